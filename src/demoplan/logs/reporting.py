"""What ``inspect`` says of a log: plain values, that read well as JSON."""

from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

Severity: TypeAlias = Literal["error", "warning", "note"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that is wrong or worth knowing."""

    severity: Severity
    """``error``: the log or mapping is of no use so; ``warning``: results may suffer; ``note``: neither."""
    subject: str
    """Topic, frame, or ``log``."""
    rule: str
    """Which check it comes from: a stable name."""
    sentence: str
    """What was found, and what to do."""


@dataclass(frozen=True, kw_only=True)
class ClockReport:
    """Stamps of one clock on one topic."""

    clock: str
    """``log``, ``publish`` or ``header``."""
    first_ns: int
    last_ns: int
    n_zero: int
    n_backwards: int
    n_jumps: int
    """Steps that differ from the log clock's by more than the threshold."""
    largest_jump_s: float


@dataclass(frozen=True, kw_only=True)
class TopicReport:
    """One topic of a log."""

    topic: str
    message_type: str
    encoding: str
    n_messages: int
    rate_hz: float | None
    largest_gap_s: float | None
    """Longest time without a message, on the log's clock."""
    is_decodable: bool
    clocks: tuple[ClockReport, ...]


@dataclass(frozen=True, kw_only=True)
class TransformReport:
    """One edge of the tree of frames."""

    parent: str
    child: str
    n_transforms: int


@dataclass(frozen=True, kw_only=True)
class LogReport:
    """What a log holds, and what is wrong with it."""

    path: str
    format: str
    compression: str
    files: tuple[str, ...]
    n_bytes: int
    status: Literal["complete", "truncated"]
    reason: str | None
    n_messages: int
    start_ns: int | None
    end_ns: int | None
    topics: tuple[TopicReport, ...]
    transforms: tuple[TransformReport, ...]
    trees: tuple[tuple[str, ...], ...]
    """Frames that transforms connect, the largest group first."""
    findings: tuple[Finding, ...]
    """Most severe first."""

    def as_json(self) -> dict[str, Any]:
        """The report as JSON values; nanoseconds are text, as JSON's numbers do not hold them."""
        plain: dict[str, Any] = _with_text_times(asdict(self))
        return plain


def _with_text_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: str(item) if key.endswith("_ns") and item is not None else _with_text_times(item)
            for key, item in value.items()
        }
    return [_with_text_times(item) for item in value] if isinstance(value, list | tuple) else value
