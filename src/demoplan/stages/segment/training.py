"""Training a segmenter on labelled episodes, and trying it on episodes that it has not seen."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from importlib.metadata import version
from typing import Literal, TypeAlias

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan import __version__
from demoplan.errors import DataError
from demoplan.ids import ContentHash, content_hash
from demoplan.language.types import TypeHierarchy
from demoplan.stages.segment.decoding import grammar_of, runs_of
from demoplan.stages.segment.features import FeatureParams, features_of
from demoplan.stages.segment.model import Segmenter
from demoplan.stages.segment.segmentation import SegmentParams, segment
from demoplan.stages.segment.tracks import Tracks, roles_of, tracks_of
from demoplan.tables import Activities, Facts, Frames


@dataclass(frozen=True, kw_only=True)
class TrainParams:
    """What can be chosen about training."""

    method: Literal[
        "decision_tree", "distilled_tree", "random_forest", "extra_trees", "gradient_boosting"
    ] = "decision_tree"
    features: FeatureParams = field(default_factory=FeatureParams)
    segmentation: SegmentParams = field(default_factory=SegmentParams)
    """How held-out episodes are segmented; in training only its thresholds of motion count."""
    sample_every_s: float = 0.04
    """One tick in this time is a training example [s]: neighbours repeat each other."""
    min_leaf_s: float = 0.3
    """Every leaf holds at least this much of the demonstrations [s]."""
    max_leaves: int | None = None
    """Leaves of one tree; null: as many as ``min_leaf_s`` allows."""
    n_trees: int = 100
    """Trees of an ensemble."""
    grammar_prior: float = 0.5
    """Pseudo-count of each change of activity that was never shown."""
    n_variations: int = 6
    """Copies of each episode at other tempos, sizes and marker places, besides itself."""
    tempo_spread: float = 0.4
    """Copies are up to this much slower or faster."""
    size_spread: float = 0.2
    """Copies have all distances up to this much larger or smaller."""
    marker_spread_m: float = 0.05
    """Copies have the hand's marker displaced by this much in each axis [m] (standard deviation)."""
    seed: int = 0


def train(
    frames: dy.DataFrame[Frames],
    facts: dy.DataFrame[Facts],
    truth: dy.DataFrame[Activities],
    entities: Mapping[str, str],
    types: TypeHierarchy,
    *,
    params: TrainParams = TrainParams(),
) -> Segmenter:
    """A segmenter fitted to every labelled episode.

    Args:
        frames: Poses and grips of the episodes.
        facts: Atoms of the same episodes.
        truth: True activities; ticks that they do not cover are not learned from.
        entities: Instance → type.
        types: Hierarchy of types.
        params: Training choices. The same data, parameters and versions give the same segmenter.

    Raises:
        DataError: If no labelled tick is found, or only one activity.
        UnknownNameError: If the method is not known.
    """
    examples = _examples(frames, facts, truth, entities, types, params=params)
    return _fit(examples, _hash_of(frames, facts, truth), params)


def segment_held_out(
    frames: dy.DataFrame[Frames],
    facts: dy.DataFrame[Facts],
    truth: dy.DataFrame[Activities],
    entities: Mapping[str, str],
    types: TypeHierarchy,
    *,
    groups: Mapping[str, str],
    params: TrainParams = TrainParams(),
) -> dy.DataFrame[Activities]:
    """Activities of every episode, each by a segmenter that was trained without the episode's group.

    Args:
        frames: Poses and grips of the episodes.
        facts: Atoms of the same episodes.
        truth: True activities.
        entities: Instance → type.
        types: Hierarchy of types.
        groups: Episode → group that is left out together: its participant, or the episode itself.
        params: Training choices.

    Raises:
        DataError: If there are fewer than two groups, or an episode has none.
    """
    examples = _examples(frames, facts, truth, entities, types, params=params)
    without = sorted(e.episode_id for e in examples if e.episode_id not in groups)
    if without:
        raise DataError(f"no group is given for episodes {without}; every labelled episode needs one")
    names = sorted({groups[example.episode_id] for example in examples})
    if len(names) < 2:
        raise DataError(
            f"leaving one group out needs two groups of labelled episodes at least; found {names}"
        )
    found = []
    for name in names:
        kept = [example for example in examples if groups[example.episode_id] != name]
        left_out = pl.col("episode_id").is_in([e for e, group in groups.items() if group == name])
        segmenter = _fit(kept, ContentHash(""), params)
        found.append(
            segment(
                Frames.cast(frames.filter(left_out)),
                Facts.cast(facts.filter(left_out)),
                entities,
                types,
                segmenter,
                params=params.segmentation,
            )
        )
    return Activities.validate(pl.concat(found).sort("episode_id", "hand", "start_ns"))


