"""Expected against sensed: what a step needs, what it should have done, and whether the rest still works.

Three questions, asked of sensed states only: do the conditions of a step hold at dispatch, do its effects
hold after it, and would the steps that remain still reach the goal from here? By the third, a change that
nobody expected is noticed before it is too late, and is not reported where it is harmless.

Source: R. Fikes, P. Hart, N. Nilsson, "Learning and executing generalized robot plans", Artificial
Intelligence 3, 1972, doi:10.1016/0004-3702(72)90051-3, for asking whether the rest of a plan still applies.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import dataframely as dy
import polars as pl

from demoplan.language.atoms import Atom, Literal
from demoplan.language.execution import GroundOperator, State, holds, unmet
from demoplan.tables import Facts


@dataclass(frozen=True, kw_only=True)
class MonitorParams:
    """How sensed facts become a state."""

    debounce_s: float = 0.10
    """An atom counts as it was for most of this long before the instant asked about [s]."""


@dataclass(frozen=True)
class SensedState:
    """What perception says of an instant; an atom in neither set was observed false."""

    tick_ns: int
    held: State
    unknown: State = frozenset()

    def says(self, literal: Literal) -> bool | None:
        """Whether a literal is true; None if that could not be observed."""
        return None if literal.atom in self.unknown else holds(literal, self.held)


@dataclass(frozen=True)
class Deviation:
    """How what is sensed differs from what was expected; all empty if it does not."""

    unmet: tuple[Literal, ...] = ()
    """Conditions that are observed false, sorted."""
    missing: tuple[Literal, ...] = ()
    """Effects that are observed not to have come about, sorted."""
    extra: tuple[Literal, ...] = ()
    """Changes that no step explains, sorted."""
    unobserved: tuple[Literal, ...] = ()
    """Conditions and effects that could not be observed, sorted."""
    broken: tuple[Literal, ...] = ()
    """What the rest of the plan, or the goal, now lacks, sorted."""

    @property
    def is_alarming(self) -> bool:
        """Whether something must be done about it: an unexplained change alone may be harmless."""
        return bool(self.unmet or self.missing or self.unobserved or self.broken)

    @property
    def literals(self) -> tuple[Literal, ...]:
        """Everything that should be so and is not, sorted and without repetition."""
        return tuple(sorted({*self.unmet, *self.missing, *self.unobserved, *self.broken}))


def sensed_state(
    facts: dy.DataFrame[Facts], instant_ns: int, params: MonitorParams = MonitorParams()
) -> SensedState:
    """The debounced state at an instant.

    Args:
        facts: Intervals of atoms of one episode, in any order.
        instant_ns: End of the stretch that is looked at [ns]; facts end one tick after the last sighting.
        params: Length of the stretch.

    Returns:
        Atoms that held, or could not be known, for more than half of the stretch.
    """
    length_ns = round(params.debounce_s * 1e9)
    overlap = pl.min_horizontal(pl.col("end_ns"), instant_ns) - pl.max_horizontal(
        pl.col("start_ns"), instant_ns - length_ns
    )
    spent = (
        facts.lazy()
        .with_columns(overlap.alias("overlap_ns"))
        .filter(pl.col("overlap_ns") > 0)
        .group_by("predicate", "arguments", "value")
        .agg(pl.col("overlap_ns").sum())
        .filter(pl.col("overlap_ns") * 2 > length_ns)
        .collect()
    )
    found: dict[str, set[Atom]] = {"true": set(), "unknown": set()}
    for row in spent.iter_rows(named=True):
        found[row["value"]].add(Atom(row["predicate"], tuple(row["arguments"])))
    return SensedState(instant_ns, frozenset(found["true"]), frozenset(found["unknown"]))


def before_step(step: GroundOperator, sensed: SensedState) -> Deviation:
    """What keeps a step from being dispatched: conditions that are false, or cannot be seen.

    Args:
        step: With the conditions that can be demanded.
        sensed: The state now.
    """
    said = {literal: sensed.says(literal) for literal in step.preconditions}
    return Deviation(
        unmet=tuple(sorted(literal for literal, value in said.items() if value is False)),
        unobserved=tuple(sorted(literal for literal, value in said.items() if value is None)),
    )


def is_done_already(step: GroundOperator, sensed: SensedState) -> bool:
    """Whether every effect of a step holds before it begins, so that it can be skipped."""
    return all(sensed.says(effect) for effect in effects_of(step))


def effects_of(step: GroundOperator) -> tuple[Literal, ...]:
    """The effects of a step as literals, sorted; what it both deletes and adds holds."""
    added = [Literal(atom) for atom in step.adds]
    return tuple(sorted(added + [Literal(atom, False) for atom in step.deletes - step.adds]))


def after_step(
    step: GroundOperator,
    before: SensedState,
    after: SensedState,
    others: Iterable[GroundOperator] = (),
    *,
    waived: frozenset[Literal] = frozenset(),
) -> Deviation:
    """What a step should have done and did not, and what else has changed.

    Args:
        step: The step that ended, with the effects that last.
        before: The state when it was dispatched.
        after: The state now.
        others: Steps that ran meanwhile: what they do, or undo, explains changes too.
        waived: Effects that a step which ran meanwhile has rightly undone.
    """
    others = tuple(others)
    said = {literal: after.says(literal) for literal in effects_of(step) if literal not in waived}
    explained = {effect.atom for each in (step, *others) for effect in effects_of(each)}
    seen = before.unknown | after.unknown | explained
    extra = [Literal(atom) for atom in after.held - before.held - seen]
    extra += [Literal(atom, False) for atom in before.held - after.held - seen]
    return Deviation(
        missing=tuple(sorted(literal for literal, value in said.items() if value is False)),
        extra=tuple(sorted(extra)),
        unobserved=tuple(sorted(literal for literal, value in said.items() if value is None)),
    )


def rest_of_plan(
    steps: Sequence[GroundOperator], goal: frozenset[Literal], sensed: SensedState
) -> tuple[Literal, ...]:
    """What the rest of a plan lacks when it starts from the state that is sensed.

    Args:
        steps: Those that have not begun, in the plan's order, with the conditions that can be demanded.
        goal: What shall hold after them.
        sensed: The state now. What cannot be seen is given the benefit of the doubt: it is asked again.

    Returns:
        The first conditions that fail, sorted; those of the goal if every step can be taken; none if all is
        well.
    """
    state = sensed.held

    def false(literals: Iterable[Literal], touched: set[Atom]) -> tuple[Literal, ...]:
        return tuple(
            each for each in unmet(literals, state) if each.atom in touched or each.atom not in sensed.unknown
        )

    touched: set[Atom] = set()
    for step in steps:
        lacking = false(step.preconditions, touched)
        if lacking:
            return lacking
        state = step.apply(state)
        touched |= step.adds | step.deletes
    return false(goal, touched)


def confirmed(first: Deviation, second: Deviation) -> Deviation:
    """What two looks agree on; what only one of them shows was never there, or has passed."""

    def both(name: str) -> tuple[Literal, ...]:
        return tuple(sorted(set(getattr(first, name)) & set(getattr(second, name))))

    return Deviation(
        unmet=both("unmet"),
        missing=both("missing"),
        extra=both("extra"),
        unobserved=both("unobserved"),
        broken=both("broken"),
    )


def in_words(deviation: Deviation, words: Mapping[str, str] | None = None) -> str:
    """One sentence about a deviation."""
    titles = words or {
        "unmet": "needed and not so",
        "missing": "expected and not so",
        "unobserved": "not observed",
        "broken": "lacking for the rest of the plan",
        "extra": "changed unexpectedly",
    }
    parts = [
        f"{title}: {', '.join(map(str, getattr(deviation, name)))}"
        for name, title in titles.items()
        if getattr(deviation, name)
    ]
    return "; ".join(parts) or "as expected"
