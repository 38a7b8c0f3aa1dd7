"""All that is known about a discrepancy, gathered for its diagnosis."""

from demoplan.engines.mujoco.session import MotionReport
from demoplan.language.atoms import Atom
from demoplan.pipeline.execution.executing.course import Course, Running
from demoplan.pipeline.execution.executing.experience import Experience
from demoplan.pipeline.execution.executing.params import ExecuteParams
from demoplan.pipeline.execution.replanning import lifted_text
from demoplan.pipeline.execution.senses import TABLE, Senses
from demoplan.stages.diagnose import Case
from demoplan.stages.monitor import Deviation

_LOOK_BACK_NS = 2_000_000_000
"""At least so much of the past is looked at, however short the step was."""
_BEFORE_STEP_NS = 300_000_000
"""How things stood before a step shows in this long before its dispatch."""


def case_of(
    deviation: Deviation,
    running: Running | None,
    report: MotionReport | None,
    passed_s: float | None,
    *,
    course: Course,
    senses: Senses,
    experience: Experience,
    gone: frozenset[str],
    params: ExecuteParams,
) -> Case:
    """What a diagnosis gets to know.

    Args:
        deviation: What should be so and is not.
        running: The step that it came with, if any.
        report: How the step's motion went.
        passed_s: The deviation was gone after this long.
        course: The plan under way.
        senses: Where to look.
        experience: Of the run so far.
        gone: Objects that are known to be gone.
        params: The words.
    """
    now_ns = senses.session.time_ns
    start_ns = now_ns if running is None else running.start_ns
    sensed = senses.look()
    bound = None if running is None else running.bound
    operator = None if bound is None else bound.operator
    lasting = None if running is None else course.lasting[running.index]
    texts = lifted_text(deviation.literals, operator, lasting)
    return Case(
        literals=deviation.literals,
        passed_after_s=passed_s,
        held=course.lasting_state(sensed).held,
        unknown=sensed.unknown,
        frames=senses.frames(max(-1, min(start_ns, now_ns - _LOOK_BACK_NS) - _BEFORE_STEP_NS)),
        hands=senses.session.hands,
        fixed=frozenset({TABLE}),
        objects=tuple(name for name in senses.objects if name not in gone),
        hand=None if bound is None else bound.hand,
        activity=None if operator is None else operator.activity,
        thing=None if bound is None else bound.motion.object,
        support=None if bound is None else bound.motion.support,
        was_held=running is not None
        and bound is not None
        and Atom(params.holding, (bound.hand, bound.motion.object or "")) in running.before.held,
        motion_state=None if report is None else report.state,
        motion_problem=None if report is None else report.problem,
        motion_reason=None if report is None else report.reason,
        tracking_error_m=0.0 if report is None else report.tracking_error_m,
        n_collisions=0 if report is None else report.n_collisions,
        n_alike_before=0 if operator is None else experience.n_alike(operator.name, texts),
        n_good_before=0 if operator is None else experience.n_good(operator.name, texts),
        since_ns=start_ns,
    )
