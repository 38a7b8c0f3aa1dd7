"""Tables as Parquet, named by the hash of their bytes."""

import functools
import hashlib
from pathlib import Path
from typing import Any, TypeVar

import dataframely as dy
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from demoplan.errors import StoreError
from demoplan.ids import ContentHash
from demoplan.store.atomic import settle, temporary_in
from demoplan.tables.validating import is_typed, validated

TABLE_FORMAT = "1"
"""Version of the form in which tables are written; a reader refuses a newer one."""

Table = TypeVar("Table", bound=dy.Schema)


class ObjectStore:
    """A folder of tables: ``ab/abcd….parquet`` for the table whose bytes have that hash."""

    def __init__(self, root: Path) -> None:
        """Use ``root``; it is made when something is first written."""
        self.root = root

    def path_of(self, content: ContentHash) -> Path:
        """Where the table of that hash is."""
        return self.root / content[:2] / f"{content}.parquet"

    def has(self, content: ContentHash) -> bool:
        """Whether a table of that hash is there."""
        return self.path_of(content).is_file()

    def put(self, table: pl.DataFrame, schema: type[dy.Schema]) -> ContentHash:
        """Write a table, and give back the hash of its bytes. Equal tables give equal bytes, written once.

        Stages hold what they give to its declaration, so only the columns and their types are looked at
        here; a table that differs in these is cast, and all its rules are checked.
        """
        typed = table if is_typed(table, schema) else validated(table, schema)
        described = _described(typed.to_arrow(compat_level=pl.CompatLevel.oldest()), schema)
        # Its name is not known before it is written; held in memory, it would cost more than it does on disk.
        with temporary_in(self.root, ".parquet") as temporary:
            with pa.OSFile(str(temporary), "wb") as sink:
                pq.write_table(described, sink, row_group_size=1 << 20, **_encodings(schema))
            with temporary.open("rb", buffering=0) as file:
                content = ContentHash(hashlib.file_digest(file, "sha256").hexdigest())
            if not self.has(content):
                settle(temporary, self.path_of(content))
        return content

    def get(self, content: ContentHash, schema: type[Table]) -> dy.DataFrame[Table]:
        """Read a table back.

        Raises:
            StoreError: If it is not there, is not Parquet, or was written in a newer form.
        """
        path = self.path_of(content)
        try:
            found = pq.read_schema(path).metadata or {}
            table = pl.read_parquet(path, use_pyarrow=False, glob=False)
        except FileNotFoundError:
            raise StoreError(f"table {content} is not in the store {self.root}") from None
        except (OSError, pa.ArrowException, pl.exceptions.PolarsError) as error:
            raise StoreError(f"{path}: not a readable table: {error}; run `demoplan run` again") from None
        written = found.get(b"demoplan.table_format", b"?").decode()
        if written != TABLE_FORMAT:
            raise StoreError(f"{path}: written in table format {written}; this version reads {TABLE_FORMAT}")
        return validated(table, schema)

    def is_intact(self, content: ContentHash) -> bool:
        """Whether the bytes that are there still have the hash that names them."""
        path = self.path_of(content)
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == content


@functools.cache
def _encodings(schema: type[dy.Schema]) -> dict[str, Any]:
    """How the columns of a table are written: what costs little time for its size.

    Texts repeat, so they go through a dictionary; numbers hardly do. Whole numbers are stamps and indexes:
    their steps are small. Only they are ever searched by range, so only they have statistics.
    """
    described = _described(schema.create_empty().to_arrow(compat_level=pl.CompatLevel.oldest()), schema)
    sink = pa.BufferOutputStream()
    pq.write_table(described, sink)
    columns = pq.ParquetFile(pa.BufferReader(sink.getvalue())).schema
    by_type: dict[str, list[str]] = {}
    for column in (columns.column(index) for index in range(len(columns))):
        by_type.setdefault(column.physical_type, []).append(column.path)
    whole = by_type.get("INT64", [])
    return {
        "compression": "lz4",
        "use_dictionary": by_type.get("BYTE_ARRAY", []),
        "column_encoding": dict.fromkeys(whole, "DELTA_BINARY_PACKED"),
        "write_statistics": whole,
    }


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
    return pa.Table.from_arrays(
        table.columns,
        schema=pa.schema(
            [field.with_metadata(notes[field.name]) for field in table.schema],
            metadata={"demoplan.table": schema.__name__, "demoplan.table_format": TABLE_FORMAT},
        ),
    )
