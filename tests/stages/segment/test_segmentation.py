"""Activities that tile each hand's episode, by rules and by a trained segmenter."""

import dataclasses

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.errors import DataError, UnknownNameError
from demoplan.language.types import TypeHierarchy
from demoplan.stages.segment import (
    PUBLISHED_RULES,
    RULES,
    GranularActivity,
    RuleTree,
    SegmentParams,
    TrainParams,
    segment,
    train,
)
from demoplan.tables import Activities, Facts, Frames


def course(activities, hand="Right_hand"):
    return activities.filter(pl.col("hand") == hand).get_column("activity").to_list()


def assert_tiles(activities, frames):
    for (episode, hand), rows in activities.group_by("episode_id", "hand"):
        ticks = frames.filter((pl.col("episode_id") == episode) & (pl.col("entity") == hand))["tick_ns"]
        track = rows.sort("start_ns")
        assert track["start_ns"][0] == ticks.min()
        assert track["end_ns"][-1] > ticks.max()
        assert track["start_ns"][1:].to_list() == track["end_ns"][:-1].to_list()
        assert (track["activity"][1:] != track["activity"][:-1]).all()


def test_the_rules_name_what_they_were_published_for(demonstrate):
    d = demonstrate()
    found = segment(d.frames, d.facts, d.entities, d.types, PUBLISHED_RULES)
    assert course(found) == ["Idle", "Reach", "Take", "Put", "Take", "Release", "Idle"]
    assert course(found, "Left_hand") == ["Idle"]
    assert_tiles(found, d.frames)


def fact(facts, predicate, arguments, start_s, end_s):
    row = {
        "episode_id": "e1",
        "predicate": predicate,
        "arguments": arguments,
        "start_ns": 1_000_000_000 + round(start_s * 1e9),
        "end_ns": 1_000_000_000 + round(end_s * 1e9),
        "value": "true",
    }
    return Facts.validate(pl.concat([facts, pl.DataFrame([row], schema=facts.schema)]), cast=True)


def test_with_memory_a_rest_after_carrying_is_not_taking_again(demonstrate):
    d = demonstrate()
    found = segment(d.frames, d.facts, d.entities, d.types, RULES)
    assert course(found) == ["Idle", "Reach", "Take", "Put", "Release", "Idle"]
    assert_tiles(found, d.frames)


def test_with_memory_a_motion_reaches_from_its_beginning(demonstrate):
    d = demonstrate()
    facts = d.facts.filter(pl.col("predicate") != "actedOn")
    late = fact(facts, "actedOn", ["Right_hand", "cube"], 1.7, 2.0)
    published = segment(d.frames, late, d.entities, d.types, PUBLISHED_RULES)
    assert course(published)[:3] == ["Idle", "Release", "Reach"]
    assert course(segment(d.frames, late, d.entities, d.types, RULES))[:3] == ["Idle", "Reach", "Take"]


def test_with_memory_a_motion_that_comes_to_nothing_releases(demonstrate):
    d = demonstrate()
    passing = fact(d.facts, "actedOn", ["Right_hand", "bowl"], 4.6, 4.9)
    found = segment(d.frames, passing, d.entities, d.types, RULES)
    assert course(found) == ["Idle", "Reach", "Take", "Put", "Release", "Idle"]


def test_with_memory_a_rest_on_the_way_into_a_grasp_is_not_idle(demonstrate):
    d = demonstrate()
    facts = d.facts.filter(pl.col("predicate") != "inHand")
    late = fact(facts, "inHand", ["Right_hand", "cube"], 2.3, 4.4)
    assert "Idle" in course(segment(d.frames, late, d.entities, d.types, PUBLISHED_RULES))[1:-1]
    assert course(segment(d.frames, late, d.entities, d.types, RULES)) == [
        "Idle",
        "Reach",
        "Take",
        "Put",
        "Release",
        "Idle",
    ]


def test_with_memory_a_hand_that_only_rests_is_idle(demonstrate):
    d = demonstrate()
    assert course(segment(d.frames, d.facts, d.entities, d.types, RULES), "Left_hand") == ["Idle"]


