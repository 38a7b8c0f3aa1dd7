"""rosbag2's sqlite3 files: with or without definitions, compressed by message or not, closed cleanly or not.

Source: https://github.com/ros2/rosbag2/tree/rolling/rosbag2_storage_sqlite3 (schema versions 1 to 4).
"""

import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

import numpy as np
import zstandard
from numpy.typing import NDArray

from demoplan.errors import LogError
from demoplan.logs.compression import ZSTD_MAGIC
from demoplan.logs.messages import Block, Channel, Tally, TopicFilter, by_channel

MAGIC = b"SQLite format 3\0"
_BATCH_BYTES = 2**20
"""Payloads decoded at a time: few enough that they stay in the processor's cache."""
_ROW_BYTES = 64
"""What a row counts beside its payload, so that many without one do not gather without bound."""
_MOST_MESSAGE = 2**30


class Rosbag2Sqlite:
    """One ``.db3`` file, read in the order in which it was written, in bounded memory."""

    format = "rosbag2-sqlite3"

    def __init__(self, path: Path) -> None:
        """Take the path; nothing is read before ``blocks``."""
        self.path = path

    def blocks(self, is_wanted: TopicFilter, tally: Tally) -> Iterator[Block]:
        """Payloads of the wanted topics, in file order; every message is counted in ``tally``."""
        with self._opened(tally) as database:
            channels = self._channels(database, tally)
            for channel in channels.values():
                tally.declare(channel)
            try:
                yield from self._messages(database, channels, is_wanted, tally)
            except sqlite3.DatabaseError as error:
                tally.problems.append(f"the database is damaged, what follows is lost: {error}")

    @contextmanager
    def _opened(self, tally: Tally) -> Iterator[sqlite3.Connection]:
        """The database, opened so that nothing is written beside the log.

        A recorder that was killed leaves its last messages in a ``-wal`` file. To read that, sqlite3 must
        write into the folder: so a copy is read instead.
        """
        wal = self.path.with_name(self.path.name + "-wal")
        with tempfile.TemporaryDirectory(prefix="demoplan-") as folder:
            path = self.path
            if wal.is_file() and wal.stat().st_size > 0:
                path = Path(folder) / "log.db3"
                shutil.copyfile(self.path, path)
                shutil.copyfile(wal, path.with_name(path.name + "-wal"))
                tally.remarks.append("it was never closed: messages were taken from its write-ahead log, too")
                uri = f"file:{quote(str(path))}"
            else:
                uri = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
            try:
                database = sqlite3.connect(uri, uri=True)
            except sqlite3.Error as error:
                raise LogError(self.path, f"sqlite3 does not open it: {error}") from None
            with closing(database):
                # sqlite3 refuses a file that was cut, unless told so; nothing is ever written.
                database.execute("PRAGMA writable_schema = ON")
                database.execute("PRAGMA trusted_schema = OFF")
                if path is self.path and (lost := _n_lost(path)):
                    tally.problems.append(f"the database is cut: its last {lost} bytes are missing")
                database.text_factory = lambda data: data.decode(errors="replace")
                yield database

    def _channels(self, database: sqlite3.Connection, tally: Tally) -> dict[int, Channel]:
        try:
            tables = {
                name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            }
            if not {"topics", "messages"} <= tables:
                raise LogError(
                    self.path,
                    f"a database, but not a rosbag2: it has no tables 'topics' and 'messages'; "
                    f"found: {', '.join(sorted(tables)) or 'none'}",
                )
            columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
            definitions: dict[str, tuple[str, bytes]] = {}
            if "message_definitions" in tables:
                query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
                for name, encoding, text in database.execute(f"{query} ORDER BY id"):
                    definitions[name] = (encoding or "", (text or "").encode())
            profiles = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
            channels = {}
            for number, topic, message_type, encoding, profile in database.execute(
                f"SELECT id, name, type, serialization_format, {profiles} FROM topics ORDER BY id"  # noqa: S608
            ):
                schema_encoding, schema = definitions.get(message_type, ("", b""))
                # QoS durability 1 is transient local: what ROS 1 calls latched.
                is_latched = "durability: 1" in str(profile) or "transient_local" in str(profile)
                channels[number] = Channel(topic, message_type, encoding, schema_encoding, schema, is_latched)
        except sqlite3.DatabaseError as error:
            raise LogError(self.path, f"sqlite3 cannot read its list of topics: {error}") from None
        tally.facts.setdefault("compression", "none")
        return channels

    def _messages(
        self, database: sqlite3.Connection, channels: dict[int, Channel], is_wanted: TopicFilter, tally: Tally
    ) -> Iterator[Block]:
        codes = {number: code for code, number in enumerate(channels)}
        known: list[Channel | None] = [*channels.values(), None]
        wanted = [number for number, channel in channels.items() if is_wanted(channel.topic)]
        columns = {row[1] for row in database.execute("PRAGMA table_info(messages)")}
        published = "send_timestamp" if "send_timestamp" in columns else "NULL"
        stamp = "timestamp" if "timestamp" in columns else "recv_timestamp"
        # Unwanted payloads stay unread, on pages of their own; their rows are counted in the same pass. The
        # order of rows is the order of recording.
        is_all = len(wanted) == len(channels)
        chosen = ",".join(str(number) for number in wanted)
        data = "data" if is_all else f"CASE WHEN topic_id IN ({chosen}) THEN data END"
        cursor = database.execute(
            f"SELECT topic_id, {stamp}, {published}, {data} FROM messages ORDER BY id"  # noqa: S608
        )
        broken: sqlite3.DatabaseError | None = None
        while broken is None:
            rows: list[tuple[int, int, int | None, bytes | None]] = []
            n_bytes = 0
            try:
                while n_bytes < _BATCH_BYTES:
                    some = cursor.fetchmany(128)
                    if not some:
                        break
                    rows += some
                    n_bytes += sum([len(row[3] or b"") for row in some]) + len(some) * _ROW_BYTES
            except sqlite3.DatabaseError as error:
                broken = error
            if rows:
                yield from self._block(rows, codes, known, is_wanted, tally)
            elif broken is None:
                return
        raise broken

    def _block(
        self,
        rows: list[tuple[int, int, int | None, bytes | None]],
        codes: dict[int, int],
        known: list[Channel | None],
        is_wanted: TopicFilter,
        tally: Tally,
    ) -> Iterator[Block]:
        numbers, log, publish, data = zip(*rows, strict=True)
        payloads: tuple[bytes, ...] = data
        if set(map(type, data)) != {bytes}:
            payloads = tuple(item if isinstance(item, bytes) else b"" for item in data)
        # All messages of a file are compressed, or none.
        if payloads[-1][:4] == ZSTD_MAGIC or payloads[0][:4] == ZSTD_MAGIC:
            payloads = tuple(_unpacked(payload) for payload in payloads)
            tally.facts["compression"] = "zstd, by message"
        lengths = np.fromiter(map(len, payloads), np.int64, len(payloads))
        starts = np.cumsum(lengths) - lengths
        has_publish = publish[0] is not None and all(value is not None for value in publish)
        try:
            log_ns = np.array(log, np.int64)
            publish_ns = np.array(publish, np.int64) if has_publish else None
        except (TypeError, ValueError, OverflowError):
            raise LogError(self.path, "its messages have time stamps that are no 64-bit integers") from None
        yield from by_channel(
            known,
            _coded(numbers, codes),
            is_wanted,
            tally,
            np.frombuffer(b"".join(payloads), np.uint8),
            starts,
            lengths,
            log_ns,
            publish_ns,
        )


def _n_lost(path: Path) -> int:
    """How many bytes a database lacks, by the size in its header."""
    with path.open("rb") as file:
        head = file.read(32)
    if len(head) < 32:
        return 0
    page = int.from_bytes(head[16:18], "big")
    n_pages = int.from_bytes(head[28:32], "big")
    return max(n_pages * (65536 if page == 1 else page) - path.stat().st_size, 0)


def _coded(numbers: tuple[int, ...], codes: dict[int, int]) -> NDArray[np.int64]:
    """Codes of topic numbers; the one after the last for a topic that is not declared."""
    found = np.full(len(numbers), len(codes), np.int64)
    asked = np.array(numbers, np.int64)
    for number, code in codes.items():
        found[asked == number] = code
    return found


def _unpacked(payload: bytes) -> bytes:
    """A message that was compressed by itself. A payload of CDR never begins like zstd."""
    if payload[:4] != ZSTD_MAGIC:
        return payload
    size = zstandard.frame_content_size(payload)
    if size > _MOST_MESSAGE:
        return b""
    try:
        return zstandard.ZstdDecompressor().decompress(payload, max_output_size=max(size, 2**26))
    except zstandard.ZstdError:
        return b""
