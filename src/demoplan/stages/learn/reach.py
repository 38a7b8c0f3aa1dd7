"""Domains that stay plannable: conditions on a hand that nothing can bring about are dropped.

How a hand moves and what it is near are the classifier's own inputs. They chain the activities of one
demonstration, but a start that came late, or an Idle that was missed, leaves a condition that no operator can
restore, and then the second cube can never be taken. This looks at one hand with one object in the abstract:
from every state that can arise, each operator must be able to come about again.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

from demoplan.stages.learn.bind import HAND, OBJECT
from demoplan.stages.learn.lift import LiftedAtom
from demoplan.stages.learn.merge import Draft
from demoplan.stages.learn.params import LearnParams

State = frozenset[LiftedAtom]
_HARD = 100
MAX_FREE_ATOMS = 10
"""Beyond so many conditions on the hand alone, not all starts are tried, only the one with none of them."""


@dataclass(frozen=True)
class _Step:
    """An operator as far as one hand and one object go."""

    needs: State
    forbids: State
    adds: State
    deletes: State

    def distance(self, state: State, params: LearnParams) -> int:
        """How many conditions a state does not meet, those that may not be dropped counting as many."""
        missing = (self.needs - state) | (self.forbids & state)
        return sum(1 if _is_soft(atom, params) else _HARD for atom in missing)


def keep_plannable(drafts: Sequence[Draft], params: LearnParams) -> list[Draft]:
    """Drop the fewest, least certain conditions on hands so that every operator can come about again.

    Guards (an open hand, what it holds) are never dropped, nor is anything about the world.
    """
    result = list(drafts)
    blocked = _blocked(result, params)
    while any(blocked):
        best: tuple[tuple[object, ...], int, LiftedAtom] | None = None
        for position, draft in enumerate(result):
            for candidate in draft.preconditions:
                if draft.quarantine or not candidate.is_kept or not _is_soft(candidate.atom, params):
                    continue
                left = _blocked(_without(result, position, candidate.atom), params)
                if left < blocked:
                    key = (left, candidate.probability, position, candidate.atom)
                    if best is None or key < best[0]:
                        best = (key, position, candidate.atom)
        if best is None:
            break
        result = _without(result, best[1], best[2])
        blocked = _blocked(result, params)
    return result


def _is_soft(atom: LiftedAtom, params: LearnParams) -> bool:
    return HAND in atom.variables and atom.predicate not in (params.empty, params.holding)


def _without(drafts: Sequence[Draft], position: int, atom: LiftedAtom) -> list[Draft]:
    draft = drafts[position]
    conditions = tuple(
        replace(each, is_kept=False, note="nothing could bring it about again, and plans would end here")
        if each.atom == atom
        else each
        for each in draft.preconditions
    )
    return [*drafts[:position], replace(draft, preconditions=conditions), *drafts[position + 1 :]]


def _project(draft: Draft) -> _Step:
    def about(literals: Iterable[tuple[LiftedAtom, bool]], is_positive: bool) -> State:
        return frozenset(
            atom
            for atom, sign in literals
            if sign == is_positive and HAND in atom.variables and set(atom.variables) <= {HAND, OBJECT}
        )

    conditions, effects = draft.kept("precondition"), draft.kept("effect")
    return _Step(
        about(conditions, True), about(conditions, False), about(effects, True), about(effects, False)
    )


def _blocked(drafts: Sequence[Draft], params: LearnParams) -> tuple[int, int]:
    """How far operators are from coming about, over all starts; and how many some arising state shuts out.

    How far is the least number of conditions that keep an operator from a state that can be reached from
    a start; one that may not be dropped counts as many. It comes first: a condition that is dropped may open
    states which are ends until the next is.
    """
    steps = [_project(draft) for draft in drafts if not draft.quarantine]
    mentioned = frozenset(chain.from_iterable((*s.needs, *s.forbids, *s.adds, *s.deletes) for s in steps))
    empty, hold = LiftedAtom(params.empty, (HAND,)), LiftedAtom(params.holding, (HAND, OBJECT))
    free = sorted(atom for atom in mentioned if atom.variables == (HAND,) and atom != empty)
    subsets: Iterable[tuple[LiftedAtom, ...]] = [()]
    if len(free) <= MAX_FREE_ATOMS:
        subsets = chain.from_iterable(combinations(free, size) for size in range(len(free) + 1))
    starts = {frozenset((empty, *subset)) for subset in subsets}
    follow: dict[State, dict[int, State]] = {}
    pending = sorted(starts, key=sorted)
    while pending:
        state = pending.pop()
        if state in follow:
            continue
        following = {
            number: (state - step.deletes) | step.adds
            for number, step in enumerate(steps)
            if step.needs <= state and not step.forbids & state
        }
        if hold not in state:
            # The hand may turn to another object, to which it has no relation yet.
            following[-1] = frozenset(atom for atom in state if atom.variables == (HAND,))
        follow[state] = following
        pending += following.values()
    possible = {
        state: frozenset(number for number in following if number >= 0) for state, following in follow.items()
    }
    is_growing = True
    while is_growing:
        is_growing = False
        for state, following in follow.items():
            more = possible[state].union(*(possible[after] for after in following.values()))
            if more != possible[state]:
                possible[state], is_growing = more, True
    far = 0
    for start in starts:
        reached = _closure(start, follow)
        far += sum(min(step.distance(state, params) for state in reached) for step in steps)
    shut = sum(any(number not in reached for reached in possible.values()) for number in range(len(steps)))
    return far, shut


def _closure(start: State, follow: Mapping[State, Mapping[int, State]]) -> set[State]:
    reached, pending = {start}, [start]
    while pending:
        for after in follow[pending.pop()].values():
            if after not in reached:
                reached.add(after)
                pending.append(after)
    return reached