def test_segments_say_what_is_acted_on_and_what_is_held(demonstrate):
    d = demonstrate()
    found = segment(d.frames, d.facts, d.entities, d.types, PUBLISHED_RULES)
    rows = found.filter(pl.col("hand") == "Right_hand").to_dicts()
    assert [(row["acted_on"], row["in_hand"]) for row in rows] == [
        (None, None),
        ("cube", None),
        (None, "cube"),
        (None, "cube"),
        (None, "cube"),
        ("cube", None),
        (None, None),
    ]


def test_an_object_that_is_grasped_within_a_segment_is_acted_on_in_it(demonstrate):
    d = demonstrate()
    facts = d.facts.filter(pl.col("predicate") != "inHand")
    late = fact(facts, "inHand", ["Right_hand", "cube"], 2.1, 4.4)
    frames = d.frames.with_columns(
        grip=pl.when(pl.col("entity") == "Right_hand").then(pl.col("grip") * 0.8).otherwise(pl.col("grip"))
    )
    found = segment(Frames.validate(frames), late, d.entities, d.types, RULES)
    take = found.filter(pl.col("activity") == "Take").row(0, named=True)
    assert (take["acted_on"], take["in_hand"]) == ("cube", "cube")


def test_doing_something_with_one_class_to_another_has_its_own_name(demonstrate):
    d = demonstrate()
    put = d.facts.filter(pl.col("predicate") == "handMove").row(1, named=True)
    over = pl.DataFrame(
        [{**put, "predicate": "actedOn", "arguments": ["Right_hand", "bowl"]}], schema=d.facts.schema
    )
    facts = Facts.validate(pl.concat([d.facts, over]), cast=True)
    rules = RuleTree(
        has_memory=False,
        granular=(GranularActivity(held_type="Graspable", acted_on_type="Bowl", activity="Pour"),),
    )
    found = segment(d.frames, facts, d.entities, d.types, rules)
    assert course(found) == ["Idle", "Reach", "Take", "Pour", "Take", "Release", "Idle"]
    assert found.filter(pl.col("activity") == "Pour").row(0, named=True)["acted_on"] == "bowl"


def test_without_facts_about_motion_the_rules_see_it_themselves(demonstrate):
    d = demonstrate()
    facts = Facts.cast(d.facts.filter(pl.col("predicate") != "handMove"))
    found = segment(d.frames, facts, d.entities, d.types)
    assert agreement(found, d.truth) > 0.9
    assert_tiles(found, d.frames)


def test_segments_shorter_than_the_limit_join_a_neighbour(demonstrate):
    d = demonstrate()
    params = SegmentParams(min_duration_s=0.9)
    found = segment(d.frames, d.facts, d.entities, d.types, params=params)
    lengths = (found["end_ns"] - found["start_ns"]) / 1e9
    assert lengths.min() >= 0.9
    assert_tiles(found, d.frames)


def test_a_cube_can_be_acted_on_with_a_cube_in_hand(demonstrate):
    d = demonstrate()
    entities = {**d.entities, "bowl": "Cube"}
    hold = d.facts.filter(pl.col("predicate") == "inHand").row(0, named=True)
    on = {**hold, "predicate": "actedOn", "arguments": ["Right_hand", "bowl"]}
    facts = Facts.validate(pl.concat([d.facts, pl.DataFrame([on], schema=d.facts.schema)]), cast=True)
    found = segment(d.frames, facts, entities, d.types)
    put = found.filter(pl.col("activity") == "Put").row(0, named=True)
    assert (put["acted_on"], put["in_hand"]) == ("bowl", "cube")


def test_no_frames_give_no_activities(demonstrate):
    d = demonstrate()
    found = segment(Frames.create_empty(), Facts.create_empty(), d.entities, d.types)
    assert found.height == 0
    assert found.schema == Activities.create_empty().schema


def test_a_recording_without_hands_gives_no_activities(demonstrate):
    d = demonstrate()
    frames = Frames.cast(d.frames.filter(~pl.col("entity").str.ends_with("hand")))
    assert segment(frames, Facts.create_empty(), d.entities, d.types).height == 0


def test_the_order_of_rows_does_not_matter(demonstrate, together):
    d = together(demonstrate("a"), demonstrate("b", seed=4))
    shuffled = Frames.cast(d.frames.sample(fraction=1.0, shuffle=True, seed=1))
    facts = Facts.cast(d.facts.sample(fraction=1.0, shuffle=True, seed=2))
    one = segment(d.frames, d.facts, d.entities, d.types)
    assert one.equals(segment(shuffled, facts, d.entities, d.types))


