"""Goal text to literals: what a person types, or PDDL, checked against the world that it speaks of."""

import re
from collections.abc import Iterable, Mapping

from demoplan.errors import PddlError, UnknownNameError, UsageError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Signature
from demoplan.language.pddl.parse import parse_condition
from demoplan.language.pddl.symbols import SymbolMap
from demoplan.language.types import ROOT, TypeHierarchy

_PDDL = re.compile(r"\(\s*(?:(?:and|not)\b|[^\s()]+[\s)])", re.IGNORECASE)
_TOKEN = re.compile(
    r"\s+|(?P<and>&&?|∧|and\b)|(?P<not>!|~|¬|not\b)|(?P<atom>[A-Za-z][\w-]*\s*\([^()]*\))|(?P<open>\()|(?P<close>\))",
    re.IGNORECASE,
)
_EXAMPLE = "onTop(cube_red, cube_blue) & !inHand(Right_hand, cube_green)"


def parse_goal(
    text: str,
    predicates: Iterable[Signature],
    objects: Mapping[str, str] | Iterable[tuple[str, str]],
    types: TypeHierarchy,
) -> frozenset[Literal]:
    """The literals that a goal asks for.

    Two forms are read: ``onTop(cube_red, cube_blue) & !inHand(Right_hand, cube_green)`` (also with ``and``,
    ``not``, ``∧``, ``¬``) and PDDL, ``(and (on_top cube_red cube_blue) …)``. In both, predicates and objects
    may go by the names of the logs or by those that they have in PDDL text.

    Args:
        text: What is asked for. ``(and)`` asks for nothing and is already reached.
        predicates: Predicates that may be asked about.
        objects: Instance → type.
        types: The hierarchy that the types belong to.

    Raises:
        UnknownNameError: If a predicate or an object is not there; the error lists what is.
        PddlError: If the text is not a goal, a predicate has the wrong number or types of arguments, or the
            goal asks for an atom and for its opposite.
    """
    signatures = {signature.name: signature for signature in predicates}
    instances = dict(objects)
    asked = parse_condition(text) if _PDDL.match(text.strip()) else _infix(text)
    predicate_names = _either_name("predicate", signatures)
    object_names = _either_name("object", instances)
    goal: set[Literal] = set()
    for literal in asked:
        predicate = _resolved("predicate", literal.atom.predicate, predicate_names, signatures)
        names = tuple(_resolved("object", name, object_names, instances) for name in literal.atom.arguments)
        atom = Atom(predicate, names)
        _check(atom, signatures[predicate], instances, types)
        goal.add(Literal(atom, literal.is_positive))
    contradictory = sorted(str(each.atom) for each in goal if each.is_positive and each.negated() in goal)
    if contradictory:
        raise PddlError(f"the goal asks for {contradictory[0]} and for its opposite: no state can satisfy it")
    return frozenset(goal)


def goal_text(goal: Iterable[Literal]) -> str:
    """The goal as canonical text in the first form; ``(and)`` for a goal that asks for nothing."""
    ordered = sorted(goal, key=lambda literal: (not literal.is_positive, literal))
    return " & ".join(f"{'' if each.is_positive else '!'}{each.atom}" for each in ordered) or "(and)"


def _infix(text: str) -> tuple[Literal, ...]:
    """The literals of ``p(a) & !q(b)``; brackets around conjunctions are allowed."""
    literals: list[Literal] = []
    position, depth = 0, 0
    is_negated, wants_atom = False, True
    while position < len(text):
        match = _TOKEN.match(text, position)
        kind = match.lastgroup if match else None
        wanted = "an atom" if wants_atom else "'&' or the end"
        fits = (
            match is not None
            and (kind is None or (kind in {"atom", "not", "open"}) == wants_atom)
            and not (kind == "open" and is_negated)
            and not (kind == "close" and depth == 0)
        )
        if match is None or not fits:
            found = text[position : position + 30]
            hint = "; only conjunctions can be asked for" if re.match(r"\||or\b|∨", found) else ""
            raise PddlError(
                f"goal, column {position + 1}: expected {wanted}, found {found!r}{hint}; "
                f"a goal reads {_EXAMPLE}"
            )
        position = match.end()
        if kind == "atom":
            literals.append(Literal(Atom.parse(match[0]), not is_negated))
            is_negated, wants_atom = False, False
        elif kind == "not":
            is_negated = not is_negated
        elif kind == "and":
            wants_atom = True
        elif kind == "open":
            depth += 1
        elif kind == "close":
            depth -= 1
    if wants_atom or depth:
        missing = "an atom" if wants_atom else "')'"
        raise PddlError(f"goal: expected {missing}, found the end of {text!r}; a goal reads {_EXAMPLE}")
    return tuple(literals)


def _either_name(kind: str, names: Iterable[str]) -> dict[str, str]:
    """Own names, and PDDL names where they are not some other's own name."""
    own = list(names)
    symbols = SymbolMap.of((kind, name) for name in sorted(own))
    return {**{symbol: name for _, name, symbol in symbols.entries}, **{name: name for name in own}}


def _resolved(kind: str, asked: str, names: Mapping[str, str], available: Iterable[str]) -> str:
    found = names.get(asked)
    if found is None:
        # PDDL readers lower names, so a name that differs in case only is found if there is just one.
        alike = {name for spelling, name in names.items() if spelling.lower() == asked.lower()}
        if len(alike) != 1:
            raise UnknownNameError(kind, asked, available, where="the goal")
        found = alike.pop()
    return found


def _check(atom: Atom, signature: Signature, objects: Mapping[str, str], types: TypeHierarchy) -> None:
    wanted = signature.argument_types
    if len(atom.arguments) != len(wanted):
        takes = ", ".join(wanted) or "none"
        raise PddlError(
            f"the goal asks for {atom} with {len(atom.arguments)} arguments; "
            f"{atom.predicate} takes {len(wanted)}: {takes}"
        )
    for name, kind in zip(atom.arguments, wanted, strict=True):
        try:
            fits = kind == ROOT or types.is_subtype(objects[name], kind)
        except UnknownNameError as error:
            raise UsageError(f"object {name!r}: {error}") from error
        if not fits:
            fitting = sorted(each for each, own in objects.items() if types.is_subtype(own, kind))
            raise PddlError(
                f"the goal asks for {atom}, where {name} is a {objects[name]}; "
                f"{atom.predicate} takes a {kind}: {', '.join(fitting) or 'there is none'}"
            )
