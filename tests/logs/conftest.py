"""Logs to read, written by other libraries than ours: they are the oracle."""

import sqlite3
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from demoplan.manifests.mapping import Mapping

ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))

START_NS = 1_700_000_000_000_000_000


@dataclass
class Recording:
    """Messages as plain values: (topic, type, stamps, value)."""

    messages: list[tuple[str, str, int, Any]] = field(default_factory=list)

    def add(self, topic: str, kind: str, log_ns: int, value: Any) -> None:
        self.messages.append((topic, kind, log_ns, value))

    @property
    def topics(self) -> dict[str, str]:
        return {topic: kind for topic, kind, _, _ in self.messages}


def stamp(store, time_ns: int):
    return store.types["builtin_interfaces/msg/Time"](
        sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000
    )


def header(store, time_ns: int, frame: str):
    kind = store.types["std_msgs/msg/Header"]
    seq = {"seq": 0} if store is ROS1 else {}
    return kind(stamp=stamp(store, time_ns), frame_id=frame, **seq)


def pose(store, position, orientation_wxyz):
    types = store.types
    w, x, y, z = orientation_wxyz
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](*position),
        orientation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
    )


def build(store, kind: str, value: Any):
    """A message object from plain values."""
    types = store.types
    if kind == "tf2_msgs/msg/TFMessage":
        transforms = []
        for time_ns, parent, child, position, (w, x, y, z) in value:
            transforms.append(
                types["geometry_msgs/msg/TransformStamped"](
                    header=header(store, time_ns, parent),
                    child_frame_id=child,
                    transform=types["geometry_msgs/msg/Transform"](
                        translation=types["geometry_msgs/msg/Vector3"](*position),
                        rotation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
                    ),
                )
            )
        return types[kind](transforms)
    if kind == "geometry_msgs/msg/PoseStamped":
        time_ns, frame, position, orientation = value
        return types[kind](header(store, time_ns, frame), pose(store, position, orientation))
    if kind == "sensor_msgs/msg/Joy":
        time_ns, axes = value
        return types[kind](header(store, time_ns, ""), np.array(axes, np.float32), np.array([1, 0], np.int32))
    if kind == "std_msgs/msg/Float32":
        return types[kind](value)
    raise AssertionError(kind)


def to_mcap(path: Path, recording: Recording, *, profile: str = "ros2", definitions: bool = True, **options):
    store = ROS1 if profile == "ros1" else ROS2
    with path.open("wb") as file:
        writer = McapWriter(file, **{"chunk_size": 4096, "compression": CompressionType.ZSTD, **options})
        writer.start(profile)
        channels = {}
        for topic, kind in recording.topics.items():
            text = ""
            if definitions:
                text, _ = store.generate_msgdef(kind, ros_version=1 if profile == "ros1" else 2)
            schema = writer.register_schema(
                kind, "ros1msg" if profile == "ros1" else "ros2msg", text.encode()
            )
            channels[topic] = writer.register_channel(topic, "ros1" if profile == "ros1" else "cdr", schema)
        for topic, kind, log_ns, value in recording.messages:
            message = build(store, kind, value)
            data = (
                store.serialize_ros1(message, kind)
                if profile == "ros1"
                else store.serialize_cdr(message, kind)
            )
            writer.add_message(channels[topic], log_ns, bytes(data), log_ns - 1_000)
        writer.finish()
    return path


def to_sqlite3(path: Path, recording: Recording, *, compression: str = ""):
    with Ros2Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=ROS2)
            for topic, kind in recording.topics.items()
        }
        for topic, kind, log_ns, value in recording.messages:
            writer.write(connections[topic], log_ns, ROS2.serialize_cdr(build(ROS2, kind, value), kind))
    (file,) = path.glob("*.db3")
    if compression == "message":
        database = sqlite3.connect(file)
        rows = database.execute("SELECT id, data FROM messages").fetchall()
        packer = zstandard.ZstdCompressor()
        database.executemany(
            "UPDATE messages SET data = ? WHERE id = ?", [(packer.compress(d), i) for i, d in rows]
        )
        database.commit()
        database.close()
    if compression == "file":
        file.with_name(file.name + ".zstd").write_bytes(
            zstandard.ZstdCompressor().compress(file.read_bytes())
        )
        file.unlink()
    return path


