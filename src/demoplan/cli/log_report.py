"""How ``demoplan doctor`` shows what is in a log."""

from demoplan.cli.output import Exit, print_table, say, stdout
from demoplan.logs import LogReport, TopicReport

_COLOURS = {"error": "red", "warning": "yellow", "note": "cyan"}


def show_log_report(report: LogReport) -> None:
    """Print a log's topics, frames and findings."""
    span = (
        f", {(report.end_ns - report.start_ns) / 1e9:.2f} s"
        if report.start_ns is not None and report.end_ns is not None
        else ""
    )
    print_table(
        f"{report.path}: {report.format}, compression {report.compression}, {report.n_bytes} bytes, "
        f"{report.n_messages} messages{span}, {report.status}",
        ["topic", "type", "encoding", "messages", "rate [Hz]", "largest gap [s]", "clocks", "jumps"],
        [_topic_row(topic) for topic in report.topics],
    )
    for number, tree in enumerate(report.trees, 1):
        say(f"frames, tree {number} of {len(report.trees)}: {', '.join(tree)}")
    if not report.findings:
        say("nothing wrong was found")
    for finding in report.findings:
        stdout.print(f"[{_COLOURS[finding.severity]}]{finding.severity}[/] ", end="")
        stdout.print(f"{finding.subject}: {finding.sentence}", markup=False)


def exit_code_of(report: LogReport) -> Exit:
    """3 if the log is truncated, 1 if something makes it useless as it is, else 0."""
    if report.status == "truncated":
        return Exit.DATA_LOSS
    return Exit.FAILED if any(finding.severity == "error" for finding in report.findings) else Exit.FINE


def _topic_row(topic: TopicReport) -> tuple[object, ...]:
    return (
        topic.topic,
        topic.message_type,
        topic.encoding,
        topic.n_messages,
        "" if topic.rate_hz is None else f"{topic.rate_hz:.1f}",
        "" if topic.largest_gap_s is None else f"{topic.largest_gap_s:.3f}",
        ", ".join(clock.clock for clock in topic.clocks),
        sum(clock.n_jumps + clock.n_backwards for clock in topic.clocks) or "",
    )
