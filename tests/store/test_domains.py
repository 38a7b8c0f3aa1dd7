"""Domain versions: content-addressed, with a history of what each name stood for."""

import json
import shutil

import polars as pl
import pytest

from demoplan.ids import content_hash
from demoplan.store import DomainVersion, Store
from demoplan.store.verifying import verify
from demoplan.tables import Evidence, Literals, Operators

TEXTS = {letter: f"(define (domain {letter}))\n" for letter in "ab"}


def publish(store, letter, snapshot, n_episodes=1, name="stack"):
    text = TEXTS[letter]
    version = DomainVersion(
        domain_id=content_hash(text)[:16],
        name=name,
        parent=None,
        dataset="d",
        episodes=[f"e{n}" for n in range(n_episodes)],
        snapshot=snapshot,
        params="{}",
        code_version="c",
        n_operators=0,
        tables={},
    )
    evidence = pl.DataFrame(
        [
            {
                "operator": "Reach1", "episode_id": f"e{n}", "hand": "h", "start_ns": 0, "end_ns": 1,
                "binding": [], "contradicts": [],
            }
            for n in range(n_episodes)
        ],
        schema=Evidence.create_empty().schema,
    )  # fmt: skip
    return store.domains.put(
        version, text, Operators.create_empty(), Literals.create_empty(), Evidence.validate(evidence)
    )


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path)


def letters(store, name="stack"):
    ids = {content_hash(text)[:16]: letter for letter, text in TEXTS.items()}
    return "".join(ids[each.domain_id] for each in store.domains.history(name))


def test_the_latest_version_is_what_the_latest_evidence_gave(store):
    publish(store, "a", "s1")
    publish(store, "b", "s2")
    again = publish(store, "a", "s1")
    assert letters(store) == "aba"
    assert store.domains.latest("stack") == again == store.domains.find("stack")
    assert [version.parent for version in store.domains.versions()] == [None, again.domain_id]
    assert verify(store) == []


def test_publishing_the_same_again_adds_nothing_to_the_history(store):
    for _ in range(3):
        publish(store, "a", "s1")
    assert letters(store) == "a"


def test_the_same_text_from_other_evidence_shows_that_evidence_and_keeps_the_first(store):
    first = publish(store, "a", "s" * 20, n_episodes=1)
    second = publish(store, "a", "t" * 20, n_episodes=3)
    assert first.domain_id == second.domain_id
    assert store.domains.tables(store.domains.latest("stack"))[2].height == 3
    assert store.domains.tables(first)[2].height == 1
    back = publish(store, "a", "s" * 20, n_episodes=1)
    assert store.domains.tables(store.domains.latest("stack"))[2].height == 1
    assert back == first
    assert letters(store) == "aaa"
    assert verify(store) == []


def test_order_does_not_rest_on_the_clock(store, monkeypatch):
    now = iter(range(10_000, 0, -1000))
    monkeypatch.setattr("time.time_ns", lambda: next(now))
    for letter, snapshot in (("a", "s1"), ("b", "s2"), ("a", "s1")):
        publish(store, letter, snapshot)
    assert letters(store) == "aba"
    assert [each.made_at_ns for each in store.domains.history("stack")] == [10_000, 9000, 8000]


def test_an_order_that_an_earlier_version_kept_becomes_the_start_of_the_history(store):
    publish(store, "b", "s1")
    publish(store, "a", "s2")
    folder = store.root / "domains/stack"
    history = (folder / "history.jsonl").read_text().splitlines()
    (folder / "history.jsonl").unlink()
    (folder / "order.txt").write_text("".join(f"{json.loads(line)['domain_id']}\n" for line in history))
    assert letters(store) == "ba"
    publish(store, "b", "s1")
    assert letters(store) == "bab"


def test_a_version_whose_process_died_before_its_line_is_there_and_is_the_latest_when_published_again(store):
    publish(store, "a", "s1")
    history = (store.root / "domains/stack/history.jsonl").read_text()
    publish(store, "b", "s2")
    (store.root / "domains/stack/history.jsonl").write_text(history)
    assert sorted(letters(store)) == ["a", "b"]
    assert letters(store)[-1] == "a"
    publish(store, "b", "s2")
    assert letters(store)[-1] == "b"


def test_a_version_without_metadata_is_no_version_and_is_completed_when_it_is_published_again(store):
    version = publish(store, "a", "s1")
    folder = store.root / "domains/stack" / version.domain_id
    (folder / "metadata.json").unlink()
    (store.root / "domains/stack/history.jsonl").unlink()
    assert store.domains.versions() == []
    assert [fault.kind for fault in verify(store)] == ["leftover"]
    publish(store, "a", "s1")
    assert verify(store) == []
    assert letters(store) == "a"


def test_names_have_histories_of_their_own(store):
    publish(store, "a", "s1")
    publish(store, "b", "s1", name="other")
    shutil.rmtree(store.root / "domains/stack")
    assert letters(store, "other") == "b"
    assert store.domains.latest("stack") is None
