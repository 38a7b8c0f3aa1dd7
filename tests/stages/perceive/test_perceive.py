from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.errors import DataError, UnknownNameError
from demoplan.language.domains import Signature
from demoplan.language.vocabulary import PredicateRule
from demoplan.manifests.mapping import Entity
from demoplan.manifests.vocabulary import parse_vocabulary
from demoplan.stages.perceive import PerceiveParams, check_definitions, perceive
from demoplan.tables import Frames

VOCABULARIES = Path(__file__).resolve().parents[3] / "schemas" / "vocabularies"
TABLETOP = parse_vocabulary((VOCABULARIES / "tabletop.yaml").read_text(), "tabletop.yaml")
TICK_NS = 10_000_000
TABLE = (0.0, 0.0, 0.0)


def entities(**types):
    return {name: Entity.model_validate({"type": kind}) for name, kind in types.items()}


def frames(positions, grips=None, orientations=None):
    """Frames of ``{entity: (n, 3) or one place}``, at 100 Hz; NaN places become null."""
    n = max(len(p) for p in positions.values() if np.ndim(p) == 2)
    parts = []
    for name, given_place in sorted(positions.items()):
        place = np.broadcast_to(np.asarray(given_place, float), (n, 3))
        turn = np.broadcast_to(np.asarray((orientations or {}).get(name, (1.0, 0, 0, 0)), float), (n, 4))
        grip = (grips or {}).get(name)
        seen = pl.Series(np.isfinite(place).all(axis=1))
        parts.append(
            pl.DataFrame(
                {
                    "episode_id": ["e"] * n,
                    "entity": [name] * n,
                    "tick_ns": np.arange(n) * TICK_NS,
                    "position_xyz_m": np.array(place),
                    "orientation_wxyz": np.array(turn),
                    "grip": pl.Series(
                        [None] * n if grip is None else np.asarray(grip, float), dtype=pl.Float64
                    ),
                    "pose_age_ns": np.full(n, 0 if name == "table" else 1),
                    "seen": seen,
                }
            ).select(
                "episode_id",
                "entity",
                "tick_ns",
                pl.when("seen").then("position_xyz_m"),
                pl.when("seen").then("orientation_wxyz"),
                pl.when(pl.col("grip").is_not_nan()).then("grip"),
                pl.when("seen").then("pose_age_ns"),
            )
        )
    return Frames.validate(pl.concat(parts), cast=True)


