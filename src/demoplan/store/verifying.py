"""Is everything there and as it was written? And: set aside what is not, so that it is made again."""

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from demoplan.errors import StoreError
from demoplan.ids import ContentHash, content_hash
from demoplan.store.atomic import PART, locked
from demoplan.store.domains import TABLES
from demoplan.store.records import stage_key
from demoplan.store.store import Store

DAMAGED = "damaged"
"""Folder in the store to which repairing moves what is not as it was written; nothing is deleted."""

LEFTOVER_AGE_S = 3600.0
"""A file that is being written is taken for left over by a killed process after this time [s]."""


@dataclass(frozen=True, order=True)
class Fault:
    """Something in the store that is not as it should be."""

    path: str
    """Relative to the store."""
    kind: str
    """``damaged``: not what its name says; ``unreadable``, ``missing``: named, not there; ``leftover``."""
    detail: str

    @property
    def is_harmless(self) -> bool:
        """Whether nothing that was ever finished is affected: the traces of a killed process."""
        return self.kind == "leftover"


def verify(store: Store, on_done: Callable[[str], None] = lambda _: None) -> list[Fault]:
    """Check every table, record, snapshot, domain version and the manifest against each other and themselves.

    Args:
        store: The store; nothing in it is changed.
        on_done: Called with the name of each part of the store when it has been checked.

    Returns:
        What is wrong, in order of path; empty if the store is as it was written.
    """
    faults: list[Fault] = []
    for name, check in _CHECKS.items():
        faults += (
            Fault(path.relative_to(store.root).as_posix(), kind, detail)
            for path, kind, detail in check(store)
        )
        on_done(name)
    return sorted(set(faults))


CHECKED = ("tables", "records", "manifest", "snapshots", "domains", "leftovers")
"""Parts of the store that are checked, in this order."""

_Found = Iterator[tuple[Path, str, str]]


def _tables(store: Store) -> _Found:
    for path in sorted(store.objects.root.glob("*/*.parquet")):
        if not path.name.startswith(PART) and not store.objects.is_intact(ContentHash(path.stem)):
            yield path, "damaged", "its bytes are not those that its name stands for"


def _records(store: Store) -> _Found:
    for path in store.records.paths():
        try:
            record = store.records.get(path.parent.name, ContentHash(path.stem))
        except StoreError as error:
            yield path, "unreadable", str(error)
            continue
        assert record is not None
        key = stage_key(record.stage, record.inputs, record.params, record.code_version)
        if not (key == record.key == path.stem and record.stage == path.parent.name):
            yield path, "damaged", "its content is not what its name stands for"
        for name, content in sorted(record.outputs.items()):
            if not store.objects.has(ContentHash(content)):
                yield store.objects.path_of(ContentHash(content)), "missing", f"{name}, named by {path.name}"


def _manifest(store: Store) -> _Found:
    try:
        states = store.manifest.episodes()
    except StoreError as error:
        yield store.manifest.path, "unreadable", str(error)
        return
    for state in states:
        who = f"{state.dataset}/{state.episode_id}"
        for name, content in sorted(state.tables.items()):
            if not store.objects.has(ContentHash(content)):
                yield store.objects.path_of(ContentHash(content)), "missing", f"{name} of {who}"
        for stage, key in sorted(state.keys.items()):
            path = store.records.path_of(stage, ContentHash(key))
            if not path.is_file():
                yield path, "missing", f"record of {stage} of {who}"


def _snapshots(store: Store) -> _Found:
    history = store.snapshots.root / "log.jsonl"
    try:
        named = {entry.snapshot_id for entry in store.snapshots.log()}
    except StoreError as error:
        yield history, "unreadable", str(error)
        named = set()
    for snapshot_id in sorted(named | set(store.snapshots.ids())):
        path = store.snapshots.root / f"{snapshot_id}.json"
        if not path.is_file():
            yield path, "missing", "named by the history"
            continue
        try:
            store.snapshots.get(snapshot_id)
        except StoreError as error:
            yield path, "unreadable", str(error)


