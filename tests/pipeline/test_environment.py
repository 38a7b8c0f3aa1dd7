from importlib import metadata

import pytest

from demoplan.errors import PlannerError, StoreError
from demoplan.pipeline import environment
from demoplan.pipeline.environment import CHECKS, Machine, examine


def look(part, tmp_path, **variables):
    return list(
        CHECKS[part](Machine(environment=variables, store=str(tmp_path / "not" / "there"), timeout_s=30.0))
    )


def severities(findings):
    return [finding.severity for finding in findings]


@pytest.mark.parametrize(
    ("package", "version", "words"),
    [
        ("fastapi", "0.151.2", "kills Prefect's embedded server"),
        ("sqlalchemy", "2.1.0", "scheduled runs"),
        ("mujoco", "4.1.0", "other results"),
    ],
)
def test_versions_that_are_known_to_break_something_are_found(tmp_path, monkeypatch, package, version, words):
    real = metadata.version
    installed = {"prefect": "3.8.8", package: version}
    monkeypatch.setattr(metadata, "version", lambda name: installed.get(name) or real(name))
    errors = [f for f in look("versions", tmp_path) if f.severity == "error"]
    assert [words in f.sentence and version in f.sentence for f in errors] == [True]
    assert errors[0].remedy


def test_a_missing_planner_is_told_with_how_to_get_it(tmp_path, monkeypatch):
    def fail(*_):
        raise PlannerError("no planner here")

    monkeypatch.setattr(environment, "solve", fail)
    (found,) = look("planner", tmp_path)
    assert (found.severity, found.sentence) == ("absent", "no planner here")
    assert "demoplan[planner]" in found.remedy


def test_the_planner_is_tried_and_not_only_looked_for(tmp_path):
    pytest.importorskip("up_fast_downward")
    assert severities(look("planner", tmp_path)) == ["ok"]


def test_a_store_that_is_not_there_yet_is_tried_where_it_would_be_and_leaves_nothing(tmp_path):
    assert severities(look("store", tmp_path))[-1] == "ok"
    assert list(tmp_path.iterdir()) == []


def test_a_store_below_a_file_is_an_error_or_is_told(tmp_path):
    (tmp_path / "not").write_text("a file")
    assert severities(look("store", tmp_path))[-1] in {"warning", "error"}


def test_a_full_disk_is_told(tmp_path, monkeypatch):
    import shutil
    from types import SimpleNamespace

    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10**6))
    first = look("store", tmp_path)[0]
    assert (first.severity, "free" in first.sentence, "gc" in first.remedy) == ("warning", True, True)


@pytest.fixture
def quiet(tmp_path):
    """A machine on which nothing reports to anybody."""
    folder = tmp_path / "config" / "rerun"
    folder.mkdir(parents=True)
    (folder / "analytics.json").write_text('{"analytics_enabled": false}')
    return {
        "DO_NOT_TRACK": "1",
        "RAY_USAGE_STATS_ENABLED": "0",
        "XDG_CONFIG_HOME": str(tmp_path / "config"),
    }


def test_telemetry_of_prefect_is_told_until_both_switches_are_off(tmp_path, quiet):
    pytest.importorskip("prefect")
    from prefect.settings import PREFECT_SERVER_ANALYTICS_ENABLED, temporary_settings

    with temporary_settings({PREFECT_SERVER_ANALYTICS_ENABLED: True}):
        (found,) = look("telemetry", tmp_path, **quiet | {"DO_NOT_TRACK": ""})
    assert found.severity == "warning"
    assert "DO_NOT_TRACK=1" in found.remedy
    assert "PREFECT_SERVER_ANALYTICS_ENABLED=false" in found.remedy
    with temporary_settings({PREFECT_SERVER_ANALYTICS_ENABLED: False}):
        assert severities(look("telemetry", tmp_path, **quiet)) == ["ok"]


@pytest.mark.parametrize("content", [None, '{"analytics_enabled": true}', "{}", "not JSON"])
def test_telemetry_of_the_viewer_is_told_unless_it_was_turned_off(tmp_path, quiet, content):
    path = tmp_path / "config" / "rerun" / "analytics.json"
    path.unlink() if content is None else path.write_text(content)
    assert "rerun analytics disable" in [found.remedy for found in look("telemetry", tmp_path, **quiet)]


def test_telemetry_of_ray_is_told_where_ray_is(tmp_path, quiet):
    pytest.importorskip("ray")
    del quiet["RAY_USAGE_STATS_ENABLED"]
    assert "RAY_USAGE_STATS_ENABLED=0" in [found.remedy for found in look("telemetry", tmp_path, **quiet)]


def test_sqlite_and_a_short_start_are_told_and_a_server_by_url_is_fine(tmp_path):
    pytest.importorskip("prefect")
    from prefect.settings import (
        PREFECT_API_URL,
        PREFECT_SERVER_ALLOW_EPHEMERAL_MODE,
        PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS,
        temporary_settings,
    )

    alone = {PREFECT_API_URL: None, PREFECT_SERVER_ALLOW_EPHEMERAL_MODE: True}
    with temporary_settings(alone | {PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS: 20}):
        found = look("database", tmp_path)
    assert severities(found) == ["warning", "warning"]
    assert "SQLite" in found[0].sentence
    assert "20 s" in found[1].sentence
    with temporary_settings({PREFECT_API_URL: "http://127.0.0.1:4200/api"}):
        assert severities(look("database", tmp_path)) == ["ok"]


def test_bytecode_that_is_not_written_is_told(tmp_path):
    assert "warning" in severities(look("python", tmp_path, PYTHONDONTWRITEBYTECODE="1"))


def test_drawing_that_fails_is_told_with_its_reason(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.setattr(environment, "_DRAWING", "raise SystemExit('no EGL device')")
    first = look("drawing", tmp_path)[0]
    assert first.severity == "warning"
    assert "no EGL device" in first.sentence
    assert "libegl1" in first.remedy


def test_every_part_says_something(tmp_path):
    done = []
    findings = examine(Machine(environment={}, store=str(tmp_path), timeout_s=30.0), done.append)
    assert done == list(CHECKS)
    assert {finding.subject for finding in findings} == set(CHECKS)
    assert all(f.remedy for f in findings if f.severity == "absent")


def test_a_bucket_that_does_not_answer_is_said_to_be_so(monkeypatch):
    pytest.importorskip("obstore")
    monkeypatch.setattr(environment, "open_place", lambda _: _Silent())
    (finding,) = CHECKS["store"](Machine(environment={}, store="s3://lab/store"))
    assert (finding.severity, "s3://lab" in finding.sentence) == ("error", True)


class _Silent:
    def exists(self):
        raise StoreError("s3://lab/store does not answer")
