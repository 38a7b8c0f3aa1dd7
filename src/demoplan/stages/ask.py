"""A world state and a goal to a problem."""

from collections.abc import Iterable, Mapping

import dataframely as dy
import polars as pl

from demoplan.errors import DataError, UnknownNameError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Problem
from demoplan.tables import Facts


def state_at(facts: dy.DataFrame[Facts], episode_id: str, instant_ns: int) -> frozenset[Atom]:
    """Atoms that were observed to hold at an instant; what was unknown is left out.

    Args:
        facts: Intervals of ground atoms, of any number of episodes.
        episode_id: The demonstration to look into.
        instant_ns: Time on the episode's clock [ns].

    Raises:
        UnknownNameError: If there is no such episode.
        DataError: If the instant lies outside the episode's facts.
    """
    own = facts.filter(pl.col("episode_id") == episode_id)
    if own.is_empty():
        raise UnknownNameError("episode", episode_id, facts["episode_id"].unique(), "the facts")
    start_ns, end_ns = own.select(pl.col("start_ns").min(), pl.col("end_ns").max()).row(0)
    if not start_ns <= instant_ns < end_ns:
        raise DataError(
            f"instant {instant_ns} ns is outside episode {episode_id!r}: it spans {start_ns} to {end_ns} ns"
        )
    held = own.filter(
        (pl.col("start_ns") <= instant_ns) & (instant_ns < pl.col("end_ns")) & (pl.col("value") == "true")
    )
    return frozenset(Atom(row["predicate"], tuple(row["arguments"])) for row in held.iter_rows(named=True))


def ask(
    domain: Domain, state: Iterable[Atom], objects: Mapping[str, str], goal: Iterable[Literal], name: str
) -> Problem:
    """The problem of reaching a goal from a state.

    Args:
        domain: What may be done; the state and the goal must be in its words.
        state: Ground atoms that hold; all else is false.
        objects: Type of each instance. Where the domain declares it of a narrower kind, that counts: it was
            learned that it behaves unlike others.
        goal: Ground literals that shall hold.
        name: The problem's name.

    Raises:
        UnknownNameError: If a type, predicate or object is unknown.
        DataError: If an atom has the wrong number or type of arguments, or the goal contradicts itself.
    """
    objects = _as_declared(objects, domain)
    for type_name in objects.values():
        domain.types.require(type_name)
    initial, wanted = frozenset(state), frozenset(goal)
    for atom in sorted(initial | {literal.atom for literal in wanted}):
        _require_fits(atom, domain, objects)
    for literal in sorted(wanted):
        if literal.is_positive and literal.negated() in wanted:
            raise DataError(f"the goal asks for both {literal} and its negation")
    return Problem(
        name=name,
        domain_name=domain.name,
        objects=tuple(sorted(objects.items())),
        initial=initial,
        goal=wanted,
    )


def _as_declared(objects: Mapping[str, str], domain: Domain) -> dict[str, str]:
    """Types of instances, with those of the domain's constants where they stand beside what they replace."""
    declared = dict(domain.constants)
    types = {}
    for name, kind in objects.items():
        new = declared.get(name, kind)
        beside = domain.types.ancestors(kind)[1:2]
        types[name] = new if beside and domain.types.is_subtype(new, beside[0]) else kind
    return types


def _require_fits(atom: Atom, domain: Domain, objects: Mapping[str, str]) -> None:
    signatures = {signature.name: signature for signature in domain.predicates}
    if atom.predicate not in signatures:
        raise UnknownNameError("predicate", atom.predicate, signatures, f"domain {domain.name!r}")
    wanted = signatures[atom.predicate].argument_types
    if len(atom.arguments) != len(wanted):
        raise DataError(f"{atom} has {len(atom.arguments)} arguments; {atom.predicate!r} takes {len(wanted)}")
    for argument, type_name in zip(atom.arguments, wanted, strict=True):
        if argument not in objects:
            raise UnknownNameError("object", argument, objects, f"the problem, for {atom}")
        if not domain.types.is_subtype(objects[argument], type_name):
            raise DataError(
                f"{atom}: {argument!r} is a {objects[argument]!r}; "
                f"{atom.predicate!r} takes a {type_name!r} there"
            )
