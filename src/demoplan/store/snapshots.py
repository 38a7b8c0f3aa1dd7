"""Snapshots: what stood at some moment, by an id that is the hash of it."""

import json
import time
from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass
from pathlib import PurePosixPath
from typing import Any

from demoplan.errors import StoreError, UnknownNameError
from demoplan.ids import content_hash
from demoplan.store.manifest import EpisodeState, StateLists
from demoplan.store.places import AbsentError, NewerError, Place

SNAPSHOT_FORMAT = 2
"""Format 1 held all states itself; it is read as it is."""


@dataclass(frozen=True, kw_only=True)
class LogEntry:
    """One line of the store's history."""

    snapshot_id: str
    made_at_ns: int
    """Wall clock, for people; the order of the history does not depend on it."""
    cause: str
    """What was done: a command and what it was done to."""
    n_episodes: int
    n_lost: int
    """Episodes that are truncated or quarantined."""


@dataclass(frozen=True, order=True)
class StateChange:
    """How one episode differs between two snapshots."""

    dataset: str
    episode_id: str
    kind: str
    """``added``, ``removed`` or ``changed``."""
    tables: tuple[str, ...]
    """Names of the tables whose content differs."""
    status: str
    """The status, or ``old → new``."""


class Snapshots:
    """``snapshots/ID.json``: each state of the manifest that was kept; ``snapshots/log.jsonl``: their order.

    A snapshot names a list of states for each dataset; datasets that did not change share it.
    """

    folder = "snapshots"
    log_name = "snapshots/log.jsonl"

    def __init__(self, place: Place) -> None:
        """Use a place; the folder is made when something is first written."""
        self._place = place
        self.lists = StateLists(place, "snapshots/states")

    def name_of(self, snapshot_id: str) -> str:
        """What a snapshot is called in its place."""
        return f"{self.folder}/{snapshot_id}.json"

    def take(self, states: Iterable[EpisodeState], cause: str) -> str:
        """Keep what stands now; if it is what stood last, nothing is written.

        Args:
            states: Every episode of the manifest.
            cause: What was done.

        Returns:
            The snapshot's id: equal states have equal ids, whoever made them and when.
        """
        by_dataset: dict[str, list[EpisodeState]] = defaultdict(list)
        for state in states:
            by_dataset[state.dataset].append(state)
        lists = {dataset: self.lists.put(members) for dataset, members in sorted(by_dataset.items())}
        body = json.dumps({"format": SNAPSHOT_FORMAT, "lists": lists}, sort_keys=True, indent=1) + "\n"
        snapshot_id = content_hash(body)[:16]
        self._place.create(self.name_of(snapshot_id), body.encode())
        everything = [state for members in by_dataset.values() for state in members]
        entry = LogEntry(
            snapshot_id=snapshot_id,
            made_at_ns=time.time_ns(),
            cause=cause,
            n_episodes=len(everything),
            n_lost=sum(state.status != "complete" for state in everything),
        )

        def append(found: bytes | None) -> bytes | None:
            history = self._parsed(found)
            is_last = bool(history) and history[-1].snapshot_id == snapshot_id
            return None if is_last else _rendered([*history, entry])

        self._place.update(self.log_name, append)
        return snapshot_id

    def forget(self, snapshot_ids: Collection[str]) -> None:
        """Take snapshots out of the history."""
        self._place.update(
            self.log_name,
            lambda found: _rendered(e for e in self._parsed(found) if e.snapshot_id not in snapshot_ids),
        )

    def log(self) -> list[LogEntry]:
        """The history, oldest first.

        Raises:
            StoreError: If it cannot be read.
        """
        try:
            return self._parsed(self._place.read(self.log_name))
        except AbsentError:
            return []

    def _parsed(self, data: bytes | None) -> list[LogEntry]:
        try:
            return [LogEntry(**json.loads(line)) for line in (data or b"").splitlines()]
        except (ValueError, TypeError) as error:
            raise StoreError(
                f"{self._place.location}: {self.log_name}: not a history: {error}; "
                "`demoplan store repair` sets it aside"
            ) from None

    def ids(self) -> list[str]:
        """Every snapshot that is there, in no order of time."""
        paths = (PurePosixPath(name) for name in self._place.names(self.folder))
        return sorted(path.stem for path in paths if path.suffix == ".json" and len(path.parts) == 2)

    def find(self, asked: str) -> str:
        """A snapshot by its id, or the start of it (4 digits or more).

        Raises:
            UnknownNameError: If none fits, or more than one does.
        """
        known = self.ids()
        fitting = [each for each in known if len(asked) >= 4 and each.startswith(asked)]
        if len(fitting) != 1:
            where = f"store {self._place.location}"
            raise UnknownNameError("snapshot", asked, fitting or known, where=where)
        return fitting[0]

    def get(self, snapshot_id: str) -> list[EpisodeState]:
        """The episodes as they stood.

        Raises:
            StoreError: If the snapshot cannot be read, or is not what its id names.
        """
        content = self._content(snapshot_id)
        if content["format"] == 1:
            return [EpisodeState(**state) for state in content["episodes"]]
        return [state for _, name in sorted(content["lists"].items()) for state in self.lists.get(name)]

    def lists_of(self, snapshot_id: str) -> set[str]:
        """The hashes of the lists of states that a snapshot names.

        Raises:
            StoreError: As ``get``.
        """
        return set(self._content(snapshot_id).get("lists", {}).values())

    def _content(self, snapshot_id: str) -> dict[str, Any]:
        where = f"{self._place.location}: {self.name_of(snapshot_id)}"
        data = self._place.read(self.name_of(snapshot_id))
        if content_hash(data)[:16] != snapshot_id:
            raise StoreError(f"{where}: its content is not what its name says")
        try:
            content: dict[str, Any] = json.loads(data)
            written = content["format"]
            _ = content["episodes" if written == 1 else "lists"]
        except (ValueError, KeyError, TypeError) as error:
            raise StoreError(f"{where}: not a snapshot: {error}") from None
        if written not in (1, SNAPSHOT_FORMAT):
            raise NewerError(where, "snapshot format", written, f"1 to {SNAPSHOT_FORMAT}")
        return content


def _rendered(history: Iterable[LogEntry]) -> bytes:
    return "".join(json.dumps(asdict(entry), sort_keys=True) + "\n" for entry in history).encode()


def difference(old: Iterable[EpisodeState], new: Iterable[EpisodeState]) -> list[StateChange]:
    """How two states of a manifest differ, by episode."""
    before = {(state.dataset, state.episode_id): state for state in old}
    after = {(state.dataset, state.episode_id): state for state in new}
    changes = []
    for name in sorted(before.keys() | after.keys()):
        was, now = before.get(name), after.get(name)
        if was == now:
            continue
        kind = "added" if was is None else "removed" if now is None else "changed"
        old_tables = was.tables if was is not None else {}
        new_tables = now.tables if now is not None else {}
        tables = tuple(
            sorted(t for t in old_tables.keys() | new_tables.keys() if old_tables.get(t) != new_tables.get(t))
        )
        statuses = list(dict.fromkeys(state.status for state in (was, now) if state is not None))
        changes.append(StateChange(*name, kind, tables, " → ".join(statuses)))
    return changes
