import numpy as np
import polars as pl
import pytest

from demoplan.errors import LogError, UsageError
from demoplan.logs import read


@pytest.fixture(scope="module")
def log(making, recording, tmp_path_factory):
    return making.to_mcap(tmp_path_factory.mktemp("logs") / "a.mcap", recording)


def hand(**more):
    return {"/hand": {"kind": "pose", "entity": "h", **more}}


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001)])
def test_positions_are_scaled_to_metres(unit, factor, log, making, recording):
    samples = read(log, making.mapping_of(hand(unit=unit)), "e").samples
    values = [v[2] for t, _, _, v in recording.messages if t == "/hand"]
    np.testing.assert_allclose(samples["position_xyz_m"].to_numpy(), np.array(values) * factor, rtol=1e-15)


def test_each_clock_can_be_chosen(log, making):
    for clock in ("header", "publish", "log"):
        samples = read(log, making.mapping_of(hand(clock=clock)), "e").samples
        assert samples["stamp_ns"].equals(samples[f"{clock}_ns"].rename("stamp_ns"))


def test_without_a_header_stamp_the_log_clock_counts_and_a_note_says_so(making, tmp_path):
    recording = making.Recording()
    for i in range(4):
        header_ns = 0 if i < 3 else making.START_NS
        value = (header_ns, "", [0.0, 0, 0], [1.0, 0, 0, 0])
        recording.add("/hand", "geometry_msgs/msg/PoseStamped", making.START_NS + i, value)
        recording.add("/grip", "std_msgs/msg/Float32", making.START_NS + i, 0.5)
    topics = {**hand(), "/grip": {"kind": "grip", "entity": "h"}}
    found = read(making.to_rosbag1(tmp_path / "a.bag", recording), making.mapping_of(topics), "e")
    samples = found.samples.filter(pl.col("topic") == "/hand")
    assert samples["header_ns"].to_list() == [None, None, None, making.START_NS]
    assert samples["stamp_ns"].to_list() == [making.START_NS + i for i in (0, 1, 2)] + [making.START_NS]
    assert set(samples["reference"]) == {"world"}
    notes = dict(found.topics.select("topic", "note").iter_rows())
    assert notes["/hand"] == "3 rows are stamped by the log's clock, since their header stamp is zero"
    assert "no header stamp" in notes["/grip"]


def test_readings_without_a_value_are_kept_but_not_tracked(making, tmp_path):
    nan = float("nan")
    poses = [
        ([0.0, 0, 0], [1.0, 0, 0, 0], True),
        ([nan, 0, 0], [1.0, 0, 0, 0], False),
        ([0.0, 0, 0], [0.0, 0, 0, 0], False),
        ([0.0, 0, 0], [0.0, 0, 0, 2.0], True),
        ([0.0, 0, 0], [0.0, 0, nan, 1.0], False),
        ([0.0, float("inf"), 0], [1.0, 0, 0, 0], False),
    ]
    recording = making.Recording()
    for i, (position, orientation, _) in enumerate(poses):
        time_ns = making.START_NS + i
        recording.add(
            "/hand", "geometry_msgs/msg/PoseStamped", time_ns, (time_ns, "w", position, orientation)
        )
    samples = read(making.to_mcap(tmp_path / "a.mcap", recording), making.mapping_of(hand()), "e").samples
    assert samples["is_tracked"].to_list() == [tracked for *_, tracked in poses]
    assert samples["orientation_wxyz"][3].to_list() == [0.0, 0.0, 0.0, 2.0]


def test_grips_are_mapped_to_opening_and_clipped(log, making):
    topics = {
        "/joy#left": {"kind": "grip", "entity": "l", "field": "axes[1]", "open_at": 0.25, "closed_at": 0.75}
    }
    topics["/joy#right"] = {
        "kind": "grip",
        "entity": "r",
        "field": "axes[2]",
        "open_at": -1.0,
        "closed_at": 1.0,
    }
    samples = read(log, making.mapping_of(topics), "e").samples
    left = samples.filter(pl.col("topic") == "/joy#left")["grip"].to_list()
    assert left[:5] == [1.0, 1.0, 0.5, 0.0, 0.0]
    assert set(samples.filter(pl.col("entity") == "r")["grip"]) == {1.0}


def test_a_list_that_is_too_short_for_an_index_is_counted_not_dropped(making, tmp_path):
    recording = making.Recording()
    for i in range(6):
        recording.add(
            "/joy", "sensor_msgs/msg/Joy", making.START_NS + i, (making.START_NS + i, [1.0] * (i % 3))
        )
    topics = {"/joy": {"kind": "grip", "entity": "h", "field": "axes[1]"}}
    found = read(making.to_mcap(tmp_path / "a.mcap", recording), making.mapping_of(topics), "e")
    (row,) = found.topics.to_dicts()
    assert (row["n_messages"], row["n_rows"], row["n_rejected"]) == (6, 2, 4)
    assert "too short" in row["note"]


def test_transforms_keep_frames_that_no_entity_is_named_for(log, making):
    topics = {"/tf": {"kind": "transforms", "entities": {"cube_red": "Cube_red1"}, "static": True}}
    samples = read(log, making.mapping_of(topics), "e").samples
    assert set(samples["entity"]) == {"cube_red", "cube_blue", "cube_with_a_longer_name"}
    assert samples["is_static"].all()


@pytest.mark.parametrize(
    ("topics", "sentence"),
    [
        ({"/nowhere": {"kind": "transforms"}}, r"no topic /nowhere.*available: /hand, /joy, /tf, /unmapped"),
        (hand(position="pose.place"), r"'pose.place' does not exist; available:.*pose\.position\.x"),
        (hand(position="pose"), r"'pose' is not a record of x, y, z"),
        (hand(position="a b"), r"not a field path"),
        ({"/joy": {"kind": "grip", "entity": "h", "field": "axes"}}, r"'axes' is not a number"),
        ({"/hand": {"kind": "transforms"}}, r"mapped as 'transforms': field 'transforms' does not exist"),
        ({"/joy": {"kind": "bodies", "path": "axes", "entities": {}}}, r"'axes' is no list of records"),
    ],
)
def test_a_mapping_that_does_not_fit_says_what_is_available(topics, sentence, log, making):
    with pytest.raises(LogError, match=sentence):
        read(log, making.mapping_of(topics), "e")


def test_an_optional_topic_that_is_missing_is_listed(log, making):
    found = read(log, making.mapping_of({"/nowhere": {"kind": "transforms", "required": False}}), "e")
    assert found.topics.filter(pl.col("topic") == "/nowhere")["note"].to_list() == [
        "the log has no such topic"
    ]
    assert found.samples.is_empty()


def test_a_grip_that_opens_where_it_closes_is_refused(log, making):
    with pytest.raises(UsageError, match="both 1"):
        read(log, making.mapping_of({"/joy": {"kind": "grip", "entity": "h", "closed_at": 1.0}}), "e")
