"""Domain versions: one folder each, added and never overwritten."""

import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import PurePosixPath

import dataframely as dy
import polars as pl

from demoplan.errors import StoreError, UnknownNameError
from demoplan.ids import DomainId
from demoplan.store.objects import Table, read_table, write_table
from demoplan.store.places import AbsentError, Place
from demoplan.tables import Evidence, Findings, Literals, Operators

TABLES = ("operators", "literals", "evidence", "findings")
"""Names of the tables that stand beside a domain's text; a version may lack the last."""


@dataclass(frozen=True, kw_only=True)
class DomainVersion:
    """What is known of one version besides its text and tables."""

    domain_id: DomainId
    name: str
    parent: str | None
    """The version of the same name that came before it."""
    dataset: str
    episodes: list[str]
    """Ids of the episodes that it was learned from, sorted."""
    snapshot: str
    """Hash over the transitions that it was learned from."""
    params: str
    """Parameters of learning, as canonical JSON."""
    code_version: str
    n_operators: int
    tables: dict[str, str]
    """Name of each table → hash of its content."""


_EVIDENCE_DIGITS = 16


@dataclass(frozen=True, kw_only=True)
class Publication:
    """One line of the history of a name: from then on, that version was what its evidence gave."""

    domain_id: DomainId
    snapshot: str
    """Hash over the transitions that it was learned from then."""
    made_at_ns: int
    """Wall clock, for people; the order of the history does not depend on it."""


