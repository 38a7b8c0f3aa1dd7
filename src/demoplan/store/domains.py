"""Domain versions: one folder each, added and never overwritten."""

import json
import shutil
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.errors import StoreError, UnknownNameError
from demoplan.ids import DomainId
from demoplan.store.atomic import PART, locked, write_bytes
from demoplan.store.objects import ObjectStore
from demoplan.tables import Evidence, Literals, Operators

TABLES = ("operators", "literals", "evidence")
"""Names of the tables that stand beside a domain's text."""


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


class DomainStore:
    """Folders ``name/id/`` with ``domain.pddl``, ``metadata.json`` and the tables behind it."""

    def __init__(self, root: Path) -> None:
        """Use ``root``; it is made when something is first written."""
        self.root = root

    def put(
        self,
        version: DomainVersion,
        text: str,
        operators: dy.DataFrame[Operators],
        literals: dy.DataFrame[Literals],
        evidence: dy.DataFrame[Evidence],
    ) -> DomainVersion:
        """Add a version; if it is there already, it stays as it was first written.

        The parent is the name's latest version at that moment, unless the version names one.

        Returns:
            The version as stored.
        """
        with locked(self.root / f"{version.name}.lock"):
            folder = self.root / version.name / version.domain_id
            if (folder / "metadata.json").is_file():
                return self._read(folder)
            latest = self.latest(version.name)
            self.root.joinpath(version.name).mkdir(parents=True, exist_ok=True)
            draft = Path(tempfile.mkdtemp(prefix=PART, dir=self.root / version.name))
            try:
                tables = ObjectStore(draft / "tables")
                contents = {
                    "operators": tables.put(operators, Operators),
                    "literals": tables.put(literals, Literals),
                    "evidence": tables.put(evidence, Evidence),
                }
                for name, content in contents.items():
                    shutil.copyfile(tables.path_of(content), draft / f"{name}.parquet")
                shutil.rmtree(draft / "tables")
                fields = asdict(version) | {
                    "tables": contents,
                    "parent": version.parent or (latest.domain_id if latest else None),
                }
                stored = DomainVersion(**fields)
                (draft / "domain.pddl").write_text(text)
                (draft / "metadata.json").write_text(json.dumps(fields, sort_keys=True, indent=1) + "\n")
                draft.chmod(0o755)
                draft.rename(folder)
            finally:
                shutil.rmtree(draft, ignore_errors=True)
            order = "".join(f"{domain_id}\n" for domain_id in self._order(version.name))
            write_bytes(self.root / version.name / "order.txt", order.encode())
            return stored

    def _order(self, name: str) -> list[str]:
        """Ids of a name's versions in the order in which they were added."""
        folder = self.root / name
        present = {path.parent.name for path in folder.glob("*/metadata.json")}
        try:
            listed = (folder / "order.txt").read_text().split()
        except FileNotFoundError:
            listed = []
        known = [domain_id for domain_id in listed if domain_id in present]
        return known + sorted(present - set(known))

    def latest(self, name: str) -> DomainVersion | None:
        """The version of that name that was added last."""
        order = self._order(name)
        return self._read(self.root / name / order[-1]) if order else None

    def versions(self) -> list[DomainVersion]:
        """Every version, by name, in the order in which they were added."""
        if not self.root.is_dir():
            return []
        names = sorted(path.name for path in self.root.iterdir() if path.is_dir())
        return [self._read(self.root / name / domain_id) for name in names for domain_id in self._order(name)]

    def find(self, asked: str) -> DomainVersion:
        """A version by its id, the start of its id (4 digits or more), or its name (then the latest).

        Raises:
            UnknownNameError: If none fits, or more than one does.
        """
        versions = self.versions()
        by_name = [version for version in versions if version.name == asked]
        if by_name:
            return by_name[-1]
        fitting = [v for v in versions if len(asked) >= 4 and v.domain_id.startswith(asked)]
        if len({v.domain_id for v in fitting}) != 1:
            available = [f"{v.name} {v.domain_id}" for v in (fitting or versions)]
            raise UnknownNameError("domain", asked, available, where=f"store {self.root.parent}")
        return fitting[0]

    def text(self, version: DomainVersion) -> str:
        """The PDDL text of a version."""
        return (self.root / version.name / version.domain_id / "domain.pddl").read_text()

    def tables(
        self, version: DomainVersion
    ) -> tuple[dy.DataFrame[Operators], dy.DataFrame[Literals], dy.DataFrame[Evidence]]:
        """Operators, literals and evidence of a version."""
        folder = self.root / version.name / version.domain_id
        try:
            return (
                Operators.validate(pl.read_parquet(folder / "operators.parquet"), cast=True),
                Literals.validate(pl.read_parquet(folder / "literals.parquet"), cast=True),
                Evidence.validate(pl.read_parquet(folder / "evidence.parquet"), cast=True),
            )
        except OSError as error:
            raise StoreError(f"{folder}: the domain's tables cannot be read: {error}") from None

    def _read(self, folder: Path) -> DomainVersion:
        try:
            return DomainVersion(**json.loads((folder / "metadata.json").read_text()))
        except (OSError, ValueError, TypeError) as error:
            raise StoreError(f"{folder}: not a domain version: {error}") from None
