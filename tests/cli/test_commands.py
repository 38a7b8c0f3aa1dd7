"""The command line as its user meets it: real processes, real exit codes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from demoplan.store import Store

CHECKOUT = Path(__file__).resolve().parents[2]


def demoplan(*arguments, cwd=None, **environment):
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": "/tmp",
        "PYTHONPATH": str(CHECKOUT / "src"),
        **environment,
    }
    return subprocess.run(
        [sys.executable, "-m", "demoplan", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=environment,
        timeout=120,
        check=False,
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store into which two shipped episodes were run by the published rules."""
    folder = tmp_path_factory.mktemp("cli")
    manifest = (CHECKOUT / "datasets/cube-stacking/dataset.yaml").read_text()
    head, _, rest = manifest.partition("\nepisodes:\n")
    entries = rest.split("\n  - id: ")
    kept = [e for e in ("\n" + rest).split("\n  - id: ")[1:] if e.startswith(("p1-one-left", "p3-one-right"))]
    assert len(kept) == 2
    assert entries
    vocabulary = "vocabulary: ../../schemas/vocabularies/tabletop.yaml"
    assert vocabulary in head
    head = head.replace(vocabulary, f"vocabulary: {CHECKOUT}/schemas/vocabularies/tabletop.yaml")
    head = head.replace("name: cube-stacking", "name: two", 1)
    text = head + "\nepisodes:\n" + "".join(f"  - id: {entry.rstrip()}\n" for entry in _bare(kept))
    text += "goals:\n  - {name: one, goal: 'onTop(cube_red,cube_blue)'}\n"
    (folder / "dataset.yaml").write_text(text)
    root = CHECKOUT / "datasets/cube-stacking"
    ended = demoplan(
        *("run", folder, "--root", root, "--store", folder / "store", "--segmenter", "rules", "--json")
    )
    assert ended.returncode == 0, ended.stderr
    return folder, json.loads(ended.stdout)


def _bare(entries):
    """Episode entries without what follows the list in the manifest."""
    for entry in entries:
        lines = entry.splitlines()
        yield "\n".join([lines[0], *(line for line in lines[1:] if line.startswith("    "))])


def test_the_main_job_prints_one_json_value_and_writes_a_report(store):
    _, summary = store
    assert {episode["status"] for episode in summary["episodes"]} == {"complete"}
    assert [domain["name"] for domain in summary["domains"]] == ["p1-one-left", "p3-one-right", "combined"]
    report = Path(summary["report"]).read_text()
    assert "<html" in report
    assert "p1-one-left" in report
    for outside in ("http://", "https://", "<script"):
        assert outside not in report


