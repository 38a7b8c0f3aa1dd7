"""The store as a whole, and the one way in which stages run over it."""

import contextlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.errors import StoreError
from demoplan.ids import ContentHash
from demoplan.store.domains import DomainStore
from demoplan.store.index import Index
from demoplan.store.manifest import Manifest
from demoplan.store.objects import Draft, ObjectStore, Table
from demoplan.store.opening import open_place
from demoplan.store.records import Packs, Record, RecordStore, schema_version, stage_key
from demoplan.store.shards import Shards
from demoplan.store.snapshots import Snapshots
from demoplan.store.timings import Timings

SWEEP = "sweep"
"""What writers share and sweeping has for itself."""


@dataclass(frozen=True, kw_only=True)
class StageOutput:
    """What a stage's function gives back: tables by name, with their declarations, and notes."""

    tables: Mapping[str, tuple[pl.DataFrame | Draft, type[dy.Schema]]]
    notes: Mapping[str, str] = field(default_factory=dict)


class Store:
    """Tables, records, a manifest and domain versions, in a folder or a bucket.

    ``objects/`` tables by content · ``records/`` what gave them · ``shards/`` many of both in few files ·
    ``manifest.json`` with ``states/``: what
    stands now · ``snapshots/`` what stood before · ``domains/`` versions · ``timings/`` what stages took ·
    ``reports/``, ``recordings/`` what can be made again from the rest.
    """

    def __init__(self, location: Path | str) -> None:
        """Use a folder, or a bucket as ``s3://BUCKET/PREFIX``; a folder is made when it is first written to.

        Raises:
            StoreError: If the location is a URL of an unknown kind.
        """
        self.place = open_place(location)
        self.location = self.place.location
        """What opens the same store again, in this process or another."""
        self.shards = Shards(self.place)
        self.packs = Packs(self.place)
        self.objects = ObjectStore(self.place, self.shards)
        self.records = RecordStore(self.place, self.packs)
        self.manifest = Manifest(self.place)
        self.snapshots = Snapshots(self.place)
        self.domains = DomainStore(self.place)
        self.timings = Timings(self.place)
        self._waiting: dict[tuple[str, str], Record] | None = None
        """Records that are written at the end of a block of work; None outside of one."""

    @property
    def root(self) -> Path:
        """The store's folder.

        Raises:
            StoreError: If it is not kept in one.
        """
        path = self.place.path("")
        if path is None:
            raise StoreError(f"{self.location} is not a folder")
        return path

    def index(self) -> Index:
        """What is there now, listed once."""
        return Index(self.objects, self.records)

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """Do the work of many stages, and make all of it durable at the end of the block, at once.

        Waiting for the disk takes longer than writing small tables; waiting once for all takes a fraction.
        Tables are there at once, their records at the end. A process that is killed inside the block leaves
        tables that nothing names, and does the block's stages again.
        """
        if self._waiting is not None:
            yield
            return
        self._waiting = {}
        try:
            with self.naming():
                try:
                    with self.place.together():
                        yield
                finally:
                    waiting, self._waiting = self._waiting, None
                    with self.place.together():
                        for record in waiting.values():
                            self.records.put(record)
        finally:
            self._waiting = None

    def naming(self) -> contextlib.AbstractContextManager[None]:
        """Shared with other writers; sweeping waits, so that no table goes before what names it is there."""
        return self.place.guard(SWEEP, is_shared=True)

    def is_current(self, stage: str, inputs: Mapping[str, str], params: str, code_version: str) -> bool:
        """Whether the stage's output for these inputs, parameters and code is there."""
        return self.find(stage, inputs, params, code_version) is not None

    def find(self, stage: str, inputs: Mapping[str, str], params: str, code_version: str) -> Record | None:
        """The record of a stage for these inputs, parameters and code, if all that it names is there."""
        key = stage_key(stage, dict(inputs), params, code_version)
        record = (self._waiting or {}).get((stage, key)) or self.records.get(stage, key)
        if record is None or not all(self.objects.has(ContentHash(c)) for c in record.outputs.values()):
            return None
        return record

    def run(
        self,
        stage: str,
        inputs: Mapping[str, str],
        params: str,
        code_version: str,
        function: Callable[[], StageOutput],
    ) -> Record:
        """The record of a stage for these inputs: found if it is there, else made by calling ``function``.

        Args:
            stage: The stage's name.
            inputs: Name of each input → hash of its content.
            params: The parameters, as canonical JSON (see ``canonical_json``).
            code_version: Hash of the code behind the function.
            function: What gives the output. It is called only if the output is not there.
        """
        found = self.find(stage, inputs, params, code_version)
        if found is not None:
            return found
        start = time.perf_counter()
        output = function()
        with self.naming():
            contents = {
                name: str(self.objects.put(table, schema)) for name, (table, schema) in output.tables.items()
            }
            record = Record(
                stage=stage,
                key=stage_key(stage, dict(inputs), params, code_version),
                inputs=dict(inputs),
                params=params,
                code_version=code_version,
                outputs=contents,
                notes=dict(output.notes),
                schemas={name: schema_version(schema) for name, (_, schema) in output.tables.items()},
            )
            if self._waiting is None:
                self.records.put(record)
            else:
                self._waiting[stage, record.key] = record
        self.timings.note(stage, record.key, time.perf_counter() - start)
        return record

    def get(self, content: str, schema: type[Table]) -> dy.DataFrame[Table]:
        """The table whose content has that hash."""
        return self.objects.get(ContentHash(content), schema)

    def joined(self, contents: Sequence[str], schema: type[Table]) -> pl.DataFrame:
        """The tables of these hashes, one below the other; see ``ObjectStore.joined``."""
        return self.objects.joined([ContentHash(content) for content in contents], schema)


def canonical_json(value: object) -> str:
    """JSON with sorted keys and no white space, so that equal values give equal text."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
