"""Transitions to operators: the verb, and its tables."""

import re
from collections.abc import Sequence
from math import log2
from typing import NamedTuple

import dataframely as dy
import numpy as np
import polars as pl

from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.learn.bind import bind_arguments, bind_roles
from demoplan.stages.learn.conditional import part_by_conditions
from demoplan.stages.learn.encode import encode
from demoplan.stages.learn.findings import findings_of, splits_of, with_applied
from demoplan.stages.learn.lift import AFTER, BEFORE, Lifted, LiftedAtom, Pattern, lift
from demoplan.stages.learn.mend import mend
from demoplan.stages.learn.merge import Candidate, Draft, merge, weigh
from demoplan.stages.learn.params import LearnParams
from demoplan.stages.learn.reach import keep_plannable
from demoplan.stages.learn.relevance import LOGGED, TRACED
from demoplan.stages.learn.retyping import Retyping, strongest
from demoplan.stages.learn.settle import settle
from demoplan.stages.learn.sound import check_balance, keep_apart, prune
from demoplan.stages.learn.splitting import TypeSplit
from demoplan.tables import Evidence, Findings, Literals, Operators, Transitions

MAX_COST = 1_000_000
"""Keeps the cost of any plan within Fast Downward's 32-bit integers."""


class Learned(NamedTuple):
    """What was learned, and the evidence behind it."""

    operators: dy.DataFrame[Operators]
    literals: dy.DataFrame[Literals]
    evidence: dy.DataFrame[Evidence]
    findings: dy.DataFrame[Findings]


def learn(
    transitions: dy.DataFrame[Transitions],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams = LearnParams(),
) -> Learned:
    """Operators that explain the transitions, with the counts behind every literal.

    An operator is the transition into an activity. Logged activities bind a hand, the object that it
    manipulates, and what that object's support changed from and to; symbolic traces bind what their actions
    name. Nothing depends on the order of rows, on the names of instances, or on chance.

    Args:
        transitions: Of any number of episodes; logs and symbolic traces are not mixed.
        types: The hierarchy that instances' types belong to.
        predicates: Every predicate that atoms may have.
        params: Learning choices.

    Returns:
        Operators (those that are not believed are marked as quarantined, with the reason), every literal
        that was considered, which transitions stand behind each operator, and what was found on the way.

    Raises:
        UnknownNameError: If a predicate or a type is unknown.
        DataError: If an atom has the wrong number of arguments, or an object has no type.
    """
    return _learn(transitions, types, predicates, params)[0]


MAX_SPLIT_ROUNDS = 3
"""How often types are split again once operators were learned with those of the round before."""


def learn_splitting_types(
    transitions: dy.DataFrame[Transitions],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams = LearnParams(),
) -> tuple[Learned, Retyping]:
    """As :func:`learn`, with the types applied that behaviour was found to split.

    Operators are learned, types are split where the evidence is strong, and operators are learned again with
    the new types, until nothing splits any more. The findings say which splits were applied.

    Args:
        transitions: Of logs, of any number of episodes.
        types: The hierarchy that instances' types belong to.
        predicates: Every predicate that atoms may have.
        params: Learning choices.

    Returns:
        What was learned, and the types, predicates and instances' types that it is in terms of.
    """
    retyping = Retyping.of(types, predicates)
    applied: list[TypeSplit] = []
    for _ in range(MAX_SPLIT_ROUNDS):
        learned, splits = _learn(
            retyping.transitions(transitions), retyping.types, retyping.predicates, params
        )
        chosen = strongest(splits)
        if not chosen:
            break
        for split in chosen:
            retyping = retyping.split(split.type_name, split.apart)
        applied += chosen
    else:
        learned, _ = _learn(retyping.transitions(transitions), retyping.types, retyping.predicates, params)
    return learned._replace(findings=with_applied(learned.findings, applied)), retyping


def _learn(
    transitions: dy.DataFrame[Transitions],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams,
) -> tuple[Learned, tuple[TypeSplit, ...]]:
    data = encode(transitions, types, predicates)
    if data.arguments is not None:
        lifted = lift(data, bind_arguments(data, data.arguments), None, params)
        drafts = merge(lifted, types, data.predicates, params, TRACED)
        return tables_of(drafts, data.table, data.names, lifted, params), ()
    mended = mend(data, types, params.mend)
    # What was read is not needed any more, and large.
    data = mended.data
    settled = settle(data, types, params)
    lifted = lift(data, bind_roles(data, settled, params), settled, params)
    misread_rate = mended.rates.overall if mended.is_needed else 0.0
    drafts = drafts_of_logs(lifted, types, data.predicates, params, misread_rate)
    learned = tables_of(drafts, data.table, data.names, lifted, params)
    named = _named(drafts)
    splits = splits_of(data, lifted, named)
    return learned._replace(findings=findings_of(mended, lifted, named, splits)), splits


