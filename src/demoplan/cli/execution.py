"""Commands that let robots run plans: execute, evaluate, serve-goals."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from demoplan.cli.options import (
    DEFAULT_STORE,
    JsonOption,
    StoreOption,
    WorkersOption,
    existing_store,
    workers_of,
)
from demoplan.cli.output import Exit, print_frame, print_json, print_table, progress, say, stdout
from demoplan.errors import UnknownNameError, UsageError
from demoplan.store import Store

if TYPE_CHECKING:
    from demoplan.engines.mujoco.filming import Film
    from demoplan.language.vocabulary import Vocabulary

RobotOption = Annotated[str, typer.Option("--robot", help="gripper, gripper_dual, tiago, tiago_dual.")]
MonitorOption = Annotated[
    list[str] | None,
    typer.Option("--monitor", help="full, preconditions, none; evaluate takes several."),
]
SkillsOption = Annotated[
    Path | None,
    typer.Option("--skills", metavar="FILE", help="Which motion carries out which activity: your own table."),
]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(execute)
    app.command()(evaluate)
    app.command("serve-goals")(serve_goals)


def _vocabulary(store: Store, dataset: str) -> "Vocabulary":
    from demoplan.pipeline.datasets import recall

    return recall(store, dataset).vocabulary


def _checked(monitors: Sequence[str], robot: str) -> tuple[str, ...]:
    from demoplan.engines.mujoco.session import ROBOTS
    from demoplan.pipeline.execution.execute import MONITORS

    for name in monitors:
        if name not in MONITORS:
            raise UnknownNameError("monitor", name, MONITORS)
    if robot not in ROBOTS:
        raise UnknownNameError("robot", robot, ROBOTS)
    return tuple(monitors)


def execute(
    domain: Annotated[
        str, typer.Option("--domain", "-d", help="Domain: id, start of an id, or name (then the latest).")
    ],
    goal: Annotated[str, typer.Option("--goal", "-g", help='"onTop(cube_red, cube_blue) & …", or PDDL.')],
    scene: Annotated[
        Path | None,
        typer.Option("--scene", metavar="FILE", help="Scene; without one, four cubes at random places."),
    ] = None,
    state: Annotated[
        str | None,
        typer.Option("--state", "-s", help="Scene of an episode: EPISODE@start, @end or @SECONDS."),
    ] = None,
    robot: RobotOption = "gripper",
    seed: Annotated[int, typer.Option(min=0, help="Seed of scene, sensors and faults.")] = 0,
    monitor: MonitorOption = None,
    faults: Annotated[
        Path | None, typer.Option("--faults", metavar="FILE", help="Faults file, for --fault.")
    ] = None,
    fault: Annotated[str | None, typer.Option("--fault", help="Which of them happens.")] = None,
    view: Annotated[
        Path | None, typer.Option("--view", metavar="FILE.rrd", help="Save a recording of the run.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="FILE.png", help="Draw how it ended.")
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option("--video", metavar="FILE.gif", help="Draw the run, four times as fast; .gif or .webp."),
    ] = None,
    skills: SkillsOption = None,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Plan, and let a simulated robot do it, watched and replanned. Exit code 1 if the goal is missed."""
    from demoplan.engines.mujoco.scene_spec import read_scene
    from demoplan.engines.mujoco.skills import read_skills
    from demoplan.errors import DemoplanError
    from demoplan.manifests.faults import read_faults
    from demoplan.manifests.goals import GoalCase
    from demoplan.pipeline.domains.learning import stored_domain
    from demoplan.pipeline.execution.evaluate import scene_of
    from demoplan.pipeline.execution.execute import ExecuteParams
    from demoplan.pipeline.execution.run_jobs import RunJob, carry_out, not_started
    from demoplan.pipeline.execution.scenes import scene_of_state

    monitors = _checked(monitor or ("full",), robot)
    if len(monitors) != 1:
        raise UsageError(f"execute takes one --monitor; given: {', '.join(monitors)}")
    opened = existing_store(store)
    learned = stored_domain(opened, domain)
    vocabulary = _vocabulary(opened, learned.version.dataset)
    known = {each.name: each for each in (read_faults(faults) if faults else ())}
    if fault is not None and fault not in known:
        raise UnknownNameError("fault", fault, known, str(faults or "no --faults file"))
    if scene is not None and state is not None:
        raise UsageError("give --scene or --state: a scene comes from one of them")
    case = GoalCase(name="goal", goal=goal)
    spec = scene_of_state(opened, state) if state else read_scene(scene) if scene else scene_of(case, seed)
    job = RunJob(
        store=opened.location,
        domain_text=learned.text,
        domain_name=learned.version.name,
        goal=case,
        robot=robot,
        seed=seed,
        fault=known[fault] if fault is not None else None,
        vocabulary=vocabulary,
        params=ExecuteParams(monitor=monitors[0], skills=read_skills(skills)),
        scene=spec,
    )
    film = _film(picture, video)
    try:
        done = carry_out(job, film)
    except DemoplanError as error:
        if as_json:
            print_json({"run": not_started(job, str(error)).row(0, named=True), "steps": []})
        raise
    row = done.run.row(0, named=True) | {"goal": goal}
    if as_json:
        print_json({"run": row, "steps": done.steps})
    else:
        print_table(
            "steps",
            ["plan", "step", "state", "from [s]", "to [s]", "what was wrong"],
            [
                (
                    each["plan_index"],
                    f"{each['operator']}({', '.join(each['arguments'])})",
                    each["state"],
                    "" if each["start_ns"] is None else f"{each['start_ns'] / 1e9:.2f}",
                    "" if each["end_ns"] is None else f"{each['end_ns'] / 1e9:.2f}",
                    "" if each["failure"] is None else f"{each['failure']}: {each['cause']}",
                )
                for each in done.steps.iter_rows(named=True)
            ],
        )
        stdout.print(
            f"{row['outcome']}; by physics the goal is {'' if row['is_goal_reached'] else 'not '}reached; "
            f"{row['simulated_s']:.1f} simulated seconds, {row['n_steps']} steps, {row['n_plans']} plans",
            markup=False,
        )
    if row["reason"]:
        say(row["reason"])
    if view is not None:
        from demoplan.pipeline.execution.run_views import record_run

        record_run(done.run, done.steps, done.frames, spec, vocabulary, view, goal=goal)
        say(f"recording written to {view}")
    if film is not None:
        _draw(film, picture, video)
    raise typer.Exit(int(Exit.FINE if row["is_goal_reached"] else Exit.FAILED))


