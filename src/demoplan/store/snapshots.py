"""Snapshots: what stood at some moment, by an id that is the hash of it."""

import json
import time
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from demoplan.errors import StoreError, UnknownNameError
from demoplan.ids import content_hash
from demoplan.store.atomic import locked, write_bytes
from demoplan.store.manifest import EpisodeState

SNAPSHOT_FORMAT = 1


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
    """A folder with ``ID.json`` for each state of the manifest that was kept, and ``log.jsonl`` in order."""

    def __init__(self, root: Path) -> None:
        """Use ``root``; it is made when something is first written."""
        self.root = root

    def take(self, states: Iterable[EpisodeState], cause: str) -> str:
        """Keep what stands now; if it is what stood last, nothing is written.

        Args:
            states: Every episode of the manifest.
            cause: What was done.

        Returns:
            The snapshot's id: equal states have equal ids, whoever made them and when.
        """
        ordered = sorted((asdict(state) for state in states), key=lambda s: (s["dataset"], s["episode_id"]))
        body = json.dumps({"format": SNAPSHOT_FORMAT, "episodes": ordered}, sort_keys=True, indent=1) + "\n"
        snapshot_id = content_hash(body)[:16]
        with locked(self.root / "log.lock"):
            history = self.log()
            if history and history[-1].snapshot_id == snapshot_id:
                return snapshot_id
            if not self._path_of(snapshot_id).is_file():
                write_bytes(self._path_of(snapshot_id), body.encode())
            entry = LogEntry(
                snapshot_id=snapshot_id,
                made_at_ns=time.time_ns(),
                cause=cause,
                n_episodes=len(ordered),
                n_lost=sum(state["status"] != "complete" for state in ordered),
            )
            self._write_log((*history, entry))
        return snapshot_id

    def forget(self, snapshot_ids: Collection[str]) -> None:
        """Take snapshots out of the history."""
        with locked(self.root / "log.lock"):
            self._write_log([entry for entry in self.log() if entry.snapshot_id not in snapshot_ids])

    def _write_log(self, history: Iterable[LogEntry]) -> None:
        lines = [json.dumps(asdict(entry), sort_keys=True) + "\n" for entry in history]
        write_bytes(self.root / "log.jsonl", "".join(lines).encode())

    def log(self) -> list[LogEntry]:
        """The history, oldest first.

        Raises:
            StoreError: If it cannot be read.
        """
        path = self.root / "log.jsonl"
        try:
            return [LogEntry(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
        except FileNotFoundError:
            return []
        except (OSError, ValueError, TypeError) as error:
            raise StoreError(
                f"{path}: not a history: {error}; `demoplan store repair` sets it aside"
            ) from None

    def ids(self) -> list[str]:
        """Every snapshot that is there, in no order of time."""
        return sorted(path.stem for path in self.root.glob("[0-9a-f]*.json"))

    def find(self, asked: str) -> str:
        """A snapshot by its id, or the start of it (4 digits or more).

        Raises:
            UnknownNameError: If none fits, or more than one does.
        """
        known = self.ids()
        fitting = [each for each in known if len(asked) >= 4 and each.startswith(asked)]
        if len(fitting) != 1:
            raise UnknownNameError("snapshot", asked, fitting or known, where=f"store {self.root.parent}")
        return fitting[0]

    def get(self, snapshot_id: str) -> list[EpisodeState]:
        """The episodes as they stood.

        Raises:
            StoreError: If the snapshot cannot be read, or is not what its id names.
        """
        path = self._path_of(snapshot_id)
        try:
            text = path.read_text(encoding="utf-8")
            content = json.loads(text)
            if content["format"] != SNAPSHOT_FORMAT:
                raise StoreError(
                    f"{path}: snapshot format {content['format']}; this version reads {SNAPSHOT_FORMAT}"
                )
            states = [EpisodeState(**state) for state in content["episodes"]]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise StoreError(f"{path}: not a snapshot: {error}") from None
        if content_hash(text)[:16] != snapshot_id:
            raise StoreError(f"{path}: its content is not what its name says")
        return states

    def _path_of(self, snapshot_id: str) -> Path:
        return self.root / f"{snapshot_id}.json"


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
