"""Is everything there and as it was written? And: set aside what is not, so that it is made again."""

import hashlib
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath

from demoplan.errors import StoreError
from demoplan.ids import ContentHash, content_hash
from demoplan.store.domains import TABLES
from demoplan.store.places import SET_ASIDE, AbsentError
from demoplan.store.records import stage_key
from demoplan.store.store import SWEEP, Store

REASONS = f"{SET_ASIDE}/reasons.jsonl"
"""What was set aside, where it is now, and why: one line each."""

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
        faults += (Fault(*found) for found in check(store))
        on_done(name)
    return sorted(set(faults))


CHECKED = ("tables", "shards", "records", "manifest", "states", "snapshots", "domains", "leftovers")
"""Parts of the store that are checked, in this order."""

_Found = Iterator[tuple[str, str, str]]
"""Name in the store, kind and detail of faults."""


def _tables(store: Store) -> _Found:
    for content in sorted(store.objects.loose()):
        if not store.objects.is_intact(ContentHash(content)):
            name = store.objects.name_of(ContentHash(content))
            yield name, "damaged", "its bytes are not those that its name stands for"


def _shards(store: Store) -> _Found:
    for entry in store.shards.entries():
        try:
            if not store.shards.is_intact(entry.name):
                yield entry.name, "damaged", "its bytes are not those that its name stands for"
            else:
                store.shards.spots_of(entry.name)
        except StoreError as error:
            yield entry.name, "unreadable", str(error)
    for name in store.packs.names():
        try:
            store.packs.records_of(name)
        except StoreError as error:
            yield name, "damaged", str(error)


def _records(store: Store) -> _Found:
    index = store.index()
    for stage, name_key in sorted(store.records.keys()):
        name = store.records.name_of(stage, name_key)
        try:
            record = store.records.get(stage, name_key)
        except StoreError as error:
            yield name, "unreadable", str(error)
            continue
        if record is None:  # swept since it was listed
            continue
        key = stage_key(record.stage, record.inputs, record.params, record.code_version)
        if not (key == record.key == name_key and record.stage == stage):
            yield name, "damaged", "its content is not what its name stands for"
        for output, content in sorted(record.outputs.items()):
            if not index.has(content):
                table = store.objects.name_of(ContentHash(content))
                yield table, "missing", f"{output}, named by {PurePosixPath(name).name}"


def _manifest(store: Store) -> _Found:
    try:
        states = store.manifest.episodes()
    except StoreError as error:
        yield store.manifest.name, "unreadable", str(error)
        return
    index = store.index()
    for state in states:
        who = f"{state.dataset}/{state.episode_id}"
        for table, content in sorted(state.tables.items()):
            if not index.has(content):
                yield store.objects.name_of(ContentHash(content)), "missing", f"{table} of {who}"
        for stage, key in sorted(state.keys.items()):
            if not index.has_record(stage, key):
                yield store.records.name_of(stage, key), "missing", f"record of {stage} of {who}"


def _states(store: Store) -> _Found:
    for lists in (store.manifest.lists, store.snapshots.lists):
        for content in lists.contents():
            try:
                lists.get(content)
            except AbsentError:  # superseded since it was listed
                continue
            except StoreError as error:
                yield lists.name_of(content), "damaged", str(error)


def _snapshots(store: Store) -> _Found:
    try:
        named = {entry.snapshot_id for entry in store.snapshots.log()}
    except StoreError as error:
        yield store.snapshots.log_name, "unreadable", str(error)
        named = set()
    there = set(store.snapshots.ids())
    lists = set(store.snapshots.lists.contents())
    for snapshot_id in sorted(named | there):
        name = store.snapshots.name_of(snapshot_id)
        if snapshot_id not in there:
            yield name, "missing", "named by the history"
            continue
        try:
            missing = store.snapshots.lists_of(snapshot_id) - lists
        except StoreError as error:
            yield name, "unreadable", str(error)
            continue
        for content in sorted(missing):
            yield store.snapshots.lists.name_of(content), "missing", f"named by snapshot {snapshot_id}"


