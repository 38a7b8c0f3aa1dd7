"""The stage itself: ground every predicate, settle its states, list its intervals."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import polars as pl
from dataframely import DataFrame

from demoplan.errors import DataError
from demoplan.geometry import Codes, run_lengths
from demoplan.geometry.switching import Ints
from demoplan.language.vocabulary import PredicateRule, Vocabulary
from demoplan.manifests.mapping import Entity
from demoplan.stages.perceive.bodies import Bodies, bodies_of
from demoplan.stages.perceive.evidence import FALSE, TRUE, Evidence, Known, Numbers, settled
from demoplan.stages.perceive.registry import DEFINITIONS, Definition, check_definitions
from demoplan.tables import Facts, Frames
from demoplan.tables.episodewise import by_episode
from demoplan.tables.validating import validated

TICKS_AT_ONCE = 1 << 16
"""Ticks of a long episode that are looked at together."""


@dataclass(frozen=True, kw_only=True)
class PerceiveParams:
    """What can be chosen about perception, beside the vocabulary's numbers."""

    velocity_window_s: float = 0.15
    """Window of the straight-line fit behind every velocity [s]. At 100 Hz and 1 mm of noise a velocity is
    then uncertain by 6 mm/s along each axis, well below the threshold of 40 mm/s."""
    hold_s: float = 0.3
    """An atom keeps its state over a shorter gap in what it needs [s], where its predicate states no
    ``hold_s`` of its own."""


def perceive(
    frames: DataFrame[Frames],
    entities: Mapping[str, Entity],
    vocabulary: Vocabulary,
    params: PerceiveParams = PerceiveParams(),
) -> DataFrame[Facts]:
    """Find out what held when.

    Every predicate is tried on every tuple of different entities whose types fit its arguments. Its
    definition says at which ticks the atom begins and at which it may go on to hold; hysteresis, gaps and
    flickers are then settled (see :func:`demoplan.stages.perceive.evidence.settled`).

    Args:
        frames: Poses and grips on one clock, as ``align`` gives them.
        entities: Type, and where it differs from the type's, shape, of every entity in the frames.
        vocabulary: Types, shapes, predicates.
        params: Choices that are not a predicate's own.

    Returns:
        Longest intervals in which an atom held, or could not be known; in order of episode, predicate,
        arguments and time. What is not listed was observed false.

    Raises:
        UnknownNameError: If an entity has no type, or a type, definition or number does not exist.
        DataError: If a predicate does not fit its definition, or the frames are not a full grid.
    """
    rules = check_definitions(vocabulary)
    parts = [
        _episode(
            episode_id,
            bodies_of([rows], entities, vocabulary, params.velocity_window_s),
            vocabulary,
            rules,
            params,
        )
        for episode_id, rows in by_episode(frames)
    ]
    facts = pl.concat(parts) if parts else Facts.create_empty()
    return validated(facts, Facts)


