"""A log, with or without a mapping, to a report on it: what ``demoplan doctor`` shows."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl

from demoplan.errors import LogError, UsageError
from demoplan.logs.columns import XYZ, XYZW, Columns, Decoder, Field, MissingFieldError, Wanted
from demoplan.logs.decoding import decoder_for
from demoplan.logs.definitions import Definitions, UnknownTypeError
from demoplan.logs.layouts import Interner
from demoplan.logs.messages import Block, Channel, Tally, Times
from demoplan.logs.opening import files_of, note_missing_files
from demoplan.logs.reading import SampleStream, definitions_of, topic_of
from demoplan.logs.reporting import ClockReport, Finding, LogReport, TopicReport, TransformReport
from demoplan.logs.sampling import STAMP_PATHS, wanted_of
from demoplan.logs.watching import ClockWatch, FrameGraph, PoseWatch
from demoplan.manifests.mapping import BodiesTopic, Mapping, TransformsTopic

_S = 1e-9
_YEAR_S = 365.25 * 86400
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


@dataclass(frozen=True, kw_only=True)
class InspectParams:
    """From where on something is reported."""

    gap_s: float = 0.5
    """A topic that is silent for longer has a gap [s] …"""
    gap_intervals: float = 10.0
    """… if that is also this many of its mean intervals."""
    backwards_s: float = 0.1
    """A header or publish clock that goes back by less is remarked on only [s]."""
    jump_s: float = 1.0
    """A clock that moves this much against the log's clock between two messages jumps [s]."""
    offset_s: float = 5.0
    """A clock that is off the log's clock by more than this is remarked on [s]."""
    uptime_years: float = 10.0
    """Stamps below this count from a start, not from 1970 [years]."""
    reach_m: float = 20.0
    """A mapped position with a larger coordinate is no manipulation in metres [m]."""
    nearest_m: float = 0.002
    """A mapped body that never leaves this distance from its reference was recorded in a larger unit [m]."""
    quaternion_tolerance: float = 0.01
    """A quaternion whose norm differs from 1 by more is not of unit length."""
    untracked_share: float = 0.05
    """A mapped body that is untracked more often is remarked on."""


