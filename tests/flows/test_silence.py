"""Nothing that a flow starts reaches for anything but this machine."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]

FLOW = """
import asyncio
import sys

from flows.ingest import ingest

asyncio.run(ingest(sys.argv[1], store=sys.argv[2], workers=1))
"""


@pytest.fixture
def trapped(trap, tmp_path):
    """Runs Python so that whatever it or its children reach for outside is written down."""
    variables, reached = trap

    def run(code, *arguments):
        environment = {key: value for key, value in os.environ.items() if not key.startswith("PREFECT_")}
        environment.pop("DO_NOT_TRACK", None)
        environment |= variables | {"PREFECT_HOME": str(tmp_path / "home")}
        done = subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)],
            check=False,
            cwd=CHECKOUT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=400,
        )
        return done, reached()

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
