"""Touches and the counts between them are what a walk over every atom and state would find."""

from dataclasses import replace

import numpy as np
import pytest

from demoplan.errors import DataError
from demoplan.language.domains import Signature
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.touches import GroundCodes, candidates, spans, touch


def test_candidates_are_all_well_typed_atoms_over_the_parameters(courier):
    over = candidates(courier(1).signatures)
    go = {str(each.atom) for each in over if each.action == 0}
    assert go == {
        *(f"at(?c,{room})" for room in ("?a", "?b")),
        *(f"door({one},{two})" for one in ("?a", "?b") for two in ("?a", "?b")),
        "free(?c)",
        "lit(?a)",
        "lit(?b)",
    }


@pytest.mark.parametrize("hidden", [0.0, 0.4])
def test_segments_hold_what_was_seen_between_touches(courier, hidden):
    traces = courier(3, rate=0.1, hidden=hidden)
    params = DenoiseParams(max_span_states=10)
    codes, over = GroundCodes(traces), candidates(traces.signatures)
    chosen = spans(traces, params)
    touches = touch(traces, chosen, over, codes)
    timelines = touches.timelines
    code_of = codes.of_atoms(traces).tolist()
    true = {
        (state, code_of[atom])
        for state, atom in zip(traces.true_state.tolist(), traces.true_atom.tolist(), strict=True)
    }
    false = {
        (state, code_of[atom])
        for state, atom in zip(traces.false_state.tolist(), traces.false_atom.tolist(), strict=True)
    }

    def seen(code, first, last):
        n_true = sum((state, code) in true for state in range(first, last + 1))
        n_false = sum(
            (state, code) in false or (not traces.is_partial[state] and (state, code) not in true)
            for state in range(first, last + 1)
        )
        return n_true, n_false

    for line, code in enumerate(touches.timeline_code.tolist()):
        mine = np.flatnonzero(timelines.touch_timeline == line)
        at = touches.touch_state[mine].tolist()
        span = touches.timeline_span[line]
        first, last = int(chosen.first[span]), int(chosen.last[span])
        assert (timelines.before_true[line], timelines.before_false[line]) == seen(code, first, at[0])
        for place, row in enumerate(mine):
            end = at[place + 1] if place + 1 < len(at) else last
            assert (timelines.after_true[row], timelines.after_false[row]) == seen(code, at[place] + 1, end)


def test_spans_cut_long_traces_and_stop_when_every_action_has_enough(courier):
    traces = courier(6)
    long = spans(traces, DenoiseParams(max_span_states=1_000))
    assert long.first.tolist() == [26 * n for n in range(6)]
    short = spans(traces, DenoiseParams(max_span_states=10))
    assert (short.last - short.first + 1).max() == 10
    few = spans(traces, DenoiseParams(max_span_states=10, max_instances=1))
    assert len(few.first) < len(short.first)
    owner = np.searchsorted(few.first, traces.action_state, side="right") - 1
    kept = traces.action_signature[(owner >= 0) & (traces.action_state <= few.last[np.maximum(owner, 0)])]
    assert set(kept.tolist()) == set(traces.action_signature.tolist())


def test_more_objects_than_codes_can_hold_are_refused_with_advice(courier):
    traces = replace(courier(1), object_names=tuple(f"o{n}" for n in range(3_000_000_000 // 1000)))
    wide = Signature("related", ("object",) * 3)
    signatures = replace(traces.signatures, predicates=(*traces.signatures.predicates, wide))
    with pytest.raises(DataError, match="3000000 objects in predicates of 3 arguments"):
        GroundCodes(replace(traces, signatures=signatures))
