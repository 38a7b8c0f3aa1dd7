"""Tables as Parquet, named by the hash of their bytes."""

import contextlib
import functools
import hashlib
import itertools
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import dataframely as dy
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from demoplan.errors import StoreError
from demoplan.ids import ContentHash
from demoplan.store.encodings import encodings_of
from demoplan.store.places import AbsentError, NewerError, Place
from demoplan.store.shards import Shards
from demoplan.tables.migrating import migrated, version_of
from demoplan.tables.validating import are_rows_valid, is_typed, validated

TABLE_FORMAT = "1"
"""Version of the form in which tables are written; a reader refuses a newer one."""

ROWS_AT_ONCE = 1 << 20
"""Rows of a table that are written as one group; a longer table can be written and read in parts."""

ROWS_IN_PART = 1 << 17
"""Rows of a long table that are read at once."""

_REQUESTS = 16
"""Tables of a bucket that are asked for at once."""

_FORMAT, _VERSION = b"demoplan.table_format", b"demoplan.table_version"

Table = TypeVar("Table", bound=dy.Schema)


@dataclass(frozen=True, eq=False)
class Draft:
    """A table that is written and has no name yet."""

    path: Path
    content: ContentHash

    def parts(self, schema: type[Table]) -> Iterator[dy.DataFrame[Table]]:
        """The rows, some at a time."""
        return parts_of(self.path, schema)


class ObjectStore:
    """Tables by content: ``ab/abcd….parquet`` is the one whose bytes have that hash, or a shard holds it."""

    folder = "objects"

    def __init__(self, place: Place, shards: Shards) -> None:
        """Use ``objects/`` of a place, and its shards."""
        self._place = place
        self._shards = shards

    def name_of(self, content: ContentHash) -> str:
        """What the table of that hash is called in its place."""
        return f"{self.folder}/{content[:2]}/{content}.parquet"

    def path_of(self, content: ContentHash) -> Path:
        """Where the table of that hash is on this machine.

        Raises:
            StoreError: If the store is not a folder.
        """
        path = self._place.path(self.name_of(content))
        if path is None:
            raise StoreError(f"{self._place.location} is not a folder: its tables have no paths")
        return path

    def has(self, content: ContentHash) -> bool:
        """Whether a table of that hash is there."""
        return self.has_loose(content) or self._shards.find(content) is not None

    def has_loose(self, content: ContentHash) -> bool:
        """Whether a table of that hash is there as a file of its own."""
        return self._place.entry(self.name_of(content)) is not None

    def contents(self) -> set[str]:
        """The hashes of all tables that are there, by one listing."""
        return self.loose() | self._shards.contents().keys()

    def loose(self) -> set[str]:
        """The hashes of all tables that are files of their own."""
        names = self._place.names(self.folder)
        return {PurePosixPath(name).stem for name in names if name.endswith(".parquet")}

    def put(self, table: pl.DataFrame | Draft, schema: type[dy.Schema]) -> ContentHash:
        """Write a table, and give back the hash of its bytes. Equal tables give equal bytes, written once.

        Stages hold what they give to its declaration, so only the columns and their types are looked at
        here; a table that differs in these is cast, and all its rules are checked.
        """
        if isinstance(table, Draft):
            self._place.settle(table.path, self.name_of(table.content))
            return table.content
        # Its name is not known before it is written; held in memory, it would cost more than it does on disk.
        with self._place.draft(".parquet") as draft:
            content = write_table(table, schema, draft)
            self._place.settle(draft, self.name_of(content))
        return content

    @contextlib.contextmanager
    def drafted(self, parts: Iterable[pl.DataFrame], schema: type[dy.Schema]) -> Iterator[Draft]:
        """Write a table whose rows come in parts; it is there when it is ``put`` before the block ends.

        The bytes are those of the parts put as one table. At most a group of rows, and a part, is held.
        """
        with self._place.draft(".parquet") as path:
            yield Draft(path, write_parts(parts, schema, path))

    def get(self, content: ContentHash, schema: type[Table]) -> dy.DataFrame[Table]:
        """Read a table back.

        Raises:
            StoreError: If it is not there, is not Parquet, or was written in a newer form.
        """
        try:
            return read_table(self._place, self.name_of(content), schema)
        except AbsentError:
            found = self._shards.read(content)
            table = pl.DataFrame(found)
            where = f"{self._place.location}: {content} in a shard"
            return read_as_declared(table, found.schema.metadata or {}, schema, where)

    def parts(self, content: ContentHash, schema: type[Table]) -> Iterator[dy.DataFrame[Table]]:
        """Read a table back, some rows at a time, each part held to its declaration.

        Raises:
            StoreError: If it is not there, is not Parquet, or was written in a newer form.
        """
        path = self._place.path(self.name_of(content))
        if path is None or not _is_of_today(path, schema):
            yield self.get(content, schema)
        else:
            yield from parts_of(path, schema)

    def n_rows(self, content: ContentHash) -> int | None:
        """How many rows a table has, as its file says; null if it is no file of this machine."""
        path = self._place.path(self.name_of(content))
        try:
            return None if path is None else int(pq.read_metadata(path).num_rows)
        except (OSError, pa.ArrowException):
            return None

    def extent(self, content: ContentHash, column: str) -> tuple[int, int] | None:
        """Least and greatest whole number in a column, as its file says; null if that does not say."""
        path = self._place.path(self.name_of(content))
        try:
            found = None if path is None else pq.read_metadata(path)
        except (OSError, pa.ArrowException):
            return None
        if found is None or not found.num_rows:
            return None
        index = found.schema.names.index(column)
        stated = [found.row_group(group).column(index).statistics for group in range(found.num_row_groups)]
        if not all(each is not None and each.has_min_max for each in stated):
            return None
        return min(each.min for each in stated), max(each.max for each in stated)

    def joined(self, contents: Sequence[ContentHash], schema: type[Table]) -> pl.DataFrame:
        """Tables one below the other, read at once where that can be: small ones take a tenth of the time.

        A key that is unique in each may come more than once.

        Raises:
            StoreError: If one is not there, is not Parquet, or was written in a newer form.
        """
        table = self._at_once(contents, schema) if len(contents) > 1 else None
        if table is not None:
            return table
        # Of a bucket, each is a request that waits for its answer.
        n_at_once = _REQUESTS if self._place.path("") is None else 1
        with ThreadPoolExecutor(n_at_once) as pool:
            parts = list(pool.map(lambda content: self.get(content, schema), contents))
        return pl.concat(parts) if parts else schema.create_empty()

    def _at_once(self, contents: Sequence[ContentHash], schema: type[Table]) -> pl.DataFrame | None:
        """None if one of the tables is not a file of today's form: then each is to be read by itself."""
        paths = [self._place.path(self.name_of(content)) for content in contents]
        files = [path for path in paths if path is not None]
        try:
            if not all(_is_of_today(path, schema) for path in files) or len(files) < len(contents):
                return None
            table = pl.read_parquet(files, use_pyarrow=False, glob=False)
        except (OSError, pa.ArrowException, pl.exceptions.PolarsError):
            return None
        return table if are_rows_valid(table, schema) else None

    def is_intact(self, content: ContentHash) -> bool:
        """Whether the bytes that are there still have the hash that names them."""
        try:
            with self._place.open(self.name_of(content)) as file:
                return hashlib.file_digest(file, "sha256").hexdigest() == content
        except AbsentError:
            return False


