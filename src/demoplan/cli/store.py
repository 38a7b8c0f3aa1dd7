"""Commands about the store: its history, whether it is whole, and what may go."""

from collections import Counter
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Annotated

import typer

from demoplan.cli.options import DEFAULT_STORE, JsonOption, StoreOption, existing_store
from demoplan.cli.output import Exit, print_json, print_table, progress, say

stores = typer.Typer(no_args_is_help=True, help="The store: log, diff, verify, repair, compact, gc.")


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(stores, name="store")


@stores.command()
def log(store: StoreOption = DEFAULT_STORE, as_json: JsonOption = False) -> None:
    """List the snapshots of what stood, oldest first: id, when, and what was done."""
    history = existing_store(store).snapshots.log()
    if as_json:
        print_json([asdict(entry) for entry in history])
        return
    print_table(
        f"{len(history)} snapshots",
        ["id", "made", "by", "episodes", "lost"],
        [
            (
                entry.snapshot_id,
                datetime.fromtimestamp(entry.made_at_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
                entry.cause,
                entry.n_episodes,
                entry.n_lost or "",
            )
            for entry in history
        ],
    )


@stores.command()
def diff(
    old: Annotated[str, typer.Argument(help="Snapshot: id, or the start of it.")],
    new: Annotated[str | None, typer.Argument(help="Snapshot; without it, what the store holds now.")] = None,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Say which episodes changed between two snapshots, and which of their tables."""
    from demoplan.store.snapshots import difference

    opened = existing_store(store)
    before = opened.snapshots.get(opened.snapshots.find(old))
    after = opened.snapshots.get(opened.snapshots.find(new)) if new else opened.manifest.episodes()
    changes = difference(before, after)
    if as_json:
        print_json([asdict(change) for change in changes])
        return
    print_table(
        f"{len(changes)} episodes differ",
        ["dataset", "episode", "change", "status", "tables"],
        [(c.dataset, c.episode_id, c.kind, c.status, ", ".join(c.tables)) for c in changes],
    )


@stores.command()
def verify(store: StoreOption = DEFAULT_STORE, as_json: JsonOption = False) -> None:
    """Check every table, record, snapshot and domain against its hash. Exit code 1 if any is damaged."""
    from demoplan.store.verifying import CHECKED
    from demoplan.store.verifying import verify as verify_all

    with progress("verify", len(CHECKED)) as done:
        faults = verify_all(existing_store(store), done)
    if as_json:
        print_json([asdict(fault) for fault in faults])
    else:
        print_table(
            f"{len(faults)} faults",
            ["file", "fault", "detail"],
            [(fault.path, fault.kind, fault.detail) for fault in faults],
        )
    if any(not fault.is_harmless for fault in faults):
        say("`demoplan store repair` sets aside what is damaged, `demoplan reprocess` then makes it again")
        raise typer.Exit(int(Exit.FAILED))


@stores.command()
def repair(store: StoreOption = DEFAULT_STORE, as_json: JsonOption = False) -> None:
    """Move what is damaged into `damaged/`, remove what killed processes left; the rest stays."""
    from demoplan.store.verifying import CHECKED, verify
    from demoplan.store.verifying import repair as repair_all

    opened = existing_store(store)
    with progress("verify", len(CHECKED)) as done:
        faults = verify(opened, done)
    repairs = repair_all(opened, faults)
    if as_json:
        print_json([asdict(each) for each in repairs])
        return
    print_table(
        f"{len(repairs)} repairs",
        ["file", "what was done", "detail"],
        [(each.path, each.action, each.detail) for each in repairs],
    )


@stores.command()
def compact(store: StoreOption = DEFAULT_STORE, as_json: JsonOption = False) -> None:
    """Put small files into shards of about 100 MB for each table; `gc` then removes the small ones."""
    from demoplan.store.compacting import compact as compact_all

    opened = existing_store(store)
    before = opened.place.entries("")
    n_tables = len({name for state in opened.manifest.episodes() for name in state.tables})
    with progress("compact", n_tables + 1) as done:
        made = compact_all(opened, on_done=done)
    if as_json:
        print_json([asdict(each) for each in made])
        return
    print_table(
        f"{len(made)} shards",
        ["table", "parts", "MB", "shard"],
        [(each.table, each.n_parts, f"{each.n_bytes / 1e6:.3f}", each.shard) for each in made],
    )
    say(f"{len(before)} files before; `demoplan store gc` removes what is in shards now")


@stores.command()
def gc(
    grace: Annotated[
        float, typer.Option("--grace", min=0.0, metavar="HOURS", help="What is younger stays [h].")
    ] = 24.0,
    keep: Annotated[
        int | None,
        typer.Option(
            "--keep",
            min=1,
            metavar="N",
            help="Also forget all snapshots but the last N, and superseded results that only those name.",
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be removed.")] = False,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Remove tables that no record, manifest or snapshot names, and what killed processes left."""
    from demoplan.store.sweeping import sweep

    opened = existing_store(store)
    n_before = len(opened.place.names(""))
    swept = sweep(opened, grace_s=grace * 3600.0, n_snapshots=keep, is_dry_run=dry_run)
    if as_json:
        print_json([asdict(each) for each in swept])
    else:
        counts = Counter(each.kind for each in swept)
        sizes = {kind: sum(each.n_bytes for each in swept if each.kind == kind) for kind in counts}
        print_table(
            "would be removed" if dry_run else "removed",
            ["what", "files", "MB"],
            [(kind, counts[kind], f"{sizes[kind] / 1e6:.3f}") for kind in sorted(counts)],
        )
        say(f"{n_before} files before, {len(opened.place.names(''))} after")
