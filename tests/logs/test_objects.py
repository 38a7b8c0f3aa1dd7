import json
import struct

import pytest
from mcap.writer import Writer

from demoplan.errors import LogError
from demoplan.logs import inspect, read


def varint(value):
    out = b""
    while value > 0x7F:
        out += bytes([value & 0x7F | 0x80])
        value >>= 7
    return out + bytes([value])


def field(number, value):
    if isinstance(value, float):
        return varint(number << 3 | 1) + struct.pack("<d", value)
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def descriptor(name, fields):
    """A message type from (name, number, type, type name or empty, repeated)."""
    body = field(1, name)
    for label, number, kind, type_name, is_repeated in fields:
        about = field(1, label) + field(3, number) + field(4, 3 if is_repeated else 1) + field(5, kind)
        body += field(2, about + (field(6, type_name) if type_name else b""))
    return field(4, body)


DOUBLE, MESSAGE, STRING, INT64, UINT32 = 1, 11, 9, 3, 13
SCHEMA = field(
    1,
    field(1, "rig.proto")
    + field(2, "rig")
    + descriptor("Time", [("seconds", 1, INT64, "", False), ("nanos", 2, UINT32, "", False)])
    + descriptor("V", [(n, i, DOUBLE, "", False) for i, n in enumerate("xyz", 1)])
    + descriptor("Q", [(n, i, DOUBLE, "", False) for i, n in enumerate("xyzw", 1)])
    + descriptor(
        "Body",
        [
            ("name", 1, STRING, "", False),
            ("p", 2, MESSAGE, ".rig.V", False),
            ("q", 3, MESSAGE, ".rig.Q", False),
        ],
    )
    + descriptor(
        "Bodies",
        [
            ("timestamp", 1, MESSAGE, ".rig.Time", False),
            ("frame_id", 2, STRING, "", False),
            ("bodies", 3, MESSAGE, ".rig.Body", True),
        ],
    ),
)
TOPICS = {
    "/bodies": {
        "kind": "bodies",
        "path": "bodies",
        "position": "p",
        "orientation": "q",
        "entities": {"red": "cube_red", "blue": "cube_blue"},
        "unit": "mm",
    }
}


def body(name, p, q):
    vector = b"".join(field(i, v) for i, v in enumerate(p, 1) if v)
    return (
        field(1, name) + field(2, vector) + field(3, b"".join(field(i, v) for i, v in enumerate(q, 1) if v))
    )


def write(path, encoding, payloads, schema_name="rig.Bodies", schema_encoding="protobuf", schema=SCHEMA):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema(schema_name, schema_encoding, schema)
        channel = writer.register_channel("/bodies", encoding, number)
        for i, payload in enumerate(payloads):
            writer.add_message(channel, 2_000_000_000_000_000_000 + i, payload, 7)
        writer.finish()
    return path


def check(found):
    samples = found.samples
    assert samples["entity"].to_list() == ["cube_red", "cube_blue", "cube_red"]
    assert samples["header_ns"].to_list() == [1_700_000_000_000_000_005] * 2 + [1_700_000_001_000_000_005]
    assert samples["position_xyz_m"].to_list() == [
        [0.001, 0.002, 0.0],
        [0.004, 0.005, 0.006],
        [0.001, 0.002, 0.0],
    ]
    assert samples["orientation_wxyz"].to_list() == [[1.0, 0, 0, 0]] * 3
    assert set(samples["reference"]) == {"rig"}
    (row,) = found.topics.to_dicts()
    assert (row["n_messages"], row["n_rows"], row["n_rejected"]) == (4, 3, 2)
    assert "'green' left out" in row["note"]


def test_protobuf_is_read_by_the_descriptors_in_the_log(making, tmp_path):
    red, blue = body("red", (1.0, 2.0, 0.0), (0, 0, 0, 1.0)), body("blue", (4.0, 5.0, 6.0), (0, 0, 0, 1.0))
    time = [field(1, field(1, 1_700_000_000 + i) + field(2, 5)) for i in (0, 1)]
    payloads = [
        time[0] + field(2, "rig") + field(3, red) + field(3, blue),
        time[1] + field(2, "rig") + field(3, red) + field(3, body("green", (1.0, 0, 0), (0, 0, 0, 1.0))),
        time[1] + field(2, "rig"),
        b"\xff\xff\xff",
    ]
    path = write(tmp_path / "a.mcap", "protobuf", payloads)
    check(read(path, making.mapping_of(TOPICS), "e"))
    assert "malformed" in {finding.rule for finding in inspect(path).findings}


def test_json_is_read_like_any_other_message(making, tmp_path):
    def as_json(seconds, bodies):
        rows = [
            {"name": n, "p": dict(zip("xyz", p, strict=True)), "q": {"x": 0, "y": 0, "z": 0, "w": 1}}
            for n, p in bodies
        ]
        stamp = {"sec": seconds, "nsec": 5}
        return json.dumps({"timestamp": stamp, "frame_id": "rig", "bodies": rows}).encode()

    red = ("red", (1, 2, 0))
    payloads = [
        as_json(1_700_000_000, [red, ("blue", (4, 5, 6))]),
        as_json(1_700_000_001, [red, ("green", (0, 0, 0))]),
        as_json(1_700_000_001, []),
        b"{not json",
    ]
    path = write(tmp_path / "a.mcap", "json", payloads, "Bodies", "jsonschema", b"{}")
    check(read(path, making.mapping_of(TOPICS), "e"))


def test_a_field_that_json_messages_lack_is_named_with_what_is_there(making, tmp_path):
    path = write(
        tmp_path / "a.mcap",
        "json",
        [b'{"bodies": [{"name": "red", "at": [1, 2, 3]}]}'],
        "B",
        "jsonschema",
        b"",
    )
    with pytest.raises(LogError, match=r"'p' does not exist; available: name, at\[\]"):
        read(path, making.mapping_of(TOPICS), "e")
    topics = {"/bodies": {**TOPICS["/bodies"], "position": "at", "orientation": None}}
    samples = read(path, making.mapping_of(topics), "e").samples
    assert samples["position_xyz_m"].to_list() == [[0.001, 0.002, 0.003]]


def test_descriptors_without_the_type_are_named(making, tmp_path):
    path = write(tmp_path / "a.mcap", "protobuf", [b""], "rig.Other")
    with pytest.raises(LogError, match=r"do not hold rig\.Other; they hold: \.rig\.Bodies"):
        read(path, making.mapping_of(TOPICS), "e")
