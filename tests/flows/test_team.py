"""For a team: Prefect's server on PostgreSQL, a worker, and the compose file that starts both."""

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
from ruamel.yaml import YAML

CHECKOUT = Path(__file__).resolve().parents[2]
COMPOSE = YAML(typ="safe").load((CHECKOUT / "compose.yaml").read_text())
QUIET = {"DO_NOT_TRACK": "1", "PREFECT_SERVER_ANALYTICS_ENABLED": "false"}


def test_every_service_of_the_compose_file_waits_for_what_it_needs_and_reports_to_nobody():
    services = COMPOSE["services"]
    assert set(services) == {"database", "server", "deploy", "worker"}
    for name, service in services.items():
        assert not service["image"].endswith(":latest"), name
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", [])), name
        for other, how in service.get("depends_on", {}).items():
            if how["condition"] == "service_healthy":
                assert "healthcheck" in services[other], f"{name} would wait for {other} for ever"
        for volume in service.get("volumes", []):
            source = volume.rpartition(":")[0]
            assert source.startswith("${") or source in COMPOSE["volumes"], volume
        if name != "database":
            assert service["environment"].items() >= QUIET.items()
            assert (CHECKOUT / service["build"]["dockerfile"]).is_file()


def test_passwords_come_from_outside_and_settings_are_ones_that_prefect_knows():
    pytest.importorskip("prefect", reason="flows need the extra: pip install 'demoplan[flows]'")
    from prefect.settings import Settings
    from prefect.settings.legacy import _get_settings_fields

    text = (CHECKOUT / "compose.yaml").read_text()
    assert text.count("${DEMOPLAN_DATABASE_PASSWORD:?") == 2
    known = set(_get_settings_fields(Settings))
    for service in COMPOSE["services"].values():
        named = {key for key in service["environment"] if key.startswith("PREFECT_")}
        assert named <= known, named - known


def test_the_pool_and_the_image_of_the_compose_file_are_those_of_the_deployments():
    deployments = YAML(typ="safe").load((CHECKOUT / "prefect.yaml").read_text())["deployments"]
    (pool,) = {deployment["work_pool"]["name"] for deployment in deployments}
    services = COMPOSE["services"]
    assert f"work-pool create {pool} --type process" in " ".join(services["deploy"]["command"])
    assert services["worker"]["command"][:5] == ["prefect", "worker", "start", "--pool", pool]
    ignored = (CHECKOUT / "flows" / "Dockerfile.dockerignore").read_text().split()
    assert {".git", ".venv", ".demoplan"} <= set(ignored)


def program(name):
    """A program of PostgreSQL, which Debian keeps off the path."""
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return shutil.which(name) or (str(found[-1]) if found else None)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(ready, what, timeout_s=180.0):
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        try:
            return ready()
        except (OSError, AssertionError):
            time.sleep(0.5)
    raise AssertionError(f"{what} within {timeout_s:.0f} s")


@contextmanager
def running(*command, **options):
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **options)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(30)


@pytest.fixture
def database():
    """A PostgreSQL server of its own on loopback; it refuses to run as root."""
    if program("initdb") is None:
        pytest.skip("PostgreSQL is not installed: apt install postgresql")
    user = {"user": "postgres"} if os.getuid() == 0 else {}
    folder = Path(tempfile.mkdtemp(prefix="demoplan-postgres-"))
    try:
        if user:
            shutil.chown(folder, **user)
        secret = folder / "secret"
        secret.write_text("of the test\n")
        secret.chmod(0o644)
        subprocess.run(
            [
                *(program("initdb"), "-D", folder / "data", "-U", "prefect"),
                *("-A", "scram-sha-256", "--pwfile", secret, "--no-sync"),
            ],
            **user,
            cwd=folder,
            check=True,
            capture_output=True,
        )
        port = free_port()
        with running(
            program("postgres"),
            "-D",
            folder / "data",
            "-p",
            str(port),
            "-h",
            "127.0.0.1",
            "-k",
            folder,
            **user,
        ):
            wait_for(lambda: socket.create_connection(("127.0.0.1", port), 1).close(), "PostgreSQL answers")
            yield f"prefect:of%20the%20test@127.0.0.1:{port}/postgres"
    finally:
        shutil.rmtree(folder)


def rows_in(database, query):
    """What PostgreSQL itself answers."""
    import asyncio

    import asyncpg

    async def ask():
        connection = await asyncpg.connect(f"postgresql://{database}")
        try:
            return await connection.fetch(query)
        finally:
            await connection.close()

    return [tuple(row) for row in asyncio.run(ask())]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_deployed_flow_runs_on_a_worker_and_its_state_is_in_postgresql(database, tmp_path, trap):
    pytest.importorskip("prefect", reason="flows need the extra: pip install 'demoplan[flows]'")
    port = free_port()
    api = f"http://127.0.0.1:{port}/api"
    watched, reached = trap
    environment = os.environ | QUIET | watched
    environment |= {
        "PREFECT_HOME": str(tmp_path / "home"),
        "PREFECT_API_DATABASE_CONNECTION_URL": f"postgresql+asyncpg://{database}",
    }
    client = environment | {"PREFECT_API_URL": api}

    def ask(path, content=None):
        body = json.dumps(content or {}).encode()
        request = Request(f"{api}/{path}", body, {"Content-Type": "application/json"})
        return json.load(urlopen(request, timeout=30))

    def prefect(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "prefect", *arguments],
            cwd=CHECKOUT,
            env=client,
            check=True,
            capture_output=True,
            text=True,
            timeout=240,
        )

    serve = [sys.executable, "-m", "prefect", "server", "start", "--host", "127.0.0.1", "--no-ui"]
    with running(*serve, "--port", str(port), env=environment, cwd=CHECKOUT):
        wait_for(lambda: urlopen(f"{api}/health", timeout=5).close(), "Prefect's server answers")
        ask("work_pools/", {"name": "demoplan", "type": "process"})
        prefect("--no-prompt", "deploy", "--all")
        deployments = {d["entrypoint"]: d for d in ask("deployments/filter")}
        assert len(deployments) == 5
        assert not [s for d in deployments.values() for s in d["schedules"] if s["active"]]
        chosen = deployments["flows/ingest.py:ingest"]
        assert chosen["parameter_openapi_schema"]["properties"]["runner"]["description"]
        run = ask(
            f"deployments/{chosen['id']}/create_flow_run",
            {
                "parameters": {
                    "dataset": str(CHECKOUT / "datasets" / "cube-stacking"),
                    "store": str(tmp_path / "store"),
                    "runner": "threads",
                }
            },
        )
        prefect("worker", "start", "--pool", "demoplan", "--run-once")
        seen = ask("flow_runs/filter", {"flow_runs": {"id": {"any_": [run["id"]]}}})
        assert [(r["state"]["type"], r["state"]["message"]) for r in seen] == [("COMPLETED", None)]
        names = {artifact["key"] for artifact in ask("artifacts/filter")}
        assert "episodes-cube-stacking" in names
        states = rows_in(database, "select state_type::text, count(*) from flow_run group by 1")
        assert states == [("COMPLETED", 1)]
        assert rows_in(database, "select count(*) from task_run where state_type = 'COMPLETED'")[0][0] >= 2

    # With its analytics on, the server reaches for its makers within this time.
    assert reached() == []
    from demoplan.store import Store

    assert {s.status for s in Store(tmp_path / "store").manifest.episodes()} == {"complete"}
