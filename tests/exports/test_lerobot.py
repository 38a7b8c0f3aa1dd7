"""A LeRobot dataset as the format's documentation describes it, and as the real lerobot reads it.

Two short made-up episodes, whose every exported number can be said in advance.
"""

import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demoplan.errors import DataError, UnknownNameError, UsageError
from demoplan.exports.lerobot import DatasetFacts, EpisodeContent, LeRobotParams, licence_id, write_dataset
from demoplan.exports.lerobot.statistics import QUANTILES, figures_of, joined
from demoplan.exports.lerobot.vectors import vectors_of
from demoplan.manifests.dataset import Dataset, Episode
from demoplan.pipeline.exporting import split_of_episodes
from demoplan.tables import Activities, Frames

TICK_NS = 10_000_000
START_NS = 1_790_000_000_000_000_000
N_TICKS = 100
TURN = np.array([0.8, 0.0, 0.0, 0.6])


def track(entity, positions, *, turns=None, grips=None, unseen=()):
    """Frames of one entity; ticks in ``unseen`` are null."""
    n = len(positions)
    turns = np.tile(TURN, (n, 1)) if turns is None else turns
    gone = np.isin(np.arange(n), list(unseen))
    return pl.DataFrame(
        {
            "episode_id": ["e"] * n,
            "entity": [entity] * n,
            "tick_ns": START_NS + TICK_NS * np.arange(n),
            "position_xyz_m": pl.Series(
                [None if g else list(p) for g, p in zip(gone, positions, strict=True)],
                dtype=pl.Array(pl.Float64, 3),
            ),
            "orientation_wxyz": pl.Series(
                [None if g else list(q) for g, q in zip(gone, turns, strict=True)],
                dtype=pl.Array(pl.Float64, 4),
            ),
            "grip": pl.Series([None] * n if grips is None else list(grips), dtype=pl.Float64),
            "pose_age_ns": pl.Series([None if g else 0 for g in gone], dtype=pl.Int64),
        }
    )


def frames_of(*tracks):
    return Frames.validate(pl.concat(tracks), cast=True)


def ramp(offset=0.0):
    """Positions that tell their tick: x is 0.01 m per tick."""
    x = offset + 0.01 * np.arange(N_TICKS)
    return np.column_stack((x, np.full(N_TICKS, 0.5), np.full(N_TICKS, 1.0)))


def activities_of(*rows):
    table = [("e", hand, START_NS + a * TICK_NS, START_NS + b * TICK_NS, *rest) for hand, a, b, *rest in rows]
    schema = {name: column.dtype for name, column in Activities.columns().items()}
    return Activities.validate(pl.DataFrame(table, schema=schema, orient="row"))


@pytest.fixture
def facts():
    return DatasetFacts(
        name="made-up",
        description="Two hands | and a *cube*.",
        licence="apache-2.0",
        licence_words="Apache-2.0",
        source="made up",
        world="world",
        tick_rate_hz=100.0,
        hands=("Left_hand", "Right_hand"),
        gripping=("Right_hand",),
        objects=("cube_red",),
        activities_from="as made up",
        version="0",
        manifest_sha256="0" * 64,
    )


@pytest.fixture
def episodes():
    """Two episodes of one second; in the first the cube is out of sight from tick 40 to 60."""

    def frames(gap):
        return frames_of(
            track("Left_hand", ramp()),
            track("Right_hand", ramp(1.0), grips=np.linspace(1.0, 0.0, N_TICKS)),
            track("cube_red", ramp(2.0), unseen=gap),
        )

    moves = activities_of(
        ("Left_hand", 0, N_TICKS, "Idle", None, None),
        ("Right_hand", 0, 30, "Reach", "cube_red", None),
        ("Right_hand", 30, 70, "Take", "cube_red", "cube_red"),
        ("Right_hand", 70, N_TICKS, "Put", "table", "cube_red"),
    )

    def episode(name, split, gap, *, is_goal_reached):
        return EpisodeContent(
            episode_id=name,
            participant=name[:2],
            task="lift the cube",
            goal="inHand(Right_hand, cube_red)",
            is_goal_reached=is_goal_reached,
            status="complete",
            log_sha256="ab" * 32,
            split=split,
            manifest_splits=(),
            frames=lambda: frames(gap),
            activities=lambda: moves,
        )

    return [
        episode("p1-lift", "train", range(40, 60), is_goal_reached=True),
        episode("p2-lift", "test", (), is_goal_reached=False),
    ]


