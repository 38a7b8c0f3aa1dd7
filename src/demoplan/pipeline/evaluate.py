"""Domains × goals × seeds × faults × monitors, executed on all cores: resumable, a row per run and step."""

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import dataframely as dy
import polars as pl
from pydantic import Field

from demoplan.engines.mujoco.scene_spec import RandomSceneParams, SceneSpec, random_scene, read_scene
from demoplan.errors import DemoplanError, ManifestError, UsageError
from demoplan.ids import content_hash
from demoplan.language.pddl import domain_id, parse_domain
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.dataset import SafeName
from demoplan.manifests.loading import load_yaml
from demoplan.manifests.mapping import Strict
from demoplan.pipeline.execute import ExecuteParams, execute, run_rows, step_rows
from demoplan.pipeline.faults import AnyFault
from demoplan.store import Store
from demoplan.store.code_version import code_version
from demoplan.store.store import StageOutput, canonical_json
from demoplan.tables import Executions, Frames, Runs

CODE = (
    "demoplan.pipeline.executing",
    "demoplan.pipeline.execute",
    "demoplan.pipeline.evaluate",
    "demoplan.pipeline.replanning",
    "demoplan.pipeline.senses",
    "demoplan.pipeline.faults",
    "demoplan.pipeline.injecting",
    "demoplan.stages.monitor",
    "demoplan.stages.diagnose",
    "demoplan.stages.perceive",
    "demoplan.language.dispatch",
    "demoplan.language.momentary",
    "demoplan.engines.mujoco",
)
"""What a run's outcome depends on, beside its inputs: a change of any of these runs it anew."""


class GoalCase(Strict):
    """A goal, and the kind of scene that it is tried in."""

    name: SafeName
    goal: str
    """Goal text, as ``onTop(cube_red,cube_blue) & onTop(cube_blue,cube_green)``."""
    cubes: tuple[str, ...] = ("cube_red", "cube_blue", "cube_green", "cube_yellow")
    """Cubes at places drawn from the seed."""
    stacked: tuple[tuple[str, str], ...] = ()
    """(cube, cube below it) pairs that hold at the start."""
    edges_m: tuple[float, ...] = Field(default=(0.05,), min_length=1)
    """Edges of cubes; one is drawn for each."""
    scene: str | None = None
    """A scene's file, relative to this one, in place of a drawn scene."""


class GoalsFile(Strict):
    """The form of a goals file."""

    goals: tuple[GoalCase, ...]


def parse_goals(text: str, path: Path | str) -> tuple[GoalCase, ...]:
    """The goals that a file describes.

    Raises:
        ManifestError: If its form is wrong, or a name is used twice; with the line.
    """
    goals = load_yaml(text, path, GoalsFile).goals
    names: set[str] = set()
    for goal in goals:
        if goal.name in names:
            lines = [n for n, line in enumerate(text.splitlines(), 1) if goal.name in line]
            raise ManifestError(path, lines[-1] if lines else None, f"goal {goal.name!r} is named twice")
        names.add(goal.name)
    return goals


def read_goals(path: Path) -> tuple[GoalCase, ...]:
    """The goals that a file describes; see :func:`parse_goals`."""
    try:
        return parse_goals(path.read_text(encoding="utf-8"), path)
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read: {error}") from None


@dataclass(frozen=True, kw_only=True)
class RunJob:
    """All that a process needs to make one run. Domains travel as text: that is what their id stands for."""

    store_root: Path
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
            store_root=store.root,
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
    from demoplan.engines.mujoco.session import open_session  # noqa: PLC0415 - a heavy import, once a process

    def make() -> StageOutput:
        domain = parse_domain(job.domain_text)
        try:
            session = open_session(job.scene, job.robot, seed=job.seed)
            done = execute(
                domain,
                job.goal.goal,
                session,
                job.vocabulary,
                run_id=job.run_id,
                seed=job.seed,
                domain_id=str(domain_id(domain)),
                domain_name=job.domain_name,
                goal_name=job.goal.name,
                fault=job.fault,
                params=job.params,
            )
        except DemoplanError as error:
            run = not_started(job, str(domain_id(domain)), f"{type(error).__name__}: {error}")
            return StageOutput(tables={"runs": (run, Runs), "executions": (step_rows([]), Executions)})
        tables: dict[str, tuple[pl.DataFrame, type[dy.Schema]]] = {
            "runs": (done.run, Runs),
            "executions": (done.steps, Executions),
        }
        if job.is_recorded:
            tables["frames"] = (done.frames, Frames)
        return StageOutput(tables=tables)

    inputs, params, code = job.key()
    return str(Store(job.store_root).run("execute", inputs, params, code, make).key)


