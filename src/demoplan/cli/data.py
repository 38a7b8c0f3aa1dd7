"""Commands about data: record, ingest, doctor, tables."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import polars as pl
import typer

from demoplan.cli import definitions
from demoplan.cli.options import (
    DEFAULT_STORE,
    JsonOption,
    RootOption,
    StoreOption,
    WorkersOption,
    existing_store,
    workers_of,
)
from demoplan.cli.output import Exit, print_frame, print_json, print_table, progress, say, warn
from demoplan.errors import UnknownNameError, UsageError
from demoplan.store import EpisodeState, Store
from demoplan.tables import Activities, Episodes, Facts, Frames, Samples, Topics, Transitions

if TYPE_CHECKING:
    from demoplan.pipeline.datasets import OpenDataset

EPISODE_TABLES = {
    "episodes": Episodes,
    "topics": Topics,
    "samples": Samples,
    "frames": Frames,
    "facts": Facts,
    "labels": Activities,
    "activities": Activities,
    "transitions": Transitions,
}


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(ingest)
    app.command()(doctor)
    app.command()(tables)
    app.command()(record)
    app.command()(schemas)


def show_states(states: list[EpisodeState], *, as_json: bool) -> Exit:
    """Print what became of each episode; data that was lost or set aside gives its exit code."""
    lost = [state for state in states if state.status != "complete"]
    if as_json:
        print_json([{"episode_id": s.episode_id, "status": s.status, "reason": s.reason} for s in states])
    for state in lost:
        warn(f"{state.episode_id} is {state.status}: {state.reason}")
    return Exit.DATA_LOSS if lost else Exit.FINE


def ingest(
    dataset: Annotated[Path, typer.Argument(help="Folder with dataset.yaml, or the file.")],
    store: StoreOption = DEFAULT_STORE,
    root: RootOption = None,
    workers: WorkersOption = 0,
    pattern: Annotated[
        str | None,
        typer.Option(
            "--take-up",
            metavar="PATTERN",
            help="Take up logs that arrived: a regular expression over their names with the groups "
            "participant and task, as '(?P<participant>p\\d+)-(?P<task>.+)'.",
        ),
    ] = None,
    bucket: Annotated[
        str | None,
        typer.Option("--bucket", metavar="URL", help="First fetch logs from s3://BUCKET/PREFIX, each once."),
    ] = None,
    quiet_s: Annotated[
        float, typer.Option("--quiet", min=0.0, help="Leave logs that changed less than this ago [s].")
    ] = 30.0,
    as_json: JsonOption = False,
) -> None:
    """Read, align and perceive every episode of a dataset into the store."""
    from demoplan.pipeline.crews import Processes
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.episodes.ingest import ingest_dataset

    opened = open_dataset(dataset, root=root, environment=os.environ)
    if bucket is not None:
        _fetch(bucket, opened.root, quiet_s)
    if pattern is not None:
        _take_up(dataset, opened, pattern, quiet_s)
        opened = open_dataset(dataset, root=root, environment=os.environ)
    here = Store(store)
    states = ingest_dataset(opened, here, crew=Processes(workers_of(workers)), progress=progress)
    here.snapshots.take(here.manifest.episodes(), f"ingest {opened.dataset.name}")
    if not as_json:
        print_table(
            f"{opened.dataset.name}: {len(states)} episodes",
            ["episode", "status", "tables"],
            [(s.episode_id, s.status, ", ".join(sorted(s.tables))) for s in states],
        )
    raise typer.Exit(int(show_states(states, as_json=as_json)))


def _fetch(bucket: str, root: Path, quiet_s: float) -> None:
    """Bring new logs of a bucket; say what was left there."""
    from demoplan.pipeline.episodes.fetching import Fetched, fetch_logs
    from demoplan.store.opening import open_place

    def tell(log: Fetched) -> None:
        if log.refusal:
            warn(f"{bucket}/{log.file} is left alone: {log.refusal}")
        else:
            say(f"{log.file}: {log.n_bytes} bytes fetched")

    fetch_logs(open_place(bucket), root, quiet_s=quiet_s, on_done=tell)


def _take_up(dataset: Path, opened: "OpenDataset", pattern: str, quiet_s: float) -> None:
    """Write logs that have arrived into the dataset's manifest; say which were left."""
    from demoplan.pipeline.episodes.arrivals import ArrivalParams, enrol, find_arrivals

    arrivals = find_arrivals(opened, ArrivalParams(pattern=pattern, quiet_s=quiet_s))
    for arrival in arrivals:
        if arrival.refusal:
            warn(f"{arrival.file} is left alone: {arrival.refusal}")
    say(f"{enrol(dataset, arrivals)} new episodes in {dataset}")


