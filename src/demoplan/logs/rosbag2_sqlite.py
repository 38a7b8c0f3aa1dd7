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

from demoplan.errors import LogError
from demoplan.logs.compression import ZSTD_MAGIC
from demoplan.logs.messages import MOST_BYTES, Block, Channel, Tally, TopicFilter, by_channel

MAGIC = b"SQLite format 3\0"
_BATCH_BYTES = MOST_BYTES // 8
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

        A recorder that was killed leaves its last messages in a ``-wal`` file. Reading that needs write access
        to the folder, so that a copy is read instead.
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
                query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions ORDER BY id"
                for name, encoding, text in database.execute(query):
                    definitions[name] = (encoding or "", (text or "").encode())
            profiles = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
            channels = {}
            for number, topic, message_type, encoding, profile in database.execute(
                f"SELECT id, name, type, serialization_format, {profiles} FROM topics ORDER BY id"
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
        others = database.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id").fetchall()
        for number, n_messages in others:
            channel = channels.get(number)
            if channel is None:
                tally.problems.append(
                    f"{n_messages} messages of a topic that the log never declares were left out"
                )
            elif number not in wanted:
                tally.count(channel, n_messages)
                tally.take_indexes(channel.topic, n_messages)
        if not wanted:
            return
        # Payloads of other topics lie on pages that are never read. Row order is the order of recording.
        chosen = ",".join(str(number) for number in wanted)
        cursor = database.execute(
            f"SELECT topic_id, {stamp}, {published}, data FROM messages "  # noqa: S608 (integers and own names)
            f"WHERE topic_id IN ({chosen}) ORDER BY id"
        )
        broken: sqlite3.DatabaseError | None = None
        while broken is None:
            rows: list[tuple[int, int, int | None, bytes]] = []
            n_bytes = 0
            try:
                while n_bytes < _BATCH_BYTES:
                    some = cursor.fetchmany(64)
                    if not some:
                        break
                    rows += some
                    n_bytes += sum([len(row[3]) for row in some])
            except sqlite3.DatabaseError as error:
                broken = error
            if rows:
                yield from self._block(rows, codes, known, is_wanted, tally)
            elif broken is None:
                return
        raise broken

    def _block(
        self,
        rows: list[tuple[int, int, int | None, bytes]],
        codes: dict[int, int],
        known: list[Channel | None],
        is_wanted: TopicFilter,
        tally: Tally,
    ) -> Iterator[Block]:
        numbers, log, publish, payloads = zip(*rows, strict=True)
        if any(payload[:4] == ZSTD_MAGIC for payload in payloads[:1]):
            payloads = tuple(_unpacked(payload) for payload in payloads)
            tally.facts["compression"] = "zstd, by message"
        lengths = np.fromiter(map(len, payloads), np.int64, len(payloads))
        starts = np.cumsum(lengths) - lengths
        has_publish = publish[0] is not None and all(value is not None for value in publish)
        yield from by_channel(
            known,
            np.array([codes[number] for number in numbers], np.int64),
            is_wanted,
            tally,
            np.frombuffer(b"".join(payloads), np.uint8),
            starts,
            lengths,
            np.array(log, np.int64),
            np.array(publish, np.int64) if has_publish else None,
        )


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
