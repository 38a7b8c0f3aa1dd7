"""Noisy traces to operators and literals, each with its probability and the counts behind it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.inference import ADD, DELETE, KEEP, Beliefs, FlipRates, Timelines, believe
from demoplan.language.atoms import Atom, Literal
from demoplan.language.traces import TraceSet
from demoplan.language.traces.values import Codes
from demoplan.stages.denoise.counts import Counts, count
from demoplan.stages.denoise.implications import Implications, Rules, needed
from demoplan.stages.denoise.opportunities import Occasions, Opportunity, forbidden, occasions, undone
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.snapshots import snapshots
from demoplan.stages.denoise.touches import Candidate, GroundCodes, candidates, spans, touch
from demoplan.tables import Literals, Operators

Row = Mapping[str, Any]
"""A row of a table to be."""


@dataclass(frozen=True, eq=False)
class Denoised:
    """What was learned from traces; the tables are made and validated when they are first asked for."""

    operator_rows: tuple[Row, ...]
    literal_rows: tuple[Row, ...]
    flip_rates: dict[str, tuple[float, float]]
    """Per predicate: probability that a true atom was not seen, and that a false atom was seen."""
    flip_rate: float
    """Over all predicates."""
    n_rounds: int
    is_settled: bool
    """Whether beliefs came to rest within the rounds allowed."""

    @cached_property
    def operators(self) -> dy.DataFrame[Operators]:
        """One row per action that was seen."""
        return Operators.validate(_frame(Operators, self.operator_rows), cast=True)

    @cached_property
    def literals(self) -> dy.DataFrame[Literals]:
        """One row per literal that was considered, with its counts and its probability."""
        return Literals.validate(_frame(Literals, self.literal_rows), cast=True)

    def actions(self) -> dict[str, tuple[frozenset[Literal], frozenset[Literal]]]:
        """Preconditions and effects of each operator, as far as they are stated."""
        found: dict[str, tuple[set[Literal], set[Literal]]] = {
            row["operator"]: (set(), set()) for row in self.operator_rows
        }
        for row in self.literal_rows:
            if row["is_kept"]:
                literal = Literal(Atom(row["predicate"], tuple(row["variables"])), row["is_positive"])
                found[row["operator"]][row["role"] == "effect"].add(literal)
        return {name: (frozenset(pre), frozenset(effects)) for name, (pre, effects) in found.items()}


@dataclass(frozen=True, eq=False)
class Gathered:
    """What is kept of traces: counts over all of them, and as many of their spans as learning needs.

    Its size does not grow with the number of traces once every action has enough instances.
    """

    sample: TraceSet
    counts: Counts
    n_episodes: Codes
    """Per action, traces with an instance of it."""


def gather(
    traces: TraceSet, params: DenoiseParams = DenoiseParams(), so_far: Gathered | None = None
) -> Gathered:
    """Add traces to what was gathered from others of the same reader.

    While no action has ``max_instances`` instances, everything is kept and the order of arrival does not
    matter to what is learned; later traces are counted, and kept where they show an action still rare.
    """
    over = candidates(traces.signatures)
    counts = count(traces, over, GroundCodes(traces))
    n_actions = len(traces.signatures.actions)
    n_sampled = None if so_far is None else np.bincount(so_far.sample.action_signature, minlength=n_actions)
    chosen = spans(traces, params, n_sampled)
    sample = traces.select(chosen.first, chosen.last)
    n_episodes = _n_episodes(traces)
    if so_far is None:
        return Gathered(sample, counts, n_episodes)
    return Gathered(so_far.sample.join(sample), so_far.counts + counts, so_far.n_episodes + n_episodes)


def forget(gathered: Gathered, traces: TraceSet) -> Gathered:
    """What would have been gathered without some traces.

    Exact while everything is kept, see :func:`gather`; later the counts stay exact, and the sample loses what
    it had of these traces.

    Args:
        gathered: What was gathered, these traces among it.
        traces: All of the traces to forget, from the same reader; they are known by their names.
    """
    counts = gathered.counts - count(traces, candidates(traces.signatures), GroundCodes(traces))
    sample, names = gathered.sample, set(traces.trace_names)
    is_start = np.r_[True, sample.state_trace[1:] != sample.state_trace[:-1]][: sample.n_states]
    first = np.flatnonzero(is_start)
    last = np.r_[first[1:] - 1, sample.n_states - 1][: len(first)]
    is_kept = np.array([sample.trace_names[trace] not in names for trace in sample.state_trace[first]], bool)
    rest = sample.select(first[is_kept], last[is_kept])
    return Gathered(rest, counts, gathered.n_episodes - _n_episodes(traces))


def denoise(traces: TraceSet, params: DenoiseParams = DenoiseParams()) -> Denoised:
    """Learn one operator per action of the traces' signatures.

    Args:
        traces: What was observed, with misreadings; how many is estimated from the traces.
        params: Priors and limits.

    Returns:
        Operators and literals; an action without an instance gives no operator. Beliefs come from at most
        ``max_instances`` instances per action and what stands around them; counts come from all.
    """
    return conclude(gather(traces, params), params)


def conclude(gathered: Gathered, params: DenoiseParams = DenoiseParams()) -> Denoised:
    """Learn from what was gathered; see :func:`denoise`."""
    traces = gathered.sample
    over = candidates(traces.signatures)
    codes = GroundCodes(traces)
    chosen = spans(traces, params)
    touches = touch(traces, chosen, over, codes)
    predicate = np.array([each.predicate for each in over], dtype=np.int64)
    beliefs = believe(touches.timelines, predicate, len(traces.signatures.predicates), params)
    n_actions = len(traces.signatures.actions)
    owner = np.array([each.action for each in over], dtype=np.int64)
    is_seen = gathered.counts.n_transitions[owner] > 0
    verdicts = _verdicts(over, touches.timelines, gathered.counts, beliefs, params)
    implications = None
    if params.is_minimal and len(touches.timelines.entry_touch):
        seen = snapshots(traces, chosen, touches, beliefs, codes, params)
        rules = Rules(
            conditions=_by_action(over, verdicts.is_condition & is_seen, n_actions),
            adds=_by_action(over, (verdicts.effect == ADD) & is_seen, n_actions),
            deletes=_by_action(over, (verdicts.effect == DELETE) & is_seen, n_actions),
        )
        implications = Implications(traces, seen, rules, codes, params)
    of_action = {
        int(action): np.flatnonzero(owner == action)
        for action in np.flatnonzero(gathered.counts.n_transitions)
    }
    names = [each.name for each in traces.signatures.actions]
    negative = (
        {} if implications is None else _forbidden(over, of_action, names, verdicts, implications, params)
    )
    rows: list[Row] = []
    for indices in of_action.values():
        rows += _literals(traces, over, indices, verdicts, gathered.counts, implications, negative)
    rates = zip(beliefs.rates.missed.tolist(), beliefs.rates.imagined.tolist(), strict=True)
    predicates = [each.name for each in traces.signatures.predicates]
    return Denoised(
        operator_rows=_operators(gathered),
        literal_rows=tuple(rows),
        flip_rates=dict(zip(predicates, rates, strict=True)),
        flip_rate=beliefs.flip_rate,
        n_rounds=beliefs.n_rounds,
        is_settled=beliefs.is_settled,
    )


@dataclass(frozen=True, eq=False)
class _Verdicts:
    """Per candidate: what it is taken for, and how likely that is."""

    is_condition: NDArray[np.bool_]
    effect: Codes
    required: NDArray[np.float64]
    """Probability that it is a condition."""
    occasions: tuple[Occasions, ...]
    """How often its action met it, and it was true."""
    effects: NDArray[np.float64]
    """``(n_candidates, 3)``: probabilities of keeping, adding, deleting."""


def _verdicts(
    over: tuple[Candidate, ...], timelines: Timelines, counts: Counts, beliefs: Beliefs, params: DenoiseParams
) -> _Verdicts:
    # Messages that go round in loops make surer than they should: what else is known may add only so much to
    # what was seen right before and after an action.
    before = _odds(over, counts.true_before, counts.false_before, beliefs.rates)
    after = _odds(over, counts.true_after, counts.false_after, beliefs.rates)
    required, effects = np.minimum(beliefs.required, _at_most(before, params)), beliefs.effects
    for column, odds in ((ADD, after), (DELETE, -after)):
        effects[:, column] = np.minimum(effects[:, column], _at_most(odds, params))
    effects[:, KEEP] = np.maximum(1 - effects[:, ADD] - effects[:, DELETE], 0)
    effect = effects.argmax(axis=1)
    action = np.array([each.action for each in over], dtype=np.int64)
    for each in np.unique(action):
        mine = np.flatnonzero(action == each)
        likeliest = mine[effects[mine, ADD].argmax()]
        if not (effect[mine] == ADD).any() and effects[likeliest, ADD] >= params.effect_despite:
            effect[likeliest] = ADD
    least = np.where(effect == DELETE, params.required_if_deleted_min, params.required_min)
    met = occasions(timelines, beliefs.messages, len(over))
    return _Verdicts((required >= least) & (effect != ADD), effect, required, met, effects)


def _odds(over: tuple[Candidate, ...], true: Codes, false: Codes, rates: FlipRates) -> NDArray[np.float64]:
    """Logarithm of the odds that literals were always true against always false, by how they were seen."""
    predicate = np.array([each.predicate for each in over], dtype=np.int64)
    missed, imagined = rates.missed[predicate], rates.imagined[predicate]
    return np.asarray(true * np.log((1 - missed) / imagined) + false * np.log(missed / (1 - imagined)))


def _at_most(odds: NDArray[np.float64], params: DenoiseParams) -> NDArray[np.float64]:
    """The highest probability that what was seen directly leaves room for."""
    return np.asarray(1 / (1 + np.exp(np.clip(-odds - params.chain_evidence_max, -700, 700))))


def _forbidden(
    over: tuple[Candidate, ...],
    of_action: Mapping[int, Codes],
    names: Sequence[str],
    verdicts: _Verdicts,
    implications: Implications,
    params: DenoiseParams,
) -> dict[Candidate, tuple[float, str]]:
    """Literals that actions avoid though nothing else makes them; how habits go is seen over all actions."""
    found: list[Opportunity] = []
    for indices in of_action.values():
        conditions = [over[index] for index in indices if verdicts.is_condition[index]]
        # Nobody does again what is done, or undoes what is undone: what an action changes it meets by habit.
        others = {
            over[index]: verdicts.occasions[index]
            for index in indices
            if verdicts.effect[index] == KEEP and not verdicts.is_condition[index]
        }
        found += implications.opportunities(conditions, others)
    effects = (
        (
            names[action],
            [over[index] for index in indices if verdicts.effect[index] == ADD],
            [over[index] for index in indices if verdicts.effect[index] == DELETE],
        )
        for action, indices in of_action.items()
    )
    return forbidden(found, undone(effects), params)


def _by_action(
    over: tuple[Candidate, ...], is_chosen: NDArray[np.bool_], n_actions: int
) -> dict[int, list[Candidate]]:
    found: dict[int, list[Candidate]] = {action: [] for action in range(n_actions)}
    for index in np.flatnonzero(is_chosen):
        found[over[index].action].append(over[index])
    return found


def _n_episodes(traces: TraceSet) -> Codes:
    names = {name: n for n, name in enumerate(dict.fromkeys(traces.trace_names))}
    episode = np.array([names[name] for name in traces.trace_names], dtype=np.int64)
    n_actions = len(traces.signatures.actions)
    if not traces.n_actions:
        return np.zeros(n_actions, dtype=np.int64)
    pair = episode[traces.state_trace[traces.action_state]] * n_actions + traces.action_signature
    return np.bincount(np.unique(pair) % n_actions, minlength=n_actions)


def _frame(schema: type[dy.Schema], rows: Sequence[Row]) -> pl.DataFrame:
    return pl.DataFrame(rows, schema={name: column.dtype for name, column in schema.columns().items()})


def _operators(gathered: Gathered) -> tuple[Row, ...]:
    rows: list[Row] = []
    for index, action in enumerate(gathered.sample.signatures.actions):
        n = int(gathered.counts.n_transitions[index])
        if not n:
            continue
        parameters = [{"variable": each.variable, "type": each.type_name} for each in action.parameters]
        rows.append(
            {
                "operator": action.name,
                "activity": action.name,
                "parameters": parameters,
                "n_transitions": n,
                "n_episodes": int(gathered.n_episodes[index]),
                "n_successes": 0,
                "n_failures": 0,
                # Every trace shows what succeeded; Laplace's rule of succession.
                "beta": (n + 1) / (n + 2),
                "cost": 1,
                "is_quarantined": False,
                "note": None,
            }
        )
    return tuple(rows)


def _literals(
    traces: TraceSet,
    over: tuple[Candidate, ...],
    indices: Codes,
    verdicts: _Verdicts,
    counts: Counts,
    implications: Implications | None,
    negative: Mapping[Candidate, tuple[float, str]],
) -> list[Row]:
    """Rows of one action: every candidate as a condition, and those that may change as effects."""
    conditions = [over[index] for index in indices if verdicts.is_condition[index]]
    is_deleted = {over[index]: bool(verdicts.effect[index] == DELETE) for index in indices}
    kept, reasons = conditions, dict[Candidate, str]()
    if implications is not None:
        kept, reasons = needed(conditions, is_deleted, implications)
    rows: list[Row] = []
    for index in indices:
        each = over[index]
        effect = verdicts.effect[index]
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
                "probability": min(float(verdicts.required[index]), 1.0),
                "is_kept": each in kept,
                "note": reasons.get(each),
            }
        )
        if each in negative:
            rows.append(
                {
                    **shared,
                    "n_support": before["n_against"],
                    "n_against": before["n_support"],
                    "role": "precondition",
                    "is_positive": False,
                    "probability": negative[each][0],
                    "is_kept": True,
                    "note": negative[each][1],
                }
            )
        if effect != KEEP:
            true, false = int(counts.true_after[index]), int(counts.false_after[index])
            is_added = bool(effect == ADD)
            rows.append(
                {
                    **shared,
                    "n_support": true if is_added else false,
                    "n_against": false if is_added else true,
                    "role": "effect",
                    "is_positive": is_added,
                    "probability": min(float(verdicts.effects[index, effect]), 1.0),
                    "is_kept": True,
                    "note": None,
                }
            )
    return rows
