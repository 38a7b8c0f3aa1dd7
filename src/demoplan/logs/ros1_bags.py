"""ROS 1 bags, version 2.0: none, bz2 or lz4, indexed or cut short.

As with MCAP, the file is read forwards, once, and a chunk's index records are used only if they account for
each byte of the chunk.

Source: http://wiki.ros.org/Bags/Format/2.0.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from demoplan.errors import LogError
from demoplan.logs import compression
from demoplan.logs.compression import BrokenStreamError, Part, UnknownCompressionError
from demoplan.logs.messages import MOST_BYTES, Block, Bytes, Channel, Tally, Times, TopicFilter, by_channel

MAGIC = b"#ROSBAG V"
_VERSION = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_U32 = struct.Struct("<I")
_INDEX_ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])
_MOST_HEADER = 2**20


class Ros1Bag:
    """One ROS 1 bag, read forwards in bounded memory."""

    format = "rosbag1"

    def __init__(self, path: Path) -> None:
        """Take the path; nothing is read before ``blocks``."""
        self.path = path
        self._channels: list[Channel | None] = []
        self._code_of_connection: dict[int, int] = {}

    def blocks(self, is_wanted: TopicFilter, tally: Tally) -> Iterator[Block]:
        """Payloads of the wanted topics, in file order; every message is counted in ``tally``."""
        size = self.path.stat().st_size
        with self.path.open("rb", buffering=2**18) as file:
            version = file.read(len(_VERSION))
            if version != _VERSION:
                raise LogError(
                    self.path, f"a bag of version {version[9:12].decode(errors='replace')!r}; known: '2.0'"
                )
            while True:
                at = file.tell()
                if at == size:
                    break
                record = _read_head(file, size)
                if record is None:
                    tally.problems.append(
                        f"at byte {at} of {size} begins a record that is damaged or not all there"
                    )
                    break
                head, n_data = record
                op = head.get("op", b"\0")[:1]
                end = file.tell() + n_data
                if op == bytes([_CHUNK]):
                    if end > size:
                        tally.problems.append(f"at byte {at} of {size} begins a chunk that is not all there")
                    yield from self._chunk(file, head, min(n_data, size - file.tell()), at, is_wanted, tally)
                    end = min(end, size)
                    if file.tell() > end:
                        continue
                elif end > size:
                    tally.problems.append(f"at byte {at} of {size} begins a record that is not all there")
                    break
                elif op == bytes([_BAG]):
                    if head.get("encryptor"):
                        raise LogError(self.path, "the bag is encrypted; decrypt it with ROS first")
                    index_at = int.from_bytes(head.get("index_pos", b""), "little")
                    if index_at == 0:
                        tally.problems.append("it was never closed: it has no index")
                    elif index_at >= size and any(head.get("chunk_count", b"")):
                        tally.problems.append(f"it ends at byte {size}, before its index at byte {index_at}")
                elif op == bytes([_CONNECTION]):
                    self._connect(head, file.read(n_data), tally)
                elif op == bytes([_MESSAGE]):
                    file.seek(at)
                    buffer = np.frombuffer(file.read(end - at), np.uint8)
                    yield from self._messages(buffer, np.zeros(1, np.int64), is_wanted, tally)
                file.seek(end)

    def _connect(self, head: dict[str, bytes], data: bytes, tally: Tally) -> None:
        """Take up a connection record."""
        described = _fields(data)
        if described is None or "topic" not in head or len(head.get("conn", b"")) != 4:
            tally.problems.append("a connection record is damaged")
            return
        (number,) = _U32.unpack(head["conn"])
        channel = Channel(
            head["topic"].decode(errors="replace"),
            described.get("type", b"").decode(errors="replace"),
            "ros1",
            "ros1msg",
            described.get("message_definition", b""),
            described.get("latching") == b"1",
        )
        if number not in self._code_of_connection:
            self._code_of_connection[number] = len(self._channels)
            self._channels.append(channel)
        tally.declare(channel)

    def _chunk(
        self,
        file: BinaryIO,
        head: dict[str, bytes],
        available: int,
        at: int,
        is_wanted: TopicFilter,
        tally: Tally,
    ) -> Iterator[Block]:
        end = file.tell() + available
        name = head.get("compression", b"").decode(errors="replace")
        unpacked = _U32.unpack(head.get("size", bytes(4)))[0]
        tally.facts.setdefault("compression", name)
        try:
            if available <= MOST_BYTES and unpacked <= MOST_BYTES:
                packed = file.read(available)
                try:
                    data = compression.whole(name, packed, unpacked)
                except BrokenStreamError:
                    yield from self._stream(compression.pieces(name, packed, unpacked), at, is_wanted, tally)
                    return
                indexed = self._indexes_after(file)
                buffer = np.frombuffer(data, np.uint8)
                starts = self._tiled(buffer, indexed, tally)
                if starts is None:
                    starts, stop = self._walk(buffer, tally)
                    if stop < len(buffer):
                        tally.problems.append(f"the chunk at byte {at} ends within a record")
                yield from self._messages(buffer, starts, is_wanted, tally)
                return
            parts = compression.pieces(name, Part(file, available), unpacked)
            yield from self._stream(parts, at, is_wanted, tally)
        except BrokenStreamError as error:
            tally.problems.append(f"the chunk at byte {at} does not decompress in full: {error}")
        except UnknownCompressionError:
            raise LogError(
                self.path, f"the chunk at byte {at} is compressed by {name!r}; known: none, bz2, lz4"
            ) from None
        file.seek(end)

    def _indexes_after(self, file: BinaryIO) -> Times:
        """Places of messages in the chunk just read, from the index records that follow; sorted."""
        parts = []
        while True:
            at = file.tell()
            record = _read_head(file, at + _MOST_HEADER)
            if record is None or record[0].get("op") != bytes([_INDEX]) or record[1] > MOST_BYTES:
                file.seek(at)
                break
            data = file.read(record[1])
            n_entries = len(data) // _INDEX_ENTRY.itemsize
            parts.append(np.frombuffer(data, _INDEX_ENTRY, n_entries)["offset"].astype(np.int64))
        return np.sort(np.concatenate(parts)) if parts else np.empty(0, np.int64)

    def _tiled(self, buffer: Bytes, starts: Times, tally: Tally) -> Times | None:
        """The indexed places if messages there, and connections between them, make up the whole buffer."""
        if not len(starts) or starts[0] < 0:
            return None
        shape = _shape_of_messages(buffer, int(starts[0]))
        if shape is None or starts[-1] + shape.itemsize > len(buffer):
            return None
        heads = _heads(buffer, starts, shape)
        if not _is_shaped(heads, shape):
            return None
        ends = starts + shape.itemsize + heads["size"].astype(np.int64)
        nexts = np.append(starts[1:], len(buffer))
        is_gap = ends != nexts
        connections = []
        for begin, end in [
            (0, int(starts[0])),
            *zip(ends[is_gap].tolist(), nexts[is_gap].tolist(), strict=True),
        ]:
            pos = begin
            while pos < end:
                record = _record_at(buffer, pos)
                if record is None or record[0].get("op") != bytes([_CONNECTION]):
                    return None
                connections.append(record)
                pos = record[2]
            if pos != end:
                return None
        for head, body, end in connections:
            self._connect(head, buffer[body:end].tobytes(), tally)
        return starts

    def _walk(self, buffer: Bytes, tally: Tally) -> tuple[Times, int]:
        """Places of all whole message records from the start, and where the first other thing begins."""
        starts: list[int] = []
        pos, size, unpack = 0, len(buffer), _U32.unpack_from
        n_head, expected = 0, b""
        data = buffer.data
        while pos + 8 <= size:
            (length,) = unpack(data, pos)
            # Most records have the header's fields in one order: then no header needs to be parsed.
            if length == n_head and bytes(data[pos + 4 : pos + 4 + len(expected)]) == expected:
                body = pos + 4 + n_head
                if body + 4 > size:
                    break
                end = body + 4 + unpack(data, body)[0]
                if end > size:
                    break
                starts.append(pos)
                pos = end
                continue
            record = _record_at(buffer, pos)
            if record is None:
                break
            head, body, end = record
            if head.get("op") == bytes([_MESSAGE]):
                starts.append(pos)
                if bytes(data[pos + 4 : pos + 8 + 4]) == b"\x04\0\0\0op=\x02":
                    n_head, expected = length, b"\x04\0\0\0op=\x02"
            elif head.get("op") == bytes([_CONNECTION]):
                self._connect(head, bytes(data[body:end]), tally)
            pos = end
        return np.array(starts, np.int64), pos

    def _stream(
        self, parts: Iterator[bytes], at: int, is_wanted: TopicFilter, tally: Tally
    ) -> Iterator[Block]:
        """Messages of a chunk that is too large to hold, or cut short, as far as its bytes go."""
        held = b""
        broken: BrokenStreamError | None = None
        gathered: list[bytes] = []
        n_held = 0
        is_over = False
        while not is_over:
            try:
                piece = next(parts, None)
            except BrokenStreamError as error:
                piece, broken = None, error
            is_over = piece is None
            if piece is not None:
                gathered.append(piece)
                n_held += len(piece)
                if n_held < MOST_BYTES // 4:
                    continue
            held = b"".join(gathered)
            buffer = np.frombuffer(held, np.uint8)
            starts, stop = self._walk(buffer, tally)
            yield from self._messages(buffer, starts, is_wanted, tally)
            gathered, n_held = [held[stop:]], len(held) - stop
        if n_held and broken is None:
            tally.problems.append(f"the chunk at byte {at} ends within a record")
        if broken is not None:
            raise broken

    def _messages(
        self, buffer: Bytes, starts: Times, is_wanted: TopicFilter, tally: Tally
    ) -> Iterator[Block]:
        while len(starts):
            shape = _shape_of_messages(buffer, int(starts[0]))
            if shape is None:
                tally.problems.append("a message record is damaged")
                starts = starts[1:]
                continue
            in_reach = starts[starts + shape.itemsize <= len(buffer)]
            heads = _heads(buffer, in_reach, shape)
            n_alike = len(in_reach)
            if not _is_shaped(heads, shape):
                n_alike = int(np.argmin([_is_shaped(heads[i : i + 1], shape) for i in range(len(heads))]))
            heads = heads[:n_alike]
            numbers, codes = np.unique(heads["conn"], return_inverse=True)
            table = np.array([self._code(int(number)) for number in numbers], np.int64)
            yield from by_channel(
                self._channels,
                table[codes],
                is_wanted,
                tally,
                buffer,
                starts[:n_alike] + shape.itemsize,
                heads["size"].astype(np.int64),
                heads["seconds"].astype(np.int64) * 1_000_000_000 + heads["nanoseconds"].astype(np.int64),
                None,
            )
            starts = starts[n_alike:]

    def _code(self, number: int) -> int:
        if number not in self._code_of_connection:
            self._code_of_connection[number] = len(self._channels)
            self._channels.append(None)
        return self._code_of_connection[number]


def _fields(header: bytes | memoryview) -> dict[str, bytes] | None:
    """Fields of a record header; null if it is damaged."""
    fields: dict[str, bytes] = {}
    header = bytes(header)
    pos = 0
    while pos < len(header):
        if pos + 4 > len(header):
            return None
        (length,) = _U32.unpack_from(header, pos)
        pos += 4
        name, equals, value = header[pos : pos + length].partition(b"=")
        if pos + length > len(header) or not equals:
            return None
        fields[name.decode(errors="replace")] = value
        pos += length
    return fields


def _read_head(file: BinaryIO, size: int) -> tuple[dict[str, bytes], int] | None:
    """Header of the next record and the size of its data, which comes next; null if it is not all there."""
    prefix = file.read(4)
    if len(prefix) < 4:
        return None
    (length,) = _U32.unpack(prefix)
    if length > _MOST_HEADER or file.tell() + length + 4 > size:
        return None
    fields = _fields(file.read(length))
    n_data = file.read(4)
    if fields is None or len(n_data) < 4:
        return None
    return fields, _U32.unpack(n_data)[0]


def _record_at(buffer: Bytes, pos: int) -> tuple[dict[str, bytes], int, int] | None:
    """Header, start of data and end of the record at ``pos``; null if it is not all there."""
    size = len(buffer)
    if pos + 8 > size:
        return None
    (length,) = _U32.unpack_from(buffer.data, pos)
    body = pos + 4 + length
    if length > _MOST_HEADER or body + 4 > size:
        return None
    fields = _fields(buffer.data[pos + 4 : body])
    end = body + 4 + _U32.unpack_from(buffer.data, body)[0]
    if fields is None or end > size:
        return None
    return fields, body + 4, end


def _shape_of_messages(buffer: Bytes, pos: int) -> np.dtype | None:
    """How a message record begins, if all have their header's fields in the order of the one at ``pos``.

    Every header holds the same fields of the same sizes, but no order is prescribed.
    """
    record = _record_at(buffer, pos)
    if record is None:
        return None
    fields, body, _ = record
    if (
        fields.get("op") != bytes([_MESSAGE])
        or len(fields.get("conn", b"")) != 4
        or len(fields.get("time", b"")) != 8
    ):
        return None
    places = {"head": (0, "<u4"), "size": (body - 4 - pos, "<u4")}
    at = 4
    for name, value in fields.items():
        value_at = at + 4 + len(name) + 1
        if name == "op":
            # Its name, the equals sign and its value: what shows that a header is ordered like this one.
            places["op"] = (at, "<u8")
        elif name == "conn":
            places["conn_name"] = (at, "<u8")
            places["conn"] = (value_at, "<u4")
        elif name == "time":
            places["seconds"], places["nanoseconds"] = (value_at, "<u4"), (value_at + 4, "<u4")
        at = value_at + len(value)
    return np.dtype(
        {
            "names": list(places),
            "formats": [code for _, code in places.values()],
            "offsets": [place for place, _ in places.values()],
            "itemsize": body - pos,
        }
    )


_OP_FIELD = int.from_bytes(b"\x04\0\0\0op=\x02", "little")
_CONN_NAME = int.from_bytes(b"\x09\0\0\0conn", "little")


def _is_shaped(heads: np.ndarray, shape: np.dtype) -> bool:
    """Whether all these message heads have the length and order of ``shape``."""
    is_shaped = heads["head"] == shape.itemsize - 8
    is_shaped &= heads["op"] == _OP_FIELD
    is_shaped &= heads["conn_name"] == _CONN_NAME
    return bool(is_shaped.all())


def _heads(buffer: Bytes, starts: Times, shape: np.dtype) -> np.ndarray:
    windows = np.lib.stride_tricks.sliding_window_view(buffer, shape.itemsize)
    return windows[starts].view(shape)[:, 0]
