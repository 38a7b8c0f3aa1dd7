"""Streams of messages to a log: MCAP and rosbag2 (ROS 2 CDR), or ROS 1 bags.

Each stream holds arrays; messages of equal layout are assembled as one byte matrix, so that no message is
serialised by itself. The same streams give the same bytes, whatever the time of day.
"""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from demoplan.errors import LogError, UnknownNameError

Floats: TypeAlias = NDArray[np.float64]
Stamps: TypeAlias = NDArray[np.int64]
LogFormat: TypeAlias = Literal["mcap", "rosbag2", "rosbag1"]

LOG_FORMATS: dict[str, str] = {"mcap": ".mcap", "rosbag2": "", "rosbag1": ".bag"}
"""Format → what follows the name of its file; a rosbag2 is a folder."""


@dataclass(frozen=True)
class Stamped:
    """Three stamps per message [ns], each ``(n,)``. ROS bags only keep header and receipt."""

    header_ns: Stamps
    publish_ns: Stamps
    log_ns: Stamps


@dataclass(frozen=True)
class TransformStream:
    """A ``tf2_msgs/TFMessage`` topic: transforms from one parent frame to ``k`` children."""

    topic: str
    stamps: Stamped
    parent: str
    children: tuple[str, ...]
    position_xyz_m: Floats
    """``(n, k, 3)``"""
    orientation_wxyz: Floats
    """``(n, k, 4)``"""
    is_present: NDArray[np.bool_]
    """Which children are in which message, ``(n, k)``."""
    is_static: bool = False


@dataclass(frozen=True)
class PoseStream:
    """A ``geometry_msgs/PoseStamped`` topic."""

    topic: str
    stamps: Stamped
    frame: str
    position_xyz_m: Floats
    """``(n, 3)``"""
    orientation_wxyz: Floats
    """``(n, 4)``"""


@dataclass(frozen=True)
class JoyStream:
    """A ``sensor_msgs/Joy`` topic with axes and no buttons."""

    topic: str
    stamps: Stamped
    frame: str
    axes: Floats
    """``(n, k)``"""


Stream: TypeAlias = TransformStream | PoseStream | JoyStream

_TYPES: dict[type, str] = {
    TransformStream: "tf2_msgs/msg/TFMessage",
    PoseStream: "geometry_msgs/msg/PoseStamped",
    JoyStream: "sensor_msgs/msg/Joy",
}


class _Layout:
    """A message layout while it is put together: fields in order, aligned as the encoding wants.

    CDR aligns each number to its size, counted from behind the four bytes that name the encoding;
    ROS 1 packs.
    """

    def __init__(self, *, is_cdr: bool) -> None:
        self.is_cdr = is_cdr
        self.size = 4 if is_cdr else 0
        self.constants: list[tuple[int, bytes]] = [(0, b"\x00\x01\x00\x00")] if is_cdr else []
        self.columns: list[tuple[int, NDArray[np.uint8]]] = []

    def _align(self, to: int) -> None:
        if self.is_cdr:
            self.size += -(self.size - 4) % to

    def constant(self, value: int) -> None:
        """An unsigned 32-bit number that is the same in every message."""
        self._align(4)
        self.constants.append((self.size, value.to_bytes(4, "little")))
        self.size += 4

    def text(self, value: str) -> None:
        """A string that is the same in every message."""
        data = value.encode() + (b"\x00" if self.is_cdr else b"")
        self.constant(len(data))
        self.constants.append((self.size, data))
        self.size += len(data)

    def numbers(self, values: NDArray[np.generic]) -> None:
        """Numbers ``(n,)`` or ``(n, k)``, one row per message, little-endian."""
        self._align(values.dtype.itemsize)
        rows = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<"), copy=False)
        data = rows.reshape(len(rows), -1).view(np.uint8)
        self.columns.append((self.size, data))
        self.size += data.shape[1]

    def stamps(self, stamps_ns: Stamps) -> None:
        """A header's time: whole seconds and nanoseconds."""
        seconds, rest = np.divmod(stamps_ns, 1_000_000_000)
        self.numbers(np.stack([seconds, rest], axis=1).astype(np.uint32))

    def header(self, stamps_ns: Stamps, sequence: Stamps, frame: str) -> None:
        """A ``std_msgs/Header``; ROS 1 has a running number in front."""
        if not self.is_cdr:
            self.numbers(sequence.astype(np.uint32))
        self.stamps(stamps_ns)
        self.text(frame)

    def messages(self, n: int) -> list[bytes]:
        """The ``n`` messages."""
        matrix = np.zeros((n, self.size), dtype=np.uint8)
        for offset, data in self.constants:
            matrix[:, offset : offset + len(data)] = np.frombuffer(data, dtype=np.uint8)
        for offset, column in self.columns:
            matrix[:, offset : offset + column.shape[1]] = column
        block = matrix.tobytes()
        return [block[k * self.size : (k + 1) * self.size] for k in range(n)]


