"""Remove what nothing names any more; what the history needs stays until the history is cut."""

import shutil
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from demoplan.errors import StoreError, UsageError
from demoplan.ids import ContentHash
from demoplan.store.atomic import PART, locked
from demoplan.store.manifest import EpisodeState
from demoplan.store.records import Record
from demoplan.store.store import Store
from demoplan.store.verifying import DAMAGED, LEFTOVER_AGE_S

GRACE_S = 24 * 3600.0
"""What is younger than this stays, named or not: somebody may be about to name it [s]."""


@dataclass(frozen=True, order=True)
class Swept:
    """A file that was removed, or would be."""

    path: str
    """Relative to the store."""
    kind: str
    """``table``, ``record``, ``snapshot`` or ``leftover``."""
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
    now_s = time.time() if now_s is None else now_s
    with locked(store.sweep_lock):
        forgotten = set() if n_snapshots is None else _old_snapshots(store, n_snapshots)
        try:
            named = store.manifest.episodes()
            for snapshot_id in store.snapshots.ids():
                if snapshot_id not in forgotten:
                    named += store.snapshots.get(snapshot_id)
            records = dict(_records(store))
        except StoreError as error:
            raise StoreError(
                f"{error}. Nothing was removed, since what it names is not known; "
                "`demoplan store repair` comes first"
            ) from None
        superseded = set() if n_snapshots is None else _superseded(records, named)
        kept = {content for state in named for content in state.tables.values()}
        kept |= {
            c for path, record in records.items() if path not in superseded for c in record.outputs.values()
        }
        candidates = [(store.snapshots.root / f"{name}.json", "snapshot") for name in forgotten]
        candidates += [(path, "record") for path in superseded]
        candidates += [
            (path, "table")
            for path in store.objects.root.glob("*/*.parquet")
            if not path.name.startswith(PART) and ContentHash(path.stem) not in kept
        ]
        candidates += _leftovers(store, now_s)
        # Records go before the tables that they name: killed in between, nothing names what is not there.
        order = {"snapshot": 0, "record": 1, "table": 2, "leftover": 3}
        swept = []
        for path, kind in sorted(candidates, key=lambda each: (order[each[1]], each[0])):
            if kind in ("record", "table") and now_s - path.stat().st_mtime < grace_s:
                continue
            swept.append(Swept(path.relative_to(store.root).as_posix(), kind, _size(path)))
            if not is_dry_run:
                _remove(path)
        if forgotten and not is_dry_run:
            store.snapshots.forget(forgotten)
    return sorted(swept)


def _old_snapshots(store: Store, n_snapshots: int) -> set[str]:
    latest = list(dict.fromkeys(entry.snapshot_id for entry in reversed(store.snapshots.log())))
    return set(store.snapshots.ids()) - set(latest[:n_snapshots])


def _records(store: Store) -> Iterable[tuple[Path, Record]]:
    for path in store.records.paths():
        record = store.records.get(path.parent.name, ContentHash(path.stem))
        assert record is not None
        yield path, record


def _superseded(records: dict[Path, Record], named: Iterable[EpisodeState]) -> set[Path]:
    """Records of episodes' stages that no state names. Records of other stages have no state: they stay."""
    in_use: dict[str, set[str]] = {}
    for state in named:
        for stage, key in state.keys.items():
            in_use.setdefault(stage, set()).add(key)
    return {
        path
        for path, record in records.items()
        if record.stage in in_use and record.key not in in_use[record.stage]
    }


def _leftovers(store: Store, now_s: float) -> list[tuple[Path, str]]:
    return [
        (path, "leftover")
        for path in store.root.rglob(f"{PART}*")
        if now_s - path.stat().st_mtime >= LEFTOVER_AGE_S
        and not any(parent.name.startswith((PART, DAMAGED)) for parent in path.parents)
    ]


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else (path,)
    return sum(file.stat().st_size for file in files if file.is_file())


def _remove(path: Path) -> None:
    try:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(f"cannot remove {path}: {error.strerror or error}") from error
