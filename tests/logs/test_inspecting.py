import json

import pytest

from demoplan.errors import LogError
from demoplan.logs import InspectParams, inspect

S = 1_000_000_000


def rules(report, subject=None):
    return {finding.rule for finding in report.findings if subject in (None, finding.subject)}


def poses(
    making,
    stamps,
    *,
    position=(0.1, 0.2, 0.3),
    orientation=(1.0, 0, 0, 0),
    header=lambda i, t: t,
    frame="world",
):
    recording = making.Recording()
    for i, time_ns in enumerate(stamps):
        value = (header(i, time_ns), frame, list(position), list(orientation))
        recording.add("/hand", "geometry_msgs/msg/PoseStamped", time_ns, value)
    return recording


def steady(making, n=200):
    return [making.START_NS + i * S // 100 for i in range(n)]


def report_of(making, tmp_path, recording, mapping=None, **params):
    path = making.to_mcap(tmp_path / "a.mcap", recording)
    return inspect(path, mapping, params=InspectParams(**params))


def test_a_sound_log_has_no_finding(making, tmp_path):
    report = report_of(making, tmp_path, poses(making, steady(making)))
    assert report.findings == ()
    (topic,) = report.topics
    assert (topic.n_messages, topic.is_decodable) == (200, True)
    assert topic.rate_hz == pytest.approx(100.0)
    assert topic.largest_gap_s == pytest.approx(0.01)
    assert report.end_ns - report.start_ns == 199 * S // 100


def test_a_gap_is_found_where_it_is(making, tmp_path):
    stamps = [t + (3 * S if i >= 100 else 0) for i, t in enumerate(steady(making))]
    report = report_of(making, tmp_path, poses(making, stamps))
    (finding,) = report.findings
    assert finding.rule == "gap"
    assert "3.01 s" in finding.sentence
    assert str(stamps[99]) in finding.sentence


@pytest.mark.parametrize(
    ("header", "rule"),
    [
        (lambda i, t: t + (2 * S if i >= 100 else 0), "header-clock-jump"),
        (lambda i, t: t - (S // 2 if i >= 100 else 0), "header-clock-backwards"),
        (lambda i, t: 5 * S + i * S // 100, "header-clock-uptime"),
        (lambda i, t: 0, "header-clock-zero"),
        (lambda i, t: t - 60 * S, "header-clock-offset"),
    ],
)
def test_clocks_that_misbehave_are_found(header, rule, making, tmp_path):
    report = report_of(making, tmp_path, poses(making, steady(making), header=header))
    assert rules(report) == {rule}


@pytest.mark.parametrize(
    ("pose", "rule"),
    [
        ({"position": (float("nan"), 0, 0)}, "not-finite"),
        ({"orientation": (0.0, 0, 0, 0)}, "no-rotation"),
        ({"orientation": (2.0, 0, 0, 0)}, "not-unit"),
    ],
)
def test_poses_that_are_none_are_found(pose, rule, making, tmp_path):
    assert rules(report_of(making, tmp_path, poses(making, steady(making), **pose))) == {rule}


def test_the_tree_of_frames_is_checked(making, tmp_path):
    recording = making.Recording()
    edges = [
        ("world", "table"),
        ("/table", "cube"),
        ("hand", "cube"),
        ("camera", "lens"),
        ("x", "y"),
        ("y", "x"),
    ]
    for i, time_ns in enumerate(steady(making, 60)):
        parent, child = edges[i % len(edges)]
        transform = (time_ns, parent, child, [0.0, 0, 0], [1.0, 0, 0, 0])
        recording.add("/tf", "tf2_msgs/msg/TFMessage", time_ns, [transform])
    report = report_of(making, tmp_path, recording)
    assert rules(report) == {"disconnected", "parents", "loop"}
    assert report.trees == (("cube", "hand", "table", "world"), ("camera", "lens"), ("x", "y"))
    (conflict,) = [f for f in report.findings if f.rule == "parents"]
    assert conflict.subject == "cube"
    assert "hand, table" in conflict.sentence
    assert {(t.parent, t.child): t.n_transforms for t in report.transforms}["table", "cube"] == 10


def test_a_mapping_that_does_not_fit_is_found_without_an_exception(making, tmp_path):
    recording = poses(making, steady(making), position=(450.0, -120.0, 800.0), frame="rig")
    topics = {
        "/hand": {"kind": "pose", "entity": "h"},
        "/gone": {"kind": "transforms"},
        "/spare": {"kind": "transforms", "required": False},
    }
    report = report_of(making, tmp_path, recording, making.mapping_of(topics))
    found = {(f.severity, f.subject, f.rule): f.sentence for f in report.findings}
    assert "unit: mm" in found["warning", "/hand", "unit"]
    assert "rig" in found["error", "/hand", "reference"]
    assert "available: /hand" in found["error", "/gone", "missing-topic"]
    assert ("warning", "/spare", "missing-topic") in found
    assert [f.severity for f in report.findings] == sorted(f.severity for f in report.findings)
    topics = {"/hand": {"kind": "pose", "entity": "h", "position": "pose.place"}}
    broken = inspect(tmp_path / "a.mcap", making.mapping_of(topics))
    assert "mapping" in rules(broken, "/hand")


def test_names_that_never_come_and_a_grip_that_never_moves_are_found(making, recording, tmp_path):
    topics = {
        "/tf": {"kind": "transforms", "entities": {"cube_green": "Cube_green"}},
        "/joy": {"kind": "grip", "entity": "h", "field": "axes[0]"},
    }
    report = report_of(making, tmp_path, recording, making.mapping_of(topics))
    assert "cube_green" in next(f.sentence for f in report.findings if f.rule == "never-seen")
    assert "grip" in rules(report, "/joy")


def test_a_cut_log_is_reported_as_truncated(making, recording, tmp_path):
    path = making.to_mcap(tmp_path / "a.mcap", recording)
    path.write_bytes(path.read_bytes()[:-4000])
    report = inspect(path)
    assert report.status == "truncated"
    assert "truncated" in rules(report, "log")


def test_a_chunk_whose_checksum_does_not_fit_is_found(making, recording, tmp_path):
    path = making.WRITERS["mcap none"](tmp_path, recording)
    data = bytearray(path.read_bytes())
    place = data.index(b"cube_with_a_longer_name")
    data[place] ^= 1
    path.write_bytes(data)
    report = inspect(path)
    assert "checksum" in report.reason


def test_a_type_without_definition_is_noted_and_the_rest_is_read(making, tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("rig_msgs/msg/Grip", "", b"")
        for topic, encoding in (("/grip", "cdr"), ("/odd", "flatbuffer")):
            writer.add_message(
                writer.register_channel(topic, encoding, schema), 5 * S, b"\0\1\0\0abcd", 5 * S
            )
        writer.finish()
    report = inspect(path)
    assert [t.is_decodable for t in report.topics] == [False, False]
    sentences = {f.subject: f.sentence for f in report.findings if f.rule == "unknown-type"}
    assert "rig_msgs/msg/Grip has no definition" in sentences["/grip"]
    assert "flatbuffer" in sentences["/odd"]


def test_a_report_is_json_with_times_as_text(making, recording, tmp_path):
    report = report_of(making, tmp_path, recording)
    plain = json.loads(json.dumps(report.as_json()))
    assert plain["start_ns"] == str(report.start_ns)
    assert isinstance(plain["topics"][0]["clocks"][0]["first_ns"], str)


def test_what_is_no_log_is_an_error(tmp_path):
    with pytest.raises(LogError, match="does not exist"):
        inspect(tmp_path / "nothing")
