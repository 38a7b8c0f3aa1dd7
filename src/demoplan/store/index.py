"""The store's listings read once, for those who look at thousands of episodes."""

from demoplan.ids import ContentHash
from demoplan.store.objects import ObjectStore
from demoplan.store.records import Record, RecordStore

_FEW = 50
"""So many questions are answered one by one: a listing of a large store takes as long as hundreds of them."""


class Index:
    """Which tables and records are there; each is listed once, as soon as many are asked for.

    What is written after that is not in it.
    """

    def __init__(self, objects: ObjectStore, records: RecordStore) -> None:
        """Read from these, when something is first asked."""
        self._objects = objects
        self._records = records
        self._contents: set[str] | None = None
        self._keys: set[tuple[str, str]] | None = None
        self._n_asked = 0
        self._read: dict[tuple[str, str], Record] = {}

    def has(self, content: str) -> bool:
        """Whether a table of that hash is there."""
        if self._contents is None and self._is_among_few():
            return self._objects.has(ContentHash(content))
        if self._contents is None:
            self._contents = self._objects.contents()
        return content in self._contents

    def has_record(self, stage: str, key: str) -> bool:
        """Whether there is a record of that key."""
        if self._keys is None and self._is_among_few():
            return self._records.get(stage, ContentHash(key)) is not None
        if self._keys is None:
            self._keys = self._records.keys()
        return (stage, key) in self._keys

    def _is_among_few(self) -> bool:
        self._n_asked += 1
        return self._n_asked <= _FEW

    def record(self, stage: str, key: str) -> Record | None:
        """The record of that key, read at most once; None if there is none."""
        if not self.has_record(stage, key):
            return None
        if (stage, key) not in self._read:
            record = self._records.get(stage, ContentHash(key))
            if record is None:  # swept since it was listed
                return None
            self._read[stage, key] = record
        return self._read[stage, key]

    def find(self, stage: str, key: str) -> Record | None:
        """The record of that key, if all that it names is there."""
        record = self.record(stage, key)
        if record is None or not all(self.has(content) for content in record.outputs.values()):
            return None
        return record
