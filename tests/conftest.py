"""What every test may use: the slow marker, where recordings that are not ours may be found, and an S3 server."""

import gc
import json
import os
import subprocess
import sys
import urllib.request
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


@pytest.fixture(scope="session")
def small_dataset(tmp_path_factory):
    """Three shipped episodes, one of each log format, as a dataset of their own; and where its logs are."""
    folder = tmp_path_factory.mktemp("small")
    root = CHECKOUT / "datasets/cube-stacking"
    head, _, rest = (root / "dataset.yaml").read_text().partition("\nepisodes:\n")
    wanted = ("p1-one-left", "p2-one-right", "p3-one-left")
    blocks = [b for b in ("\n" + rest).split("\n  - id: ")[1:] if b.split("\n")[0] in wanted]
    assert len(blocks) == len(wanted)
    entries = [
        "\n".join([b.split("\n")[0], *[x for x in b.split("\n")[1:] if x[:4] == "    "]]) for b in blocks
    ]
    text = head.replace("../../schemas", f"{CHECKOUT}/schemas").replace(
        "name: cube-stacking", "name: small", 1
    )
    text += "\nepisodes:\n" + "".join(f"  - id: {entry}\n" for entry in entries)
    text += "goals:\n  - {name: one, goal: 'onTop(cube_red,cube_blue)'}\n"
    (folder / "dataset.yaml").write_text(text)
    return folder, root


@pytest.fixture
def no_collector():
    """Python's collector of circles does nothing: what is not used any more goes at once, or it stays."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


class S3Server:
    """An S3 server on loopback, and what is to go wrong with it."""

    def __init__(self, process, url):
        self.process = process
        self.url = url

    def _ask(self, method, path, data=None):
        request = urllib.request.Request(self.url + path, data=data, method=method)
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.read()

    def make_bucket(self, name):
        self._ask("PUT", f"/{name}")

    def break_down(self, **faults):
        self._ask("PUT", "/-/faults", json.dumps(faults).encode())

    def n_requests(self):
        return json.loads(self._ask("GET", "/-/faults"))["n_requests"]


@pytest.fixture(scope="session")
def s3_process():
    pytest.importorskip("obstore", reason="the extra s3 is not installed")
    pytest.importorskip("moto.server", reason="moto[server] is not installed")
    process = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("s3_server.py"))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    yield S3Server(process, process.stdout.readline().strip())
    process.stdin.close()
    process.wait(timeout=10)
    process.stdout.close()


@pytest.fixture
def s3(s3_process, monkeypatch):
    """The server, with the environment that leads to it."""
    for name, value in {
        "AWS_ENDPOINT_URL": s3_process.url,
        "AWS_ACCESS_KEY_ID": "somebody",
        "AWS_SECRET_ACCESS_KEY": "this-must-never-be-shown",
        "AWS_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    yield s3_process
    s3_process.break_down(n=0)


@pytest.fixture
def bucket_url(s3, request):
    name = f"lab-{abs(hash(request.node.nodeid)) % 10**9}"
    s3.make_bucket(name)
    return f"s3://{name}/demoplan"