@dataclass(eq=False)
class _TopicWatch:
    """Everything gathered about one topic."""

    clocks: dict[str, ClockWatch] = field(default_factory=dict)
    poses: PoseWatch | None = None
    problems: list[str] = field(default_factory=list)
    n_refused: int = 0
    last_index: int = -1
    _waiting: dict[str, list[tuple[Times, Times, Times]]] = field(default_factory=dict)

    def note(self, clock: str, indexes: Times, stamps: Times, log: Times) -> None:
        """Keep stamps until ``settle``: channels of one topic interleave, and come one after the other."""
        self._waiting.setdefault(clock, []).append((indexes, stamps, log))

    def settle(self, jump_s: float) -> None:
        """Look at the stamps kept so far, in file order."""
        for clock, parts in self._waiting.items():
            indexes, stamps, log = (np.concatenate(column) for column in zip(*parts, strict=True))
            order = np.argsort(indexes, kind="stable")
            self.clocks.setdefault(clock, ClockWatch(jump_s)).see(stamps[order], log[order])
        self._waiting.clear()


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
        findings += _fit(path, mapping, definitions_root, inspection, params)
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
        self.topics: dict[str, _TopicWatch] = {}
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
            self.topics.setdefault(channel.topic, _TopicWatch())
            self._decoder(channel)

    def _see(self, block: Block) -> None:
        watch = self.topics.setdefault(block.channel.topic, _TopicWatch())
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

    def _see_columns(self, watch: _TopicWatch, block: Block, columns: Columns) -> None:
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
                self.topics.setdefault(channel.topic, _TopicWatch()).problems.append(str(error))
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
        for problem in dict.fromkeys(self.tally.problems):
            yield Finding(
                severity="warning",
                subject="log",
                rule="truncated",
                sentence=f"The log is not whole: {problem}. What it still holds is read, and its episode is marked.",
            )
        for remark in dict.fromkeys(self.tally.remarks):
            yield Finding(severity="note", subject="log", rule="container", sentence=f"{_sentence(remark)}.")
        if not sum(self.tally.channels.values()):
            yield Finding(
                severity="error",
                subject="log",
                rule="empty",
                sentence="The log holds no messages: record again, and check that the recorder subscribed to the topics.",
            )
        logs = [watch.clocks["log"] for watch in self.topics.values() if "log" in watch.clocks]
        latest_s = max((clock.latest_ns for clock in logs), default=0) * _S
        if 0 < latest_s < self.params.uptime_years * _YEAR_S:
            yield Finding(
                severity="note",
                subject="log",
                rule="log-clock-uptime",
                sentence=f"The log's clock counts from a start and not from 1970 (last stamp {latest_s:.3g} s), as "
                "in simulation: durations are right, dates are not.",
            )
        for topic in sorted(self.topics):
            yield from self._topic_findings(topic)
        yield from self._frame_findings()

    def _topic_findings(self, topic: str) -> Iterator[Finding]:
        watch, params = self.topics[topic], self.params

        def found(severity: str, rule: str, sentence: str) -> Finding:
            return Finding(severity=severity, subject=topic, rule=rule, sentence=sentence)  # type: ignore[arg-type]

        members = [channel for channel in self.tally.channels if channel.topic == topic]
        if len(kinds := sorted({member.message_type for member in members})) > 1:
            yield found("warning", "types", f"Its messages are of several types: {', '.join(kinds)}.")
        if any(self._decoders.get(member) is None for member in members):
            yield found("note", "unknown-type", f"Cannot be decoded: {'; '.join(watch.problems)}.")
        elif watch.n_refused:
            yield found(
                "warning",
                "malformed",
                f"{watch.n_refused} messages do not hold what their type says: {'; '.join(watch.problems[:3])}. "
                "Check that the definition in the log is the one that was published.",
            )
        log = watch.clocks.get("log")
        if log is not None and log.rate_hz and log.largest_gap_s > params.gap_s:
            if log.largest_gap_s * log.rate_hz > params.gap_intervals:
                yield found(
                    "warning",
                    "gap",
                    f"No message for {log.largest_gap_s:.3g} s from {log.gap_at_ns} ns on, at a mean rate of "
                    f"{log.rate_hz:.3g} Hz: what happened then is not known; look for lost connections.",
                )
        for name, clock in sorted(watch.clocks.items()):
            yield from self._clock_findings(topic, name, clock, log)
        yield from self._pose_findings(topic, watch)

    def _clock_findings(
        self, topic: str, name: str, clock: ClockWatch, log: ClockWatch | None
    ) -> Iterator[Finding]:
        def found(severity: str, rule: str, sentence: str) -> Finding:
            return Finding(severity=severity, subject=topic, rule=rule, sentence=sentence)  # type: ignore[arg-type]

        if clock.n_zero:
            yield found(
                "warning" if name == "header" else "note",
                f"{name}-clock-zero",
                f"{clock.n_zero} {name} stamps are zero; rows without a header stamp take the log's: "
                "if all are, map the topic with 'clock: log'.",
            )
        if clock.n_backwards:
            # Several publishers of one topic are never quite in step, nor is a recorder's queue.
            is_slight = name == "log" or clock.furthest_back_s <= self.params.backwards_s
            yield found(
                "note" if is_slight else "warning",
                f"{name}-clock-backwards",
                f"The {name} clock goes backwards {clock.n_backwards} times, by up to {clock.furthest_back_s:.3g} s: "
                "rows are sorted by their stamps; choose another clock for the topic if that is wrong.",
            )
        if clock.n_jumps:
            others = "log" if name == "header" else "header"
            yield found(
                "warning",
                f"{name}-clock-jump",
                f"The {name} clock jumps {clock.n_jumps} times against the log's, by up to "
                f"{clock.largest_jump_s:+.3g} s: map the topic with 'clock: {others}', or cut the log there.",
            )
        uptime_s = self.params.uptime_years * _YEAR_S
        if name == "log" or log is None or not log.n_stamps or not clock.n_stamps:
            return
        offset_s = (clock.first_ns - log.first_ns) * _S
        if 0 < clock.latest_ns * _S < uptime_s < log.latest_ns * _S:
            yield found(
                "warning",
                f"{name}-clock-uptime",
                f"The {name} clock counts from a start (first stamp {clock.first_ns * _S:.3g} s) where the log's counts "
                "from 1970: topics on different clocks do not align; map all topics with one clock, as 'clock: log'.",
            )
        elif abs(offset_s) > self.params.offset_s:
            yield found(
                "note",
                f"{name}-clock-offset",
                f"The {name} clock is {offset_s:+.3g} s off the log's: use the same clock for all topics.",
            )

    def _pose_findings(self, topic: str, watch: _TopicWatch) -> Iterator[Finding]:
        poses = watch.poses
        if poses is None:
            return

        def found(rule: str, sentence: str) -> Finding:
            return Finding(severity="warning", subject=topic, rule=rule, sentence=sentence)

        if poses.n_not_finite:
            yield found(
                "not-finite",
                f"{poses.n_not_finite} of {poses.n_poses} poses hold NaN or infinity: they count as not tracked.",
            )
        if poses.n_without_rotation:
            yield found(
                "no-rotation",
                f"{poses.n_without_rotation} of {poses.n_poses} orientations are 0, 0, 0, 0, which is no rotation: "
                "they count as not tracked; map with 'orientation: null' if the source has none.",
            )
        if poses.n_not_unit:
            yield found(
                "not-unit",
                f"{poses.n_not_unit} of {poses.n_poses} quaternions are not of unit length: they are normalised when "
                "aligned; check that the order of their numbers is mapped right.",
            )

    def _frame_findings(self) -> Iterator[Finding]:
        def found(subject: str, rule: str, sentence: str) -> Finding:
            return Finding(severity="warning", subject=subject, rule=rule, sentence=sentence)

        trees = self.graph.trees
        if len(trees) > 1:
            listed = " | ".join(", ".join(tree[:6]) + (" …" if len(tree) > 6 else "") for tree in trees[:6])
            yield found(
                "frames",
                "disconnected",
                f"The frames fall into {len(trees)} groups without a transform between them: {listed}. "
                "Record the missing (static) transform, or map only topics of one group.",
            )
        for child, parents in self.graph.conflicts:
            yield found(
                child,
                "parents",
                f"Frame {child} has several parents, {', '.join(parents)}: two publishers disagree; stop one of them.",
            )
        if loops := self.graph.loops:
            yield found(
                "frames", "loop", f"Frames {', '.join(loops)} form a loop: no pose can be derived from them."
            )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _fit(
    path: Path, mapping: Mapping, root: Path | str | None, inspection: _Inspection, params: InspectParams
) -> Iterator[Finding]:
    """How the log fits a mapping."""
    present = {topic: watch for topic, watch in inspection.topics.items()}
    usable = {}
    for label, topic in mapping.topics.items():
        if topic_of(label) not in present:
            consequence = "the log is refused" if topic.required else "what it feeds is unobserved"
            yield Finding(
                severity="error" if topic.required else "warning",
                subject=label,
                rule="missing-topic",
                sentence=f"The mapping reads it, but the log has no such topic, so that {consequence}; "
                f"available: {', '.join(sorted(present)) or 'none'}.",
            )
            continue
        usable[label] = topic
    for label, topic in usable.items():
        single = mapping.model_copy(update={"topics": {label: topic}})
        try:
            stream = SampleStream(path, single, "doctor", definitions_of(mapping, root))
            seen = _Seen()
            for batch in stream.batches():
                seen.add(batch)
        except (LogError, UsageError) as error:
            problem = error.problem if isinstance(error, LogError) else str(error)
            yield Finding(severity="error", subject=label, rule="mapping", sentence=f"{_sentence(problem)}.")
            continue
        yield from seen.findings(label, topic, mapping, inspection.graph, params)


