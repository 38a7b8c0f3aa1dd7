"""What an action could have been applied to and never was: the evidence for a negative condition.

That a literal was always false before an action mostly follows from the action's other conditions. Only where
those left it free, and it was true often enough that chance cannot have avoided it, is it forbidden.
"""

import math
from collections.abc import Sequence

import numpy as np
import polars as pl

from demoplan.language.traces import TraceSet
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.snapshots import Snapshots
from demoplan.stages.denoise.touches import Candidate, GroundCodes

_MAX_BINDINGS = 200_000
"""More ways to bind an action's parameters than these are not looked through."""


def forbidden(
    conditions: Sequence[Candidate],
    avoided: Sequence[Candidate],
    n_instances: int,
    traces: TraceSet,
    seen: Snapshots,
    codes: GroundCodes,
    params: DenoiseParams,
) -> dict[Candidate, str]:
    """Literals that one action's instances avoided although its conditions did not, and the evidence.

    Args:
        conditions: The action's positive conditions.
        avoided: Literals that were false before every instance.
        n_instances: How many instances there were.
        traces: Where they come from.
        seen: Atoms that hold in some states, after noise is taken out.
        codes: Codes of ground atoms.
        params: How strong evidence must be.
    """
    chances = _bindings(conditions, seen, codes)
    if chances is None or chances.height < params.n_implied_min:
        return {}
    found: dict[Candidate, str] = {}
    state = chances["state"].to_numpy()
    for each in avoided:
        names = [str(term) for term in each.terms]
        if not set(names) <= set(chances.columns):
            continue
        code = codes.of(each.predicate, [chances[name].to_numpy() for name in names], len(state))
        is_true = np.isin(code * seen.n + state, seen.likely)
        share = float(is_true.mean())
        if is_true.sum() < params.n_implied_min:
            continue
        evidence = math.inf if share == 1 else -n_instances * math.log1p(-share)
        # A literal that is true whenever the conditions hold was avoided by misreading, not by the action.
        if params.forbidden_evidence <= evidence < math.inf:
            found[each] = f"avoided {n_instances} times where it held in {share:.0%} of the chances"
    return found


def _bindings(conditions: Sequence[Candidate], seen: Snapshots, codes: GroundCodes) -> pl.DataFrame | None:
    """Every way to meet the conditions in the snapshots: a column per parameter, and ``state``."""
    table: pl.DataFrame | None = None
    waiting = sorted(conditions, key=lambda each: (len(each.terms), each.terms, each.predicate))
    predicate = codes.predicate_of(seen.sure_code)
    while waiting:
        bound = set() if table is None else set(table.columns)
        # Next, the condition that shares most parameters with those already bound.
        each = max(waiting, key=lambda one: sum(str(term) in bound for term in one.terms))
        waiting.remove(each)
        if any(term < 0 for term in each.terms):
            continue
        rows = predicate == each.predicate
        columns = {"state": seen.sure_state[rows]}
        is_fit = np.ones(int(rows.sum()), dtype=np.bool_)
        for position, term in enumerate(each.terms):
            objects = codes.object_of(seen.sure_code[rows], position)
            if str(term) in columns:
                is_fit &= columns[str(term)] == objects
            columns[str(term)] = objects
        part = pl.DataFrame({name: column[is_fit] for name, column in columns.items()})
        table = part if table is None else table.join(part, on=sorted(bound & set(part.columns)))
        if table.height > _MAX_BINDINGS:
            return None
    return table
