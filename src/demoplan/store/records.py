"""Records: which output a stage gave for which input, parameters and code."""

import functools
import hashlib
import json
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import PurePosixPath

import dataframely as dy
import polars as pl
import pyarrow.parquet as pq

from demoplan.errors import StoreError
from demoplan.ids import ContentHash, content_hash
from demoplan.store.places import AbsentError, Place
from demoplan.tables.contracts import contract


@dataclass(frozen=True, kw_only=True)
class Record:
    """One run of one stage, complete: it is written after all that it names."""

    stage: str
    key: ContentHash
    inputs: dict[str, str]
    """Name of each input → hash of its content."""
    params: str
    """Parameters as canonical JSON."""
    code_version: str
    outputs: dict[str, str]
    """Name of each output table → hash of its content."""
    notes: dict[str, str]
    """What else is known of the run: a log's status, and its reason."""
    schemas: dict[str, str] = field(default_factory=dict)
    """Name of each output table → its declaration then, as ``Name:hash`` (see ``schema_version``)."""


def stage_key(stage: str, inputs: dict[str, str], params: str, code_version: str) -> ContentHash:
    """The key of a stage's output: equal keys stand for equal outputs."""
    return content_hash(stage, json.dumps(inputs, sort_keys=True), params, code_version)


@functools.cache
def schema_version(schema: type[dy.Schema]) -> str:
    """A table's declaration as ``Name:hash``: it changes with columns, types, units, key and rules."""
    return f"{schema.__name__}:{content_hash(json.dumps(contract(schema), sort_keys=True))[:16]}"


class RecordStore:
    """Records by stage and key: ``stage/key.json``, or a row of a pack."""

    folder = "records"

    def __init__(self, place: Place, packs: "Packs") -> None:
        """Use ``records/`` of a place, and its packs."""
        self._place = place
        self._packs = packs

    def name_of(self, stage: str, key: str) -> str:
        """What the record of that key is called in its place."""
        return f"{self.folder}/{stage}/{key}.json"

    def get(self, stage: str, key: str) -> Record | None:
        """The record of that key, or None if the stage has not run so.

        Raises:
            StoreError: If a record is there that cannot be read.
        """
        name = self.name_of(stage, key)
        try:
            return parse_record(self._place.read(name), f"{self._place.location}: {name}")
        except AbsentError:
            return self._packs.get(stage, key)

    def has(self, stage: str, key: str) -> bool:
        """Whether there is a record of that key."""
        is_loose = self._place.entry(self.name_of(stage, key)) is not None
        return is_loose or self._packs.get(stage, key) is not None

    def put(self, record: Record) -> None:
        """Write a record; its outputs must be there already."""
        with self._place.draft(".json") as draft:
            draft.write_bytes(render_record(record))
            self._place.settle(draft, self.name_of(record.stage, record.key))

    def keys(self) -> set[tuple[str, str]]:
        """Stage and key of every record, by one listing."""
        return self.loose() | self._packs.keys()

    def loose(self) -> set[tuple[str, str]]:
        """Stage and key of every record that is a file of its own."""
        found = set()
        for name in self._place.names(self.folder):
            path = PurePosixPath(name)
            if path.suffix == ".json":
                found.add((path.parent.name, path.stem))
        return found


_LOOK_AGAIN_S = 2.0
"""Whether a record is there is not asked of a bucket's listing more often than this [s]."""


class Packs:
    """Many records in one Parquet file: ``shards/records/HASH.parquet``, added whole and never changed.

    A pack is read as a whole when a record is first asked for that is no file of its own.
    """

    folder = "shards/records"

    def __init__(self, place: Place) -> None:
        """Use a place; the folder is made when something is first written."""
        self._place = place
        self._read: dict[str, dict[tuple[str, str], Record]] = {}
        """Pack → stage and key → record."""
        self._looked_s = -_LOOK_AGAIN_S

    def names(self) -> list[str]:
        """Every pack."""
        return [name for name in self._place.names(self.folder) if name.endswith(".parquet")]

    def get(self, stage: str, key: str) -> Record | None:
        """The record of that key; None if no pack holds it."""
        for records in self._read.values():
            if (stage, key) in records:
                return records[stage, key]
        is_costly = self._place.path("") is None
        if is_costly and time.monotonic() - self._looked_s < _LOOK_AGAIN_S:
            return None
        self._look()
        return next((r[stage, key] for r in self._read.values() if (stage, key) in r), None)

    def keys(self) -> set[tuple[str, str]]:
        """Stage and key of every record in a pack."""
        self._look()
        return {key for records in self._read.values() for key in records}

    def _look(self) -> None:
        """Read packs that are new, and forget those that are gone; a damaged one counts as empty."""
        self._looked_s = time.monotonic()
        names = self.names()
        self._read = {name: records for name, records in self._read.items() if name in names}
        for name in names:
            if name not in self._read:
                try:
                    self._read[name] = self.records_of(name)
                except StoreError:
                    self._read[name] = {}

    def records_of(self, name: str) -> dict[tuple[str, str], Record]:
        """What a pack holds.

        Raises:
            StoreError: If it is not a pack, or not the one that its name stands for.
        """
        data = self._place.read(name)
        where = f"{self._place.location}: {name}"
        if hashlib.sha256(data).hexdigest() != PurePosixPath(name).stem:
            raise StoreError(
                f"{where}: its content is not what its name says; `demoplan store repair` sets it aside"
            )
        try:
            rows = pl.read_parquet(data, use_pyarrow=False).rows(named=True)
            return {
                (row["stage"], row["key"]): Record(
                    **{name: json.loads(row[name]) if name in _PACKED_AS_JSON else row[name] for name in row}
                )
                for row in rows
            }
        except (pl.exceptions.PolarsError, ValueError, TypeError) as error:
            raise StoreError(f"{where}: not a pack of records: {error}") from None

    def put(self, records: Iterable[Record]) -> str:
        """Write a pack, and say what it is called: the same for the same records, in whatever order."""
        rows = []
        for record in sorted(records, key=lambda each: (each.stage, each.key)):
            values = asdict(record)
            rows.append(
                {n: json.dumps(v, sort_keys=True) if n in _PACKED_AS_JSON else v for n, v in values.items()}
            )
        with self._place.draft(".parquet") as draft:
            table = pl.DataFrame(rows, schema=dict.fromkeys(rows[0], pl.String))
            pq.write_table(table.to_arrow(compat_level=pl.CompatLevel.oldest()), draft, compression="zstd")
            name = f"{self.folder}/{hashlib.sha256(draft.read_bytes()).hexdigest()}.parquet"
            self._place.settle(draft, name)
        self._looked_s = -_LOOK_AGAIN_S
        return name


_PACKED_AS_JSON = ("inputs", "outputs", "notes", "schemas")


def render_record(record: Record) -> bytes:
    """A record as JSON that people can read, the same bytes for the same record."""
    return (json.dumps(asdict(record), sort_keys=True, indent=1) + "\n").encode()


def parse_record(text: bytes, where: str) -> Record:
    """A record from its JSON.

    Raises:
        StoreError: If it is not a record.
    """
    try:
        return Record(**json.loads(text))
    except (ValueError, TypeError) as error:
        raise StoreError(f"{where}: not a record: {error}; `demoplan store repair` sets it aside") from None
