"""Logs in a bucket: fetched beside a dataset, each once, whole or not at all."""

import hashlib
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from demoplan.errors import StoreError
from demoplan.pipeline.episodes.arrivals import BAG_METADATA, LOG_SUFFIXES
from demoplan.store.atomic import settle, temporary_in
from demoplan.store.places import Entry, Place

_CHUNK_BYTES = 8 << 20


@dataclass(frozen=True, order=True)
class Fetched:
    """An object of a bucket that is, or belongs to, a log."""

    file: str
    """Relative to the dataset's root, as in the bucket."""
    n_bytes: int
    sha256: str = ""
    """Of the bytes that were written; empty if it was not fetched."""
    refusal: str = ""
    """Why it was not fetched, if it was not."""


def fetch_logs(
    place: Place,
    root: Path,
    *,
    quiet_s: float = 30.0,
    now_s: float | None = None,
    on_done: Callable[[Fetched], None] = lambda _: None,
) -> list[Fetched]:
    """Bring logs of a bucket that are not below ``root`` yet there; what is there is never written over.

    Args:
        place: The bucket, or any other place.
        root: Where the logs of the dataset are.
        quiet_s: Of a log in a folder, nothing is fetched until its last part is so old [s].
        now_s: The time now, as seconds since the epoch; the wall clock if it is not given.
        on_done: Called with each log that was not there.

    Returns:
        What is new, sorted by name; logs that are here already with the same length are left out.

    Raises:
        StoreError: If the bucket cannot be read, the folder not written, or a log changed meanwhile.
    """
    now_s = time.time() if now_s is None else now_s
    found = [entry for entry in place.entries("") if _is_log(entry.name)]
    newest_s: dict[PurePosixPath, float] = {}
    for entry in found:
        whole = _whole(entry.name)
        newest_s[whole] = max(newest_s.get(whole, entry.modified_s), entry.modified_s)
    fetched = []
    for entry in found:
        result = _fetch(place, root, entry, now_s - newest_s[_whole(entry.name)] < quiet_s)
        if result is not None:
            fetched.append(result)
            on_done(result)
    return sorted(fetched)


def _is_log(name: str) -> bool:
    path = PurePosixPath(name)
    return path.suffix in LOG_SUFFIXES or (path.name == BAG_METADATA and len(path.parts) > 1)


def _whole(name: str) -> PurePosixPath:
    """What arrives together: the folder of a rosbag2, or the object itself."""
    path = PurePosixPath(name)
    return path.parent if len(path.parts) > 1 else path


def _fetch(place: Place, root: Path, entry: Entry, is_arriving: bool) -> Fetched | None:
    """Bring one object; None if it is here."""
    name = entry.name
    path = root / name
    # Names come from outside: they may point nowhere but below the root.
    if not path.resolve().is_relative_to(root.resolve()) or "\\" in name:
        return Fetched(name, entry.n_bytes, refusal="its name leads out of the dataset's folder")
    if path.exists():
        n_bytes = path.stat().st_size
        if n_bytes == entry.n_bytes:
            return None
        refusal = f"is here already, with {n_bytes} bytes in place of {entry.n_bytes}; logs are not replaced"
        return Fetched(name, entry.n_bytes, refusal=refusal)
    if is_arriving:
        return Fetched(name, entry.n_bytes, refusal="is still arriving")
    digest, n_bytes = hashlib.sha256(), 0
    with temporary_in(path.parent, path.suffix) as temporary:
        with temporary.open("wb") as file:
            for chunk in _chunks(place, name):
                file.write(chunk)
                digest.update(chunk)
                n_bytes += len(chunk)
        if n_bytes != entry.n_bytes:
            raise StoreError(f"{name}: {n_bytes} bytes came, {entry.n_bytes} were told; it changed meanwhile")
        # As old as it is there, so that it counts as settled here too.
        os.utime(temporary, (entry.modified_s, entry.modified_s))
        settle(temporary, path)
    return Fetched(name, entry.n_bytes, sha256=digest.hexdigest())


def _chunks(place: Place, name: str) -> Iterator[bytes]:
    with place.open(name) as file:
        while chunk := file.read(_CHUNK_BYTES):
            yield chunk
