"""One run as a value: all that a process needs to make it, and the row of one that cannot be made."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import dataframely as dy

from demoplan.engines.mujoco.filming import Film
from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.ids import content_hash
from demoplan.language.pddl import domain_id, parse_domain
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.faults import AnyFault
from demoplan.manifests.goals import GoalCase
from demoplan.pipeline.execution.execute import Executed, ExecuteParams, execute, run_rows
from demoplan.pipeline.execution.faults import CLASS_OF_KIND
from demoplan.store.code_version import code_version
from demoplan.store.store import canonical_json
from demoplan.tables import Runs

CODE = (
    "demoplan.pipeline.execution.executing",
    "demoplan.pipeline.execution.execute",
    "demoplan.pipeline.execution.evaluate",
    "demoplan.pipeline.execution.replanning",
    "demoplan.pipeline.execution.senses",
    "demoplan.pipeline.execution.faults",
    "demoplan.pipeline.execution.injecting",
    "demoplan.pipeline.execution.recoverability",
    "demoplan.stages.monitor",
    "demoplan.stages.diagnose",
    "demoplan.stages.perceive",
    "demoplan.language.dispatch",
    "demoplan.language.momentary",
    "demoplan.engines.mujoco",
)
"""What a run's outcome depends on, beside its inputs: a change of any of these runs it anew."""


@dataclass(frozen=True, kw_only=True)
class RunJob:
    """All that a process needs to make one run. Domains travel as text: that is what their id stands for."""

    store: str
    domain_text: str
    domain_name: str
    goal: GoalCase
    robot: str
    seed: int
    fault: AnyFault | None
    vocabulary: Vocabulary
    params: ExecuteParams
    scene: SceneSpec
    is_recorded: bool = False
    """Whether the poses are kept, to be looked at."""

    @property
    def run_id(self) -> str:
        """Hash of everything that the run is made of."""
        return content_hash(canonical_json(self._inputs()), self._params())[:32]

    def _inputs(self) -> dict[str, str]:
        return {
            "domain": content_hash(self.domain_text),
            "goal": self.goal.goal,
            "scene": content_hash(self.scene.model_dump_json()),
            "vocabulary": content_hash(canonical_json(asdict(self.vocabulary))),
        }

    def _params(self) -> str:
        return canonical_json(
            {
                "names": [self.domain_name, self.goal.name],
                "robot": self.robot,
                "seed": self.seed,
                "fault": None if self.fault is None else self.fault.model_dump(mode="json"),
                "params": asdict(self.params),
                "is_recorded": self.is_recorded,
            }
        )

    def key(self) -> tuple[Mapping[str, str], str, str]:
        """Inputs, parameters and code version, for the store."""
        return self._inputs(), self._params(), code_version(*CODE)


def carry_out(job: RunJob, film: Film | None = None) -> Executed:
    """Make the run.

    Args:
        job: All that it needs.
        film: Keeps what it looks like, if it is to be drawn.

    Raises:
        DemoplanError: If it cannot be started; :func:`not_started` is the row that says so.
    """
    from demoplan.engines.mujoco.opening import open_session  # noqa: PLC0415 - a heavy import, once a process

    domain = parse_domain(job.domain_text)
    return execute(
        domain,
        job.goal.goal,
        open_session(job.scene, job.robot, seed=job.seed, film=film),
        job.vocabulary,
        run_id=job.run_id,
        seed=job.seed,
        domain_id=str(domain_id(domain)),
        domain_name=job.domain_name,
        goal_name=job.goal.name,
        fault=job.fault,
        params=job.params,
    )


def case_of(job: RunJob) -> RunJob:
    """The job that decides, for all monitors, whether anybody could recover from the job's fault."""
    return replace(job, params=replace(job.params, monitor="none"), is_recorded=False)


def not_started(job: RunJob, reason: str) -> dy.DataFrame[Runs]:
    """The row of a run that could not begin, or did not come back."""
    fault = job.fault
    return run_rows(
        [
            {
                "run_id": job.run_id,
                "domain_id": str(domain_id(parse_domain(job.domain_text))),
                "domain_name": job.domain_name,
                "goal": job.goal.name,
                "robot": job.robot,
                "monitor": job.params.monitor,
                "seed": job.seed,
                "fault": None if fault is None else fault.name,
                "fault_kind": None if fault is None else fault.kind,
                "fault_class": None if fault is None else CLASS_OF_KIND[fault.kind],
                "severity": None if fault is None else fault.severity,
                "is_fault_injected": False,
                "fault_ns": None,
                "is_recoverable": None,
                "is_goal_reached": False,
                "is_goal_sensed": False,
                "outcome": "not_started",
                "reason": reason,
                "n_plans": 0,
                "n_steps": 0,
                "n_discrepancies": 0,
                "n_passed": 0,
                "n_false_alarms": 0,
                "n_unsound": 0,
                "diagnosed": None,
                "simulated_s": 0.0,
            }
        ]
    )
