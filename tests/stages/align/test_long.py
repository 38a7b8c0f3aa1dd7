"""An episode aligned part by part has the frames of one that is aligned at once, to the last bit."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.errors import DataError
from demoplan.logs import read
from demoplan.manifests.mapping import Mapping
from demoplan.pipeline.datasets import open_dataset
from demoplan.stages.align import align, align_parts
from demoplan.tables import Frames, Samples

STACKING = Path(__file__).parents[3] / "datasets" / "cube-stacking"
MS = 1_000_000


def stream(rng, *, entity, kind="pose", reference="world", is_static=False):
    """Readings at uneven times, some lost, some repeated, some late; now and then a clock jumps."""
    n = 1 if is_static else int(rng.integers(1, 120))
    stamp = np.cumsum(rng.choice([0, 3, 10, 10, 10, 40, 450], n)) * MS
    log = stamp + rng.integers(0, 4, n) * MS
    if rng.random() < 0.2:
        stamp = stamp + (np.arange(n) > n // 2) * 7_000 * MS
    wxyz = rng.normal(size=(n, 4))
    is_turned = kind == "transform" or (kind == "pose" and rng.random() < 0.9)
    return pl.DataFrame(
        {
            "episode_id": ["e"] * n,
            "topic": [f"/{kind}s"] * n,
            "entity": [entity] * n,
            "kind": [kind] * n,
            "reference": [reference] * n,
            "is_static": [is_static] * n,
            "message_index": np.arange(n),
            "stamp_ns": stamp,
            "log_ns": log,
            "publish_ns": pl.Series([None] * n, dtype=pl.Int64),
            "header_ns": stamp,
            "position_xyz_m": [None] * n if kind == "grip" else rng.normal(size=(n, 3)).tolist(),
            "orientation_wxyz": wxyz.tolist() if is_turned else [None] * n,
            "grip": rng.random(n) if kind == "grip" else pl.Series([None] * n, dtype=pl.Float64),
            "is_tracked": rng.random(n) < 0.95,
        },
        schema=Samples.create_empty().schema,
    )


@st.composite
def logs(draw):
    """Hands with grips, told in the world or in a frame of their rig, cubes, a fixed table, one thing unseen."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rig = draw(st.sampled_from(["world", "rig"]))
    below = draw(st.sampled_from(["world", "rig", "tray"]))
    parts = [
        stream(rng, entity="rig", kind="transform", is_static=draw(st.booleans())),
        stream(rng, entity="tray", kind="transform", reference=draw(st.sampled_from(["world", "rig"]))),
        stream(rng, entity="hand", reference=rig),
        stream(rng, entity="hand", kind="grip"),
        stream(rng, entity="cube_frame", kind="transform", reference=below),
        stream(rng, entity="cube", reference=rig),
    ]
    found = pl.concat(parts)
    if draw(st.booleans()):
        found = found.sample(fraction=1, shuffle=True, seed=int(rng.integers(2**31)))
    fixed = {"position_xyz_m": [0, 0, 0.7]}
    mapping = Mapping.model_validate(
        {
            "world": "world",
            "entities": {
                "hand": {"type": "Hand"},
                "cube": {"type": "Cube"},
                "tray": {"type": "Tray"},
                "lost": {"type": "Cube"},
                "table": {"type": "Table", "fixed": fixed},
            },
            "topics": {"/transforms": {"kind": "transforms", "entities": {"cube_frame": "cube"}}},
        }
    )
    return Samples.validate(found), mapping


def in_parts(samples, n_rows):
    return (Samples.validate(part) for part in samples.iter_slices(n_rows))


@settings(max_examples=25, deadline=None)
@given(logs(), st.integers(20, 200), st.integers(50, 900))
def test_parts_of_any_size_give_the_same_frames(log, n_rows, ticks_at_once):
    samples, mapping = log
    try:
        expected = align(samples, mapping)
    except DataError as error:
        with pytest.raises(DataError) as found:
            list(align_parts(in_parts(samples, n_rows), mapping, ticks_at_once=ticks_at_once))
        assert str(found.value) == str(error)
        return
    found = pl.concat(list(align_parts(in_parts(samples, n_rows), mapping, ticks_at_once=ticks_at_once)))
    assert found.equals(expected)


def test_the_shipped_episodes_come_out_the_same():
    opened = open_dataset(STACKING)
    for episode in opened.dataset.episodes:
        mapping = opened.dataset.mapping
        samples = read(opened.log_of(episode), mapping, episode.id).samples
        found = pl.concat(list(align_parts(in_parts(samples, 5000), mapping, ticks_at_once=333)))
        assert found.equals(align(samples, mapping))


def test_no_parts_give_no_frames_and_parts_of_two_episodes_are_refused():
    mapping = Mapping.model_validate({"world": "world", "entities": {"cube": {"type": "Cube"}}, "topics": {}})
    assert list(align_parts([], mapping)) == []
    assert list(align_parts([Samples.create_empty()], mapping)) == []
    one = stream(np.random.default_rng(0), entity="cube")
    both = [Samples.validate(part) for part in (one, one.with_columns(episode_id=pl.lit("f")))]
    with pytest.raises(DataError, match=r"several episodes .* e, f"):
        list(align_parts(both, mapping))
    assert Frames.is_valid(align(both[0], mapping))