def drafts_of_logs(
    lifted: Lifted,
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams,
    misread_rate: float = 0.0,
) -> list[Draft]:
    """Operators of logged activities: they depend on patterns and their counts alone.

    Where readings are wrong at some rate, what is no more frequent than that is not believed.
    """
    drafts = merge(lifted, types, predicates, params, LOGGED, misread_rate)
    parts = [
        part
        for draft in drafts
        for part in part_by_conditions(draft, lifted.patterns, types, predicates, LOGGED)
    ]
    if len(parts) > len(drafts):
        drafts = weigh(
            parts,
            lifted.patterns,
            types,
            predicates,
            params=params,
            relevance=LOGGED,
            misread_rate=misread_rate,
        )
    drafts = [keep_apart(draft, lifted.patterns, types, predicates, params) for draft in drafts]
    drafts = [check_balance(draft, lifted.patterns, params) for draft in drafts]
    return list(keep_plannable(prune(drafts, params, misread_rate), params))


def tables_of(
    drafts: Sequence[Draft], rows: pl.DataFrame, names: Sequence[str], lifted: Lifted, params: LearnParams
) -> Learned:
    """Drafts as tables, with the evidence behind them; what was found on the way is not theirs to tell.

    Args:
        drafts: Operators.
        rows: ``episode_id``, ``hand``, ``start_ns`` and ``end_ns`` of every transition.
        names: Instances, by the codes of ``lifted.bindings``.
        lifted: Which pattern each transition shows, and what its variables are bound to.
        params: Learning choices.
    """
    named = _named(drafts)
    return Learned(
        _operators(named, rows, lifted, params),
        _literals(named, lifted.variables),
        _evidence(named, rows, names, lifted),
        Findings.create_empty(),
    )


def _named(drafts: Sequence[Draft]) -> list[tuple[str, Draft]]:
    """Drafts with names: the activity, numbered from the most frequent; sorted by name."""
    ordered = sorted(
        drafts,
        key=lambda draft: (
            draft.activity,
            draft.quarantine is not None,
            -draft.count,
            repr(draft.types),
            draft.grip,
        ),
    )
    names: dict[str, int] = {}
    result = []
    for draft in ordered:
        stem = re.sub(r"[^a-z0-9]+", "_", draft.activity.lower()).strip("_") or "activity"
        stem = stem if stem[0].isalpha() else f"a_{stem}"
        names[stem] = names.get(stem, 0) + 1
        result.append((f"{stem}_{names[stem]}", draft))
    return result


def success_probability(n_demonstrated: int, n_successes: int, n_failures: int, params: LearnParams) -> float:
    """Posterior mean of success: Beta(1, 1), executions, and demonstrations up to a cap as successes.

    >>> success_probability(100, 0, 0, LearnParams()), success_probability(1, 2, 4, LearnParams())
    (0.75, 0.4444444444444444)
    """
    successes = 1 + min(n_demonstrated, params.max_demonstrations) + n_successes
    return successes / (successes + 1 + n_failures)


def planner_cost(count: int, most: int, beta: float, params: LearnParams) -> int:
    """What a planner minimises: a step's own cost, and so much for each bit of rarity or of unreliability.

    With ``cost="count"`` it is ``step_cost + round(cost_per_bit · log2(most / count))``; with
    ``cost="beta"``, ``step_cost + round(cost_per_bit · −log2(beta))``. Costs add up along a plan as
    logarithms of shares do.

    >>> planner_cost(12, 12, 0.75, LearnParams()), planner_cost(3, 12, 0.75, LearnParams())
    (10, 30)
    """
    bits = -log2(beta) if params.cost == "beta" else log2(max(most, count, 1) / max(count, 1))
    return min(params.step_cost + round(params.cost_per_bit * bits), MAX_COST)