@dataclass(eq=False)
class _Seen:
    """What came of one mapped topic."""

    furthest_m: dict[str, float] = field(default_factory=dict)
    n_rows: dict[str, int] = field(default_factory=dict)
    n_untracked: dict[str, int] = field(default_factory=dict)
    references: set[str] = field(default_factory=set)
    grips: list[tuple[float, float]] = field(default_factory=list)

    def add(self, batch: pl.DataFrame) -> None:
        """Take a batch of samples."""
        far = pl.col("position_xyz_m").arr.eval(pl.element().abs().fill_nan(0.0)).arr.max()
        summary = batch.group_by("entity", maintain_order=True).agg(
            pl.len(),
            (~pl.col("is_tracked")).sum().alias("lost"),
            far.max().alias("far"),
            pl.col("reference").unique(),
        )
        for row in summary.iter_rows(named=True):
            name = row["entity"]
            self.n_rows[name] = self.n_rows.get(name, 0) + row["len"]
            self.n_untracked[name] = self.n_untracked.get(name, 0) + row["lost"]
            self.furthest_m[name] = max(self.furthest_m.get(name, 0.0), row["far"] or 0.0)
            self.references |= set(row["reference"])
        if batch["kind"][0] == "grip":
            self.grips.append((float(batch["grip"].min()), float(batch["grip"].max())))  # type: ignore[arg-type]

    def findings(
        self, label: str, topic: object, mapping: Mapping, graph: FrameGraph, params: InspectParams
    ) -> Iterator[Finding]:
        """What looks wrong."""

        def found(severity: str, rule: str, sentence: str) -> Finding:
            return Finding(severity=severity, subject=label, rule=rule, sentence=sentence)  # type: ignore[arg-type]

        if isinstance(topic, BodiesTopic | TransformsTopic):
            named = set(topic.entities.values()) if isinstance(topic, BodiesTopic) else set(topic.entities)
            if absent := sorted(named - set(self.n_rows)):
                yield found(
                    "warning",
                    "never-seen",
                    f"Never holds {', '.join(absent)}; it holds {', '.join(sorted(self.n_rows)) or 'nothing'}.",
                )
        mapped = {
            n: v
            for n, v in self.furthest_m.items()
            if not isinstance(topic, TransformsTopic) or n in topic.entities
        }
        if far := {name: value for name, value in mapped.items() if value > params.reach_m}:
            name, value = max(far.items(), key=lambda item: item[1])
            unit = "mm" if value > 20 * params.reach_m else "cm"
            yield found(
                "warning",
                "unit",
                f"{name} is up to {value:.4g} m away, which no hand reaches: the positions seem to be in {unit}; "
                f"map the topic with 'unit: {unit}'.",
            )
        if not isinstance(topic, TransformsTopic) and mapped and 0 < max(mapped.values()) < params.nearest_m:
            yield found(
                "warning",
                "unit",
                f"No position is further than {max(mapped.values()):.3g} m away: check the topic's 'unit'.",
            )
        for name, n_rows in sorted(self.n_rows.items()):
            share = self.n_untracked[name] / n_rows
            if share > params.untracked_share:
                yield found(
                    "warning",
                    "untracked",
                    f"{name} is not tracked in {share:.0%} of its {n_rows} rows: look for occlusion.",
                )
        if self.grips and max(high for _, high in self.grips) - min(low for low, _ in self.grips) < 0.1:
            yield found(
                "warning",
                "grip",
                "The grip hardly changes: check the topic's 'field', 'open_at' and 'closed_at'.",
            )
        connected = next((tree for tree in graph.trees if mapping.world in tree), (mapping.world,))
        if not isinstance(topic, TransformsTopic) and not self.grips:
            if lost := sorted(self.references - set(connected)):
                yield found(
                    "error",
                    "reference",
                    f"Its poses are given in {', '.join(lost)}, which no transform connects to the mapping's world "
                    f"{mapping.world!r}: name the frame with 'frame', or set 'world'.",
                )
