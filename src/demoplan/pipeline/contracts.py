"""The published contracts: what ``schemas/`` holds, written from code."""

import json
from pathlib import Path

from pydantic import BaseModel

from demoplan import tables
from demoplan.manifests.dataset import Dataset
from demoplan.manifests.faults import FaultsFile
from demoplan.manifests.goals import GoalsFile
from demoplan.manifests.mapping import Mapping
from demoplan.manifests.vocabulary import VocabularyFile
from demoplan.tables.contracts import contract


def contracts() -> dict[str, str]:
    """File name below ``schemas/`` → content, of every contract that is written from code."""
    files = {f"tables/{name.lower()}.json": _json(contract(getattr(tables, name))) for name in tables.__all__}
    models: dict[str, type[BaseModel]] = {
        "dataset": Dataset,
        "faults": FaultsFile,
        "goals": GoalsFile,
        "mapping": Mapping,
        "vocabulary": VocabularyFile,
    }
    for name, model in models.items():
        files[f"{name}.schema.json"] = _json(model.model_json_schema())
    return files


def write_contracts(folder: Path) -> list[Path]:
    """Write the contracts into a folder, and say which files these are."""
    written = []
    for name, text in sorted(contracts().items()):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def _json(value: object) -> str:
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
