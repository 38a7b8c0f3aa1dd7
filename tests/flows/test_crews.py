"""The same flows on the workers of clusters: the same bytes, also when workers die."""

import asyncio
import importlib.util
import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("prefect", reason="flows need the extra: pip install 'demoplan[flows]'")

from demoplan.errors import DemoplanError, UsageError

CHECKOUT = Path(__file__).resolve().parents[2]
DATASET = CHECKOUT / "datasets" / "cube-stacking"
pytestmark = pytest.mark.filterwarnings("default")  # of Prefect, Dask and Ray, in their own servers

# What a worker runs that is killed in the middle, twice by the same log: more often than Dask and Ray forgive.
DYING = """
import os
from pathlib import Path

from demoplan.pipeline.episodes.ingest import ingest_group


def dying_ingest(orders):
    for time in ("first", "second"):
        died = Path(__file__).with_name(time)
        if "p2-one-left" in [order.log.stem for order in orders] and not died.exists():
            died.touch()
            os.kill(os.getpid(), 9)
    return ingest_group(orders)
"""


def place(*arguments, **environment):
    from flows.crews import workplace

    return workplace(*arguments, environment=environment)


def test_one_setting_says_who_works_and_a_parameter_goes_before_the_environment():
    assert place(None, None, 3).runner == "processes"
    assert place(None, None, 3).n_workers == 3
    here = place(None, None, 2, DEMOPLAN_RUNNER="dask", DEMOPLAN_RUNNER_ADDRESS="tcp://10.0.0.1:8786")
    assert (here.runner, here.address) == ("dask", "tcp://10.0.0.1:8786")
    other = place("ray", None, 2, DEMOPLAN_RUNNER="dask", DEMOPLAN_RUNNER_ADDRESS="tcp://10.0.0.1:8786")
    assert (other.runner, other.address) == ("ray", None)


@pytest.mark.parametrize(
    ("runner", "address", "message"),
    [
        ("spark", None, "unknown runner 'spark'; known: processes, threads, dask, ray"),
        ("processes", "tcp://10.0.0.1:8786", "is for dask and ray"),
    ],
)
def test_a_workplace_that_cannot_be_is_refused(runner, address, message):
    with pytest.raises(UsageError, match=message):
        place(runner, address, 2)


def test_workers_elsewhere_need_a_server_that_they_can_reach(monkeypatch):
    from types import SimpleNamespace

    from flows import crews

    def server(url):
        context = SimpleNamespace(client=SimpleNamespace(api_url=url))
        monkeypatch.setattr(crews, "FlowRunContext", SimpleNamespace(get=lambda: context))

    server("http://127.0.0.1:8001/api")
    with pytest.raises(UsageError, match="cannot reach Prefect's server"):
        crews._server_of(place("dask", "tcp://10.0.0.1:8786", 2))
    assert crews._server_of(place("dask", "tcp://127.0.0.1:8786", 2)) == "http://127.0.0.1:8001/api"
    server("http://prefect.lab:4200/api")
    assert crews._server_of(place("ray", "ray://10.0.0.1:10001", 2)) == "http://prefect.lab:4200/api"


@pytest.mark.parametrize("module", ["prefect_dask", "prefect_ray"])
def test_a_runner_whose_extra_is_missing_says_which(module, monkeypatch):
    from flows import crews

    monkeypatch.setitem(sys.modules, module, None)
    name = module.removeprefix("prefect_")
    with pytest.raises(UsageError, match=rf"demoplan\[{name}\]"):
        crews._RUNNERS[name](place(name, None, 2))


class DiedError(Exception):
    """As a cluster says that workers died."""


class DyingRunner:
    """Runs at once what it is given; whoever has the order "always" dies of it."""

    def __init__(self):
        self.given = []

    def submit(self, task, parameters):
        from types import SimpleNamespace

        self.given.append(parameters["orders"])

        def result():
            if "always" in parameters["orders"]:
                raise DiedError
            return task.fn(**parameters)

        return SimpleNamespace(result=result)


def test_a_task_over_which_workers_die_is_taken_apart_and_only_what_kills_is_given_up():
    from flows.crews import TaskCrew

    runner = DyingRunner()
    words = ["a", "b", "always", "c", *"defghijk"]
    done = dict(TaskCrew(runner, (DiedError,), 2)(str.upper, words))
    assert done == {word: word.upper() for word in words} | {"always": None}
    assert [len(orders) for orders in runner.given] == [3, 3, 3, 3, 1, 1, 1]


