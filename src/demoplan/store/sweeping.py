"""Remove what nothing names any more; what the history needs stays until the history is cut."""

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TypeAlias

from demoplan.errors import StoreError, UsageError
from demoplan.store.manifest import EpisodeState
from demoplan.store.places import Entry
from demoplan.store.records import Record
from demoplan.store.store import SWEEP, Store
from demoplan.store.verifying import LEFTOVER_AGE_S

_ORDER = ("snapshot", "record", "pack", "packed", "table", "shard", "states", "leftover")
_AT_ONCE = ("snapshot", "packed", "leftover")
"""What goes however young it is."""

_Key: TypeAlias = tuple[str, str]
"""Stage and key of a record."""

GRACE_S = 24 * 3600.0
"""What is younger than this stays, named or not: somebody may be about to name it [s]."""


@dataclass(frozen=True, order=True)
class Swept:
    """A file that was removed, or would be."""

    path: str
    """Relative to the store."""
    kind: str
    """``table``, ``record``, ``shard``, ``states``, ``snapshot``, ``leftover``, ``packed``: in a shard; or
    ``pack``: of records, written anew without those that nothing names."""
    n_bytes: int


def sweep(
    store: Store,
    *,
    grace_s: float = GRACE_S,
    n_snapshots: int | None = None,
    is_dry_run: bool = False,
    now_s: float | None = None,
) -> list[Swept]:
    """Remove tables that no record, no manifest and no snapshot names, and what killed processes left.

    Args:
        store: The store. Writers wait while it is swept.
        grace_s: What was written less than this ago stays.
        n_snapshots: Also forget all snapshots but the latest ones, and those records of episodes' stages that
            neither the manifest nor a snapshot that stays names; their tables go with them. By default the
            whole history stays.
        is_dry_run: Only say what would be removed.
        now_s: The time now, as seconds since the epoch; the wall clock if it is not given.

    Returns:
        What was removed, or would be, in order of path.

    Raises:
        UsageError: If the grace period is negative, or no snapshot is to be kept.
        StoreError: If something that may name tables cannot be read: then nothing is removed.
    """
    if grace_s < 0 or (n_snapshots is not None and n_snapshots < 1):
        raise UsageError(f"grace {grace_s} s, {n_snapshots} snapshots: expected 0 s or more, and 1 or more")
    if grace_s < store.place.least_grace_s and not is_dry_run:
        raise UsageError(
            f"grace {grace_s:.0f} s: {store.location} cannot hold writers off while it is swept; expected "
            f"{store.place.least_grace_s:.0f} s or more, and no writer that takes longer for one episode"
        )
    now_s = time.time() if now_s is None else now_s
    with store.place.guard(SWEEP):
        forgotten = set() if n_snapshots is None else _old_snapshots(store, n_snapshots)
        try:
            old_s = now_s - grace_s if n_snapshots is not None else None
            doomed, superseded = _doomed(store, forgotten, old_s)
        except StoreError as error:
            raise StoreError(
                f"{error}. Nothing was removed, since what it names is not known; "
                "`demoplan store repair` comes first"
            ) from None
        doomed += [
            (entry, "leftover")
            for entry in _leftovers(store)
            if now_s - entry.modified_s >= max(LEFTOVER_AGE_S, store.place.least_grace_s)
        ]
        # Records go before the tables that they name: killed in between, nothing names what is not there.
        swept = []
        for entry, kind in sorted(doomed, key=lambda each: (_ORDER.index(each[1]), each[0].name)):
            if kind not in _AT_ONCE and now_s - entry.modified_s < grace_s:
                continue
            swept.append(Swept(entry.name, kind, entry.n_bytes))
            if not is_dry_run:
                if kind == "pack":
                    _keep_rest(store, entry.name, superseded)
                store.place.remove(entry.name)
        if forgotten and not is_dry_run:
            store.snapshots.forget(forgotten)
    return sorted(swept)


