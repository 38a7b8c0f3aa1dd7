"""A place in a bucket of an S3-compatible object store.

Which server, region and credentials is asked of the environment only, by the names that all S3 tools know:
``AWS_ENDPOINT_URL``, ``AWS_REGION``, ``AWS_ACCESS_KEY_ID``, ``AWS_SECRET_ACCESS_KEY``, ``AWS_SESSION_TOKEN``.
The server must honour ``If-None-Match`` and ``If-Match`` when something is written: that is what keeps
writers from losing each other's work, since nobody can hold a lock on a bucket.

Source: Amazon S3 User Guide, "How to prevent object overwrites with conditional writes".
"""

import base64
import contextlib
import io
import os
import random
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from typing_extensions import override

from demoplan.errors import StoreError
from demoplan.store.places import BUCKET_SCHEME, AbsentError, Entry, Place

if TYPE_CHECKING:
    from typing_extensions import Buffer

try:
    import obstore
    from obstore import exceptions
    from obstore.store import S3Store
except ImportError as error:
    raise StoreError(
        f"a store at {BUCKET_SCHEME}… needs the package obstore: pip install 'demoplan[s3]' ({error})"
    ) from None

_NO_BUCKET = "there is no such bucket"
_RETRIED = "max_retries"
"""Stands in errors of requests that the library has sent more than once."""

_LINES = ".lines"
"""Folder of the lines that were added to a name: each is an empty object that is called as the line reads."""


@dataclass(frozen=True, kw_only=True)
class BucketParams:
    """How patient one is with a server."""

    n_retries: int = 6
    """Times that a request is sent again which the server refused or did not answer."""
    first_pause_s: float = 0.2
    longest_pause_s: float = 5.0
    """Pauses between these are doubled each time, and varied at random so that writers do not keep step."""
    request_timeout_s: float = 60.0
    """How long one request may take, its content included."""
    connect_timeout_s: float = 5.0
    overall_s: float = 180.0
    """How long a request may take with all that it is sent again."""
    n_updates: int = 60
    """Times that a change is made anew because another writer was quicker."""


