"""Which instances an operator speaks of: the hand, the object, and what its support changed from and to."""

from dataclasses import dataclass

import numpy as np

from demoplan.stages.learn.encode import NOBODY, Encoded, Ints
from demoplan.stages.learn.params import LearnParams
from demoplan.stages.learn.settle import Settled

HAND, OBJECT, FROM, TO, TARGET = range(5)
ROLES = ("?hand", "?object", "?from", "?to", "?target")
"""Variables of operators learned from logs. ``?target`` is what a held object is used on."""


@dataclass(frozen=True)
class Bindings:
    """Instances bound to each variable."""

    variables: tuple[str, ...]
    instances: Ints
    """Instance codes, shape (n, number of variables), ``NOBODY`` where a variable is not bound."""


def bind_roles(data: Encoded, settled: Settled, params: LearnParams) -> Bindings:
    """Bind the roles of logged activities.

    Bystanders are never bound: an object enters only as what the hand manipulates, as what that object
    rested on and no longer does, as what it has come to rest on, or as what the held object acts on.
    """
    roles = np.full((data.n, len(ROLES)), NOBODY, dtype=np.int64)
    roles[:, HAND] = data.hand
    roles[:, OBJECT] = settled.manipulated
    states = data.true.only(data.has_predicate(*params.supports))
    resting: list[Ints] = []
    for side in (0, 1):
        row, atom = states.gather(settled.support_source[:, side])
        is_rest = data.atom_arguments[atom, 0] == settled.manipulated[row]
        row, support = row[is_rest], data.atom_arguments[atom[is_rest]][:, 1:2].reshape(-1)
        resting.append(np.unique(row * len(data.names) + support))
    lost, gained = np.setdiff1d(resting[0], resting[1]), np.setdiff1d(resting[1], resting[0])
    roles[:, FROM] = _one_each(data, lost)
    roles[:, TO] = _one_each(data, gained)
    uses = (settled.holds[:, 0] == settled.manipulated) & (settled.holds[:, 1] == settled.manipulated)
    uses &= (settled.manipulated != NOBODY) & (roles[:, TO] == NOBODY)
    uses &= ~(roles[:, :TARGET] == data.acted_on[:, None]).any(axis=1)
    roles[uses, TARGET] = data.acted_on[uses]
    return Bindings(ROLES, roles)


def _one_each(data: Encoded, keys: Ints) -> Ints:
    """One support per row, of keys ``row * n_names + support``: what is acted on, else the first by type.

    An object that is set down across two others rests on both for the predicate; the hand aimed at one.
    """
    chosen = np.full(data.n, NOBODY, dtype=np.int64)
    if len(keys):
        row, support = np.divmod(keys, len(data.names))
        is_other = support != data.acted_on[row]
        order = np.lexsort((support, data.type_of(row, support), is_other, row))
        row, support = row[order], support[order]
        first = np.r_[True, row[1:] != row[:-1]]
        chosen[row[first]] = support[first]
    return chosen


def bind_arguments(data: Encoded, arguments: Ints) -> Bindings:
    """Bind the variables ``?x1``, ``?x2`` … of symbolic traces, whose actions name their instances."""
    return Bindings(tuple(f"?x{column + 1}" for column in range(arguments.shape[1])), arguments)
