"""Commands to look at things: view, catalog."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from demoplan.cli.options import DEFAULT_STORE, JsonOption, StoreOption, existing_store
from demoplan.cli.output import print_frame, print_json, print_table, say, stdout
from demoplan.errors import UnknownNameError, UsageError
from demoplan.store import Store

if TYPE_CHECKING:
    from demoplan.viewers.sources import EpisodeViewParams


_TOLD = ("folder", "id", "success", "goal", "participant", "task", "robot", "fault", "outcome")
"""Properties that a list for people shows, where any recording has them."""


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(view)
    app.command()(catalog)


def view(
    name: Annotated[str, typer.Argument(help="Episode id, DATASET/EPISODE, or the start of a run's id.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.rrd", help="Save it; open nothing.")
    ] = None,
    layers: Annotated[
        str,
        typer.Option(help="Parts to show: raw, activities, predicates, execution, explanation; by commas."),
    ] = "all",
    at: Annotated[
        float | None,
        typer.Option(
            min=0.0, metavar="SECONDS", help="Where the picture's time cursor stands; default: the middle."
        ),
    ] = None,
    png: Annotated[
        Path | None,
        typer.Option("--png", metavar="FILE.png", help="Draw it into a picture; needs no screen."),
    ] = None,
    url: Annotated[
        str | None, typer.Option("--connect", metavar="URL", help="Send it to a viewer that is running.")
    ] = None,
    store: StoreOption = DEFAULT_STORE,
) -> None:
    """Look at an episode or an execution in rerun: what was seen, done, true, planned, and why."""
    from demoplan.viewers.episode import open_episode, render_episode_png
    from demoplan.viewers.sources import LAYERS, EpisodeViewParams

    chosen = LAYERS if layers == "all" else tuple(filter(None, (part.strip() for part in layers.split(","))))
    for layer in chosen:
        if layer not in LAYERS:
            raise UnknownNameError("layer", layer, LAYERS)
    if not chosen:
        raise UsageError(f"--layers names none; available: {', '.join(LAYERS)}, or all")
    opened = existing_store(store)
    path, duration_ns = _record(opened, name, output, EpisodeViewParams(layers=chosen))
    say(f"recording written to {path}")
    if png is not None:
        render_episode_png(path, png, at_ns=round(at * 1e9) if at is not None else duration_ns // 2)
        say(f"picture written to {png}")
    elif output is None:
        open_episode(path, url=url)


def _record(store: Store, name: str, output: Path | None, params: "EpisodeViewParams") -> tuple[Path, int]:
    """Write the recording of whatever has that name; gives its path and how long it lasts [ns]."""
    from demoplan.pipeline.datasets import recall
    from demoplan.pipeline.domains.learning import latest_evidence
    from demoplan.pipeline.viewing import record_stored_run, record_view, stored_run
    from demoplan.tables import Episodes

    folder = store.place.path("recordings") or Path(DEFAULT_STORE, "recordings")
    try:
        state = store.manifest.episode(name)
    except UnknownNameError as error:
        try:
            found = stored_run(store, name)
        except UnknownNameError as other:
            raise _neither(name, error, other) from None
        if found.frames is None:
            say("its poses were not kept: `demoplan evaluate --views DIR` keeps them; steps are shown alone")
        path = output or folder / found.dataset / "executions" / f"{found.run_id}.rrd"
        record_stored_run(found, path, params)
        return path, round(found.run["simulated_s"][0] * 1e9)
    path = output or folder / state.dataset / f"{state.episode_id}.rrd"
    evidence = latest_evidence(store, state.dataset)
    record_view(store, recall(store, state.dataset), state, path, evidence, params)
    row = store.get(state.tables["episodes"], Episodes).row(0, named=True)
    return path, int(row["end_ns"] - row["start_ns"])


def _neither(name: str, episode: UnknownNameError, run: UnknownNameError) -> UnknownNameError:
    """The name is of no episode; it may be of several runs, or of none."""
    return run if any(known.startswith(name) for known in run.available) else episode


def catalog(
    folder: Annotated[Path, typer.Argument(help="Folder with recordings (.rrd); sub-folders count too.")],
    where: Annotated[
        str | None,
        typer.Option("--where", help="List the recordings for which this SQL condition holds, and end."),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 lets other machines in.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 takes a free one.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Serve a folder of recordings through rerun's catalog; --where "success = false" finds some of them."""
    from demoplan.viewers.catalog import has_client, matching, served, wait_for_end

    with served(folder, host=host, port=port) as catalogue:
        if where is not None:
            rows = matching(catalogue, where)
            if as_json:
                print_json(rows)
            else:
                told = [name for name in _TOLD if name in rows.columns and rows[name].count()]
                print_frame(f"{rows.height} recordings where {where}", rows.select(told), limit=1000)
                say("--json gives every property, and the address of each recording")
            return
        if as_json:
            print_json(
                {
                    "url": catalogue.url,
                    "datasets": [
                        {"name": dataset, "url": catalogue.url, "n_recordings": n}
                        for dataset, n in catalogue.n_recordings.items()
                    ],
                }
            )
        else:
            print_table(catalogue.url, ["dataset", "recordings"], list(catalogue.n_recordings.items()))
            stdout.print(f"open it with: rerun {catalogue.url}", markup=False)
        stdout.file.flush()
        say("serving; Ctrl-C ends it")
        if not has_client():
            say("recordings that come later are not taken up: that needs the extra 'catalog'")

        def look() -> None:
            for path in catalogue.take_up() if has_client() else ():
                say(f"taken up: {path}")

        wait_for_end(look)
