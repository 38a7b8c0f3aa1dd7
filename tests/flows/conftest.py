"""Flows are no part of the package: they are found in the checkout. One server serves all their tests."""

import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]


sys.path.insert(0, str(CHECKOUT))


@pytest.fixture(scope="session")
def prefect_server():
    """A server on a database of its own; starting it takes long on a busy machine."""
    from prefect.settings import PREFECT_SERVER_ANALYTICS_ENABLED, temporary_settings
    from prefect.testing.utilities import prefect_test_harness

    with (
        temporary_settings({PREFECT_SERVER_ANALYTICS_ENABLED: False}),
        prefect_test_harness(server_startup_timeout=240),
    ):
        yield
