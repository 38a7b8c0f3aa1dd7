"""The main job, and doing again what is stale of it: run, reprocess."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import polars as pl
import typer

from demoplan.cli.data import show_states
from demoplan.cli.options import (
    DEFAULT_STORE,
    JsonOption,
    RootOption,
    StoreOption,
    WorkersOption,
    existing_store,
    local_folder,
    workers_of,
)
from demoplan.cli.output import Exit, print_frame, print_json, print_table, progress, say, warn
from demoplan.store import Store

if TYPE_CHECKING:
    from demoplan.pipeline.datasets import OpenDataset
    from demoplan.pipeline.run import RunResult


HEADLINES = ("frame accuracy", "macro F1", "F1@50", "edit score")
"""What the terminal shows; the report and --json have the rest."""


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(run)
    app.command()(reprocess)


def run(
    dataset: Annotated[Path, typer.Argument(help="Folder with dataset.yaml, or the file.")],
    store: StoreOption = DEFAULT_STORE,
    root: RootOption = None,
    segmenter: Annotated[
        str,
        typer.Option(
            help="auto, rules, published_rules, decision_tree, distilled_tree, random_forest, extra_trees, "
            "gradient_boosting, or a file."
        ),
    ] = "auto",
    fresh: Annotated[
        int,
        typer.Option(min=0, metavar="N", help="Also record N new people, and try the same on them."),
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the new people.")] = 1,
    splits_types: Annotated[
        bool,
        typer.Option(
            "--split-types", help="Give objects that behave unlike others of their type one of their own."
        ),
    ] = False,
    workers: WorkersOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Logs to activities, domains, plans, scores and a report; what is up to date is skipped."""
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.run import run as run_all
    from demoplan.stages.learn import LearnParams

    opened = open_dataset(dataset, root=root, environment=os.environ)
    others = _recorded(store, opened, fresh, seed) if fresh else None
    result = run_all(
        opened,
        Store(store),
        segmenter=segmenter,
        n_workers=workers_of(workers),
        progress=progress,
        fresh=others,
        learning=LearnParams(splits_types=splits_types),
    )
    if as_json:
        print_json(_summary(result))
    else:
        _show(result)
    say(f"report: {result.report}")
    raise typer.Exit(int(max(show_states(list(result.states), as_json=False), Exit.FINE)))


_MOST_LISTED = 40
"""Stale stage runs that are listed one by one; ``--json`` gives all of them."""


