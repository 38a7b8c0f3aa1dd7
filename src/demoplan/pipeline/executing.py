"""The executor: dispatches what is ready on free hands, watches, and decides what a discrepancy means."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from demoplan.engines.fast_downward import SolveParams
from demoplan.engines.mujoco.session import Motion, MotionReport, Session
from demoplan.engines.mujoco.skills import SkillTable, motion_of, read_skills
from demoplan.errors import UnknownNameError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.dispatch import DispatchGraph, dispatch_graph
from demoplan.language.domains import Domain, Operator, Plan
from demoplan.language.execution import GroundOperator
from demoplan.language.goals import parse_goal
from demoplan.language.momentary import Momentary
from demoplan.language.vocabulary import Vocabulary
from demoplan.pipeline.faults import AnyFault, changed_domain
from demoplan.pipeline.injecting import Injector
from demoplan.pipeline.replanning import amended, emptied_hands, lifted_text, plan_from
from demoplan.pipeline.senses import TABLE, SenseParams, Senses
from demoplan.stages.diagnose import Case, DiagnoseParams, Diagnosis, diagnose
from demoplan.stages.monitor import (
    Deviation,
    SensedState,
    after_step,
    before_step,
    confirmed,
    effects_of,
    is_done_already,
    rest_of_plan,
)


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


@dataclass(frozen=True)
class Ended:
    """How a run ended."""

    outcome: str
    reason: str = ""


class _Replan(Exception):  # noqa: N818
    """A discrepancy was acted upon: what is left of the plan is given up."""


class _End(Exception):  # noqa: N818
    """The run ends here."""

    def __init__(self, outcome: str, reason: str) -> None:
        super().__init__(reason)
        self.ended = Ended(outcome, reason)


@dataclass(frozen=True)
class Bound:
    """A step's operator, and which hand makes which motion to carry it out."""

    operator: Operator
    hand: str
    motion: Motion


