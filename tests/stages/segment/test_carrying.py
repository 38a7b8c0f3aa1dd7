"""What travels with a hand is carried by it, whether or not a grip tells."""

import numpy as np
import polars as pl

from demoplan.stages.segment.carrying import CarryParams, carried
from demoplan.stages.segment.features import features_of
from demoplan.stages.segment.tracks import roles_of, tracks_of
from demoplan.tables import Facts, Frames

TICK_S = 0.01


def lift_hold_place(pause_s):
    """Height of an object that is lifted, held still and set down, by a hand 10 cm above it."""
    up = np.concatenate([np.zeros(100), np.linspace(0, 0.2, 50), np.full(round(pause_s * 100), 0.2)])
    return np.concatenate([up, np.linspace(0.2, 0, 50), np.zeros(100)])


def found(height, distances):
    speed = np.abs(np.gradient(height, TICK_S))[None]
    return carried(np.asarray(distances)[:, None], speed, height[None], TICK_S, CarryParams())


def test_an_object_is_carried_from_when_it_moves_until_it_rests():
    height = lift_hold_place(0.2)
    mask = found(height, [np.full(len(height), 0.1)])[0, 0]
    moving = np.flatnonzero(mask)
    assert 95 <= moving[0] <= 105
    assert abs(moving[-1] - (len(height) - 100)) <= 5
    assert mask[moving[0] : moving[-1]].all()


def test_a_long_rest_in_the_air_does_not_end_carrying():
    height = lift_hold_place(4.0)
    mask = found(height, [np.full(len(height), 0.1)])[0, 0]
    assert mask[150:550].all()


def test_a_long_rest_on_the_table_ends_it():
    height = np.concatenate([lift_hold_place(0.1), lift_hold_place(0.1)])
    mask = found(height, [np.full(len(height), 0.1)])[0, 0]
    rest = len(height) // 2
    assert not mask[rest - 50 : rest + 50].any()


def test_a_hand_that_passes_by_carries_nothing():
    height = lift_hold_place(0.2)
    here = np.full(len(height), 0.1)
    other = np.linspace(0.6, 0.15, len(height))
    mask = found(height, [here, other])
    assert mask[0].any()
    assert not mask[1].any()


def test_a_far_object_that_moves_is_not_carried():
    height = lift_hold_place(0.2)
    assert not found(height, [np.full(len(height), 0.8)]).any()


def test_nothing_is_carried_where_there_are_no_objects():
    assert carried(np.zeros((2, 0, 5)), np.zeros((0, 5)), np.zeros((0, 5)), TICK_S, CarryParams()).shape == (
        2,
        0,
        5,
    )


def test_carrying_shows_without_grip_or_facts(demonstrate):
    d = demonstrate()
    frames = Frames.cast(d.frames.with_columns(grip=None))
    (tracks,) = tracks_of(frames, Facts.create_empty(), roles_of(d.entities, d.types))
    features = features_of(tracks)
    holding = features.values[tracks.hands.index("Right_hand"), :, features.names.index("is_holding")]
    put = d.truth.filter(pl.col("activity") == "Put").row(0, named=True)
    during = (tracks.tick_ns >= put["start_ns"] + 2e8) & (tracks.tick_ns < put["end_ns"] - 3e8)
    assert holding[during].all()
    assert not holding[tracks.tick_ns < put["start_ns"]].any()
