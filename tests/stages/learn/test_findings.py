"""What is found besides operators: misreadings, groups, types that split, and why operators stand apart."""

import polars as pl
import pytest

from demoplan.stages.learn import learn
from demoplan.tables import Transitions


def findings(table_world, transitions, kind):
    found = learn(transitions, table_world.TYPES, table_world.PREDICATES).findings
    return found.filter(pl.col("kind") == kind)


@pytest.fixture(scope="module")
def study(table_world):
    return table_world.transitions_of(*table_world.study("findings").values())


def with_balls(transitions, balls, support="cube_blue"):
    """The transitions, as if what is put rolls off to the table whenever it is one of some objects."""
    rows = []
    for row in transitions.iter_rows(named=True):
        for ball in balls:
            for name in row["objects"]:
                if name["type"] == "WoodenCube" and name["name"] != ball:
                    old, new = f"onTop({ball},{name['name']})", f"onTop({ball},table)"
                    for side in ("before", "after"):
                        changed = {new if atom == old else atom for atom in row[side]}
                        if old in row[side]:
                            changed |= {f"clear({name['name']})"}
                            changed -= {f"inTouch({ball},{name['name']})", f"inTouch({name['name']},{ball})"}
                        row[side] = sorted(changed)
        rows.append(row)
    return Transitions.validate(pl.DataFrame(rows, schema=transitions.schema))


def test_misreadings_are_listed_with_their_rate_only_where_there_are_some(table_world, study):
    noisy = findings(table_world, table_world.corrupted(study, 1), "misreading")
    assert noisy["rate"].to_list() == pytest.approx([0.05] * len(table_world.PREDICATES), abs=0.03)
    assert findings(table_world, study, "misreading").is_empty()


def test_groups_are_listed_with_their_evidence(table_world, study):
    found = findings(table_world, study, "exclusion")
    on_one_thing = found.filter(pl.col("subject") == "onTop(#,·) for # WoodenCube").row(0, named=True)
    assert on_one_thing["log10_bayes_factor"] > 2
    assert on_one_thing["n_against"] == 0


def test_objects_that_behave_unlike_the_others_of_their_type_are_proposed_as_a_type(table_world):
    habits = table_world.Habits(missed_segment=0.0, hesitation=0.0, regrasp=0.0)
    moves = [("cube_red", "cube_blue"), ("cube_green", "cube_yellow")]
    episodes = [
        table_world.demonstrate(f"e{number}", moves, "Right_hand", f"balls{number}", habits)
        for number in range(8)
    ]
    transitions = table_world.transitions_of(*episodes)
    assert findings(table_world, transitions, "type").is_empty()
    found = findings(table_world, with_balls(transitions, ["cube_green"]), "type")
    assert "WoodenCube: cube_green" in found["subject"].to_list()
    row = found.filter(pl.col("subject") == "WoodenCube: cube_green").row(0, named=True)
    assert row["log10_bayes_factor"] > 1
    assert "Put goes another way" in row["statement"]
    assert not row["is_applied"]


def test_habits_of_the_demonstrator_split_no_type(table_world, study):
    """Everybody puts red on blue: that nobody puts anything on yellow says nothing about yellow."""
    assert findings(table_world, study, "type").is_empty()


def test_operators_of_one_activity_say_what_tells_them_apart(table_world):
    moves = [("cube_red", "cube_blue"), ("cube_red", "table"), ("cube_green", "cube_red")]
    episodes = [
        table_world.demonstrate(f"e{number}", moves, "Right_hand", f"variants{number}") for number in range(6)
    ]
    found = findings(table_world, table_world.transitions_of(*episodes), "variant")
    puts = found.filter(pl.col("subject") == "put_1, put_2")
    assert puts.height == 1
    assert "?to is " in puts.item(0, "statement")
    assert puts.item(0, "log10_bayes_factor") > 1