def write_table(table: pl.DataFrame, schema: type[dy.Schema], path: Path) -> ContentHash:
    """Write a table into a local file, and give back the hash of its bytes."""
    with pa.OSFile(str(path), "wb") as sink:
        pq.write_table(_to_arrow(table, schema), sink, row_group_size=ROWS_AT_ONCE, **_encodings(schema))
    return _hash_of(path)


def write_parts(
    parts: Iterable[pl.DataFrame], schema: type[dy.Schema], path: Path, rows_at_once: int = ROWS_AT_ONCE
) -> ContentHash:
    """Write a table whose rows come in parts: the same bytes as :func:`write_table` of all of them."""
    with (
        pa.OSFile(str(path), "wb") as sink,
        pq.ParquetWriter(
            sink, _to_arrow(schema.create_empty(), schema).schema, **_encodings(schema)
        ) as writer,
    ):
        waiting = [_to_arrow(schema.create_empty(), schema)]
        n_waiting = n_written = 0
        for part in parts:
            waiting.append(_to_arrow(part, schema))
            n_waiting += len(part)
            while n_waiting >= rows_at_once:
                table = pa.concat_tables(waiting)
                writer.write_table(table.slice(0, rows_at_once), row_group_size=rows_at_once)
                waiting, n_waiting = [table.slice(rows_at_once)], n_waiting - rows_at_once
                n_written += rows_at_once
                del table
        # A table without rows has one group without rows.
        if n_waiting or not n_written:
            writer.write_table(pa.concat_tables(waiting), row_group_size=rows_at_once)
    return _hash_of(path)


