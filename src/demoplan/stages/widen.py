"""A domain to a ladder of domains: the operators shown most often first, then more and more of them.

A combined domain holds rare operators, and what is rare is often noise. So planning tries the frequent ones
alone, and widens when there is no plan.

Source: M. Diehl, K. Ramirez-Amaro, "Optimizing robot planning domains to reduce search time for long-horizon
planning", 2021, for the idea.
"""

from dataclasses import dataclass, replace

from demoplan.language.domains import Domain, Problem


@dataclass(frozen=True, kw_only=True)
class WidenParams:
    """What can be chosen about the ladder."""

    max_rungs: int = 8
    """At most this many domains; where counts take more values, several values come in at once."""


def widen(domain: Domain, params: WidenParams = WidenParams()) -> tuple[Domain, ...]:
    """Domains with more and more of the operators; the last one has all.

    Args:
        domain: All operators, with the counts of transitions behind them.
        params: Size of the ladder.

    Returns:
        Domains of the same name, types and predicates. Each holds every operator whose count reaches a
        threshold, and more operators than the one before it. Operators of equal count come in together, so
        their names do not matter. A domain without operators gives itself alone.
    """
    counts = sorted({operator.count for operator in domain.operators}, reverse=True)
    n_rungs = min(max(1, params.max_rungs), len(counts))
    # Rung r of k takes the first ceil((r + 1) m / k) of the m values, so that the last takes all.
    thresholds = [counts[-(-(rung + 1) * len(counts) // n_rungs) - 1] for rung in range(n_rungs)]
    ladder = tuple(
        replace(domain, operators=tuple(each for each in domain.operators if each.count >= threshold))
        for threshold in thresholds
    )
    return ladder or (domain,)


def is_worth_trying(domain: Domain, problem: Problem) -> bool:
    """Whether a plan is not ruled out at a glance: each goal literal holds, or is like some effect.

    It looks at predicates only: True promises nothing, False spares the planner's start.
    """
    effects = {
        (effect.atom.predicate, effect.is_positive)
        for operator in domain.operators
        for effect in operator.effects
    }
    return all(
        (literal.atom in problem.initial) == literal.is_positive
        or (literal.atom.predicate, literal.is_positive) in effects
        for literal in problem.goal
    )
