"""Who decides: dispatches what is ready on free hands, watches, and acts on what differs."""

from collections import Counter
from collections.abc import Callable

from demoplan.engines.mujoco.session import MotionReport, Session
from demoplan.errors import UnknownNameError
from demoplan.language.domains import Domain, Plan
from demoplan.language.goals import parse_goal
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.faults import AnyFault
from demoplan.pipeline.execution.executing.counts import Counts
from demoplan.pipeline.execution.executing.course import Bound, Course, Running
from demoplan.pipeline.execution.executing.discrepancies import Discrepancies
from demoplan.pipeline.execution.executing.endings import Ended, Replanned, RunEnded
from demoplan.pipeline.execution.executing.hands import Hands
from demoplan.pipeline.execution.executing.params import ExecuteParams
from demoplan.pipeline.execution.executing.recovering import Recovery
from demoplan.pipeline.execution.executing.rows import Row, StepRows, end_of
from demoplan.pipeline.execution.faults import changed_domain
from demoplan.pipeline.execution.injecting import Injector
from demoplan.pipeline.execution.replanning import emptied_hands, plan_from
from demoplan.pipeline.execution.senses import Senses
from demoplan.stages.monitor import (
    Deviation,
    SensedState,
    before_step,
    effects_of,
    is_done_already,
)


