"""Reference domains as an oracle: a small reader and simulator of STRIPS PDDL, apart from the package.

What is learned is judged here, so nothing here is shared with the learner: another reader, another
simulator, another way of counting. Names compare without case, as in PDDL.
"""

import itertools
import re
from dataclasses import dataclass, field
from pathlib import Path

Fact = tuple[str, ...]
"""A predicate and its arguments."""

_TOKEN = re.compile(r"[()]|[^\s()]+")


def read(text: str) -> list:
    """Nested lists of lower-case names; comments are dropped."""
    root: list = []
    stack = [root]
    for token in _TOKEN.findall(re.sub(r";[^\n]*", "", text).lower()):
        if token == "(":
            inner: list = []
            stack[-1].append(inner)
            stack.append(inner)
        elif token == ")":
            stack.pop()
        else:
            stack[-1].append(token)
    return root[0]


def typed(names: list) -> list[tuple[str, str]]:
    """``a b - t c`` as pairs of name and type; a name without a type is an ``object``."""
    pairs: list[tuple[str, str]] = []
    waiting: list[str] = []
    words = iter(names)
    for word in words:
        if word == "-":
            type_name = next(words)
            pairs += [(name, type_name) for name in waiting]
            waiting = []
        else:
            waiting.append(word)
    return pairs + [(name, "object") for name in waiting]


@dataclass
class Action:
    """A lifted action, as sets of facts over its variables and constants."""

    name: str
    parameters: list[tuple[str, str]]
    holds: set[Fact] = field(default_factory=set)
    absent: set[Fact] = field(default_factory=set)
    adds: set[Fact] = field(default_factory=set)
    deletes: set[Fact] = field(default_factory=set)
    differs: list[tuple[str, str]] = field(default_factory=list)

    def ground(self, facts: set[Fact], arguments: tuple[str, ...]) -> set[Fact]:
        """Facts over variables as facts over objects."""
        names = dict(zip((name for name, _ in self.parameters), arguments, strict=True))
        return {(fact[0], *(names.get(word, word) for word in fact[1:])) for fact in facts}

    def is_applicable(self, state: set[Fact], arguments: tuple[str, ...]) -> bool:
        """Whether the preconditions hold."""
        names = dict(zip((name for name, _ in self.parameters), arguments, strict=True))
        return (
            self.ground(self.holds, arguments) <= state
            and not self.ground(self.absent, arguments) & state
            and all(names.get(a, a) != names.get(b, b) for a, b in self.differs)
        )

    def apply(self, state: set[Fact], arguments: tuple[str, ...]) -> set[Fact]:
        """The next state: what is added wins over what is deleted."""
        return (state - self.ground(self.deletes, arguments)) | self.ground(self.adds, arguments)


@dataclass
class Model:
    """A domain: types with their parents, constants, predicates, actions."""

    name: str
    parents: dict[str, str]
    constants: list[tuple[str, str]]
    predicates: dict[str, list[str]]
    actions: dict[str, Action]

    def fits(self, type_name: str, wanted: str) -> bool:
        """Whether one type stands below another."""
        while type_name != wanted and type_name in self.parents:
            type_name = self.parents[type_name]
        return wanted in {type_name, "object"}

    def objects_of(self, objects: dict[str, str], wanted: str) -> list[str]:
        """Names of the objects that fit a type, sorted."""
        return sorted(name for name, type_name in objects.items() if self.fits(type_name, wanted))


def _literals(tree: list) -> tuple[set[Fact], set[Fact], list[tuple[str, str]]]:
    positive: set[Fact] = set()
    negative: set[Fact] = set()
    differs: list[tuple[str, str]] = []
    if not tree:
        return positive, negative, differs
    for part in tree[1:] if tree[0] == "and" else [tree]:
        if part[0] == "not" and part[1][0] == "=":
            differs.append((part[1][1], part[1][2]))
        elif part[0] == "not":
            negative.add(tuple(part[1]))
        elif part[0] in {"when", "forall", "or", "imply", "exists"}:
            raise ValueError(f"{part[0]!r} is beyond STRIPS")
        else:
            positive.add(tuple(part))
    return positive, negative, differs


def read_domain(path: Path) -> Model:
    """A domain from its file."""
    model = Model(path.stem, {}, [], {}, {})
    for section in read(path.read_text())[1:]:
        match section[0]:
            case "domain":
                model.name = section[1]
            case ":types":
                model.parents = {name: parent for name, parent in typed(section[1:]) if name != "object"}
            case ":constants":
                model.constants = typed(section[1:])
            case ":predicates":
                model.predicates = {one[0]: [kind for _, kind in typed(one[1:])] for one in section[1:]}
            case ":action":
                parts = dict(zip(section[2::2], section[3::2], strict=True))
                action = Action(section[1], typed(parts.get(":parameters", [])))
                action.holds, action.absent, action.differs = _literals(parts.get(":precondition", []))
                action.adds, action.deletes, _ = _literals(parts.get(":effect", []))
                model.actions[action.name] = action
    return model