def _film(picture: Path | None, video: Path | None) -> "Film | None":
    """What a run is to be kept on, if it is to be drawn; refused before it begins if it could not be."""
    if picture is None and video is None:
        return None
    from demoplan.engines.mujoco.drawing import require_drawing
    from demoplan.engines.mujoco.filming import Film

    require_drawing(picture, video, _backend())
    return Film()


def _draw(film: "Film", picture: Path | None, video: Path | None) -> None:
    from demoplan.engines.mujoco.drawing import PICTURE, VIDEO, save_picture, save_video

    if picture is not None:
        save_picture(film, picture, params=replace(PICTURE, backend=_backend()))
        say(f"picture written to {picture}")
    if video is not None:
        save_video(film, video, params=replace(VIDEO, backend=_backend()))
        say(f"video written to {video}")


def _backend() -> str:
    """What draws. With MuJoCo's own variable, MuJoCo does not start where OSMesa is missing."""
    return os.environ.get("DEMOPLAN_GL", "egl").lower()


def evaluate(
    domains: Annotated[
        list[str], typer.Argument(help="Domains: ids, names, or patterns as 'cube-stacking*'.")
    ],
    goals: Annotated[Path, typer.Option("--goals", metavar="FILE", help="Goals file.")],
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="How many seeds.")] = 10,
    first_seed: Annotated[int, typer.Option(min=0, help="The first of them.")] = 0,
    robot: RobotOption = "gripper",
    faults: Annotated[
        Path | None, typer.Option("--faults", metavar="FILE", help="Faults file: each, and none.")
    ] = None,
    monitor: MonitorOption = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE.html", help="Where the report goes.")
    ] = None,
    views: Annotated[
        Path | None, typer.Option("--views", metavar="DIR", help="Save a recording of every run.")
    ] = None,
    skills: SkillsOption = None,
    store: StoreOption = DEFAULT_STORE,
    workers: WorkersOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Execute every domain × goal × seed × fault × monitor; what was run before is not run again."""
    from demoplan.pipeline.execution.simulate import Batch, simulate
    from demoplan.stages.score_runs import fault_confusion, score_runs

    batch = Batch(
        domains=tuple(domains),
        goals=goals,
        seeds=range(first_seed, first_seed + seeds),
        robot=robot,
        faults=faults,
        monitors=_checked(monitor or ("full",), robot),
        skills=skills,
        is_recorded=views is not None,
    )
    opened = existing_store(store)
    simulated = simulate(opened, batch, n_workers=workers_of(workers), progress=progress)
    result = simulated.evaluation
    scores = score_runs(result.runs)
    if as_json:
        print_json({"runs": result.runs, "scores": scores, "classes": fault_confusion(result.runs)})
    else:
        print_frame(
            "scores",
            scores.select("method", "metric", "subject", "value", "low", "high", "detail"),
            limit=1000,
        )
        if faults is not None:
            print_frame("classes of faults", fault_confusion(result.runs), limit=1000)
        for (outcome,), part in result.runs.group_by("outcome", maintain_order=True):
            say(f"{outcome}: {part.height} runs")
    if report is not None:
        from demoplan.pipeline.execution.run_views import execution_report
        from demoplan.store.atomic import write_bytes

        write_bytes(report, execution_report(result, title=f"{robot}: {goals.stem}").encode())
        say(f"report: {report}")
    if views is not None:
        from demoplan.pipeline.execution.run_views import record_runs

        record_runs(opened, result, simulated.vocabulary, views)
        say(f"recordings written to {views}")


def serve_goals(
    domain: Annotated[str, typer.Option("--domain", "-d", help="Domain: id, start of an id, or name.")],
    scene: Annotated[
        Path | None,
        typer.Option("--scene", metavar="FILE", help="Scene; without one, four cubes at random places."),
    ] = None,
    robot: RobotOption = "gripper",
    seed: Annotated[int, typer.Option(min=0, help="Seed of scene and sensors.")] = 0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on loopback; 0 takes a free one.")] = 9090,
    skills: SkillsOption = None,
    store: StoreOption = DEFAULT_STORE,
) -> None:
    """Offer /demoplan/plan_goal and /demoplan/execute_goal to rosbridge clients, on loopback only."""
    from demoplan.engines.mujoco.skills import read_skills
    from demoplan.engines.rosbridge import serve
    from demoplan.pipeline.domains.learning import stored_domain
    from demoplan.pipeline.execution.execute import ExecuteParams
    from demoplan.pipeline.execution.goal_service import GoalService

    _checked((), robot)
    opened = existing_store(store)
    learned = stored_domain(opened, domain)
    vocabulary = _vocabulary(opened, learned.version.dataset)
    service = GoalService(
        learned.domain,
        vocabulary,
        scene=scene,
        robot=robot,
        seed=seed,
        params=ExecuteParams(skills=read_skills(skills)),
    )
    serve(
        service.services(),
        port=port,
        on_ready=lambda actual: say(f"rosbridge v2 on ws://127.0.0.1:{actual}; Ctrl-C ends it"),
    )
