"""Commands that plan and that train segmenters: plan, segmenter."""

import os
from pathlib import Path
from typing import Annotated

import typer

from demoplan.cli.options import (
    DEFAULT_STORE,
    JsonOption,
    RootOption,
    StoreOption,
    WorkersOption,
    existing_store,
    workers_of,
)
from demoplan.cli.output import Exit, print_frame, print_json, progress, say, stdout
from demoplan.store import Store
from demoplan.store.atomic import write_bytes

segmenters = typer.Typer(no_args_is_help=True, help="Segmenters: train, score.")


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(plan)
    app.command("learn-traces")(learn_traces)
    app.add_typer(segmenters, name="segmenter")


def plan(
    domain: Annotated[
        str, typer.Option("--domain", "-d", help="Domain: id, start of an id, or name (then the latest).")
    ],
    state: Annotated[
        str,
        typer.Option(
            "--state", "-s", help="Where to start: EPISODE@start, EPISODE@end, EPISODE@SECONDS, or a file."
        ),
    ],
    goal: Annotated[
        str,
        typer.Option("--goal", "-g", help='"onTop(cube_red, cube_blue) & …", or PDDL: "(and (on_top …))".'),
    ],
    most_frequent: Annotated[
        bool,
        typer.Option(
            "--most-frequent", help="Plan with the operators shown most often; widen if there is no plan."
        ),
    ] = False,
    robot: Annotated[
        str | None,
        typer.Option("--robot", help="Also say whether this robot gets everywhere: gripper, tiago, …"),
    ] = None,
    time_limit: Annotated[float, typer.Option(min=0.1, help="Wall-clock time for everything [s].")] = 30.0,
    memory_limit: Annotated[int, typer.Option(min=64, help="Memory of each planner [MiB].")] = 2048,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the plan, one step a line, to a file.")
    ] = None,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Plan from a state to a goal; without a plan, say what is missing. Exit code 1 if there is no plan."""
    from demoplan.engines.fast_downward import SolveParams
    from demoplan.pipeline.domains.learning import exclusive_groups_of, stored_domain
    from demoplan.pipeline.domains.planning import make_plan, problem_of, start_of

    opened = existing_store(store)
    learned = stored_domain(opened, domain)
    start = start_of(state, opened, learned.domain)
    if robot is not None:
        from demoplan.pipeline.execution.reaching import open_for, reach_of_plan, with_hands_of
        from demoplan.pipeline.execution.scenes import scene_of_state

        session = open_for(scene_of_state(opened, state), robot)
        start = with_hands_of(start, session, learned.domain)
    problem = problem_of(learned.domain, start, goal)
    params = SolveParams(wall_s=time_limit, memory_bytes=memory_limit * 2**20)
    answer = make_plan(
        learned.domain,
        problem,
        params,
        is_widening=most_frequent,
        groups=exclusive_groups_of(learned),
    )
    out_of_reach = None
    if robot is not None and answer.plan is not None:
        out_of_reach = reach_of_plan(answer.plan, learned.domain, session)
    if as_json:
        print_json(
            {
                "attempts": answer.rows,
                "missing": answer.missing,
                "impossible": answer.impossibility,
                "out_of_reach": out_of_reach,
            }
        )
    elif answer.plan is not None:
        for number, step in enumerate(answer.plan.steps, 1):
            stdout.print(f"{number:3}  {step}", markup=False)
        say(f"cost {answer.plan.cost}, {len(answer.plan.steps)} steps; checked by simulating it")
    for attempt in answer.rows.iter_rows(named=True):
        if attempt["outcome"] != "solved":
            say(f"attempt {attempt['attempt'] + 1}: {attempt['outcome']}: {attempt['message']}")
    if answer.impossibility is not None:
        say(f"the plan could not happen in any world: {answer.impossibility}")
    if out_of_reach is not None:
        say(f"{robot} cannot carry it out: {out_of_reach}")
    if answer.missing:
        say(answer.missing)
    if answer.plan is not None and output is not None:
        text = "".join(f"{step}\n" for step in answer.plan.steps)
        write_bytes(output, text.encode())
    is_fine = answer.plan is not None and out_of_reach is None
    raise typer.Exit(int(Exit.FINE if is_fine else Exit.FAILED))


def learn_traces(
    case: Annotated[Path, typer.Argument(help="Folder with domain.pddl, trajectories/, problems/.")],
    output: Annotated[Path, typer.Argument(help="PDDL file to write.")],
    as_json: JsonOption = False,
) -> None:
    """Learn a domain from symbolic traces, noisy or not. Exit code 3 if something had to be left out.

    ``--json`` gives every literal considered, with its probability and counts, and how often atoms were
    misread, as estimated.
    """
    from demoplan.pipeline.domains.learn_traces import learn_traces as learn

    report = learn(case, output)
    if as_json:
        print_json(
            {
                "n_traces": report.n_traces,
                "n_transitions": report.n_transitions,
                "unseen_actions": list(report.unseen_actions),
                "faults": [str(fault) for fault in report.faults],
                "flip_rate": report.denoised.flip_rate,
                "flip_rates": {
                    predicate: {"missed": missed, "imagined": imagined}
                    for predicate, (missed, imagined) in report.denoised.flip_rates.items()
                },
                "is_settled": report.denoised.is_settled,
                "literals": report.denoised.literals.to_dicts(),
            }
        )
    for fault in report.faults:
        say(str(fault))
    misread = f"{report.denoised.flip_rate:.1%} of the atoms misread"
    say(
        f"{report.n_traces} traces, {report.n_transitions} transitions, {misread}; domain written to {output}"
    )
    raise typer.Exit(report.exit_code)


MethodOption = Annotated[
    str, typer.Option("--method", "-m", help="decision_tree, distilled_tree, random_forest, extra_trees, …")
]


@segmenters.command("train")
def train(
    dataset: Annotated[Path, typer.Argument(help="Dataset with labels.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Where to write the segmenter (JSON).")],
    method: MethodOption = "decision_tree",
    split: Annotated[
        str | None, typer.Option("--split", help="Only the episodes of this split of the dataset.")
    ] = None,
    store: StoreOption = DEFAULT_STORE,
    root: RootOption = None,
    workers: WorkersOption = 0,
) -> None:
    """Fit a segmenter to all labelled episodes of a dataset; it is data, and names what it was trained on."""
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.episodes.activities import train_on

    opened = open_dataset(dataset, root=root, environment=os.environ)
    chosen, text = train_on(
        opened, Store(store), method=method, split=split, n_workers=workers_of(workers), progress=progress
    )
    write_bytes(output, text.encode())
    say(f"segmenter {chosen.content[:16]} ({method}) written to {output}")


@segmenters.command("score")
def score(
    dataset: Annotated[Path, typer.Argument(help="Dataset with labels.")],
    method: Annotated[
        list[str] | None,
        typer.Option("--method", "-m", help="Method or segmenter's file; may be repeated."),
    ] = None,
    store: StoreOption = DEFAULT_STORE,
    root: RootOption = None,
    workers: WorkersOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Score segmenters, each participant (or take, if there is one participant) by what never saw it."""
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.episodes.activities import score_methods

    opened = open_dataset(dataset, root=root, environment=os.environ)
    scores, confusions = score_methods(
        opened,
        Store(store),
        methods=tuple(method or ("published_rules", "rules", "decision_tree", "extra_trees")),
        n_workers=workers_of(workers),
        progress=progress,
    )
    if as_json:
        print_json({"scores": scores, "confusions": confusions})
        return
    overall = scores.filter(scores["subject"] == "all").drop("suite", "subject", "detail")
    print_frame("each group left out of training in turn", overall, limit=1000)
    shown = confusions.filter(confusions["subject"] == "all").drop("subject")
    print_frame("what was taken for what", shown, limit=1000)