def _domains(store: Store) -> _Found:
    for folder in store.domains.folders():
        names = {PurePosixPath(name).name for name in store.place.names(folder)}
        if "metadata.json" not in names:
            yield folder, "leftover", "a process was killed while it wrote this, or is writing it"
            continue
        try:
            tables = json.loads(store.place.read(f"{folder}/metadata.json"))["tables"]
            expected = {name: str(tables[name]) for name in TABLES if name in tables or name != "findings"}
        except (StoreError, ValueError, KeyError, TypeError) as error:
            yield folder, "unreadable", f"metadata.json: {error}"
            continue
        for name, content in expected.items():
            if _sha256(store, f"{folder}/{name}.parquet") != content:
                yield folder, "damaged", f"{name}.parquet is not the table that metadata.json names"
        try:
            text = store.place.read(f"{folder}/domain.pddl").decode()
        except (StoreError, UnicodeDecodeError) as error:
            yield folder, "unreadable", f"domain.pddl: {error}"
            continue
        if content_hash(text)[:16] != PurePosixPath(folder).parts[2]:
            yield folder, "damaged", "domain.pddl is not the text that the domain's id stands for"


def _leftovers(store: Store) -> _Found:
    for entry in store.place.leftovers():
        yield entry.name, "leftover", "a process was killed while it wrote this, or is writing it"


_CHECKS: dict[str, Callable[[Store], _Found]] = dict(
    zip(
        CHECKED,
        (_tables, _shards, _records, _manifest, _states, _snapshots, _domains, _leftovers),
        strict=True,
    )
)


def _sha256(store: Store, name: str) -> str | None:
    try:
        with store.place.open(name) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except StoreError:
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
    with store.place.guard(SWEEP):
        for fault in faults:
            names = _names_of(store, fault.path)
            if fault.kind == "missing":
                done.append(
                    Repair(fault.path, "left", f"{fault.detail}: `demoplan reprocess` makes it again")
                )
            elif fault.kind == "leftover":
                done.append(_remove_leftover(store, fault, names, leftover_age_s, now_s))
            elif names:  # a folder with two faults is moved once
                target = _set_aside(store, fault.path, names, fault.detail)
                done.append(Repair(fault.path, "set aside", f"{fault.detail}; now {target}"))
                if fault.path == store.manifest.name:
                    done.append(_restore_manifest(store))
    return sorted(done)


def _names_of(store: Store, name: str) -> list[str]:
    """A file by its name, or all files of the folder of that name."""
    return [name] if store.place.entry(name) is not None else store.place.names(name)


def _remove_leftover(
    store: Store, fault: Fault, names: list[str], leftover_age_s: float, now_s: float
) -> Repair:
    entries = [entry for entry in map(store.place.entry, names) if entry is not None]
    if not entries:
        return Repair(fault.path, "left", "is finished by now")
    age_s = now_s - max(entry.modified_s for entry in entries)
    if age_s < leftover_age_s:
        return Repair(fault.path, "left", f"{age_s:.0f} s old: its process may be running")
    for entry in entries:
        store.place.remove(entry.name)
    return Repair(fault.path, "removed", fault.detail)


def _set_aside(store: Store, name: str, names: list[str], reason: str) -> str:
    """Move a file or folder below ``damaged/``, beside what was moved there before, and note the reason."""
    target, number = f"{SET_ASIDE}/{name}", 1
    while _names_of(store, target):
        number += 1
        target = f"{SET_ASIDE}/{name}.{number}"
    for each in names:
        store.place.move(each, target + each.removeprefix(name))
    told = {"was": name, "is": target, "reason": reason, "at_ns": time.time_ns()}
    store.place.add_line(REASONS, (json.dumps(told, sort_keys=True) + "\n").encode())
    return target


def _restore_manifest(store: Store) -> Repair:
    """Take the states of the last snapshot that can be read; what came after it is found again by running."""
    name = store.manifest.name
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
