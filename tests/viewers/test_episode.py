"""An episode's recording is read back: entities, row counts, gaps, layout; names from logs are data."""

import dataclasses
import subprocess

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from demoplan import tables
from demoplan.errors import DemoplanError, UnknownNameError, UsageError
from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.language.vocabulary import PredicateRule, Shape, Vocabulary
from demoplan.manifests.mapping import Mapping
from demoplan.viewers import rerun_adapter
from demoplan.viewers.compose import compose_episode
from demoplan.viewers.episode import open_episode, render_episode_png, save_episode
from demoplan.viewers.episode_view import Entity, Threshold
from demoplan.viewers.lanes import fact_lanes_of, relation_lanes_of
from demoplan.viewers.sources import EpisodeTables, entities_of, thresholds_of

EPISODE = "p1-two-both"
GAP_TICKS = {"cube_green": 250, "Left_hand": 60}


@pytest.fixture(scope="module")
def sources(frames, facts, activities, truth, evidence, episodes, looks):
    entities = tuple(
        Entity(name=n, type_name=t, shape=s, is_hand=t == "Hand", is_surface=t == "Table")
        for n, (t, s) in looks.items()
    )
    return EpisodeTables(
        episode_id=EPISODE,
        frames=frames,
        entities=entities,
        episodes=episodes,
        facts=facts,
        activities=activities,
        truth=truth,
        evidence=evidence,
        thresholds=(Threshold(quantity="speed", name="handMove.enter_m_per_s", value=0.06),),
    )


@pytest.fixture(scope="module")
def recording(sources, tmp_path_factory):
    return save_episode(tmp_path_factory.mktemp("view") / "deep" / "episode.rrd", sources)


def _chunks(recording, path):
    return [c for c in RrdReader(recording).stream() if c.entity_path == path]


def test_the_recording_is_the_episodes_and_brings_its_layout(recording):
    reader = RrdReader(recording)
    assert [(e.application_id, e.recording_id) for e in reader.recordings()] == [("demoplan", EPISODE)]
    assert len(reader.blueprints()) == 1


def test_every_hand_has_lanes_inferred_above_true_above_operators(recording):
    rows = rerun_adapter.viewer_paths(recording)
    assert [p for p in sorted(rows) if p.startswith("/Right_hand")] == [
        "/Right_hand/activity",
        "/Right_hand/activity_true",
        "/Right_hand/operator",
    ]


def test_an_activity_lane_changes_state_once_per_activity_and_ends_with_the_episode(recording, activities):
    rows = rerun_adapter.viewer_paths(recording)
    for hand in ("Left_hand", "Right_hand"):
        n = activities.filter(pl.col("hand") == hand).height
        assert rows[f"/{hand}/activity"] == n + 1


def test_every_atom_that_ever_held_or_was_unknown_has_a_lane_and_no_other(recording, facts):
    expected = {"/".join(("", row["predicate"], *row["arguments"])) for row in facts.to_dicts()}
    predicates = tuple(f"/{name}/" for name in facts["predicate"].unique())
    relations = {"/".join(("", *lane.path)) for lane in relation_lanes_of(facts)}
    rows = rerun_adapter.viewer_paths(recording)
    assert {p for p in rows if p.startswith(predicates)} == expected | relations


def test_poses_are_sent_where_they_were_seen_only(recording):
    for path, entity, extra in (
        ("/world/objects/cube_red", "cube_red", 0),
        ("/world/objects/cube_green", "cube_green", GAP_TICKS["cube_green"]),
    ):
        chunks = [c for c in _chunks(recording, path) if not c.is_static]
        poses = sum(
            c.num_rows for c in chunks if "Transform3D:translation" in c.to_record_batch().schema.names
        )
        assert poses == 3000 - extra, entity


