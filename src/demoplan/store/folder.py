"""A place in a folder of the local file system."""

import contextlib
import ctypes
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from io import BufferedReader
from pathlib import Path

from typing_extensions import override

from demoplan.errors import StoreError
from demoplan.store.atomic import PART, flush, locked, make_folder, settle, temporary_in, write_bytes
from demoplan.store.places import SET_ASIDE, AbsentError, Entry, Place

_FLUSHERS = 8
"""Files that are made durable at once: each waits for the disk, hardly any for the processor."""
_MANY = 24
"""From so many files on, the whole file system is made durable instead of each of them."""

LOCK_SUFFIX = ".lock"


class Folder(Place):
    """Files below one folder: written beside, flushed, then renamed."""

    least_grace_s = 0.0

    def __init__(self, root: Path) -> None:
        """Use ``root``; it is made when something is first written."""
        self.root = root
        self.location = str(root)
        self._pending: set[Path] | None = None
        self._mutex = threading.Lock()

    @override
    def exists(self) -> bool:
        return self.root.is_dir()

    @override
    def read(self, name: str) -> bytes:
        with self._reading(name):
            return (self.root / name).read_bytes()

    @override
    def write(self, name: str, data: bytes) -> None:
        write_bytes(self.root / name, data)

    @override
    def create(self, name: str, data: bytes) -> bool:
        if (self.root / name).exists():
            return False
        with self.draft(".part") as draft:
            draft.write_bytes(data)
            path = self.root / name
            flush([draft])
            make_folder(path.parent)
            try:
                os.link(draft, path)
            except FileExistsError:
                return False
            flush([path.parent])
        return True

    @override
    def update(self, name: str, change: Callable[[bytes | None], bytes | None]) -> None:
        path = self.root / name
        with locked(path.with_suffix(LOCK_SUFFIX)):
            try:
                found: bytes | None = self.read(name)
            except AbsentError:
                found = None
            changed = change(found)
            if changed is not None and changed != found:
                write_bytes(path, changed)

    @override
    def add_line(self, name: str, line: bytes) -> None:
        path = self.root / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                os.write(descriptor, line)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise StoreError(f"cannot write {path}: {error.strerror or error}") from error

    @override
    def lines(self, name: str) -> list[bytes]:
        try:
            return self.read(name).splitlines()
        except AbsentError:
            return []

    @override
    def entry(self, name: str) -> Entry | None:
        try:
            with self._reading(name):
                return _entry(name, (self.root / name).stat())
        except AbsentError:
            return None

    @override
    def names(self, folder: str) -> list[str]:
        return sorted(name for name, _ in self._walk(folder))

    @override
    def entries(self, folder: str) -> list[Entry]:
        found = []
        for name, each in self._walk(folder):
            with contextlib.suppress(FileNotFoundError):  # removed meanwhile
                found.append(_entry(name, each.stat()))
        return sorted(found, key=lambda entry: entry.name)

    @override
    def leftovers(self) -> list[Entry]:
        found = []
        for path in sorted(self.root.rglob(f"{PART}*")):
            relative = path.relative_to(self.root)
            if (
                not any(part.startswith(PART) for part in relative.parts[:-1])
                and SET_ASIDE not in relative.parts
            ):
                with contextlib.suppress(FileNotFoundError):  # finished meanwhile
                    found.append(_entry(relative.as_posix(), path.stat()))
        return found

    @override
    def remove(self, name: str) -> None:
        path = self.root / name
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise StoreError(f"cannot remove {path}: {error.strerror or error}") from error

    @override
    def move(self, name: str, target: str) -> None:
        with self._reading(name):
            make_folder((self.root / target).parent)
            (self.root / name).rename(self.root / target)

    @override
    @contextlib.contextmanager
    def draft(self, suffix: str) -> Iterator[Path]:
        with temporary_in(self.root, suffix) as draft:
            yield draft

    @override
    def settle(self, draft: Path, name: str) -> None:
        path = self.root / name
        with contextlib.suppress(FileNotFoundError):
            # After a power cut a file may be there that is shorter than it was to be.
            if path.stat().st_size == draft.stat().st_size:
                return
        with self._mutex:
            is_later = self._pending is not None
            if self._pending is not None:
                self._pending |= {path, path.parent}
        settle(draft, path, is_flushed=not is_later)

    @override
    def open(self, name: str) -> BufferedReader:
        with self._reading(name):
            return (self.root / name).open("rb")

    @override
    def path(self, name: str) -> Path | None:
        return self.root / name

    @override
    @contextlib.contextmanager
    def guard(self, name: str, *, is_shared: bool = False) -> Iterator[None]:
        with locked(self.root / f"{name}{LOCK_SUFFIX}", is_shared=is_shared):
            yield

    @override
    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        with self._mutex:
            is_outermost = self._pending is None
            if self._pending is None:
                self._pending = set()
        try:
            yield
        finally:
            if is_outermost:
                with self._mutex:
                    pending, self._pending = self._pending or set(), None
                try:
                    _flush_all(self.root, pending)
                except OSError as error:
                    raise StoreError(f"cannot write into {self.root}: {error.strerror or error}") from error

    @contextlib.contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        try:
            yield
        except (FileNotFoundError, NotADirectoryError):
            raise AbsentError(f"{self.root / name}: not there") from None
        except OSError as error:
            raise StoreError(f"{self.root / name}: {error.strerror or error}") from error

    def _walk(self, folder: str) -> Iterator[tuple[str, "os.DirEntry[str]"]]:
        try:
            with os.scandir(self.root / folder) as found:
                for each in found:
                    if each.name.startswith(PART) or each.name.endswith(LOCK_SUFFIX):
                        continue
                    name = f"{folder}/{each.name}" if folder else each.name
                    if not each.is_dir(follow_symlinks=False):
                        yield name, each
                    elif name != SET_ASIDE:
                        yield from self._walk(name)
        except (FileNotFoundError, NotADirectoryError):
            return
        except OSError as error:
            raise StoreError(f"{self.root / folder}: {error.strerror or error}") from error


def _entry(name: str, status: os.stat_result) -> Entry:
    return Entry(name=name, n_bytes=status.st_size, modified_s=status.st_mtime)


def _flush_all(root: Path, paths: Iterable[Path]) -> None:
    ordered = sorted(paths)
    if len(ordered) >= _MANY and _flush_file_system(root):
        return
    with ThreadPoolExecutor(_FLUSHERS) as pool:
        list(pool.map(lambda path: flush([path]), ordered))


def _flush_file_system(root: Path) -> bool:
    """Make everything on a file system durable with one wait; say whether the system can do that.

    Source: syncfs(2), Linux man-pages.
    """
    syncfs = getattr(ctypes.CDLL(None, use_errno=True), "syncfs", None) if sys.platform == "linux" else None
    if syncfs is None:
        return False
    descriptor = os.open(root, os.O_RDONLY)
    try:
        if syncfs(descriptor) == 0:
            return True
        number = ctypes.get_errno()
    finally:
        os.close(descriptor)
    raise StoreError(f"cannot write into {root}: {os.strerror(number)}")
