"""Records: which output a stage gave for which input, parameters and code."""

import functools
import json
from dataclasses import asdict, dataclass, field
from pathlib import PurePosixPath

import dataframely as dy

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
    """Records by stage and key: ``stage/key.json``."""

    def __init__(self, place: Place, folder: str = "records") -> None:
        """Use ``folder`` of a place; it is made when something is first written."""
        self._place = place
        self.folder = folder

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
            return None

    def has(self, stage: str, key: str) -> bool:
        """Whether there is a record of that key."""
        return self._place.entry(self.name_of(stage, key)) is not None

    def put(self, record: Record) -> None:
        """Write a record; its outputs must be there already."""
        with self._place.draft(".json") as draft:
            draft.write_bytes(render_record(record))
            self._place.settle(draft, self.name_of(record.stage, record.key))

    def keys(self) -> set[tuple[str, str]]:
        """Stage and key of every record, by one listing."""
        found = set()
        for name in self._place.names(self.folder):
            path = PurePosixPath(name)
            if path.suffix == ".json":
                found.add((path.parent.name, path.stem))
        return found


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
