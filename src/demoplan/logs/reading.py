"""A log and a mapping to samples, as a stream of bounded tables."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import polars as pl
from dataframely import DataFrame

from demoplan.errors import LogError, UsageError
from demoplan.logs.columns import Decoder, MissingFieldError
from demoplan.logs.decoding import decoder_for
from demoplan.logs.definitions import Definitions, UnknownTypeError
from demoplan.logs.messages import Channel, Tally
from demoplan.logs.opening import files_of, note_missing_files
from demoplan.logs.sampling import TopicSampler, wanted_of
from demoplan.manifests.mapping import GripTopic, Mapping
from demoplan.tables import Samples, Topics
from demoplan.tables.validating import validated

Status: TypeAlias = Literal["complete", "truncated"]

_BATCH_ROWS = 131_072
"""A batch is given as soon as one topic has this many rows."""


@dataclass(frozen=True, eq=False)
class Reading:
    """A log, read whole."""

    samples: DataFrame[Samples]
    """Sorted by the mapping's topics; rows of one topic in file order."""
    topics: DataFrame[Topics]
    status: Status
    reason: str | None


class SampleStream:
    """Samples of one log, in bounded memory.

    ``batches`` is to be gone through once; then ``topics``, ``status`` and ``reason`` tell of the whole log.
    """

    def __init__(self, path: Path, mapping: Mapping, episode_id: str, definitions: Definitions) -> None:
        """Take what ``open_log`` has checked."""
        self._path = path
        self._files = files_of(path)
        self._mapping = mapping
        self._episode_id = episode_id
        self._definitions = definitions
        self._tally = Tally()
        self._is_read = False
        self._samplers: dict[str, list[TopicSampler]] = {}
        for label, topic in mapping.topics.items():
            if isinstance(topic, GripTopic) and topic.open_at == topic.closed_at:
                raise UsageError(
                    f"topic {label!r}: open_at and closed_at are both {topic.open_at}; "
                    "give the numbers that are recorded when the hand is open, and when it is closed"
                )
            sampler = TopicSampler(label, topic, mapping, episode_id)
            self._samplers.setdefault(topic_of(label), []).append(sampler)

    def batches(self) -> Iterator[DataFrame[Samples]]:
        """Samples of one topic at a time, in file order, at most some hundred thousand rows each.

        Raises:
            LogError: If the log cannot be read, lacks a required topic, or a type lacks a mapped field.
        """
        if self._is_read:
            raise UsageError("the batches of a log can be gone through only once; open it again")
        self._is_read = True
        decoders: dict[tuple[Channel, str], Decoder | None] = {}
        note_missing_files(self._path, self._files, self._tally)
        for file in self._files:
            with file.container(self._tally) as container:
                for block in container.blocks(self._samplers.__contains__, self._tally):
                    for sampler in self._samplers[block.channel.topic]:
                        key = (block.channel, sampler.label)
                        if key not in decoders:
                            decoders[key] = self._decoder(block.channel, sampler)
                        decoder = decoders[key]
                        if decoder is None:
                            sampler.n_rejected += len(block.starts)
                            continue
                        # Channels of a topic may interleave: a batch ends only where all before it is there.
                        if sampler.n_pending >= _BATCH_ROWS and block.indexes[0] > sampler.last_index:
                            yield sampler.take()
                        try:
                            sampler.add(block, decoder.decode(block))
                        except MissingFieldError as error:
                            raise self._refusal(block.channel, sampler, str(error)) from None
        for samplers in self._samplers.values():
            for sampler in samplers:
                if sampler.n_pending:
                    yield sampler.take()
        self._require_topics()

    def _decoder(self, channel: Channel, sampler: TopicSampler) -> Decoder | None:
        """What reads a channel for a mapped topic; null, with a note, if nothing can and it is optional."""
        wanted = wanted_of(sampler.topic)
        try:
            return decoder_for(channel, wanted, self._definitions, sampler.interner)
        except (MissingFieldError, UnknownTypeError) as error:
            if sampler.topic.required:
                raise self._refusal(channel, sampler, str(error)) from None
            sampler.notes[f"messages were left out: {error}"] += 1
            return None

    def _refusal(self, channel: Channel, sampler: TopicSampler, problem: str) -> LogError:
        kind = channel.message_type or "no declared type"
        return LogError(
            self._path, f"topic {sampler.label} ({kind}), mapped as {sampler.topic.kind!r}: {problem}"
        )

    def _require_topics(self) -> None:
        available = {channel.topic for channel in self._tally.channels}
        missing = sorted(
            topic
            for topic, samplers in self._samplers.items()
            if topic not in available and any(sampler.topic.required for sampler in samplers)
        )
        if missing:
            salvaged = f" (the log is truncated: {self.reason})" if self._tally.problems else ""
            raise LogError(
                self._path,
                f"it has no topic {', '.join(missing)}, which the mapping requires; "
                f"available: {', '.join(sorted(available)) or 'none'}{salvaged}",
            )

    @property
    def topics(self) -> DataFrame[Topics]:
        """Every topic of the log, mapped or not, and every mapped one, be it in the log or not."""
        rows = []
        for topic in sorted({*(channel.topic for channel in self._tally.channels), *self._samplers}):
            members = [channel for channel in self._tally.channels if channel.topic == topic]
            samplers = self._samplers.get(topic, [])
            notes = [note for sampler in samplers if (note := sampler.note())]
            if not members:
                notes.append("the log has no such topic")
            rows.append(
                {
                    "episode_id": self._episode_id,
                    "topic": topic,
                    "message_type": ", ".join(dict.fromkeys(member.message_type for member in members)),
                    "encoding": ", ".join(dict.fromkeys(member.encoding for member in members)),
                    "is_mapped": bool(samplers),
                    "n_messages": sum(self._tally.channels[member] for member in members),
                    "n_rows": sum(sampler.n_rows for sampler in samplers),
                    "n_rejected": max((sampler.n_rejected for sampler in samplers), default=0),
                    "note": "; ".join(notes) or None,
                }
            )
        return validated(pl.DataFrame(rows, schema=Topics.create_empty().schema), Topics)

    @property
    def status(self) -> Status:
        """Whether everything that was recorded could be read."""
        return "truncated" if self._tally.problems else "complete"

    @property
    def reason(self) -> str | None:
        """What is missing, if the log is truncated."""
        problems = list(dict.fromkeys(self._tally.problems))
        more = f"; and {len(problems) - 5} more problems" if len(problems) > 5 else ""
        return "; ".join(problems[:5]) + more if problems else None