def not_started(job: RunJob, domain: str, reason: str) -> dy.DataFrame[Runs]:
    """The row of a run that could not begin, or did not come back."""
    from demoplan.pipeline.faults import CLASS_OF_KIND  # noqa: PLC0415

    fault = job.fault
    return run_rows(
        [
            {
                "run_id": job.run_id,
                "domain_id": domain,
                "domain_name": job.domain_name,
                "goal": job.goal.name,
                "robot": job.robot,
                "monitor": job.params.monitor,
                "seed": job.seed,
                "fault": None if fault is None else fault.name,
                "fault_kind": None if fault is None else fault.kind,
                "fault_class": None if fault is None else CLASS_OF_KIND[fault.kind],
                "severity": None if fault is None else fault.severity,
                "is_recoverable": None if fault is None else fault.is_recoverable,
                "is_fault_injected": False,
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
    store = Store(jobs[0].store_root)
    waiting = []
    for job in jobs:
        inputs, params, code = job.key()
        if store.is_current("execute", inputs, params, code):
            on_done(_name(job))
        else:
            waiting.append(job)
    lost: dict[str, str] = {}
    for job, reason in _all_run(waiting, n_workers):
        if reason is not None:
            lost[job.run_id] = reason
        on_done(_name(job))
    records = [_record(store, job, lost.get(job.run_id)) for job in jobs]
    order = ["domain_name", "goal", "fault", "monitor", "seed", "run_id"]
    runs = pl.concat([record.run for record in records]).unique("run_id").sort(order)
    steps = pl.concat([record.steps for record in records]).unique(Executions.primary_key())
    return Evaluation(
        runs=Runs.validate(runs),
        steps=Executions.validate(steps.sort(Executions.primary_key())),
        records=tuple(records),
    )


def _name(job: RunJob) -> str:
    fault = f", {job.fault.name}" if job.fault is not None else ""
    return f"{job.domain_name}: {job.goal.name}{fault}, {job.params.monitor}, seed {job.seed}"


def _record(store: Store, job: RunJob, lost: str | None) -> RunRecord:
    if lost is not None:
        run = not_started(job, str(content_hash(job.domain_text)[:16]), lost)
        return RunRecord(job=job, run=run, steps=step_rows([]), frames=None)
    inputs, params, code = job.key()

    def never() -> StageOutput:
        raise AssertionError("the run was made a moment ago")

    record = store.run("execute", inputs, params, code, never)
    return RunRecord(
        job=job,
        run=store.get(record.outputs["runs"], Runs),
        steps=store.get(record.outputs["executions"], Executions),
        frames=record.outputs.get("frames"),
    )


def _all_run(jobs: Sequence[RunJob], n_workers: int) -> Iterator[tuple[RunJob, str | None]]:
    """Each job when it has ended, with what killed it if something did."""
    if n_workers <= 1 or len(jobs) <= 1:
        for job in jobs:
            run_job(job)
            yield job, None
        return
    remaining = list(jobs)
    while remaining:
        done: set[int] = set()
        # Spawned, not forked: polars hangs in a forked process that used it before.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(n_workers, len(remaining)), mp_context=context) as pool:
            futures = {pool.submit(run_job, job): k for k, job in enumerate(remaining)}
            for future in as_completed(futures):
                k = futures[future]
                try:
                    future.result()
                except BrokenProcessPool:
                    continue
                done.add(k)
                yield remaining[k], None
        left = [job for k, job in enumerate(remaining) if k not in done]
        if len(left) == len(remaining):
            # Nobody came back: try them alone, so that only the one at fault is lost.
            for job in left:
                yield job, _alone(job)
            return
        remaining = left


def _alone(job: RunJob) -> str | None:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            pool.submit(run_job, job).result()
        except BrokenProcessPool:
            return "the process that ran it died"
    return None
