"""What can be chosen about learning from noisy traces."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DenoiseParams:
    """Priors and limits; none of them says how noisy the traces are, which is estimated.

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
    max_span_states: int = 512
    """Longer traces are cut into spans of this many states, each on its own: bounds time and memory."""
    max_instances: int = 1_500
    """Spans are taken in order, as long as one of their actions has fewer instances than this."""
    required_min: float = 0.5
    """Probability from which a condition is stated."""
    required_if_deleted_min: float = 0.2
    """The same for what the action deletes: stated in vain it costs no plan, left out it breaks some."""
    effect_despite: float = 0.05
    """An action without any likely added literal is given its likeliest, if that is at least this likely:
    nobody acts to no end."""
    is_minimal: bool = True
    """Leave out conditions that others imply in everything seen."""
    n_implied_min: int = 10
    """Cases needed before one condition is taken to imply another."""
    implied_exceptions_max: float = 0.02
    """Share of the cases that may contradict it, as misreadings do."""
    forbidden_evidence: float = 12.0
    """Natural logarithm of the odds at which a negative condition is stated: demonstrators have habits, so
    chance alone has to be far away."""
    n_snapshots: int = 6
    """States per trace in which implications are looked for, evenly spaced."""
    max_snapshots: int = 600
    """States in all in which implications are looked for."""
