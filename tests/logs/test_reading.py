import sqlite3

import numpy as np
import polars as pl
import pytest

from demoplan.errors import LogError, UsageError
from demoplan.logs import fingerprint, open_log, read

FORMATS = [
    "mcap zstd",
    "mcap lz4",
    "mcap none",
    "mcap without chunks",
    "mcap without indexes",
    "mcap of ros1",
    "mcap without definitions",
    "sqlite3",
    "sqlite3 by message",
    "sqlite3 by file",
    "rosbag1",
    "rosbag1 bz2",
    "rosbag1 lz4",
]


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_what_was_recorded(name, making, recording, tmp_path):
    found = read(making.WRITERS[name](tmp_path, recording), making.MAPPING, "e")
    assert found.status == "complete", found.reason

    tf = found.samples.filter(pl.col("topic") == "/tf")
    expected = [
        (i, *transform)
        for i, value in enumerate(v for t, _, _, v in recording.messages if t == "/tf")
        for transform in value
    ]
    assert tf["message_index"].to_list() == [row[0] for row in expected]
    assert tf["header_ns"].to_list() == tf["stamp_ns"].to_list() == [row[1] for row in expected]
    assert tf["entity"].to_list() == [row[3] for row in expected]
    assert set(tf["reference"]) == {"world"}
    np.testing.assert_array_equal(tf["position_xyz_m"].to_numpy(), [row[4] for row in expected])
    np.testing.assert_array_equal(tf["orientation_wxyz"].to_numpy(), [row[5] for row in expected])

    hand = found.samples.filter(pl.col("topic") == "/hand")
    values = [v for t, _, _, v in recording.messages if t == "/hand"]
    np.testing.assert_array_equal(hand["position_xyz_m"].to_numpy(), [v[2] for v in values])
    np.testing.assert_array_equal(hand["orientation_wxyz"].to_numpy(), [v[3] for v in values])
    assert hand["log_ns"].to_list() == [log for t, _, log, _ in recording.messages if t == "/hand"]

    grip = found.samples.filter(pl.col("topic") == "/joy")
    assert grip["grip"].to_list() == [v[1][1] for t, _, _, v in recording.messages if t == "/joy"]
    assert found.samples["is_tracked"].all()

    topics = {row["topic"]: row for row in found.topics.iter_rows(named=True)}
    assert {t: r["n_messages"] for t, r in topics.items()} == dict.fromkeys(topics, 120)
    assert topics["/tf"]["n_rows"] == len(tf)
    assert (topics["/unmapped"]["is_mapped"], topics["/unmapped"]["n_rows"]) == (False, 0)


def test_publish_times_are_kept_where_the_format_has_them(making, recording, tmp_path):
    mcap = read(making.to_mcap(tmp_path / "a.mcap", recording), making.MAPPING, "e").samples
    assert (mcap["log_ns"] - mcap["publish_ns"]).unique().to_list() == [1000]
    bag = read(making.to_rosbag1(tmp_path / "a.bag", recording), making.MAPPING, "e").samples
    assert bag["publish_ns"].null_count() == len(bag)