def held(facts, predicate, *arguments, value="true"):
    """Intervals of an atom, in ticks."""
    rows = facts.filter(
        (pl.col("predicate") == predicate)
        & (pl.col("arguments") == list(arguments))
        & (pl.col("value") == value)
    )
    return [(start // TICK_NS, end // TICK_NS) for start, end in rows.select("start_ns", "end_ns").rows()]


def still(*place, n=100):
    return np.tile(np.array(place, float), (n, 1))


def along(start, end, n):
    return np.linspace(start, end, n)


CUBES = entities(a="Cube", b="Cube", c="Cube", table="Table")


def test_in_a_tower_each_cube_is_on_top_of_the_one_directly_beneath_it():
    facts = perceive(
        frames(
            {"a": still(0, 0, 0.025), "b": still(0.01, 0, 0.075), "c": still(0, 0.01, 0.125), "table": TABLE}
        ),
        CUBES,
        TABLETOP,
    )
    on_top = facts.filter(pl.col("predicate") == "onTop")["arguments"].to_list()
    assert on_top == [["a", "table"], ["b", "a"], ["c", "b"]]
    assert facts.filter(pl.col("predicate") == "clear")["arguments"].to_list() == [["c"]]
    assert held(facts, "onTop", "b", "a") == [(0, 100)]


def test_beside_is_not_on_top_but_in_touch():
    facts = perceive(
        frames({"a": still(0, 0, 0.025), "b": still(0.052, 0, 0.025), "table": TABLE}), CUBES, TABLETOP
    )
    assert held(facts, "inTouch", "a", "b") == held(facts, "inTouch", "b", "a") == [(0, 100)]
    assert held(facts, "onTop", "a", "b") == []


def test_a_table_is_touched_by_its_surface_however_far_its_middle_is():
    facts = perceive(frames({"a": still(0.5, 0.3, 0.026), "table": TABLE}), CUBES, TABLETOP)
    assert held(facts, "inTouch", "a", "table") == held(facts, "onTop", "a", "table") == [(0, 100)]


def test_a_cube_over_the_edge_is_not_on_the_table():
    facts = perceive(frames({"a": still(0.62, 0, 0.025), "table": TABLE}), CUBES, TABLETOP)
    assert held(facts, "onTop", "a", "table") == []
    assert held(facts, "inTouch", "a", "table") == [(0, 100)]


def test_a_cube_lying_on_another_face_still_supports():
    side = (np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0)
    facts = perceive(
        frames({"a": still(0, 0, 0.025), "b": still(0, 0, 0.075), "table": TABLE}, orientations={"a": side}),
        CUBES,
        TABLETOP,
    )
    assert held(facts, "onTop", "b", "a") == [(0, 100)]


def test_on_top_ends_as_soon_as_the_cube_leaves_and_noise_about_the_threshold_does_not_flicker():
    rng = np.random.default_rng(0)
    height = np.concatenate([np.full(100, 0.025 + 0.011), np.linspace(0.036, 0.2, 100)])
    height[:50] = 0.025
    place = np.stack([np.zeros(200), np.zeros(200), height], axis=1) + rng.normal(0, 0.001, (200, 3))
    facts = perceive(frames({"a": place, "table": TABLE}), CUBES, TABLETOP)
    ((start, end),) = held(facts, "onTop", "a", "table")
    assert start == 0
    assert 100 <= end <= 106  # 15 mm up, at 1.6 mm a tick from 11 mm


HANDS = entities(h="Hand", g="Hand", a="Cube", b="Cube", table="Table")


def pick_and_place(n=100):
    """A hand comes to cube a, closes, carries it to cube b, opens and leaves."""
    hand = np.concatenate(
        [
            along((0.3, 0, 0.2), (0, 0, 0.025), n),
            still(0, 0, 0.025, n=30),
            along((0, 0, 0.025), (0, 0, 0.2), n),
            along((0, 0, 0.2), (0.2, 0, 0.2), n),
            along((0.2, 0, 0.2), (0.2, 0, 0.075), n),
            still(0.2, 0, 0.075, n=30),
            along((0.2, 0, 0.075), (0.2, 0.3, 0.3), n),
        ]
    )
    cube = hand.copy()
    cube[: n + 30] = (0, 0, 0.025)
    cube[-n - 30 :] = (0.2, 0, 0.075)
    closed = np.zeros(len(hand), bool)
    closed[n + 15 : -n - 15] = True
    return hand, cube, np.where(closed, 0.05, 0.95), n


def test_a_pick_and_place_reads_as_a_person_would_say():
    hand, cube, grip, n = pick_and_place()
    facts = perceive(
        frames({"h": hand, "a": cube, "b": (0.2, 0, 0.025), "table": TABLE}, grips={"h": grip}),
        HANDS,
        TABLETOP,
    )
    carried = (n + 15, len(hand) - n - 15)
    assert held(facts, "inHand", "h", "a") == [carried]
    assert held(facts, "inHand", "h", "b") == []
    assert held(facts, "handOpen", "h") == [(0, carried[0]), (carried[1], len(hand))]
    ((_, lifted),) = held(facts, "onTop", "a", "table")
    assert n + 30 <= lifted <= n + 40
    ((stacked, end),) = held(facts, "onTop", "a", "b")
    assert 3 * n + 115 <= stacked <= 4 * n + 30
    assert end == len(hand)
    assert held(facts, "clear", "b") == [(0, stacked)]
    ((near, _), *_) = held(facts, "graspable", "h", "a")
    assert 0 < near < n
    first, *_ = held(facts, "actedOn", "h", "a")
    assert 0 < first[0] < n
    assert first[1] == carried[0]
    assert any(start < carried[1] and end > 3 * n for start, end in held(facts, "actedOn", "h", "b"))
    # The table only, while no cube was within reach: from then on, what stands on it.
    assert all(end <= first[0] for _, end in held(facts, "actedOn", "h", "table"))
    moves = held(facts, "handMove", "h")
    assert moves[0][0] == 0
    assert not any(start <= n + 15 < end for start, end in moves)


def test_without_a_grip_signal_holding_shows_by_moving_together_and_opening_is_unknown():
    hand, cube, _, n = pick_and_place()
    facts = perceive(frames({"h": hand, "a": cube, "b": (0.2, 0, 0.025), "table": TABLE}), HANDS, TABLETOP)
    ((start, end),) = held(facts, "inHand", "h", "a")
    assert n - 10 <= start <= n + 35  # from when the hand came to rest at it
    assert len(hand) - n - 30 <= end <= len(hand) - n + 15
    assert held(facts, "inHand", "h", "b") == []
    assert held(facts, "handOpen", "h", value="unknown") == [(0, len(hand))]
    assert held(facts, "handOpen", "h") == []


def test_what_turns_with_the_hand_is_held_although_its_velocity_differs():
    angle = np.linspace(0, 4 * np.pi, 300)
    hand = np.tile([0.0, 0, 0.5], (300, 1))
    cube = hand + 0.03 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    turn = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=1)
    turned = frames({"h": hand, "a": cube}, orientations={"h": turn})
    assert held(perceive(turned, HANDS, TABLETOP), "inHand", "h", "a") == [(0, 300)]
    fixed = frames({"h": hand, "a": cube})
    assert held(perceive(fixed, HANDS, TABLETOP), "inHand", "h", "a") == []


def test_a_fist_that_passes_over_a_cube_does_not_hold_it():
    fist = along((-0.3, 0, 0.06), (0.3, 0, 0.06), 300)
    facts = perceive(
        frames({"h": fist, "a": still(0, 0, 0.025, n=300), "table": TABLE}, grips={"h": np.full(300, 0.05)}),
        HANDS,
        TABLETOP,
    )
    assert held(facts, "inHand", "h", "a") == []


def test_a_dropped_cube_is_no_longer_in_the_closed_hand():
    hand, cube, grip, n = pick_and_place()
    cube[250:] = (0.05, 0, 0.025)
    facts = perceive(frames({"h": hand, "a": cube, "table": TABLE}, grips={"h": grip}), HANDS, TABLETOP)
    assert held(facts, "inHand", "h", "a") == [(n + 15, 250)]


def test_a_cube_of_the_held_cubes_type_can_be_acted_on_and_what_another_hand_brings_is_not():
    hand, cube, grip, _n = pick_and_place()
    still_hand = still(0.2, 0.08, 0.06, n=len(hand))
    facts = perceive(
        frames(
            {"h": hand, "g": still_hand, "a": cube, "b": (0.2, 0, 0.025), "table": TABLE},
            grips={"h": grip, "g": np.ones(len(hand))},
        ),
        HANDS,
        TABLETOP,
    )
    assert held(facts, "actedOn", "h", "b")
    assert held(facts, "actedOn", "g", "a") == []


def test_where_a_pose_is_missing_for_long_its_atoms_are_unknown_and_for_short_they_keep():
    place = still(0, 0, 0.025, n=200)
    place[50:60] = np.nan
    place[100:160] = np.nan
    facts = perceive(frames({"a": place, "table": TABLE}), CUBES, TABLETOP)
    for predicate in ("onTop", "inTouch"):
        assert held(facts, predicate, "a", "table") == [(0, 100), (160, 200)]
        assert held(facts, predicate, "a", "table", value="unknown") == [(100, 160)]


def test_a_body_that_was_never_seen_leaves_everything_about_it_unknown_and_clear_undecided():
    facts = perceive(
        frames({"a": still(0, 0, 0.025), "b": np.full((100, 3), np.nan), "table": TABLE}), CUBES, TABLETOP
    )
    assert held(facts, "onTop", "b", "a", value="unknown") == [(0, 100)]
    assert held(facts, "clear", "a", value="unknown") == [(0, 100)]
    assert held(facts, "onTop", "a", "table") == [(0, 100)]


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_intervals_are_longest_disjoint_sorted_and_within_the_episode(seed):
    rng = np.random.default_rng(seed)
    n = 120
    places = {
        name: np.cumsum(rng.normal(0, 0.01, (n, 3)), axis=0) + np.array([0, 0, 0.05])
        for name in ("a", "b", "h", "g")
    }
    places["a"][rng.integers(0, n, 40)] = np.nan
    given_frames = frames({**places, "table": TABLE}, grips={"h": rng.uniform(size=n), "g": np.ones(n)})
    facts = perceive(given_frames, HANDS, TABLETOP)
    keys = facts.select("predicate", "arguments", "start_ns").rows()
    assert keys == sorted(keys)
    for one, two in zip(facts.rows(named=True), facts.rows(named=True)[1:], strict=False):
        if (one["predicate"], one["arguments"]) == (two["predicate"], two["arguments"]):
            assert one["end_ns"] <= two["start_ns"]
            assert one["end_ns"] < two["start_ns"] or one["value"] != two["value"]
    assert facts["start_ns"].min() >= 0
    assert facts["end_ns"].max() <= n * TICK_NS
    assert perceive(given_frames, HANDS, TABLETOP).equals(facts)
    for x, y in combinations(("a", "b"), 2):
        assert held(facts, "inTouch", x, y) == held(facts, "inTouch", y, x)


def with_rule(name, definition, arguments, numbers):
    rule = PredicateRule(Signature(name, arguments), definition, tuple(sorted(numbers.items())))
    return replace(TABLETOP, predicates=(rule,))


def test_object_centred_definitions_say_where_things_are():
    where = frames({"a": still(0, 0, 0.025), "b": still(-0.1, 0.01, 0.2), "c": still(0.002, 0, 0.3)})
    cases = [
        (
            "beside",
            ("Cube", "Cube"),
            {"enter_m": 0.05, "exit_m": 0.04, "direction_rad": np.pi, "half_angle_rad": 0.8, "reach_m": 0.2},
            {("b", "a"), ("b", "c")},
        ),
        (
            "above",
            ("Cube", "Cube"),
            {"enter_m": 0.1, "exit_m": 0.09, "footprint_margin_m": 0.0},
            {("c", "a")},
        ),
        ("centred", ("Cube", "Cube"), {"enter_m": 0.01, "exit_m": 0.02}, {("a", "c"), ("c", "a")}),
        ("near", ("Cube", "Cube"), {"enter_m": 0.12, "exit_m": 0.13}, {("b", "c"), ("c", "b")}),
        ("inside", ("Cube", "Cube"), {"enter_m": 0.0, "exit_m": -0.01}, set()),
        ("upright", ("Cube",), {"enter_rad": 0.1, "exit_rad": 0.2}, {("a",), ("b",), ("c",)}),
    ]
    for definition, arguments, numbers, expected in cases:
        facts = perceive(where, CUBES, with_rule("p", definition, arguments, numbers))
        assert {tuple(row) for row in facts["arguments"].to_list()} == expected, definition


def test_what_lies_in_a_box_is_inside_it():
    shapes = {
        "a": CUBES["a"],
        "b": Entity.model_validate({"type": "Cube", "shape": {"size_xyz_m": [0.3, 0.3, 0.1]}}),
    }
    path = along((0, 0, 0.3), (0, 0, 0), 100)
    facts = perceive(
        frames({"a": path, "b": (0, 0, 0)}),
        shapes,
        with_rule("in", "inside", ("Cube", "Cube"), {"enter_m": 0.0, "exit_m": -0.01}),
    )
    assert held(facts, "in", "a", "b") == [(83, 100)]  # 5 cm, at 3 mm a tick from 30 cm


@pytest.mark.parametrize(
    ("rule", "error", "words"),
    [
        (
            PredicateRule(Signature("p", ("Cube",)), "sideways"),
            UnknownNameError,
            "unknown definition 'sideways'.*rests_on",
        ),
        (
            PredicateRule(Signature("p", ("Cube",)), "in_touch"),
            DataError,
            "1 arguments; its definition 'in_touch' takes 2",
        ),
        (
            PredicateRule(Signature("p", ("Cube",)), "upright", (("enter_rad", 0.1),)),
            DataError,
            "lacks exit_rad",
        ),
        (
            PredicateRule(Signature("p", ("Cube",)), "upright", (("enter_deg", 5.0),)),
            UnknownNameError,
            "enter_deg.*exit_rad",
        ),
        (
            PredicateRule(Signature("p", ("Cube",)), "nothing_on"),
            DataError,
            "derived from .*'rests_on'",
        ),
    ],
)
def test_a_predicate_that_does_not_fit_its_definition_is_refused(rule, error, words):
    with pytest.raises(error, match=words):
        check_definitions(replace(TABLETOP, predicates=(rule,)))


def test_an_object_without_a_type_is_refused_by_name():
    with pytest.raises(UnknownNameError, match=r"unknown entity 'b'.*without a type"):
        perceive(frames({"a": still(0, 0, 0), "b": (0, 0, 0)}), entities(a="Cube"), TABLETOP)


def test_an_unknown_type_is_refused_with_those_that_exist():
    with pytest.raises(UnknownNameError, match=r"unknown type 'Sphinx'.*WoodenCube"):
        perceive(frames({"a": still(0, 0, 0)}), entities(a="Sphinx"), TABLETOP)


def test_every_shipped_vocabulary_fits_the_definitions():
    for file in sorted(VOCABULARIES.glob("*.yaml")):
        assert check_definitions(parse_vocabulary(file.read_text(), file))


def test_holding_a_state_over_a_gap_can_be_switched_off():
    place = still(0, 0, 0.025, n=60)
    place[30:33] = np.nan
    facts = perceive(frames({"a": place, "table": TABLE}), CUBES, TABLETOP, PerceiveParams(hold_s=0.0))
    assert held(facts, "onTop", "a", "table", value="unknown") == [(30, 33)]