def groundings_of(rule: PredicateRule, bodies: Bodies, vocabulary: Vocabulary) -> list[tuple[int, ...]]:
    """Every tuple of different bodies whose types fit the predicate's arguments, in order of their names."""
    fitting = [
        [row for row, name in enumerate(bodies.types) if vocabulary.types.is_subtype(name, wanted)]
        for wanted in rule.signature.argument_types
    ]

    def extend(prefix: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if len(prefix) == len(fitting):
            yield prefix
            return
        for row in fitting[len(prefix)]:
            if row not in prefix:
                yield from extend((*prefix, row))

    return list(extend(()))


def perceive_parts(
    parts: Iterable[DataFrame[Frames]],
    entities: Mapping[str, Entity],
    vocabulary: Vocabulary,
    params: PerceiveParams = PerceiveParams(),
    *,
    ticks_at_once: int = TICKS_AT_ONCE,
) -> DataFrame[Facts]:
    """Find out what held when in one long episode: what :func:`perceive` gives, in less memory.

    Poses of all ticks are kept; what definitions derive from them is found some ticks at a time, and only
    the states of atoms last.

    Args:
        parts: Frames of one episode, some rows at a time.
        entities: As for ``perceive``.
        vocabulary: Types, shapes, predicates.
        params: Choices that are not a predicate's own.
        ticks_at_once: Ticks to work on together; it changes no state.

    Returns:
        The facts that ``perceive`` gives.

    Raises:
        UnknownNameError: As ``perceive`` does.
        DataError: As ``perceive`` does, or if the parts are of several episodes.
    """
    rules = check_definitions(vocabulary)
    episodes: set[str] = set()

    def watched() -> Iterator[pl.DataFrame]:
        for part in parts:
            if len(part):
                episodes.update(part["episode_id"].unique())
                yield part

    rows = watched()
    first = next(rows, None)
    if first is None:
        return Facts.create_empty()
    bodies = bodies_of(itertools.chain([first], rows), entities, vocabulary, params.velocity_window_s)
    if len(episodes) > 1:
        raise DataError(
            f"parts of several episodes cannot be perceived as one: {', '.join(sorted(episodes))}"
        )
    (episode_id,) = episodes
    return validated(_episode(episode_id, bodies, vocabulary, rules, params, ticks_at_once), Facts)


def _episode(
    episode_id: str,
    bodies: Bodies,
    vocabulary: Vocabulary,
    rules: tuple[PredicateRule, ...],
    params: PerceiveParams,
    ticks_at_once: int | None = None,
) -> pl.DataFrame:
    known: dict[str, Known] = {}
    states: dict[str, tuple[list[tuple[int, ...]], Codes]] = {}
    for rule in rules:
        groundings = groundings_of(rule, bodies, vocabulary)
        numbers = dict(rule.numbers)
        definition = DEFINITIONS[rule.definition]
        if ticks_at_once is None:
            evidence = definition.function(bodies, groundings, numbers, known)
            codes = settled(evidence, bodies.tick_s, numbers, params.hold_s)
        else:
            evidence = _by_windows(definition, bodies, groundings, numbers, known, ticks_at_once)
            codes = _settled_one_by_one(evidence, bodies.tick_s, numbers, params.hold_s)
        del evidence
        states[rule.signature.name] = (groundings, codes)
        earlier = known[rule.definition].codes if rule.definition in known else {}
        known[rule.definition] = Known(
            {**earlier, **dict(zip(groundings, codes, strict=True))}, len(bodies.tick_ns)
        )
    return _intervals(episode_id, bodies, states, is_long=ticks_at_once is not None)


def _by_windows(
    definition: Definition,
    bodies: Bodies,
    groundings: list[tuple[int, ...]],
    numbers: Numbers,
    known: dict[str, Known],
    ticks_at_once: int,
) -> Evidence:
    """Evidence of all ticks, found some ticks at a time where each tick is judged by itself."""
    n = len(bodies.tick_ns)
    windows = [slice(start, start + ticks_at_once) for start in range(0, n, ticks_at_once)]
    if not definition.is_by_tick:
        bodies.measure([(one, other) for one, other in groundings], windows)
        evidence = definition.function(bodies, groundings, numbers, known)
        bodies.forget()
        return evidence
    shape = (len(groundings), n)
    whole = Evidence(*(np.empty(shape, np.bool_) for _ in range(3)))
    for window in windows:
        now = {name: each.during(window) for name, each in known.items()}
        some = definition.function(bodies.during(window), groundings, numbers, now)
        whole.enters[:, window] = some.enters
        whole.stays[:, window] = some.stays
        whole.is_observed[:, window] = some.is_observed
    return whole


def _settled_one_by_one(evidence: Evidence, tick_s: float, numbers: Numbers, hold_s: float) -> Codes:
    """States of all atoms, each settled by itself: none depends on another."""
    codes = np.empty(evidence.enters.shape, np.int8)
    for row in range(len(codes)):
        own = slice(row, row + 1)
        alone = Evidence(evidence.enters[own], evidence.stays[own], evidence.is_observed[own])
        codes[own] = settled(alone, tick_s, numbers, hold_s)
    return codes


def _intervals(
    episode_id: str,
    bodies: Bodies,
    states: Mapping[str, tuple[list[tuple[int, ...]], Codes]],
    *,
    is_long: bool,
) -> pl.DataFrame:
    """Runs of true and of unknown, as rows."""
    period = round(bodies.tick_s * 1e9)
    edges = np.append(bodies.tick_ns, bodies.tick_ns[-1] + period)
    predicates = sorted(name for name, (groundings, _) in states.items() if groundings)
    atoms: list[list[str]] = []
    counts: list[int] = []
    for name in predicates:
        groundings = states[name][0]
        atoms += [[bodies.names[body] for body in grounding] for grounding in groundings]
        counts.append(len(groundings))
    n_ticks = len(bodies.tick_ns)
    every = [states[name][1] for name in predicates] or [np.zeros((0, n_ticks), np.int8)]
    # In a short episode one pass over all is quicker.
    blocks = every if is_long else [np.concatenate(every)]
    offsets = np.cumsum([0, *(len(block) for block in blocks)])
    found = [_listed(block, int(offset)) for block, offset in zip(blocks, offsets, strict=False)]
    rows, starts, ends, values = (np.concatenate(column) for column in zip(*found, strict=True))
    predicate_of = np.repeat(np.arange(len(predicates)), counts)
    return pl.DataFrame(
        {
            "episode_id": pl.Series([episode_id]).new_from_index(0, len(rows)),
            "predicate": pl.Series(predicates, dtype=pl.String).gather(predicate_of[rows]),
            "arguments": pl.Series(atoms, dtype=pl.List(pl.String)).gather(rows),
            "start_ns": edges[starts],
            "end_ns": edges[ends],
            "value": pl.Series(np.where(values == TRUE, "true", "unknown")).cast(Facts.value.dtype),
        }
    )


def _listed(codes: Codes, offset: int) -> tuple[Ints, Ints, Ints, Codes]:
    """Runs that are not false: row, counted from ``offset``, first tick, tick after the last, and value."""
    rows, starts, ends, values = run_lengths(codes)
    is_listed = values != FALSE
    return rows[is_listed] + offset, starts[is_listed], ends[is_listed], values[is_listed]