class Executor:
    """One run, from a goal to its end. Everything random comes from the session and the seed."""

    def __init__(
        self,
        domain: Domain,
        goal: str,
        session: Session,
        vocabulary: Vocabulary,
        *,
        run_id: str,
        seed: int,
        fault: AnyFault | None,
        params: ExecuteParams,
    ) -> None:
        """Check that the goal, the fault and the skills fit; nothing moves yet."""
        self.session, self.params = session, params
        self.senses = Senses(session, vocabulary, params.sensing)
        self.goal = parse_goal(goal, domain.predicates, self.senses.type_of, domain.types)
        self.full_goal = emptied_hands(self.goal, session.hands, params.ends_with, domain)
        for operator in domain.operators:
            if operator.activity not in params.skills.activities:
                raise UnknownNameError(
                    "skill for activity",
                    operator.activity,
                    params.skills.activities,
                    f"skills table {params.skills.name!r}",
                )
        self.injector = injector = Injector(fault, session, self.senses, seed)
        self.hands = Hands(session, self.injector, params)
        self.noted = StepRows(run_id)
        self.recovery = Recovery(self.hands, self.senses, params)
        self.counts = Counts()
        self.discrepancies = Discrepancies(
            changed_domain(domain, fault),
            self.senses,
            self.hands,
            self.noted,
            self.counts,
            params,
            # Of the injector alone: nothing of a run may hold the run, or its session lives on after it.
            has_happened=lambda: fault is None or injector.is_done,
        )
        self._n_started: Counter[str] = Counter()
        self._until: Callable[[], bool] = lambda: False
        self._course = self._course_of(domain, Plan())

    # --- the run -------------------------------------------------------------------------------------------

    def run(self, until: Callable[[], bool] = lambda: False) -> Ended:
        """Carry it out, to an end.

        Args:
            until: Asked all the time; once it is true, hands come to rest and the run is ``stopped``.
        """
        self._until = until
        self.session.advance(self.params.lag_s)
        try:
            while True:
                if not self._plan():
                    continue
                try:
                    self._dispatch_all()
                    return self._finish()
                except Replanned as replanned:
                    self.hands.stop(self._course)
                    self._close_rows()
                    self.hands.advance(max(replanned.pause_s, self.params.poll_s))
                    if replanned.let_go is not None:
                        self.recovery.open(replanned.let_go, self._row_beside())
        except RunEnded as end:
            self.hands.stop(self._course)
            self._close_rows()
            return end.ended

    def _plan(self) -> bool:
        """Plan from what is sensed now; False if something was done that calls for looking again."""
        if self.counts.n_plans >= self.params.max_plans:
            raise RunEnded("gave_up", f"the budget of {self.params.max_plans} plans is used up")
        sensed = self.senses.look()
        planned = plan_from(
            self.discrepancies.domain,
            self.full_goal,
            sensed,
            self.senses,
            self.params.momentary,
            self.params.solving,
            self.params.skills,
            is_first=self.counts.n_plans == 0,
            gone=self.discrepancies.gone,
        )
        self.counts.n_plans += 1
        plan, refusal = planned.plan, ""
        if planned.n_possible is not None and self.params.monitor == "full":
            # What the plan does before it asks for the impossible may show what is wrong with the operators.
            self.discrepancies.name("operator_model")
            if not planned.n_possible:
                raise RunEnded("no_plan", planned.reason)
            assert plan is not None
            plan, refusal = Plan(plan.steps[: planned.n_possible], plan.cost), planned.reason
        if plan is None:
            if planned.outcome == "no_plan" and self.free_a_hand(sensed):
                return False
            raise RunEnded(planned.outcome, planned.reason)
        self._course = self._course_of(planned.domain, plan, refusal)
        return True

    def free_a_hand(self, sensed: SensedState) -> bool:
        """Lay down what a hand holds, or open a closed one; whether that changed anything."""
        return self.recovery.free_a_hand(sensed, self._row_beside)

    def _course_of(self, domain: Domain, plan: Plan, refusal: str = "") -> Course:
        return Course(
            domain,
            plan,
            self.full_goal,
            hands=self.session.hands,
            type_of=self.senses.type_of,
            momentary=self.params.momentary,
            skills=self.params.skills,
            refusal=refusal,
        )

    def _dispatch_all(self) -> None:
        running = self._course.running
        while not self._course.is_over:
            self.hands.check_time()
            if self._until():
                raise RunEnded("stopped", "whoever started it has seen enough")
            for index in self._course.ready():
                bound = self._course.bound(index)
                if bound.hand not in running and bound.hand not in self.hands.retiring:
                    self._begin(index, bound)
            if not running and not self.hands.retiring:
                continue
            self.hands.advance(self.params.poll_s)
            self.hands.note_retired()
            for hand in sorted(running):
                report = self.session.report(hand)
                if report is not None and report.state == "running":
                    if not self.hands.is_late(running[hand].start_ns):
                        continue
                    self.session.cancel(hand)
                    running[hand].row["state"] = "timeout"
                self._end_step(running[hand], self.session.report(hand))

    def _finish(self) -> Ended:
        """All steps have ended: is the goal what is sensed?"""
        if self._course.refusal:
            raise RunEnded("no_plan", self._course.refusal)
        self.hands.await_retired()
        if self.params.monitor == "full":
            lacking = self._course.lacking_at_end(self.senses.look())
            if lacking:
                self.discrepancies.handle(Deviation(broken=lacking), None, None, self._course)
        return Ended("reached")

    # --- one step ------------------------------------------------------------------------------------------

    def _begin(self, index: int, bound: Bound) -> None:
        """Skip a step, find that it cannot begin, or start its motion."""
        lasting = self._course.lasting[index]
        row = self._row_of_step(index, bound)
        sensed = self.senses.look()
        if self.params.monitor != "none":
            # What only moves has no lasting effects: it is done if the hand is as it would leave it.
            asked = lasting if effects_of(lasting) else self._course.graph.steps[index]
            if is_done_already(asked, sensed):
                row |= {"state": "skipped", "end_ns": self.session.time_ns}
                self._course.ended.add(index)
                return
            deviation, sensed = self._before(index, sensed)
            if deviation.is_alarming:
                row["unmet"] = [str(each) for each in (*deviation.unmet, *deviation.unobserved)]
                running = Running(index, bound, sensed, self.session.time_ns, row)
                self.discrepancies.handle(deviation, running, None, self._course)
                sensed = self.senses.look()
        if before_step(lasting, self.senses.truth()).unmet:
            self.counts.n_unsound += 1
        row |= {"state": "executing", "start_ns": self.session.time_ns}
        self._n_started[bound.operator.activity] += 1
        number = self._n_started[bound.operator.activity]
        running = Running(index, bound, sensed, self.session.time_ns, row)
        self.injector.dispatched(bound.hand, bound.motion, number, lasting, self._course.objects)
        self.counts.n_steps += 1
        self._course.running[bound.hand] = running
        self.session.start(bound.hand, bound.motion)

    def _before(self, index: int, sensed: SensedState) -> tuple[Deviation, SensedState]:
        """What keeps a step from beginning, once what the step before did has had time to be seen."""
        deviation = before_step(self._course.lasting[index], sensed)
        end_ns = self.session.time_ns + round(self.params.lag_s * 1e9)
        while deviation.is_alarming and self.session.time_ns < end_ns:
            self.hands.advance(self.params.poll_s)
            sensed = self.senses.look()
            deviation = before_step(self._course.lasting[index], sensed)
        return deviation, sensed

    def _end_step(self, running: Running, report: MotionReport | None) -> None:
        """A motion has ended: has it done what it should have?"""
        row, lasting = running.row, self._course.lasting[running.index]
        row["end_ns"] = self.session.time_ns
        self.injector.ended(lasting, running.bound.operator.activity)
        is_well = report is not None and report.state == "succeeded"
        if report is not None:
            row |= {
                "tracking_error_m": report.tracking_error_m,
                "peak_force_n": report.peak_force_n,
                "n_collisions": report.n_collisions,
            }
        if self.params.monitor == "none":
            row["state"] = "succeeded" if is_well else end_of(row)
            row["cause"] = None if is_well or report is None else report.reason
        elif self.params.monitor == "preconditions":
            if not is_well:
                row["state"] = end_of(row)
                missing = Deviation(missing=effects_of(lasting))
                self.discrepancies.handle(missing, running, report, self._course)
            row["state"] = "succeeded"
        else:
            self._check_effects(running, report, is_well=is_well)
        del self._course.running[running.bound.hand]
        self._course.ended.add(running.index)
        self._retire(running.bound.hand)

    def _retire(self, hand: str) -> None:
        """A hand that is through goes out of the way: where it let go, others may have to go next."""
        is_begun_next = any(self._course.bound(index).hand == hand for index in self._course.ready())
        if is_begun_next or not self._course.is_through(hand):
            return
        if not self._course.hands_with_steps() - {hand}:
            return
        held = self.senses.look().held
        if any(each.predicate == self.params.holding and each.arguments[0] == hand for each in held):
            return
        row = self._row_beside()
        row |= {"operator": "retire", "arguments": [hand], "hand": hand, "activity": "Idle"}
        self.hands.retire(hand, row)

    def _check_effects(self, running: Running, report: MotionReport | None, *, is_well: bool) -> None:
        """Hold a step against what is sensed after it; more than the robot's own word, the world counts."""
        row, deviation = running.row, self._after(running)
        row["missing"] = [str(each) for each in (*deviation.missing, *deviation.unobserved)]
        row["extra"] = [str(each) for each in deviation.extra]
        if deviation.is_alarming:
            row["state"] = end_of(row)
            self.discrepancies.handle(deviation, running, report, self._course)
        elif not is_well:
            row["cause"] = None if report is None else report.reason
        row["state"] = "succeeded"
        self.discrepancies.came_about(self._course, running)

    def _after(self, running: Running) -> Deviation:
        """The deviation after a step, once its effects have had their time."""
        end_ns = self.session.time_ns + round(self.params.lag_s * 1e9)
        deviation = self._deviation(running)
        while deviation.is_alarming and self.session.time_ns < end_ns:
            self.hands.advance(self.params.poll_s)
            deviation = self._deviation(running)
        return deviation

    def _deviation(self, running: Running) -> Deviation:
        rows = self.noted.of_plan(self.counts.plan_index)
        return self._course.deviation(running, self.senses.look(), rows)

    # --- rows, and what is true ----------------------------------------------------------------------------

    def _row_beside(self) -> Row:
        return self.noted.beside(self.counts.plan_index, self._course.n_steps)

    def _row_of_step(self, index: int, bound: Bound) -> Row:
        step = self._course.graph.steps[index].step
        return self.noted.of_step(
            self.counts.plan_index,
            index,
            step.operator,
            step.arguments,
            hand=bound.hand,
            activity=bound.operator.activity,
        )

    def _close_rows(self) -> None:
        """Steps that were never begun are rows too; then the plan is put away."""
        begun = {row["step_index"] for row in self.noted.of_plan(self.counts.n_plans - 1)}
        for index in range(self._course.n_steps):
            if index not in begun and index not in self._course.ended:
                self._row_of_step(index, self._course.bound(index))
        self._course = self._course_of(self._course.domain, Plan())

    def is_goal_sensed(self) -> bool:
        """Whether the goal is what is sensed now."""
        sensed = self.senses.look()
        return all(sensed.says(literal) for literal in self.goal)

    def is_goal_reached(self) -> bool:
        """Whether the goal is physically so: by contact and rest where it is about resting, else as seen."""
        truth = self.senses.truth()
        return all(
            self.session.is_resting_on(*literal.atom.arguments) == literal.is_positive
            if literal.atom.predicate == self.params.resting
            else bool(truth.says(literal))
            for literal in self.goal
        )