def _domains(store: Store) -> _Found:
    for path in sorted(store.domains.root.glob("*/*/metadata.json")):
        folder = path.parent
        if folder.name.startswith(PART):
            continue
        try:
            tables = json.loads(path.read_text(encoding="utf-8"))["tables"]
            expected = {name: str(tables[name]) for name in TABLES}
        except (OSError, ValueError, KeyError, TypeError) as error:
            yield folder, "unreadable", f"metadata.json: {error}"
            continue
        for name, content in expected.items():
            if _sha256(folder / f"{name}.parquet") != content:
                yield folder, "damaged", f"{name}.parquet is not the table that metadata.json names"
        try:
            text = (folder / "domain.pddl").read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            yield folder, "unreadable", f"domain.pddl: {error}"
            continue
        if content_hash(text)[:16] != folder.name:
            yield folder, "damaged", "domain.pddl is not the text that the domain's id stands for"


def _leftovers(store: Store) -> _Found:
    for path in sorted(store.root.rglob(f"{PART}*")):
        if not any(parent.name.startswith((PART, DAMAGED)) for parent in path.parents):
            yield path, "leftover", "a process was killed while it wrote this, or is writing it"


_CHECKS: dict[str, Callable[[Store], _Found]] = dict(
    zip(CHECKED, (_tables, _records, _manifest, _snapshots, _domains, _leftovers), strict=True)
)


def _sha256(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


@dataclass(frozen=True, order=True)
class Repair:
    """What was done about a fault."""

    path: str
    action: str
    """``removed``, ``set aside``, ``restored`` or ``left``."""
    detail: str


def repair(
    store: Store, faults: list[Fault], *, leftover_age_s: float = LEFTOVER_AGE_S, now_s: float | None = None
) -> list[Repair]:
    """Set aside what is damaged, remove what killed processes left, restore a manifest from its snapshot.

    A table that was set aside or is missing is made again by reprocessing, as long as its log is there.

    Args:
        store: The store.
        faults: What ``verify`` found.
        leftover_age_s: A leftover younger than this may belong to a process that is running, and stays.
        now_s: The time now, as seconds since the epoch; the wall clock if it is not given.

    Returns:
        What was done, one for each fault, in order of path.
    """
    now_s = time.time() if now_s is None else now_s
    done = []
    with locked(store.sweep_lock):
        for fault in faults:
            path = store.root / fault.path
            if fault.kind == "missing":
                done.append(
                    Repair(fault.path, "left", f"{fault.detail}: `demoplan reprocess` makes it again")
                )
            elif fault.kind == "leftover":
                done.append(_remove_leftover(path, fault, leftover_age_s, now_s))
            elif path.exists():  # a folder with two faults is moved once
                target = _set_aside(store, path)
                done.append(Repair(fault.path, "set aside", f"{fault.detail}; now {target}"))
                if path == store.manifest.path:
                    done.append(_restore_manifest(store))
    return sorted(done)


def _remove_leftover(path: Path, fault: Fault, leftover_age_s: float, now_s: float) -> Repair:
    try:
        age_s = now_s - path.stat().st_mtime
    except FileNotFoundError:
        return Repair(fault.path, "left", "is finished by now")
    if age_s < leftover_age_s:
        return Repair(fault.path, "left", f"{age_s:.0f} s old: its process may be running")
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    return Repair(fault.path, "removed", fault.detail)


def _set_aside(store: Store, path: Path) -> str:
    """Move a file or folder below ``damaged/``, beside what was moved there before under the same name."""
    relative = path.relative_to(store.root)
    target = store.root / DAMAGED / relative
    number = 1
    while target.exists():
        number += 1
        target = store.root / DAMAGED / relative.with_name(f"{relative.name}.{number}")
    target.parent.mkdir(parents=True, exist_ok=True)
    path.rename(target)
    return target.relative_to(store.root).as_posix()


def _restore_manifest(store: Store) -> Repair:
    """Take the states of the last snapshot that can be read; what came after it is found again by running."""
    name = store.manifest.path.name
    try:
        history = store.snapshots.log()
    except StoreError:
        history = []
    for entry in reversed(history):
        try:
            states = store.snapshots.get(entry.snapshot_id)
        except StoreError:
            continue
        store.manifest.update(states)
        return Repair(name, "restored", f"from snapshot {entry.snapshot_id}, made by: {entry.cause}")
    return Repair(name, "left", "there is no snapshot to restore it from: run `demoplan run` again")
