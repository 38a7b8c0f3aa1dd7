"""Shards: many tables in one Parquet file, each in row groups of its own, found by the hash of its content.

``shards/TABLE/HASH.parquet`` is plain Parquet: every reader sees one long table, and skips by the statistics
of ``episode_id`` what it does not ask for. The footer says which row groups hold which content, so that one
table is read without looking at the others. Shards are added whole and never changed.
"""

import hashlib
import json
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import pyarrow as pa
import pyarrow.parquet as pq

from demoplan.errors import StoreError
from demoplan.store.encodings import encodings_of
from demoplan.store.places import AbsentError, Entry, NewerError, Place

SHARD_FORMAT = "1"

_MOST_FOOTERS = 16

_LOOK_AGAIN_S = 2.0
"""Whether something is there is not asked of the listing of a bucket more often than this [s]."""

FOLDER = "shards"
RECORDS = "records"
"""Folder below ``shards`` that holds records and no tables."""

_FORMAT_KEY, _CONTENTS_KEY = b"demoplan.shard_format", b"demoplan.contents"


@dataclass(frozen=True, kw_only=True)
class Spot:
    """Where in a shard a table is."""

    shard: str
    """Name of the shard in its place."""
    first_row_group: int
    n_row_groups: int


class Shards:
    """The shards of a store. Their footers are read once each; the listing, when something is not found."""

    def __init__(self, place: Place) -> None:
        """Use a place; the folder is made when something is first written."""
        self._place = place
        self._spots: dict[str, dict[str, Spot]] = {}
        """Shard → content → where it is."""
        self._footers: dict[str, pq.FileMetaData] = {}
        """The footers that were read last."""
        self._looked_s = -_LOOK_AGAIN_S

    def entries(self) -> list[Entry]:
        """Every shard of tables, without its content."""
        return [
            entry
            for entry in self._place.entries(FOLDER)
            if entry.name.endswith(".parquet") and PurePosixPath(entry.name).parts[1] != RECORDS
        ]

    def find(self, content: str, *, is_fresh: bool = False) -> Spot | None:
        """Where a table is; None if no shard holds it.

        Args:
            content: Hash of the table.
            is_fresh: Whether to look for new shards even if that was done a moment ago.
        """
        for spots in self._spots.values():
            if content in spots:
                return spots[content]
        is_costly = self._place.path("") is None
        if is_costly and not is_fresh and time.monotonic() - self._looked_s < _LOOK_AGAIN_S:
            return None
        return self.contents().get(content)

    def contents(self) -> dict[str, Spot]:
        """Content → where it is, of all shards that are there now.

        What a damaged shard holds counts as not there, so that it is made again; verifying finds it.
        """
        self._looked_s = time.monotonic()
        names = {entry.name for entry in self.entries()}
        self._spots = {name: spots for name, spots in self._spots.items() if name in names}
        for name in sorted(names - self._spots.keys()):
            try:
                self._spots[name] = self.spots_of(name)
            except NewerError:
                raise
            except StoreError:
                self._spots[name] = {}
        return {content: spot for _, spots in sorted(self._spots.items()) for content, spot in spots.items()}

    def spots_of(self, name: str) -> dict[str, Spot]:
        """What a shard holds, from its footer.

        Raises:
            StoreError: If it is not a shard, or a newer one than this version reads.
        """
        where = f"{self._place.location}: {name}"
        try:
            with self._open(name) as file:
                noted = file.metadata.metadata or {}
            written = noted[_FORMAT_KEY].decode()
            listed = json.loads(noted[_CONTENTS_KEY])
        except (pa.ArrowException, OSError, KeyError, ValueError) as error:
            raise StoreError(
                f"{where}: not a shard: {error}; `demoplan store repair` sets it aside"
            ) from None
        if written != SHARD_FORMAT:
            raise NewerError(where, "shard format", written, SHARD_FORMAT)
        return {
            str(content): Spot(shard=name, first_row_group=int(first), n_row_groups=int(number))
            for content, first, number in listed
        }

    def read(self, content: str) -> pa.Table:
        """A table as it was written: only its row groups are read.

        Raises:
            AbsentError: If no shard holds it.
            StoreError: If the shard cannot be read.
        """
        spot = self.find(content, is_fresh=True)
        try:
            if spot is not None:
                return self.read_spot(spot)
        except AbsentError:  # joined with another shard, and swept
            spot = self.contents().get(content)
            if spot is not None:
                return self.read_spot(spot)
        raise AbsentError(f"table {content} is not in the store {self._place.location}")

    def read_spot(self, spot: Spot) -> pa.Table:
        """The table of a spot."""
        groups = range(spot.first_row_group, spot.first_row_group + spot.n_row_groups)
        try:
            with self._open(spot.shard) as file:
                table = file.read_row_groups(list(groups), use_threads=False)
                return table.replace_schema_metadata(file.schema_arrow.metadata)
        except (pa.ArrowException, OSError) as error:
            raise StoreError(
                f"{self._place.location}: {spot.shard} cannot be read: {error}; "
                "`demoplan store repair` sets it aside, `demoplan reprocess` makes its tables again"
            ) from None

    def _open(self, name: str) -> pq.ParquetFile:
        path = self._place.path(name)
        footer = self._footers.get(name)
        if path is None:
            file = pq.ParquetFile(pa.PythonFile(self._place.open(name), mode="r"), metadata=footer)
        else:
            try:
                file = pq.ParquetFile(path, metadata=footer)
            except FileNotFoundError:
                raise AbsentError(f"{path}: not there") from None
        if footer is None:
            # Reading a footer of a thousand row groups takes longer than reading one of these.
            while len(self._footers) >= _MOST_FOOTERS:
                self._footers.pop(next(iter(self._footers)), None)
            self._footers[name] = file.metadata
        return file

    def is_intact(self, name: str) -> bool:
        """Whether the bytes of a shard still have the hash that names it."""
        try:
            with self._place.open(name) as file:
                return hashlib.file_digest(file, "sha256").hexdigest() == PurePosixPath(name).stem
        except AbsentError:
            return False


def write_shard(parts: Iterable[tuple[str, pa.Table]], path: Path) -> str:
    """Write tables of one schema into a local file, in this order, and give back the hash of its bytes.

    Args:
        parts: Content and table; there is at least one.
        path: The file.
    """
    listed: list[tuple[str, int, int]] = []
    writer: pq.ParquetWriter | None = None
    n_groups = 0
    try:
        for content, table in parts:
            if writer is None:
                writer = pq.ParquetWriter(path, table.schema, **encodings_of(table.schema, ("episode_id",)))
            if len(table):
                writer.write_table(table, row_group_size=len(table))
            listed.append((content, n_groups, int(len(table) > 0)))
            n_groups += int(len(table) > 0)
        assert writer is not None
        writer.add_key_value_metadata({_FORMAT_KEY: SHARD_FORMAT.encode(), _CONTENTS_KEY: json.dumps(listed)})
    finally:
        if writer is not None:
            writer.close()
    with path.open("rb", buffering=0) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