def to_rosbag1(path: Path, recording: Recording, *, compression: str | None = None):
    writer = Ros1Writer(path)
    writer.chunk_threshold = 8192
    if compression:
        writer.set_compression(Ros1Writer.CompressionFormat[compression])
    with writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=ROS1)
            for topic, kind in recording.topics.items()
        }
        for topic, kind, log_ns, value in recording.messages:
            writer.write(connections[topic], log_ns, ROS1.serialize_ros1(build(ROS1, kind, value), kind))
    return path


WRITERS = {
    "mcap zstd": lambda folder, r: to_mcap(folder / "log.mcap", r),
    "mcap lz4": lambda folder, r: to_mcap(folder / "log.mcap", r, compression=CompressionType.LZ4),
    "mcap none": lambda folder, r: to_mcap(folder / "log.mcap", r, compression=CompressionType.NONE),
    "mcap without chunks": lambda folder, r: to_mcap(folder / "log.mcap", r, use_chunking=False),
    "mcap without indexes": lambda folder, r: to_mcap(folder / "log.mcap", r, index_types=IndexType.NONE),
    "mcap of ros1": lambda folder, r: to_mcap(folder / "log.mcap", r, profile="ros1"),
    "mcap without definitions": lambda folder, r: to_mcap(folder / "log.mcap", r, definitions=False),
    "sqlite3": lambda folder, r: to_sqlite3(folder / "log", r),
    "sqlite3 by message": lambda folder, r: to_sqlite3(folder / "log", r, compression="message"),
    "sqlite3 by file": lambda folder, r: to_sqlite3(folder / "log", r, compression="file"),
    "rosbag1": lambda folder, r: to_rosbag1(folder / "log.bag", r),
    "rosbag1 bz2": lambda folder, r: to_rosbag1(folder / "log.bag", r, compression="BZ2"),
    "rosbag1 lz4": lambda folder, r: to_rosbag1(folder / "log.bag", r, compression="LZ4"),
}


def mapping_of(topics: dict[str, Any], **more: Any) -> Mapping:
    return Mapping.model_validate({"entities": {}, "topics": topics, **more})


MAPPING = mapping_of(
    {
        "/tf": {"kind": "transforms"},
        "/hand": {"kind": "pose", "entity": "Right_hand"},
        "/joy": {"kind": "grip", "entity": "Right_hand", "field": "axes[1]"},
    }
)


def demonstration(n_messages: int = 120, *, seed: int = 0) -> Recording:
    """Transforms whose number varies, poses, and a grip axis, on three topics."""
    random = np.random.default_rng(seed)
    recording = Recording()
    for i in range(n_messages):
        time_ns = START_NS + i * 10_000_000
        names = ["cube_red", "cube_blue", "cube_with_a_longer_name"][: 1 + i % 3]
        transforms = [
            (time_ns - 500, "world", name, random.normal(size=3).tolist(), random.normal(size=4).tolist())
            for name in names
        ]
        recording.add("/tf", "tf2_msgs/msg/TFMessage", time_ns, transforms)
        value = (time_ns - 700, "world", random.normal(size=3).tolist(), random.normal(size=4).tolist())
        recording.add("/hand", "geometry_msgs/msg/PoseStamped", time_ns + 1, value)
        recording.add("/joy", "sensor_msgs/msg/Joy", time_ns + 2, (time_ns - 900, [0.5, (i % 5) / 4, -1.0]))
        recording.add("/unmapped", "std_msgs/msg/Float32", time_ns + 3, float(i))
    return recording


@pytest.fixture(scope="session")
def making() -> ModuleType:
    """This module: its functions write logs."""
    return sys.modules[__name__]


@pytest.fixture(scope="session")
def recording() -> Recording:
    return demonstration()
