"""What to do about a discrepancy: look again, name its class, and go on, plan again, or end honestly."""

from collections.abc import Callable

from demoplan.engines.mujoco.session import MotionReport
from demoplan.language.atoms import Atom
from demoplan.language.domains import Domain
from demoplan.pipeline.execution.executing.cases import case_of
from demoplan.pipeline.execution.executing.counts import Counts
from demoplan.pipeline.execution.executing.course import Course, Running
from demoplan.pipeline.execution.executing.endings import Replanned, RunEnded
from demoplan.pipeline.execution.executing.experience import Experience
from demoplan.pipeline.execution.executing.hands import Hands
from demoplan.pipeline.execution.executing.params import ExecuteParams
from demoplan.pipeline.execution.executing.rows import StepRows, end_of
from demoplan.pipeline.execution.replanning import amended, lifted_text
from demoplan.pipeline.execution.senses import Senses
from demoplan.stages.diagnose import Diagnosis, diagnose
from demoplan.stages.monitor import Deviation, before_step, confirmed, effects_of


class Discrepancies:
    """All discrepancies of a run, and what was learned from them."""

    def __init__(
        self,
        domain: Domain,
        senses: Senses,
        hands: Hands,
        noted: StepRows,
        counts: Counts,
        params: ExecuteParams,
        *,
        has_happened: Callable[[], bool],
    ) -> None:
        """None has been found yet.

        Args:
            domain: What is planned with.
            senses: Where to look.
            hands: For letting time pass.
            noted: Where each is written down.
            counts: Where each is counted.
            params: Choices.
            has_happened: Whether the run's fault, if it has one, has happened: for scoring, what is named
                before is not kept.
        """
        self.domain = domain
        """What to plan with: corrected where an operator has proved wrong."""
        self.gone: frozenset[str] = frozenset()
        """Objects that are no longer there."""
        self.diagnosed: str | None = None
        """The class first named after the fault had happened."""
        self._senses, self._hands, self._noted, self._counts = senses, hands, noted, counts
        self._params, self._has_happened = params, has_happened
        self._experience = Experience()

    def name(self, failure: str) -> None:
        """Keep the class that was first named once the fault, if there is one, had happened."""
        if self.diagnosed is None and self._has_happened():
            self.diagnosed = failure

    def came_about(self, course: Course, running: Running) -> None:
        """A step did what it should."""
        operator, lasting = running.bound.operator, course.lasting[running.index]
        self._experience.came_about(operator.name, lifted_text(effects_of(lasting), operator, lasting))

    def handle(
        self, deviation: Deviation, running: Running | None, report: MotionReport | None, course: Course
    ) -> None:
        """Look again, name its class, and act: go on if it has passed, else give the plan up.

        Args:
            deviation: What should be so and is not.
            running: The step that it came with; None if it is the goal that is not so after all steps.
            report: How the step's motion went.
            course: The plan under way.

        Raises:
            Replanned: If a new plan is called for.
            RunEnded: If it has come about too often.
        """
        asked_ns = self._senses.session.time_ns
        is_told = report is not None and report.state in {"failed", "blocked"}
        passed_s = None
        if self._params.monitor == "full" and not is_told:
            deviation, passed_s = self._looked_again(deviation, running, course)
        found = self._diagnosis(deviation, running, report, passed_s, course)
        self.name(found.failure)
        row = self._noted.beside(self._counts.plan_index, course.n_steps) if running is None else running.row
        if running is None:
            row |= {"start_ns": asked_ns, "end_ns": self._senses.session.time_ns}
            row["missing"] = [str(each) for each in deviation.literals]
        row |= {"failure": found.failure, "cause": found.cause}
        if passed_s is not None:
            self._counts.n_passed += 1
            if running is None:
                row["state"] = "succeeded"
            return
        row["state"] = end_of(row)
        self._counts.n_discrepancies += 1
        truth = self._senses.truth()
        if not is_told and all(truth.says(literal) for literal in deviation.literals):
            self._counts.n_false_alarms += 1
        self._give_up_plan(deviation, running, report, found, course)

    def _give_up_plan(
        self,
        deviation: Deviation,
        running: Running | None,
        report: MotionReport | None,
        found: Diagnosis,
        course: Course,
    ) -> None:
        """Learn what there is to learn, and ask for another plan."""
        n_equal = self._n_equal(deviation, running, report, found, course)
        is_doubtful = n_equal >= self._params.failures_before_amending
        if found.failure == "operator_model" and running is not None and is_doubtful:
            step = course.graph.steps[running.index]
            self.domain = amended(self.domain, step, deviation.missing, deviation.extra) or self.domain
        self.gone |= self._gone_objects()
        if running is not None and report is not None and self._is_to_let_go(running, report):
            raise Replanned(let_go=running.bound.hand)
        # What is in the way may go away: each time it is given longer.
        raise Replanned(pause_s=self._params.patience_s * n_equal if found.failure == "motion" else 0.0)

    def _looked_again(
        self, deviation: Deviation, running: Running | None, course: Course
    ) -> tuple[Deviation, float | None]:
        """The deviation as it is after a while, or after how long it was gone [s]."""
        session = self._senses.session
        asked_ns = session.time_ns
        end_ns = asked_ns + round(self._params.confirm_s * 1e9)
        while session.time_ns < end_ns:
            self._hands.advance(0.25)
            again = self._again(deviation, running, course)
            if not confirmed(deviation, again).is_alarming:
                return deviation, (session.time_ns - asked_ns) / 1e9
            deviation = again
        return deviation, None

    def _again(self, deviation: Deviation, running: Running | None, course: Course) -> Deviation:
        """The same question, asked of the state now."""
        sensed = self._senses.look()
        if running is None:
            return Deviation(broken=course.lacking_at_end(sensed))
        if deviation.unmet or running.row["state"] == "not_executed":
            return before_step(course.lasting[running.index], sensed)
        return course.deviation(running, sensed, self._noted.of_plan(self._counts.plan_index))

    def _diagnosis(
        self,
        deviation: Deviation,
        running: Running | None,
        report: MotionReport | None,
        passed_s: float | None,
        course: Course,
    ) -> Diagnosis:
        case = case_of(
            deviation,
            running,
            report,
            passed_s,
            course=course,
            senses=self._senses,
            experience=self._experience,
            gone=self.gone,
            params=self._params,
        )
        return diagnose(case, self._params.diagnosing)

    def _n_equal(
        self,
        deviation: Deviation,
        running: Running | None,
        report: MotionReport | None,
        found: Diagnosis,
        course: Course,
    ) -> int:
        """How often there has been such a failure in this run; too often ends it."""
        operator = None if running is None else running.bound.operator
        step = None if running is None else course.graph.steps[running.index]
        texts = lifted_text(deviation.literals, operator, step)
        name = "the goal" if operator is None else operator.name
        n_equal = self._experience.failed(name, found.failure, texts)
        if running is not None and report is not None and report.state == "succeeded":
            self._experience.failed_though_moved(name, texts)
        if n_equal >= self._params.max_equal_failures:
            raise RunEnded("gave_up", f"{name} failed {n_equal} times in the same way: {found.cause}")
        return n_equal

    def _is_to_let_go(self, running: Running, report: MotionReport) -> bool:
        """Whether hand and perception disagree about what is held: opening brings both to the same answer."""
        if report.problem in {"still_holding", "not_holding"}:
            return True
        in_hand = Atom(self._params.holding, (running.bound.hand, running.bound.motion.object or ""))
        is_lost = in_hand in running.before.held and in_hand not in self._senses.look().held
        return is_lost and report.state != "succeeded"

    def _gone_objects(self) -> frozenset[str]:
        session, gone_s = self._senses.session, self._params.diagnosing.gone_s
        seen = self._senses.frames(max(-1, session.time_ns - round(gone_s * 1e9)))
        present = set(seen.filter(seen["position_xyz_m"].is_not_null())["entity"])
        return frozenset(self._senses.objects) - present
