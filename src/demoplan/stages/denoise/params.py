"""What can be chosen about learning from noisy traces."""

from dataclasses import dataclass

from demoplan.inference import BeliefParams


@dataclass(frozen=True, kw_only=True)
class DenoiseParams(BeliefParams):
    """Priors and limits; none of them says how noisy the traces are, which is estimated."""

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
    chain_evidence_max: float = 3.0
    """Natural logarithm of the odds that courses of atoms may add to what was seen right before and after."""
    is_minimal: bool = True
    """Leave out conditions that others imply in everything seen."""
    n_implied_min: int = 10
    """Cases needed before one condition is taken to imply another."""
    implied_exceptions_max: float = 0.02
    """Share of the cases that may contradict it, as misreadings do."""
    forbidden_prior: float = 5.0
    """Natural logarithm of the odds against a negative condition beforehand: most that is avoided is avoided
    by habit, so that chance and habit together have to be far away."""
    n_forbidden_min: int = 15
    """Fewer occasions than these forbid nothing, whatever the odds: ten of one kind may all be one habit."""
    forbidden_prior_if_undone: float = 2.0
    """The same odds for what some action does nothing but undo: nobody acts to no end, so something asks that
    it be false, a goal or a condition; one of the few literals of that predicate may well be it."""
    n_forbidden_if_undone_min: int = 5
    """The same number of occasions for what some action does nothing but undo."""
    n_snapshots: int = 6
    """States per trace in which implications are looked for, evenly spaced."""
    max_snapshots: int = 600
    """States in all in which implications are looked for."""