def topic_of(label: str) -> str:
    """The topic that a mapping's key names: ``/joy#left`` and ``/joy#right`` both read ``/joy``."""
    return label.split("#", 1)[0]


def open_log(
    path: Path | str,
    mapping: Mapping,
    episode_id: str,
    *,
    definitions_root: Path | str | None = None,
) -> SampleStream:
    """A stream of samples of a log.

    Args:
        path: An MCAP file, ROS 1 bag, ``.db3`` file, or a folder with the files of a rosbag2.
        mapping: Which topics say what about which entity. Only these are decoded.
        episode_id: Goes into every row.
        definitions_root: Folder that the mapping's ``definitions`` are relative to.

    Raises:
        LogError: If there is nothing, or what is there is no log.
        UsageError: If the mapping names folders of definitions that do not exist.
    """
    return SampleStream(Path(path), mapping, episode_id, definitions_of(mapping, definitions_root))


def read(
    path: Path | str,
    mapping: Mapping,
    episode_id: str,
    *,
    definitions_root: Path | str | None = None,
) -> Reading:
    """All samples of a log at once; same bytes in, same table out. Arguments and errors: see ``open_log``."""
    stream = open_log(path, mapping, episode_id, definitions_root=definitions_root)
    by_topic: dict[str, list[pl.DataFrame]] = {label: [] for label in mapping.topics}
    for batch in stream.batches():
        by_topic[batch["topic"][0]].append(batch)
    batches = [batch for part in by_topic.values() for batch in part]
    samples = pl.concat(batches) if batches else Samples.create_empty()
    return Reading(Samples.cast(samples), stream.topics, stream.status, stream.reason)


def definitions_of(mapping: Mapping | None, root: Path | str | None) -> Definitions:
    """Where a mapping says that definitions are.

    Raises:
        UsageError: If a folder that it names is not below ``root``.
    """
    folders = []
    for name in () if mapping is None else mapping.definitions:
        if root is None:
            raise UsageError(
                f"the mapping names definitions {name!r}, but no folder is given that this is relative to"
            )
        folder = (Path(root) / name).resolve()
        if not folder.is_relative_to(Path(root).resolve()):
            raise UsageError(f"the mapping's definitions {name!r} leave {root}; give a folder below it")
        if not folder.is_dir():
            raise UsageError(f"the mapping's definitions {name!r} are no folder below {root}")
        folders.append(folder)
    return Definitions(tuple(folders))
