"""Transitions as a table become trace sets: the same learner serves logs whose actions name objects."""

from itertools import chain

import dataframely as dy
import numpy as np
import polars as pl

from demoplan.errors import DataError
from demoplan.language.atoms import Atom
from demoplan.language.traces import Signatures, TraceSet
from demoplan.language.traces.values import ABSENT, Codes
from demoplan.tables import Transitions


def traces_of(transitions: dy.DataFrame[Transitions], signatures: Signatures) -> TraceSet:
    """Transitions of each episode and hand, in order, as traces.

    A transition whose state before is the state after the one before it continues its trace; otherwise
    something else happened between, and another trace begins. Where atoms could not be observed, the state is
    partial: it says which of the episode's atoms were false.

    Args:
        transitions: Rows with ``arguments``; others name no objects and are left out.
        signatures: Actions by the names of activities, and predicates.

    Raises:
        DataError: If an atom or an activity does not fit the signatures.
    """
    rows = transitions.filter(pl.col("arguments").is_not_null()).sort("episode_id", "hand", "start_ns")
    objects: dict[str, int] = {}
    actions = {each.name: n for n, each in enumerate(signatures.actions)}
    predicates = {each.name: n for n, each in enumerate(signatures.predicates)}
    atoms: dict[str, int] = {}
    atom_rows: list[tuple[int, ...]] = []

    def atom(text: str) -> int:
        if text not in atoms:
            value = Atom.parse(text)
            index = predicates.get(value.predicate, ABSENT)
            if index == ABSENT or len(signatures.predicates[index].argument_types) != len(value.arguments):
                listed = ", ".join(sorted(predicates))
                raise DataError(f"atom {text} fits no predicate; declared: {listed}")
            atoms[text] = len(atom_rows)
            atom_rows.append((index, *(objects.setdefault(name, len(objects)) for name in value.arguments)))
        return atoms[text]

    trace_names: list[str] = []
    state_trace: list[int] = []
    true: list[list[int]] = []
    unknown: list[set[int]] = []
    action_rows: list[tuple[int, ...]] = []
    declared: list[tuple[int, int, str]] = []
    last: tuple[object, ...] = ()
    for row in rows.iter_rows(named=True):
        if row["activity"] not in actions:
            listed = ", ".join(sorted(actions))
            raise DataError(f"activity {row['activity']!r} fits no action; declared: {listed}")
        signature = signatures.actions[actions[row["activity"]]]
        if len(row["arguments"]) != len(signature.parameters):
            wanted = len(signature.parameters)
            raise DataError(f"{signature.name!r} has {len(row['arguments'])} arguments; it takes {wanted}")
        where = (row["episode_id"], row["hand"])
        if last != (where, row["before"], row["unknown_before"]):
            trace_names.append(row["episode_id"])
            state_trace.append(len(trace_names) - 1)
            true.append([atom(text) for text in row["before"]])
            unknown.append({atom(text) for text in row["unknown_before"]})
            declared += [
                (len(trace_names) - 1, objects.setdefault(each["name"], len(objects)), each["type"])
                for each in row["objects"]
            ]
        arguments = (objects.setdefault(name, len(objects)) for name in row["arguments"])
        action_rows.append((len(state_trace) - 1, actions[row["activity"]], *arguments))
        state_trace.append(len(trace_names) - 1)
        true.append([atom(text) for text in row["after"]])
        unknown.append({atom(text) for text in row["unknown_after"]})
        last = (where, row["after"], row["unknown_after"])
    of_episode: dict[str, set[int]] = {}
    for trace, seen in zip(state_trace, true, strict=True):
        of_episode.setdefault(trace_names[trace], set()).update(seen)
    false = [
        sorted(of_episode[trace_names[trace]] - set(seen) - hidden) if hidden else []
        for trace, seen, hidden in zip(state_trace, true, unknown, strict=True)
    ]
    widest = max((len(each.parameters) for each in signatures.actions), default=0)
    table = _table(action_rows, widest + 2)
    atom_table = _table(
        atom_rows, max((len(each.argument_types) for each in signatures.predicates), default=0) + 1
    )
    states = np.arange(len(state_trace))
    return TraceSet(
        signatures=signatures,
        trace_names=tuple(trace_names),
        object_names=tuple(objects),
        atom_predicate=atom_table[:, 0],
        atom_arguments=atom_table[:, 1:],
        state_trace=np.array(state_trace, dtype=np.int64),
        is_partial=np.array([bool(hidden) for hidden in unknown], dtype=np.bool_),
        true_state=np.repeat(states, [len(each) for each in true]),
        true_atom=np.fromiter(chain.from_iterable(true), dtype=np.int64),
        false_state=np.repeat(states, [len(each) for each in false]),
        false_atom=np.fromiter(chain.from_iterable(false), dtype=np.int64),
        action_state=table[:, 0],
        action_signature=table[:, 1],
        action_arguments=table[:, 2:],
        declared_trace=np.array([trace for trace, _, _ in declared], dtype=np.int64),
        declared_object=np.array([each for _, each, _ in declared], dtype=np.int64),
        declared_type=tuple(kind for _, _, kind in declared),
    )


def _table(rows: list[tuple[int, ...]], width: int) -> Codes:
    table = np.full((len(rows), width), ABSENT, dtype=np.int64)
    for n, row in enumerate(rows):
        table[n, : len(row)] = row
    return table
