"""From evidence at each tick to states that last: hysteresis, gaps, and flickers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from demoplan.geometry import Bools, Codes, hysteresis, run_lengths, without_short_runs

Numbers: TypeAlias = Mapping[str, float]
"""A predicate's thresholds, by name."""

Groundings: TypeAlias = Sequence[tuple[int, ...]]
"""Numbers of bodies, one tuple per ground atom."""

FALSE, TRUE, UNKNOWN = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Evidence:
    """What each tick says about each grounding of a predicate; all ``(g, n)``."""

    enters: Bools
    """The atom begins to hold."""
    stays: Bools
    """The atom goes on holding, if it held."""
    is_observed: Bools
    """The tick says anything at all."""


@dataclass(frozen=True, eq=False)
class Known:
    """The settled states of every predicate that has one definition."""

    codes: Mapping[tuple[int, ...], Codes]
    """State ``(n,)`` of each grounding."""
    n_ticks: int

    def during(self, ticks: slice) -> "Known":
        """The same states at some ticks."""
        codes = {bodies: state[ticks] for bodies, state in self.codes.items()}
        return Known(codes, len(range(self.n_ticks)[ticks]))

    def state(self, *bodies: int) -> Codes:
        """State ``(n,)`` of one grounding; false where the vocabulary's types rule it out."""
        found = self.codes.get(bodies)
        return np.full(self.n_ticks, FALSE) if found is None else found


def stacked(parts: Sequence[tuple[Bools, Bools, Bools]], n_ticks: int) -> "Evidence":
    """Evidence of groundings one after another: (enters, stays, is_observed) of each."""
    if not parts:
        nothing = np.zeros((0, n_ticks), np.bool_)
        return Evidence(nothing, nothing, nothing)
    enters, stays, observed = zip(*parts, strict=True)
    return Evidence(np.stack(enters), np.stack(stays), np.stack(observed))


def settled(evidence: Evidence, tick_s: float, numbers: Numbers, hold_s: float) -> Codes:
    """The state of each grounding at each tick ``(g, n)``: false, true or unknown.

    An atom holds from where it enters for as long as it stays. Where nothing is observed for at most
    ``hold_s``, the last state is kept; for longer, it is unknown, and what held before says nothing about
    what holds after. Then interruptions shorter than ``min_false_s`` are closed, and after that, states
    shorter than ``min_true_s`` dropped; what borders on the unknown is left alone.

    Args:
        evidence: What each tick says.
        tick_s: Seconds between ticks.
        numbers: ``min_true_s``, ``min_false_s`` and ``hold_s`` [s], where the vocabulary states them.
        hold_s: Where it does not.
    """
    observed = evidence.is_observed
    enters = evidence.enters & observed
    stays = (evidence.stays | evidence.enters) & observed
    if observed.all():
        codes = hysteresis(enters, stays).astype(np.int8)
    else:
        is_kept, restarts = _short_gaps(observed, round(numbers.get("hold_s", hold_s) / tick_s))
        holds = hysteresis(enters, (stays | ~observed) & ~(restarts & ~enters))
        codes = np.where(observed | is_kept, holds.astype(np.int8), UNKNOWN)
    codes = without_short_runs(codes, FALSE, TRUE, round(numbers.get("min_false_s", 0.0) / tick_s))
    return without_short_runs(codes, TRUE, FALSE, round(numbers.get("min_true_s", 0.0) / tick_s))


def _short_gaps(observed: Bools, n_most: int) -> tuple[Bools, Bools]:
    """Ticks within gaps short enough to bridge, and the first ticks after longer ones; both ``(g, n)``."""
    rows, starts, ends, values = run_lengths(observed.astype(np.int8))
    is_gap = values == 0
    is_bridged = is_gap & (ends - starts <= n_most) & (starts > 0)
    kept = np.repeat(is_bridged, ends - starts).reshape(observed.shape)
    restarts = np.zeros(observed.shape, np.bool_)
    ending = is_gap & ~is_bridged & (ends < observed.shape[1])
    restarts[rows[ending], ends[ending]] = True
    return kept, restarts