def _doomed(
    store: Store, forgotten: set[str], old_s: float | None
) -> tuple[list[tuple[Entry, str]], set[_Key]]:
    """What nothing names, with its kind; and the records of episodes' stages that nothing names.

    Args:
        store: The store.
        forgotten: Snapshots that name nothing any more.
        old_s: Records in packs that were written before this may go, and loose ones; None lets all stay.
    """
    # Listed before what names them is read: what is named later is not among them.
    tables = store.place.entries(store.objects.folder)
    loose = store.place.entries(store.records.folder)
    lists = store.place.entries(store.manifest.lists.folder)
    lists += store.place.entries(store.snapshots.lists.folder)
    named = store.manifest.episodes()
    named_lists = {store.manifest.lists.name_of(content) for content in store.manifest.lists_named()}
    for snapshot_id in store.snapshots.ids():
        if snapshot_id not in forgotten:
            named += store.snapshots.get(snapshot_id)
            named_lists |= {
                store.snapshots.lists.name_of(content) for content in store.snapshots.lists_of(snapshot_id)
            }
    packs = store.place.entries(store.packs.folder)
    records = dict(_records(store))
    superseded: set[_Key] = set()
    if old_s is not None:
        young = {key for e in packs if e.modified_s > old_s for key in store.packs.records_of(e.name)}
        superseded = _superseded(records, named) - young
    kept = {content for state in named for content in state.tables.values()}
    kept |= {c for key, record in records.items() if key not in superseded for c in record.outputs.values()}
    gone = {store.records.name_of(*key) for key in superseded}
    doomed = [(store.place.entry(store.snapshots.name_of(name)), "snapshot") for name in forgotten]
    doomed += [(entry, "record") for entry in loose if entry.name in gone]
    doomed += [(entry, "table") for entry in tables if PurePosixPath(entry.name).stem not in kept]
    doomed += _in_shards(store, tables, kept)
    doomed += _in_packs(store, packs, [entry for entry in loose if entry.name not in gone], superseded)
    doomed += [(entry, "states") for entry in lists if entry.name not in named_lists]
    return [(entry, kind) for entry, kind in doomed if entry is not None], superseded


def _in_shards(store: Store, tables: list[Entry], kept: set[str]) -> list[tuple[Entry, str]]:
    """Tables that a shard holds too, and shards that hold nothing which is needed and not in another one."""
    loose = {PurePosixPath(entry.name).stem: entry for entry in tables}
    doomed: list[tuple[Entry, str]] = []
    held: set[str] = set()
    # The largest first: it is what smaller ones were joined into.
    for entry in sorted(store.shards.entries(), key=lambda each: (-each.n_bytes, each.name)):
        contents = store.shards.spots_of(entry.name).keys()
        if contents & kept <= held:
            # With nothing of its own that is needed it goes at once; with nothing needed at all, in time.
            doomed.append((entry, "packed" if contents & kept else "shard"))
            continue
        held |= contents
        double = sorted(contents & kept & loose.keys())
        if double and store.shards.is_intact(entry.name):
            doomed += [(loose[content], "packed") for content in double]
    return doomed


def _in_packs(
    store: Store, packs: list[Entry], loose: list[Entry], superseded: set[_Key]
) -> list[tuple[Entry, str]]:
    """Records that a pack holds too, packs of which no record is needed here, and packs of which some are."""
    by_name = {entry.name: entry for entry in loose}
    doomed: list[tuple[Entry, str]] = []
    held: set[_Key] = set()
    for entry in sorted(packs, key=lambda each: (-each.n_bytes, each.name)):
        keys = store.packs.records_of(entry.name).keys()
        if keys - superseded <= held:
            doomed.append((entry, "packed"))
            continue
        held |= keys - superseded
        if keys & superseded:
            doomed.append((entry, "pack"))
    names = (store.records.name_of(*key) for key in sorted(held))
    return doomed + [(by_name[name], "packed") for name in names if name in by_name]


def _keep_rest(store: Store, pack: str, superseded: set[_Key]) -> None:
    """Write those records of a pack into another one that something names."""
    rest = [record for key, record in store.packs.records_of(pack).items() if key not in superseded]
    if rest:
        store.packs.put(rest)


def _old_snapshots(store: Store, n_snapshots: int) -> set[str]:
    latest = list(dict.fromkeys(entry.snapshot_id for entry in reversed(store.snapshots.log())))
    return set(store.snapshots.ids()) - set(latest[:n_snapshots])


def _records(store: Store) -> Iterable[tuple[_Key, Record]]:
    for stage, key in sorted(store.records.keys()):
        record = store.records.get(stage, key)
        if record is not None:
            yield (stage, key), record


def _superseded(records: dict[_Key, Record], named: Iterable[EpisodeState]) -> set[_Key]:
    """Records of episodes' stages that no state names. Records of other stages have no state: they stay."""
    in_use: dict[str, set[str]] = {}
    for state in named:
        for stage, key in state.keys.items():
            in_use.setdefault(stage, set()).add(key)
    return {(stage, key) for stage, key in records if stage in in_use and key not in in_use[stage]}


def _leftovers(store: Store) -> Iterable[Entry]:
    yield from store.place.leftovers()
    for folder in store.domains.folders():
        entries = store.place.entries(folder)
        if not any(entry.name == f"{folder}/metadata.json" for entry in entries):
            yield from (
                entry for entry in entries if PurePosixPath(entry.name).parent == PurePosixPath(folder)
            )