@pytest.fixture
def written(tmp_path, facts, episodes):
    write_dataset(tmp_path / "out", facts, episodes, LeRobotParams(fps=50))
    return tmp_path / "out"


def data(folder, chunk=0, file=0):
    return pq.read_table(folder / f"data/chunk-{chunk:03d}/file-{file:03d}.parquet")


def column(table, name):
    return np.array(table[name].to_pylist())


def test_the_folder_has_the_files_of_the_format_and_nothing_else(written):
    assert sorted(str(p.relative_to(written)) for p in written.rglob("*") if p.is_file()) == [
        "README.md",
        "data/chunk-000/file-000.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "meta/info.json",
        "meta/stats.json",
        "meta/subtasks.parquet",
        "meta/tasks.parquet",
    ]
    assert [p.name for p in written.parent.iterdir()] == ["out"]


def test_every_declared_feature_is_a_column_of_its_shape_and_type(written):
    info = json.loads((written / "meta/info.json").read_text())
    table = data(written)
    assert info["codebase_version"] == "v3.0"
    assert table.column_names == list(info["features"])
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (2, 100, 1)
    assert table.num_rows == 100
    for name, feature in info["features"].items():
        values = column(table, name)
        assert list(values.shape[1:]) == (feature["shape"] if feature["shape"] != [1] else []), name
        kind = table.schema.field(name).type
        leaf = kind.value_type if hasattr(kind, "value_type") else kind
        assert str(leaf) == {"float32": "float", "int64": "int64", "bool": "bool"}[feature["dtype"]]
        if feature["names"] is not None:
            assert len(feature["names"]) == feature["shape"][0]


def test_indices_and_times_count_frames_within_episodes_and_over_all(written):
    table = data(written)
    assert column(table, "index").tolist() == list(range(100))
    assert column(table, "episode_index").tolist() == [0] * 50 + [1] * 50
    assert column(table, "frame_index").tolist() == list(range(50)) * 2
    np.testing.assert_allclose(column(table, "timestamp"), np.tile(np.arange(50) / 50, 2), atol=1e-6)
    episodes = pq.read_table(written / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"], e["length"]) for e in episodes] == [
        (0, 50, 50),
        (50, 100, 50),
    ]
    assert [(e["episode_id"], e["success"], e["split"], e["tasks"]) for e in episodes] == [
        ("p1-lift", True, "train", ["lift the cube"]),
        ("p2-lift", False, "test", ["lift the cube"]),
    ]


def test_the_state_is_the_pose_at_its_time_and_the_action_is_the_next_state(written):
    info = json.loads((written / "meta/info.json").read_text())
    names = info["features"]["observation.state"]["names"]
    assert names[:2] == ["Left_hand.x_m", "Left_hand.y_m"]
    assert names[-1] == "Right_hand.grip"
    assert "Left_hand.grip" not in names
    table = data(written)
    state, action = column(table, "observation.state")[:50], column(table, "action")[:50]
    np.testing.assert_allclose(state[:, names.index("Left_hand.x_m")], 0.02 * np.arange(50), atol=1e-6)
    np.testing.assert_allclose(state[:, 3:7], np.tile(TURN, (50, 1)), atol=1e-6)
    np.testing.assert_allclose(state[:, -1], np.linspace(1, 0, N_TICKS)[::2], atol=1e-6)
    np.testing.assert_array_equal(action[:-1], state[1:])
    np.testing.assert_array_equal(action[-1], state[-1])