def tables(
    name: Annotated[
        str | None, typer.Argument(help="Which table, or `definitions`; without it, what there is.")
    ] = None,
    episode: Annotated[str | None, typer.Option("--episode", "-e", help="One episode only.")] = None,
    dataset: Annotated[str | None, typer.Option("--dataset", "-d", help="One dataset only.")] = None,
    where: Annotated[
        str | None, typer.Option("--where", help="SQL condition on the rows: \"activity = 'Reach'\".")
    ] = None,
    limit: Annotated[int, typer.Option("--limit", min=1, help="Rows to show.")] = 20,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the rows to a .parquet or .csv file.")
    ] = None,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """List the stored tables, or show the rows of one; `definitions` lists what predicates are made of."""
    if name == definitions.NAME:
        definitions.show_definitions(as_json=as_json)
        return
    opened = existing_store(store)
    states = [opened.manifest.episode(episode)] if episode else opened.manifest.episodes(dataset)
    if name is None:
        rows = [
            {"dataset": s.dataset, "episode_id": s.episode_id, "table": table, "content": content}
            for s in states
            for table, content in sorted(s.tables.items())
        ]
        if as_json:
            print_json(rows)
        else:
            listed = pl.DataFrame(rows, schema=["dataset", "episode_id", "table", "content"], orient="row")
            print_frame("tables", listed, limit=10_000)
        return
    if name not in EPISODE_TABLES:
        raise UnknownNameError("table", name, EPISODE_TABLES)
    parts = [opened.get(state.tables[name], EPISODE_TABLES[name]) for state in states if name in state.tables]
    whole: pl.DataFrame = pl.concat(parts) if parts else EPISODE_TABLES[name].create_empty()
    if where is not None:
        try:
            whole = pl.SQLContext({name: whole}).execute(f"SELECT * FROM {name} WHERE {where}", eager=True)
        except pl.exceptions.PolarsError as error:
            raise UsageError(f"--where {where!r}: {error}; columns: {', '.join(whole.columns)}") from None
    if output is not None:
        _write(whole, output)
        say(f"{whole.height} rows written to {output}")
    elif as_json:
        print_json(whole)
    else:
        print_frame(name, whole, limit=limit)


def _write(table: pl.DataFrame, output: Path) -> None:
    if output.suffix == ".parquet":
        table.write_parquet(output)
    elif output.suffix == ".csv":
        flat = [
            pl.col(column).list.join(" ") if dtype == pl.List(pl.String) else pl.col(column)
            for column, dtype in table.schema.items()
            if not isinstance(dtype, pl.Array) and dtype not in (pl.List(pl.Struct),)
        ]
        table.select(flat).write_csv(output)
    else:
        raise UsageError(f"{output}: unknown kind of file {output.suffix!r}; known: .parquet, .csv")


def doctor(
    log: Annotated[Path | None, typer.Argument(help="A log: .mcap, .bag, .db3, or a rosbag2 folder.")] = None,
    dataset: Annotated[
        Path | None, typer.Option("--dataset", "-d", help="Check it against this dataset's mapping too.")
    ] = None,
    environment: Annotated[
        bool,
        typer.Option("--environment", help="Say what of this machine stands in the way: planner, drawing, …"),
    ] = False,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Say what is in a log, and what is wrong with it; or, with --environment, what is wrong here."""
    if environment == (log is not None):
        raise UsageError("doctor looks at a log or at the machine: give LOG, or --environment")
    if log is None:
        raise typer.Exit(int(_examine(store, as_json=as_json)))
    from demoplan.cli.log_report import exit_code_of, show_log_report
    from demoplan.logs import inspect
    from demoplan.manifests.dataset import parse_dataset
    from demoplan.pipeline.datasets import read_manifest

    mapping, folder = None, None
    if dataset is not None:
        manifest, text = read_manifest(dataset)
        mapping, folder = parse_dataset(text, manifest).mapping, manifest.parent
    report = inspect(log, mapping, definitions_root=folder)
    if as_json:
        print_json(report.as_json())
    else:
        show_log_report(report)
    raise typer.Exit(int(exit_code_of(report)))


def _examine(store: str, *, as_json: bool) -> Exit:
    """Print what of this machine stands in the way."""
    from dataclasses import asdict

    from demoplan.pipeline.environment import CHECKS, Machine
    from demoplan.pipeline.environment import examine as examine_all

    with progress("examine", len(CHECKS)) as done:
        findings = examine_all(Machine(environment=os.environ, store=store), done)
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        print_table(
            "this machine",
            ["part", "", "finding", "remedy"],
            [(f.subject, f.severity, f.sentence, f.remedy) for f in findings],
        )
    return Exit.FAILED if any(f.severity == "error" for f in findings) else Exit.FINE


def record(
    folder: Annotated[Path, typer.Argument(help="Folder to write the dataset to.")],
    participants: Annotated[int, typer.Option("--participants", "-p", min=1, help="How many people.")] = 3,
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="Task; may be repeated. Default: the study's four."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of people, layouts and noise.")] = 0,
    log_format: Annotated[
        list[str] | None,
        typer.Option("--format", "-f", help="mcap, rosbag2, rosbag1; may be repeated, people take turns."),
    ] = None,
    name: Annotated[str | None, typer.Option("--name", help="Name of the dataset.")] = None,
    vocabulary: Annotated[
        Path | None,
        typer.Option("--vocabulary", help="Vocabulary file; default: the checkout's tabletop.yaml."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the dataset that the folder holds.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Record demonstrations by simulated people in a physics scene: logs, true labels and dataset.yaml."""
    from demoplan.engines.mujoco.tasks import STUDY_TASKS
    from demoplan.logs.writing import LOG_FORMATS
    from demoplan.pipeline import record as recording

    for asked in log_format or ():
        if asked not in LOG_FORMATS:
            raise UnknownNameError("log format", asked, LOG_FORMATS)
    formats: tuple[Any, ...] = tuple(log_format or LOG_FORMATS)
    tasks = tuple(task or STUDY_TASKS)
    with progress("record", participants * len(tasks)) as done:
        rows = recording.record(
            folder,
            participants=participants,
            tasks=tasks,
            seed=seed,
            formats=formats,
            name=name,
            vocabulary=vocabulary,
            is_overwriting=overwrite,
            on_episode=done,
        )
    if as_json:
        print_json(rows)
    else:
        print_frame(f"recorded into {folder}", rows.drop("sha256"), limit=1000)


def schemas(
    folder: Annotated[Path, typer.Argument(help="Folder to write to.")] = Path("schemas"),
) -> None:
    """Write the published contracts: every table, and the JSON Schemas of dataset and vocabulary files."""
    from demoplan.pipeline.contracts import write_contracts

    for path in write_contracts(folder):
        say(str(path))
