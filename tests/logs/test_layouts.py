"""Our decoding against rosbags' own, on messages of any content."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.logs.columns import XYZ, XYZW, Field, Wanted
from demoplan.logs.decoding import decoder_for
from demoplan.logs.definitions import Definitions
from demoplan.logs.layouts import Interner
from demoplan.logs.messages import Block, Channel
from demoplan.logs.sampling import wanted_of
from demoplan.manifests.mapping import TransformsTopic

NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
NUMBERS = st.floats(width=64)
TRANSFORMS = st.lists(
    st.tuples(
        st.integers(0, 2**31 * 10**9 - 1),
        NAMES,
        NAMES,
        st.lists(NUMBERS, min_size=3, max_size=3),
        st.lists(NUMBERS, min_size=4, max_size=4),
    ),
    max_size=4,
)


def block_of(channel, payloads):
    lengths = np.array([len(p) for p in payloads], np.int64)
    # Gaps between payloads, as the heads of records make them.
    buffer = np.frombuffer(b"".join(b"#" * 5 + p for p in payloads), np.uint8)
    starts = np.cumsum(lengths + 5) - lengths
    n = np.arange(len(payloads), dtype=np.int64)
    return Block(channel, buffer, starts, lengths, n, n)


@settings(max_examples=80, deadline=None)
@given(
    messages=st.lists(TRANSFORMS, min_size=1, max_size=12), form=st.sampled_from(["ros1", "little", "big"])
)
def test_transforms_decode_as_they_were_serialised(messages, form, making):
    kind = "tf2_msgs/msg/TFMessage"
    if form == "ros1":
        store, encoding = making.ROS1, "ros1"
        schema = store.generate_msgdef(kind, ros_version=1)[0].encode()
        payloads = [bytes(store.serialize_ros1(making.build(store, kind, m), kind)) for m in messages]
    else:
        store, encoding, schema = making.ROS2, "cdr", b""
        payloads = [
            bytes(store.serialize_cdr(making.build(store, kind, m), kind, little_endian=form == "little"))
            for m in messages
        ]
    interner = Interner()
    wanted = wanted_of(TransformsTopic(kind="transforms"))
    channel = Channel("/tf", kind, encoding, "ros1msg" if form == "ros1" else "", schema)
    decoder = decoder_for(channel, wanted, Definitions(), interner)
    # Twice: first the layouts are found, then recognised.
    for _ in range(2):
        columns = decoder.decode(block_of(channel, payloads))
        rows = [(i, *transform) for i, message in enumerate(messages) for transform in message]
        assert columns.refused == []
        assert columns.message.tolist() == [row[0] for row in rows]
        if not rows:
            continue
        assert columns.stamps["stamp"].tolist() == [row[1] for row in rows]
        assert [interner.texts[c] for c in columns.texts["frame"]] == [row[2] for row in rows]
        assert [interner.texts[c] for c in columns.texts["name"]] == [row[3] for row in rows]
        np.testing.assert_array_equal(columns.numbers["position"], [row[4] for row in rows])
        wxyz = columns.numbers["orientation"][:, [3, 0, 1, 2]]
        np.testing.assert_array_equal(wxyz, [row[5] for row in rows])


def test_elements_of_a_list_that_lie_behind_lists_of_any_length_are_found(making):
    kind = "sensor_msgs/msg/MultiDOFJointState"
    types = making.ROS2.types
    random = np.random.default_rng(1)
    payloads, expected = [], []
    for i in range(40):
        n = int(random.integers(0, 4))
        positions = random.normal(size=(n, 7))
        message = types[kind](
            header=making.header(making.ROS2, making.START_NS + i, "f" * (i % 3)),
            joint_names=["j" * int(k) for k in random.integers(0, 9, n)],
            transforms=[
                types["geometry_msgs/msg/Transform"](
                    types["geometry_msgs/msg/Vector3"](*p[:3]), types["geometry_msgs/msg/Quaternion"](*p[3:])
                )
                for p in positions
            ],
            twist=[],
            wrench=[],
        )
        payloads.append(bytes(making.ROS2.serialize_cdr(message, kind)))
        expected += [(i, *p) for p in positions]
    wanted = Wanted(
        (
            Field("stamp", ("header.stamp",), "stamp"),
            Field("position", ("translation",), "numbers", XYZ, is_element=True),
            Field("orientation", ("rotation",), "numbers", XYZW, is_element=True),
        ),
        "transforms",
    )
    channel = Channel("/j", kind, "cdr")
    columns = decoder_for(channel, wanted, Definitions(), Interner()).decode(block_of(channel, payloads))
    assert columns.message.tolist() == [row[0] for row in expected]
    assert columns.stamps["stamp"].tolist() == [making.START_NS + row[0] for row in expected]
    np.testing.assert_array_equal(
        np.hstack([columns.numbers["position"], columns.numbers["orientation"]]),
        [row[1:] for row in expected],
    )


def test_a_message_that_ends_within_a_field_is_refused_and_the_others_are_not(making):
    kind = "geometry_msgs/msg/PoseStamped"
    value = (making.START_NS, "world", [1.0, 2, 3], [1.0, 0, 0, 0])
    good = bytes(making.ROS2.serialize_cdr(making.build(making.ROS2, kind, value), kind))
    wild = good[:12] + b"\xff\xff\xff\x7f" + good[16:]
    parameters = b"\0\3\0\0" + good[4:]
    payloads = [good, good[:30], wild, b"", parameters, good]
    wanted = Wanted((Field("position", ("pose.position",), "numbers", XYZ),))
    channel = Channel("/p", kind, "cdr")
    columns = decoder_for(channel, wanted, Definitions(), Interner()).decode(block_of(channel, payloads))
    assert columns.message.tolist() == [0, 5]
    assert sum(n for n, _ in columns.refused) == 4
    assert any("not plain CDR" in why for _, why in columns.refused)