def _to_arrow(table: pl.DataFrame, schema: type[dy.Schema]) -> pa.Table:
    typed = table if is_typed(table, schema) else validated(table, schema)
    return _described(typed.to_arrow(compat_level=pl.CompatLevel.oldest()), schema)


def _hash_of(path: Path) -> ContentHash:
    with path.open("rb", buffering=0) as file:
        return ContentHash(hashlib.file_digest(file, "sha256").hexdigest())


def parts_of(path: Path, schema: type[Table], n_rows: int = ROWS_IN_PART) -> Iterator[dy.DataFrame[Table]]:
    """The rows of a file of today's form, so many at a time, each part held to its declaration."""
    table = pl.scan_parquet(path, glob=False)
    for start in itertools.count(0, n_rows):
        part = table.slice(start, n_rows).collect()
        if not len(part):
            return
        yield validated(part, schema)


def _is_of_today(path: Path, schema: type[dy.Schema]) -> bool:
    """Whether a file holds a table in the form in which it would be written now."""
    found = pq.read_schema(path).metadata or {}
    today = (TABLE_FORMAT.encode(), str(version_of(schema.__name__)).encode())
    return (found.get(_FORMAT), found.get(_VERSION, b"1")) == today


def read_table(place: Place, name: str, schema: type[Table]) -> dy.DataFrame[Table]:
    """Read a table of a place, held to its declaration.

    Raises:
        AbsentError: If it is not there.
        StoreError: If it is not Parquet, or was written in a newer form.
    """
    path = place.path(name)
    try:
        if path is None:
            held = place.read(name)
            found = pq.read_schema(pa.BufferReader(held)).metadata or {}
            table = pl.read_parquet(held, use_pyarrow=False)
        else:
            found = pq.read_schema(path).metadata or {}
            table = pl.read_parquet(path, use_pyarrow=False, glob=False)
    except FileNotFoundError:
        raise AbsentError(f"{place.location}: {name}: not there") from None
    except (OSError, pa.ArrowException, pl.exceptions.PolarsError) as error:
        raise StoreError(
            f"{place.location}: {name} is not a readable table: {' '.join(str(error).split())}; "
            "`demoplan store repair` sets it aside, `demoplan reprocess` makes it again"
        ) from None
    return read_as_declared(table, found, schema, f"{place.location}: {name}")


def read_as_declared(
    table: pl.DataFrame, metadata: dict[bytes, bytes], schema: type[Table], where: str
) -> dy.DataFrame[Table]:
    """A table that was read, held to its declaration.

    Raises:
        StoreError: If it was written in a newer form than this version knows.
    """
    written = metadata.get(_FORMAT, b"?").decode()
    if written != TABLE_FORMAT:
        raise NewerError(where, "table format", written, TABLE_FORMAT)
    name, version = schema.__name__, metadata.get(_VERSION, b"1").decode()
    if not version.isdecimal() or not 1 <= int(version) <= version_of(name):
        raise NewerError(where, f"{name} version", version, f"1 to {version_of(name)}")
    try:
        return validated(migrated(table, name, int(version)), schema)
    except (dy.exc.SchemaError, dy.exc.ValidationError, pl.exceptions.PolarsError) as error:
        raise StoreError(
            f"{where}: is not what {name} version {version} declares: {error}; "
            "`demoplan reprocess` makes it again"
        ) from None


@functools.cache
def _encodings(schema: type[dy.Schema]) -> dict[str, Any]:
    return encodings_of(_to_arrow(schema.create_empty(), schema).schema)


@functools.cache
def _notes_of(schema: type[dy.Schema]) -> dict[str, dict[str, str]]:
    """Column → what its field metadata says."""
    return {
        name: {
            key: str(value)
            for key, value in {"description": column.description or "", **(column.metadata or {})}.items()
            if value
        }
        for name, column in schema.columns().items()
    }


def _described(table: pa.Table, schema: type[dy.Schema]) -> pa.Table:
    """The table with each column's description and unit in its field metadata."""
    notes = _notes_of(schema)
    version = version_of(schema.__name__)
    # Version 1 is not written down, so that tables keep their hashes until they change.
    noted = {_VERSION: str(version).encode()} if version > 1 else {}
    return pa.Table.from_arrays(
        table.columns,
        schema=pa.schema(
            [field.with_metadata(notes[field.name]) for field in table.schema],
            metadata={
                b"demoplan.table": schema.__name__.encode(),
                _FORMAT: TABLE_FORMAT.encode(),
                **noted,
            },
        ),
    )