def test_what_was_not_seen_is_held_and_said_to_be_so(written):
    info = json.loads((written / "meta/info.json").read_text())
    flags = info["features"]["observation.is_seen"]["names"]
    assert flags == ["Left_hand", "Right_hand", "Right_hand.grip", "cube_red"]
    table = data(written)
    seen = column(table, "observation.is_seen")[:50, flags.index("cube_red")]
    x = column(table, "observation.environment_state")[:50, 0]
    assert np.flatnonzero(~seen).tolist() == list(range(20, 30))
    np.testing.assert_allclose(x[20:30], 2.0 + 0.01 * 39, atol=1e-6)
    np.testing.assert_allclose(x[30], 2.0 + 0.01 * 60, atol=1e-6)


def test_subtasks_say_what_each_hand_does_and_change_when_the_activity_does(written):
    table = data(written)
    texts = pq.read_table(written / "meta/subtasks.parquet").to_pylist()
    assert [row["subtask_index"] for row in texts] == list(range(len(texts)))
    names = [row["subtask"] for row in texts]
    joint = [names[k] for k in column(table, "subtask_index")[:50]]
    assert joint[14] == "Left_hand: Idle; Right_hand: Reach cube_red"
    assert joint[15] == "Left_hand: Idle; Right_hand: Take cube_red"
    assert joint[35:] == ["Left_hand: Idle; Right_hand: Put cube_red to table"] * 15
    right = [names[k] for k in column(table, "subtask_index.Right_hand")[:50]]
    assert [right[0], right[20], right[49]] == ["Reach cube_red", "Take cube_red", "Put cube_red to table"]


def test_the_last_frame_says_that_it_is_the_last_and_whether_the_goal_was_reached(written):
    table = data(written)
    assert np.flatnonzero(column(table, "next.done")).tolist() == [49, 99]
    assert np.flatnonzero(column(table, "next.success")).tolist() == [49]


def test_success_that_is_not_stated_is_no_failure(tmp_path, facts, episodes):
    unstated = [episodes[0], replace(episodes[1], is_goal_reached=None)]
    write_dataset(tmp_path / "out", facts, unstated, LeRobotParams(fps=50))
    assert "next.success" not in data(tmp_path / "out").column_names
    rows = pq.read_table(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet")["success"].to_pylist()
    assert rows == [True, None]
    assert "not stated: 1" in (tmp_path / "out/README.md").read_text()


def test_statistics_are_those_of_the_columns(written):
    stats = json.loads((written / "meta/stats.json").read_text())
    state = column(data(written), "observation.state").astype(np.float64)
    for figure, expected in (
        ("min", state.min(axis=0)),
        ("max", state.max(axis=0)),
        ("mean", state.mean(axis=0)),
        ("std", state.std(axis=0)),
    ):
        np.testing.assert_allclose(stats["observation.state"][figure], expected, atol=1e-9)
    assert stats["observation.state"]["count"] == [100]
    row = pq.read_table(written / "meta/episodes/chunk-000/file-000.parquet").to_pylist()[0]
    np.testing.assert_allclose(row["stats/observation.state/q50"], np.quantile(state[:50], 0.5, axis=0))
    assert set(QUANTILES) <= set(stats["action"])


@given(
    st.lists(
        st.lists(st.floats(-1e3, 1e3, allow_nan=False, width=32), min_size=1, max_size=20),
        min_size=1,
        max_size=6,
    )
)
def test_joining_episodes_gives_the_figures_of_all_frames_at_once(parts):
    whole = figures_of(np.concatenate([np.array(part) for part in parts]))
    pieces = joined([{"f": figures_of(np.array(part))} for part in parts])["f"]
    for figure in ("min", "max", "mean", "std", "count"):
        np.testing.assert_allclose(pieces[figure], whole[figure], rtol=1e-6, atol=1e-6)
    for quantile in QUANTILES:
        assert whole["min"] - 1e-9 <= pieces[quantile] <= whole["max"] + 1e-9


def test_equal_arguments_give_equal_bytes(tmp_path, facts, episodes):
    for name in ("one", "two"):
        write_dataset(tmp_path / name, facts, episodes, LeRobotParams(fps=20, has_language=True))
    for path in (tmp_path / "one").rglob("*"):
        if path.is_file():
            assert path.read_bytes() == (tmp_path / "two" / path.relative_to(tmp_path / "one")).read_bytes()


def test_files_begin_anew_when_they_are_large_and_episodes_say_where_they_are(tmp_path, facts, episodes):
    write_dataset(
        tmp_path / "out", facts, episodes, LeRobotParams(fps=100, data_file_mb=0, files_per_chunk=1)
    )
    rows = pq.read_table(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["data/chunk_index"], row["data/file_index"]) for row in rows] == [(0, 0), (1, 0)]
    assert column(data(tmp_path / "out", 1, 0), "episode_index").tolist() == [1] * N_TICKS