def _xyzw(orientation_wxyz: Floats) -> Floats:
    return np.roll(orientation_wxyz, -1, axis=-1)


def serialised(stream: Stream, *, is_cdr: bool) -> list[bytes]:
    """The messages of a stream, in its order, as ROS 2 CDR (little-endian) or as ROS 1 serialises them."""
    header_ns = stream.stamps.header_ns
    n = len(header_ns)
    sequence = np.arange(n, dtype=np.int64)
    layout = _Layout(is_cdr=is_cdr)
    if isinstance(stream, PoseStream):
        layout.header(header_ns, sequence, stream.frame)
        layout.numbers(np.concatenate([stream.position_xyz_m, _xyzw(stream.orientation_wxyz)], axis=1))
        return layout.messages(n)
    if isinstance(stream, JoyStream):
        layout.header(header_ns, sequence, stream.frame)
        layout.constant(stream.axes.shape[1])
        layout.numbers(stream.axes.astype(np.float32))
        layout.constant(0)
        return layout.messages(n)
    messages: list[bytes] = [b""] * n
    masks, which = np.unique(stream.is_present, axis=0, return_inverse=True)
    for number, mask in enumerate(masks):
        rows = np.flatnonzero(which.reshape(-1) == number)
        layout = _Layout(is_cdr=is_cdr)
        layout.constant(int(mask.sum()))
        for child in np.flatnonzero(mask):
            layout.header(header_ns[rows], sequence[rows], stream.parent)
            layout.text(stream.children[child])
            pose = (stream.position_xyz_m[rows, child], _xyzw(stream.orientation_wxyz[rows, child]))
            layout.numbers(np.concatenate(pose, axis=1))
        for row, message in zip(rows, layout.messages(len(rows)), strict=True):
            messages[row] = message
    return messages


def write_log(path: Path, streams: Sequence[Stream], log_format: LogFormat, *, compression: str = "") -> None:
    """Write streams to a log, in the order in which messages were received.

    Args:
        path: The file, or for a rosbag2 the folder, to write; it is replaced if it is there.
        streams: What to write; topics must differ.
        log_format: ``mcap``, ``rosbag2`` (sqlite3 with metadata.yaml) or ``rosbag1``.
        compression: ``none``, ``lz4``, ``zstd`` (MCAP), ``none``, ``lz4``, ``bz2`` (ROS 1 bag), ``none``
            (rosbag2); empty for the usual: zstd, lz4, none.

    Raises:
        UnknownNameError: If there is no such format or compression.
        LogError: If the log cannot be written.
    """
    writers: dict[str, tuple[Callable[[Path, Sequence[Stream], str], None], tuple[str, ...]]] = {
        "mcap": (_write_mcap, ("zstd", "lz4", "none")),
        "rosbag2": (_write_rosbag2, ("none",)),
        "rosbag1": (_write_rosbag1, ("lz4", "bz2", "none")),
    }
    if log_format not in writers:
        raise UnknownNameError("log format", log_format, writers)
    write, compressions = writers[log_format]
    chosen = compression or compressions[0]
    if chosen not in compressions:
        raise UnknownNameError("compression", chosen, compressions, f"format {log_format}")
    # Written under its own name (a rosbag2 names its database after its folder) beside its place, then moved.
    workshop = path.with_name(f".{path.name}.part")
    try:
        _remove(workshop)
        workshop.mkdir(parents=True)
        write(workshop / path.name, streams, chosen)
        if path.is_dir():
            _remove(path)
        (workshop / path.name).replace(path)
    except OSError as error:
        raise LogError(path, f"cannot be written: {error.strerror or error}") from error
    finally:
        _remove(workshop)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    elif path.exists():
        path.unlink()


