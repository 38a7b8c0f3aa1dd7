"""Flows are no part of the package: they are found in the checkout. One server serves all their tests."""

import os
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


# Every Python process reads this as it starts, servers that Prefect starts included.
TRAP = """
import ipaddress
import os
import socket


def is_here(host):
    if host in (None, "", "localhost", socket.gethostname()):
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    return address.is_loopback or address.is_unspecified


def caught(host):
    if isinstance(host, bytes):
        host = host.decode()
    if is_here(host):
        return False
    with open(os.environ["TRAP_FILE"], "a") as file:
        file.write(f"{host}\\n")
    return True


def trapped(function, host_of):
    def call(*arguments, **options):
        if caught(host_of(arguments)):
            raise OSError("caught: this machine only")
        return function(*arguments, **options)

    return call


class Socket(socket.socket):
    def connect(self, address):
        if self.family in (socket.AF_INET, socket.AF_INET6) and caught(address[0]):
            raise OSError("caught: this machine only")
        return super().connect(address)


socket.socket = Socket
socket.getaddrinfo = trapped(socket.getaddrinfo, lambda arguments: arguments[0])
"""


@pytest.fixture
def trap(tmp_path):
    """Variables for processes that are to be watched, and what says which hosts they reached for."""
    (tmp_path / "trap").mkdir()
    (tmp_path / "trap" / "sitecustomize.py").write_text(TRAP)
    found = tmp_path / "reached"
    variables = {
        "PYTHONPATH": os.pathsep.join(map(str, (tmp_path / "trap", CHECKOUT / "src", CHECKOUT))),
        "TRAP_FILE": str(found),
    }
    return variables, lambda: found.read_text().split() if found.exists() else []
