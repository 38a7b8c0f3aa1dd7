"""Transitions as a table teach what the same traces teach as files."""

import numpy as np
import polars as pl
import pytest

from demoplan.errors import DataError
from demoplan.stages.denoise import denoise, traces_of
from demoplan.tables import Transitions


def table_of(traces):
    """A trace set written as rows of transitions: the other way round, one state after the other."""
    names, signatures = traces.object_names, traces.signatures
    text = [
        f"{signatures.predicates[p].name}({','.join(names[a] for a in row if a >= 0)})"
        for p, row in zip(traces.atom_predicate, traces.atom_arguments, strict=True)
    ]
    states = [
        sorted(text[a] for a in traces.true_atom[traces.true_state == n]) for n in range(traces.n_states)
    ]
    rows = []
    for state, action, arguments in zip(
        traces.action_state, traces.action_signature, traces.action_arguments, strict=True
    ):
        trace = int(traces.state_trace[state])
        mine = np.flatnonzero(traces.declared_trace == trace)
        objects = [{"name": names[traces.declared_object[n]], "type": traces.declared_type[n]} for n in mine]
        rows.append({
            "episode_id": traces.trace_names[trace], "hand": "", "start_ns": int(state), "end_ns": int(state) + 1,
            "activity": signatures.actions[action].name, "previous_activity": None,
            "arguments": [names[a] for a in arguments if a >= 0], "acted_on": None, "in_hand": None,
            "objects": sorted(objects, key=lambda each: each["name"]),
            "before": states[state], "after": states[state + 1], "unknown_before": [], "unknown_after": [],
        })  # fmt: skip
    schema = {name: column.dtype for name, column in Transitions.columns().items()}
    return pl.DataFrame(rows, schema=schema)


def test_a_table_teaches_what_the_files_teach(courier, rules, learned):
    traces = courier(12, rate=0.05)
    again = traces_of(Transitions.validate(table_of(traces)), traces.signatures)
    assert again.n_states == traces.n_states
    one, two = denoise(traces), denoise(again)
    assert learned(one) == learned(two) == rules
    columns = ["operator", "role", "predicate", "variables", "n_support", "n_against"]
    assert one.literals.select(columns).equals(two.literals.select(columns))


def test_a_state_that_changed_between_transitions_begins_another_trace(courier):
    traces = courier(1)
    table = table_of(traces)
    missing = table.filter(pl.col("start_ns") != 10)
    again = traces_of(Transitions.validate(missing), traces.signatures)
    assert again.state_trace.max() == 1
    assert again.n_actions == traces.n_actions - 1


def test_what_could_not_be_observed_is_neither_true_nor_false(courier):
    traces = courier(1)
    table = (
        table_of(traces).head(1).with_columns(unknown_before=pl.lit(["lit(r1)"]), before=pl.lit(["free(c1)"]))
    )
    again = traces_of(Transitions.validate(table), traces.signatures)
    assert again.is_partial.tolist() == [True, False]
    hidden = next(
        n
        for n, (p, a) in enumerate(zip(again.atom_predicate, again.atom_arguments[:, 0], strict=True))
        if again.signatures.predicates[p].name == "lit" and again.object_names[a] == "r1"
    )
    assert hidden not in again.false_atom[again.false_state == 0]
    assert len(again.false_atom) > 0


def test_rows_without_arguments_are_left_out_and_unknown_names_refused(courier):
    traces = courier(1)
    table = table_of(traces)
    none = table.with_columns(arguments=pl.lit(None, dtype=pl.List(pl.String)))
    assert traces_of(Transitions.validate(none), traces.signatures).n_actions == 0
    with pytest.raises(
        DataError, match="activity 'jump' fits no action; declared: drop, go, pick, stamp, vanish"
    ):
        traces_of(Transitions.validate(table.with_columns(activity=pl.lit("jump"))), traces.signatures)
    with pytest.raises(DataError, match=r"atom odd\(r1\) fits no predicate"):
        traces_of(Transitions.validate(table.with_columns(after=pl.lit(["odd(r1)"]))), traces.signatures)