@dataclass
class _Running:
    """A step that is being carried out."""

    index: int
    bound: Bound
    before: SensedState
    start_ns: int
    row: dict[str, object]


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
        self.session, self.params, self.run_id = session, params, run_id
        self.senses = Senses(session, vocabulary, params.sensing)
        self.domain = changed_domain(domain, fault)
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
        self.injector = Injector(fault, session, self.senses, seed)
        self._n_started: Counter[str] = Counter()
        self._n_good: Counter[tuple[str, str]] = Counter()
        self._n_bad: Counter[tuple[str, tuple[str, ...]]] = Counter()
        self._equal: Counter[tuple[str, str, tuple[str, ...]]] = Counter()
        self._gone: set[str] = set()
        self.rows: list[dict[str, object]] = []
        self.n_plans = self.n_steps = self.n_discrepancies = 0
        self.n_passed = self.n_false_alarms = self.n_unsound = 0
        self.diagnosed: str | None = None
        self._running: dict[str, _Running] = {}
        self._graph = DispatchGraph((), ())
        self._lasting: tuple[GroundOperator, ...] = ()
        self._planned_with = self.domain
        self._ended: set[int] = set()
        self._refusal = ""
        """Why the plan's remaining steps, which are left out, could not happen."""
        self._pause_s = 0.0
        self._let_go: str | None = None
        """A hand that believes to hold what perception sees elsewhere."""

    # --- the run -------------------------------------------------------------------------------------------

    def run(self) -> Ended:
        """Carry it out, to an end."""
        self.session.advance(self.params.lag_s)
        try:
            while True:
                if not self._plan():
                    continue
                try:
                    self._dispatch_all()
                    return self._finish()
                except _Replan:
                    self._stop_hands()
                    self._close_rows()
                    self._advance(max(self._pause_s, self.params.poll_s))
                    if self._let_go is not None:
                        self._recover(self._let_go, Motion(activity="Release", skill="release"))
                        self._let_go = None
        except _End as end:
            self._stop_hands()
            self._close_rows()
            return end.ended

    def _plan(self) -> bool:
        """Plan from what is sensed now; False if something was done that calls for looking again."""
        if self.n_plans >= self.params.max_plans:
            raise _End("gave_up", f"the budget of {self.params.max_plans} plans is used up")
        sensed = self.senses.look()
        planned = plan_from(
            self.domain,
            self.full_goal,
            sensed,
            self.senses,
            self.params.momentary,
            self.params.solving,
            self.params.skills,
            is_first=self.n_plans == 0,
            gone=frozenset(self._gone),
        )
        self.n_plans += 1
        plan, self._refusal = planned.plan, ""
        if planned.n_possible is not None and self.params.monitor == "full":
            # What the plan does before it asks for the impossible may show what is wrong with the operators.
            self._name("operator_model")
            if not planned.n_possible:
                raise _End("no_plan", planned.reason)
            assert plan is not None
            plan, self._refusal = Plan(plan.steps[: planned.n_possible], plan.cost), planned.reason
        if plan is None:
            if planned.outcome == "no_plan" and self._free_a_hand(sensed):
                return False
            raise _End(planned.outcome, planned.reason)
        self._planned_with = planned.domain
        self._graph = dispatch_graph(planned.domain, plan, self.session.hands)
        self._lasting = tuple(
            self.params.momentary.lasting_step(step, self.senses.type_of, planned.domain.types)
            for step in self._graph.steps
        )
        self._ended = set()
        return True

    def _dispatch_all(self) -> None:
        n_steps = len(self._graph.steps)
        while len(self._ended) < n_steps:
            self._check_time()
            started = {running.index for running in self._running.values()}
            for index in self._graph.ready(self._ended, started):
                bound = self._bound(index)
                if bound.hand not in self._running:
                    self._begin(index, bound)
            if not self._running:
                continue
            self._advance(self.params.poll_s)
            for hand in sorted(self._running):
                report = self.session.report(hand)
                if report is not None and report.state == "running":
                    late_s = (self.session.time_ns - self._running[hand].start_ns) / 1e9
                    if late_s < self.params.step_timeout_s:
                        continue
                    self.session.cancel(hand)
                    self._running[hand].row["state"] = "timeout"
                self._end_step(hand, self.session.report(hand))

    def _finish(self) -> Ended:
        """All steps have ended: is the goal what is sensed?"""
        if self._refusal:
            raise _End("no_plan", self._refusal)
        if self.params.monitor == "full":
            lacking = rest_of_plan((), self.full_goal, self.senses.look())
            if lacking:
                self._discrepancy(Deviation(broken=lacking), None, None)
        return Ended("reached")

    # --- one step ------------------------------------------------------------------------------------------

    def _bound(self, index: int) -> Bound:
        step = self._graph.steps[index].step
        operator = next(o for o in self._planned_with.operators if o.name == step.operator)
        hand, motion = motion_of(step, self._planned_with, self.params.skills)
        return Bound(operator, hand, motion)

    def _begin(self, index: int, bound: Bound) -> None:
        """Skip a step, find that it cannot begin, or start its motion."""
        step, lasting = self._graph.steps[index], self._lasting[index]
        row = self._row(index, bound)
        sensed = self.senses.look()
        if self.params.monitor != "none":
            # What only moves has no lasting effects: it is done if the hand is as it would leave it.
            asked = lasting if effects_of(lasting) else step
            if is_done_already(asked, sensed):
                row |= {"state": "skipped", "end_ns": self.session.time_ns}
                self._ended.add(index)
                return
            deviation = before_step(lasting, sensed)
            # What the step before has done may not have been seen yet: sensing lags.
            end_ns = self.session.time_ns + round(self.params.lag_s * 1e9)
            while deviation.is_alarming and self.session.time_ns < end_ns:
                self._advance(self.params.poll_s)
                sensed = self.senses.look()
                deviation = before_step(lasting, sensed)
            if deviation.is_alarming:
                row["unmet"] = [str(each) for each in (*deviation.unmet, *deviation.unobserved)]
                self._discrepancy(deviation, _Running(index, bound, sensed, self.session.time_ns, row), None)
                sensed = self.senses.look()
        truth = self.senses.truth()
        if before_step(lasting, truth).unmet:
            self.n_unsound += 1
        row |= {"state": "executing", "start_ns": self.session.time_ns}
        running = _Running(index, bound, sensed, self.session.time_ns, row)
        self._n_started[bound.operator.activity] += 1
        planned = frozenset(name for each in self._graph.steps for name in each.step.arguments)
        number = self._n_started[bound.operator.activity]
        self.injector.dispatched(bound.hand, bound.motion, number, lasting, planned)
        self.n_steps += 1
        self._running[bound.hand] = running
        self.session.start(bound.hand, bound.motion)

    def _end_step(self, hand: str, report: MotionReport | None) -> None:
        """A motion has ended: has it done what it should have?"""
        running = self._running[hand]
        row, lasting = running.row, self._lasting[running.index]
        row["end_ns"] = self.session.time_ns
        self.injector.ended(lasting)
        is_well = report is not None and report.state == "succeeded"
        if report is not None:
            row |= {
                "tracking_error_m": report.tracking_error_m,
                "peak_force_n": report.peak_force_n,
                "n_collisions": report.n_collisions,
            }
        if self.params.monitor == "none":
            row["state"] = "succeeded" if is_well else self._ending(row)
            row["cause"] = None if is_well or report is None else report.reason
        elif self.params.monitor == "preconditions":
            if not is_well:
                row["state"] = self._ending(row)
                self._discrepancy(Deviation(missing=effects_of(lasting)), running, report)
            row["state"] = "succeeded"
        else:
            deviation = self._after(running)
            row["missing"] = [str(each) for each in (*deviation.missing, *deviation.unobserved)]
            row["extra"] = [str(each) for each in deviation.extra]
            if deviation.is_alarming or not is_well:
                if not deviation.is_alarming:
                    # The robot says that it failed, and everything is as it should be: the world counts.
                    row["cause"] = None if report is None else report.reason
                else:
                    row["state"] = self._ending(row)
                    self._discrepancy(deviation, running, report)
            row["state"] = "succeeded"
            for literal in lifted_text(effects_of(lasting), running.bound.operator, lasting):
                self._n_good[running.bound.operator.name, literal] += 1
        del self._running[hand]
        self._ended.add(running.index)

    @staticmethod
    def _ending(row: Mapping[str, object]) -> str:
        return "timeout" if row["state"] == "timeout" else "failed"

    def _after(self, running: _Running) -> Deviation:
        """The deviation after a step, once its effects have had their time."""
        end_ns = self.session.time_ns + round(self.params.lag_s * 1e9)
        deviation = self._deviation(running)
        while deviation.is_alarming and self.session.time_ns < end_ns:
            self._advance(self.params.poll_s)
            deviation = self._deviation(running)
        return deviation

    def _deviation(self, running: _Running) -> Deviation:
        sensed = self.senses.look()
        others = [self._lasting[other.index] for other in self._running.values() if other is not running]
        # Steps that ended while this one ran may rightly have changed what it left.
        since = [
            self._lasting[int(str(row["step_index"]))]
            for row in self.rows
            if row["plan_index"] == self.n_plans - 1
            and row["end_ns"] is not None
            and int(str(row["end_ns"])) >= running.start_ns
            and row is not running.row
        ]
        undone = {literal.negated() for each in (*others, *since) for literal in effects_of(each)}
        lasting = self._lasting[running.index]
        found = after_step(
            lasting,
            self._lasting_state(running.before),
            self._lasting_state(sensed),
            (*others, *since),
            waived=frozenset(undone),
        )
        # A plan that was cut short was never to reach the goal.
        broken = () if self._refusal else self._rest(sensed, except_for=running.index)
        return replace(found, broken=broken)

    def _lasting_state(self, sensed: SensedState) -> SensedState:
        types = self._planned_with.types
        kept = self.params.momentary.lasting_state(sensed.held, self.senses.type_of, types)
        return replace(sensed, held=kept)

    def _rest(self, sensed: SensedState, *, except_for: int) -> tuple[Literal, ...]:
        """What the steps still to come lack; those that run now are taken to succeed."""
        running = {each.index for each in self._running.values()} - {except_for}
        coming = [
            replace(step, preconditions=frozenset()) if index in running else step
            for index, step in sorted(
                enumerate(self._lasting), key=lambda pair: (pair[0] not in running, pair[0])
            )
            if index not in self._ended and index != except_for
        ]
        return rest_of_plan(coming, self.full_goal, sensed)

    # --- discrepancies -------------------------------------------------------------------------------------

    def _discrepancy(
        self, deviation: Deviation, running: _Running | None, report: MotionReport | None
    ) -> None:
        """Look again, name its class, and act: go on if it has passed, else give the plan up.

        Raises:
            _Replan: If a new plan is called for.
            _End: If it has come about too often.
        """
        asked_ns = self.session.time_ns
        passed_s = None
        is_told = report is not None and report.state in {"failed", "blocked"}
        if self.params.monitor == "full" and not is_told:
            end_ns = asked_ns + round(self.params.confirm_s * 1e9)
            while self.session.time_ns < end_ns:
                self._advance(0.25)
                again = self._again(deviation, running)
                if not confirmed(deviation, again).is_alarming:
                    passed_s = (self.session.time_ns - asked_ns) / 1e9
                    break
                deviation = again
        found = self._diagnosis(deviation, running, report, passed_s)
        self._name(found.failure)
        row = running.row if running is not None else None
        if row is None:
            row = self._row(None, None)
            row |= {"start_ns": asked_ns, "end_ns": self.session.time_ns}
            row["missing"] = [str(each) for each in deviation.literals]
        row |= {"failure": found.failure, "cause": found.cause}
        if passed_s is not None:
            self.n_passed += 1
            if running is None:
                row["state"] = "succeeded"
            return
        row["state"] = "timeout" if row["state"] == "timeout" else "failed"
        self.n_discrepancies += 1
        truth = self.senses.truth()
        if not is_told and all(truth.says(literal) for literal in deviation.literals):
            self.n_false_alarms += 1
        operator = None if running is None else running.bound.operator
        step = None if running is None else self._graph.steps[running.index]
        texts = lifted_text(deviation.literals, operator, step)
        name = "the goal" if operator is None else operator.name
        self._equal[name, found.failure, texts] += 1
        if running is not None and report is not None and report.state == "succeeded":
            self._n_bad[name, texts] += 1
        n_equal = self._equal[name, found.failure, texts]
        if n_equal >= self.params.max_equal_failures:
            raise _End("gave_up", f"{name} failed {n_equal} times in the same way: {found.cause}")
        if (
            found.failure == "operator_model"
            and step is not None
            and n_equal >= self.params.failures_before_amending
        ):
            better = amended(self.domain, step, deviation.missing, deviation.extra)
            self.domain = better or self.domain
        self._gone |= self._gone_objects()
        # What is in the way may go away: each time it is given longer.
        self._pause_s = self.params.patience_s * n_equal if found.failure == "motion" else 0.0
        if running is not None and report is not None:
            bound = running.bound
            in_hand = Atom(self.params.holding, (bound.hand, bound.motion.object or ""))
            is_lost = in_hand in running.before.held and in_hand not in self.senses.look().held
            if report.problem == "still_holding" or (is_lost and report.state != "succeeded"):
                self._let_go, self._pause_s = bound.hand, 0.0
        raise _Replan

    def _again(self, deviation: Deviation, running: _Running | None) -> Deviation:
        """The same question, asked of the state now."""
        sensed = self.senses.look()
        if running is None:
            return Deviation(broken=rest_of_plan((), self.full_goal, sensed))
        if deviation.unmet or running.row["state"] == "not_executed":
            return before_step(self._lasting[running.index], sensed)
        return self._deviation(running)

    def _diagnosis(
        self,
        deviation: Deviation,
        running: _Running | None,
        report: MotionReport | None,
        passed_s: float | None,
    ) -> Diagnosis:
        start_ns = self.session.time_ns if running is None else running.start_ns
        sensed = self.senses.look()
        bound = None if running is None else running.bound
        operator = None if bound is None else bound.operator
        lasting = None if running is None else self._lasting[running.index]
        texts = lifted_text(deviation.literals, operator, lasting)
        types = self._planned_with.types
        case = Case(
            literals=deviation.literals,
            passed_after_s=passed_s,
            held=self.params.momentary.lasting_state(sensed.held, self.senses.type_of, types),
            unknown=sensed.unknown,
            frames=self.senses.frames(
                max(-1, min(start_ns, self.session.time_ns - 2_000_000_000) - 300_000_000)
            ),
            hands=self.session.hands,
            fixed=frozenset({TABLE}),
            objects=tuple(name for name in self.senses.objects if name not in self._gone),
            hand=None if bound is None else bound.hand,
            activity=None if operator is None else operator.activity,
            thing=None if bound is None else bound.motion.object,
            support=None if bound is None else bound.motion.support,
            was_held=running is not None
            and bound is not None
            and Atom(self.params.holding, (bound.hand, bound.motion.object or "")) in running.before.held,
            motion_state=None if report is None else report.state,
            motion_problem=None if report is None else report.problem,
            motion_reason=None if report is None else report.reason,
            tracking_error_m=0.0 if report is None else report.tracking_error_m,
            n_collisions=0 if report is None else report.n_collisions,
            n_alike_before=0 if operator is None else self._n_bad[operator.name, texts],
            n_good_before=0
            if operator is None
            else min((self._n_good[operator.name, text] for text in texts), default=0),
            since_ns=start_ns,
        )
        return diagnose(case, self.params.diagnosing)

    def _name(self, failure: str) -> None:
        """Keep the class that was first named once the fault, if there is one, had happened."""
        if self.diagnosed is None and (self.injector.fault is None or self.injector.is_done):
            self.diagnosed = failure

    def _gone_objects(self) -> set[str]:
        seen = self.senses.frames(max(-1, self.session.time_ns - round(self.params.diagnosing.gone_s * 1e9)))
        present = set(seen.filter(seen["position_xyz_m"].is_not_null())["entity"])
        return set(self.senses.objects) - present

    def _free_a_hand(self, sensed: SensedState) -> bool:
        """Without a plan: a hand that holds something lays it down, a closed one opens; once for each plan.

        Learned operators put things where they were shown to be put, and none begins with an object in the
        air or an empty fist. Laying down and opening are the robot's own ways out of that.
        """
        for hand in self.session.hands:
            held = sorted(
                atom.arguments[1]
                for atom in sensed.held
                if atom.predicate == self.params.holding and atom.arguments[0] == hand
            )
            is_open = all(Atom(name, (hand,)) in sensed.held for name in self.params.ends_with)
            if self._gone_and_held(held) or (not held and is_open):
                continue
            motions = [Motion(activity="Release", skill="release", object=held[0] if held else None)]
            if held:
                motions.insert(0, Motion(activity="Put", skill="carry", object=held[0], support=TABLE))
            for motion in motions:
                self._recover(hand, motion)
            self._advance(self.params.lag_s)
            return self.senses.look().held != sensed.held
        return False

    def _recover(self, hand: str, motion: Motion) -> None:
        """A motion of the robot's own, that no plan asked for; it is a row as any other."""
        row = self._row(None, None)
        row |= {
            "operator": f"recover_{motion.skill}",
            "arguments": [hand, *([motion.object] if motion.object else [])],
            "hand": hand,
            "activity": motion.activity,
            "start_ns": self.session.time_ns,
        }
        report = self._wait(hand, motion)
        row |= {
            "state": "succeeded" if report.state == "succeeded" else "failed",
            "end_ns": self.session.time_ns,
            "cause": report.reason,
        }

    @staticmethod
    def _gone_and_held(held: list[str]) -> bool:
        return len(held) > 1

    def _wait(self, hand: str, motion: Motion) -> MotionReport:
        report = self.session.start(hand, motion)
        start_ns = self.session.time_ns
        while report.state == "running":
            self._check_time()
            self._advance(self.params.poll_s)
            if (self.session.time_ns - start_ns) / 1e9 > self.params.step_timeout_s:
                self.session.cancel(hand)
            report = self.session.report(hand) or report
        return report

    def _stop_hands(self) -> None:
        """Let motions that are under way come to their end: a hand that stops midway helps nobody."""
        for hand, running in sorted(self._running.items()):
            report = self.session.report(hand)
            while report is not None and report.state == "running":
                self.session.advance(self.params.poll_s)
                if (self.session.time_ns - running.start_ns) / 1e9 > self.params.step_timeout_s:
                    self.session.cancel(hand)
                report = self.session.report(hand)
            if running.row["state"] == "executing":
                is_well = report is not None and report.state == "succeeded"
                running.row |= {
                    "state": "succeeded" if is_well else "cancelled",
                    "end_ns": self.session.time_ns,
                }
        self._running = {}
        self.session.advance(self.params.lag_s)

    def _advance(self, duration_s: float) -> None:
        self.session.advance(duration_s)
        self.injector.time_passed()

    # --- rows, and what is true ----------------------------------------------------------------------------

    def _row(self, index: int | None, bound: Bound | None) -> dict[str, object]:
        plan_index = max(0, self.n_plans - 1)
        step = None if index is None else self._graph.steps[index].step
        taken = [int(str(row["step_index"])) for row in self.rows if row["plan_index"] == plan_index]
        free = max([len(self._graph.steps) - 1, *taken]) + 1
        row: dict[str, object] = {
            "run_id": self.run_id,
            "plan_index": plan_index,
            "step_index": free if index is None else index,
            "operator": "goal" if step is None else step.operator,
            "arguments": [] if step is None else list(step.arguments),
            "hand": None if bound is None else bound.hand,
            "activity": "Check" if bound is None else bound.operator.activity,
            "state": "not_executed",
            "start_ns": None,
            "end_ns": None,
            "unmet": [],
            "missing": [],
            "extra": [],
            "failure": None,
            "cause": None,
            "tracking_error_m": None,
            "peak_force_n": None,
            "n_collisions": None,
        }
        self.rows.append(row)
        return row

    def _close_rows(self) -> None:
        """Steps that were never begun are rows too."""
        begun = {row["step_index"] for row in self.rows if row["plan_index"] == self.n_plans - 1}
        for index in range(len(self._graph.steps)):
            if index not in begun and index not in self._ended:
                self._row(index, self._bound(index))
        self._graph, self._lasting, self._ended = DispatchGraph((), ()), (), set()

    def _check_time(self) -> None:
        if self.session.time_ns / 1e9 > self.params.run_timeout_s:
            raise _End("timeout", f"the run took more than {self.params.run_timeout_s:.0f} s")

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
