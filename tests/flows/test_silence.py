"""Nothing that a flow starts reaches for anything but this machine."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]

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

FLOW = """
import asyncio
import sys

from flows.ingest import ingest

asyncio.run(ingest(sys.argv[1], store=sys.argv[2], workers=1))
"""


@pytest.fixture
def trapped(tmp_path):
    """Runs Python so that whatever it or its children reach for outside is written down."""
    (tmp_path / "trap").mkdir()
    (tmp_path / "trap" / "sitecustomize.py").write_text(TRAP)
    found = tmp_path / "reached"

    def run(code, *arguments, **variables):
        environment = {key: value for key, value in os.environ.items() if not key.startswith("PREFECT_")}
        environment.pop("DO_NOT_TRACK", None)
        environment |= {
            "PYTHONPATH": os.pathsep.join(map(str, (tmp_path / "trap", CHECKOUT / "src", CHECKOUT))),
            "TRAP_FILE": str(found),
            "PREFECT_HOME": str(tmp_path / "home"),
            **variables,
        }
        done = subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)],
            check=False,
            cwd=CHECKOUT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=400,
        )
        return done, found.read_text().split() if found.exists() else []

    return run


def test_the_trap_catches_names_and_addresses_and_lets_this_machine_pass(trapped):
    code = (
        "import socket\n"
        "for host in ('example.invalid', '192.0.2.1', '127.0.0.1'):\n"
        "    try:\n"
        "        socket.create_connection((host, 9), timeout=1)\n"
        "    except OSError:\n"
        "        pass\n"
        "socket.getaddrinfo('localhost', 80)\n"
    )
    done, reached = trapped(code)
    assert done.returncode == 0, done.stderr
    assert reached == ["example.invalid", "192.0.2.1"]


@pytest.mark.slow
def test_a_flow_with_its_own_server_reaches_for_nothing_outside(trapped, tmp_path):
    pytest.importorskip("prefect", reason="flows need the extra: pip install 'demoplan[flows]'")
    done, reached = trapped(FLOW, CHECKOUT / "datasets" / "cube-stacking", tmp_path / "store")
    assert done.returncode == 0, done.stderr[-2000:]
    assert "Completed" in done.stderr
    assert reached == []
