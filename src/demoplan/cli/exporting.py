"""Commands that give data away: export."""

from pathlib import Path
from typing import Annotated

import typer

from demoplan.cli.options import DEFAULT_STORE, JsonOption, StoreOption, existing_store
from demoplan.cli.output import Exit, print_json, print_table, progress, say, warn
from demoplan.errors import UnknownNameError

exports = typer.Typer(no_args_is_help=True, help="Datasets in forms that others read: lerobot.")


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(exports, name="export")


@exports.command()
def lerobot(
    dataset: Annotated[str, typer.Argument(help="Dataset in the store, or its folder with dataset.yaml.")],
    output: Annotated[Path, typer.Argument(help="Folder to write.")],
    fps: Annotated[
        int | None, typer.Option(min=1, help="Frames per second; default: the dataset's tick rate.")
    ] = None,
    hold_out: Annotated[
        list[str] | None,
        typer.Option(
            "--hold-out",
            metavar="PARTICIPANT",
            help="Split 'test'; may be repeated. Default: the manifest's splits, else the last participant.",
        ),
    ] = None,
    train_on: Annotated[
        str | None,
        typer.Option(metavar="SPLIT", help="Split of the manifest that is 'train'; the rest is 'test'."),
    ] = None,
    activities: Annotated[
        str, typer.Option(help="Which become subtasks: inferred, or true (the labels).")
    ] = "inferred",
    language: Annotated[
        bool,
        typer.Option("--language", help="Subtasks as language rows too: read by lerobot 0.6 and later only."),
    ] = False,
    allow_unlicensed: Annotated[
        bool, typer.Option("--allow-unlicensed", help="Export data that names no licence to pass it on.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the LeRobot dataset that is there.")
    ] = False,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Write a LeRobot v3.0 dataset: poses, activities as subtasks, success, splits, and a dataset card."""
    from demoplan.pipeline.exporting import ACTIVITIES, export_lerobot, left_out

    if activities not in ACTIVITIES:
        raise UnknownNameError("kind of activities", activities, ACTIVITIES)
    opened = existing_store(store)
    name = _name_of(dataset)
    lost = left_out(opened, name)
    with progress("export", len(opened.manifest.episodes(name)) - len(lost)) as done:
        written = export_lerobot(
            opened,
            name,
            output,
            fps=fps,
            held_out=tuple(hold_out or ()),
            trained_on=train_on,
            activities=activities,
            has_language=language,
            is_unlicensed_allowed=allow_unlicensed,
            is_overwriting=overwrite,
            on_episode=done,
        )
    if as_json:
        print_json(
            {
                "path": written.path,
                "n_episodes": written.n_episodes,
                "n_frames": written.n_frames,
                "n_subtasks": written.n_subtasks,
                "splits": written.splits,
                "left_out": [{"episode_id": s.episode_id, "reason": s.reason} for s in lost],
            }
        )
    else:
        print_table(
            "exported",
            ["dataset", "episodes", "frames", "subtasks", "splits"],
            [
                (
                    written.path,
                    written.n_episodes,
                    written.n_frames,
                    written.n_subtasks,
                    ", ".join(f"{split} {span}" for split, span in written.splits.items()),
                )
            ],
        )
        say(f"dataset card: {written.path / 'README.md'}; read it before you pass the dataset on")
    if allow_unlicensed:
        warn("this export names no licence: do not pass it on")
    for state in lost:
        warn(f"{state.episode_id} is left out: {state.reason or 'never ingested'}")
    raise typer.Exit(int(Exit.DATA_LOSS if lost else Exit.FINE))


def _name_of(dataset: str) -> str:
    """The dataset's name, from its manifest if a folder or a manifest is given."""
    from demoplan.manifests.dataset import parse_dataset
    from demoplan.pipeline.datasets import read_manifest

    if not Path(dataset).exists():
        return dataset
    manifest, text = read_manifest(Path(dataset))
    return parse_dataset(text, manifest).name
