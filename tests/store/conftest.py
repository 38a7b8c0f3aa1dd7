import json
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

SECRET = "this-must-never-be-shown"


class Server:
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
    yield Server(process, process.stdout.readline().strip())
    process.stdin.close()
    process.wait(timeout=10)
    process.stdout.close()


@pytest.fixture
def s3(s3_process, monkeypatch):
    """The server, with the environment that leads to it."""
    for name, value in {
        "AWS_ENDPOINT_URL": s3_process.url,
        "AWS_ACCESS_KEY_ID": "somebody",
        "AWS_SECRET_ACCESS_KEY": SECRET,
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