class Bucket(Place):
    """Objects below a prefix of a bucket: the server puts each in place as a whole."""

    least_grace_s = 3600.0

    def __init__(self, url: str, params: BucketParams = BucketParams()) -> None:
        """Use ``s3://BUCKET/PREFIX``; nothing is asked of the server yet.

        Raises:
            StoreError: If the URL names no bucket, or holds more than bucket and prefix.
        """
        parts = urlsplit(url)
        if parts.username or parts.password or parts.query or parts.fragment or not parts.netloc:
            shown = f"{BUCKET_SCHEME}{parts.hostname or ''}{parts.path}"
            raise StoreError(
                f"{shown}: expected {BUCKET_SCHEME}BUCKET/PREFIX and nothing else; credentials come from "
                "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
            )
        prefix = parts.path.strip("/")
        self.location = f"{BUCKET_SCHEME}{parts.netloc}/{prefix}".rstrip("/")
        self._params = params
        self._random = random.Random()  # noqa: S311 - for pauses
        endpoint = os.environ.get("AWS_ENDPOINT_URL") or os.environ.get("AWS_ENDPOINT") or ""
        self._store = S3Store(
            parts.netloc,
            prefix=prefix or None,
            client_options={
                "timeout": timedelta(seconds=params.request_timeout_s),
                "connect_timeout": timedelta(seconds=params.connect_timeout_s),
                "allow_http": endpoint.startswith("http://"),
            },
            retry_config={
                "max_retries": params.n_retries,
                "retry_timeout": timedelta(seconds=params.overall_s),
                "backoff": {
                    "init_backoff": timedelta(seconds=params.first_pause_s),
                    "max_backoff": timedelta(seconds=params.longest_pause_s),
                    "base": 2,
                },
            },
        )

    @override
    def exists(self) -> bool:
        with self._asking("", "there is no such bucket"):
            return any(len(chunk) for chunk in obstore.list(self._store, chunk_size=1))

    @override
    def read(self, name: str) -> bytes:
        return self._read(name)[0]

    def _read(self, name: str) -> tuple[bytes, str | None]:
        """Content, and the tag of its version."""
        with self._asking(name):
            found = obstore.get(self._store, name)
            return bytes(found.bytes()), found.meta["e_tag"]

    @override
    def write(self, name: str, data: bytes) -> None:
        with self._asking(name, _NO_BUCKET):
            obstore.put(self._store, name, data, use_multipart=False)

    @override
    def create(self, name: str, data: bytes) -> bool:
        return self._put_if(name, data, None)

    def _put_if(self, name: str, data: bytes, tag: str | None) -> bool:
        """Write if the version is still that one, or nothing is there; say whether it was.

        The library does not send a conditional write again that was not answered, since the first may have
        been done. Here it may: the second is then refused, and ``False`` says that something is there.
        """
        mode: Any = "create" if tag is None else {"e_tag": tag}
        with self._asking(name, _NO_BUCKET):
            for attempt in range(self._params.n_retries + 1):
                try:
                    obstore.put(self._store, name, data, mode=mode, use_multipart=False)
                    return True
                except (exceptions.AlreadyExistsError, exceptions.PreconditionError):
                    return False
                except exceptions.GenericError as error:
                    if _RETRIED in _short(error) or attempt == self._params.n_retries:
                        raise
                self._pause(attempt)
        raise AssertionError("unreachable")

    def _pause(self, attempt: int) -> None:
        longest_s = min(self._params.longest_pause_s, self._params.first_pause_s * 2**attempt)
        time.sleep(self._random.uniform(0.0, longest_s))

    @override
    def update(self, name: str, change: Callable[[bytes | None], bytes | None]) -> None:
        for attempt in range(self._params.n_updates):
            try:
                found, tag = self._read(name)
            except AbsentError:
                changed, tag = change(None), None
            else:
                changed = change(found)
                if changed == found:
                    return
            if changed is None:
                return
            if self._put_if(name, changed, tag):
                return
            self._pause(attempt)
        raise StoreError(
            f"{self.location}: {name}: other writers changed it {self._params.n_updates} times in a row"
        )

    @override
    def add_line(self, name: str, line: bytes) -> None:
        written = base64.urlsafe_b64encode(line.rstrip(b"\n")).decode()
        self.write(f"{name}{_LINES}/{written}", b"")

    @override
    def lines(self, name: str) -> list[bytes]:
        entries = sorted(self.entries(f"{name}{_LINES}"), key=lambda entry: entry.modified_s)
        return [base64.urlsafe_b64decode(entry.name.rpartition("/")[2]) for entry in entries]

    @override
    def entry(self, name: str) -> Entry | None:
        try:
            with self._asking(name):
                return _entry(obstore.head(self._store, name))
        except AbsentError:
            return None

    @override
    def names(self, folder: str) -> list[str]:
        return [entry.name for entry in self.entries(folder)]

    @override
    def entries(self, folder: str) -> list[Entry]:
        with self._asking(folder):
            found = [_entry(meta) for chunk in obstore.list(self._store, folder or None) for meta in chunk]
        return sorted(found, key=lambda entry: entry.name)

    @override
    def leftovers(self) -> list[Entry]:
        return []

    @override
    def remove(self, name: str) -> None:
        with contextlib.suppress(AbsentError), self._asking(name):
            obstore.delete(self._store, name)

    @override
    def move(self, name: str, target: str) -> None:
        with self._asking(name):
            obstore.copy(self._store, name, target)
            obstore.delete(self._store, name)

    @override
    @contextlib.contextmanager
    def draft(self, suffix: str) -> Iterator[Path]:
        try:
            with tempfile.TemporaryDirectory(prefix="demoplan-") as folder:
                yield Path(folder) / f"draft{suffix}"
        except OSError as error:
            folder = tempfile.gettempdir()
            raise StoreError(f"cannot write into {folder}: {error.strerror or error}") from error

    @override
    def settle(self, draft: Path, name: str) -> None:
        data = draft.read_bytes()
        if self.create(name, data):
            return
        found = self.entry(name)
        # Whoever sweeps now may have seen it old and unnamed; written again, it is young.
        is_old = found is None or time.time() - found.modified_s > self.least_grace_s / 4
        if is_old or found is None or found.n_bytes != len(data):
            self.write(name, data)

    @override
    def open(self, name: str) -> BufferedReader:
        with self._asking(name):
            return BufferedReader(_Ranges(self, name, int(obstore.head(self._store, name)["size"])), 1 << 16)

    def read_range(self, name: str, start: int, end: int) -> bytes:
        """Part of a content: bytes ``[start, end)``."""
        with self._asking(name):
            return bytes(obstore.get_range(self._store, name, start=start, end=end))

    @override
    def path(self, name: str) -> Path | None:
        return None

    @override
    @contextlib.contextmanager
    def guard(self, name: str, *, is_shared: bool = False) -> Iterator[None]:
        yield

    @override
    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        yield

    @contextlib.contextmanager
    def _asking(self, name: str, absent: str = "not there") -> Iterator[None]:
        """Errors of the library as our own; they tell what the server said, which holds no credentials."""
        try:
            yield
        except FileNotFoundError:
            raise AbsentError(f"{self.location}/{name}: {absent}") from None
        except (exceptions.UnauthenticatedError, exceptions.PermissionDeniedError) as error:
            raise StoreError(f"{self.location}/{name}: the server refuses access: {_short(error)}") from None
        except (exceptions.BaseError, OSError, ValueError) as error:
            raise StoreError(
                f"{self.location}/{name}: no use after {self._params.n_retries} retries: {_short(error)}"
            ) from None


class _Ranges(io.RawIOBase):
    """An object that is read where it is sought."""

    def __init__(self, bucket: Bucket, name: str, n_bytes: int) -> None:
        self._bucket = bucket
        self._name = name
        self._n_bytes = n_bytes
        self._at = 0

    @override
    def readable(self) -> bool:
        return True

    @override
    def seekable(self) -> bool:
        return True

    @override
    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._n_bytes}[whence]
        self._at = max(0, base + offset)
        return self._at

    @override
    def readinto(self, buffer: "Buffer", /) -> int:
        view = memoryview(buffer).cast("B")
        end = min(self._at + len(view), self._n_bytes)
        if end <= self._at:
            return 0
        data = self._bucket.read_range(self._name, self._at, end)
        view[: len(data)] = data
        self._at += len(data)
        return len(data)


def _entry(meta: Any) -> Entry:
    return Entry(
        name=str(meta["path"]), n_bytes=int(meta["size"]), modified_s=meta["last_modified"].timestamp()
    )


def _short(error: Exception, limit: int = 300) -> str:
    """The first line of what a library says: the rest is its own inside."""
    text = str(error).strip().partition("\n")[0]
    return text if len(text) <= limit else text[: limit - 1] + "…"