def test_a_rate_that_does_not_divide_the_clock_takes_the_nearest_ticks(facts, episodes):
    vectors = vectors_of(episodes[0].frames(), facts, 30)
    wanted = np.arange(len(vectors.ticks_ns)) / 30
    got = (vectors.ticks_ns - START_NS) * 1e-9
    assert len(wanted) == 30
    assert np.abs(got - wanted).max() <= 0.005 + 1e-9


def test_rotations_do_not_jump_in_sign(facts):
    turns = np.tile(TURN, (N_TICKS, 1)) * np.where(np.arange(N_TICKS) % 3 == 0, -1.0, 1.0)[:, None]
    frames = frames_of(track("Left_hand", ramp(), turns=turns))
    state = vectors_of(frames, facts, 100).state
    np.testing.assert_allclose(state[:, 3:7], np.tile(TURN, (N_TICKS, 1)), atol=1e-6)


def test_a_rate_above_the_clock_is_refused(facts, episodes):
    with pytest.raises(DataError, match="200 frames per second were asked for; the episodes have 100"):
        vectors_of(episodes[0].frames(), facts, 200)


def test_nothing_that_is_there_is_overwritten_unasked(tmp_path, facts, episodes):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("years")
    for flag in (False, True):
        with pytest.raises(UsageError, match="is there already, and is no LeRobot dataset"):
            write_dataset(tmp_path / "other", facts, episodes, LeRobotParams(fps=50), is_overwriting=flag)
    assert (tmp_path / "other" / "thesis.tex").read_text() == "years"
    write_dataset(tmp_path / "out", facts, episodes, LeRobotParams(fps=50))
    with pytest.raises(UsageError, match="--overwrite"):
        write_dataset(tmp_path / "out", facts, episodes, LeRobotParams(fps=50))
    write_dataset(tmp_path / "out", facts, episodes[:1], LeRobotParams(fps=50), is_overwriting=True)
    assert data(tmp_path / "out").num_rows == 50


def test_an_export_that_fails_leaves_what_was_there(tmp_path, facts, episodes):
    write_dataset(tmp_path / "out", facts, episodes, LeRobotParams(fps=50))
    with pytest.raises(DataError):
        write_dataset(tmp_path / "out", facts, episodes, LeRobotParams(fps=500), is_overwriting=True)
    assert data(tmp_path / "out").num_rows == 100
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_the_card_names_licence_splits_and_components_and_shows_names_as_they_are(written):
    card = (written / "README.md").read_text()
    assert card.startswith("---\nlicense: apache-2.0\n")
    assert "| train | 0:1 | 1 | p1 |" in card
    assert "Nobody is in two splits" in card
    assert "Two hands \\| and a \\*cube\\*." in card
    assert "`Right_hand.grip`" in card


def test_the_card_of_data_without_a_licence_says_not_to_pass_it_on(tmp_path, facts, episodes):
    unlicensed = replace(facts, licence=None, licence_words="none stated")
    write_dataset(tmp_path / "out", unlicensed, episodes, LeRobotParams(fps=50))
    card = (tmp_path / "out/README.md").read_text()
    assert "license: unknown" in card
    assert "Do not pass this dataset on" in card
    assert "none stated" in card


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("Apache-2.0", "apache-2.0"),
        ("CC BY 4.0", "cc-by-4.0"),
        ("ODbL-1.0", "odbl"),
        ("", None),
        ("none stated; for local evaluation only", None),
        ("proprietary", None),
        ("not MIT", None),
    ],
)
def test_only_words_that_are_a_licence_count_as_one(words, expected):
    assert licence_id(words) == expected


