"""What is perceived part by part, some ticks at a time, is what is perceived at once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.errors import DataError
from demoplan.language.domains import Signature
from demoplan.language.vocabulary import PredicateRule
from demoplan.logs import read
from demoplan.manifests.mapping import Entity
from demoplan.manifests.vocabulary import parse_vocabulary
from demoplan.pipeline.datasets import open_dataset
from demoplan.stages.align import align
from demoplan.stages.perceive import DEFINITIONS, perceive, perceive_parts
from demoplan.tables import Facts, Frames

ROOT = Path(__file__).resolve().parents[3]
TABLETOP = parse_vocabulary((ROOT / "schemas/vocabularies/tabletop.yaml").read_text(), "tabletop.yaml")
TICK_NS = 10_000_000

FURTHER = {
    "beside": {"enter_m": 0.05, "exit_m": 0.04, "direction_rad": 3.0, "half_angle_rad": 0.8, "reach_m": 0.2},
    "above": {"enter_m": 0.02, "exit_m": 0.01, "footprint_margin_m": 0.0},
    "centred": {"enter_m": 0.02, "exit_m": 0.04},
    "near": {"enter_m": 0.05, "exit_m": 0.08, "min_true_s": 0.05, "min_false_s": 0.08},
    "inside": {"enter_m": 0.0, "exit_m": -0.02},
    "upright": {"enter_rad": 0.4, "exit_rad": 0.6},
    "moving": {"enter_m_per_s": 0.3, "exit_m_per_s": 0.2},
}
EVERYTHING = replace(
    TABLETOP,
    predicates=(
        *TABLETOP.predicates,
        *(
            PredicateRule(
                Signature(f"x_{name}", ("Cube",) * DEFINITIONS[name].arity),
                name,
                tuple(sorted(numbers.items())),
            )
            for name, numbers in FURTHER.items()
        ),
    ),
)
ENTITIES = {
    name: Entity.model_validate({"type": kind})
    for name, kind in {
        "a": "Cube",
        "b": "Cube",
        "c": "Cube",
        "g": "Hand",
        "h": "Hand",
        "table": "Table",
    }.items()
}


def wander(rng, n):
    """A slow walk that now and then rests, about a place over the table."""
    steps = rng.normal(0, 0.004, (n, 3)) * np.repeat(rng.random(n // 20 + 1) < 0.6, 20)[:n, None]
    return np.cumsum(steps, axis=0) + rng.uniform([-0.04, -0.04, 0.02], [0.04, 0.04, 0.08])


@st.composite
def episodes(draw):
    """Two hands, one with a grip signal or none, three cubes, of which one may ride along; gaps in any track."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(30, 700))
    places = {name: wander(rng, n) for name in ("a", "b", "c", "g", "h")}
    if draw(st.booleans()):
        carried = slice(n // 4, n // 2)
        places["a"][carried] = places["h"][carried] + (0.0, 0.0, -0.03)
    if draw(st.booleans()):
        for place in places.values():
            start = int(rng.integers(n))
            place[start : start + int(rng.integers(60))] = np.nan
    places["table"] = np.zeros((n, 3))
    grips = {"h": np.clip(np.cumsum(rng.normal(0, 0.1, n)) + 0.5, 0, 1)} if draw(st.booleans()) else {}
    rows = []
    for name, place in places.items():
        turn = rng.normal(size=4) + rng.normal(0, 0.02, (n, 4))
        seen = pl.Series(np.isfinite(place).all(axis=1))
        grip = grips.get(name)
        rows.append(
            pl.DataFrame(
                {
                    "episode_id": ["e"] * n,
                    "entity": [name] * n,
                    "tick_ns": np.arange(n) * TICK_NS,
                    "position_xyz_m": place,
                    "orientation_wxyz": turn / np.linalg.norm(turn, axis=1, keepdims=True),
                    "grip": pl.Series(grip if grip is not None else [None] * n, dtype=pl.Float64),
                    "pose_age_ns": np.full(n, 0 if name == "table" else 1),
                }
            ).with_columns(pl.when(seen).then(pl.col("position_xyz_m", "orientation_wxyz", "pose_age_ns")))
        )
    return Frames.validate(pl.concat(rows), cast=True)


def in_parts(frames, n_rows):
    return (Frames.validate(part) for part in frames.iter_slices(n_rows))


@settings(max_examples=20, deadline=None)
@given(episodes(), st.integers(50, 500), st.integers(20, 300))
def test_parts_and_windows_of_any_size_give_the_same_facts(frames, n_rows, ticks_at_once):
    expected = perceive(frames, ENTITIES, EVERYTHING)
    parts = in_parts(frames, n_rows)
    assert perceive_parts(parts, ENTITIES, EVERYTHING, ticks_at_once=ticks_at_once).equals(expected)


def test_the_shipped_episodes_give_the_same_facts():
    opened = open_dataset(ROOT / "datasets" / "cube-stacking")
    for episode in opened.dataset.episodes:
        mapping = opened.dataset.mapping
        frames = align(read(opened.log_of(episode), mapping, episode.id).samples, mapping)
        found = perceive_parts(in_parts(frames, 5000), mapping.entities, opened.vocabulary, ticks_at_once=333)
        assert found.equals(perceive(frames, mapping.entities, opened.vocabulary))


def test_no_parts_give_no_facts_and_parts_of_two_episodes_are_refused():
    assert perceive_parts([Frames.create_empty()], ENTITIES, TABLETOP).equals(Facts.create_empty())
    one = Frames.validate(
        pl.DataFrame({"episode_id": ["e"], "entity": ["a"], "tick_ns": [0]}).with_columns(
            pl.lit(None, dtype=dtype).alias(name)
            for name, dtype in Frames.create_empty().schema.items()
            if name not in Frames.primary_key()
        ),
        cast=True,
    )
    with pytest.raises(DataError, match=r"several episodes .* e, f"):
        perceive_parts([one, one.with_columns(episode_id=pl.lit("f"))], ENTITIES, TABLETOP)
