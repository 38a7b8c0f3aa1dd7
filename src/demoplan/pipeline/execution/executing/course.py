"""A plan while it is carried out: which steps are over, which run, and what they expect of the world."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from demoplan.engines.mujoco.session import Motion
from demoplan.engines.mujoco.skills import SkillTable, motion_of
from demoplan.language.atoms import Literal
from demoplan.language.dispatch import DispatchGraph, dispatch_graph
from demoplan.language.domains import Domain, Operator, Plan
from demoplan.language.execution import GroundOperator
from demoplan.language.momentary import Momentary
from demoplan.pipeline.execution.executing.rows import Row
from demoplan.stages.monitor import Deviation, SensedState, after_step, effects_of, rest_of_plan


@dataclass(frozen=True)
class Bound:
    """A step's operator, and which hand makes which motion to carry it out."""

    operator: Operator
    hand: str
    motion: Motion


@dataclass
class Running:
    """A step that is being carried out."""

    index: int
    bound: Bound
    before: SensedState
    start_ns: int
    row: Row


class Course:
    """One plan on its way to a goal."""

    def __init__(
        self,
        domain: Domain,
        plan: Plan,
        goal: frozenset[Literal],
        *,
        hands: tuple[str, ...],
        type_of: Mapping[str, str],
        momentary: Momentary,
        skills: SkillTable,
        refusal: str = "",
    ) -> None:
        """Nothing has begun yet.

        Args:
            domain: What the plan's steps mean.
            plan: The steps.
            goal: What shall hold after them.
            hands: Of the robot; each does one thing at a time.
            type_of: Type of everything in the scene.
            momentary: Which predicates cannot be demanded of a world at rest.
            skills: Activity → motion.
            refusal: Why steps that followed were left out of the plan, if they were.
        """
        self.domain, self.goal, self.refusal = domain, goal, refusal
        self._type_of, self._momentary, self._skills = dict(type_of), momentary, skills
        self.graph: DispatchGraph = dispatch_graph(domain, plan, hands)
        self.lasting: tuple[GroundOperator, ...] = tuple(
            momentary.lasting_step(step, self._type_of, domain.types) for step in self.graph.steps
        )
        """The steps, with what can be demanded of the world before them and expected of it afterwards."""
        self.ended: set[int] = set()
        self.running: dict[str, Running] = {}
        """By hand."""

    @property
    def n_steps(self) -> int:
        """How many steps the plan has."""
        return len(self.graph.steps)

    @property
    def is_over(self) -> bool:
        """Whether all steps have ended."""
        return len(self.ended) == self.n_steps

    @property
    def objects(self) -> frozenset[str]:
        """Everything that the plan speaks of."""
        return frozenset(name for each in self.graph.steps for name in each.step.arguments)

    def ready(self) -> tuple[int, ...]:
        """Steps that wait for nothing any more, as far as the plan goes; their hands may be busy."""
        return self.graph.ready(self.ended, {running.index for running in self.running.values()})

    def bound(self, index: int) -> Bound:
        """Operator, hand and motion of a step."""
        step = self.graph.steps[index].step
        operator = next(o for o in self.domain.operators if o.name == step.operator)
        hand, motion = motion_of(step, self.domain, self._skills)
        return Bound(operator, hand, motion)

    def is_through(self, hand: str) -> bool:
        """Whether a hand has finished with an object: its next step, if it has one, begins with a reach."""
        left = [self.bound(index) for index in range(self.n_steps) if index not in self.ended]
        own = [bound for bound in left if bound.hand == hand]
        return not own or own[0].motion.skill == "reach"

    def hands_with_steps(self) -> frozenset[str]:
        """Hands that have something to do yet."""
        return frozenset(self.bound(index).hand for index in range(self.n_steps) if index not in self.ended)

    def lasting_state(self, sensed: SensedState) -> SensedState:
        """What lasts of what is sensed."""
        kept = self._momentary.lasting_state(sensed.held, self._type_of, self.domain.types)
        return replace(sensed, held=kept)

    def deviation(self, running: Running, sensed: SensedState, rows: Iterable[Row]) -> Deviation:
        """How the world differs from what a step, and those beside it, should have made of it.

        Args:
            running: The step.
            sensed: The state now.
            rows: Those of this plan: steps that ended while this one ran may rightly have changed what it
                left.
        """
        others = [self.lasting[other.index] for other in self.running.values() if other is not running]
        since = [
            self.lasting[int(str(row["step_index"]))]
            for row in rows
            if row["end_ns"] is not None
            and int(str(row["step_index"])) < self.n_steps
            and int(str(row["end_ns"])) >= running.start_ns
            and row is not running.row
        ]
        undone = {literal.negated() for each in (*others, *since) for literal in effects_of(each)}
        found = after_step(
            self.lasting[running.index],
            self.lasting_state(running.before),
            self.lasting_state(sensed),
            (*others, *since),
            waived=frozenset(undone),
        )
        # A plan that was cut short was never to reach the goal.
        broken = () if self.refusal else self._rest(sensed, except_for=running.index)
        return replace(found, broken=broken)

    def lacking_at_end(self, sensed: SensedState) -> tuple[Literal, ...]:
        """What of the goal is not so."""
        return rest_of_plan((), self.goal, sensed)

    def _rest(self, sensed: SensedState, *, except_for: int) -> tuple[Literal, ...]:
        """What the steps still to come lack; those that run now are taken to succeed."""
        running = {each.index for each in self.running.values()} - {except_for}
        coming = [
            replace(step, preconditions=frozenset()) if index in running else step
            for index, step in sorted(
                enumerate(self.lasting), key=lambda pair: (pair[0] not in running, pair[0])
            )
            if index not in self.ended and index != except_for
        ]
        return rest_of_plan(coming, self.goal, sensed)
