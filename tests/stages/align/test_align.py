import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from demoplan.errors import DataError
from demoplan.manifests.mapping import Mapping
from demoplan.stages.align import AlignParams, align
from demoplan.tables import Samples

MS = 1_000_000
TURN = (1.0, 0.0, 0.0, 0.0)


def numbers(values):
    """Samples hold null for what is not a number."""
    return [[None if np.isnan(x) else float(x) for x in row] for row in np.asarray(values, float)]


def rows(
    stamps_ms,
    positions=None,
    *,
    entity="cube",
    orientations=None,
    kind="pose",
    reference="world",
    static=False,
    topic="/poses",
    tracked=True,
    grip=None,
    log_ms=None,
):
    n = len(stamps_ms)
    stamps = np.round(np.asarray(stamps_ms, float) * MS).astype(np.int64)
    log = stamps if log_ms is None else np.round(np.asarray(log_ms, float) * MS).astype(np.int64)
    if positions is None and kind != "grip":
        positions = np.zeros((n, 3))
    return pl.DataFrame(
        {
            "episode_id": ["e"] * n,
            "topic": [topic] * n,
            "entity": [entity] * n,
            "kind": [kind] * n,
            "reference": [reference] * n,
            "is_static": [static] * n,
            "message_index": np.arange(n),
            "stamp_ns": stamps,
            "log_ns": log,
            "publish_ns": pl.Series([None] * n, dtype=pl.Int64),
            "header_ns": stamps,
            "position_xyz_m": [None] * n if kind == "grip" else numbers(positions),
            "orientation_wxyz": [None] * n
            if kind == "grip"
            else np.asarray([TURN] * n if orientations is None else orientations, float).tolist(),
            "grip": [None] * n if grip is None else list(map(float, grip)),
            "is_tracked": [tracked] * n if isinstance(tracked, bool) else list(tracked),
        },
        schema_overrides={
            "position_xyz_m": pl.Array(pl.Float64, 3),
            "orientation_wxyz": pl.Array(pl.Float64, 4),
            "grip": pl.Float64,
        },
    )


def samples(*parts):
    return Samples.validate(pl.concat(parts), cast=True)


def mapping(*entities, world="world", topics=None, **fixed):
    listed = {name: {"type": "Cube"} for name in entities}
    listed |= {name: {"type": "Table", "fixed": {"position_xyz_m": place}} for name, place in fixed.items()}
    return Mapping.model_validate({"world": world, "entities": listed, "topics": topics or {}})


def track(frames, entity="cube"):
    mine = frames.filter(pl.col("entity") == entity)
    return mine["tick_ns"].to_numpy() / MS, mine["position_xyz_m"].to_numpy()


def test_positions_lie_on_the_line_and_orientations_on_the_arc_between_readings():
    ends = Rotation.from_euler("z", [[0], [90]], degrees=True)
    turns = ends.as_quat(scalar_first=True)
    turns[1] *= -1  # the same orientation
    frames = align(samples(rows([0, 40], [[0, 0, 0], [4, 0, 8]], orientations=turns)), mapping("cube"))
    assert frames["tick_ns"].to_list() == [0, 10 * MS, 20 * MS, 30 * MS, 40 * MS]
    np.testing.assert_allclose(track(frames)[1][:, 0], [0, 1, 2, 3, 4])
    expected = Slerp([0, 40], ends)([0, 10, 20, 30, 40]).as_quat(scalar_first=True)
    np.testing.assert_allclose(frames["orientation_wxyz"].to_numpy(), expected, atol=1e-12)
    assert frames["pose_age_ns"].to_list() == [0, 10 * MS, 20 * MS, 10 * MS, 0]


def test_beyond_the_staleness_limit_a_pose_is_null_and_a_long_gap_is_not_bridged():
    frames = align(
        samples(rows([0, 10, 410, 420], [[0, 0, 0], [1, 0, 0], [9, 0, 0], [9, 0, 0]])), mapping("cube")
    )
    times, place = track(frames)
    known = times[np.isfinite(place[:, 0])]
    assert known.tolist() == [*range(0, 111, 10), *range(310, 421, 10)]
    held = place[(times > 10) & (times <= 110), 0]
    assert (held == 1).all()  # held, not smeared towards 9
    assert frames.filter(pl.col("position_xyz_m").is_null())["pose_age_ns"].is_null().all()


