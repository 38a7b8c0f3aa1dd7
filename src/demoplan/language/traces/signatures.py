"""Signatures and objects from PDDL text, and learned actions back to PDDL text, with names as they were.

The package's domain reader wants a whole and correct domain. A case for a learner is a domain without
conditions and effects, whose faults should be told and stepped over; so only what a signature needs is read.
"""

import itertools
import re
from collections.abc import Iterator, Mapping

from demoplan.errors import DataError, PddlError
from demoplan.language.atoms import Literal
from demoplan.language.domains import Parameter, Signature
from demoplan.language.pddl.expressions import Expression, Node, Place, Word, read, shown
from demoplan.language.traces.values import ActionSignature, Fault, Signatures
from demoplan.language.types import ROOT, TypeHierarchy

_OBJECTS = re.compile(r"\(\s*:objects\s([^()]*)\)", re.IGNORECASE)


class _Source:
    """A text with its file name: gives words their letters back, and collects faults."""

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.lines = text.split("\n")
        self.faults: list[Fault] = []

    def name(self, word: Word) -> str:
        """The word as written: the reader of expressions gives lower case."""
        start = word.place.column - 1
        return self.lines[word.place.line - 1][start : start + len(word.text)]

    def fault(self, place: Place, problem: str) -> None:
        self.faults.append(Fault(self.file, place.line, problem))

    def typed(self, items: list[Node], default: str = ROOT) -> Iterator[tuple[Word, Word | None]]:
        """Names with the word of their type; ``default`` types have none."""
        waiting: list[Word] = []
        words = iter(items)
        for item in words:
            if not isinstance(item, Word):
                self.fault(item.place, f"expected a name, found {shown(item)}")
            elif item.text == "-":
                kind = next(words, None)
                if not isinstance(kind, Word):
                    self.fault(item.place, f"expected one type's name after '-'; using {default!r}")
                    kind = None
                yield from ((name, kind) for name in waiting)
                waiting = []
            else:
                waiting.append(item)
        yield from ((name, None) for name in waiting)


def _sections(text: str, file: str) -> list[Expression]:
    """The lists inside of ``(define …)``.

    Raises:
        PddlError: If brackets do not match, or there is no ``(define …)``; the message names file and line.
    """
    try:
        top, _ = read(text)
    except PddlError as error:
        raise PddlError(f"{file}: {error}") from error
    if len(top) != 1 or not top[0].items or getattr(top[0].items[0], "text", "") != "define":
        raise PddlError(f"{file}:1: expected one (define …)")
    return [item for item in top[0].items[1:] if isinstance(item, Expression) and item.items]


def read_signatures(text: str, file: str) -> tuple[Signatures, tuple[Fault, ...]]:
    """Types, constants, predicates and actions of a domain; conditions and effects are not looked at.

    Args:
        text: PDDL of a domain.
        file: Its name, for messages.

    Returns:
        The signatures, and what in them contradicts itself: of two declarations the first holds.

    Raises:
        PddlError: If the text is not a PDDL domain at all.
    """
    source = _Source(text, file)
    domain_name, types, constants = "domain", TypeHierarchy.of({}), dict[str, tuple[str, str]]()
    predicates: dict[str, Signature] = {}
    actions: dict[str, ActionSignature] = {}
    known: dict[str, str] = {ROOT: ROOT}

    def kind_of(word: Word | None) -> str:
        if word is None:
            return ROOT
        if word.text not in known:
            listed = ", ".join(sorted(known.values()))
            source.fault(
                word.place, f"unknown type {source.name(word)!r}, taken as {ROOT!r}; declared: {listed}"
            )
        return known.get(word.text, ROOT)

    sections = _sections(text, file)
    for section in sections:
        if isinstance(section.items[0], Word) and section.items[0].text == ":types":
            types = _types(source, section, known)
    for section in sections:
        match section.items:
            case [Word(text="domain"), Word() as name, *_]:
                domain_name = source.name(name)
            case [Word(text=":constants"), *items]:
                for name, kind in source.typed(items):
                    if name.text in constants:
                        source.fault(name.place, f"constant {source.name(name)!r} is declared twice")
                    constants.setdefault(name.text, (source.name(name), kind_of(kind)))
            case [Word(text=":predicates"), *items]:
                for item in items:
                    if isinstance(item, Expression) and item.items and isinstance(item.items[0], Word):
                        head = item.items[0]
                        signature = Signature(
                            source.name(head),
                            tuple(kind_of(kind) for _, kind in source.typed(item.items[1:])),
                        )
                        if predicates.setdefault(head.text, signature) != signature:
                            source.fault(head.place, _twice("predicate", signature.name))
                    else:
                        source.fault(item.place, f"expected (predicate ?x - type …), found {shown(item)}")
            case [Word(text=":action"), Word() as name, *items]:
                action = ActionSignature(source.name(name), _parameters(source, items, kind_of))
                if actions.setdefault(name.text, action) != action:
                    source.fault(name.place, _twice("action", action.name))
            case _:
                pass
    signatures = Signatures(
        domain_name, types, tuple(constants.values()), tuple(predicates.values()), tuple(actions.values())
    )
    return signatures, tuple(source.faults)


def _twice(kind: str, name: str) -> str:
    return f"{kind} {name!r} is declared twice, differently; the first declaration is used"