_Sequence: TypeAlias = tuple[tuple[str, float], ...]
"""Activity and duration [s] of segments, in order."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Examples:
    """What one episode has to teach."""

    episode_id: str
    feature_names: tuple[str, ...]
    values: NDArray[np.float32]
    """``(examples, features)``."""
    activities: NDArray[np.str_]
    """``(examples,)``."""
    sequences: tuple[_Sequence, ...]
    """Labelled segments of each hand, in order."""


def _examples(
    frames: dy.DataFrame[Frames],
    facts: dy.DataFrame[Facts],
    truth: dy.DataFrame[Activities],
    entities: Mapping[str, str],
    types: TypeHierarchy,
    *,
    params: TrainParams,
) -> list[_Examples]:
    labels_of = {key[0]: group for key, group in truth.group_by("episode_id")}
    labelled = pl.col("episode_id").is_in(list(labels_of))
    found = []
    for index, tracks in enumerate(
        tracks_of(
            Frames.cast(frames.filter(labelled)),
            Facts.cast(facts.filter(labelled)),
            roles_of(entities, types),
            params.segmentation.motion,
        )
    ):
        names, sequences = _labels(tracks, labels_of[tracks.episode_id])
        # Seeds depend on the episode alone, so that leaving others out does not change its copies.
        rng = np.random.default_rng([params.seed, index])
        variants = [tracks, *(_varied(tracks, params, rng) for _ in range(params.n_variations))]
        stride = max(1, round(params.sample_every_s / tracks.tick_s))
        values, activities = [], []
        feature_names: tuple[str, ...] = ()
        for number, variant in enumerate(variants):
            features = features_of(variant, params.features)
            feature_names = features.names
            phase = number % stride
            chosen = names[:, phase::stride]
            known = chosen != ""
            values.append(features.values[:, phase::stride][known])
            activities.append(chosen[known])
        found.append(
            _Examples(
                episode_id=tracks.episode_id,
                feature_names=feature_names,
                values=np.concatenate(values),
                activities=np.concatenate(activities),
                sequences=sequences,
            )
        )
    return found


def _labels(tracks: Tracks, truth: pl.DataFrame) -> tuple[NDArray[np.str_], tuple[_Sequence, ...]]:
    """The true activity of each hand at each tick ``(h, t)``, empty where there is none; and their order."""
    names = []
    sequences = []
    for hand in tracks.hands:
        rows = truth.filter(pl.col("hand") == hand).sort("start_ns")
        if not rows.height:
            names.append(np.full(len(tracks.tick_ns), "", dtype=object))
            continue
        activity = np.asarray(rows.get_column("activity").to_list(), dtype=object)
        found = np.searchsorted(rows.get_column("start_ns").to_numpy(), tracks.tick_ns, side="right") - 1
        covered = (found >= 0) & (tracks.tick_ns < rows.get_column("end_ns").to_numpy()[np.maximum(found, 0)])
        names.append(np.where(covered, activity[np.maximum(found, 0)], ""))
        starts, _ = runs_of(np.unique(names[-1], return_inverse=True)[1])
        ends = np.append(starts[1:], len(names[-1]))
        seen = [(str(names[-1][a]), (b - a) * tracks.tick_s) for a, b in zip(starts, ends, strict=True)]
        sequences.append(tuple((name, duration_s) for name, duration_s in seen if name))
    labelled = tuple(sequence for sequence in sequences if sequence)
    return np.asarray(names).astype(str).reshape(len(tracks.hands), -1), labelled


def _varied(tracks: Tracks, params: TrainParams, rng: np.random.Generator) -> Tracks:
    """The same demonstration as somebody else might give it: another tempo, another arm, another marker.

    Mirror images and turns about the vertical need no copies: features do not change under them.
    """
    tempo = float(np.exp(rng.uniform(-1.0, 1.0) * np.log1p(params.tempo_spread)))
    size = float(np.exp(rng.uniform(-1.0, 1.0) * np.log1p(params.size_spread)))
    shift_m = rng.normal(0.0, params.marker_spread_m, size=(len(tracks.hands), 1, 3))
    clock = tracks.tick_ns - tracks.tick_ns[0]
    return replace(
        tracks,
        tick_ns=tracks.tick_ns[0] + np.round(clock * tempo).astype(np.int64),
        hand_position_m=tracks.hand_position_m * size + shift_m,
        object_position_m=tracks.object_position_m * size,
    )


def _fit(examples: list[_Examples], training_hash: ContentHash, params: TrainParams) -> Segmenter:
    if not examples or not sum(len(example.values) for example in examples):
        raise DataError("no labelled ticks: training needs frames and true activities of the same episodes")
    names, target = np.unique(np.concatenate([e.activities for e in examples]), return_inverse=True)
    if len(names) < 2:
        raise DataError(f"only one activity is labelled: {names[0]!r}; training needs two at least")
    values = np.concatenate([example.values for example in examples])
    # Every activity counts alike, however long it lasts.
    weight = (len(target) / (len(names) * np.bincount(target)))[target]
    n_least = max(1, round(params.min_leaf_s / params.sample_every_s * (1 + params.n_variations)))
    # scikit-learn takes a second to load: only training waits for it.
    from demoplan.stages.segment import fitting  # noqa: PLC0415

    code = {name: index for index, name in enumerate(names.tolist())}
    tracks = [track for example in examples for track in example.sequences]
    sequences = [np.asarray([code[name] for name, _ in track]) for track in tracks]
    durations_s = [np.asarray([duration_s for _, duration_s in track]) for track in tracks]
    return Segmenter(
        method=params.method,
        activities=tuple(names.tolist()),
        feature_names=examples[0].feature_names,
        feature_params=params.features,
        trees=fitting.fitted(
            values,
            target,
            weight,
            method=params.method,
            n_least=n_least,
            max_leaves=params.max_leaves,
            n_trees=params.n_trees,
            seed=params.seed,
        ),
        grammar=grammar_of(sequences, durations_s, len(names), params.grammar_prior),
        training_hash=training_hash,
        training_episodes=tuple(example.episode_id for example in examples),
        options=tuple(
            (option.name, str(getattr(params, option.name)))
            for option in sorted(fields(params), key=lambda option: option.name)
            if option.name not in ("features", "segmentation", "method")
        ),
        versions=(
            ("demoplan", __version__),
            ("numpy", np.__version__),
            ("scikit-learn", version("scikit-learn")),
        ),
    )


def _hash_of(
    frames: dy.DataFrame[Frames], facts: dy.DataFrame[Facts], truth: dy.DataFrame[Activities]
) -> ContentHash:
    """Hash of what was trained on, whatever the order of its rows."""
    ordered = (
        frames.sort("episode_id", "entity", "tick_ns"),
        facts.sort("episode_id", "predicate", pl.col("arguments").list.join(","), "start_ns"),
        truth.sort("episode_id", "hand", "start_ns"),
    )
    # Written in one chunk: how a table was put together is not its content.
    parts = (table.rechunk().write_ipc(None, compression="uncompressed").getvalue() for table in ordered)
    return content_hash(*parts)
