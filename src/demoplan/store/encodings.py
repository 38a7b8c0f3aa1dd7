"""How columns are written as Parquet: what costs little time for its size."""

from collections.abc import Collection
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq


def encodings_of(schema: pa.Schema, searched: Collection[str] = ()) -> dict[str, Any]:
    """Options of the Parquet writer for a table of that schema.

    Texts repeat, so they go through a dictionary; numbers hardly do. Whole numbers are stamps and indexes:
    their steps are small, and they are searched by range, so they have statistics.

    Args:
        schema: Columns and their types.
        searched: Columns of text that are searched too.
    """
    sink = pa.BufferOutputStream()
    pq.write_table(schema.empty_table(), sink)
    columns = pq.ParquetFile(pa.BufferReader(sink.getvalue())).schema
    by_type: dict[str, list[str]] = {}
    for column in (columns.column(index) for index in range(len(columns))):
        by_type.setdefault(column.physical_type, []).append(column.path)
    whole, texts = by_type.get("INT64", []), by_type.get("BYTE_ARRAY", [])
    return {
        "compression": "lz4",
        "use_dictionary": texts,
        "column_encoding": dict.fromkeys(whole, "DELTA_BINARY_PACKED"),
        "write_statistics": [*whole, *(text for text in texts if text in searched)],
    }
