"""Classes of failures, each from sightings that are written down by hand."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from demoplan.language.atoms import Atom, Literal
from demoplan.stages.diagnose import Case, DiagnoseParams, contradictions, diagnose
from demoplan.tables import Frames

N, STEP_NS = 100, 20_000_000
STILL = np.zeros((N, 3))


def held(*texts):
    return frozenset(map(Atom.parse, texts))


def at(*place):
    return np.tile(np.array(place, float), (N, 1))


def frames(bodies, grip=0.0):
    rng = np.random.default_rng(0)
    parts = []
    for name, places in sorted(bodies.items()):
        seen = places + rng.normal(0, 3e-4, places.shape)
        parts.append(
            pl.DataFrame(
                {
                    "episode_id": ["e"] * N,
                    "entity": [name] * N,
                    "tick_ns": np.arange(N) * STEP_NS,
                    "position_xyz_m": [None if np.isnan(p).any() else p.tolist() for p in seen],
                    "orientation_wxyz": [[1.0, 0.0, 0.0, 0.0]] * N,
                    "grip": [grip if name == "h" else None] * N,
                    "pose_age_ns": [0] * N,
                },
                schema={name: column.dtype for name, column in Frames.columns().items()},
            )
        )
    return pl.concat(parts)


SOUND = held("onTop(a,b)", "onTop(b,table)", "inTouch(a,b)", "inTouch(b,table)", "clear(a)", "handOpen(h)")


def case(bodies, *, missing="onTop(a,b)", grip=1.0, **changes):
    base = Case(
        literals=(Literal(Atom.parse(missing)),),
        passed_after_s=None,
        held=held(
            "onTop(a,table)", "onTop(b,table)", "inTouch(a,table)", "clear(a)", "clear(b)", "handOpen(h)"
        ),
        unknown=frozenset(),
        frames=frames(bodies, grip),
        hands=("h",),
        fixed=frozenset({"table"}),
        objects=("a", "b"),
        hand="h",
        activity="Put",
        thing="a",
        support="b",
        motion_state="succeeded",
    )
    return replace(base, **changes)


NEAR = {"h": at(0, 0, 0.08), "a": at(0, 0, 0.075), "b": at(0, 0, 0.025)}


def test_what_passes_at_a_second_look_was_perception():
    assert diagnose(case(NEAR, passed_after_s=0.5)).failure == "perception"


def test_what_contradicts_itself_is_perception():
    impossible = held("onTop(a,b)", "clear(b)", "clear(a)", "onTop(b,table)", "inTouch(b,table)")
    found = diagnose(case(NEAR, held=impossible))
    assert found.failure == "perception"
    assert "carries a" in found.cause


def test_an_object_not_seen_any_more_is_gone():
    away = at(0, 0, 0.075)
    away[30:] = np.nan
    found = diagnose(case({**NEAR, "a": away}))
    assert found.failure == "exogenous"
    assert "gone" in found.cause


def test_an_object_that_jumps_and_stays_was_moved_by_somebody():
    jumped = at(0, 0, 0.075)
    jumped[50:] = [0.2, 0.1, 0.025]
    assert diagnose(case({**NEAR, "a": jumped})).failure == "exogenous"


def test_an_object_that_jumps_and_comes_back_was_seen_wrongly():
    jumped = at(0, 0, 0.075)
    jumped[50:70] += [0.1, 0.0, 0.0]
    assert diagnose(case({**NEAR, "a": jumped})).failure == "perception"


def test_an_object_that_slides_away_with_no_hand_near_was_moved_by_somebody():
    slides = at(0, 0.4, 0.025)
    slides[:, 0] = np.linspace(0, 0.2, N)
    found = diagnose(case({**NEAR, "b": slides}))
    assert found.failure == "exogenous"
    assert "no hand within" in found.cause


@pytest.mark.parametrize(
    "changes",
    [
        {"motion_state": "failed", "motion_problem": "path_blocked", "motion_reason": "a box"},
        {"motion_state": "blocked", "motion_problem": "path_blocked"},
        {"tracking_error_m": 0.06},
        {"motion_state": "failed", "motion_problem": "object_lost", "n_collisions": 2},
    ],
)
def test_a_hand_that_did_not_go_where_it_was_told_is_motion(changes):
    assert diagnose(case(NEAR, **changes)).failure == "motion"


def test_an_object_that_left_a_hand_on_its_course_is_an_execution_offset():
    found = diagnose(case(NEAR, was_held=True, motion_state="failed", motion_problem="object_lost"))
    assert found.failure == "execution_offset"
    assert "left h" in found.cause


def test_an_object_put_down_beside_its_aim_is_an_execution_offset_with_its_size():
    found = diagnose(case({**NEAR, "a": at(0.03, 0, 0.075)}))
    assert found.failure == "execution_offset"
    assert "30 mm" in found.cause


def test_an_object_that_slides_within_a_closed_hand_has_slipped():
    carried = at(0, 0, 0.0)
    carried[:, 0] = np.linspace(0, 0.3, N)
    slipping = carried.copy()
    slipping[:, 2] -= np.linspace(0, 0.03, N)
    found = diagnose(case({"h": carried, "a": slipping, "b": at(0.3, 0, 0.0)}, grip=0.0))
    assert found.failure == "execution_offset"
    assert "within h" in found.cause


def test_where_hand_and_object_are_as_they_should_be_it_is_the_operator():
    found = diagnose(case(NEAR, missing="clear(b)", held=SOUND))
    assert found.failure == "operator_model"


def test_what_the_same_step_has_shown_before_is_not_the_operator():
    found = diagnose(case(NEAR, missing="clear(b)", held=SOUND, n_good_before=3))
    assert found.failure == "perception"


def test_a_change_that_came_with_no_step_is_somebody_else():
    found = diagnose(case(NEAR, missing="clear(b)", held=SOUND, activity=None, motion_state=None, thing=None))
    assert found.failure == "exogenous"


@pytest.mark.parametrize(
    ("atoms", "said"),
    [
        (["handOpen(h)", "inHand(h,a)"], "h is open and holds a"),
        (["onTop(a,b)", "onTop(a,table)"], "a rests on b and on table"),
        (["clear(b)", "onTop(a,b)"], "b is free and carries a"),
        (["clear(a)", "inHand(h,a)"], "a is free and in h"),
        (["onTop(a,table)", "onTop(b,table)", "clear(b)"], "a is not free and nothing is on it or holds it"),
        (["clear(a)", "clear(b)", "onTop(b,table)"], "a floats"),
    ],
)
def test_a_state_that_cannot_be_is_told(atoms, said):
    found = contradictions(held(*atoms), frozenset(), ("h",), ("a", "b"), DiagnoseParams())
    assert said in found


def test_a_sound_state_has_no_contradiction_and_the_unseen_are_given_the_benefit_of_doubt():
    assert contradictions(SOUND, frozenset(), ("h",), ("a", "b"), DiagnoseParams()) == ()
    part = held("onTop(b,table)", "inTouch(b,table)")
    assert contradictions(part, held("clear(a)", "clear(b)"), ("h",), ("a", "b"), DiagnoseParams()) == ()
