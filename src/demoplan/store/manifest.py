"""The manifest: which records stand for each episode of each dataset now."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from demoplan.errors import StoreError, UnknownNameError
from demoplan.store.atomic import locked, write_bytes

MANIFEST_FORMAT = 1


@dataclass(frozen=True, kw_only=True)
class EpisodeState:
    """What the store holds of one episode."""

    dataset: str
    episode_id: str
    tables: dict[str, str] = field(default_factory=dict)
    """Name of a table → hash of its content."""
    keys: dict[str, str] = field(default_factory=dict)
    """Stage → key of the record that gave it."""
    status: str = "complete"
    reason: str | None = None
    attempt: str | None = None
    """Key of the stage run that failed, if one did: it would fail again. It names no record."""


class Manifest:
    """One JSON file, replaced as a whole under a lock, so that concurrent writers keep each other's work."""

    def __init__(self, root: Path) -> None:
        """Use ``manifest.json`` below ``root``."""
        self.path = root / "manifest.json"
        self._lock = root / "manifest.lock"

    def _read(self) -> dict[str, dict[str, EpisodeState]]:
        try:
            content = json.loads(self.path.read_text())
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise StoreError(f"{self.path}: not a manifest: {error}") from None
        if content.get("format") != MANIFEST_FORMAT:
            raise StoreError(
                f"{self.path}: manifest format {content.get('format')}; this version reads {MANIFEST_FORMAT}"
            )
        return {
            dataset: {name: EpisodeState(**state) for name, state in episodes.items()}
            for dataset, episodes in content["datasets"].items()
        }

    def update(self, states: Iterable[EpisodeState]) -> None:
        """Put in what is now known of some episodes; the others stay as they are."""
        with locked(self._lock):
            datasets = self._read()
            for state in states:
                datasets.setdefault(state.dataset, {})[state.episode_id] = state
            content = {
                "format": MANIFEST_FORMAT,
                "datasets": {
                    dataset: {name: asdict(state) for name, state in sorted(episodes.items())}
                    for dataset, episodes in sorted(datasets.items())
                },
            }
            write_bytes(self.path, (json.dumps(content, sort_keys=True, indent=1) + "\n").encode())

    def episodes(self, dataset: str | None = None) -> list[EpisodeState]:
        """Every known episode, sorted by dataset and id."""
        datasets = self._read()
        if dataset is not None and dataset not in datasets:
            raise UnknownNameError("dataset", dataset, datasets, where=f"store {self.path.parent}")
        chosen = [dataset] if dataset is not None else sorted(datasets)
        return [state for name in chosen for _, state in sorted(datasets[name].items())]

    def episode(self, name: str) -> EpisodeState:
        """One episode by its id, or by ``dataset/id`` where the id alone is not unique.

        Raises:
            UnknownNameError: If there is no such episode, or more than one.
        """
        everything = self.episodes()
        found = [s for s in everything if name in (s.episode_id, f"{s.dataset}/{s.episode_id}")]
        if len(found) != 1:
            available = [f"{s.dataset}/{s.episode_id}" for s in (found or everything)]
            raise UnknownNameError("episode", name, available, where=f"store {self.path.parent}")
        return found[0]
