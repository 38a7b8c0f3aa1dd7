"""Types whose objects behave unlike: what the same activity did to some of them, and not to others.

A ball that is put onto a cube lies on the table afterwards. If both are of one type, the operators of Put
contradict each other; that it is always the same objects with which it goes otherwise, says that they are of
another kind. What a hand chose to do with which object is a habit and says nothing: compared is only what
came of the same activity, aimed at the same type of thing.

Source: for the test, I. J. Good, "On the application of symmetric Dirichlet distributions and their mixtures
to contingency tables", Annals of Statistics 4(6), 1976, doi:10.1214/aos/1176343649.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import lgamma, log

import numpy as np
import polars as pl

from demoplan.stages.learn.bind import OBJECT
from demoplan.stages.learn.encode import NOBODY, Encoded, Ints
from demoplan.stages.learn.lift import Lifted

MIN_LOG_BAYES_FACTOR = log(20.0)
"""Strong evidence, by the usual scale."""
MISNAMED_SHARE = 0.1
"""Of an object's other activities, so many may have been given this one's name by mistake: what is no more
frequent than that says nothing of the object."""


@dataclass(frozen=True, kw_only=True)
class TypeSplit:
    """Objects of one type, some of which behave unlike the others."""

    type_name: str
    apart: tuple[str, ...]
    """The fewer of them."""
    rest: tuple[str, ...]
    role: str
    """``moved`` or ``aimed at``."""
    activity: str
    n_apart: int
    """Transitions of those apart."""
    n_rest: int
    log_bayes_factor: float


def find_splits(data: Encoded, lifted: Lifted, outcome_of_pattern: Ints) -> tuple[TypeSplit, ...]:
    """Types that behaviour splits, the strongest evidence first; at most one split for each type and role.

    Args:
        data: The transitions.
        lifted: What each of them shows.
        outcome_of_pattern: Which operator, believed or not, each pattern belongs to; −1 for none.
    """
    outcome = outcome_of_pattern[lifted.pattern_of]
    rows = np.flatnonzero((outcome >= 0) & (data.acted_on != NOBODY))
    aim = data.type_of(rows, data.acted_on[rows])
    found: list[TypeSplit] = []
    for role, instance in (("moved", lifted.bindings[rows, OBJECT]), ("aimed at", data.acted_on[rows])):
        has = instance != NOBODY
        table = (
            pl.DataFrame(
                {
                    "type": data.type_of(rows[has], instance[has]),
                    "activity": data.activity[rows[has]],
                    "aim": aim[has],
                    "instance": instance[has],
                    "outcome": outcome[rows[has]],
                }
            )
            .group_by(pl.all())
            .len()
        )
        for (code,), part in table.sort(pl.all()).group_by("type", maintain_order=True):
            best = _best_split(data, int(str(code)), role, part)
            if best is not None:
                found.append(best)
    return tuple(sorted(found, key=lambda each: (-each.log_bayes_factor, each.type_name, each.role)))


def _best_split(data: Encoded, code: int, role: str, table: pl.DataFrame) -> TypeSplit | None:
    counts: dict[tuple[int, int], dict[int, Counter[int]]] = defaultdict(lambda: defaultdict(Counter))
    n_of: Counter[int] = Counter()
    for _, activity, aim, instance, outcome, n in table.iter_rows():
        n_of[instance] += n
        counts[activity, aim][instance][outcome] += n
    best: TypeSplit | None = None
    for (activity, _), of_instance in sorted(counts.items()):
        instances = sorted(of_instance)
        if len(instances) < 2:
            continue
        total = _sum(of_instance.values())
        usual = max(total, key=lambda outcome: (total[outcome], -outcome))
        apart = [
            each
            for each in instances
            if _differs(of_instance[each], usual) and not _is_by_mistake(of_instance[each], n_of[each])
        ]
        rest = [each for each in instances if each not in apart]
        if not apart or not rest:
            continue
        groups = [_sum(of_instance[each] for each in group) for group in (apart, rest)]
        n_outcomes = len(total)
        gain = sum(_log_evidence(each, n_outcomes) for each in groups) - _log_evidence(total, n_outcomes)
        # As many ways to part them as there are halves of a set.
        gain -= (len(instances) - 1) * log(2.0)
        if gain >= MIN_LOG_BAYES_FACTOR and (best is None or gain > best.log_bayes_factor):
            names = [tuple(data.names[each] for each in group) for group in (apart, rest)]
            best = TypeSplit(
                type_name=data.types[code],
                apart=names[0],
                rest=names[1],
                role=role,
                activity=data.activities[activity],
                n_apart=sum(groups[0].values()),
                n_rest=sum(groups[1].values()),
                log_bayes_factor=gain,
            )
    return best


def _differs(counts: Mapping[int, int], usual: int) -> bool:
    return max(counts.values()) > counts.get(usual, 0)


def _is_by_mistake(counts: Mapping[int, int], n_in_all: int) -> bool:
    n = sum(counts.values())
    return n <= MISNAMED_SHARE * (n_in_all - n)


def _sum(counters: Iterable[Mapping[int, int]]) -> Counter[int]:
    total: Counter[int] = Counter()
    for each in counters:
        total.update(each)
    return total


def _log_evidence(counts: Mapping[int, int], n_outcomes: int) -> float:
    """Log probability of a sequence with these outcomes; their shares are Dirichlet, all 1/2."""
    weight = 0.5
    n = sum(counts.values())
    return (
        lgamma(weight * n_outcomes)
        - lgamma(weight * n_outcomes + n)
        + sum(lgamma(weight + each) - lgamma(weight) for each in counts.values())
    )
