"""What was gathered about a log, to findings: sentences that say what is wrong and what to do."""

from collections.abc import Iterator
from dataclasses import dataclass

from demoplan.logs.messages import Tally
from demoplan.logs.reporting import Finding
from demoplan.logs.watching import ClockWatch, FrameGraph, TopicWatch

_S = 1e-9
_YEAR_S = 365.25 * 86400


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


def as_sentence(text: str) -> str:
    """The text, with a capital."""
    return text[:1].upper() + text[1:]


def log_findings(tally: Tally, topics: dict[str, TopicWatch], params: InspectParams) -> Iterator[Finding]:
    """What is wrong with the log as a whole."""
    for problem in dict.fromkeys(tally.problems):
        yield Finding(
            severity="warning",
            subject="log",
            rule="truncated",
            sentence=f"The log is not whole: {problem}. "
            "What it still holds is read, and its episode is marked.",
        )
    for remark in dict.fromkeys(tally.remarks):
        yield Finding(severity="note", subject="log", rule="container", sentence=f"{as_sentence(remark)}.")
    if not sum(tally.channels.values()):
        yield Finding(
            severity="error",
            subject="log",
            rule="empty",
            sentence="The log holds no messages: record again, and check that the recorder "
            "subscribed to the topics.",
        )
    logs = [watch.clocks["log"] for watch in topics.values() if "log" in watch.clocks]
    latest_s = max((clock.latest_ns for clock in logs), default=0) * _S
    if 0 < latest_s < params.uptime_years * _YEAR_S:
        yield Finding(
            severity="note",
            subject="log",
            rule="log-clock-uptime",
            sentence=f"The log's clock counts from a start and not from 1970 (last stamp {latest_s:.3g} "
            f"s), as "
            "in simulation: durations are right, dates are not.",
        )


def topic_findings(
    topic: str, watch: TopicWatch, types: list[str], is_decodable: bool, params: InspectParams
) -> Iterator[Finding]:
    """What is wrong with one topic."""

    def found(severity: str, rule: str, sentence: str) -> Finding:
        return Finding(severity=severity, subject=topic, rule=rule, sentence=sentence)  # type: ignore[arg-type]

    if len(types) > 1:
        yield found("warning", "types", f"Its messages are of several types: {', '.join(types)}.")
    if not is_decodable:
        yield found("note", "unknown-type", f"Cannot be decoded: {'; '.join(watch.problems)}.")
    elif watch.n_refused:
        yield found(
            "warning",
            "malformed",
            f"{watch.n_refused} messages do not hold what their type says: {'; '.join(watch.problems[:3])}. "
            "Check that the definition in the log is the one that was published.",
        )
    log = watch.clocks.get("log")
    rate_hz = None if log is None else log.rate_hz
    if log is not None and rate_hz and log.largest_gap_s > max(params.gap_s, params.gap_intervals / rate_hz):
        yield found(
            "warning",
            "gap",
            f"No message for {log.largest_gap_s:.3g} s from {log.gap_at_ns} ns on, at a mean rate of "
            f"{rate_hz:.3g} Hz: what happened then is not known; look for lost connections.",
        )
    for name, clock in sorted(watch.clocks.items()):
        yield from _clock_findings(topic, name, clock, log, params)
    yield from _pose_findings(topic, watch)


def _clock_findings(
    topic: str, name: str, clock: ClockWatch, log: ClockWatch | None, params: InspectParams
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
        is_slight = name == "log" or clock.furthest_back_s <= params.backwards_s
        yield found(
            "note" if is_slight else "warning",
            f"{name}-clock-backwards",
            f"The {name} clock goes backwards {clock.n_backwards} times, by up to "
            f"{clock.furthest_back_s:.3g} s: "
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
    uptime_s = params.uptime_years * _YEAR_S
    if name == "log" or log is None or not log.n_stamps or not clock.n_stamps:
        return
    offset_s = (clock.first_ns - log.first_ns) * _S
    if 0 < clock.latest_ns * _S < uptime_s < log.latest_ns * _S:
        yield found(
            "warning",
            f"{name}-clock-uptime",
            f"The {name} clock counts from a start (first stamp {clock.first_ns * _S:.3g} s) where the "
            f"log's counts "
            "from 1970: topics on different clocks do not align; map all topics with one clock, as "
            "'clock: log'.",
        )
    elif abs(offset_s) > params.offset_s:
        yield found(
            "note",
            f"{name}-clock-offset",
            f"The {name} clock is {offset_s:+.3g} s off the log's: use the same clock for all topics.",
        )


def _pose_findings(topic: str, watch: TopicWatch) -> Iterator[Finding]:
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
            f"{poses.n_without_rotation} of {poses.n_poses} orientations are 0, 0, 0, 0, which is no "
            f"rotation: "
            "they count as not tracked; map with 'orientation: null' if the source has none.",
        )
    if poses.n_not_unit:
        yield found(
            "not-unit",
            f"{poses.n_not_unit} of {poses.n_poses} quaternions are not of unit length: they are "
            f"normalised when "
            "aligned; check that the order of their numbers is mapped right.",
        )


def frame_findings(graph: FrameGraph) -> Iterator[Finding]:
    """What is wrong with the tree of frames."""

    def found(subject: str, rule: str, sentence: str) -> Finding:
        return Finding(severity="warning", subject=subject, rule=rule, sentence=sentence)

    trees = graph.trees
    if len(trees) > 1:
        listed = " | ".join(", ".join(tree[:6]) + (" …" if len(tree) > 6 else "") for tree in trees[:6])
        yield found(
            "frames",
            "disconnected",
            f"The frames fall into {len(trees)} groups without a transform between them: {listed}. "
            "Record the missing (static) transform, or map only topics of one group.",
        )
    for child, parents in graph.conflicts:
        yield found(
            child,
            "parents",
            f"Frame {child} has several parents, {', '.join(parents)}: two publishers disagree; stop "
            f"one of them.",
        )
    if loops := graph.loops:
        yield found(
            "frames", "loop", f"Frames {', '.join(loops)} form a loop: no pose can be derived from them."
        )
