"""Features are of what is done, not of where, when, by whom, with which rig."""

import numpy as np
import polars as pl
import pytest

from demoplan.stages.segment import windows
from demoplan.stages.segment.features import FeatureParams, feature_names, features_of
from demoplan.stages.segment.tracks import roles_of, tracks_of
from demoplan.tables import Frames


def features(d, **changes):
    frames = d.frames.with_columns(**changes) if changes else d.frames
    (tracks,) = tracks_of(Frames.cast(frames), d.facts, roles_of(d.entities, d.types))
    return features_of(tracks)


def moved(d, transform):
    place = d.frames.get_column("position_xyz_m").to_numpy()
    return pl.Series("position_xyz_m", transform(place).tolist(), dtype=d.frames.schema["position_xyz_m"])


@pytest.mark.parametrize(
    "transform",
    [
        lambda p: p + np.array([3.0, -2.0, 0.9]),
        lambda p: p @ np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]),
        lambda p: p * [-1.0, 1.0, 1.0],
    ],
    ids=["elsewhere", "turned", "mirrored"],
)
def test_features_do_not_change_with_the_place_the_heading_or_the_side(demonstrate, transform):
    d = demonstrate()
    here, there = features(d), features(d, position_xyz_m=moved(d, transform))
    np.testing.assert_allclose(there.values, here.values, atol=2e-3)


def test_features_do_not_change_with_names(demonstrate):
    d = demonstrate()
    rename = {"cube": "thing", "bowl": "other", "Right_hand": "Z_hand"}
    renamed = type(d)(**vars(d))
    renamed.frames = Frames.cast(d.frames.with_columns(pl.col("entity").replace(rename)))
    renamed.facts = d.facts.with_columns(
        arguments=pl.col("arguments").list.eval(pl.element().replace(rename))
    )
    renamed.entities = {rename.get(name, name): kind for name, kind in d.entities.items()}
    np.testing.assert_allclose(features(renamed).values, features(d).values, atol=1e-6)


@pytest.mark.parametrize("rate_hz", [60.0, 240.0])
def test_features_at_the_same_time_are_the_same_at_another_rate(demonstrate, rate_hz):
    at_100, at_rate = features(demonstrate(noise_m=0.0)), features(demonstrate(noise_m=0.0, rate_hz=rate_hz))
    for moment_s in (0.5, 1.5, 2.2, 3.2, 5.0, 6.0):
        a = at_100.values[:, round(moment_s * 100)]
        b = at_rate.values[:, round(moment_s * rate_hz)]
        np.testing.assert_allclose(a, b, atol=0.12, rtol=0.1)


@pytest.mark.parametrize("keep", [["Right_hand"], ["Right_hand", "cube"], ["Left_hand", "Right_hand"]])
def test_features_are_finite_whatever_is_missing(demonstrate, keep):
    d = demonstrate()
    frames = Frames.cast(d.frames.filter(pl.col("entity").is_in(keep)).with_columns(grip=None))
    (tracks,) = tracks_of(frames, d.facts, roles_of(d.entities, d.types))
    found = features_of(tracks)
    assert np.isfinite(found.values).all()
    assert found.names == features(d).names


def test_windows_have_the_mean_of_what_lies_in_them():
    rng = np.random.default_rng(0)
    signal = rng.standard_normal((2, 40))
    total = windows.running_total(signal)
    past, future = windows.past_mean(total, 0.5, 0.1), windows.future_mean(total, 0.5, 0.1)
    for tick in range(40):
        np.testing.assert_allclose(past[:, tick], signal[:, max(0, tick - 4) : tick + 1].mean(axis=1))
        np.testing.assert_allclose(future[:, tick], signal[:, tick : tick + 5].mean(axis=1))


def test_differences_are_exact_for_straight_lines_up_to_the_ends():
    line = np.arange(30) * 0.02 * 3.0
    np.testing.assert_allclose(windows.difference(line, 0.2, 0.02), 3.0)


def test_times_to_events_count_from_the_last_and_to_the_next():
    mask = np.array([False, False, True, True, False, False, False, True])
    np.testing.assert_allclose(windows.seconds_since(mask, 9.0, 1.0), [9, 9, 0, 0, 1, 2, 3, 0])
    np.testing.assert_allclose(windows.seconds_until(mask, 9.0, 1.0), [2, 1, 0, 0, 3, 2, 1, 0])
    np.testing.assert_allclose(windows.seconds_until(~mask & False, 9.0, 1.0), [9] * 8)


@pytest.mark.parametrize("keep", [["Right_hand"], ["Left_hand", "Right_hand", "bowl", "cube"]])
def test_a_feature_that_is_asked_for_alone_is_what_it_is_among_all(demonstrate, keep):
    d = demonstrate()
    frames = Frames.cast(d.frames.filter(pl.col("entity").is_in(keep)))
    (tracks,) = tracks_of(frames, d.facts, roles_of(d.entities, d.types))
    every = features_of(tracks)
    assert every.names == feature_names(FeatureParams())
    for index, name in enumerate(every.names):
        alone = features_of(tracks, only=[name])
        assert alone.names == (name,)
        np.testing.assert_array_equal(alone.values[..., 0], every.values[..., index])
