"""Files that are either wholly there or not at all, whenever the process is killed."""

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from demoplan.errors import StoreError

PART = ".part-"
"""Prefix of files that are being written; one that is left over belongs to a killed process."""


@contextlib.contextmanager
def temporary_in(folder: Path, suffix: str) -> Iterator[Path]:
    """An empty file in ``folder`` to write to; unless it was settled, it is gone when the block ends.

    Raises:
        StoreError: If the folder cannot be written.
    """
    try:
        make_folder(folder)
        handle, name = tempfile.mkstemp(prefix=PART, suffix=suffix, dir=folder)
    except OSError as error:
        raise StoreError(f"cannot write into {folder}: {error.strerror or error}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
    except OSError as error:
        raise StoreError(f"cannot write into {folder}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def settle(temporary: Path, path: Path, *, is_flushed: bool = True) -> None:
    """Let a written file, of the same file system, take the place of ``path``.

    Args:
        temporary: The written file.
        path: Where it goes.
        is_flushed: Whether it is on the disk when this returns, so that a power cut does not undo it; if not,
            the caller flushes it and its folder later.
    """
    make_folder(path.parent)
    temporary.chmod(0o644)
    if is_flushed:
        flush([temporary])
    temporary.replace(path)
    if is_flushed:
        flush([path.parent])


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary sibling to write to; it takes the place of ``path`` when the block ends without error.

    Raises:
        StoreError: If the folder cannot be written.
    """
    with temporary_in(path.parent, path.suffix) as temporary:
        yield temporary
        settle(temporary, path)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def make_folder(folder: Path) -> None:
    """Make a folder and those above it that are not there, so that a power cut does not undo it.

    Raises:
        StoreError: If it cannot be made.
    """
    absent = []
    while not folder.is_dir():
        absent.append(folder)
        if folder == folder.parent:
            break
        folder = folder.parent
    for each in reversed(absent):
        try:
            each.mkdir(exist_ok=True)
            flush([each.parent])
        except OSError as error:
            raise StoreError(f"cannot make the folder {each}: {error.strerror or error}") from error


def flush(paths: Iterable[Path]) -> None:
    """Wait until files or folders are on the disk as they are now; what is gone meanwhile is passed over."""
    for path in paths:
        try:
            descriptor = os.open(path, os.O_RDONLY)
        except FileNotFoundError:
            continue
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def locked(path: Path, *, is_shared: bool = False) -> Iterator[None]:
    """Hold a lock on a file; the system lets go of it when the process dies.

    Args:
        path: The lock's file; it stays there, empty.
        is_shared: Whether others may hold it at the same time, if they share it too.

    Raises:
        StoreError: If the lock file cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise StoreError(f"cannot lock {path}: {error.strerror or error}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