def dataset_of(splits=None, people=("p1", "p1", "p2", "p3")):
    episodes = tuple(
        Episode(id=f"e{k}", file=f"e{k}.mcap", participant=person, task="t")
        for k, person in enumerate(people)
    )
    mapping = {"entities": {}, "topics": {}}
    return Dataset(name="d", vocabulary="v.yaml", mapping=mapping, episodes=episodes, splits=splits or {})


IDS = ("e0", "e1", "e2", "e3")


@pytest.mark.parametrize(
    ("dataset", "choice", "expected"),
    [
        (dataset_of(), {}, ("train", "train", "train", "test")),
        (dataset_of(), {"held_out": ("p1",)}, ("test", "test", "train", "train")),
        (dataset_of(people=("p1",) * 4), {}, ("train",) * 4),
        (dataset_of({"a": ("e0",), "b": ("e2", "e3")}), {}, ("a", "rest", "b", "b")),
        (dataset_of({"a": ("e0", "e2"), "b": ("e2",)}), {}, ("train", "train", "train", "test")),
        (
            dataset_of({"a": ("e0", "e2"), "b": ("e2",)}),
            {"trained_on": "a"},
            ("train", "test", "train", "test"),
        ),
    ],
)
def test_splits_leave_participants_out_unless_the_manifest_parts_the_episodes(dataset, choice, expected):
    assert tuple(split_of_episodes(dataset, IDS, **choice).values()) == expected


def test_splits_that_make_no_sense_are_refused():
    with pytest.raises(UnknownNameError, match="unknown participant 'p9'"):
        split_of_episodes(dataset_of(), IDS, held_out=("p9",))
    with pytest.raises(UnknownNameError, match="unknown split 'a'"):
        split_of_episodes(dataset_of(), IDS, trained_on="a")
    with pytest.raises(UsageError, match="nothing is left to train on"):
        split_of_episodes(dataset_of(), IDS, held_out=("p1", "p2", "p3"))


@pytest.fixture(scope="session")
def lerobot_python():
    """A Python that has lerobot, which pins an older rerun and so cannot share our environment."""
    python = os.environ.get("DEMOPLAN_LEROBOT_PYTHON")
    if not python:
        pytest.skip("the real lerobot is not here: set DEMOPLAN_LEROBOT_PYTHON to a Python that has it")
    return python


@pytest.mark.slow
@pytest.mark.parametrize("has_language", [False, True])
def test_the_real_lerobot_reads_back_what_was_written(
    tmp_path, facts, episodes, lerobot_python, has_language
):
    write_dataset(tmp_path / "out", facts, episodes, LeRobotParams(fps=50, has_language=has_language))
    ended = subprocess.run(
        [lerobot_python, Path(__file__).with_name("read_with_lerobot.py"), tmp_path / "out"],
        capture_output=True,
        text=True,
        env={"PATH": os.environ["PATH"], "HOME": str(tmp_path), "HF_HUB_OFFLINE": "1"},
        check=False,
        timeout=300,
    )
    assert ended.returncode == 0, ended.stderr
    read = json.loads(ended.stdout)
    assert (read["n_frames"], read["fps"], read["splits"]) == (100, 50, {"train": "0:1", "test": "1:2"})
    assert read["shapes"]["observation.state"] == [15]
    assert read["chunk"] == [4, 2, 15]
    table = data(tmp_path / "out")
    names = [row["subtask"] for row in pq.read_table(tmp_path / "out/meta/subtasks.parquet").to_pylist()]
    for number, episode in enumerate(read["episodes"]):
        rows = slice(50 * number, 50 * (number + 1))
        assert episode["episode_id"] == episodes[number].episode_id
        assert episode["success"] == episodes[number].is_goal_reached
        assert episode["task"] == "lift the cube"
        assert episode["subtasks"] == [names[k] for k in column(table, "subtask_index")[rows]]
        assert episode["done"] == [False] * 49 + [True]
        np.testing.assert_array_equal(episode["state"], column(table, "observation.state")[rows])
        np.testing.assert_array_equal(episode["action"], column(table, "action")[rows])
        np.testing.assert_array_equal(episode["is_seen"], column(table, "observation.is_seen")[rows])
