"""Frames and facts to activities: what each hand did when, without gap."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.errors import DataError
from demoplan.geometry import Array
from demoplan.language.types import TypeHierarchy
from demoplan.stages.segment.decoding import decoded, runs_of, without_short_runs
from demoplan.stages.segment.features import feature_names, features_of
from demoplan.stages.segment.model import Segmenter
from demoplan.stages.segment.rules import RULES, RuleTree, classify_by_rules
from demoplan.stages.segment.tracks import TrackParams, Tracks, roles_of, tracks_of
from demoplan.stages.segment.trees import over_columns, probabilities
from demoplan.stages.segment.windows import n_ticks
from demoplan.tables import Activities, Facts, Frames
from demoplan.tables.validating import validated


@dataclass(frozen=True, kw_only=True)
class SegmentParams:
    """What can be chosen about segmentation."""

    motion: TrackParams = field(default_factory=TrackParams)
    """What counts as motion where facts do not say."""
    min_duration_s: float = 0.05
    """A shorter segment joins a neighbour [s]. Source: the published rules."""
    is_decoded: bool = True
    """Whether a trained segmenter decides on the whole sequence (Viterbi) and not tick by tick."""
    evidence_s: float = 0.2
    """Ticks within this time count as one observation in decoding [s]."""
    min_probability: float = 0.02
    """No activity is ever ruled out by one leaf alone: probabilities are kept above this in decoding."""
    min_held_share: float = 0.5
    """An object is in hand in a segment if it is so for at least this share of it."""
    letting_go_s: float = 0.3
    """A segment with an empty hand acts on what the hand held up to this long before it [s]."""


def segment(
    frames: dy.DataFrame[Frames],
    facts: dy.DataFrame[Facts],
    entities: Mapping[str, str],
    types: TypeHierarchy,
    segmenter: Segmenter | RuleTree = RULES,
    *,
    params: SegmentParams = SegmentParams(),
) -> dy.DataFrame[Activities]:
    """Say for every hand what it did when, from the first tick of its episode to the end of the last one.

    Args:
        frames: Poses and grips; every entity at every tick of its episode.
        facts: Atoms of the same episodes: ``inHand``, ``actedOn`` and ``handMove`` are read.
        entities: Instance → type; entities of the frames that are not named here are left out.
        types: Hierarchy of types; ``Hand`` and ``Surface`` say what each instance is to a hand.
        segmenter: A trained segmenter, or a rule tree, which needs no labels.
        params: Segmentation choices.

    Returns:
        Activities that tile each hand's episode in order, without gap or overlap, with the object that the
        hand acts on and the one that it holds. Sorted by episode, hand, start.

    Raises:
        DataError: If frames are not on one clock per episode, or the segmenter's features are not these.
        UnknownNameError: If an entity's type is not in the hierarchy.
    """
    found = []
    for tracks in tracks_of(frames, facts, roles_of(entities, types), params.motion):
        if not tracks.hands:
            continue
        if isinstance(segmenter, RuleTree):
            names, classes = classify_by_rules(tracks, segmenter, entities, types)
            evidence: Array | None = None
        else:
            names = segmenter.activities
            classes, evidence = classify_by_model(tracks, segmenter, params)
        min_ticks = n_ticks(params.min_duration_s, tracks.tick_s)
        for hand in range(len(tracks.hands)):
            calm = without_short_runs(classes[hand], None if evidence is None else evidence[hand], min_ticks)
            found.append(_rows(tracks, hand, names, calm, params))
    table = pl.concat(found) if found else Activities.create_empty()
    return validated(table.sort("episode_id", "hand", "start_ns"), Activities)


def classify_by_model(
    tracks: Tracks, segmenter: Segmenter, params: SegmentParams
) -> tuple[NDArray[np.int64], Array]:
    """The activity of every hand at every tick ``(h, t)``, and its evidence: log-probabilities ``(h, t, k)``.

    Raises:
        DataError: If the segmenter was trained on features that this version does not compute.
    """
    available = feature_names(segmenter.feature_params)
    if available != segmenter.feature_names:
        missing = sorted(set(segmenter.feature_names) - set(available))
        raise DataError(
            f"the segmenter asks for features {missing or 'in another order'}; this version computes "
            f"{len(available)} others: train it again"
        )
    features = features_of(tracks, segmenter.feature_params, segmenter.features_used)
    n_hands, length, n_features = features.values.shape
    trees = over_columns(segmenter.trees, [available.index(name) for name in features.names])
    flat = probabilities(trees, features.values.reshape(n_hands * length, n_features))
    del features
    # In place: of a long episode, each copy would be as large as all that is known of it.
    share = np.maximum(flat, params.min_probability, out=flat).reshape(n_hands, length, -1)
    share /= share.sum(axis=2, keepdims=True)
    evidence = np.log(share, out=share)
    if not params.is_decoded:
        return evidence.argmax(axis=2), evidence
    weight = min(1.0, tracks.tick_s / params.evidence_s)
    grammar = segmenter.grammar
    change = grammar.costs(params.evidence_s)
    classes = [decoded(evidence[hand] * weight, grammar.initial, change) for hand in range(n_hands)]
    return np.asarray(classes).reshape(n_hands, length), evidence


def _rows(
    tracks: Tracks, hand: int, names: tuple[str, ...], classes: NDArray[np.int64], params: SegmentParams
) -> pl.DataFrame:
    """Rows of one hand: runs of equal classes, with the objects concerned."""
    starts, values = runs_of(classes)
    ends = np.append(starts[1:], len(classes))
    end_ns = np.append(tracks.tick_ns, tracks.tick_ns[-1] + round(tracks.tick_s * 1e9))
    acted_on, in_hand = _concerned(tracks, hand, starts, ends, params)
    objects = [*tracks.objects, *tracks.surfaces]
    return pl.DataFrame(
        {
            "episode_id": [tracks.episode_id] * len(starts),
            "hand": [tracks.hands[hand]] * len(starts),
            "start_ns": tracks.tick_ns[starts],
            "end_ns": end_ns[ends],
            "activity": [names[value] for value in values],
            "acted_on": [objects[i] if i >= 0 else None for i in acted_on],
            "in_hand": [objects[i] if i >= 0 else None for i in in_hand],
        },
        schema_overrides={"acted_on": pl.String, "in_hand": pl.String},
    )


def _concerned(
    tracks: Tracks, hand: int, starts: NDArray[np.int64], ends: NDArray[np.int64], params: SegmentParams
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """What each segment of one hand acts on, and what it holds ``(run,)``; −1 for nothing.

    An object that is let go of is acted on; so is one that is grasped, if nothing else is.
    """
    is_held = tracks.in_hand[hand]
    if not len(is_held):
        acted = _most(_ticks_per_run(tracks.acted_on[hand], starts), np.ones(len(starts)))
        return acted, np.full(len(starts), -1)
    in_hand = _most(_ticks_per_run(is_held, starts), np.maximum(1, params.min_held_share * (ends - starts)))
    holds = in_hand >= 0
    # What a hand holds all along is not what it acts on.
    acted_ticks = _ticks_per_run(tracks.acted_on[hand], starts)
    acted_ticks[np.flatnonzero(holds), in_hand[holds]] = 0
    acted_on = _most(acted_ticks, np.ones(len(starts)))
    last = is_held[:, ends - 1].T
    grasped = _most((last & ~is_held[:, starts].T).astype(np.int64), np.ones(len(starts)))
    acted_on = np.where(acted_on < 0, grasped, acted_on)
    # A grip is seen to open a little before or after the activity changes.
    before = np.maximum(starts - n_ticks(params.letting_go_s, tracks.tick_s), 0)
    n_held = np.concatenate((np.zeros((len(is_held), 1), np.int64), np.cumsum(is_held, axis=1)), axis=1)
    let_go = _most(((n_held[:, ends] - n_held[:, before]).T * ~last), np.ones(len(starts)))
    return np.where(~holds & (let_go >= 0), let_go, acted_on), in_hand


def _ticks_per_run(mask: NDArray[np.bool_], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """True ticks of each object in each run ``(run, object)``."""
    if not len(mask):
        return np.zeros((len(starts), 0), dtype=np.int64)
    counts: NDArray[np.int64] = np.add.reduceat(mask.astype(np.int64), starts, axis=1).T
    return counts


def _most(ticks: NDArray[np.int64], least: Array) -> NDArray[np.int64]:
    """The object with the most ticks in each run, −1 where it has fewer than ``least``."""
    if not ticks.shape[1]:
        return np.full(len(ticks), -1)
    best = ticks.argmax(axis=1)
    return np.where(ticks[np.arange(len(ticks)), best] >= least, best, -1)
