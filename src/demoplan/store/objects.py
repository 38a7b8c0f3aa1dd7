"""Tables as Parquet, named by the hash of their bytes."""

import hashlib
from pathlib import Path
from typing import TypeVar

import dataframely as dy
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from demoplan.errors import StoreError
from demoplan.ids import ContentHash
from demoplan.store.atomic import replacing

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
        """Write a table, validated against its declaration, and give back the hash of its bytes.

        Equal tables give equal bytes and are written once.
        """
        validated = schema.validate(table, cast=True)
        sink = pa.BufferOutputStream()
        pq.write_table(
            _described(validated.to_arrow(compat_level=pl.CompatLevel.oldest()), schema),
            sink,
            compression="zstd",
            compression_level=1,
            row_group_size=1 << 20,
        )
        data = sink.getvalue()
        content = ContentHash(hashlib.sha256(memoryview(data)).hexdigest())
        if not self.has(content):
            with replacing(self.path_of(content)) as temporary, temporary.open("wb") as file:
                file.write(memoryview(data))
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
        return schema.validate(table, cast=True)

    def is_intact(self, content: ContentHash) -> bool:
        """Whether the bytes that are there still have the hash that names them."""
        path = self.path_of(content)
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == content


def _described(table: pa.Table, schema: type[dy.Schema]) -> pa.Table:
    """The table with each column's description and unit in its field metadata."""
    fields = []
    for field in table.schema:
        column = schema.columns()[field.name]
        notes = {"description": column.description or "", **(column.metadata or {})}
        fields.append(field.with_metadata({key: str(value) for key, value in notes.items() if value}))
    return table.cast(
        pa.schema(fields, metadata={"demoplan.table": schema.__name__, "demoplan.table_format": TABLE_FORMAT})
    )
