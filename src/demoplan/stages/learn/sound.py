"""Operators that no plan may misuse: distinct objects, one hold per hand, one support per object."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.learn.bind import FROM, HAND, OBJECT, TO
from demoplan.stages.learn.decide import Noise, is_mistake, is_required
from demoplan.stages.learn.lift import BEFORE, LiftedAtom, Pattern
from demoplan.stages.learn.merge import Candidate, Draft, universe
from demoplan.stages.learn.params import LearnParams


def keep_apart(
    draft: Draft,
    patterns: Sequence[Pattern],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams,
) -> Draft:
    """The draft with what it takes so that no two variables can stand for the same instance.

    Roles of a demonstration are different objects, but a planner may bind one instance to two variables and
    put a cube on itself. STRIPS has no inequality; a literal that was true of one variable and false of
    the other says as much, and was observed: the hand holds ``?object``, and does not hold ``?to``.
    """
    atoms = universe(draft.types, types, predicates)
    added: list[Candidate] = []
    for pair in combinations(draft.variables, 2):
        if not _may_coincide(draft, pair, types) or _is_apart(draft, added, pair):
            continue
        options = []
        for atom, is_positive in sorted(draft.kept("precondition")):
            for one, other in (pair, pair[::-1]):
                if not is_positive or one not in atom.variables or other in atom.variables:
                    continue
                swapped = LiftedAtom(atom.predicate, tuple(other if v == one else v for v in atom.variables))
                if swapped in atoms:
                    options.append(_negation(swapped, draft, patterns, params))
        possible = [each for each in options if each.n_support > each.n_against]
        if possible:
            added.append(
                min(
                    possible, key=lambda each: (HAND not in each.atom.variables, -each.probability, each.atom)
                )
            )
    if not added:
        return draft
    atoms_added = {each.atom for each in added}
    rest = tuple(each for each in draft.preconditions if each.atom not in atoms_added)
    return replace(draft, preconditions=tuple(sorted((*rest, *added), key=lambda each: each.atom)))


def _may_coincide(draft: Draft, pair: tuple[int, int], types: TypeHierarchy) -> bool:
    one, other = (draft.types[position] for position in pair)
    return (
        one is not None
        and other is not None
        and (types.is_subtype(one, other) or types.is_subtype(other, one))
    )


def _is_apart(draft: Draft, added: Sequence[Candidate], pair: tuple[int, int]) -> bool:
    stated = draft.kept("precondition") | {(each.atom, each.is_positive) for each in added}
    for atom, is_positive in stated:
        if is_positive and set(pair) <= set(atom.variables):
            return True  # Nothing touches, holds or stands on itself.
        for one, other in (pair, pair[::-1]):
            if one in atom.variables and other not in atom.variables:
                swapped = LiftedAtom(atom.predicate, tuple(other if v == one else v for v in atom.variables))
                if (swapped, not is_positive) in stated:
                    return True
    return False


def _negation(atom: LiftedAtom, draft: Draft, patterns: Sequence[Pattern], params: LearnParams) -> Candidate:
    members = [patterns[position] for position in draft.patterns]
    unseen = sum(each.count for each in members if atom in each.unknown[BEFORE])
    against = sum(
        each.count for each in members if atom in each.true[BEFORE] and atom not in each.unknown[BEFORE]
    )
    support = draft.count - against - unseen
    return Candidate(
        atom=atom,
        is_positive=False,
        n_support=support,
        n_against=against,
        probability=is_required(support, against, Noise(params.noise_mean, params.noise_weight)),
        is_kept=True,
        note="keeps two variables from being one object",
    )


def check_balance(draft: Draft, patterns: Sequence[Pattern], params: LearnParams) -> Draft:
    """The draft, repaired or quarantined where it would let a hand hold two, or an object rest on two.

    A hold may only come from an open hand, an open hand only from a released hold, a support only instead
    of another. Where an end of the episode cut off the other half, the half is not believed.
    """
    effects, conditions = draft.kept("effect"), draft.kept("precondition")
    empty, hold = LiftedAtom(params.empty, (HAND,)), LiftedAtom(params.holding, (HAND, OBJECT))
    if (hold, True) in effects and (empty, True) not in conditions and _is_observed(empty, draft, patterns):
        draft = _insist(draft, empty)
        if (empty, True) not in draft.kept("precondition"):
            return replace(draft, quarantine="takes hold without an open hand before it")
    if (hold, True) in effects and (empty, True) in conditions and (empty, False) not in effects:
        return replace(draft, quarantine="takes hold, and the hand would stay open to take hold again")
    for is_positive, note in (
        (True, "opens a hand without releasing what it may hold"),
        (False, "closes a hand about nothing"),
    ):
        if (empty, is_positive) in effects and (hold, not is_positive) not in effects:
            draft = replace(
                draft,
                effects=tuple(
                    replace(each, is_kept=False, note=note)
                    if (each.atom, each.is_positive) == (empty, is_positive)
                    else each
                    for each in draft.effects
                ),
            )
    gains = {a for a, sign in effects if sign and a.predicate in params.supports and a.variables[0] == OBJECT}
    losses = {
        a for a, sign in effects if not sign and a.predicate in params.supports and (a, True) in conditions
    }
    losses = {a for a in losses if a.variables[0] == OBJECT}
    if gains and draft.grip == "free":
        return replace(draft, quarantine="moves an object that the hand holds neither before nor after")
    if losses and not gains:
        return replace(draft, quarantine="leaves an object on nothing")
    if len(gains) > len(losses):
        return replace(draft, quarantine="adds a support without taking the former one away")
    return draft


def _is_observed(atom: LiftedAtom, draft: Draft, patterns: Sequence[Pattern]) -> bool:
    return any(atom not in patterns[position].unknown[BEFORE] for position in draft.patterns)


def _insist(draft: Draft, atom: LiftedAtom) -> Draft:
    """The draft with a precondition kept against its posterior, if it was seen more often than not."""
    return replace(
        draft,
        preconditions=tuple(
            replace(each, is_kept=True, note="kept against the count: without it a hand could hold two")
            if each.atom == atom and each.is_positive and each.n_support > each.n_against
            else each
            for each in draft.preconditions
        ),
    )


def prune(drafts: Sequence[Draft], params: LearnParams, misread_rate: float = 0.0) -> list[Draft]:
    """Quarantine drafts that are better explained as a mistake, or that say nothing others do not.

    What an operator changes of hold and support is its substance. A draft without substance beside one
    with substance (a Put that stops in mid-air and goes on) is a part of it. A rare draft whose substance
    other operators give too is a missed or misnamed segment: the activity's other rows, or the other rows of
    the same change, are so many that the few are within the rate of mistakes.
    """
    noise = Noise(params.noise_mean, params.noise_weight)
    result = [
        each
        if each.quarantine or each.kept("effect")
        else replace(each, quarantine="changes nothing relevant")
        for each in drafts
    ]
    # From the rarest on, so that what is left to explain the others is what is best supported.
    for position in sorted(range(len(result)), key=lambda place: (result[place].count, place)):
        draft = result[position]
        if draft.quarantine:
            continue
        others = [each for place, each in enumerate(result) if place != position and not each.quarantine]
        reason = _superfluous(draft, others, noise, params) or _invented(draft, drafts, misread_rate, params)
        if reason:
            result[position] = replace(draft, quarantine=reason)
    return result


def _invented(draft: Draft, drafts: Sequence[Draft], misread_rate: float, params: LearnParams) -> str | None:
    """Why a draft is likelier made of misreadings, where there are some, whatever it changes."""
    if misread_rate <= 0 or not _substance(draft):
        return None
    n_activity = sum(each.count for each in drafts if each.activity == draft.activity)
    if draft.count < n_activity:
        noise = Noise(misread_rate, params.noise_weight)
        if is_mistake(draft.count, n_activity, noise) >= params.min_probability:
            return f"so rare that misreadings explain it, of which there are {misread_rate:.0%}"
    return None


def _substance(draft: Draft) -> frozenset[tuple[object, ...]]:
    changes: set[tuple[object, ...]] = set()
    if draft.grip in ("grasps", "releases", "exchanges"):
        changes.add(("grip", draft.grip, draft.types[OBJECT]))
    if draft.types[FROM] is not None or draft.types[TO] is not None:
        changes.add(("support", draft.types[OBJECT], draft.types[FROM], draft.types[TO]))
    return frozenset(changes)


def _superfluous(draft: Draft, others: Sequence[Draft], noise: Noise, params: LearnParams) -> str | None:
    siblings = [each for each in others if each.activity == draft.activity]
    substance = _substance(draft)
    n_activity = draft.count + sum(each.count for each in siblings)
    if not substance:
        # In mid-carry a hollow step is a part of the carry however often it is; a free hand's may be its own.
        if any(
            _substance(each) and (each.count >= draft.count or draft.grip == "holds") for each in siblings
        ):
            return "changes neither hold nor support, as its activity does"
        for each in siblings:
            is_more = each.count > draft.count or (
                each.count == draft.count and len(each.variables) > len(draft.variables)
            )
            same = all(mine is None or mine == its for mine, its in zip(draft.types, each.types, strict=True))
            if is_more and same and draft.kept("effect") <= each.kept("effect"):
                return "says less than another operator of its activity"
        is_rare = any(each.count > draft.count for each in siblings)
        if is_rare and is_mistake(draft.count, n_activity, noise) >= params.min_probability:
            return "so rare beside its activity's others that it is likelier a mistake"
        return None
    for change in substance:
        if not any(change in _substance(each) and each.count > draft.count for each in others):
            return None
    totals = [n_activity] + [
        draft.count + sum(each.count for each in others if change in _substance(each)) for change in substance
    ]
    if max(is_mistake(draft.count, total, noise) for total in totals) >= params.min_probability:
        return "so rare beside others that change the same that it is likelier a missed or misnamed segment"
    return None