def test_an_error_of_the_work_is_no_death():
    from flows.crews import TaskCrew

    with pytest.raises(ValueError, match="invalid literal"):
        list(TaskCrew(DyingRunner(), (DiedError,), 1)(int, ["1", "x"]))


@pytest.mark.slow
@pytest.mark.parametrize("runner", ["dask", "ray"])
def test_a_cluster_gives_the_bytes_of_a_local_run_though_workers_are_killed(
    runner, tmp_path, monkeypatch, prefect_server
):
    if importlib.util.find_spec(f"prefect_{runner}") is None:
        pytest.skip(f"needs the extra: pip install 'demoplan[{runner}]'")
    from prefect.flows import load_flow_from_entrypoint

    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.episodes.ingest import ingest, jobs_of
    from demoplan.store import Store

    (tmp_path / "dying.py").write_text(DYING)
    monkeypatch.syspath_prepend(tmp_path)
    from dying import dying_ingest

    # As a deployment loads it: not by the name under which a worker would import it.
    flow = load_flow_from_entrypoint(f"{CHECKOUT}/flows/ingest.py:ingest")
    crews = flow.fn.__globals__["in_crew"].__globals__
    crew_of = crews["crew_of"]
    counted = []

    @contextmanager
    def dying_crew(where):
        with crew_of(where) as crew:

            def give(work, orders):
                counted.extend(order for group in orders for order in group)
                return crew(dying_ingest, orders)

            yield give

    monkeypatch.setitem(crews, "crew_of", dying_crew)
    states = asyncio.run(flow(DATASET, store=str(tmp_path / "there"), workers=2, runner=runner))
    sys.modules.pop("dying")
    assert len(counted) == len(states) == 12
    assert (tmp_path / "first").exists()
    assert (tmp_path / "second").exists()

    opened = open_dataset(DATASET)
    here = Store(tmp_path / "here")
    local = ingest(jobs_of(opened, here, opened.dataset.episodes), on_done=lambda _: None)
    assert states == local
    for state in states:
        assert state.status == "complete"
        for content in state.tables.values():
            assert Store(tmp_path / "there").objects.is_intact(content)


KILLING = """
import os
import signal
import time


def kill(pid):
    os.kill(pid or os.getpid(), signal.SIGKILL)
    time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("who", "message"), [("scheduler", "went away"), ("worker", "has had no worker for 3 s")]
)
def test_a_cluster_that_goes_away_or_is_deserted_ends_the_flow(
    who, message, tmp_path, monkeypatch, prefect_server
):
    pytest.importorskip("prefect_dask", reason="needs the extra: pip install 'demoplan[dask]'")
    from prefect import flow
    from prefect.settings import PREFECT_API_URL

    from flows import crews

    (tmp_path / "killing.py").write_text(KILLING)
    monkeypatch.syspath_prepend(tmp_path)
    from killing import kill

    monkeypatch.setattr(crews, "DESERTED_S", 3.0)
    monkeypatch.setattr(crews, "PULSE_S", 0.5)
    path = os.pathsep.join(map(str, (tmp_path, CHECKOUT / "src", CHECKOUT)))
    environment = os.environ | {"PYTHONPATH": path, "PREFECT_API_URL": str(PREFECT_API_URL.value())}
    told = tmp_path / "scheduler.json"

    def started(kind, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", "--scheduler-file", str(told)]
        return subprocess.Popen(
            [*command, *arguments, "--no-dashboard"], env=environment, stderr=subprocess.DEVNULL
        )

    scheduler = started("scheduler", "--host", "127.0.0.1", "--port", "0")
    worker = started("worker", "--nthreads", "1", "--no-nanny")
    try:
        until = time.monotonic() + 60.0
        while not (told.exists() and told.read_text()) and time.monotonic() < until:
            time.sleep(0.1)
        address = json.loads(told.read_text())["address"]

        pid = (
            scheduler.pid if who == "scheduler" else 0
        )  # the flow goes to the worker too, with what it names

        @flow
        def killing():
            place = crews.Workplace(runner="dask", address=address, n_workers=1)
            with crews.crew_of(place) as crew:
                return list(crew(kill, [pid]))

        with pytest.raises(DemoplanError, match=message):
            killing()
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()
        sys.modules.pop("killing")