class DomainStore:
    """``domains/NAME/ID/``: a version's text, metadata, tables; ``domains/NAME/history.jsonl``: their order.

    A version is there when its ``metadata.json`` is, which is written after all else. The same text may be
    learned again from other episodes: then their evidence stands beside the first, in ``ID/EVIDENCE/``.
    """

    folder = "domains"

    def __init__(self, place: Place) -> None:
        """Use a place; the folder is made when something is first written."""
        self._place = place

    def put(
        self,
        version: DomainVersion,
        text: str,
        operators: dy.DataFrame[Operators],
        literals: dy.DataFrame[Literals],
        evidence: dy.DataFrame[Evidence],
        findings: dy.DataFrame[Findings] | None = None,
    ) -> DomainVersion:
        """Add a version, and let it be its name's latest; what was written of it before stays as it was.

        The parent is the name's latest version at that moment, unless the version names one.

        Returns:
            The version as stored.
        """
        tables: list[tuple[pl.DataFrame, type[dy.Schema]]] = [
            (operators, Operators),
            (literals, Literals),
            (evidence, Evidence),
        ]
        if findings is not None:
            tables.append((findings, Findings))
        # Two that learned the same text from other evidence would both take its folder for free.
        with self._place.guard(self.folder):
            stored = self._known(version) or self._written(version, text, tables)
        published = Publication(
            domain_id=stored.domain_id, snapshot=version.snapshot, made_at_ns=time.time_ns()
        )

        def append(found: bytes | None) -> bytes | None:
            history = self._parsed(version.name, found)
            if found is None:
                history = self._before_there_was_a_history(version.name)
                if history and _what(history[-1]) == _what(published):
                    history.pop()
            if history and _what(history[-1]) == _what(published):
                return None
            return _rendered([*history, published])

        self._place.update(self._history_name(version.name), append)
        return stored

    def _known(self, version: DomainVersion) -> DomainVersion | None:
        """The version as stored, if it was learned from the same before."""
        folder = self._folder_of(version)
        for name in (folder, f"{folder}/{version.snapshot[:_EVIDENCE_DIGITS]}"):
            if self._place.entry(f"{name}/metadata.json") is not None:
                known = self._read(name)
                if known.snapshot == version.snapshot:
                    return known
        return None

    def _written(
        self, version: DomainVersion, text: str, tables: Sequence[tuple[pl.DataFrame, type[dy.Schema]]]
    ) -> DomainVersion:
        folder = self._folder_of(version)
        if self._place.entry(f"{folder}/metadata.json") is not None:
            folder = f"{folder}/{version.snapshot[:_EVIDENCE_DIGITS]}"
        latest = self.latest(version.name)
        contents = {}
        with self._place.together():
            for name, (table, schema) in zip(TABLES, tables, strict=False):
                with self._place.draft(".parquet") as draft:
                    contents[name] = str(write_table(table, schema, draft))
                    self._place.settle(draft, f"{folder}/{name}.parquet")
            with self._place.draft(".pddl") as draft:
                draft.write_text(text, encoding="utf-8")
                self._place.settle(draft, f"{folder}/domain.pddl")
        parent = version.parent or (latest.domain_id if latest else None)
        fields = asdict(version) | {"tables": contents, "parent": parent}
        is_new = self._place.create(
            f"{folder}/metadata.json", (json.dumps(fields, sort_keys=True, indent=1) + "\n").encode()
        )
        stored = self._read(folder)
        if not is_new and stored.snapshot != version.snapshot:
            # Where nobody can be held off, another was quicker.
            return self._written(version, text, tables)
        return stored

    def history(self, name: str) -> list[Publication]:
        """Which version a name stood for, from the first on; one that came back is named again.

        Raises:
            StoreError: If it cannot be read.
        """
        try:
            data = self._place.read(self._history_name(name))
        except AbsentError:
            return self._before_there_was_a_history(name)
        history = self._parsed(name, data)
        missing = self._ids(name) - {each.domain_id for each in history}
        # A process was killed between a version and its line.
        return [*(self._publication(name, domain_id) for domain_id in sorted(missing)), *history]

    def latest(self, name: str) -> DomainVersion | None:
        """The version that the latest evidence of that name gave."""
        history = self.history(name)
        return self.published(name, history[-1]) if history else None

    def names(self) -> list[str]:
        """Every name that has a version, sorted."""
        return sorted({path.parts[1] for path in self._metadata()})

    def published(self, name: str, publication: Publication) -> DomainVersion:
        """The version of a line of a name's history, with the evidence that it had then."""
        folder = f"{self.folder}/{name}/{publication.domain_id}"
        first = self._read(folder)
        if first.snapshot == publication.snapshot:
            return first
        return self._read(f"{folder}/{publication.snapshot[:_EVIDENCE_DIGITS]}")

    def versions(self) -> list[DomainVersion]:
        """Every version, by name, each where its history first names it; the evidence is its latest."""
        found = []
        for name in self.names():
            latest: dict[str, Publication] = {}
            for each in self.history(name):
                latest[each.domain_id] = each
            found += [self.published(name, each) for each in latest.values()]
        return found

    def find(self, asked: str) -> DomainVersion:
        """A version by its id, the start of its id (4 digits or more), or its name (then the latest).

        Raises:
            UnknownNameError: If none fits, or more than one does.
        """
        versions = self.versions()
        if any(version.name == asked for version in versions):
            latest = self.latest(asked)
            assert latest is not None
            return latest
        fitting = [v for v in versions if len(asked) >= 4 and v.domain_id.startswith(asked)]
        if len({v.domain_id for v in fitting}) != 1:
            available = [f"{v.name} {v.domain_id}" for v in (fitting or versions)]
            raise UnknownNameError("domain", asked, available, where=f"store {self._place.location}")
        return fitting[0]

    def text(self, version: DomainVersion) -> str:
        """The PDDL text of a version."""
        return self._place.read(f"{self._folder_of(version)}/domain.pddl").decode()

    def tables(
        self, version: DomainVersion
    ) -> tuple[dy.DataFrame[Operators], dy.DataFrame[Literals], dy.DataFrame[Evidence]]:
        """Operators, literals and evidence of a version."""
        folder = self._folder_with_tables(version)
        return (
            self._table(f"{folder}/operators.parquet", Operators),
            self._table(f"{folder}/literals.parquet", Literals),
            self._table(f"{folder}/evidence.parquet", Evidence),
        )

    def findings(self, version: DomainVersion) -> dy.DataFrame[Findings]:
        """What was found when a version was learned; nothing for one that was stored without."""
        if "findings" not in version.tables:
            return Findings.create_empty()
        return self._table(f"{self._folder_with_tables(version)}/findings.parquet", Findings)

    def _folder_with_tables(self, version: DomainVersion) -> str:
        folder = self._folder_of(version)
        if self._read(folder).snapshot != version.snapshot:
            return f"{folder}/{version.snapshot[:_EVIDENCE_DIGITS]}"
        return folder

    def folders(self) -> list[str]:
        """Every folder that holds a version's text, metadata and tables, finished or not."""
        names = (PurePosixPath(name) for name in self._place.names(self.folder))
        return sorted({str(name.parent) for name in names if len(name.parts) > 3})

    def _table(self, name: str, schema: type[Table]) -> dy.DataFrame[Table]:
        return read_table(self._place, name, schema)

    def _metadata(self) -> list[PurePosixPath]:
        paths = (PurePosixPath(name) for name in self._place.names(self.folder))
        return [path for path in paths if path.name == "metadata.json"]

    def _ids(self, name: str) -> set[str]:
        names = self._place.names(f"{self.folder}/{name}")
        return {PurePosixPath(each).parts[2] for each in names if each.endswith("/metadata.json")}

    def _folder_of(self, version: DomainVersion) -> str:
        return f"{self.folder}/{version.name}/{version.domain_id}"

    def _history_name(self, name: str) -> str:
        return f"{self.folder}/{name}/history.jsonl"

    def _before_there_was_a_history(self, name: str) -> list[Publication]:
        """The order that earlier versions of demoplan kept: each version once, as it was first added."""
        try:
            listed = self._place.read(f"{self.folder}/{name}/order.txt").decode().split()
        except AbsentError:
            listed = []
        there = self._ids(name)
        known = [domain_id for domain_id in listed if domain_id in there]
        return [self._publication(name, domain_id) for domain_id in (*known, *sorted(there - set(known)))]

    def _publication(self, name: str, domain_id: str) -> Publication:
        version = self._read(f"{self.folder}/{name}/{domain_id}")
        return Publication(domain_id=version.domain_id, snapshot=version.snapshot, made_at_ns=0)

    def _parsed(self, name: str, data: bytes | None) -> list[Publication]:
        try:
            return [Publication(**json.loads(line)) for line in (data or b"").splitlines()]
        except (ValueError, TypeError) as error:
            raise StoreError(
                f"{self._place.location}: {self._history_name(name)}: not a history: {error}; "
                "`demoplan store repair` sets it aside"
            ) from None

    def _read(self, folder: str) -> DomainVersion:
        name = f"{folder}/metadata.json"
        try:
            return DomainVersion(**json.loads(self._place.read(name)))
        except (ValueError, TypeError) as error:
            raise StoreError(f"{self._place.location}: {name}: not a domain version: {error}") from None


def _what(publication: Publication) -> tuple[str, str]:
    return publication.domain_id, publication.snapshot


def _rendered(history: Iterable[Publication]) -> bytes:
    return "".join(json.dumps(asdict(each), sort_keys=True) + "\n" for each in history).encode()
