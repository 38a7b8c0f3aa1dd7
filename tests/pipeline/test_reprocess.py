"""What is stale is found, explained, and run again; nothing else is."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from demoplan.errors import UsageError
from demoplan.pipeline.datasets import open_dataset, recall, reopen
from demoplan.pipeline.run import run
from demoplan.pipeline.upkeep.reprocess import reprocess
from demoplan.pipeline.upkeep.staleness import find_stale, selected, total_cost_s
from demoplan.pipeline.upkeep.versions import learn_version
from demoplan.store import Store

CHECKOUT = Path(__file__).resolve().parents[2]
EPISODES = ("p1-one-left", "p2-one-right", "p3-one-left")


@pytest.fixture(scope="module", params=["rules", pytest.param("decision_tree", marks=pytest.mark.slow)])
def template(request, small_dataset, tmp_path_factory):
    """A dataset with its logs and its vocabulary, and a store into which it was run."""
    folder = tmp_path_factory.mktemp("template")
    source, root = small_dataset
    vocabulary = CHECKOUT / "schemas/vocabularies/tabletop.yaml"
    shutil.copy(vocabulary, folder / "vocabulary.yaml")
    text = (source / "dataset.yaml").read_text().replace(str(vocabulary), "vocabulary.yaml")
    lines = [line for line in text.splitlines() if not line.startswith("    sha256:")]
    (folder / "dataset.yaml").write_text("\n".join(lines) + "\n")
    opened = open_dataset(folder, root=root)
    logs = folder / "logs-away"
    for episode in opened.dataset.episodes:
        for file in (episode.file, episode.labels):
            (logs / file).parent.mkdir(parents=True, exist_ok=True)
            copy = shutil.copytree if (root / file).is_dir() else shutil.copy
            copy(root / file, logs / file)
    run(open_dataset(folder, root=logs), Store(folder / "store"), segmenter=request.param)
    return folder


@pytest.fixture
def lab(template, tmp_path):
    """A copy that a test may change: its folder and its store."""
    folder = tmp_path / "lab"
    shutil.copytree(template, folder)
    kept = folder / "store/datasets/small.json"
    kept.write_text(kept.read_text().replace(str(template), str(folder)))
    return folder, Store(folder / "store")


def edit(path, old, new):
    text = path.read_text()
    assert text.count(old) >= 1, old
    path.write_text(text.replace(old, new, 1))


def pairs(rows):
    return sorted(
        (row["episode_id"] or row["domain"] or "", row["stage"]) for row in rows.iter_rows(named=True)
    )


def n_runs(store):
    return {
        path.stem: len(path.read_text().splitlines())
        for path in (store.root / "timings").glob("*.jsonl")
        if path.stem != "plan"
    }


def everything(folder):
    return {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def closer(folder):
    """A change of one threshold of the vocabulary."""
    edit(folder / "vocabulary.yaml", "enter_m: 0.008", "enter_m: 0.005")


def is_trained(store):
    return bool(n_runs(store).get("train"))


def test_after_a_run_nothing_is_stale_and_nothing_is_written(lab):
    folder, store = lab
    before = everything(folder)
    assert find_stale(store).rows.is_empty()
    assert everything(folder) == before


def test_a_changed_log_runs_its_episode_and_what_depends_on_it_and_no_more(lab):
    folder, store = lab
    shutil.copy(
        CHECKOUT / "datasets/cube-stacking/logs/p1-one-right.mcap", folder / "logs-away/logs/p1-one-left.mcap"
    )
    plan = find_stale(store)
    expected = {
        ("p1-one-left", stage) for stage in ("read", "align", "perceive", "labels", "segment", "contrast")
    }
    expected |= {("small", "learn"), ("small--p1-one-left", "learn")}
    found = set(pairs(plan.rows))
    if is_trained(store):
        # The other people's segmenters were trained on this episode; its own was not.
        assert found - expected >= {("p2-one-right", "segment"), ("p3-one-left", "segment"), ("", "train")}
        assert plan.rows.filter(plan.rows["stage"] == "train").height == 2
    else:
        assert found == expected
    read = plan.rows.row(0, named=True)
    assert (read["stage"], read["reason"], read["detail"]) == ("read", "input", "log changed")
    before = n_runs(store)
    result = reprocess(store, plan, plan.rows)
    after = n_runs(store)
    for stage, n in plan.rows.group_by("stage").len().iter_rows():
        assert after[stage] - before[stage] <= n, stage
    assert after["read"] - before["read"] == 1
    assert after["perceive"] - before["perceive"] == 1
    assert {"small", "small--p1-one-left"} <= {each.version.name for each in result.learned}
    assert find_stale(store).rows.is_empty()
    if not is_trained(store):
        assert [state.episode_id for state in result.states] == ["p1-one-left"]


def test_reprocessing_ends_with_the_bytes_of_a_run_from_scratch(lab, tmp_path):
    folder, store = lab
    closer(folder)
    plan = find_stale(store)
    reprocess(store, plan, plan.rows)
    method = "decision_tree" if is_trained(store) else "rules"
    fresh = Store(tmp_path / "fresh")
    run(reopen(store, "small"), fresh, segmenter=method)
    assert store.manifest.episodes() == fresh.manifest.episodes()
    for name in ("small", *(f"small--{each}" for each in EPISODES)):
        assert store.domains.latest(name).domain_id == fresh.domains.latest(name).domain_id


def test_a_changed_threshold_is_named_with_both_values(lab):
    folder, store = lab
    closer(folder)
    perceive = find_stale(store).rows.filter(find_stale(store).rows["stage"] == "perceive")
    assert set(perceive["reason"]) == {"parameters"}
    assert "0.008 → 0.005" in perceive["detail"][0]
    assert perceive["cost_s"].null_count() == 0
    assert total_cost_s(perceive)[0] > 0


def test_a_condition_chooses_whole_episodes_and_their_domains(lab):
    folder, store = lab
    closer(folder)
    plan = find_stale(store)
    rows = selected(plan, "participant = 'p1' AND stage = 'perceive'")
    assert {row["episode_id"] for row in rows.iter_rows(named=True) if row["episode_id"]} == {"p1-one-left"}
    assert set(rows.drop_nulls("domain")["domain"]) == {"small", "small--p1-one-left"}
    result = reprocess(store, plan, rows)
    assert [state.episode_id for state in result.states] == ["p1-one-left"]
    left = find_stale(store).rows
    assert ("p1-one-left", "perceive") not in pairs(left)
    assert ("p2-one-right", "perceive") in pairs(left)


@pytest.mark.parametrize("where", ["nonsense = 1", "stage ==", "1; DROP TABLE stale"])
def test_a_condition_that_cannot_be_used_is_refused_with_the_columns(lab, where):
    folder, store = lab
    closer(folder)
    with pytest.raises(UsageError, match="columns: dataset, episode_id"):
        selected(find_stale(store), where)


def test_logs_that_are_away_count_as_unchanged_and_later_stages_still_run(lab):
    folder, store = lab
    before = {s.episode_id: s for s in store.manifest.episodes("small")}
    (folder / "logs-away").rename(folder / "archive")
    assert find_stale(store).rows.is_empty()
    closer(folder)
    plan = find_stale(store)
    assert "blocked" not in set(plan.rows["reason"])
    reprocess(store, plan, plan.rows)
    for state in store.manifest.episodes("small"):
        assert state.status == "complete"
        assert state.tables["samples"] == before[state.episode_id].tables["samples"]
        assert state.tables["facts"] != before[state.episode_id].tables["facts"]
        assert state.tables["labels"] == before[state.episode_id].tables["labels"]
    assert find_stale(store).rows.is_empty()


def test_what_would_have_to_read_a_log_that_is_away_is_blocked_and_nothing_is_lost(lab):
    folder, store = lab
    before = store.manifest.episodes("small")
    (folder / "logs-away").rename(folder / "archive")
    for record in (store.root / "records").rglob("*.json"):
        if record.parent.name == "read":
            store.objects.path_of(json.loads(record.read_text())["outputs"]["samples"]).unlink()
    plan = find_stale(store)
    assert set(plan.rows.filter(plan.rows["stage"] == "read")["reason"]) == {"blocked"}
    assert "not there any more" in plan.rows["detail"][0]
    reprocess(store, plan, plan.rows)
    assert store.manifest.episodes("small") == before


def test_a_change_that_is_taken_back_costs_nothing_and_the_manifest_follows(lab):
    folder, store = lab
    before = store.manifest.episodes("small")
    text = (folder / "vocabulary.yaml").read_text()
    closer(folder)
    plan = find_stale(store)
    reprocess(store, plan, plan.rows)
    (folder / "vocabulary.yaml").write_text(text)
    back = find_stale(store)
    assert total_cost_s(back.rows) == (0.0, 0)
    ran = n_runs(store)
    reprocess(store, back, back.rows)
    assert n_runs(store) == ran
    assert store.manifest.episodes("small") == before


def test_a_table_that_is_gone_is_made_again(lab):
    _, store = lab
    state = store.manifest.episode("p2-one-right")
    path = store.objects.path_of(state.tables["facts"])
    content = path.read_bytes()
    path.unlink()
    plan = find_stale(store)
    (row,) = [r for r in plan.rows.iter_rows(named=True) if r["stage"] == "perceive"]
    assert (row["reason"], row["detail"]) == ("output", "facts not in the store")
    before = n_runs(store)
    reprocess(store, plan, plan.rows)
    assert path.read_bytes() == content
    ran = {stage: n - before[stage] for stage, n in n_runs(store).items() if n != before[stage]}
    assert ran == {"perceive": 1}, "what comes after it gave the same and did not run"


def test_a_log_that_failed_is_not_tried_again_until_something_changed(lab):
    folder, store = lab
    log = folder / "logs-away/logs/p1-one-left.mcap"
    log.write_bytes(b"this is no log")
    plan = find_stale(store)
    (state,) = [s for s in reprocess(store, plan, plan.rows).states if s.episode_id == "p1-one-left"]
    assert state.status == "quarantined"
    assert not [pair for pair in pairs(find_stale(store).rows) if pair[0] == "p1-one-left"]
    shutil.copy(CHECKOUT / "datasets/cube-stacking/logs/p1-one-left.mcap", log)
    again = find_stale(store)
    assert ("p1-one-left", "read") in pairs(again.rows)
    reprocess(store, again, again.rows)
    assert store.manifest.episode("p1-one-left").status == "complete"


def test_a_changed_table_declaration_is_told_apart_from_changed_code(lab, monkeypatch):
    from demoplan.pipeline.episodes import episode_stages, segment_stages
    from demoplan.pipeline.upkeep import reasons, staleness

    _, store = lab
    for module in (staleness, episode_stages, segment_stages):
        real = module.code_version
        monkeypatch.setattr(module, "code_version", lambda *names, real=real: f"new {real(*names)}")
    assert set(find_stale(store).rows.filter(find_stale(store).rows["stage"] == "read")["reason"]) == {"code"}
    monkeypatch.setattr(reasons, "schema_version", lambda schema: f"{schema.__name__}:changed")
    read = find_stale(store).rows.filter(find_stale(store).rows["stage"] == "read")
    assert set(read["reason"]) == {"schema"}
    assert read["detail"][0] == "the declaration of samples, topics changed"


def test_what_a_manifest_says_of_an_episode_is_taken_over(lab):
    folder, store = lab
    edit(folder / "dataset.yaml", "task: ", "task: renamed-")
    plan = find_stale(store)
    row = plan.rows.row(0, named=True)
    assert (row["stage"], row["reason"]) == ("episodes", "parameters")
    assert "renamed-" in row["detail"]
    reprocess(store, plan, plan.rows)
    assert find_stale(store).rows.is_empty()


def test_a_manifest_that_broke_blocks_its_dataset_and_says_where(lab):
    folder, store = lab
    edit(folder / "dataset.yaml", "episodes:", "episoden:")
    (row,) = find_stale(store).rows.iter_rows(named=True)
    assert row["reason"] == "blocked"
    assert "dataset.yaml" in row["detail"]


def test_a_new_episode_is_found_and_costs_what_such_stages_take(lab):
    folder, store = lab
    text = (folder / "dataset.yaml").read_text()
    new = "  - {id: added, file: logs/p1-one-left.mcap, participant: p1, task: one-left}\ngoals:"
    (folder / "dataset.yaml").write_text(text.replace("goals:", new))
    plan = find_stale(store)
    rows = [row for row in plan.rows.iter_rows(named=True) if row["episode_id"] == "added"]
    assert [row["stage"] for row in rows] == ["read", "align", "perceive", "segment", "contrast"]
    assert {row["reason"] for row in rows} == {"new"}
    assert all(row["cost_s"] > 0 for row in rows)
    reprocess(store, plan, plan.rows)
    assert find_stale(store).rows.is_empty()
    assert "transitions" in store.manifest.episode("added").tables


def test_what_a_store_remembers_is_the_same_with_and_without_its_parsed_form(lab):
    folder, store = lab
    kept = store.root / "datasets/small.json"
    quick = recall(store, "small")
    content = json.loads(kept.read_text())
    del content["parsed"]
    kept.write_text(json.dumps(content))
    assert recall(store, "small") == quick == reopen(store, "small")
    closer(folder)
    assert reopen(store, "small").vocabulary != quick.vocabulary


def test_learning_again_adds_no_version_until_the_evidence_changes(lab):
    _, store = lab
    opened = reopen(store, "small")
    method = "decision_tree" if is_trained(store) else "rules"
    same = learn_version(opened, store, segmenter=method)
    assert (same.is_new, same.changes) == (False, ())
    one = replace(
        opened,
        dataset=opened.dataset.model_copy(update={"episodes": opened.dataset.episodes[:1], "name": "alone"}),
    )
    first = learn_version(one, store, segmenter="rules")
    assert (first.is_new, first.previous, first.changes) == (True, None, ())
    more = replace(one, dataset=one.dataset.model_copy(update={"episodes": opened.dataset.episodes[:2]}))
    second = learn_version(more, store, segmenter="rules")
    assert second.previous.version.domain_id == first.learned.version.domain_id
    assert second.learned.version.parent == first.learned.version.domain_id
    assert second.changes, "counts at least differ"