def read_problem(path: Path, model: Model) -> tuple[dict[str, str], set[Fact], tuple[set[Fact], set[Fact]]]:
    """Objects with types (constants too), the initial state, and the goal's positive and negative facts."""
    objects = dict(model.constants)
    initial: set[Fact] = set()
    goal: tuple[set[Fact], set[Fact]] = (set(), set())
    for section in read(path.read_text())[1:]:
        match section[0]:
            case ":objects":
                objects |= dict(typed(section[1:]))
            case ":init":
                initial = {tuple(fact) for fact in section[1:] if fact[0] != "="}
            case ":goal":
                goal = _literals(section[1] if len(section) > 1 else [])[:2]
    return objects, initial, goal


def read_trace(path: Path) -> tuple[list[set[Fact]], list[Fact]]:
    """States and the actions between them."""
    tree = read(path.read_text())
    states = [{tuple(fact) for fact in part[1:]} for part in tree[1:] if part[0] == ":state"]
    return states, [tuple(part[1]) for part in tree[1:] if part[0] == ":action"]


def all_facts(model: Model, objects: dict[str, str]) -> list[Fact]:
    """Every well-typed ground fact, sorted."""
    found: list[Fact] = []
    for name, types in sorted(model.predicates.items()):
        found += [
            (name, *chosen) for chosen in itertools.product(*(model.objects_of(objects, t) for t in types))
        ]
    return found


def signatures_only(path: Path) -> str:
    """The domain's text with every precondition and effect emptied; names and letters as they were."""
    text = re.sub(r";[^\n]*", "", path.read_text())
    out, position = [], 0
    for match in re.finditer(r":(precondition|effect)\s*\(", text):
        depth, end = 1, match.end()
        while depth:
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        out += [text[position : match.start()], f":{match[1]} (and )"]
        position = end
    return "".join([*out, text[position:]])


def problem_text(
    name: str, domain: str, objects: dict[str, str], initial: set[Fact], constants: set[str]
) -> str:
    """A problem without a goal, for a case folder."""
    listed = " ".join(f"{one} - {kind}" for one, kind in sorted(objects.items()) if one not in constants)
    facts = " ".join(f"({' '.join(fact)})" for fact in sorted(initial))
    head = f"(define (problem {name}) (:domain {domain})"
    return f"{head}\n(:objects {listed})\n(:init {facts})\n(:goal (and )))\n"


def trace_text(states: list[set[Fact]], actions: list[Fact]) -> str:
    """States and actions in the form of a trajectory file."""
    parts = []
    for index, state in enumerate(states):
        parts.append(f"(:state {' '.join('(' + ' '.join(fact) + ')' for fact in sorted(state))})")
        if index < len(actions):
            parts.append(f"(:action ({' '.join(actions[index])}))")
    return "(:trajectory\n\n" + "\n\n".join(parts) + "\n\n)\n"


def domain_text(model: Model, names: set[str]) -> str:
    """A model's text, with the actions named."""

    def joined(facts: set[Fact], pattern: str = "{}") -> str:
        return " ".join(pattern.format(f"({' '.join(fact)})") for fact in sorted(facts))

    types = " ".join(f"{name} - {parent}" for name, parent in sorted(model.parents.items()))
    constants = " ".join(f"{name} - {kind}" for name, kind in model.constants)
    predicates = " ".join(
        f"({name}{''.join(f' ?x{n} - {kind}' for n, kind in enumerate(kinds))})"
        for name, kinds in sorted(model.predicates.items())
    )
    lines = [f"(define (domain {model.name})", "(:requirements :strips :typing)"]
    lines += [f"(:types {types})"] if types else []
    lines += [f"(:constants {constants})"] if constants else []
    lines.append(f"(:predicates {predicates})")
    for name in sorted(names):
        action = model.actions[name]
        parameters = " ".join(f"{one} - {kind}" for one, kind in action.parameters)
        lines.append(
            f"(:action {name} :parameters ({parameters})\n"
            f" :precondition (and {joined(action.holds)} {joined(action.absent, '(not {})')})\n"
            f" :effect (and {joined(action.adds)} {joined(action.deletes, '(not {})')}))"
        )
    return "\n".join([*lines, ")"]) + "\n"
