"""Symbolic traces, whose actions name their instances, go through the same learner."""

import polars as pl
import pytest

from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.compose import compose
from demoplan.stages.learn import learn
from demoplan.tables import Transitions

TYPES = TypeHierarchy.of({"room": "object", "ball": "object"})
PREDICATES = (
    Signature("at", ("ball", "room")),
    Signature("at-robby", ("room",)),
    Signature("carry", ("ball",)),
    Signature("free", ()),
)
OBJECTS = [{"name": name, "type": "room" if name in "rs" else "ball"} for name in "abrs"]


def trace(episode, *steps):
    rows = []
    for place, (action, arguments, before, after) in enumerate(steps):
        rows.append(
            {
                "episode_id": episode,
                "hand": "",
                "start_ns": place,
                "end_ns": place + 1,
                "activity": action,
                "previous_activity": None,
                "arguments": arguments,
                "acted_on": None,
                "in_hand": None,
                "objects": OBJECTS,
                "before": sorted(before),
                "after": sorted(after),
                "unknown_before": [],
                "unknown_after": [],
            }
        )
    return Transitions.validate(pl.DataFrame(rows, schema=Transitions.create_empty().schema))


@pytest.fixture
def gripper():
    s0 = {"at(a,r)", "at(b,r)", "at-robby(r)", "free()"}
    s1 = {"carry(a)", "at(b,r)", "at-robby(r)"}
    s2 = {"carry(a)", "at(b,r)", "at-robby(s)"}
    s3 = {"at(a,s)", "at(b,r)", "at-robby(s)", "free()"}
    s4 = {"at(a,s)", "at(b,r)", "at-robby(r)", "free()"}
    return trace(
        "t",
        ("pick", ["a", "r"], s0, s1),
        ("move", ["r", "s"], s1, s2),
        ("drop", ["a", "s"], s2, s3),
        ("move", ["s", "r"], s3, s4),
        ("pick", ["b", "r"], s4, {"at(a,s)", "carry(b)", "at-robby(r)"}),
    )


def test_one_operator_per_action_with_its_own_parameters(gripper):
    tables = learn(gripper, TYPES, PREDICATES)
    domain = compose(tables.operators, tables.literals, TYPES, PREDICATES, "gripper")
    operators = {each.activity: each for each in domain.operators}
    assert sorted(operators) == ["drop", "move", "pick"]
    pick = operators["pick"]
    assert [(each.variable, each.type_name) for each in pick.parameters] == [("?x1", "ball"), ("?x2", "room")]
    assert {str(each) for each in pick.preconditions} == {"at(?x1,?x2)", "at-robby(?x2)", "free()"}
    assert {str(each) for each in pick.effects} == {"carry(?x1)", "not at(?x1,?x2)", "not free()"}
    assert {str(each) for each in operators["move"].preconditions} == {"at-robby(?x1)"}
    assert {str(each) for each in operators["move"].effects} == {"at-robby(?x2)", "not at-robby(?x1)"}


def test_an_action_that_names_an_object_twice_speaks_of_it_by_both_variables():
    table = trace("t", ("move", ["r", "r"], {"at-robby(r)", "free()"}, {"free()"}))
    tables = learn(table, TYPES, PREDICATES)
    effects = tables.literals.filter((pl.col("role") == "effect") & pl.col("is_kept"))
    assert effects["variables"].to_list() == [["?x1"], ["?x2"]]
    assert tables.evidence["binding"].to_list() == [["r", "r"]]
