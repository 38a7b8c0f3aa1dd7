"""What can be chosen about executing plans."""

from dataclasses import dataclass, field

from demoplan.engines.fast_downward import SolveParams
from demoplan.engines.mujoco.skills import SkillTable, read_skills
from demoplan.language.momentary import Momentary
from demoplan.pipeline.execution.senses import SenseParams
from demoplan.stages.diagnose import DiagnoseParams


@dataclass(frozen=True, kw_only=True)
class ExecuteParams:
    """What can be chosen about executing plans."""

    monitor: str = "full"
    """``full``: conditions before, effects after, and the rest of the plan; ``preconditions``: only the
    first, as ROSPlan does; ``none``: open loop."""
    skills: SkillTable = field(default_factory=read_skills)
    """Activity → skill, and who plays which part in it."""
    holding: str = "inHand"
    """Predicate (hand, object): the hand holds the object."""
    resting: str = "onTop"
    """Predicate (object, support)."""
    momentary: Momentary = Momentary()
    """Predicates that describe a motion in progress: they are planned with, and not demanded of the world."""
    ends_with: tuple[str, ...] = ("handOpen",)
    """Predicates that shall hold of every hand in the end, beside the goal."""
    sensing: SenseParams = SenseParams()
    diagnosing: DiagnoseParams = DiagnoseParams()
    solving: SolveParams = SolveParams()
    poll_s: float = 0.05
    """How often motions are asked how they go [s]."""
    lag_s: float = 0.5
    """Effects may come about so long after a motion has ended [s]."""
    confirm_s: float = 1.0
    """A discrepancy is looked at again after this long before anything is done about it [s]."""
    patience_s: float = 2.0
    """After a motion that failed, so long is waited before the next plan; longer each time [s]."""
    step_timeout_s: float = 30.0
    run_timeout_s: float = 600.0
    """Simulated time that a run may take [s]."""
    max_plans: int = 8
    """Budget: the first plan, and replans."""
    max_equal_failures: int = 3
    """So many failures of the same operator, class and literals end the run."""
    failures_before_amending: int = 2
    """So many failures put down to the operator's model correct it for the rest of the run."""
