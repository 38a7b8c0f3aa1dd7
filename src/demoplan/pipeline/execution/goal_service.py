"""Goals as services: what a ROS client calls to have a goal planned, or carried out."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from demoplan.engines.fast_downward import SolveParams
from demoplan.engines.mujoco.opening import open_session
from demoplan.engines.mujoco.scene_spec import SceneSpec, read_scene
from demoplan.engines.mujoco.session import Session
from demoplan.engines.rosbridge import Reply, Service
from demoplan.errors import UsageError
from demoplan.language.domains import Domain
from demoplan.language.goals import parse_goal
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.goals import GoalCase
from demoplan.pipeline.execution.evaluate import scene_of
from demoplan.pipeline.execution.execute import ExecuteParams, execute
from demoplan.pipeline.execution.replanning import emptied_hands, plan_from
from demoplan.pipeline.execution.senses import Senses

PLAN, EXECUTE, RESET = "/demoplan/plan_goal", "/demoplan/execute_goal", "/demoplan/reset"


class GoalService:
    """One robot in one scene; what a goal leaves behind is what the next one begins with."""

    def __init__(
        self,
        domain: Domain,
        vocabulary: Vocabulary,
        *,
        scene: Path | None = None,
        robot: str = "gripper",
        seed: int = 0,
        params: ExecuteParams = ExecuteParams(),
    ) -> None:
        """Open the session: a scene that cannot be opened is an error now, not at the first call."""
        self.domain, self.vocabulary, self.params = domain, vocabulary, params
        self.scene: SceneSpec = (
            read_scene(scene) if scene else scene_of(GoalCase(name="served", goal=""), seed)
        )
        self.robot, self.seed = robot, seed
        self._session = self._open()

    def _open(self) -> Session:
        session = open_session(self.scene, self.robot, seed=self.seed)
        session.advance(self.params.lag_s)
        return session

    def services(self) -> dict[str, Service]:
        """What to serve, by name."""
        goal = ("goal",)
        return {
            PLAN: Service(type="demoplan/PlanGoal", arguments=goal, function=self.plan_goal),
            EXECUTE: Service(type="demoplan/ExecuteGoal", arguments=goal, function=self.execute_goal),
            RESET: Service(type="std_srvs/Trigger", arguments=(), function=self.reset),
        }

    def plan_goal(self, arguments: Mapping[str, Any]) -> Reply:
        """Plan from what is sensed now; nothing moves. Gives outcome, message, steps and cost."""
        goal = _goal(arguments)
        senses = Senses(self._session, self.vocabulary, self.params.sensing)
        literals = parse_goal(goal, self.domain.predicates, senses.type_of, self.domain.types)
        planned = plan_from(
            self.domain,
            emptied_hands(literals, self._session.hands, self.params.ends_with, self.domain),
            senses.look(),
            senses,
            self.params.momentary,
            SolveParams(),
            self.params.skills,
            is_first=True,
            gone=frozenset(),
        )
        if planned.plan is None:
            return Reply({"outcome": planned.outcome, "message": planned.reason, "steps": [], "cost": 0})
        return Reply(
            {
                "outcome": planned.outcome,
                "message": planned.reason,
                "steps": [str(step) for step in planned.plan.steps],
                "cost": planned.plan.cost,
            }
        )

    def execute_goal(self, arguments: Mapping[str, Any]) -> Reply:
        """Reach a goal; gives how it ended, and each step with its state."""
        done = execute(
            self.domain,
            _goal(arguments),
            self._session,
            self.vocabulary,
            seed=self.seed,
            params=self.params,
        )
        run = done.run.row(0, named=True)
        return Reply(
            {
                "outcome": run["outcome"],
                "message": run["reason"] or "",
                "is_goal_reached": run["is_goal_sensed"],
                "n_plans": run["n_plans"],
                "steps": [
                    {
                        "step": f"{row['operator']}({','.join(row['arguments'])})",
                        "state": row["state"],
                        "failure": row["failure"] or "",
                        "cause": row["cause"] or "",
                    }
                    for row in done.steps.iter_rows(named=True)
                ],
            }
        )

    def reset(self, _: Mapping[str, Any]) -> Reply:
        """Put everything back to where it was."""
        self._session = self._open()
        return Reply({"success": True, "message": f"scene {self.scene.name!r} is as it was"})


def _goal(arguments: Mapping[str, Any]) -> str:
    goal = arguments.get("goal")
    if not isinstance(goal, str) or not goal.strip():
        raise UsageError(f"'goal' must be text, as 'onTop(cube_red, cube_blue)'; found {goal!r:.60}")
    return goal
