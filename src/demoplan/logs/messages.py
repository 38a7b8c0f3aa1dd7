"""What every container gives: payloads of one channel at a time, many at once, and how the log stands."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Bytes: TypeAlias = NDArray[np.uint8]
Times: TypeAlias = NDArray[np.int64]
TopicFilter: TypeAlias = Callable[[str], bool]

MOST_BYTES = 32 * 2**20
"""Containers read larger things than this in pieces, so that memory stays bounded [bytes]."""


@dataclass(frozen=True)
class Channel:
    """Messages of one type on one topic, as the log declares them."""

    topic: str
    message_type: str
    encoding: str
    """Message encoding: ``cdr``, ``ros1``, ``protobuf``, ``json`` or whatever the log says."""
    schema_encoding: str = ""
    """How the definition is written: ``ros2msg``, ``ros2idl``, ``ros1msg``, ``protobuf``, ``jsonschema``."""
    schema: bytes = b""
    """The type's definition; empty where the log has none."""
    is_latched: bool = False


@dataclass(frozen=True, eq=False)
class Block:
    """Some messages of one channel, in file order, whose payloads lie in one buffer."""

    channel: Channel
    buffer: Bytes
    starts: Times
    """First byte of each payload in ``buffer`` ``(n,)``."""
    lengths: Times
    """Bytes of each payload ``(n,)``."""
    indexes: Times
    """Which message of its topic each one is, in file order ``(n,)``."""
    log_ns: Times
    publish_ns: Times | None = None

    def payload(self, row: int) -> memoryview:
        """Bytes of one message."""
        start = int(self.starts[row])
        return self.buffer.data[start : start + int(self.lengths[row])]


@dataclass(eq=False)
class Tally:
    """What a container has seen so far: it grows while the log is read."""

    channels: dict[Channel, int] = field(default_factory=dict)
    """Messages of each channel."""
    problems: list[str] = field(default_factory=list)
    """What is missing or broken; with any of these the log counts as truncated."""
    remarks: list[str] = field(default_factory=list)
    """What is worth knowing but loses nothing."""
    facts: dict[str, str] = field(default_factory=dict)
    """Compression, chunks, writer, as the file says."""
    _next_of_topic: dict[str, int] = field(default_factory=dict)

    def declare(self, channel: Channel) -> None:
        """Note a channel, even if no message of it follows."""
        self.channels.setdefault(channel, 0)

    def count(self, channel: Channel, n_messages: int) -> None:
        """Note messages of a channel."""
        self.channels[channel] = self.channels.get(channel, 0) + n_messages

    def take_indexes(self, topic: str, n_messages: int) -> int:
        """Index of the first of ``n_messages`` further messages of a topic."""
        first = self._next_of_topic.get(topic, 0)
        self._next_of_topic[topic] = first + n_messages
        return first

    def n_of_topic(self, topic: str) -> int:
        """Messages of a topic seen so far, whatever their channel."""
        return self._next_of_topic.get(topic, 0)


class Container(Protocol):
    """One log file of some format."""

    format: str

    def blocks(self, is_wanted: TopicFilter, tally: Tally) -> Iterator[Block]:
        """Payloads of the wanted topics, in file order; every message is counted in ``tally``."""


def by_channel(
    channels: list[Channel | None],
    codes: NDArray[np.integer],
    is_wanted: TopicFilter,
    tally: Tally,
    buffer: Bytes,
    starts: Times,
    lengths: Times,
    log_ns: Times,
    publish_ns: Times | None,
) -> Iterator[Block]:
    """Messages of a stretch of file, sorted out by channel.

    Args:
        channels: What each code stands for; ``None`` for a channel that was never declared.
        codes: Which channel each message belongs to ``(n,)``, in file order.
        is_wanted: Topics whose payloads are given; the others are counted only.
        tally: Grows by every message.
        buffer: Holds all payloads.
        starts: First byte of each payload ``(n,)``.
        lengths: Bytes of each payload ``(n,)``.
        log_ns: When each was recorded ``(n,)``.
        publish_ns: When each was published ``(n,)``, if the log says.
    """
    counts = np.bincount(codes, minlength=len(channels))
    present = [int(code) for code in np.flatnonzero(counts)]
    of_topic: dict[str, list[int]] = {}
    for code in present:
        channel = channels[code]
        if channel is None:
            problem = "messages of a channel that the log never declares were left out"
            if problem not in tally.problems:
                tally.problems.append(problem)
            continue
        tally.count(channel, int(counts[code]))
        of_topic.setdefault(channel.topic, []).append(code)
    for topic, members in of_topic.items():
        n_topic = int(counts[members].sum())
        first = tally.take_indexes(topic, n_topic)
        if not is_wanted(topic):
            continue
        is_topic = None if n_topic == len(codes) else _are_any(codes, members)
        rows = np.arange(len(codes)) if is_topic is None else np.flatnonzero(is_topic)
        indexes = np.arange(first, first + n_topic, dtype=np.int64)
        for code in members:
            channel = channels[code]
            assert channel is not None
            mine: slice | NDArray[np.bool_] = slice(None) if len(members) == 1 else codes[rows] == code
            # A slice keeps views where one channel has the stretch for itself: nothing is copied.
            picked: slice | NDArray[np.intp] = (
                slice(None) if n_topic == len(codes) and len(members) == 1 else rows[mine]
            )
            yield Block(
                channel,
                buffer,
                starts[picked],
                lengths[picked],
                indexes[mine],
                log_ns[picked],
                None if publish_ns is None else publish_ns[picked],
            )


def stretches(buffer: Bytes, starts: Times, length: int) -> Bytes:
    """The ``length`` bytes from each start on, copied ``(n, length)``; each is moved as one value.

    Raises:
        ValueError: If the buffer is shorter than that.
        IndexError: If a stretch would not lie within it.
    """
    n_places = len(buffer) - length + 1
    places = np.ndarray((n_places,), f"V{length}", buffer=np.ascontiguousarray(buffer), strides=(1,))
    return places[starts].view(np.uint8).reshape(len(starts), length)


def _are_any(codes: NDArray[np.integer], members: list[int]) -> NDArray[np.bool_]:
    """Which codes are members: of few members, by comparing with each."""
    is_such = codes == members[0]
    for member in members[1:]:
        is_such |= codes == member
    return np.asarray(is_such)
