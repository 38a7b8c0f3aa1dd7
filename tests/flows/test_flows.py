"""Flows do what the pipeline does, and show it."""

import asyncio
import json
import shutil
from pathlib import Path

import pytest

pytest.importorskip("prefect", reason="flows need the extra: pip install 'demoplan[flows]'")

from ruamel.yaml import YAML

CHECKOUT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.filterwarnings("default")  # Prefect's own, in its server and its client


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Two shipped episodes as a dataset, and a third log that its manifest does not name yet."""
    folder = tmp_path_factory.mktemp("lab")
    source = CHECKOUT / "datasets/cube-stacking"
    head, _, rest = (source / "dataset.yaml").read_text().partition("\nepisodes:\n")
    entries = [b.rstrip() for b in ("\n" + rest).split("\n  - id: ")[1:]]
    names = ("p1-one-left", "p1-two-right")
    kept = [
        "\n".join(line for n, line in enumerate(entry.splitlines()) if n == 0 or line.startswith("    "))
        for entry in entries
        if entry.split()[0] in names
    ]
    head = head.replace("../../schemas", f"{CHECKOUT}/schemas").replace("name: cube-stacking", "name: lab", 1)
    goals = "goals:\n  - {name: one, goal: 'onTop(cube_red,cube_blue)'}\n"
    (folder / "dataset.yaml").write_text(
        f"{head}\nepisodes:\n" + "".join(f"  - id: {entry}\n" for entry in kept) + goals
    )
    for part in ("logs", "labels"):
        (folder / part).mkdir()
        for path in (source / part).iterdir():
            if path.stem.split(".")[0] in (*names, "p1-one-right"):
                shutil.copy(path, folder / part / path.name)
    return folder


def artifacts(prefix=""):
    from prefect.client.orchestration import get_client

    async def read():
        async with get_client() as client:
            found = await client.read_artifacts()
            newest_last = sorted(found, key=lambda artifact: artifact.created)
            return {a.key: a for a in newest_last if a.key and a.key.startswith(prefix)}

    return asyncio.run(read())


def test_every_deployment_names_a_flow_that_takes_its_parameters_and_waits_to_be_started():
    from prefect import Flow
    from prefect.flows import load_flow_from_entrypoint

    content = YAML(typ="safe").load((CHECKOUT / "prefect.yaml").read_text())
    names = ("ingest", "learn", "evaluate", "reprocess", "nightly")
    assert {d["entrypoint"] for d in content["deployments"]} == {f"flows/{n}.py:{n}" for n in names}
    for deployment in content["deployments"]:
        flow = load_flow_from_entrypoint(f"{CHECKOUT}/{deployment['entrypoint']}")
        assert isinstance(flow, Flow)
        flow.validate_parameters(deployment["parameters"])
        assert flow.isasync, "a synchronous flow loses a second in a heartbeat"
        assert not [s for s in deployment["schedules"] if s["active"]], "paused until somebody starts it"
        assert deployment["concurrency_limit"]["limit"] == 1
        assert "demoplan" in deployment["tags"]
        schema = flow.parameters.model_dump()["properties"]
        assert all(each.get("description") for each in schema.values()), schema
        assert schema["workers"]["minimum"] == 1


def test_only_tasks_at_the_edges_are_tried_again_and_none_is_cached():
    from flows import evaluate, ingest, learn, reprocess

    tasks = [ingest.enrol_arrivals, ingest.ingest_all, learn.learn_dataset, evaluate.run_study]
    tasks += [reprocess.look, reprocess.work]
    for task in tasks:
        assert task.retries > 0
        assert task.persist_result is False
        assert task.cache_policy.compute_key(None, {}, {}) is None
    for flow in (ingest.ingest, learn.learn, evaluate.evaluate, reprocess.reprocess):
        assert flow.retries == 0


@pytest.mark.parametrize(
    ("error", "again"),
    [("StoreError", True), ("OSError", True), ("UsageError", False), ("ValueError", False)],
)
def test_a_disk_may_come_back_and_a_wrong_argument_does_not(error, again):
    import builtins

    from flows.edges import is_worth_retrying
    from prefect.states import Failed

    from demoplan import errors

    kind = getattr(errors, error, None) or getattr(builtins, error)
    assert is_worth_retrying(None, None, Failed(data=kind("it failed"))) is again


def test_nothing_of_the_package_knows_the_flows_and_only_doctor_looks_at_prefect():
    for path in (CHECKOUT / "src").rglob("*.py"):
        lines = [line.strip() for line in path.read_text().splitlines()]
        assert not [x for x in lines if x.startswith(("import flows", "from flows"))], path
        if path.name != "environment.py":
            assert not [x for x in lines if x.startswith(("import prefect", "from prefect"))], path


def test_importing_the_flows_turns_telemetry_off():
    import os

    import flows

    assert flows.__doc__
    assert os.environ["DO_NOT_TRACK"] == "1"
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"
    assert os.environ["PREFECT_SERVER_ANALYTICS_ENABLED"] == "false"
    assert "analytics_enabled = false" in (CHECKOUT / "prefect.toml").read_text()


def test_differences_are_written_so_that_markdown_does_not_eat_them():
    from flows.showing import changes_text, key_of

    from demoplan.language.diff import Change

    text = changes_text("abc", [Change("put_1", "precondition", "added", new="not in_hand(?h, ?c)")])
    assert "put\\_1" in text
    assert "1 differences" in text
    assert "says the same" in changes_text("abc", [])
    assert key_of("progress", "lab: read, align") == "progress-lab-read-align"


def test_a_run_report_says_what_was_lost_what_is_new_and_what_is_solved():
    from types import SimpleNamespace

    from flows.showing import run_text

    from demoplan.store import EpisodeState

    version = SimpleNamespace(
        learned=SimpleNamespace(version=SimpleNamespace(domain_id="abcd")),
        previous=object(),
        is_new=True,
        changes=(1, 2),
    )
    states = [
        EpisodeState(dataset="lab", episode_id="a"),
        EpisodeState(dataset="lab", episode_id="b_1", status="quarantined", reason="cut <short>"),
    ]
    tried = [
        SimpleNamespace(trial=SimpleNamespace(is_solved=cause is None, cause=cause))
        for cause in (None, "unsolvable", "unsolvable")
    ]
    text = run_text("lab", version, states, tried)
    assert "2 episodes: 1 complete, 1 quarantined" in text
    assert "b\\_1: cut \\<short\\>" in text
    assert "`abcd`: a new version, 2 differences" in text
    assert "1 of 3 pairs" in text
    assert "2 × unsolvable" in text


@pytest.mark.slow
def test_a_night_takes_up_what_arrived_learns_evaluates_and_shows_it(lab, tmp_path, prefect_server):
    from flows.nightly import nightly

    from demoplan.store import Store

    store = tmp_path / "store"
    arguments = {
        "store": str(store),
        "pattern": "(?P<participant>p1)-(?P<task>.+)",
        "quiet_s": 0.0,
        "segmenter": "rules",
        "workers": 1,
    }
    domain_id = asyncio.run(nightly(lab, **arguments))
    assert Store(store).domains.latest("lab").domain_id == domain_id
    states = Store(store).manifest.episodes("lab")
    assert [s.episode_id for s in states] == ["p1-one-left", "p1-one-right", "p1-two-right"]
    assert {s.status for s in states} == {"complete"}
    found = artifacts()
    assert {"episodes-lab", "domain-diff-lab", "success-lab", "report-lab", "stale"} <= set(found)
    assert "The first version" in found["domain-diff-lab"].data
    assert "combined" in found["success-lab"].data
    assert "3 episodes: 3 complete" in found["run-report-lab"].data
    assert f"domain `{domain_id}`: the first version" in found["run-report-lab"].data
    assert [key for key in found if key.startswith("progress-")]
    assert asyncio.run(nightly(lab, **arguments)) == domain_id
    assert "says the same" in artifacts()["domain-diff-lab"].data
    assert "as it was before" in artifacts()["run-report-lab"].data


@pytest.mark.slow
@pytest.mark.parametrize("runner", ["processes", "dask"])
def test_a_night_in_a_bucket_gives_the_domain_and_the_runs_of_one_in_a_folder(
    runner, lab, tmp_path, bucket_url, prefect_server
):
    if runner == "dask":
        pytest.importorskip("prefect_dask", reason="needs the extra: pip install 'demoplan[dask]'")
    from flows.evaluate import evaluate
    from flows.nightly import nightly

    from demoplan.store import Store
    from demoplan.store.verifying import verify

    goals = tmp_path / "goals.yaml"
    goals.write_text("goals:\n  - {name: one, goal: 'onTop(cube_red,cube_blue)'}\n")
    arguments = {"segmenter": "rules", "workers": 2}
    here = str(tmp_path / "store")
    domain_id = asyncio.run(nightly(lab, store=here, **arguments))
    assert asyncio.run(nightly(lab, store=bucket_url, runner=runner, **arguments)) == domain_id
    assert Store(bucket_url).manifest.episodes() == Store(here).manifest.episodes()
    assert verify(Store(bucket_url)) == []
    result = asyncio.run(evaluate(lab, store=bucket_url, runner=runner, goals=goals, seeds=1, **arguments))
    assert result.report == f"{bucket_url}/reports/lab.html"
    shown = artifacts()
    assert shown["simulated-lab-gripper"].data.count("1 of 1") == len(result.learned)


@pytest.mark.slow
def test_reprocessing_shows_why_and_a_dry_run_runs_nothing(lab, tmp_path, prefect_server):
    from flows.ingest import ingest
    from flows.reprocess import reprocess

    from demoplan.store import Store

    store = tmp_path / "store"
    asyncio.run(ingest(lab, store=str(store), workers=1))
    state = Store(store).manifest.episode("p1-one-left")
    path = Store(store).objects.path_of(state.tables["facts"])
    path.unlink()
    assert asyncio.run(reprocess(str(store), dry_run=True)) is None
    assert not path.exists()
    assert "facts not in the store" in artifacts()["stale"].data
    result = asyncio.run(reprocess(str(store), where="episode_id = 'p1-one-left'", workers=1))
    assert [s.episode_id for s in result.states] == ["p1-one-left"]
    assert path.is_file()


@pytest.mark.slow
def test_a_flow_with_a_wrong_argument_fails_at_once_and_says_why(tmp_path, prefect_server):
    from flows.ingest import ingest

    from demoplan.errors import UsageError

    with pytest.raises(UsageError, match="no dataset here"):
        asyncio.run(ingest(tmp_path, store=str(tmp_path / "store")))


@pytest.mark.slow
def test_robots_carry_out_what_was_planned_and_the_matrix_says_how_often(lab, tmp_path, prefect_server):
    pytest.importorskip("mujoco")
    from flows.evaluate import evaluate

    from demoplan.pipeline.datasets import open_dataset

    goals = tmp_path / "goals.yaml"
    goals.write_text("goals:\n  - {name: one, goal: 'onTop(cube_red,cube_blue)'}\n")
    arguments = {
        "store": str(tmp_path / "store"),
        "segmenter": "rules",
        "workers": 1,
        "goals": goals,
        "seeds": 1,
    }
    asyncio.run(evaluate(lab, **arguments))
    found = artifacts("simulated")
    rows = json.loads(found["simulated-lab-gripper"].data)
    episodes = [each.id for each in open_dataset(lab).dataset.episodes]
    assert {row["domain"] for row in rows} == {"lab", *(f"lab--{name}" for name in episodes)}
    assert {row["one"] for row in rows} == {"1 of 1"}
    assert (tmp_path / "store/reports/lab-gripper.html").is_file()
    assert "lab-gripper.html" in found["simulated-report-lab-gripper"].data


@pytest.mark.slow
def test_two_flow_runs_on_one_store_at_once_lose_nothing_and_add_one_version(lab, tmp_path, prefect_server):
    from flows.ingest import ingest
    from flows.learn import learn

    from demoplan.store import Store
    from demoplan.store.verifying import verify

    async def at_once(store):
        learning = [learn(lab, store=store, segmenter="rules", workers=1) for _ in range(2)]
        return await asyncio.gather(*learning, ingest(lab, store=store, workers=1))

    first, second, states = asyncio.run(at_once(str(tmp_path / "store")))
    store = Store(tmp_path / "store")
    assert first.learned.version.domain_id == second.learned.version.domain_id
    assert [v.domain_id for v in store.domains.versions()] == [first.learned.version.domain_id]
    standing = store.manifest.episodes("lab")
    assert {state.status for state in standing} == {"complete"}
    assert [state.episode_id for state in standing] == [state.episode_id for state in states]
    assert all("transitions" in state.tables for state in standing)
    assert verify(store) == []