def test_readings_that_mean_nothing_are_dropped():
    positions = [[0, 0, 0], [np.nan, 0, 0], [77, 0, 0], [88, 0, 0], [4, 0, 0]]
    turns = [TURN, TURN, (0, 0, 0, 0), TURN, (2.0, 0, 0, 0)]
    frames = align(
        samples(
            rows([0, 10, 20, 30, 40], positions, orientations=turns, tracked=[True, True, True, False, True])
        ),
        mapping("cube"),
    )
    np.testing.assert_allclose(track(frames)[1][:, 0], [0, 1, 2, 3, 4])
    np.testing.assert_allclose(np.linalg.norm(frames["orientation_wxyz"].to_numpy(), axis=1), 1.0)


def test_stamps_are_sorted_and_of_repeated_ones_the_first_message_counts():
    frames = align(
        samples(rows([0, 20, 10, 10, 30], [[0, 0, 0], [2, 0, 0], [1, 0, 0], [99, 0, 0], [3, 0, 0]])),
        mapping("cube"),
    )
    np.testing.assert_allclose(track(frames)[1][:, 0], [0, 1, 2, 3])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_rows_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    stamps = np.sort(rng.integers(0, 800, 40)) + rng.integers(-15, 15, 40)
    given_rows = pl.concat(
        [
            rows(stamps, rng.normal(size=(40, 3)), orientations=rng.normal(size=(40, 4))),
            rows(
                stamps,
                rng.normal(size=(40, 3)),
                topic="/tf",
                kind="transform",
                entity="hand",
                reference="base",
            ),
            rows(np.arange(0, 800, 20), entity="base", kind="transform", topic="/tf"),
            rows(stamps, kind="grip", entity="hand", topic="/grip", grip=rng.uniform(size=40)),
        ]
    )
    # One body twice in one message.
    twice = given_rows.with_columns(message_index=pl.col("message_index") // 2)
    expected = align(samples(twice), mapping("cube", "hand"))
    shuffled = twice.sample(fraction=1.0, shuffle=True, seed=seed % 1000)
    assert align(samples(shuffled), mapping("cube", "hand")).equals(expected)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.integers(1, 300), min_size=1, max_size=30),
    st.floats(5, 200),
    st.integers(-(10**12), 10**12),
)
def test_every_entity_has_every_tick_at_whole_periods_from_the_first_stamp(steps, rate, start):
    stamps = start / MS + np.cumsum(steps)
    frames = align(
        samples(rows(stamps)), mapping("cube", "ghost", table=(0, 0, 0)), AlignParams(tick_rate_hz=rate)
    )
    ticks = frames.filter(pl.col("entity") == "cube")["tick_ns"].to_numpy()
    first, last = round(stamps[0] * MS), round(stamps[-1] * MS)
    period = round(1e9 / rate)
    assert ticks.tolist() == list(range(first, last + 1, period))
    for entity in ("ghost", "table"):
        assert frames.filter(pl.col("entity") == entity)["tick_ns"].to_numpy().tolist() == ticks.tolist()
    assert frames.filter(pl.col("entity") == "ghost")["position_xyz_m"].is_null().all()
    assert (frames.filter(pl.col("entity") == "table")["pose_age_ns"] == 0).all()


def test_transforms_are_chained_to_the_world_and_static_ones_hold_throughout():
    quarter = Rotation.from_euler("z", 90, degrees=True).as_quat(scalar_first=True)
    frames = align(
        samples(
            rows(
                [0],
                [[1, 0, 0]],
                orientations=[quarter],
                kind="transform",
                entity="base",
                static=True,
                topic="/tf_static",
            ),
            rows(
                [0, 500, 1000],
                [[1, 0, 0], [1.5, 0, 0], [2, 0, 0]],
                kind="transform",
                entity="cube_link",
                reference="/base",
                topic="/tf",
            ),
        ),
        mapping("cube", topics={"/tf": {"kind": "transforms", "entities": {"cube_link": "cube"}}}),
        AlignParams(tick_rate_hz=2, staleness_ns=300 * MS),
    )
    np.testing.assert_allclose(track(frames)[1], [[1, 1, 0], [1, 1.5, 0], [1, 2, 0]], atol=1e-12)


