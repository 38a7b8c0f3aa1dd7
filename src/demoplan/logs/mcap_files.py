"""MCAP files: chunked or not, indexed or not, whole or cut short.

The file is read forwards, once, without its summary: valid files exist whose summary is incomplete, and a
file that was cut has none. Within a chunk the message indexes that follow it give every message's place as
arrays; they are used if they account for each byte of the chunk, otherwise the records are walked.

Source: MCAP format specification, version 0, https://mcap.dev/spec.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from demoplan.errors import LogError
from demoplan.logs import compression
from demoplan.logs.compression import BrokenStreamError, Part, UnknownCompressionError
from demoplan.logs.messages import (
    MOST_BYTES,
    Block,
    Bytes,
    Channel,
    Tally,
    Times,
    TopicFilter,
    by_channel,
    stretches,
)

MAGIC = b"\x89MCAP0\r\n"

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX, _STATISTICS, _DATA_END = 2, 3, 4, 5, 6, 7, 11, 15
_PREFIX = struct.Struct("<BQ")
_MESSAGE_HEAD = np.dtype(
    {
        "names": ["op", "length", "channel", "log", "publish"],
        "formats": ["u1", "<u8", "<u2", "<u8", "<u8"],
        "offsets": [0, 1, 9, 15, 23],
        "itemsize": 31,
    }
)
_INDEX_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])


class McapFile:
    """One MCAP file, read forwards in bounded memory."""

    format = "mcap"

    def __init__(self, path: Path, *, check_crc: bool = False) -> None:
        """Take the path; nothing is read before ``blocks``.

        Args:
            path: The file.
            check_crc: Compare each chunk's checksum, where it has one.
        """
        self.path = path
        self._check_crc = check_crc
        self._schemas: dict[int, tuple[str, str, bytes]] = {}
        self._channels: list[Channel | None] = []

    def blocks(self, is_wanted: TopicFilter, tally: Tally) -> Iterator[Block]:
        """Payloads of the wanted topics, in file order; every message is counted in ``tally``."""
        with self.path.open("rb", buffering=2**18) as file:
            size = self.path.stat().st_size
            if file.read(len(MAGIC)) != MAGIC:
                raise LogError(self.path, "not an MCAP file: it does not begin with MCAP's magic bytes")
            yield from self._records(file, size, is_wanted, tally)

    def _records(self, file: BinaryIO, size: int, is_wanted: TopicFilter, tally: Tally) -> Iterator[Block]:
        is_data, n_declared, n_before = True, None, sum(tally.channels.values())
        while True:
            at = file.tell()
            prefix = file.read(_PREFIX.size)
            if len(prefix) < _PREFIX.size:
                tally.problems.append(f"it ends at byte {size} without a footer")
                break
            op, length = _PREFIX.unpack(prefix)
            if op == 0 or at + _PREFIX.size + length > size:
                what = (
                    "a record of no known kind"
                    if op == 0
                    else f"a record of {length} bytes that is not all there"
                )
                tally.problems.append(f"at byte {at} of {size} begins {what}")
                if op == _CHUNK:
                    yield from self._chunk(file, size - at - _PREFIX.size, at, is_wanted, tally)
                break
            if op == _FOOTER:
                self._check_end(file, length, tally)
                break
            if op == _DATA_END:
                is_data = False
                file.seek(length, 1)
            elif op == _STATISTICS:
                n_declared = struct.unpack_from("<Q", file.read(length))[0]
            elif not is_data:
                file.seek(length, 1)
            elif op == _CHUNK:
                yield from self._chunk(file, length, at, is_wanted, tally)
            elif op == _MESSAGE:
                file.seek(at)
                yield from self._loose(file, length, is_wanted, tally)
            elif op in (_SCHEMA, _CHANNEL):
                self._declare(op, file.read(length), at, tally)
            else:
                file.seek(length, 1)
        n_found = sum(tally.channels.values()) - n_before
        if n_declared is not None and n_declared != n_found:
            tally.remarks.append(f"its statistics speak of {n_declared} messages where {n_found} were found")

    def _check_end(self, file: BinaryIO, length: int, tally: Tally) -> None:
        file.seek(length, 1)
        if file.read(len(MAGIC)) != MAGIC:
            tally.problems.append("its closing magic bytes are missing")

    def _declare(self, op: int, data: bytes | memoryview, at: int, tally: Tally) -> None:
        """Take up a schema or channel record."""
        data = bytes(data)
        try:
            if op == _SCHEMA:
                (schema_id,) = struct.unpack_from("<H", data)
                name, pos = _string(data, 2)
                encoding, pos = _string(data, pos)
                (n_bytes,) = struct.unpack_from("<I", data, pos)
                if schema_id:
                    self._schemas[schema_id] = (name, encoding, data[pos + 4 : pos + 4 + n_bytes])
                return
            channel_id, schema_id = struct.unpack_from("<HH", data)
            topic, pos = _string(data, 4)
            encoding, pos = _string(data, pos)
        except (struct.error, UnicodeDecodeError):
            tally.problems.append(f"the record at byte {at} is damaged")
            return
        if schema_id and schema_id not in self._schemas:
            tally.remarks.append(f"topic {topic} names schema {schema_id}, which the log does not hold")
        name, schema_encoding, schema = self._schemas.get(schema_id, ("", "", b""))
        channel = Channel(topic, name, encoding, schema_encoding, schema)
        if len(self._channels) <= channel_id:
            self._channels += [None] * (channel_id + 1 - len(self._channels))
        self._channels[channel_id] = channel
        tally.declare(channel)

    def _chunk(
        self, file: BinaryIO, length: int, at: int, is_wanted: TopicFilter, tally: Tally
    ) -> Iterator[Block]:
        """Messages of a chunk, whose record body of ``length`` bytes (or what is left of it) comes next."""
        end = file.tell() + length
        head = file.read(min(32, length))
        if len(head) < 32:
            file.seek(end)
            return
        _, _, unpacked, crc, n_name = struct.unpack("<QQQII", head)
        name = file.read(min(n_name, 64)).decode(errors="replace")
        (packed,) = struct.unpack("<Q", file.read(8).ljust(8, b"\0"))
        available = max(end - file.tell(), 0)
        tally.facts.setdefault("compression", name or "none")
        try:
            if packed <= available and packed <= MOST_BYTES and unpacked <= MOST_BYTES:
                data = compression.whole(name, file.read(packed), unpacked)
                file.seek(end)
                indexes = self._indexes_after(file)
                if self._check_crc and crc and zlib.crc32(data) != crc:
                    tally.problems.append(f"the checksum of the chunk at byte {at} does not fit its content")
                yield from self._whole_chunk(np.frombuffer(data, np.uint8), indexes, at, is_wanted, tally)
                return
            source = Part(file, min(packed, available))
            yield from self._stream(compression.pieces(name, source, unpacked), at, is_wanted, tally)
        except BrokenStreamError as error:
            if packed <= available:
                tally.problems.append(f"the chunk at byte {at} does not decompress in full: {error}")
        except UnknownCompressionError:
            raise LogError(
                self.path, f"the chunk at byte {at} is compressed by {name!r}; known: none, lz4, zstd"
            ) from None
        file.seek(end)

    def _indexes_after(self, file: BinaryIO) -> Times:
        """Places of messages in the chunk just read, from the message index records that follow; sorted."""
        parts = []
        while True:
            at = file.tell()
            prefix = file.read(_PREFIX.size)
            if len(prefix) < _PREFIX.size or prefix[0] != _INDEX:
                file.seek(at)
                break
            length = _PREFIX.unpack(prefix)[1]
            if length > MOST_BYTES:
                file.seek(at)
                break
            body = file.read(length)
            if len(body) < length or length < 6:
                file.seek(at)
                break
            n_entries = min(struct.unpack_from("<I", body, 2)[0], length - 6) // _INDEX_ENTRY.itemsize
            parts.append(np.frombuffer(body, _INDEX_ENTRY, n_entries, 6)["offset"].astype(np.int64))
        if not parts:
            return np.empty(0, np.int64)
        return (
            parts[0] if len(parts) == 1 and (np.diff(parts[0]) > 0).all() else np.sort(np.concatenate(parts))
        )

    def _whole_chunk(
        self, buffer: Bytes, indexed: Times, at: int, is_wanted: TopicFilter, tally: Tally
    ) -> Iterator[Block]:
        starts = self._tiled(buffer, indexed, at, tally)
        if starts is None:
            starts, stop = self._walk(buffer, at, tally)
            if stop < len(buffer):
                tally.problems.append(f"the chunk at byte {at} ends within a record")
        yield from self._messages(buffer, starts, is_wanted, tally)

    def _tiled(self, buffer: Bytes, starts: Times, at: int, tally: Tally) -> Times | None:
        """The indexed places if messages there, and declarations between them, make up the whole buffer."""
        if not len(starts) or starts[0] < 0 or starts[-1] + _MESSAGE_HEAD.itemsize > len(buffer):
            return None
        heads = _heads(buffer, starts)
        ends = starts + _PREFIX.size + heads["length"].astype(np.int64)
        if (heads["op"] != _MESSAGE).any():
            return None
        nexts = np.append(starts[1:], len(buffer))
        # A length that is too large for a signed number would lead back before the buffer.
        if (ends < starts + _MESSAGE_HEAD.itemsize).any() or (ends > nexts).any():
            return None
        is_gap = ends != nexts
        gaps = [(0, int(starts[0])), *zip(ends[is_gap].tolist(), nexts[is_gap].tolist(), strict=True)]
        declarations = []
        for begin, end in gaps:
            pos = begin
            while pos < end:
                if pos + _PREFIX.size > end:
                    return None
                op, length = _PREFIX.unpack_from(buffer.data, pos)
                if op not in (_SCHEMA, _CHANNEL):
                    return None
                declarations.append((op, pos, length))
                pos += _PREFIX.size + length
            if pos != end:
                return None
        for op, pos, length in declarations:
            body = pos + _PREFIX.size
            self._declare(op, buffer.data[body : body + length], at, tally)
        return starts

    def _walk(self, buffer: Bytes, at: int, tally: Tally) -> tuple[Times, int]:
        """Places of all whole message records from the start, and where the first other thing begins."""
        starts: list[int] = []
        pos, size, unpack, data = 0, len(buffer), _PREFIX.unpack_from, buffer.data
        while pos + 9 <= size:
            op, length = unpack(data, pos)
            end = pos + 9 + length
            if end > size:
                break
            if op == _MESSAGE and length >= 22:
                starts.append(pos)
            elif op in (_SCHEMA, _CHANNEL):
                self._declare(op, buffer.data[pos + 9 : end], at, tally)
            elif op in (0, _CHUNK, _INDEX, _DATA_END, _FOOTER):
                break
            pos = end
        return np.array(starts, np.int64), pos

    def _messages(
        self, buffer: Bytes, starts: Times, is_wanted: TopicFilter, tally: Tally
    ) -> Iterator[Block]:
        if not len(starts):
            return
        heads = _heads(buffer, starts)
        codes = heads["channel"].astype(np.int64)
        missing = int(codes.max()) + 1 - len(self._channels)
        if missing > 0:
            self._channels += [None] * missing
        yield from by_channel(
            self._channels,
            codes,
            is_wanted,
            tally,
            buffer,
            starts + _MESSAGE_HEAD.itemsize,
            heads["length"].astype(np.int64) - 22,
            heads["log"].astype(np.int64),
            heads["publish"].astype(np.int64),
        )

    def _loose(self, file: BinaryIO, first: int, is_wanted: TopicFilter, tally: Tally) -> Iterator[Block]:
        """Messages that stand in the file itself, from the next record up to the first of another kind."""
        at = file.tell()
        data = file.read(max(MOST_BYTES // 4, first + _PREFIX.size))
        buffer = np.frombuffer(data, np.uint8)
        starts, stop = self._walk(buffer, at, tally)
        tally.facts.setdefault("compression", "none")
        yield from self._messages(buffer, starts, is_wanted, tally)
        file.seek(at + stop)

    def _stream(
        self, parts: Iterator[bytes], at: int, is_wanted: TopicFilter, tally: Tally
    ) -> Iterator[Block]:
        """Messages of a chunk that is too large to hold, or cut short, as far as its bytes go."""
        held, n_held = [], 0
        need = MOST_BYTES // 4
        broken: BrokenStreamError | None = None
        while True:
            piece = None
            try:
                piece = next(parts, None)
            except BrokenStreamError as error:
                broken = error
            if piece is not None:
                held.append(piece)
                n_held += len(piece)
                if n_held < need:
                    continue
            buffer = np.frombuffer(b"".join(held), np.uint8)
            starts, stop = self._walk(buffer, at, tally)
            yield from self._messages(buffer, starts, is_wanted, tally)
            if piece is None:
                if stop < len(buffer):
                    tally.problems.append(f"the chunk at byte {at} ends within a record")
                break
            rest = buffer[stop:].tobytes()
            held, n_held = [rest], len(rest)
            missing = _PREFIX.unpack_from(rest)[1] + _PREFIX.size if len(rest) >= _PREFIX.size else 0
            need = max(MOST_BYTES // 4, missing)
        if broken is not None:
            raise broken


def _heads(buffer: Bytes, starts: Times) -> np.ndarray:
    """Heads of the message records at ``starts``, as a structured array."""
    return stretches(buffer, starts, _MESSAGE_HEAD.itemsize).view(_MESSAGE_HEAD)[:, 0]


def _string(data: bytes, pos: int) -> tuple[str, int]:
    (n_bytes,) = struct.unpack_from("<I", data, pos)
    end = pos + 4 + n_bytes
    if end > len(data):
        raise struct.error("string ends outside its record")
    return data[pos + 4 : end].decode(), end
