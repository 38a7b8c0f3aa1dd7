"""How long stages took: beside the records, since a time is not part of what a stage gives."""

import json
from statistics import median

from demoplan.ids import ContentHash, is_safe_name
from demoplan.store.places import Place


class Timings:
    """One file for each stage, ``stage.jsonl``, with a line for each time it ran."""

    def __init__(self, place: Place, folder: str = "timings") -> None:
        """Use ``folder`` of a place; it is made when something is first written."""
        self._place = place
        self._folder = folder

    def note(self, stage: str, key: ContentHash, wall_s: float) -> None:
        """Write down that a stage took so long; one short append, which other writers do not tear apart."""
        line = json.dumps({"key": key, "wall_s": round(wall_s, 6)}) + "\n"
        self._place.add_line(self._name_of(stage), line.encode())

    def of(self, stage: str) -> dict[str, float]:
        """Key → time of its last run [s]. A line that a killed process left half written is passed over."""
        found: dict[str, float] = {}
        for line in self._place.lines(self._name_of(stage)):
            try:
                entry = json.loads(line)
                found[str(entry["key"])] = float(entry["wall_s"])
            except (ValueError, KeyError, TypeError):
                continue
        return found

    def _name_of(self, stage: str) -> str:
        assert is_safe_name(stage)
        return f"{self._folder}/{stage}.jsonl"


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