def test_a_second_run_makes_nothing_new(store):
    folder, _ = store
    before = sorted((path, path.stat().st_mtime_ns) for path in (folder / "store/objects").rglob("*.parquet"))
    ended = demoplan(
        *("run", folder, "--root", CHECKOUT / "datasets/cube-stacking", "--store", folder / "store"),
        *("--segmenter", "rules", "--json"),
    )
    assert ended.returncode == 0
    after = sorted((path, path.stat().st_mtime_ns) for path in (folder / "store/objects").rglob("*.parquet"))
    assert before == after


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["tables"], 0, ["p1-one-left", "facts"]),
        (["tables", "activities", "-e", "p1-one-left"], 0, ["Reach"]),
        (["tables", "facts", "--where", "predicate = 'inHand'"], 0, ["inHand"]),
        (["tables", "facts", "--where", "predicat = 1"], 2, ["predicat", "columns:", "predicate"]),
        (["tables", "fact"], 2, ["unknown table 'fact'", "facts"]),
        (["tables", "facts", "-e", "nobody"], 2, ["unknown episode 'nobody'", "two/p1-one-left"]),
        (["tables", "facts", "-d", "three"], 2, ["unknown dataset 'three'", "two"]),
        (["domain", "list"], 0, ["two--p1-one-left"]),
        (["domain", "show", "two"], 0, ["(define (domain"]),
        (["domain", "show", "two", "--evidence"], 0, ["support", "p1-one-left"]),
        (["domain", "show", "nothing"], 2, ["unknown domain 'nothing'", "two"]),
        (["domain", "diff", "two", "two"], 0, []),
        (["view", "nobody"], 2, ["unknown episode 'nobody'"]),
        (["plan", "-d", "two", "-s", "p1-one-left@99", "-g", "clear(cube_red)"], 2, ["lasts"]),
        (["plan", "-d", "two", "-s", "nonsense", "-g", "clear(cube_red)"], 2, ["EPISODE@start"]),
        (
            ["plan", "-d", "two", "-s", "p1-one-left@start", "-g", "clear(cube_blak)"],
            2,
            ["cube_black", "cube_red"][1:],
        ),
        (["plan", "-d", "two", "-s", "p1-one-left@start", "-g", "clean(cube_red)"], 2, ["'clean'", "clear"]),
        (["plan", "-d", "two", "-s", "p1-one-left@start", "-g", "clear(cube_red"], 2, ["goal"]),
        (["plan", "-d", "two", "-s", "nofile.json", "-g", "clear(cube_red)"], 2, ["no such file"]),
    ],
)
def test_reading_commands_answer_or_say_what_is_wrong(store, arguments, code, words):
    folder, _ = store
    ended = demoplan(*arguments, "--store", folder / "store")
    assert ended.returncode == code, ended.stderr
    assert "Traceback" not in ended.stderr
    for word in words:
        assert word in ended.stdout + ended.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["tables"],
        ["tables", "facts"],
        ["domain", "list"],
        ["domain", "show", "two"],
        ["domain", "diff", "two", "two"],
    ],
)
def test_reading_commands_speak_json(store, arguments):
    folder, _ = store
    ended = demoplan(*arguments, "--store", folder / "store", "--json")
    assert ended.returncode == 0, ended.stderr
    json.loads(ended.stdout)


def test_a_recording_is_saved_without_a_screen(store, tmp_path):
    folder, _ = store
    ended = demoplan("view", "p1-one-left", "-o", tmp_path / "a.rrd", "--store", folder / "store")
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "a.rrd").read_bytes()[:4] in (b"RRF2", b"RRF1", b"RRIO")


def test_bad_arguments_end_with_two_and_missing_logs_with_one(tmp_path):
    assert demoplan("run", tmp_path).returncode == 2
    assert demoplan("nonsense").returncode == 2
    missing = demoplan("doctor", tmp_path / "no.mcap")
    assert (missing.returncode, "does not exist" in missing.stderr) == (1, True)


