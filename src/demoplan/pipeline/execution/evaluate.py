"""Domains × goals × seeds × faults × monitors, executed on all cores: resumable, a row per run and step."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.engines.mujoco.scene_spec import RandomSceneParams, SceneSpec, random_scene, read_scene
from demoplan.errors import DemoplanError, UsageError
from demoplan.language.pddl import parse_domain
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.faults import AnyFault
from demoplan.manifests.goals import GoalCase
from demoplan.pipeline.execution.batch import run_batch
from demoplan.pipeline.execution.execute import ExecuteParams, step_rows
from demoplan.pipeline.execution.recoverability import Recoverability, recoverability
from demoplan.pipeline.execution.run_jobs import RunJob, carry_out, case_of, not_started
from demoplan.store import Store
from demoplan.store.store import StageOutput
from demoplan.tables import Executions, FaultCases, Frames, Runs

RUN_STAGE, CASE_STAGE = "execute", "fault-case"
"""Names of the store's records."""


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Where the store keeps a run."""

    job: RunJob
    run: dy.DataFrame[Runs]
    steps: dy.DataFrame[Executions]
    frames: str | None
    """Content hash of the poses, if they were kept."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """All runs of a batch."""

    runs: dy.DataFrame[Runs]
    steps: dy.DataFrame[Executions]
    records: tuple[RunRecord, ...] = field(default=(), repr=False)


def scene_of(goal: GoalCase, seed: int, folder: Path | None = None) -> SceneSpec:
    """The scene that a goal is tried in: the file that it names, or one that is drawn from the seed."""
    if goal.scene is not None:
        return read_scene((folder or Path()) / goal.scene)
    return random_scene(
        goal.cubes,
        seed=seed,
        stacked=goal.stacked,
        params=RandomSceneParams(edges_m=goal.edges_m),
    )


def jobs_of(
    store: Store,
    domains: Sequence[tuple[str, str]],
    goals: Sequence[GoalCase],
    *,
    vocabulary: Vocabulary,
    seeds: Sequence[int],
    robot: str,
    faults: Sequence[AnyFault | None] = (None,),
    monitors: Sequence[str] = ("full",),
    params: ExecuteParams = ExecuteParams(),
    folder: Path | None = None,
    is_recorded: bool = False,
) -> list[RunJob]:
    """One job for each domain × goal × fault × monitor × seed.

    Args:
        store: Where runs are kept.
        domains: (name, PDDL text) pairs.
        goals: What to reach, and in which scenes.
        vocabulary: What perception looks for.
        seeds: Of scenes, sensors and faults: equal seeds give the same scene to every domain and monitor.
        robot: Which robot.
        faults: What goes wrong; None for nothing.
        monitors: What is checked.
        params: Other choices.
        folder: What the goals' scene files are relative to.
        is_recorded: Keep poses.
    """
    return [
        RunJob(
            store=store.location,
            domain_text=text,
            domain_name=name,
            goal=goal,
            robot=robot,
            seed=seed,
            fault=fault,
            vocabulary=vocabulary,
            params=replace(params, monitor=monitor),
            scene=scene_of(goal, seed, folder),
            is_recorded=is_recorded,
        )
        for name, text in domains
        for goal in goals
        for fault in faults
        for monitor in monitors
        for seed in seeds
    ]


def run_job(job: RunJob) -> str:
    """Make one run and keep it, unless it is there already; give back the key of its record.

    Whatever cannot be started is a row that says so: an unknown object in the goal, a robot that is not
    installed, a scene whose objects stand in each other.
    """

    def make() -> StageOutput:
        try:
            done = carry_out(job)
        except DemoplanError as error:
            run = not_started(job, f"{type(error).__name__}: {error}")
            return StageOutput(tables={"runs": (run, Runs), "executions": (step_rows([]), Executions)})
        tables: dict[str, tuple[pl.DataFrame, type[dy.Schema]]] = {
            "runs": (done.run, Runs),
            "executions": (done.steps, Executions),
        }
        if job.is_recorded:
            tables["frames"] = (done.frames, Frames)
        # Without its scene, a stored run could not be drawn.
        return StageOutput(tables=tables, notes={"scene": job.scene.model_dump_json()})

    return str(Store(job.store).run(RUN_STAGE, *job.key(), make).key)


def decide_case(job: RunJob) -> str:
    """Decide whether anybody could recover from the fault of a case, and keep it; give back its key."""
    from demoplan.engines.mujoco.opening import open_session  # noqa: PLC0415 - a heavy import, once a process

    fault = job.fault
    assert fault is not None

    def make() -> StageOutput:
        try:
            decided = recoverability(
                parse_domain(job.domain_text),
                job.goal.goal,
                open_session(job.scene, job.robot, seed=job.seed),
                job.vocabulary,
                fault,
                seed=job.seed,
                params=job.params,
            )
        except DemoplanError as error:
            decided = Recoverability(False, None, f"{type(error).__name__}: {error}")
        schema = {name: column.dtype for name, column in FaultCases.columns().items()}
        row = pl.DataFrame([{"case_id": job.run_id, **asdict(decided)}], schema=schema)
        return StageOutput(tables={"cases": (FaultCases.validate(row), FaultCases)})

    return str(Store(job.store).run(CASE_STAGE, *job.key(), make).key)


def evaluate(
    jobs: Sequence[RunJob], *, n_workers: int, on_done: Callable[[str], None] = lambda _: None
) -> Evaluation:
    """Make every run that is not in the store yet, and gather them all.

    Args:
        jobs: What to run.
        n_workers: Processes; each takes one run at a time. One that dies costs its own run only.
        on_done: Called with the name of each run when it is there.
    """
    if not jobs:
        raise UsageError("nothing to run: give at least one domain, goal and seed")
    store = Store(jobs[0].store)
    cases = list({case.run_id: case for case in (case_of(job) for job in jobs if job.fault)}.values())
    undecided = _make_all(store, CASE_STAGE, decide_case, cases, n_workers, lambda _: None)
    decided = {case.run_id: _decided(store, case) for case in cases if case.run_id not in undecided}
    lost = _make_all(store, RUN_STAGE, run_job, jobs, n_workers, on_done)
    records = [
        _record(store, job, lost.get(job.run_id), decided.get(case_of(job).run_id) if job.fault else None)
        for job in jobs
    ]
    order = ["domain_name", "goal", "fault", "monitor", "seed", "run_id"]
    runs = pl.concat([record.run for record in records]).unique("run_id").sort(order)
    steps = pl.concat([record.steps for record in records]).unique(Executions.primary_key())
    return Evaluation(
        runs=Runs.validate(runs),
        steps=Executions.validate(steps.sort(Executions.primary_key())),
        records=tuple(records),
    )


def _make_all(
    store: Store,
    stage: str,
    make: Callable[[RunJob], str],
    jobs: Sequence[RunJob],
    n_workers: int,
    on_done: Callable[[str], None],
) -> dict[str, str]:
    """Make what the store does not have; what was lost, by run id, and why."""
    waiting = []
    for job in jobs:
        if store.is_current(stage, *job.key()):
            on_done(_name(job))
        else:
            waiting.append(job)
    lost = {}
    for job, reason in run_batch(make, waiting, n_workers=n_workers):
        if reason is not None:
            lost[job.run_id] = reason
        on_done(_name(job))
    return lost


def _name(job: RunJob) -> str:
    fault = f", {job.fault.name}" if job.fault is not None else ""
    return f"{job.domain_name}: {job.goal.name}{fault}, {job.params.monitor}, seed {job.seed}"


def _never() -> StageOutput:
    raise AssertionError("it was made a moment ago")


def _decided(store: Store, case: RunJob) -> bool | None:
    record = store.run(CASE_STAGE, *case.key(), _never)
    found: bool | None = store.get(record.outputs["cases"], FaultCases).item(0, "is_recoverable")
    return found


def _record(store: Store, job: RunJob, lost: str | None, is_recoverable: bool | None) -> RunRecord:
    if lost is not None:
        run = not_started(job, lost)
        return RunRecord(job=job, run=run, steps=step_rows([]), frames=None)
    record = store.run(RUN_STAGE, *job.key(), _never)
    run = store.get(record.outputs["runs"], Runs)
    decided = pl.lit(is_recoverable, dtype=pl.Boolean).alias("is_recoverable")
    return RunRecord(
        job=job,
        run=Runs.validate(run.with_columns(decided)),
        steps=store.get(record.outputs["executions"], Executions),
        frames=record.outputs.get("frames"),
    )