def test_what_is_lost_from_sight_is_cleared_and_comes_back(recording):
    shown = []
    for chunk in _chunks(recording, "/world/objects/cube_green"):
        batch = chunk.to_record_batch()
        if "Boxes3D:half_sizes" in batch.schema.names and not chunk.is_static:
            seconds = [t.value / 1e9 for t in batch["episode"]]
            shown += list(
                zip(seconds, [len(v) for v in batch["Boxes3D:half_sizes"].to_pylist()], strict=True)
            )
    assert sorted(shown) == [(0.0, 1), (10.0, 0), (12.5, 1)]


def test_both_timelines_hold_integer_nanoseconds(recording, frames):
    first = int(frames["tick_ns"].min())
    for chunk in _chunks(recording, "/signals/speed/Right_hand"):
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            absolute = np.array([t.value for t in batch["clock"]])
            relative = np.array([t.value for t in batch["episode"]])
            assert (absolute - relative == first).all()
            assert (np.diff(np.sort(relative)) == 10_000_000).all()


def test_writing_is_whole_or_not_at_all(sources, tmp_path, monkeypatch):
    target = tmp_path / "episode.rrd"
    target.write_bytes(b"older")

    def fail(view, path):
        path.write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(rerun_adapter, "write_recording", fail)
    with pytest.raises(OSError, match="disk full"):
        save_episode(target, sources)
    assert target.read_bytes() == b"older"
    assert [p.name for p in tmp_path.iterdir()] == ["episode.rrd"]


def test_another_suffix_is_refused(sources, tmp_path):
    with pytest.raises(UsageError, match=r"ends in \.rrd; asked for 'episode\.mcap'"):
        save_episode(tmp_path / "episode.mcap", sources)


def test_an_unknown_episode_names_those_that_there_are(sources):
    other = EpisodeTables(episode_id="p9", frames=sources.frames, entities=())
    with pytest.raises(UnknownNameError, match="unknown episode 'p9' in the frames; available: p1-two-both"):
        compose_episode(other)


def test_frames_alone_are_enough(frames, tmp_path):
    path = save_episode(tmp_path / "bare.rrd", EpisodeTables(episode_id=EPISODE, frames=frames, entities=()))
    rows = rerun_adapter.viewer_paths(path)
    assert "/world/objects/cube_red" in rows
    assert all(p.startswith(("/world", "/signals", "/__properties")) for p in rows)


def test_names_from_logs_cannot_climb_into_other_entities(frames, tmp_path):
    hostile = "../../hands/x [evil]"
    renamed = tables.Frames.validate(
        frames.with_columns(pl.col("entity").replace({"cube_red": hostile})).sort("entity", "tick_ns")
    )
    path = save_episode(tmp_path / "bad.rrd", EpisodeTables(episode_id=EPISODE, frames=renamed, entities=()))
    assert [p for p in rerun_adapter.viewer_paths(path) if "evil" in p] == [
        r"/world/objects/..\/..\/hands\/x\ \[evil\]"
    ]


def test_a_contact_line_joins_cube_and_nearest_point_of_the_table(sources):
    view = compose_episode(sources)
    first = view.contacts.lines_xyz_m[: view.contacts.counts[0]]
    feet = [line for line in first if np.isclose(line[:, 2].min(), 0.0, atol=2e-3)]
    assert len(feet) == 4
    for line in feet:
        assert np.allclose(line[0, :2], line[1, :2], atol=2e-3)


def test_contact_lines_end_when_the_contact_ends(sources, facts):
    view = compose_episode(sources)
    touching = facts.filter((pl.col("predicate") == "inTouch") & (pl.col("value") == "true"))
    at = np.searchsorted(view.contacts.ticks_ns, touching["end_ns"].to_numpy())
    assert (view.contacts.ticks_ns[at] == touching["end_ns"].to_numpy()).all()