def _types(source: _Source, section: Expression, known: dict[str, str]) -> TypeHierarchy:
    pairs = [(name, kind) for name, kind in source.typed(section.items[1:])]
    for name, kind in pairs:
        known.setdefault(name.text, source.name(name))
        if kind is not None:
            known.setdefault(kind.text, source.name(kind))
    parents: dict[str, str] = {}
    for name, kind in pairs:
        parent = known[kind.text] if kind is not None else ROOT
        if name.text != ROOT and parents.setdefault(known[name.text], parent) != parent:
            source.fault(name.place, _twice("type", source.name(name)))
    try:
        return TypeHierarchy.of(parents)
    except DataError as error:
        raise PddlError(f"{source.file}:{section.place.line}: {error}") from error


def _parameters(source: _Source, items: list[Node], kind_of: object) -> tuple[Parameter, ...]:
    assert callable(kind_of)
    for key, value in itertools.pairwise(items):
        if isinstance(key, Word) and key.text == ":parameters" and isinstance(value, Expression):
            found: dict[str, Parameter] = {}
            for name, kind in source.typed(value.items):
                if name.text in found:
                    source.fault(name.place, f"parameter {source.name(name)!r} is declared twice")
                    continue
                found[name.text] = Parameter(source.name(name), kind_of(kind))
            return tuple(found.values())
    return ()


def read_objects(text: str, file: str, signatures: Signatures) -> tuple[dict[str, str], tuple[Fault, ...]]:
    """Objects of a problem, as ``{name: type}``; its initial state and goal are not looked at.

    Raises:
        PddlError: If the text is not a PDDL problem at all.
    """
    kinds = {name.lower(): name for name in (*signatures.types.names, ROOT)}
    alone = _objects_alone(text)
    if alone is not None:
        plain = _plain_objects(alone[1], kinds)
        if plain is not None:
            return plain, ()
        text = "(define (problem p)" + "\n" * text.count("\n", 0, alone.start()) + alone[0] + ")"
    source = _Source(text, file)
    objects: dict[str, str] = {}
    for section in _sections(text, file):
        if isinstance(section.items[0], Word) and section.items[0].text == ":objects":
            for name, kind in source.typed(section.items[1:]):
                if kind is not None and kind.text not in kinds:
                    listed = ", ".join(sorted(kinds.values()))
                    source.fault(name.place, f"unknown type {source.name(kind)!r}; declared: {listed}")
                    continue
                objects[source.name(name)] = kinds[kind.text] if kind is not None else ROOT
    return objects, tuple(source.faults)


def _objects_alone(text: str) -> re.Match[str] | None:
    """The objects of a problem in which they stand in one place, without comments; else nothing.

    The initial state of a noisy trace holds thousands of atoms that nobody asks for.
    """
    if ";" in text or len(_OBJECTS.findall(text)) != 1:
        return None
    return _OBJECTS.search(text)


def _plain_objects(listed: str, kinds: Mapping[str, str]) -> dict[str, str] | None:
    """Objects with types, if all types are known; else nothing."""
    objects: dict[str, str] = {}
    waiting: list[str] = []
    words = iter(listed.split())
    for word in words:
        if word != "-":
            waiting.append(word)
            continue
        kind = kinds.get(next(words, "-").lower())
        if kind is None:
            return None
        objects |= dict.fromkeys(waiting, kind)
        waiting = []
    return objects | dict.fromkeys(waiting, ROOT)


def render_strips(
    signatures: Signatures, learned: Mapping[str, tuple[frozenset[Literal], frozenset[Literal]]]
) -> str:
    """A domain as plain ``:strips :typing :negative-preconditions`` text, with the signatures' own names.

    Args:
        signatures: What the domain declares.
        learned: Preconditions and effects of the actions that are known. Others are left out.
    """
    typed = " ".join(f"{name} - {parent}" for name, parent in signatures.types.parents)
    constants = " ".join(f"{name} - {kind}" for name, kind in signatures.constants)
    lines = [
        f"(define (domain {signatures.domain_name})",
        "  (:requirements :strips :typing :negative-preconditions)",
    ]
    lines += [f"  (:types {typed})"] if typed else []
    lines += [f"  (:constants {constants})"] if constants else []
    lines.append("  (:predicates")
    for predicate in signatures.predicates:
        arguments = "".join(f" ?x{n} - {kind}" for n, kind in enumerate(predicate.argument_types, start=1))
        lines.append(f"    ({predicate.name}{arguments})")
    lines.append("  )")
    for action in signatures.actions:
        if action.name in learned:
            conditions, effects = learned[action.name]
            parameters = " ".join(f"{each.variable} - {each.type_name}" for each in action.parameters)
            lines += [
                f"  (:action {action.name}",
                f"    :parameters ({parameters})",
                f"    :precondition (and{_joined(conditions)})",
                f"    :effect (and{_joined(effects)})",
                "  )",
            ]
    return "\n".join([*lines, ")"]) + "\n"


def _joined(literals: frozenset[Literal]) -> str:
    ordered = sorted(literals, key=lambda each: (not each.is_positive, each.atom))
    texts = [f"({' '.join((each.atom.predicate, *each.atom.arguments))})" for each in ordered]
    return "".join(
        f" {text}" if each.is_positive else f" (not {text})"
        for each, text in zip(ordered, texts, strict=True)
    )