def _received(streams: Sequence[Stream], payloads: Sequence[list[bytes]]) -> Iterator[tuple[int, int, bytes]]:
    """(stream, message, payload) in order of receipt; at equal stamps in order of streams."""
    counts = [len(messages) for messages in payloads]
    owner = np.repeat(np.arange(len(streams)), counts)
    number = np.concatenate([np.arange(count) for count in counts])
    received = np.concatenate([stream.stamps.log_ns for stream in streams])
    for k in np.lexsort((number, owner, received)):
        stream, message = int(owner[k]), int(number[k])
        yield stream, message, payloads[stream][message]


def _write_mcap(path: Path, streams: Sequence[Stream], compression: str) -> None:
    kinds = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("wb") as file:
        writer = McapWriter(file, compression=kinds[compression])
        writer.start(profile="ros2", library="demoplan")
        schemas: dict[str, int] = {}
        channels: list[int] = []
        for stream in streams:
            name = _TYPES[type(stream)]
            if name not in schemas:
                text, _ = store.generate_msgdef(name, ros_version=2)
                schemas[name] = writer.register_schema(name, "ros2msg", text.encode())
            channels.append(writer.register_channel(stream.topic, "cdr", schemas[name], _qos_text(stream)))
        payloads = [serialised(stream, is_cdr=True) for stream in streams]
        for owner, number, payload in _received(streams, payloads):
            stamps = streams[owner].stamps
            writer.add_message(
                channels[owner],
                int(stamps.log_ns[number]),
                payload,
                int(stamps.publish_ns[number]),
                sequence=number,
            )
        writer.finish()  # type: ignore[no-untyped-call]


def _qos(stream: Stream) -> Qos:
    is_latched = isinstance(stream, TransformStream) and stream.is_static
    forever = QosTime(9223372036, 854775807)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if is_latched else 100,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if is_latched else QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


def _qos_text(stream: Stream) -> dict[str, str]:
    """The same as channel metadata, as ROS 2's own recorder writes it."""
    qos = _qos(stream)

    def time(value: QosTime) -> str:
        return f"{{sec: {value.sec}, nsec: {value.nsec}}}"

    lines = (
        f"history: {qos.history.name.lower()}",
        f"depth: {qos.depth}",
        f"reliability: {qos.reliability.name.lower()}",
        f"durability: {qos.durability.name.lower()}",
        f"deadline: {time(qos.deadline)}",
        f"lifespan: {time(qos.lifespan)}",
        f"liveliness: {qos.liveliness.name.lower()}",
        f"liveliness_lease_duration: {time(qos.liveliness_lease_duration)}",
        f"avoid_ros_namespace_conventions: {str(qos.avoid_ros_namespace_conventions).lower()}",
    )
    return {"offered_qos_profiles": "- " + "\n  ".join(lines) + "\n"}


def _write_rosbag2(path: Path, streams: Sequence[Stream], compression: str) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Ros2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connections = [
            bag.add_connection(
                stream.topic, _TYPES[type(stream)], typestore=store, offered_qos_profiles=[_qos(stream)]
            )
            for stream in streams
        ]
        payloads = [serialised(stream, is_cdr=True) for stream in streams]
        for owner, number, payload in _received(streams, payloads):
            bag.write(connections[owner], int(streams[owner].stamps.log_ns[number]), payload)


def _write_rosbag1(path: Path, streams: Sequence[Stream], compression: str) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    # The ROS 1 type store has no tf2_msgs; the definition is the same in both generations.
    store.register(
        get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", _TYPES[TransformStream])
    )
    bag = Ros1Writer(path)
    if compression != "none":
        bag.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
    with bag:
        connections = [
            bag.add_connection(
                stream.topic,
                _TYPES[type(stream)],
                typestore=store,
                latching=1 if isinstance(stream, TransformStream) and stream.is_static else None,
            )
            for stream in streams
        ]
        payloads = [serialised(stream, is_cdr=False) for stream in streams]
        for owner, number, payload in _received(streams, payloads):
            bag.write(connections[owner], int(streams[owner].stamps.log_ns[number]), payload)