@pytest.mark.parametrize("second", [0.5, 3.0, 6.1, 12.0, 17.7, 29.9])
def test_there_are_as_many_contact_lines_as_contacts_in_sight(sources, facts, second):
    view = compose_episode(sources)
    instant = view.start_ns + int(second * 1e9)
    holding = facts.filter(
        (pl.col("predicate") == "inTouch") & (pl.col("start_ns") <= instant) & (pl.col("end_ns") > instant)
    )
    hidden = {"cube_green"} if 10.0 <= second < 12.5 else set()
    expected = sum(1 for pair in holding["arguments"].to_list() if not hidden & set(pair))
    at = np.searchsorted(view.contacts.ticks_ns, instant, side="right") - 1
    assert view.contacts.counts[at] == expected


def test_speed_is_what_the_thresholds_are_compared_with_and_unknown_where_unseen(sources):
    (chart,) = [c for c in compose_episode(sources).charts if c.name == "speed"]
    assert [t.name for t in chart.thresholds] == ["handMove.enter_m_per_s"]
    (left,) = [c for c in chart.curves if c.name == "Left_hand"]
    assert np.flatnonzero(np.isnan(left.values)).tolist() == list(range(400, 460))
    seconds = (left.ticks_ns - left.ticks_ns[0]) * 1e-9
    assert np.median(left.values[seconds < 3.9]) < 0.03
    assert left.values[(seconds > 9.0) & (seconds < 10.2)].max() > 0.3


def test_a_hand_with_an_extent_is_a_point_seen_through_it(sources, tmp_path):
    palm = Entity(
        name="Right_hand", type_name="Hand", shape=Shape("sphere", (0.16, 0.16, 0.16)), is_hand=True
    )
    others = tuple(e for e in sources.entities if e.name != "Right_hand")
    path = save_episode(tmp_path / "palm.rrd", dataclasses.replace(sources, entities=(*others, palm)))
    names = {n for c in _chunks(path, "/world/hands/Right_hand") for n in c.to_record_batch().schema.names}
    assert {"Ellipsoids3D:half_sizes", "Points3D:positions", "Points3D:radii"} <= names


def test_trails_do_not_bridge_gaps(sources):
    (left,) = [t for t in compose_episode(sources).trails if t.name == "Left_hand"]
    start = compose_episode(sources).start_ns
    seconds = (left.ticks_ns - start) * 1e-9
    assert not ((seconds > 4.0) & (seconds <= 4.6)).any()


VOCABULARY = Vocabulary(
    types=TypeHierarchy.of({"Hand": "object", "Table": "Surface", "Cube": "Graspable", "WoodenCube": "Cube"}),
    predicates=(
        PredicateRule(
            Signature("handMove", ("Hand",)), "moving", (("enter_m_per_s", 0.06), ("exit_m_per_s", 0.04))
        ),
        PredicateRule(
            Signature("handOpen", ("Hand",)), "hand_open", (("enter_fraction", 0.6), ("min_true_s", 0.05))
        ),
        PredicateRule(Signature("inTouch", ("object", "object")), "in_touch", (("enter_m", 0.01),)),
    ),
    shapes=(("Cube", Shape("box", (0.05, 0.05, 0.05))),),
)


def test_entities_take_their_own_shape_or_their_nearest_ancestors():
    mapping = Mapping.model_validate(
        {
            "entities": {
                "cube": {"type": "WoodenCube"},
                "Right_hand": {"type": "Hand"},
                "table": {
                    "type": "Table",
                    "shape": {"size_xyz_m": [1, 1, 0.02]},
                    "fixed": {"position_xyz_m": [0, 0, -0.01]},
                },
            },
            "topics": {},
        }
    )
    hand, cube, table = entities_of(mapping, VOCABULARY)
    assert (hand.name, hand.shape.kind, hand.is_hand) == ("Right_hand", "point", True)
    assert (cube.shape, cube.is_hand, cube.is_surface) == (Shape("box", (0.05, 0.05, 0.05)), False, False)
    assert (table.is_surface, table.fixed_position_xyz_m) == (True, (0.0, 0.0, -0.01))


