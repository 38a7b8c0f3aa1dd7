"""Where Fast Downward is: found without importing it, since it is GPL and we are not."""

import os
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path

_DISTRIBUTION = "up-fast-downward"
_SEARCH = "up_fast_downward/downward/builds/release/bin/downward"
INSTALL_HINT = "install it with: pip install 'demoplan[planner]'"


@dataclass(frozen=True)
class Installation:
    """The two programs that planning runs, one after the other."""

    search: Path
    """The search binary."""
    translator_path: Path
    """Folder that holds the Python package ``fast_downward.translate``."""
    version: str


def find_installation() -> Installation | None:
    """The planner's programs as its wheel installed them, or None where they are missing.

    Only the wheel's list of files is read; nothing of it is imported.
    """
    try:
        distribution = metadata.distribution(_DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return None
    search = Path(str(distribution.locate_file(_SEARCH)))
    translator_path = search.parent
    if not (translator_path / "fast_downward" / "translate" / "__main__.py").is_file():
        return None
    if not os.access(search, os.X_OK):
        return None
    return Installation(search=search, translator_path=translator_path, version=_version_at(search))


@lru_cache(maxsize=4)
def _version_at(search: Path) -> str:
    """The version of the wheel that holds a program; reading it takes longer than finding the program."""
    return metadata.version(_DISTRIBUTION)
