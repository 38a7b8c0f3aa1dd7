"""Where a store is kept: a folder or a bucket, behind one small interface."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Protocol

from demoplan.errors import StoreError

BUCKET_SCHEME = "s3://"

SET_ASIDE = "damaged"
"""Folder to which repairing moves what is not as it was written; nothing is deleted."""


class AbsentError(StoreError):
    """Nothing has that name."""


class NewerError(StoreError):
    """A newer version of demoplan wrote it: this one does not guess what it means."""

    def __init__(self, where: str, kind: str, found: object, known: object) -> None:
        """Keep what was found, and what this version reads."""
        self.found = found
        self.known = known
        super().__init__(
            f"{where}: {kind} {found}; this version of demoplan reads {known}: a newer one wrote it, use that"
        )


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A file or object, without its content."""

    name: str
    """Relative to the store, parts joined by ``/``."""
    n_bytes: int
    modified_s: float
    """When it was written, as seconds since the epoch by the clock of the place."""


class Place(Protocol):
    """Named bytes that are wholly there or not at all, whatever happens while they are written.

    Names are relative, with ``/`` between parts. Every method raises ``StoreError`` with the place's name in
    its message if the place cannot be read or written.
    """

    location: str
    """What opens the place again, in this process or another."""
    least_grace_s: float
    """What is younger than this may be about to be named by another writer, and may not be swept [s]."""

    def exists(self) -> bool:
        """Whether anything was ever written here."""

    def read(self, name: str) -> bytes:
        """The content of that name.

        Raises:
            AbsentError: If there is none.
        """

    def write(self, name: str, data: bytes) -> None:
        """Put content under a name, in place of what is there."""

    def create(self, name: str, data: bytes) -> bool:
        """Put content under a name unless something is there; say whether it was put."""

    def update(self, name: str, change: Callable[[bytes | None], bytes | None]) -> None:
        """Replace the content of a name by what becomes of it; no other writer's change gets lost.

        Args:
            name: The name.
            change: Takes what is there (None if nothing is) and gives what shall be there, or None to leave
                it. It may be called more than once, and must give the same for what it has given already.
        """

    def add_line(self, name: str, line: bytes) -> None:
        """Add one short line to those under a name; other writers do not tear it apart."""

    def lines(self, name: str) -> list[bytes]:
        """All lines under a name; a line that was cut off while it was written may be among them."""

    def entry(self, name: str) -> Entry | None:
        """What is known of a name without reading its content; None if there is nothing."""

    def names(self, folder: str) -> list[str]:
        """All names below a folder, sorted, in one listing."""

    def entries(self, folder: str) -> list[Entry]:
        """Like ``names``, with sizes and times."""

    def leftovers(self) -> list[Entry]:
        """What killed processes left half written, or running ones are writing."""

    def remove(self, name: str) -> None:
        """Take a name away; nothing happens if it is not there."""

    def move(self, name: str, target: str) -> None:
        """Give content another name."""

    def draft(self, suffix: str) -> AbstractContextManager[Path]:
        """An empty local file to write to; unless it was settled, it is gone when the block ends."""

    def settle(self, draft: Path, name: str) -> None:
        """Put a draft under a name, unless content of the same length is there already."""

    def open(self, name: str) -> BufferedReader:
        """The content of a name, to be read in parts.

        Raises:
            AbsentError: If there is none.
        """

    def path(self, name: str) -> Path | None:
        """The local file of that name, whether it is there or not; None if the place is not local."""

    def guard(self, name: str, *, is_shared: bool = False) -> AbstractContextManager[None]:
        """Hold others off, where the place can do that; processes that die let go."""

    def together(self) -> AbstractContextManager[None]:
        """Make what is settled in the block durable at its end, all at once, and not one by one."""