def reprocess(
    where: Annotated[
        str | None,
        typer.Option(
            "--where",
            metavar="EXPR",
            help="Only episodes that fit: \"participant = 'p1' AND reason = 'code'\".",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only say what is stale, why, and what it would cost.")
    ] = False,
    store: StoreOption = DEFAULT_STORE,
    workers: WorkersOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Run again what is stale, and only that: input, parameters, code or table declarations changed."""
    from demoplan.pipeline.upkeep.reprocess import reprocess as run_again
    from demoplan.pipeline.upkeep.staleness import find_stale, selected, total_cost_s

    opened = existing_store(store)
    plan = find_stale(opened, os.environ)
    rows = selected(plan, where)
    cost_s, n_unknown = total_cost_s(rows)
    blocked = rows.filter(pl.col("reason") == "blocked")
    if not as_json:
        by = ["dataset", "stage", "reason"]
        counts = rows.group_by(by, maintain_order=True).agg(
            pl.len().alias("runs"),
            pl.col("cost_s").sum(),
            pl.col("detail").first().alias("the first of them"),
        )
        print_frame(f"{rows.height} stage runs are stale", counts, limit=1000)
        if 0 < rows.height <= _MOST_LISTED:
            listed = rows.select("episode_id", "domain", "stage", "reason", "detail", "cost_s")
            print_frame("they are", listed, limit=_MOST_LISTED)
    unknown = f", and {n_unknown} that never ran before" if n_unknown else ""
    say(f"at most {rows.height - blocked.height} stage runs, about {cost_s:.1f} s of work{unknown}")
    result = None
    if not dry_run and rows.height > blocked.height:
        result = run_again(opened, plan, rows, n_workers=workers_of(workers), progress=progress)
        for domain, changes in result.changes.items():
            say(f"{domain}: new version, {len(changes)} differences; `demoplan domain list` names it")
    if as_json:
        print_json(
            {
                "stale": rows,
                "cost_s": cost_s,
                "n_cost_unknown": n_unknown,
                "episodes": [s.episode_id for s in result.states] if result else [],
                "domains": [each.version.domain_id for each in result.learned] if result else [],
                "snapshot": result.snapshot_id if result else None,
            }
        )
    for row in blocked.iter_rows(named=True):
        warn(f"{row['dataset']} {row['episode_id'] or ''}: {row['detail']}")
    code = show_states(list(result.states), as_json=False) if result else Exit.FINE
    raise typer.Exit(int(Exit.DATA_LOSS if blocked.height and not dry_run else code))


def _recorded(store: str, opened: "OpenDataset", n_people: int, seed: int) -> "OpenDataset":
    """New people who do what the dataset's people did; recorded once for each number and seed."""
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.record import record

    name = f"fresh-{n_people}-seed-{seed}"
    folder = local_folder(Store(store), "fresh") / name
    if not (folder / "dataset.yaml").is_file():
        tasks = list(dict.fromkeys(episode.task for episode in opened.dataset.episodes))
        with progress(f"record {n_people} new people", n_people * len(tasks)) as done:
            record(
                folder,
                participants=[f"n{k + 1}" for k in range(n_people)],
                tasks=tasks,
                seed=seed,
                formats=("mcap",),
                name=name,
                on_episode=done,
            )
    return open_dataset(folder)


def _show(result: "RunResult") -> None:
    main = [
        score
        for score in result.scores.iter_rows(named=True)
        if score["subject"] == "all" and score["metric"] in HEADLINES
    ]
    print_table(
        "Activities against the truth",
        ["what", "method", "metric", "value", "95 % interval", "n"],
        [
            (s["suite"], s["method"], s["metric"], _figure(s["value"]), _interval(s), s["n"])
            for s in main
            if s["suite"].startswith("segmentation")
        ],
    )
    print_table(
        "Domains",
        ["learned from", "id", "operators", "transitions"],
        [
            (
                name,
                each.version.domain_id,
                len(each.domain.operators),
                each.operators["n_transitions"].sum(),
            )
            for name, each in result.learned.items()
        ],
    )
    plans = result.scores.filter(pl.col("suite") == "planning")
    print_table(
        "Plans",
        ["domains", "metric", "value", "95 % interval", "how many"],
        [
            (s["subject"], s["metric"], _figure(s["value"]), _interval(s), s["detail"])
            for s in plans.iter_rows(named=True)
        ],
    )
    failures = [each.trial for each in result.tried if each.trial.cause is not None]
    if failures:
        print_table(
            "Goals that were not reached",
            ["domain", "goal", "cause"],
            [(t.domain, t.goal, t.cause) for t in failures],
        )


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _interval(score: dict[str, object]) -> str:
    low, high = score["low"], score["high"]
    return f"{low:.3f} to {high:.3f}" if low is not None and high is not None else ""


def _summary(result: "RunResult") -> dict[str, object]:
    return {
        "episodes": [
            {"episode_id": s.episode_id, "dataset": s.dataset, "status": s.status, "reason": s.reason}
            for s in result.states
        ],
        "domains": [
            {
                "name": name,
                "domain_id": each.version.domain_id,
                "n_operators": len(each.domain.operators),
            }
            for name, each in result.learned.items()
        ],
        "scores": result.scores,
        "failures": [
            {"domain": t.trial.domain, "goal": t.trial.goal, "cause": t.trial.cause}
            for t in result.tried
            if t.trial.cause is not None
        ],
        "method": result.method,
        "report": str(result.report),
    }
