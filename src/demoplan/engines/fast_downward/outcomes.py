"""Exit codes to outcomes: a closed vocabulary, in which an unknown exit is never "no plan"."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from demoplan.engines.fast_downward.processes import Ended

Outcome: TypeAlias = Literal[
    "solved",
    "unsolvable",
    "gave_up",
    "out_of_time",
    "out_of_memory",
    "bad_input",
    "invalid_plan",
    "planner_missing",
    "failed",
]


@dataclass(frozen=True)
class Verdict:
    """What an exit means."""

    outcome: Outcome
    is_explained: bool
    meaning: str


_MEANINGS: dict[int, tuple[Outcome, str]] = {
    0: ("solved", "a plan was found"),
    1: ("solved", "a plan was found, then memory ran out"),
    2: ("solved", "a plan was found, then time ran out"),
    3: ("solved", "a plan was found, then memory and time ran out"),
    10: ("unsolvable", "the translator proved that there is no plan"),
    11: ("unsolvable", "the search proved that there is no plan"),
    12: ("gave_up", "the search ended without a plan and without a proof that there is none"),
    13: ("gave_up", "there is no plan within the cost bound"),
    20: ("out_of_memory", "the translator ran out of memory"),
    21: ("out_of_time", "the translator ran out of time"),
    22: ("out_of_memory", "the search ran out of memory"),
    23: ("out_of_time", "the search ran out of time"),
    24: ("out_of_time", "the search ran out of time and memory"),
    30: ("failed", "critical error in the translator"),
    31: ("bad_input", "the translator refused the PDDL text"),
    32: ("failed", "critical error in the search"),
    33: ("bad_input", "the search refused its options or the translated task"),
    34: ("bad_input", "the search does not support something that the domain uses"),
    35: ("failed", "critical error in the driver"),
    36: ("bad_input", "the driver refused its options"),
    37: ("failed", "the driver does not support this system"),
}
"""Source: Fast Downward documentation, "Exit codes", and ``returncodes.py`` of the driver, release 26.6."""


def verdict_of_search(ended: Ended) -> Verdict:
    """What the search's exit means."""
    return _verdict(ended, "search")


def verdict_of_translator(ended: Ended) -> Verdict | None:
    """What the translator's exit means, or None if it succeeded and the search may start."""
    if ended.exit_code == 0 and not ended.is_timeout:
        return None
    return _verdict(ended, "translator")


def _verdict(ended: Ended, program: str) -> Verdict:
    if ended.is_timeout:
        return Verdict("out_of_time", True, f"the {program} was ended after {ended.wall_s:.1f} s")
    if program == "translator" and ended.exit_code == 1 and "MemoryError" in ended.output:
        # Its own handler for this can fail for want of memory, and then it ends as any broken program does.
        return Verdict("out_of_memory", True, "the translator ran out of memory")
    known = _MEANINGS.get(ended.exit_code)
    # Codes below 10 speak of plans, which the translator does not make: from it they explain nothing.
    if known is None or (program == "translator" and known[0] == "solved"):
        how = f"signal {-ended.exit_code}" if ended.exit_code < 0 else f"exit code {ended.exit_code}"
        return Verdict(
            "failed", False, f"the {program} ended with {how}, which says nothing: {last_words(ended)}"
        )
    outcome, meaning = known
    is_silent = outcome in {"solved", "unsolvable", "gave_up", "out_of_time", "out_of_memory"}
    return Verdict(outcome, True, meaning if is_silent else f"{meaning}: {last_words(ended)}")


def last_words(ended: Ended, n_lines: int = 3) -> str:
    """The last lines that a program printed, on one line; for messages."""
    lines = [line.strip() for line in ended.output.splitlines() if line.strip()]
    return " / ".join(lines[-n_lines:])[:500] or "it printed nothing"