def test_a_bad_log_is_set_aside_and_the_others_go_on(tmp_path):
    folder, root = tmp_path / "data", CHECKOUT / "datasets/cube-stacking"
    folder.mkdir()
    good = (root / "logs/p1-one-left.mcap").read_bytes()
    (folder / "good.mcap").write_bytes(good)
    (folder / "cut.mcap").write_bytes(good[: len(good) * 9 // 10])
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "text.mcap").write_text("this is not a log")
    head = (root / "dataset.yaml").read_text().partition("\nepisodes:\n")[0]
    head = head.replace("../../schemas", f"{CHECKOUT}/schemas")
    names = ("good", "cut", "empty", "text", "missing")
    entries = "".join(f"  - {{id: {n}, file: {n}.mcap, participant: p, task: t}}\n" for n in names)
    (folder / "dataset.yaml").write_text(f"{head}\nepisodes:\n{entries}")
    ended = demoplan("ingest", folder, "--store", tmp_path / "store", "--json")
    assert ended.returncode == 3
    found = {episode["episode_id"]: episode for episode in json.loads(ended.stdout)}
    statuses = {name: found[name]["status"] for name in names}
    assert statuses == {
        "good": "complete",
        "cut": "truncated",
        "empty": "quarantined",
        "text": "quarantined",
        "missing": "quarantined",
    }
    for name in names[2:]:
        assert f"{name}.mcap" in found[name]["reason"]
    rows = demoplan("tables", "facts", "-e", "cut", "--store", tmp_path / "store", "--json")
    assert json.loads(rows.stdout), "what a truncated log still holds is kept"


@pytest.mark.parametrize(
    "command",
    [
        "run",
        "record",
        "ingest",
        "doctor",
        "segmenter",
        "domain",
        "plan",
        "view",
        "tables",
        "reprocess",
        "store",
    ],
)
def test_every_command_has_help(command):
    ended = demoplan(command, "--help")
    assert ended.returncode == 0
    assert "Usage" in ended.stdout


def test_after_the_main_job_nothing_is_stale_and_the_store_is_whole(store):
    folder, _ = store
    stale = demoplan("reprocess", "--dry-run", "--json", "--store", folder / "store")
    assert stale.returncode == 0, stale.stderr
    assert json.loads(stale.stdout)["stale"] == []
    history = demoplan("store", "log", "--json", "--store", folder / "store")
    assert json.loads(history.stdout)[0]["cause"] == "run two"
    verified = demoplan("store", "verify", "--json", "--store", folder / "store")
    assert (verified.returncode, json.loads(verified.stdout)) == (0, [])
    swept = demoplan("store", "gc", "--dry-run", "--json", "--store", folder / "store")
    assert (swept.returncode, json.loads(swept.stdout)) == (0, [])


def test_a_damaged_store_fails_verification_and_is_mended_by_repairing_and_reprocessing(store, tmp_path):
    import shutil

    folder, _ = store
    shutil.copytree(folder / "store", tmp_path / "store")
    content = Store(tmp_path / "store").manifest.episode("two/p1-one-left").tables["facts"]
    path = tmp_path / "store/objects" / content[:2] / f"{content}.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    assert demoplan("store", "verify", "--store", tmp_path / "store").returncode == 1
    repaired = demoplan("store", "repair", "--store", tmp_path / "store")
    assert (repaired.returncode, "set aside" in repaired.stdout) == (0, True)
    ended = demoplan("reprocess", "--workers", 1, "--store", tmp_path / "store")
    assert ended.returncode == 0, ended.stderr
    assert path.read_bytes() == whole
    assert demoplan("store", "verify", "--store", tmp_path / "store").returncode == 0


def test_a_condition_with_an_unknown_column_is_refused(store):
    folder, _ = store
    ended = demoplan("reprocess", "--where", "colour = 1", "--store", folder / "store")
    assert (ended.returncode, "columns: dataset" in ended.stderr) == (2, True)


def test_doctor_looks_at_a_log_or_at_the_machine(tmp_path):
    assert demoplan("doctor").returncode == 2
    assert demoplan("doctor", "a.mcap", "--environment").returncode == 2
    ended = demoplan("doctor", "--environment", "--json", "--store", tmp_path)
    assert ended.returncode in (0, 1), ended.stderr
    parts = {finding["subject"] for finding in json.loads(ended.stdout)}
    assert {"planner", "drawing", "versions", "database", "telemetry", "store"} <= parts


def test_a_domain_is_linted_tested_and_drawn(store, tmp_path):
    folder, _ = store
    found = demoplan("domain", "lint", "two", "--store", folder / "store", "--json")
    assert found.returncode == 0, found.stderr
    assert {"no-way-back"} <= {each["rule"] for each in json.loads(found.stdout)}
    case = tmp_path / "never.plan"
    case.write_text(
        "; start: p1-one-left@end\n; goal: onTop(cube_red, cube_blue)\n; expect: invalid\n"
        "put_1(Left_hand,cube_red,table,cube_blue)\n"
    )
    passed = demoplan("domain", "test", "two", case, "--store", folder / "store", "--json")
    assert passed.returncode == 0, passed.stderr
    assert json.loads(passed.stdout)[0]["found"] == "invalid"
    case.write_text(case.read_text().replace("expect: invalid", "expect: valid"))
    assert demoplan("domain", "test", "two", case, "--store", folder / "store").returncode == 1
    picture = tmp_path / "two.svg"
    assert demoplan("domain", "graph", "two", "--out", picture, "--store", folder / "store").returncode == 0
    assert picture.read_text().startswith("<svg")
    drawn = tmp_path / "two.png"
    assert demoplan("domain", "graph", "two", "--out", drawn, "--store", folder / "store").returncode == 0
    assert drawn.read_bytes().startswith(b"\x89PNG")
    assert (
        demoplan(
            "domain", "graph", "two", "--out", tmp_path / "two.gif", "--store", folder / "store"
        ).returncode
        == 2
    )
