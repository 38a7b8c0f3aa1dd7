"""Operators, domains, problems and plans, as values that compare by content."""

from dataclasses import dataclass, field

from demoplan.language.atoms import Atom, Literal
from demoplan.language.types import TypeHierarchy


@dataclass(frozen=True, order=True)
class Parameter:
    """A typed variable; ``variable`` starts with ``?``."""

    variable: str
    type_name: str


@dataclass(frozen=True, order=True)
class Signature:
    """A predicate's name and the types of its arguments."""

    name: str
    argument_types: tuple[str, ...]


@dataclass(frozen=True)
class Operator:
    """A lifted action: the effects state the change only.

    ``cost`` is what the planner minimises; ``count`` is the number of transitions behind it.
    """

    name: str
    parameters: tuple[Parameter, ...]
    preconditions: frozenset[Literal]
    effects: frozenset[Literal]
    activity: str = ""
    cost: int = 1
    count: int = 0


@dataclass(frozen=True)
class Domain:
    """What a planner may do: types, predicates and operators.

    ``predicates`` and ``operators`` are sorted by name. ``constants`` holds (instance, type) pairs, sorted:
    the objects that operators themselves name, and that every problem has.
    """

    name: str
    types: TypeHierarchy
    predicates: tuple[Signature, ...]
    operators: tuple[Operator, ...]
    constants: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Problem:
    """A start and a goal. ``objects`` holds (instance, type) pairs sorted by instance."""

    name: str
    domain_name: str
    objects: tuple[tuple[str, str], ...]
    initial: frozenset[Atom]
    goal: frozenset[Literal]


@dataclass(frozen=True)
class Step:
    """A ground operator: its name and the instances bound to its parameters, in order."""

    operator: str
    arguments: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Canonical text: ``put_1(Right_hand,cube_red)``."""
        return f"{self.operator}({','.join(self.arguments)})"


@dataclass(frozen=True)
class Plan:
    """Steps in order, and what they cost."""

    steps: tuple[Step, ...] = field(default=())
    cost: int = 0
