"""Which bytes stood under a log's path when they were last read: what is unchanged is not read again."""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from demoplan.errors import LogError
from demoplan.store import Store

SEEN_FORMAT = 1
_NAME = "seen.json"

SETTLED_NS = 2_000_000_000
"""A file that was written this shortly before it was read may be written once more within the same tick of
the file system's clock [ns]: its content decides, each time."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A log as it was read, and the row that tells of its episode."""

    signature: str
    """Names, sizes, inodes and times of its files; empty if these cannot be trusted."""
    sha256: str
    row: str
    """Hash of what the episode's row in the table ``episodes`` says."""


def signature_of(path: Path) -> str:
    """What changes with a log's files: size, inode, and when content and inode were last changed.

    Of a folder: of every file in it. Whoever changes a file and sets its times back still changes the inode.

    Raises:
        LogError: If nothing is there, or it cannot be read.
    """
    try:
        found = path.stat()
        parts = [path]
        if not path.is_file():
            parts = sorted(each for each in path.iterdir() if each.is_file())
        stats = [(each.name, found if each is path else each.stat()) for each in parts]
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None
    return ";".join(
        f"{name}:{each.st_size}:{each.st_ino}:{each.st_mtime_ns}:{each.st_ctime_ns}" for name, each in stats
    )


def settled_signature(signature: str, now_ns: int | None = None) -> str:
    """The signature, or nothing if a file was changed so lately that it may change again unnoticed."""
    now_ns = time.time_ns() if now_ns is None else now_ns
    times = [int(value) for part in signature.split(";") if part for value in part.rsplit(":", 2)[1:]]
    return signature if all(each < now_ns - SETTLED_NS for each in times) else ""


class SeenLogs:
    """What was last seen of the logs of a store's episodes: a cache, which may be deleted at any time."""

    def __init__(self, store: Store) -> None:
        """Read what was kept; what cannot be read counts as nothing."""
        self._place = store.place
        self._known = _parsed(self._place.read(_NAME) if self._place.entry(_NAME) is not None else None)
        self._new: dict[str, Seen] = {}

    def of(self, dataset: str, episode_id: str) -> Seen | None:
        """What was last seen of an episode's log."""
        return self._known.get(f"{dataset}/{episode_id}")

    def sha256_of(self, dataset: str, episode_id: str, log: Path) -> str | None:
        """Hash of the bytes of a log, if it is not younger than what was seen."""
        seen = self.of(dataset, episode_id)
        if seen is None or not seen.signature or seen.signature != signature_of(log):
            return None
        return seen.sha256

    def note(self, dataset: str, episode_id: str, seen: Seen) -> None:
        """Remember a log until ``keep``."""
        self._known[f"{dataset}/{episode_id}"] = self._new[f"{dataset}/{episode_id}"] = seen

    def keep(self) -> None:
        """Write what is new; what others wrote meanwhile stays."""
        if not self._new:
            return
        new = dict(self._new)
        self._place.update(_NAME, lambda before: _rendered(_parsed(before) | new))
        self._new.clear()


def _parsed(data: bytes | None) -> dict[str, Seen]:
    try:
        content = json.loads(data or b"{}")
        if content.get("format") != SEEN_FORMAT:
            return {}
        return {
            name: Seen(signature=entry[0], sha256=entry[1], row=entry[2])
            for name, entry in content["episodes"].items()
        }
    except (ValueError, KeyError, IndexError, TypeError, AttributeError):
        return {}


def _rendered(seen: Mapping[str, Seen]) -> bytes:
    entries = {name: [each.signature, each.sha256, each.row] for name, each in sorted(seen.items())}
    return json.dumps({"format": SEEN_FORMAT, "episodes": entries}, indent=0).encode()
