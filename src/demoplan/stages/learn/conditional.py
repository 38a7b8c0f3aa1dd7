"""Effects that depend on something: one activity, two operators, and the condition that tells them apart.

Putting a wet cube down stains what it is put on; a dry one does not. Over both, the stain looks like chance.
An effect that comes and goes is therefore held against every property of the things involved: where one of
them decides it, the operator is parted in two by that condition, which is a conditional effect (``when``)
compiled away, so that every planner and every monitor understands it.

What is about the hand is left alone: it changes at the ends of activities, which are never exact, and so
coincides with much.

Source: for compiling conditional effects away, B. Nebel, "On the compilability and expressive power of
propositional planning formalisms", JAIR 12, 2000, doi:10.1613/jair.735; for the test, see ``splitting``.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import lgamma, log

from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.learn.bind import HAND
from demoplan.stages.learn.lift import AFTER, BEFORE, LiftedAtom, Pattern
from demoplan.stages.learn.merge import Draft, Relevance, universe

MIN_LOG_BAYES_FACTOR = log(100.0)
"""Decisive evidence, by the usual scale, after the number of conditions tried is paid for."""
MIN_CASES = 3
"""The effect must have come, and have stayed away, at least this often."""
MIN_SHARE = 0.8
"""With the condition, the effect comes at least this often; without it, it stays away as often; or the other
way round."""


def part_by_conditions(
    draft: Draft,
    patterns: Sequence[Pattern],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    relevance: Relevance,
) -> list[Draft]:
    """The draft, or the two that the clearest condition parts it into; literals are to be weighed anew."""
    atoms = [atom for atom in universe(draft.types, types, predicates) if HAND not in atom.variables]
    members = [patterns[position] for position in draft.patterns]
    best: tuple[float, LiftedAtom, LiftedAtom, str] | None = None
    for effect in atoms:
        if not relevance.is_effect(effect):
            continue
        for value in (True, False):
            open_ones = [
                each
                for each in members
                if _value(each, effect, BEFORE) is (not value) and _value(each, effect, AFTER) is not None
            ]
            n_made = sum(each.count for each in open_ones if _value(each, effect, AFTER) is value)
            n_all = sum(each.count for each in open_ones)
            if min(n_made, n_all - n_made) < MIN_CASES:
                continue
            for condition in atoms:
                if condition == effect:
                    continue
                found = _evidence(open_ones, effect, value, condition)
                if found is None:
                    continue
                gain, text = found[0] - log(len(atoms)), found[1]
                if gain >= MIN_LOG_BAYES_FACTOR and (best is None or (gain, condition) > best[:2]):
                    best = (gain, condition, effect, text)
    if best is None:
        return [draft]
    gain, condition, effect, text = best
    parts = []
    for value in (True, False):
        own = tuple(place for place in draft.patterns if _value(patterns[place], condition, BEFORE) is value)
        parts.append(
            replace(
                draft,
                patterns=own,
                count=sum(patterns[place].count for place in own),
                parted_by=(*draft.parted_by, (condition, value)),
                note=f"parted by {condition.predicate}: {effect.predicate} changes in {text}; "
                f"the odds for two operators are 10^{gain / log(10.0):.1f}",
            )
        )
    return parts


def _value(pattern: Pattern, atom: LiftedAtom, side: int) -> bool | None:
    return None if atom in pattern.unknown[side] else atom in pattern.true[side]


def _evidence(
    members: Sequence[Pattern], effect: LiftedAtom, value: bool, condition: LiftedAtom
) -> tuple[float, str] | None:
    """Log Bayes factor that the effect depends on the condition; None where it does not decide."""
    counts = {(held, made): 0 for held in (True, False) for made in (True, False)}
    for each in members:
        held = _value(each, condition, BEFORE)
        if held is not None:
            counts[held, _value(each, effect, AFTER) is value] += each.count
    totals = {held: counts[held, True] + counts[held, False] for held in (True, False)}
    if min(totals.values()) < MIN_CASES:
        return None
    with_it, without = (counts[held, True] / totals[held] for held in (True, False))
    if max(with_it, without) < MIN_SHARE or min(with_it, without) > 1 - MIN_SHARE:
        return None
    apart = sum(_log_coin(counts[held, True], counts[held, False]) for held in (True, False))
    together = _log_coin(counts[True, True] + counts[False, True], counts[True, False] + counts[False, False])
    text = (
        f"{counts[True, True]} of {totals[True]} where it holds, "
        f"{counts[False, True]} of {totals[False]} where it does not"
    )
    return apart - together, text


def _log_coin(heads: int, tails: int) -> float:
    return lgamma(heads + 0.5) + lgamma(tails + 0.5) - lgamma(heads + tails + 1.0) - 2 * lgamma(0.5)