def test_a_world_that_is_itself_below_the_root_is_reached_against_the_transforms():
    frames = align(
        samples(
            rows([0, 10], [[0, 0, 1]] * 2, kind="transform", entity="table", reference="map", topic="/tf"),
            rows([0, 10], [[5, 0, 1.5]] * 2, kind="transform", entity="cube", reference="map", topic="/tf"),
        ),
        mapping("cube", world="table"),
    )
    np.testing.assert_allclose(track(frames)[1], [[5, 0, 0.5]] * 2)


def test_a_frame_that_is_handed_over_follows_the_parent_seen_last():
    frames = align(
        samples(
            rows([0, 10, 20], [[1, 0, 0]] * 3, kind="transform", entity="hand", topic="/tf"),
            rows([0], [[0, 0, 0]], kind="transform", entity="cube", topic="/tf"),
            rows([20], [[0, 0, 0.5]], kind="transform", entity="cube", reference="hand", topic="/tf"),
        ),
        mapping("cube"),
    )
    place = track(frames)[1]
    np.testing.assert_allclose(place[[0, 2]], [[0, 0, 0], [1, 0, 0.5]])


def test_a_chain_is_as_old_as_its_oldest_link():
    frames = align(
        samples(
            rows([0, 100], kind="transform", entity="base", topic="/tf"),
            rows(np.arange(0, 101, 10), kind="transform", entity="cube", reference="base", topic="/tf"),
        ),
        mapping("cube"),
    )
    assert frames["pose_age_ns"].max() == 50 * MS


def test_frames_that_do_not_hang_together_with_the_world_are_named():
    parts = samples(rows([0, 10], kind="transform", entity="cube", reference="odom", topic="/tf"))
    with pytest.raises(DataError, match=r"world 'world'.*'cube'.*odom → cube"):
        align(parts, mapping("cube"))


def test_transforms_in_a_circle_are_refused_by_name():
    parts = samples(
        rows([0, 10], kind="transform", entity="a", reference="b", topic="/tf"),
        rows([0, 10], kind="transform", entity="b", reference="a", topic="/tf"),
    )
    with pytest.raises(DataError, match="circle through 'a', 'b'"):
        align(parts, mapping("a"))


def test_grip_is_interpolated_and_a_hand_may_have_a_grip_without_a_pose():
    frames = align(
        samples(rows([0, 40], kind="grip", entity="hand", topic="/g", grip=[0, 1])), mapping("hand")
    )
    np.testing.assert_allclose(frames["grip"].to_numpy(), [0, 0.25, 0.5, 0.75, 1])
    assert frames["position_xyz_m"].is_null().all()


def test_a_source_without_orientation_leaves_it_null_beside_the_position():
    part = rows([0, 10], [[1, 2, 3]] * 2).with_columns(
        orientation_wxyz=pl.lit(None, dtype=pl.Array(pl.Float64, 4))
    )
    frames = align(samples(part), mapping("cube"))
    assert frames["orientation_wxyz"].is_null().all()
    np.testing.assert_allclose(track(frames)[1], [[1, 2, 3]] * 2)


def test_no_usable_sample_is_an_error_that_says_so():
    with pytest.raises(DataError, match=r"no usable sample.*of 2 rows \(2 not tracked\)"):
        align(samples(rows([0, 10], tracked=False)), mapping("cube"))


def test_clocks_that_lie_years_apart_are_refused_with_both_topics_named():
    parts = samples(rows([0, 10]), rows([1.7e12, 1.7e12 + 10], entity="hand", topic="/hand"))
    with pytest.raises(DataError, match=r"/poses \(cube\) begins at 0.000 s, /hand \(hand\) ends"):
        align(parts, mapping("cube", "hand"))


def test_several_episodes_are_aligned_each_on_its_own():
    one = rows([0, 10])
    two = rows([1000, 1020]).with_columns(episode_id=pl.lit("f"))
    both = align(samples(two, one), mapping("cube"))
    assert both.equals(
        pl.concat([align(samples(one), mapping("cube")), align(samples(two), mapping("cube"))])
    )
