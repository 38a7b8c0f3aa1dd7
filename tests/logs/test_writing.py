import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from demoplan.errors import LogError, UnknownNameError
from demoplan.logs.writing import (
    LOG_FORMATS,
    JoyStream,
    PoseStream,
    Stamped,
    TransformStream,
    serialised,
    write_log,
)

ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"))
START_NS = 1_700_000_000_123_456_789
NAMES = st.text(st.characters(min_codepoint=33, max_codepoint=0x17F), min_size=1, max_size=12)
WRITINGS = [
    ("mcap", "zstd"),
    ("mcap", "lz4"),
    ("mcap", "none"),
    ("rosbag2", "none"),
    ("rosbag1", "lz4"),
    ("rosbag1", "bz2"),
    ("rosbag1", "none"),
]


def stamped(n, step_ns, offset_ns=0):
    header_ns = START_NS + offset_ns + np.arange(n, dtype=np.int64) * step_ns
    return Stamped(header_ns, header_ns + 3_000_000, header_ns + 9_000_000)


def orientations(rng, *shape):
    raw = rng.normal(size=(*shape, 4))
    return raw / np.linalg.norm(raw, axis=-1, keepdims=True)


def transform_stream(n, children, rng, *, parent="world", topic="/tf", is_static=False):
    k = len(children)
    present = rng.random((n, k)) > 0.2 if not is_static else np.ones((n, k), dtype=bool)
    return TransformStream(
        topic,
        stamped(n, 10_000_000),
        parent,
        tuple(children),
        rng.normal(size=(n, k, 3)),
        orientations(rng, n, k),
        present,
        is_static,
    )


def pose_stream(n, rng, frame="vr_origin"):
    return PoseStream(
        "/hand/pose",
        stamped(n, 8_333_333, 2_000_000),
        frame,
        rng.normal(size=(n, 3)),
        orientations(rng, n),
    )


def joy_stream(n, rng, frame="hand", n_axes=1):
    return JoyStream("/hand/joy", stamped(n, 8_333_333, 2_000_000), frame, rng.random((n, n_axes)))


def streams(seed=0, n=60):
    rng = np.random.default_rng(seed)
    return [
        transform_stream(1, ["table", "vr_origin"], rng, topic="/tf_static", is_static=True),
        transform_stream(n, ["cube_red", "cube_blue", "cube_green"], rng),
        pose_stream(n, rng),
        joy_stream(n, rng),
    ]


def message_of(stream, number, store):
    """The same message, built field by field with another library."""
    types = store.types
    header_ns = int(stream.stamps.header_ns[number])
    time = types["builtin_interfaces/msg/Time"](*divmod(header_ns, 10**9))
    sequence = () if store is ROS2 else (number,)

    def header(frame):
        return types["std_msgs/msg/Header"](*sequence, time, frame)

    def quaternion(wxyz):
        w, x, y, z = wxyz
        return types["geometry_msgs/msg/Quaternion"](x, y, z, w)

    if isinstance(stream, PoseStream):
        point = types["geometry_msgs/msg/Point"](*stream.position_xyz_m[number])
        pose = types["geometry_msgs/msg/Pose"](point, quaternion(stream.orientation_wxyz[number]))
        return types["geometry_msgs/msg/PoseStamped"](header(stream.frame), pose)
    if isinstance(stream, JoyStream):
        axes = stream.axes[number].astype(np.float32)
        return types["sensor_msgs/msg/Joy"](header(stream.frame), axes, np.array([], dtype=np.int32))
    transforms = [
        types["geometry_msgs/msg/TransformStamped"](
            header(stream.parent),
            child,
            types["geometry_msgs/msg/Transform"](
                types["geometry_msgs/msg/Vector3"](*stream.position_xyz_m[number, column]),
                quaternion(stream.orientation_wxyz[number, column]),
            ),
        )
        for column, child in enumerate(stream.children)
        if stream.is_present[number, column]
    ]
    return types["tf2_msgs/msg/TFMessage"](transforms)


