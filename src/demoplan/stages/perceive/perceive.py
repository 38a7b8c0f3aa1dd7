"""The stage itself: ground every predicate, settle its states, list its intervals."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import polars as pl
from dataframely import DataFrame

from demoplan.geometry import Codes, run_lengths
from demoplan.language.vocabulary import PredicateRule, Vocabulary
from demoplan.manifests.mapping import Entity
from demoplan.stages.perceive.bodies import Bodies, bodies_of
from demoplan.stages.perceive.evidence import FALSE, TRUE, Known, settled
from demoplan.stages.perceive.registry import DEFINITIONS, check_definitions
from demoplan.tables import Facts, Frames
from demoplan.tables.episodewise import by_episode
from demoplan.tables.validating import validated


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
    parts = [_episode(rows, entities, vocabulary, rules, params) for _, rows in by_episode(frames)]
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


def _episode(
    frames: pl.DataFrame,
    entities: Mapping[str, Entity],
    vocabulary: Vocabulary,
    rules: tuple[PredicateRule, ...],
    params: PerceiveParams,
) -> pl.DataFrame:
    bodies = bodies_of(frames, entities, vocabulary, params.velocity_window_s)
    known: dict[str, Known] = {}
    states: dict[str, tuple[list[tuple[int, ...]], Codes]] = {}
    for rule in rules:
        groundings = groundings_of(rule, bodies, vocabulary)
        numbers = dict(rule.numbers)
        evidence = DEFINITIONS[rule.definition].function(bodies, groundings, numbers, known)
        codes = settled(evidence, bodies.tick_s, numbers, params.hold_s)
        states[rule.signature.name] = (groundings, codes)
        earlier = known[rule.definition].codes if rule.definition in known else {}
        known[rule.definition] = Known(
            {**earlier, **dict(zip(groundings, codes, strict=True))}, len(bodies.tick_ns)
        )
    return _intervals(frames["episode_id"][0], bodies, states)


def _intervals(
    episode_id: str, bodies: Bodies, states: Mapping[str, tuple[list[tuple[int, ...]], Codes]]
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
    every = np.concatenate([states[name][1] for name in predicates] or [np.zeros((0, n_ticks), np.int8)])
    rows, starts, ends, values = run_lengths(every)
    is_listed = values != FALSE
    rows, starts, ends, values = rows[is_listed], starts[is_listed], ends[is_listed], values[is_listed]
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