def test_an_entity_without_every_tick_is_refused(demonstrate):
    d = demonstrate()
    broken = Frames.cast(
        d.frames.filter(~((pl.col("entity") == "cube") & (pl.col("tick_ns") > 2_000_000_000)))
    )
    with pytest.raises(DataError, match="'e1'"):
        segment(broken, d.facts, d.entities, d.types)


def test_an_entity_of_an_unknown_type_is_refused(demonstrate):
    d = demonstrate()
    with pytest.raises(UnknownNameError, match="Spoon"):
        segment(d.frames, d.facts, {**d.entities, "cube": "Spoon"}, d.types)


def test_a_hand_alone_in_an_empty_room_is_idle_or_moves(demonstrate):
    d = demonstrate()
    frames = Frames.cast(d.frames.filter(pl.col("entity") == "Right_hand"))
    found = segment(frames, Facts.create_empty(), d.entities, d.types)
    assert set(course(found)) == {"Idle", "Release"}


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000), tempo=st.floats(0.5, 2.0), missing=st.floats(0.0, 0.6))
def test_activities_tile_the_episode_whatever_is_not_seen(demonstrate, seed, tempo, missing):
    d = demonstrate(seed=seed, tempo=tempo, rate_hz=50.0)
    rng = np.random.default_rng(seed)
    lost = pl.Series("lost", rng.random(d.frames.height) < missing)
    nothing = pl.lit(None)
    frames = d.frames.with_columns(
        [
            pl.when(lost).then(nothing).otherwise(pl.col(name)).alias(name)
            for name in ("position_xyz_m", "orientation_wxyz", "grip")
        ]
    )
    found = segment(Frames.validate(frames, cast=True), d.facts, d.entities, d.types)
    assert_tiles(found, d.frames)


@pytest.fixture(scope="module")
def segmenter(three):
    params = TrainParams(n_variations=1, min_leaf_s=0.1)
    return train(three.frames, three.facts, three.truth, three.entities, three.types, params=params)


def agreement(found, truth):
    right = total = 0
    for row in truth.iter_rows(named=True):
        same = found.filter((pl.col("episode_id") == row["episode_id"]) & (pl.col("hand") == row["hand"]))
        start = np.maximum(same["start_ns"].to_numpy(), row["start_ns"])
        shared = np.maximum(np.minimum(same["end_ns"].to_numpy(), row["end_ns"]) - start, 0)
        right += shared[same["activity"].to_numpy() == row["activity"]].sum()
        total += row["end_ns"] - row["start_ns"]
    return right / total


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 50},
        {"rate_hz": 60.0},
        {"rate_hz": 240.0},
        {"mirrored": True},
        {"tempo": 1.15},
        {"start_ns": 1_760_000_000_000_000_000},
    ],
    ids=str,
)
def test_a_trained_segmenter_knows_the_same_motion_at_other_rates_sides_and_tempos(
    segmenter, demonstrate, change
):
    d = demonstrate("new", **change)
    found = segment(d.frames, d.facts, d.entities, d.types, segmenter)
    assert agreement(found, d.truth) > 0.95
    assert_tiles(found, d.frames)


def test_without_decoding_ticks_are_decided_one_by_one(segmenter, demonstrate):
    d = demonstrate("new", seed=51)
    params = SegmentParams(is_decoded=False)
    found = segment(d.frames, d.facts, d.entities, d.types, segmenter, params=params)
    assert agreement(found, d.truth) > 0.9
    assert_tiles(found, d.frames)


def test_a_segmenter_with_other_features_is_refused(segmenter, demonstrate):
    d = demonstrate()
    foreign = dataclasses.replace(segmenter, feature_names=(*segmenter.feature_names[:-1], "smell"))
    with pytest.raises(DataError, match="smell"):
        segment(d.frames, d.facts, d.entities, d.types, foreign)


def test_types_outside_the_hierarchy_of_hands_and_surfaces_are_objects(demonstrate):
    d = demonstrate()
    types = TypeHierarchy.of({"Hand": "object", "Table": "Surface", "Cube": "object", "Bowl": "object"})
    assert segment(d.frames, d.facts, d.entities, types).equals(
        segment(d.frames, d.facts, d.entities, d.types)
    )