def expected(stream, number, *, is_cdr):
    store = ROS2 if is_cdr else ROS1
    message = message_of(stream, number, store)
    write = store.serialize_cdr if is_cdr else store.serialize_ros1
    return bytes(write(message, message.__msgtype__))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(NAMES, min_size=1, max_size=4, unique=True),
    NAMES,
    st.integers(1, 4),
    st.booleans(),
    st.integers(0, 1000),
)
def test_bytes_are_those_of_another_library_whatever_the_names_are(children, frame, n_axes, is_cdr, seed):
    rng = np.random.default_rng(seed)
    for stream in (
        transform_stream(5, children, rng, parent=frame),
        pose_stream(3, rng, frame),
        joy_stream(3, rng, frame, n_axes),
    ):
        messages = serialised(stream, is_cdr=is_cdr)
        assert messages == [expected(stream, k, is_cdr=is_cdr) for k in range(len(messages))]


@pytest.mark.parametrize(("log_format", "compression"), WRITINGS)
def test_a_log_gives_back_every_message_in_order_of_receipt(tmp_path, log_format, compression):
    path = tmp_path / f"log{LOG_FORMATS[log_format]}"
    written = streams()
    write_log(path, written, log_format, compression=compression)
    by_topic = {stream.topic: stream for stream in written}
    counts = dict.fromkeys(by_topic, 0)
    received = []
    with AnyReader([path]) as reader:
        for connection, received_ns, payload in reader.messages():
            stream = by_topic[connection.topic]
            number = counts[connection.topic]
            counts[connection.topic] += 1
            received.append(received_ns)
            assert received_ns == stream.stamps.log_ns[number]
            assert bytes(payload) == expected(stream, number, is_cdr=log_format != "rosbag1")
            reader.deserialize(payload, connection.msgtype)
    assert counts == {topic: len(stream.stamps.log_ns) for topic, stream in by_topic.items()}
    assert received == sorted(received)


def test_mcap_keeps_publication_and_receipt_and_says_that_it_is_ros2(tmp_path):
    path = tmp_path / "log.mcap"
    written = streams()
    write_log(path, written, "mcap")
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        poses = [m for _, _, m in reader.iter_messages(topics=["/hand/pose"])]
    assert [m.publish_time for m in poses] == written[2].stamps.publish_ns.tolist()
    assert [m.sequence for m in poses] == list(range(len(poses)))


def test_latched_transforms_are_marked_so(tmp_path):
    write_log(tmp_path / "log.bag", streams(), "rosbag1")
    write_log(tmp_path / "log", streams(), "rosbag2")
    with AnyReader([tmp_path / "log.bag"]) as reader:
        latching = {c.topic: c.ext.latching for c in reader.connections}
    assert latching["/tf_static"] == 1 and latching["/tf"] is None
    with AnyReader([tmp_path / "log"]) as reader:
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
    assert durability["/tf_static"] == "TRANSIENT_LOCAL" and durability["/tf"] == "VOLATILE"


def tree(folder):
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


@pytest.mark.parametrize(("log_format", "compression"), WRITINGS)
def test_the_same_streams_give_the_same_bytes(tmp_path, log_format, compression):
    for run in ("one", "two", "other"):
        path = tmp_path / run / f"log{LOG_FORMATS[log_format]}"
        write_log(path, streams(seed=run == "other"), log_format, compression=compression)
    assert tree(tmp_path / "one") == tree(tmp_path / "two")
    assert tree(tmp_path / "one") != tree(tmp_path / "other")


@pytest.mark.parametrize("log_format", LOG_FORMATS)
def test_a_log_that_is_there_is_replaced_and_nothing_else_is_left(tmp_path, log_format):
    path = tmp_path / f"log{LOG_FORMATS[log_format]}"
    write_log(path, streams(seed=1, n=200), log_format)
    write_log(path, streams(), log_format)
    write_log(tmp_path / "fresh" / path.name, streams(), log_format)
    assert [p.name for p in tmp_path.iterdir() if p.name != "fresh"] == [path.name]
    anew = tmp_path / "fresh" / path.name
    assert (tree(anew) if path.is_dir() else anew.read_bytes()) == (
        tree(path) if path.is_dir() else path.read_bytes()
    )


def test_an_unknown_format_or_compression_is_refused_with_what_there_is(tmp_path):
    with pytest.raises(UnknownNameError, match=r"'hdf5'.*mcap, rosbag1, rosbag2"):
        write_log(tmp_path / "log", streams(), "hdf5")
    with pytest.raises(UnknownNameError, match=r"'bz2' in format mcap.*lz4, none, zstd"):
        write_log(tmp_path / "log.mcap", streams(), "mcap", compression="bz2")
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_a_log_error_and_not_a_crash(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(LogError, match="cannot be written"):
        write_log(tmp_path / "file" / "log.mcap", streams(), "mcap")
