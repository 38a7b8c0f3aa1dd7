"""Noisy traces to operators and literals, each with its probability and the counts behind it."""

from dataclasses import dataclass

import dataframely as dy
import numpy as np
import polars as pl

from demoplan.language.atoms import Literal
from demoplan.language.traces import TraceSet
from demoplan.stages.denoise.beliefs import ADD, DELETE, KEEP, Beliefs, believe
from demoplan.stages.denoise.counts import Counts, count
from demoplan.stages.denoise.implications import Implications, needed, snapshots
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.touches import Candidate, GroundCodes, candidates, spans, touch
from demoplan.tables import Literals, Operators

_HALF = 0.5


@dataclass(frozen=True, eq=False)
class Denoised:
    """What was learned from traces."""

    operators: dy.DataFrame[Operators]
    literals: dy.DataFrame[Literals]
    flip_rates: dict[str, tuple[float, float]]
    """Per predicate: probability that a true atom was not seen, and that a false atom was seen."""
    flip_rate: float
    """Over all predicates."""
    n_rounds: int
    is_settled: bool
    """Whether beliefs came to rest within the rounds allowed."""

    def actions(self) -> dict[str, tuple[frozenset[Literal], frozenset[Literal]]]:
        """Preconditions and effects of each operator, as far as they are stated."""
        from demoplan.language.atoms import Atom  # noqa: PLC0415

        found: dict[str, tuple[set[Literal], set[Literal]]] = {
            name: (set(), set()) for name in self.operators["operator"]
        }
        for row in self.literals.filter(pl.col("is_kept")).iter_rows(named=True):
            literal = Literal(Atom(row["predicate"], tuple(row["variables"])), row["is_positive"])
            found[row["operator"]][row["role"] == "effect"].add(literal)
        return {name: (frozenset(pre), frozenset(effects)) for name, (pre, effects) in found.items()}


def denoise(traces: TraceSet, params: DenoiseParams = DenoiseParams()) -> Denoised:
    """Learn one operator per action of the traces' signatures.

    Args:
        traces: What was observed, with misreadings; how many is estimated from the traces.
        params: Priors and limits.

    Returns:
        Operators and literals; an action without an instance gives no operator. Beliefs come from at most
        ``max_instances`` instances per action and what stands around them; counts come from all.
    """
    over = candidates(traces.signatures)
    codes = GroundCodes(traces)
    chosen = spans(traces, params)
    touches = touch(traces, chosen, over, codes)
    beliefs = believe(touches, over, len(traces.signatures.predicates), params)
    counts = count(traces, over, codes, params)
    n_instances = np.bincount(traces.action_signature, minlength=len(traces.signatures.actions))
    implications = None
    if params.is_minimal and len(chosen.first):
        implications = Implications(
            traces, snapshots(traces, chosen, touches, beliefs, codes, params), codes, params
        )
    by_action: dict[int, list[int]] = {}
    for index, each in enumerate(over):
        by_action.setdefault(each.action, []).append(index)
    rows: list[dict[str, object]] = []
    for action, indices in sorted(by_action.items()):
        if n_instances[action]:
            rows += _literals(traces, over, indices, beliefs, counts, implications)
    name_of = {row[0]: row for row in enumerate(traces.signatures.predicates)}
    return Denoised(
        operators=_operators(traces, n_instances),
        literals=Literals.validate(_frame(Literals, rows), cast=True),
        flip_rates={
            each.name: (float(beliefs.rates.missed[n]), float(beliefs.rates.imagined[n]))
            for n, each in name_of.values()
        },
        flip_rate=beliefs.flip_rate,
        n_rounds=beliefs.n_rounds,
        is_settled=beliefs.is_settled,
    )


def _frame(schema: type[dy.Schema], rows: list[dict[str, object]]) -> pl.DataFrame:
    return pl.DataFrame(rows, schema={name: column.dtype for name, column in schema.columns().items()})


def _operators(traces: TraceSet, n_instances: np.ndarray) -> dy.DataFrame[Operators]:
    rows: list[dict[str, object]] = []
    action_trace = traces.state_trace[traces.action_state]
    for index, action in enumerate(traces.signatures.actions):
        if not n_instances[index]:
            continue
        names = {traces.trace_names[n] for n in np.unique(action_trace[traces.action_signature == index])}
        rows.append(
            {
                "operator": action.name,
                "activity": action.name,
                "parameters": [
                    {"variable": each.variable, "type": each.type_name} for each in action.parameters
                ],
                "n_transitions": int(n_instances[index]),
                "n_episodes": len(names),
                "n_successes": 0,
                "n_failures": 0,
                "beta": (int(n_instances[index]) + 1) / (int(n_instances[index]) + 2),
                "cost": 1,
                "is_quarantined": False,
                "note": None,
            }
        )
    return Operators.validate(_frame(Operators, rows), cast=True)


def _literals(
    traces: TraceSet,
    over: tuple[Candidate, ...],
    indices: list[int],
    beliefs: Beliefs,
    counts: Counts,
    implications: Implications | None,
) -> list[dict[str, object]]:
    """Rows of one action: every candidate as a condition, and those that may change as effects."""
    hypotheses = beliefs.hypotheses
    role = beliefs.roles[indices]
    required = role[:, hypotheses.condition == 1].sum(axis=1)
    effects = np.stack(
        [role[:, hypotheses.effect == each].sum(axis=1) for each in (KEEP, ADD, DELETE)], axis=1
    )
    effect = effects.argmax(axis=1)
    is_condition = (required >= _HALF) & (effect != ADD)
    conditions = [over[indices[n]] for n in np.flatnonzero(is_condition)]
    is_deleted = {over[indices[n]]: bool(effect[n] == DELETE) for n in range(len(indices))}
    kept, reasons = conditions, dict[Candidate, str]()
    if implications is not None:
        kept, reasons = needed(conditions, is_deleted, implications)
    rows: list[dict[str, object]] = []
    for n, index in enumerate(indices):
        each = over[index]
        shared = {
            "operator": traces.signatures.actions[each.action].name,
            "predicate": each.atom.predicate,
            "variables": list(each.atom.arguments),
            "n_transitions": int(counts.n_transitions[each.action]),
        }
        before = {"n_support": int(counts.true_before[index]), "n_against": int(counts.false_before[index])}
        rows.append(
            {
                **shared,
                **before,
                "role": "precondition",
                "is_positive": True,
                "probability": min(float(required[n]), 1.0),
                "is_kept": each in kept,
                "note": reasons.get(each),
            }
        )
        if effect[n] != KEEP:
            true, false = int(counts.true_after[index]), int(counts.false_after[index])
            is_added = bool(effect[n] == ADD)
            rows.append(
                {
                    **shared,
                    "n_support": true if is_added else false,
                    "n_against": false if is_added else true,
                    "role": "effect",
                    "is_positive": is_added,
                    "probability": min(float(effects[n, effect[n]]), 1.0),
                    "is_kept": True,
                    "note": None,
                }
            )
    return rows
