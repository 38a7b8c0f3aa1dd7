"""What can be chosen about learning."""

from dataclasses import dataclass, field

from demoplan.stages.learn.misreadings import MendParams


@dataclass(frozen=True, kw_only=True)
class LearnParams:
    """What can be chosen about learning."""

    holding: str = "inHand"
    """Predicate (hand, object) of what a hand holds; a hand holds one object at a time."""
    empty: str = "handOpen"
    """Predicate (hand) that is true only while the hand holds nothing: either this or ``holding``."""
    supports: tuple[str, ...] = ("onTop",)
    """Predicates (object, support) of what an object rests on: one thing, unless it is carried."""
    noise_mean: float = 0.05
    """Prior mean of the rate at which an observation is wrong: of an atom, or of an activity's name."""
    noise_weight: float = 20.0
    """How many observations the prior rate is worth. With the mean above: Beta(1, 19)."""
    slip: float = 0.02
    """Probability that a transition contradicts its operator although nothing was misread: it was misnamed,
    or its ends lie beside the changes that they stand for."""
    min_probability: float = 0.5
    """A literal is stated, and a variant believed, when its posterior probability is at least this."""
    max_demonstrations: int = 2
    """Demonstrations count for at most this many successes in ``beta``: whoever demonstrates shows what
    works, so that a hundred showings say little more than two about how often it would fail."""
    cost: str = "count"
    """What the planner's cost comes from: ``count`` (shown more often is cheaper) or ``beta`` (more
    reliable is cheaper)."""
    step_cost: int = 10
    """What every step costs, before rarity or unreliability is added."""
    cost_per_bit: float = 10.0
    """Added cost per bit by which an operator is rarer than the commonest, or per bit of −log2(beta)."""
    mend: MendParams = field(default_factory=MendParams)
    """How misreadings are found and put right."""
    splits_types: bool = False
    """Whether types are split where their objects behave unlike; otherwise it is only proposed."""
    rows_per_chunk: int = 100_000
    """Transitions lifted at once: bounds memory, and changes no result."""
