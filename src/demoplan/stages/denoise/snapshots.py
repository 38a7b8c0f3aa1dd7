"""States with noise taken out: which atoms hold in some of them, and which objects there are."""

from dataclasses import dataclass

import numpy as np

from demoplan.inference import Beliefs
from demoplan.language.traces import TraceSet
from demoplan.language.traces.values import Codes
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.touches import GroundCodes, Spans, Touches

_SURE = 0.9
"""Atoms believed more than this count as holding where an implication starts."""


@dataclass(frozen=True, eq=False)
class Snapshots:
    """Atoms that hold in some states, after noise is taken out."""

    n: int
    sure_state: Codes
    sure_code: Codes
    likely: Codes
    """Sorted ``code * n + state`` of all that is more likely true than not."""
    object_state: Codes
    """Snapshot of every declared object; with ``object_index`` and ``object_type``."""
    object_index: Codes
    object_type: tuple[str, ...]


def snapshots(
    traces: TraceSet,
    chosen: Spans,
    touches: Touches,
    beliefs: Beliefs,
    codes: GroundCodes,
    params: DenoiseParams,
) -> Snapshots:
    """States at even distances in each span, as far as the limit goes."""
    n_each = max(1, min(params.n_snapshots, params.max_snapshots // max(len(chosen.first), 1)))
    n_spans = min(len(chosen.first), params.max_snapshots)
    steps = np.linspace(0.0, 1.0, n_each) if n_each > 1 else np.array([0.5])
    states = np.round(chosen.first[:n_spans, None] + steps * (chosen.last - chosen.first)[:n_spans, None])
    state = np.unique(states.astype(np.int64))
    span = np.searchsorted(chosen.first, state, side="right") - 1
    code, probability, at = _touched(traces, touches, beliefs, state, span)
    still_code, still_span, still = _untouched(traces, chosen, touches, beliefs, codes, n_spans)
    # An atom that nothing touched holds in every snapshot of its span.
    order = np.argsort(still_span, kind="stable")
    low = np.searchsorted(still_span[order], span, side="left")
    high = np.searchsorted(still_span[order], span, side="right")
    sizes = high - low
    picked = order[np.repeat(low - np.r_[0, np.cumsum(sizes)[:-1]], sizes) + np.arange(sizes.sum())]
    code = np.concatenate([code, still_code[picked]])
    probability = np.concatenate([probability, still[picked]])
    at = np.concatenate([at, np.repeat(np.arange(len(state)), sizes)])
    is_sure = probability > _SURE
    declared = np.flatnonzero(np.isin(traces.declared_trace, traces.state_trace[state]))
    pairs = [
        (n, index)
        for n, trace in enumerate(traces.state_trace[state].tolist())
        for index in declared[traces.declared_trace[declared] == trace].tolist()
    ]
    object_row = np.array([index for _, index in pairs], dtype=np.int64)
    return Snapshots(
        n=len(state),
        sure_state=at[is_sure],
        sure_code=code[is_sure],
        likely=np.unique((code * len(state) + at)[probability > 1 / 2]),
        object_state=np.array([n for n, _ in pairs], dtype=np.int64),
        object_index=traces.declared_object[object_row],
        object_type=tuple(traces.declared_type[index] for index in object_row),
    )


def _touched(
    traces: TraceSet, touches: Touches, beliefs: Beliefs, state: Codes, span: Codes
) -> tuple[Codes, np.ndarray, Codes]:
    """Codes, probabilities and snapshots of atoms that some action touched."""
    by_span = np.argsort(touches.timeline_span, kind="stable")
    low = np.searchsorted(touches.timeline_span[by_span], span, side="left")
    high = np.searchsorted(touches.timeline_span[by_span], span, side="right")
    sizes = high - low
    timeline = by_span[np.repeat(low - np.r_[0, np.cumsum(sizes)[:-1]], sizes) + np.arange(sizes.sum())]
    at = np.repeat(np.arange(len(state)), sizes)
    key = touches.timelines.touch_timeline * traces.n_states + touches.touch_state
    by_time = np.argsort(key, kind="stable")
    last = np.searchsorted(key[by_time], timeline * traces.n_states + state[at], side="left") - 1
    touch = by_time[np.maximum(last, 0)]
    is_after = (last >= 0) & (touches.timelines.touch_timeline[touch] == timeline)
    messages = beliefs.messages
    probability = np.where(is_after, messages.true_after[touch], messages.true_before[timeline])
    return touches.timeline_code[timeline], probability, at


def _untouched(
    traces: TraceSet, chosen: Spans, touches: Touches, beliefs: Beliefs, codes: GroundCodes, n_spans: int
) -> tuple[Codes, Codes, np.ndarray]:
    """Codes, spans and probabilities of atoms that nothing touched: one long segment each."""
    span = np.searchsorted(chosen.first, traces.true_state, side="right") - 1
    is_inside = (span >= 0) & (traces.true_state <= chosen.last[np.maximum(span, 0)]) & (span < n_spans)
    code = codes.of_atoms(traces)[traces.true_atom[is_inside]]
    key, n_true = np.unique(code * n_spans + span[is_inside], return_counts=True)
    touched = touches.timeline_code * n_spans + touches.timeline_span
    is_touched = np.isin(key, touched[touches.timeline_span < n_spans])
    key, n_true = key[~is_touched], n_true[~is_touched]
    code, span = key // n_spans, key % n_spans
    full = np.r_[0, np.cumsum(~traces.is_partial)]
    n_seen = np.maximum(full[chosen.last[span] + 1] - full[chosen.first[span]], n_true)
    predicate = codes.predicate_of(code)
    missed, imagined = beliefs.rates.missed[predicate], beliefs.rates.imagined[predicate]
    odds = n_true * np.log((1 - missed) / imagined) + (n_seen - n_true) * np.log(missed / (1 - imagined))
    return code, span, 1 / (1 + np.exp(-np.clip(odds, -50, 50)))