def _operators(
    named: Sequence[tuple[str, Draft]], rows_of: pl.DataFrame, lifted: Lifted, params: LearnParams
) -> dy.DataFrame[Operators]:
    most = max((draft.count for _, draft in named if not draft.quarantine), default=1)
    number = _draft_of_pattern(named, lifted)[lifted.pattern_of]
    episodes = (
        pl.DataFrame({"number": number, "episode_id": rows_of["episode_id"]})
        .group_by("number")
        .agg(pl.col("episode_id").n_unique())
    )
    n_episodes = dict(zip(*episodes.select("number", "episode_id").get_columns(), strict=True))
    rows = []
    for position, (name, draft) in enumerate(named):
        beta = success_probability(draft.count, 0, 0, params)
        rows.append(
            {
                "operator": name,
                "activity": draft.activity,
                "parameters": [
                    {"variable": lifted.variables[place], "type": draft.types[place]}
                    for place in draft.variables
                ],
                "n_transitions": draft.count,
                "n_episodes": n_episodes.get(position, 0),
                "n_successes": 0,
                "n_failures": 0,
                "beta": beta,
                "cost": planner_cost(draft.count, most, beta, params),
                "is_quarantined": draft.quarantine is not None,
                "note": draft.quarantine or draft.note,
            }
        )
    return Operators.validate(pl.DataFrame(rows, schema=Operators.create_empty().schema).sort("operator"))


def _draft_of_pattern(
    named: Sequence[tuple[str, Draft]], lifted: Lifted
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    number = np.full(len(lifted.patterns), -1, dtype=np.int64)
    for position, (_, draft) in enumerate(named):
        number[list(draft.patterns)] = position
    return number


def _literals(named: Sequence[tuple[str, Draft]], variables: Sequence[str]) -> dy.DataFrame[Literals]:
    rows = [
        {
            "operator": name,
            "role": role,
            "predicate": each.atom.predicate,
            "variables": [variables[place] for place in each.atom.variables],
            "is_positive": each.is_positive,
            "n_support": each.n_support,
            "n_against": each.n_against,
            "n_transitions": draft.count,
            "probability": each.probability,
            "is_kept": each.is_kept,
            "note": each.note,
        }
        for name, draft in named
        for role, candidates in (("precondition", draft.preconditions), ("effect", draft.effects))
        for each in candidates
    ]
    table = pl.DataFrame(rows, schema=Literals.create_empty().schema)
    return Literals.validate(table.sort("operator", "role", "predicate", "variables", "is_positive"))


def _evidence(
    named: Sequence[tuple[str, Draft]], rows: pl.DataFrame, instances: Sequence[str], lifted: Lifted
) -> dy.DataFrame[Evidence]:
    pattern_rows = [
        {
            "pattern": position,
            "operator": name,
            "used": list(draft.variables),
            "contradicts": _contradictions(draft, lifted.patterns[position], lifted.variables),
        }
        for name, draft in named
        for position in draft.patterns
    ]
    patterns = pl.DataFrame(
        pattern_rows,
        schema={
            "pattern": pl.Int64,
            "operator": pl.String,
            "used": pl.List(pl.Int64),
            "contradicts": pl.List(pl.String),
        },
    )
    names = pl.Series(instances, dtype=pl.String)
    columns = [
        pl.Series(f"_{place}", lifted.bindings[:, place]).replace(-1, None)
        for place in range(lifted.bindings.shape[1])
    ]
    bound = pl.DataFrame([names.gather(column) for column in columns]) if columns else pl.DataFrame()
    table = (
        pl.concat(
            [
                rows.select("episode_id", "hand", "start_ns", "end_ns"),
                pl.DataFrame({"pattern": lifted.pattern_of}),
                bound.select(binding=pl.concat_list(pl.all())) if columns else pl.DataFrame({"binding": []}),
            ],
            how="horizontal",
        )
        .join(patterns, on="pattern", how="inner", maintain_order="left")
        .with_columns(pl.col("binding").list.gather(pl.col("used")))
        .select(Evidence.column_names())
        .sort("operator", "episode_id", "hand", "start_ns")
    )
    return Evidence.validate(table, cast=True)


def _contradictions(draft: Draft, pattern: Pattern, variables: Sequence[str]) -> list[str]:
    """Stated literals that a pattern shows the opposite of."""
    against = []
    for role, side, candidates in (
        ("precondition", BEFORE, draft.preconditions),
        ("effect", AFTER, draft.effects),
    ):
        for each in candidates:
            is_known = each.atom not in pattern.unknown[side]
            if each.is_kept and is_known and (each.atom in pattern.true[side]) != each.is_positive:
                against.append(f"{role} {_text(each, variables)}")
    return sorted(against)


def _text(candidate: Candidate, variables: Sequence[str]) -> str:
    atom: LiftedAtom = candidate.atom
    text = f"{atom.predicate}({','.join(variables[place] for place in atom.variables)})"
    return text if candidate.is_positive else f"not {text}"
