"""How long stages took: beside the records, since a time is not part of what a stage gives."""

import json
import os
from pathlib import Path
from statistics import median

from demoplan.errors import StoreError
from demoplan.ids import ContentHash, is_safe_name


class Timings:
    """One file for each stage, ``stage.jsonl``, with a line for each time it ran."""

    def __init__(self, root: Path) -> None:
        """Use ``root``; it is made when something is first written."""
        self.root = root

    def note(self, stage: str, key: ContentHash, wall_s: float) -> None:
        """Write down that a stage took so long; one short append, which other writers do not tear apart."""
        line = json.dumps({"key": key, "wall_s": round(wall_s, 6)}) + "\n"
        path = self._path_of(stage)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                os.write(descriptor, line.encode())
            finally:
                os.close(descriptor)
        except OSError as error:
            raise StoreError(f"cannot write {path}: {error.strerror or error}") from error

    def of(self, stage: str) -> dict[str, float]:
        """Key → time of its last run [s]. A line that a killed process left half written is passed over."""
        try:
            lines = self._path_of(stage).read_bytes().splitlines()
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise StoreError(f"cannot read {self._path_of(stage)}: {error.strerror or error}") from error
        found: dict[str, float] = {}
        for line in lines:
            try:
                entry = json.loads(line)
                found[str(entry["key"])] = float(entry["wall_s"])
            except (ValueError, KeyError, TypeError):
                continue
        return found

    def _path_of(self, stage: str) -> Path:
        assert is_safe_name(stage)
        return self.root / f"{stage}.jsonl"


class Estimates:
    """What running stages again would take, by what they took before."""

    def __init__(self, timings: Timings) -> None:
        """Read from ``timings``; each stage once."""
        self._timings = timings
        self._read: dict[str, tuple[dict[str, float], float | None]] = {}

    def of(self, stage: str, previous_key: str | None = None) -> float | None:
        """Seconds that a stage took for what it gave before, else its median, else None: it never ran."""
        if stage not in self._read:
            times = self._timings.of(stage)
            self._read[stage] = times, (median(times.values()) if times else None)
        times, usual = self._read[stage]
        return times.get(previous_key or "", usual)
