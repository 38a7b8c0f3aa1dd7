"""What a literal can be to its action, and how likely each is beforehand."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

KEEP, ADD, DELETE = 0, 1, 2
"""What an action does to an atom."""


@dataclass(frozen=True, kw_only=True)
class BeliefParams:
    """Priors and limits; none of them says how noisy the observations are, which is estimated.

    The seven ``weight_…`` are prior odds of what a literal over an action's parameters is to that action, not
    normalised. They are pulled towards what is found for the literal's predicate over all actions, so that a
    predicate which never changes is soon not believed to change by accident.
    """

    weight_required: float = 0.25
    """Precondition that stays."""
    weight_consumed: float = 0.10
    """Precondition that the action deletes."""
    weight_forbidden: float = 0.10
    """Always false before, and stays so."""
    weight_produced: float = 0.10
    """Always false before, and added."""
    weight_unrelated: float = 0.25
    """Neither condition nor effect."""
    weight_added: float = 0.05
    """Added, whether it held or not."""
    weight_deleted: float = 0.02
    """Deleted, whether it held or not."""
    n_prior_literals: float = 15.0
    """How many literals' worth of belief the weights have against what a predicate shows."""
    chances: tuple[float, ...] = (0.02, 0.25, 0.5, 0.75, 0.98)
    """How often a literal that is no condition may happen to hold before the action: values tried."""
    slip: float = 1e-4
    """Probability that one transition contradicts a rule of the action although nothing was misread."""
    flip_start: float = 0.08
    """Flip rate from which estimation starts."""
    flip_min: float = 1e-3
    """Least flip rate assumed: also clean traces may hold one misreading in a thousand."""
    flip_max: float = 0.45
    n_flip_prior: float = 100.0
    """Observations' worth of belief that a predicate flips as often as all predicates do."""
    damping: float = 0.5
    """Part of each message kept from the round before; keeps loops of messages from swinging."""
    n_rounds_max: int = 40
    tolerance: float = 2e-3
    """Rounds end when no belief moves by more than this."""


@dataclass(frozen=True, eq=False)
class Roles:
    """The roles, and the hypotheses that they consist of: those of one role differ in chance only."""

    condition: Ints
    """Per role: 1 true before, -1 false before, 0 neither."""
    effect: Ints
    """Per role: ``KEEP``, ``ADD`` or ``DELETE``."""
    weight: Floats
    """Per role, adding up to 1."""
    role: Ints
    """Per hypothesis, ascending."""
    chance: Floats
    """Per hypothesis: probability that the atom is true before."""
    log_share: Floats
    """Per hypothesis: logarithm of its part of the role's weight."""

    @classmethod
    def of(cls, params: BeliefParams) -> "Roles":
        """Roles under the parameters' weights."""
        chances = np.array(params.chances)
        flat = np.full(len(chances), 1 / len(chances))
        # What is added mostly was false before, what is deleted mostly true, or nobody would do it.
        rising = (1 - chances) ** 2 / ((1 - chances) ** 2).sum()
        falling = chances**2 / (chances**2).sum()
        certain, never = np.array([1 - params.slip]), np.array([params.slip])
        one = np.ones(1)
        rows = [
            (1, KEEP, params.weight_required, certain, one),
            (1, DELETE, params.weight_consumed, certain, one),
            (-1, KEEP, params.weight_forbidden, never, one),
            (-1, ADD, params.weight_produced, never, one),
            (0, KEEP, params.weight_unrelated, chances, flat),
            (0, ADD, params.weight_added, chances, rising),
            (0, DELETE, params.weight_deleted, chances, falling),
        ]
        weight = np.array([row[2] for row in rows])
        return cls(
            condition=np.array([row[0] for row in rows]),
            effect=np.array([row[1] for row in rows]),
            weight=weight / weight.sum(),
            role=np.repeat(np.arange(len(rows)), [len(row[3]) for row in rows]),
            chance=np.concatenate([row[3] for row in rows]),
            log_share=np.log(np.concatenate([row[4] for row in rows])),
        )