def test_a_split_bag_counts_on_over_its_files(making, tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    for number in (0, 1, 2, 10):
        part = making.demonstration(20, seed=number)
        making.to_mcap(folder / f"bag_{number}.mcap", part)
    found = read(folder, making.MAPPING, "e")
    hand = found.samples.filter(pl.col("topic") == "/hand")
    assert hand["message_index"].to_list() == list(range(80))
    last = making.demonstration(20, seed=10).messages[-3][3][2]
    assert hand["position_xyz_m"][-1].to_list() == last


def test_a_missing_part_of_a_split_bag_marks_it_truncated(making, recording, tmp_path):
    path = making.to_sqlite3(tmp_path / "log", recording)
    metadata = path / "metadata.yaml"
    metadata.write_text(
        metadata.read_text().replace("  relative_file_paths:\n", "  relative_file_paths:\n  - gone.db3\n")
    )
    found = read(path, making.MAPPING, "e")
    assert found.status == "truncated"
    assert "gone.db3" in found.reason
    metadata.write_text("{ not yaml")
    assert read(path, making.MAPPING, "e").status == "complete"
    metadata.unlink()
    assert read(path, making.MAPPING, "e").status == "complete"


def test_reading_leaves_nothing_beside_the_log_even_in_wal_mode(making, recording, tmp_path):
    path = making.to_sqlite3(tmp_path / "log", recording)
    (file,) = path.glob("*.db3")
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode = WAL")
    database.close()
    before = sorted(p.name for p in path.iterdir())
    assert len(read(path, making.MAPPING, "e").samples) == 480
    assert sorted(p.name for p in path.iterdir()) == before


def test_messages_in_a_write_ahead_log_are_not_lost(making, recording, tmp_path):
    path = making.to_sqlite3(tmp_path / "log", recording)
    (file,) = path.glob("*.db3")
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("DELETE FROM messages WHERE id % 2 = 0")
    database.commit()
    copy = tmp_path / "killed"
    copy.mkdir()
    for part in path.glob("*.db3*"):
        (copy / part.name).write_bytes(part.read_bytes())
    database.close()
    assert (copy / (file.name + "-wal")).stat().st_size > 0
    found = read(copy, making.MAPPING, "e")
    assert found.topics["n_messages"].sum() == 240
    assert found.status == "complete"


def test_batches_are_bounded_and_hold_one_topic_each(making, monkeypatch, recording, tmp_path):
    monkeypatch.setattr("demoplan.logs.reading._BATCH_ROWS", 50)
    path = making.to_mcap(tmp_path / "a.mcap", recording, chunk_size=2048)
    stream = open_log(path, making.MAPPING, "e")
    batches = list(stream.batches())
    assert len(batches) > 6
    assert max(map(len, batches)) < 100
    assert all(batch["topic"].n_unique() == 1 for batch in batches)
    with pytest.raises(UsageError, match="only once"):
        next(stream.batches())
    monkeypatch.undo()
    whole = read(path, making.MAPPING, "e").samples
    assert (
        pl.concat(batches).sort("topic", maintain_order=True).equals(whole.sort("topic", maintain_order=True))
    )


def test_two_publishers_of_one_topic_stay_in_file_order(making, tmp_path):
    from rosbags.rosbag1 import Writer

    path = tmp_path / "log.bag"
    with Writer(path) as writer:
        kind = "geometry_msgs/msg/PoseStamped"
        connections = [
            writer.add_connection("/hand", kind, typestore=making.ROS1, callerid=c) for c in ("/a", "/b")
        ]
        for i in range(50):
            value = (making.START_NS + i, "world", [i, 0, 0], [1, 0, 0, 0])
            data = making.ROS1.serialize_ros1(making.build(making.ROS1, kind, value), kind)
            writer.write(connections[i % 2], making.START_NS + i, data)
    mapping = making.mapping_of({"/hand": {"kind": "pose", "entity": "h"}})
    samples = read(path, mapping, "e").samples
    assert samples["message_index"].to_list() == list(range(50))
    assert [x[0] for x in samples["position_xyz_m"].to_list()] == list(range(50))


def test_definitions_come_from_a_folder_where_the_log_has_none(making, tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("rig_msgs/msg/Grip", "", b"")
        channel = writer.register_channel("/grip", "cdr", schema)
        payload = (
            b"\0\1\0\0" + (3).to_bytes(4, "little") + b"ab\0" + b"\0" + np.array([0.25], "<f4").tobytes()
        )
        writer.add_message(channel, 5, payload, 5)
        writer.finish()
    topics = {"/grip": {"kind": "grip", "entity": "h", "field": "width", "open_at": 0.5}}
    with pytest.raises(LogError, match=r"rig_msgs/msg/Grip has no definition.*definitions"):
        read(path, making.mapping_of(topics), "e")
    (tmp_path / "defs" / "rig_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "defs" / "rig_msgs" / "msg" / "Grip.msg").write_text("string side\nfloat32 width\n")
    mapping = making.mapping_of(topics, definitions=["defs"])
    assert read(path, mapping, "e", definitions_root=tmp_path).samples["grip"].to_list() == [0.5]
    with pytest.raises(UsageError, match="leave"):
        read(path, making.mapping_of(topics, definitions=["../x"]), "e", definitions_root=tmp_path)


def test_fingerprint_is_that_of_the_bytes_and_does_not_depend_on_metadata(making, recording, tmp_path):
    import hashlib

    path = making.to_mcap(tmp_path / "a.mcap", recording)
    assert fingerprint(path) == hashlib.sha256(path.read_bytes()).hexdigest()
    folder = making.to_sqlite3(tmp_path / "log", recording)
    before = fingerprint(folder)
    (folder / "metadata.yaml").unlink()
    assert fingerprint(folder) == before


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "does not exist"),
        (b"", "the file is empty"),
        (b"PK\x03\x04 something", "it begins with"),
        (b"#ROSBAG V1.2\n", "version '1.2'"),
    ],
)
def test_what_is_no_log_is_refused_with_a_sentence(content, sentence, making, tmp_path):
    path = tmp_path / "x.bag"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LogError, match=sentence):
        read(path, making.MAPPING, "e")


def test_a_folder_or_database_that_is_no_log_is_refused(making, tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(LogError, match=r"no log file; found: notes\.txt"):
        read(tmp_path, making.MAPPING, "e")
    database = sqlite3.connect(tmp_path / "x.db3")
    database.execute("CREATE TABLE other (id INTEGER)")
    database.commit()
    database.close()
    with pytest.raises(LogError, match=r"not a rosbag2.*found: other"):
        read(tmp_path / "x.db3", making.MAPPING, "e")
