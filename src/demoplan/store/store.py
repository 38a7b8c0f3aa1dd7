"""The store as a whole, and the one way in which stages run over it."""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.ids import ContentHash
from demoplan.store.atomic import locked
from demoplan.store.domains import DomainStore
from demoplan.store.manifest import Manifest
from demoplan.store.objects import ObjectStore, Table
from demoplan.store.records import Record, RecordStore, schema_version, stage_key
from demoplan.store.snapshots import Snapshots
from demoplan.store.timings import Timings


@dataclass(frozen=True, kw_only=True)
class StageOutput:
    """What a stage's function gives back: tables by name, with their declarations, and notes."""

    tables: Mapping[str, tuple[pl.DataFrame, type[dy.Schema]]]
    notes: Mapping[str, str] = field(default_factory=dict)


class Store:
    """A folder with tables, records, a manifest and domain versions.

    ``objects/`` tables by content · ``records/`` what gave them · ``manifest.json`` what stands now ·
    ``snapshots/`` what stood before · ``domains/`` versions · ``timings/`` what stages took ·
    ``reports/``, ``recordings/`` what can be made again from the rest.
    """

    def __init__(self, root: Path) -> None:
        """Use the folder ``root``; it is made when something is first written."""
        self.root = root
        self.objects = ObjectStore(root / "objects")
        self.records = RecordStore(root / "records")
        self.manifest = Manifest(root)
        self.snapshots = Snapshots(root / "snapshots")
        self.domains = DomainStore(root / "domains")
        self.timings = Timings(root / "timings")
        self.sweep_lock = root / "sweep.lock"

    def is_current(self, stage: str, inputs: Mapping[str, str], params: str, code_version: str) -> bool:
        """Whether the stage's output for these inputs, parameters and code is there."""
        return self.find(stage, inputs, params, code_version) is not None

    def find(self, stage: str, inputs: Mapping[str, str], params: str, code_version: str) -> Record | None:
        """The record of a stage for these inputs, parameters and code, if all that it names is there."""
        key = stage_key(stage, dict(inputs), params, code_version)
        record = self.records.get(stage, key)
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
        # Shared with other writers; sweeping waits, so that no table goes before what names it is there.
        with locked(self.sweep_lock, is_shared=True):
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
            self.records.put(record)
        self.timings.note(stage, record.key, time.perf_counter() - start)
        return record

    def get(self, content: str, schema: type[Table]) -> dy.DataFrame[Table]:
        """The table whose content has that hash."""
        return self.objects.get(ContentHash(content), schema)


def canonical_json(value: object) -> str:
    """JSON with sorted keys and no white space, so that equal values give equal text."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
