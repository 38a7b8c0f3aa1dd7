"""Recordings that others made: everything reads, or is refused with a reason; counts are as their makers say."""

import json
import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from mcap import records
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from demoplan.errors import LogError
from demoplan.logs import inspect, read


def test_conformance_files_hold_as_many_messages_as_they_should(logs_root):
    root = logs_root / "mcap-conformance"
    n_compared = 0
    for path in sorted(root.rglob("*.mcap")):
        report = inspect(path)
        assert report.status == "complete", (path.name, report.reason)
        expected = root / "expected_json" / path.parent.name / f"{path.stem}.json"
        if expected.is_file():
            records = json.loads(expected.read_text())["records"]
            declared = sum(record["type"] == "Message" for record in records)
            assert report.n_messages == declared, path.name
            n_compared += 1
        elif path.parent.name.startswith(("OneMessage", "TenMessages")):
            assert report.n_messages == (1 if path.parent.name == "OneMessage" else 10), path.name
            n_compared += 1
    assert n_compared > 250


def counts_by_another_reader(path):
    """Messages by topic, as mcap's, sqlite3's or rosbags' own reader counts them."""
    counts = Counter()
    if path.suffix == ".mcap":
        channels = {}
        with path.open("rb") as file:
            for record in StreamReader(file).records:
                if isinstance(record, records.Channel):
                    channels[record.id] = record.topic
                elif isinstance(record, records.Message):
                    counts[channels[record.channel_id]] += 1
    elif path.suffix == ".db3":
        with closing(sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)) as database:
            query = "SELECT name FROM messages JOIN topics ON topics.id = topic_id"
            counts.update(name for (name,) in database.execute(query))
    else:
        with AnyReader([path]) as reader:
            counts.update(connection.topic for connection, _, _ in reader.messages())
    return dict(counts)


def test_every_other_log_holds_what_another_reader_counts(logs_root):
    n_compared = 0
    for path in sorted(logs_root.rglob("*")):
        if path.suffix not in (".mcap", ".db3", ".bag") or "mcap-conformance" in path.parts:
            continue
        if path.stat().st_size == 0:
            with pytest.raises(LogError, match="empty"):
                inspect(path)
            continue
        report = inspect(path)
        assert report.status == "complete", (path, report.reason)
        found = {topic.topic: topic.n_messages for topic in report.topics if topic.n_messages}
        assert found == counts_by_another_reader(path), path
        n_compared += 1
    assert n_compared > 30


def test_one_recording_reads_alike_however_it_is_compressed(logs_root, making):
    topics = {
        "/tf": {"kind": "transforms"},
        "/tf_static": {"kind": "transforms", "static": True},
        "/turtle1/pose": {"kind": "grip", "entity": "h", "field": "x", "open_at": 11.0},
    }
    tables = [
        read(logs_root / "rosbag1" / f"example{end}.bag", making.mapping_of(topics), "e").samples
        for end in ("", "-bz2", "-lz4")
    ]
    assert len(tables[0]) == 2688 + 1 + 1344
    assert tables[0].equals(tables[1])
    assert tables[0].equals(tables[2])


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_split_bags_read_whole(storage, logs_root):
    folder = logs_root / "rosbag2/rosbag2_py/test/resources" / storage / "wbag"
    report = inspect(folder)
    assert report.status == "complete"
    assert len(report.files) == 5
    assert report.n_messages == 1246 + 3 * 1240 + 1108


BODIES = ("HandLeft", "HandRight", "Bowl", "Bottle", "Whisk")


def test_motion_capture_with_a_type_of_its_own_reads_as_rosbags_reads_it(bimanual_root, making):
    path = sorted(bimanual_root.glob("*.bag"))[3]
    topics = {
        "/natnet_node/natnet_frame": {
            "kind": "bodies",
            "path": "rigid_bodies",
            "valid": "track_valid",
            "entities": {name: name for name in BODIES},
        }
    }
    found = read(path, making.mapping_of(topics), "e")
    rows, n_empty = [], 0
    with AnyReader([Path(path)]) as reader:
        for i, (connection, log_ns, raw) in enumerate(reader.messages()):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            n_empty += not message.rigid_bodies
            for body in message.rigid_bodies:
                p, q = body.pose.position, body.pose.orientation
                rows.append(
                    (i, log_ns, stamp, body.name, body.track_valid, p.x, p.y, p.z, q.w, q.x, q.y, q.z)
                )
    samples = found.samples
    for column, at in (
        ("message_index", 0),
        ("log_ns", 1),
        ("header_ns", 2),
        ("entity", 3),
        ("is_tracked", 4),
    ):
        assert samples[column].to_list() == [row[at] for row in rows], column
    np.testing.assert_array_equal(samples["position_xyz_m"].to_numpy(), [row[5:8] for row in rows])
    np.testing.assert_array_equal(samples["orientation_wxyz"].to_numpy(), [row[8:] for row in rows])
    (topic,) = found.topics.filter(pl.col("is_mapped")).to_dicts()
    assert topic["n_rejected"] == n_empty > 0