def test_thresholds_are_those_of_a_hands_speed_and_grip():
    assert [(t.quantity, t.name, t.value) for t in thresholds_of(VOCABULARY)] == [
        ("speed", "handMove.enter_m_per_s", 0.06),
        ("speed", "handMove.exit_m_per_s", 0.04),
        ("grip", "handOpen.enter_fraction", 0.6),
    ]


def test_opening_what_is_not_there_says_how_to_make_it(tmp_path):
    with pytest.raises(UsageError, match="no recording at"):
        open_episode(tmp_path / "none.rrd")
    with pytest.raises(UsageError, match="no recording at"):
        render_episode_png(tmp_path / "none.rrd", tmp_path / "none.png")


def test_a_viewer_that_does_not_answer_is_named(recording):
    with pytest.raises(DemoplanError, match=r"no rerun viewer answers at rerun\+http://127\.0\.0\.1:1/proxy"):
        open_episode(recording, url="rerun+http://127.0.0.1:1/proxy")


@pytest.mark.parametrize("n_ticks", [1, 2])
def test_the_shortest_episodes_can_be_shown(frames, tmp_path, n_ticks):
    first = frames["tick_ns"].min()
    short = tables.Frames.validate(frames.filter(pl.col("tick_ns") < first + n_ticks * 10_000_000))
    hand = Entity(name="Left_hand", type_name="Hand", shape=Shape("point", (0, 0, 0)), is_hand=True)
    path = save_episode(tmp_path / "s.rrd", EpisodeTables(episode_id=EPISODE, frames=short, entities=(hand,)))
    assert rerun_adapter.viewer_paths(path)["/signals/grip/Left_hand"] == n_ticks


def test_what_was_never_seen_is_not_drawn(sources, facts):
    gone = tables.Frames.validate(
        sources.frames.with_columns(
            pl.when(pl.col("entity") != "cube_red").then(pl.col(c)).alias(c)
            for c in ("position_xyz_m", "orientation_wxyz", "pose_age_ns")
        )
    )
    view = compose_episode(dataclasses.replace(sources, frames=gone))
    (red,) = [body for body in view.bodies if body.entity.name == "cube_red"]
    assert (len(red.ticks_ns), len(red.change_ticks_ns)) == (0, 0)
    assert np.isfinite(view.contacts.lines_xyz_m).all()


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(1, 5), st.sampled_from("abc")), min_size=1, max_size=12)
)
def test_a_lane_shows_at_every_tick_the_state_that_its_table_says(parts):
    spans, cursor = [], 0
    for gap, length, state in parts:
        spans.append((cursor + gap, cursor + gap + length, state))
        cursor += gap + length
    table = pl.DataFrame(
        [("e", "p", [state], start, end, "true") for start, end, state in spans],
        schema=["episode_id", "predicate", "arguments", "start_ns", "end_ns", "value"],
        orient="row",
    ).with_columns(arguments=pl.lit(["x"]))
    (lane,) = fact_lanes_of(table)
    assert (np.diff(lane.ticks_ns) > 0).all()
    for tick in range(cursor + 2):
        expected = "true" if any(start <= tick < end for start, end, _ in spans) else None
        at = int(np.searchsorted(lane.ticks_ns, tick, side="right")) - 1
        assert (lane.states[at] if at >= 0 else None) == expected


@pytest.mark.slow
def test_the_prepared_layout_draws_without_a_screen_and_leaves_no_viewer_behind(recording, tmp_path):
    try:
        png = render_episode_png(recording, tmp_path / "episode.png", at_ns=11 * 10**9, size_px=(1200, 800))
    except DemoplanError as error:
        if "Vulkan" in str(error):
            pytest.skip(str(error))
        raise
    assert png.read_bytes().startswith(b"\x89PNG")
    left = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True).stdout
    assert not [line for line in left.splitlines() if "--headless" in line and "1200x800" in line]
