"""What every test may use: the slow marker, and where recordings that are not ours may be found."""

import os
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser):
    parser.addoption("--slow", action="store_true", help="run the slow tests too")


def pytest_collection_modifyitems(config, items):
    if config.getoption("--slow"):
        return
    skip = pytest.mark.skip(reason="slow: give --slow to run it")
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(skip)


def _root(variable: str, folder: str) -> Path:
    root = Path(os.environ.get(variable, CHECKOUT.parent / "shared" / "data" / folder))
    if not root.is_dir():
        pytest.skip(f"recordings are not here: set {variable}, or put them into {root}")
    return root


@pytest.fixture(scope="session")
def bimanual_root() -> Path:
    """Folder of the bimanual cooking recordings; they have no licence and are never part of the project."""
    return _root("DEMOPLAN_BIMANUAL_ROOT", "bimanual-cooking")


@pytest.fixture(scope="session")
def logs_root() -> Path:
    """Folder of public sample logs in every format."""
    return _root("DEMOPLAN_LOGS_ROOT", "logs")
