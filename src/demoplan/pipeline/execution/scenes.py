"""Logged instants to scenes: what stood where, put onto a table of the simulator."""

import re

import numpy as np
import polars as pl

from demoplan.engines.mujoco.scene_spec import SceneSpec, Vector, scene_of_poses
from demoplan.errors import DataError, UsageError
from demoplan.pipeline.datasets import recall
from demoplan.store import Store
from demoplan.tables import Frames
from demoplan.viewers.episode_view import Entity
from demoplan.viewers.sources import entities_of

_AT_TIME = re.compile(r"(?P<episode>.+)@(?P<instant>start|end|[0-9]+(?:\.[0-9]+)?)")
_KINDS = {"box": "box", "cylinder": "cylinder", "sphere": "sphere"}
_LOOK_NS = 500_000_000
"""An object that was not seen for so long before the instant is not there [ns]."""


def is_of_an_episode(text: str) -> bool:
    """Whether a state is an instant of an episode, and not a file.

    >>> is_of_an_episode("p1-one-left@start"), is_of_an_episode("towers.json")
    (True, False)
    """
    return _AT_TIME.fullmatch(text) is not None


def scene_of_state(store: Store, text: str) -> SceneSpec:
    """The scene of an episode at an instant.

    Args:
        store: Where the episode is.
        text: ``EPISODE@start``, ``EPISODE@end`` or ``EPISODE@12.5`` (seconds from the first tick).

    Returns:
        Loose objects with their shapes and types, about the middle of the table's top, as a session wants it.

    Raises:
        UsageError: If the text names no instant of an episode.
        DataError: If there is no table, or an object has no extent.
    """
    match = _AT_TIME.fullmatch(text)
    if match is None:
        raise UsageError(f"{text!r} is no instant of an episode; expected EPISODE@start, @end or @SECONDS")
    state = store.manifest.episode(match["episode"])
    if "frames" not in state.tables:
        raise UsageError(f"episode {match['episode']!r} has no poses: {state.reason or 'ingest it again'}")
    frames = store.get(state.tables["frames"], Frames)
    first_ns, last_ns = frames.select(first=pl.col("tick_ns").min(), last=pl.col("tick_ns").max()).row(0)
    instants = {"start": first_ns + _LOOK_NS // 5, "end": last_ns}
    asked = match["instant"]
    instant_ns = instants[asked] if asked in instants else first_ns + round(float(asked) * 1e9)
    if not first_ns <= instant_ns <= last_ns:
        raise UsageError(f"{text}: the episode lasts {(last_ns - first_ns) / 1e9:.2f} s")
    opened = recall(store, state.dataset)
    return _scene(frames, instant_ns, entities_of(opened.dataset.mapping, opened.vocabulary), text)


def _scene(frames: pl.DataFrame, instant_ns: int, entities: tuple[Entity, ...], origin: str) -> SceneSpec:
    seen = (
        frames.filter(
            pl.col("position_xyz_m").is_not_null()
            & pl.col("tick_ns").is_between(instant_ns - _LOOK_NS, instant_ns)
        )
        .sort("tick_ns")
        .group_by("entity", maintain_order=True)
        .last()
    )
    poses = {row["entity"]: row for row in seen.iter_rows(named=True)}
    tables = [each for each in entities if each.is_surface and each.name in poses]
    if not tables:
        raise DataError(f"{origin}: no table was seen, so nothing can be put onto one")
    table = tables[0]
    top = np.asarray(poses[table.name]["position_xyz_m"]) + np.asarray(table.shape.centre_xyz_m)
    top = top + np.array([0.0, 0.0, table.shape.size_xyz_m[2] / 2])
    loose = [each for each in entities if not each.is_hand and not each.is_surface and each.name in poses]
    for each in loose:
        if each.shape.kind not in _KINDS:
            raise DataError(f"{origin}: {each.name} has no extent; give it, or its type, a shape")
    depth, width, _ = table.shape.size_xyz_m
    return scene_of_poses(
        {
            each.name: (
                _three(np.asarray(poses[each.name]["position_xyz_m"]) - top),
                tuple(poses[each.name]["orientation_wxyz"]),
            )
            for each in loose
        },
        {each.name: (each.shape.kind, each.shape.size_xyz_m) for each in loose},  # type: ignore[misc]
        {each.name: each.type_name for each in loose},
        table_size_xyz_m=(float(depth), float(width), 0.04),
        name=re.sub(r"[^A-Za-z0-9._-]+", "-", origin),
    )


def _three(values: np.ndarray) -> Vector:
    return (float(values[0]), float(values[1]), float(values[2]))
