"""A log, with or without a mapping, to a report on it: what ``demoplan doctor`` shows."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from demoplan.logs.columns import XYZ, XYZW, Columns, Decoder, Field, MissingFieldError, Wanted
from demoplan.logs.decoding import decoder_for
from demoplan.logs.definitions import Definitions, UnknownTypeError
from demoplan.logs.diagnosing import InspectParams, frame_findings, log_findings, topic_findings
from demoplan.logs.fitting import fit
from demoplan.logs.layouts import Interner
from demoplan.logs.messages import Block, Channel, Tally
from demoplan.logs.opening import files_of, note_missing_files
from demoplan.logs.reading import definitions_of
from demoplan.logs.reporting import ClockReport, Finding, LogReport, TopicReport, TransformReport
from demoplan.logs.sampling import STAMP_PATHS, wanted_of
from demoplan.logs.watching import FrameGraph, PoseWatch, TopicWatch
from demoplan.manifests.mapping import Mapping, TransformsTopic

_POSITIONS = ("pose.position", "pose.pose.position", "transform.translation", "translation", "position")
_ORIENTATIONS = ("pose.orientation", "pose.pose.orientation", "transform.rotation", "rotation", "orientation")
_MESSAGE_FIELDS = Wanted(
    (
        Field("stamp", STAMP_PATHS, "stamp", is_required=False),
        Field("position", _POSITIONS, "numbers", XYZ, is_required=False),
        Field("orientation", _ORIENTATIONS, "numbers", XYZW, is_required=False),
    )
)
_TRANSFORMS = re.compile(r"(tf2?_msgs|tf)/(msg/)?(TF|tf)Message|foxglove(_msgs/msg/|/|\.)FrameTransforms")
_SEVERITIES = ("error", "warning", "note")


def inspect(
    path: Path | str,
    mapping: Mapping | None = None,
    *,
    definitions_root: Path | str | None = None,
    params: InspectParams = InspectParams(),
) -> LogReport:
    """A report on a log.

    Args:
        path: An MCAP file, ROS 1 bag, ``.db3`` file, or a folder with the files of a rosbag2.
        mapping: If given, the report also says how the log fits it.
        definitions_root: Folder that the mapping's ``definitions`` are relative to.
        params: From where on something is reported.

    Raises:
        LogError: If there is nothing, or what is there is no log.
    """
    path = Path(path)
    inspection = _Inspection(path, definitions_of(mapping, definitions_root), params)
    inspection.run()
    findings = [*inspection.findings()]
    if mapping is not None:
        findings += fit(path, mapping, definitions_root, inspection.topics, inspection.graph, params)
    findings.sort(key=lambda finding: (_SEVERITIES.index(finding.severity), finding.subject, finding.rule))
    return inspection.report(tuple(findings))


class _Inspection:
    """One pass over a log, that decodes stamps, poses and transforms wherever types have them."""

    def __init__(self, path: Path, definitions: Definitions, params: InspectParams) -> None:
        self.path = path
        self.params = params
        self.definitions = definitions
        self.tally = Tally()
        self.files = files_of(path)
        self.formats: list[str] = []
        self.topics: dict[str, TopicWatch] = {}
        self.graph = FrameGraph()
        self.interner = Interner()
        self._decoders: dict[Channel, Decoder | None] = {}

    def run(self) -> None:
        """Read the log."""
        note_missing_files(self.path, self.files, self.tally)
        for file in self.files:
            with file.container(self.tally, check_crc=True) as container:
                if container.format not in self.formats:
                    self.formats.append(container.format)
                for block in container.blocks(lambda _: True, self.tally):
                    self._see(block)
        for watch in self.topics.values():
            watch.settle(self.params.jump_s)
        for channel in self.tally.channels:
            self.topics.setdefault(channel.topic, TopicWatch())
            self._decoder(channel)

    def _see(self, block: Block) -> None:
        watch = self.topics.setdefault(block.channel.topic, TopicWatch())
        if len(block.indexes) and block.indexes[0] > watch.last_index:
            watch.settle(self.params.jump_s)
        watch.last_index = max(watch.last_index, int(block.indexes[-1]))
        watch.note("log", block.indexes, block.log_ns, block.log_ns)
        if block.publish_ns is not None:
            watch.note("publish", block.indexes, block.publish_ns, block.log_ns)
        decoder = self._decoder(block.channel)
        if decoder is None:
            return
        try:
            columns = decoder.decode(block)
        except MissingFieldError as error:
            self._decoders[block.channel] = None
            watch.problems.append(str(error))
            return
        for count, why in columns.refused:
            watch.n_refused += count
            if why not in watch.problems:
                watch.problems.append(why)
        self._see_columns(watch, block, columns)

    def _see_columns(self, watch: TopicWatch, block: Block, columns: Columns) -> None:
        if (stamps := columns.stamps.get("stamp")) is not None and len(stamps):
            # Of the transforms of one message, the first one's stamp counts.
            is_first = np.diff(columns.message, prepend=-1) != 0
            rows = columns.message[is_first]
            watch.note("header", block.indexes[rows], stamps[is_first], block.log_ns[rows])
        position, orientation = columns.numbers.get("position"), columns.numbers.get("orientation")
        if position is not None or orientation is not None:
            watch.poses = watch.poses or PoseWatch(self.params.quaternion_tolerance)
            watch.poses.see(position, orientation)
        if "name" in columns.texts:
            self.graph.see(columns.texts["frame"], columns.texts["name"], self.interner.texts)

    def _decoder(self, channel: Channel) -> Decoder | None:
        if channel not in self._decoders:
            self._decoders[channel] = None
            wanted = _MESSAGE_FIELDS
            if _TRANSFORMS.fullmatch(channel.message_type):
                wanted = wanted_of(TransformsTopic(kind="transforms"))
            try:
                self._decoders[channel] = decoder_for(channel, wanted, self.definitions, self.interner)
            except (UnknownTypeError, MissingFieldError) as error:
                self.topics.setdefault(channel.topic, TopicWatch()).problems.append(str(error))
        return self._decoders[channel]

    def report(self, findings: tuple[Finding, ...]) -> LogReport:
        """The report, with the findings given."""
        topics = tuple(self._topic_report(topic) for topic in sorted(self.topics))
        logs = [watch.clocks["log"] for watch in self.topics.values() if "log" in watch.clocks]
        stamped = [clock for clock in logs if clock.n_stamps]
        edges = sorted(self.graph.edges.items())
        problems = list(dict.fromkeys(self.tally.problems))
        return LogReport(
            path=str(self.path),
            format=", ".join(self.formats),
            compression=self.tally.facts.get("compression", "none"),
            files=tuple(file.path.name for file in self.files),
            n_bytes=sum(file.path.stat().st_size for file in self.files),
            status="truncated" if problems else "complete",
            reason="; ".join(problems) or None,
            n_messages=sum(self.tally.channels.values()),
            start_ns=min((clock.earliest_ns for clock in stamped), default=None),
            end_ns=max((clock.latest_ns for clock in stamped), default=None),
            topics=topics,
            transforms=tuple(
                TransformReport(parent=parent, child=child, n_transforms=count)
                for (parent, child), count in edges
            ),
            trees=self.graph.trees,
            findings=findings,
        )

    def _topic_report(self, topic: str) -> TopicReport:
        watch = self.topics[topic]
        members = [channel for channel in self.tally.channels if channel.topic == topic]
        log = watch.clocks.get("log")
        return TopicReport(
            topic=topic,
            message_type=", ".join(dict.fromkeys(member.message_type for member in members)),
            encoding=", ".join(dict.fromkeys(member.encoding for member in members)),
            n_messages=sum(self.tally.channels[member] for member in members),
            rate_hz=None if log is None else log.rate_hz,
            largest_gap_s=None if log is None or log.n_stamps < 2 else log.largest_gap_s,
            is_decodable=all(self._decoders.get(member) is not None for member in members),
            clocks=tuple(
                ClockReport(
                    clock=name,
                    first_ns=clock.first_ns,
                    last_ns=clock.last_ns,
                    n_zero=clock.n_zero,
                    n_backwards=clock.n_backwards,
                    n_jumps=clock.n_jumps,
                    largest_jump_s=clock.largest_jump_s,
                )
                for name, clock in sorted(watch.clocks.items())
            ),
        )

    def findings(self) -> Iterator[Finding]:
        """What is wrong with the log by itself."""
        yield from log_findings(self.tally, self.topics, self.params)
        for topic, watch in sorted(self.topics.items()):
            members = [channel for channel in self.tally.channels if channel.topic == topic]
            types = sorted({member.message_type for member in members})
            is_decodable = all(self._decoders.get(member) is not None for member in members)
            yield from topic_findings(topic, watch, types, is_decodable, self.params)
        yield from frame_findings(self.graph)
