"""Records: which output a stage gave for which input, parameters and code."""

import functools
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import dataframely as dy

from demoplan.errors import StoreError
from demoplan.ids import ContentHash, content_hash
from demoplan.store.atomic import PART, write_bytes
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
    """A folder of records: ``stage/key.json``."""

    def __init__(self, root: Path) -> None:
        """Use ``root``; it is made when something is first written."""
        self.root = root

    def path_of(self, stage: str, key: ContentHash) -> Path:
        """Where the record of that key is."""
        return self.root / stage / f"{key}.json"

    def get(self, stage: str, key: ContentHash) -> Record | None:
        """The record of that key, or None if the stage has not run so.

        Raises:
            StoreError: If a record is there that cannot be read.
        """
        path = self.path_of(stage, key)
        try:
            return Record(**json.loads(path.read_text()))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError) as error:
            raise StoreError(f"{path}: not a record: {error}; delete it to run the stage again") from None

    def put(self, record: Record) -> None:
        """Write a record; its outputs must be there already."""
        text = json.dumps(asdict(record), sort_keys=True, indent=1) + "\n"
        write_bytes(self.path_of(record.stage, record.key), text.encode())

    def paths(self) -> Iterator[Path]:
        """Where every record is, in order of stage and key."""
        for path in sorted(self.root.glob("*/*.json")):
            if not path.name.startswith(PART):
                yield path
