"""Why a hand's stretch of time has the name that it has: the rule's row, or the path through the tree."""

from collections.abc import Mapping
from dataclasses import dataclass

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.language.types import TypeHierarchy
from demoplan.stages.segment.features import features_of
from demoplan.stages.segment.model import Segmenter
from demoplan.stages.segment.rules import PUBLISHED_RULES, RULES, RuleTree, classify_by_rules
from demoplan.stages.segment.segmentation import SegmentParams
from demoplan.stages.segment.tracks import Tracks, roles_of, tracks_of
from demoplan.stages.segment.trees import Trees, over_columns, probabilities
from demoplan.tables import Activities, Facts, Frames


@dataclass(frozen=True, kw_only=True)
class Reason:
    """Why one activity is what it is."""

    episode_id: str
    hand: str
    start_ns: int
    activity: str
    text: str


def explain(
    frames: dy.DataFrame[Frames],
    facts: dy.DataFrame[Facts],
    activities: dy.DataFrame[Activities],
    entities: Mapping[str, str],
    types: TypeHierarchy,
    segmenter: Segmenter | RuleTree = RULES,
    *,
    params: SegmentParams = SegmentParams(),
) -> tuple[Reason, ...]:
    """Say for every activity what was seen at its middle, and how that decides.

    Args:
        frames: The frames that the activities were found in.
        facts: The facts that they were found with.
        activities: What ``segment`` gave.
        entities: Instance → type.
        types: Hierarchy of types.
        segmenter: What ``segment`` was called with.
        params: What ``segment`` was called with.

    Returns:
        A reason for each activity whose hand is in the frames, sorted by episode, hand and start. A rule
        tree's names what was moving, held and acted on; a single tree's the conditions on the path to its
        leaf, each feature with its value; an ensemble's the probability that it gives. Where the middle
        alone would have another name, the reason says so: the sequence decided.
    """
    found: list[Reason] = []
    for tracks in tracks_of(frames, facts, roles_of(entities, types), params.motion):
        rows = activities.filter(pl.col("episode_id") == tracks.episode_id)
        rows = rows.filter(pl.col("hand").is_in(list(tracks.hands))).sort("hand", "start_ns")
        if rows.is_empty():
            continue
        hands = np.array([tracks.hands.index(hand) for hand in rows["hand"]])
        middles = (rows["start_ns"] + (rows["end_ns"] - rows["start_ns"]) // 2).to_numpy()
        ticks = np.clip(np.searchsorted(tracks.tick_ns, middles, side="right") - 1, 0, None)
        if isinstance(segmenter, RuleTree):
            texts = _by_rules(tracks, hands, ticks, rows["activity"].to_list(), segmenter, entities, types)
        else:
            texts = _by_model(tracks, hands, ticks, rows["activity"].to_list(), segmenter)
        found += [
            Reason(
                episode_id=tracks.episode_id,
                hand=row["hand"],
                start_ns=row["start_ns"],
                activity=row["activity"],
                text=text,
            )
            for row, text in zip(rows.iter_rows(named=True), texts, strict=True)
        ]
    return tuple(sorted(found, key=lambda reason: (reason.episode_id, reason.hand, reason.start_ns)))


def _by_rules(
    tracks: Tracks,
    hands: NDArray[np.int64],
    ticks: NDArray[np.int64],
    activities: list[str],
    tree: RuleTree,
    entities: Mapping[str, str],
    types: TypeHierarchy,
) -> list[str]:
    """What each hand did at each tick, in the words of the rules."""
    instant = RuleTree(granular=tree.granular, has_memory=PUBLISHED_RULES.has_memory)
    names, classes = classify_by_rules(tracks, instant, entities, types)
    things = [*tracks.objects, *tracks.surfaces]
    texts = []
    for hand, tick, activity in zip(hands, ticks, activities, strict=True):
        held = [tracks.objects[k] for k in np.flatnonzero(tracks.in_hand[hand, :, tick])]
        acted = [things[k] for k in np.flatnonzero(tracks.acted_on[hand, :, tick]) if things[k] not in held]
        text = (
            f"{'moving' if tracks.is_moving[hand, tick] else 'at rest'}, "
            f"holds {', '.join(held) or 'nothing'}, acts on {', '.join(acted) or 'nothing'}"
        )
        alone = names[int(classes[hand, tick])]
        if alone != activity:
            text += f"; that alone is {alone}, what comes before and after makes it {activity}"
        texts.append(text)
    return texts


def _by_model(
    tracks: Tracks,
    hands: NDArray[np.int64],
    ticks: NDArray[np.int64],
    activities: list[str],
    segmenter: Segmenter,
) -> list[str]:
    """The probability of each activity at each tick, and for a single tree the way to it."""
    features = features_of(tracks, segmenter.feature_params, segmenter.features_used)
    known = {name: k for k, name in enumerate(segmenter.feature_names)}
    trees = over_columns(segmenter.trees, [known[name] for name in features.names])
    rows = np.ascontiguousarray(features.values[hands, ticks])
    shares = probabilities(trees, rows)
    texts = []
    for row, share, activity in zip(rows, shares, activities, strict=True):
        alone = segmenter.activities[int(share.argmax())]
        own = share[segmenter.activities.index(activity)] if activity in segmenter.activities else 0.0
        text = f"probability {own:.2f}"
        if len(trees.root) == 1:
            text = f"{', '.join(_path(trees, row, features.names)) or 'always'}: {text}"
        else:
            text += f" over {len(trees.root)} trees"
        if alone != activity:
            text += f"; that alone is {alone}, the whole sequence makes it {activity}"
        texts.append(text)
    return texts


def _path(trees: Trees, row: NDArray[np.float32], names: tuple[str, ...]) -> list[str]:
    """The conditions on the way to a row's leaf; of several about one feature, the narrowest each way."""
    node = int(trees.root[0])
    low: dict[int, float] = {}
    high: dict[int, float] = {}
    while trees.feature[node] >= 0:
        feature, threshold = int(trees.feature[node]), float(trees.threshold[node])
        if row[feature] <= threshold:
            high[feature] = min(threshold, high.get(feature, np.inf))
            node = int(trees.left[node])
        else:
            low[feature] = max(threshold, low.get(feature, -np.inf))
            node = int(trees.right[node])
    conditions = []
    for feature in dict.fromkeys((*low, *high)):
        left = f"{low[feature]:.3g} < " if feature in low else ""
        right = f" ≤ {high[feature]:.3g}" if feature in high else ""
        conditions.append(f"{left}{names[feature]} {row[feature]:.3g}{right}")
    return conditions
