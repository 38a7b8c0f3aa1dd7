import dataframely as dy
import polars as pl
import pytest

from demoplan.tables import Activities, Frames
from demoplan.tables.validating import validated


def frames(**changed):
    columns = {
        "episode_id": ["e", "e"],
        "entity": ["cube", "cube"],
        "tick_ns": [0, 10],
        "position_xyz_m": [[0.0, 0.0, 0.0], None],
        "orientation_wxyz": [None, None],
        "grip": [0.5, None],
        "pose_age_ns": [0, None],
    }
    return pl.DataFrame(columns | changed, schema=Frames.create_empty().schema, strict=False)


def test_a_table_that_keeps_its_declaration_comes_back_as_it_is():
    table = frames()
    assert validated(table, Frames) is table
    assert table.equals(Frames.validate(table))


@pytest.mark.parametrize(
    ("changed", "rule"),
    [
        ({"tick_ns": [0, 0]}, "primary_key"),
        ({"entity": ["cube", None]}, "nullability"),
        ({"grip": [1.5, None]}, "max"),
        ({"pose_age_ns": [-1, None]}, "min"),
        ({"position_xyz_m": [[float("nan"), 0.0, 0.0], None]}, "inner_nan"),
    ],
)
def test_a_table_that_breaks_a_rule_is_refused_by_the_name_of_the_rule(changed, rule):
    with pytest.raises(dy.exc.ValidationError, match=rule):
        validated(frames(**changed), Frames)


def test_a_table_of_other_types_is_cast_and_a_rule_over_columns_is_checked():
    row = {"episode_id": "e", "hand": "h", "start_ns": 0, "end_ns": 1, "activity": "Idle"}
    empty = {"acted_on": None, "in_hand": None}
    found = validated(pl.DataFrame([row | empty]), Activities)
    assert found.schema == Activities.create_empty().schema
    with pytest.raises(dy.exc.ValidationError, match="interval_is_not_empty"):
        validated(pl.DataFrame([row | empty | {"end_ns": 0}]), Activities)


def test_rows_may_stand_in_any_order_but_no_key_twice():
    keys = {"position_xyz_m": [None] * 3, "orientation_wxyz": [None] * 3, "grip": [None] * 3}
    keys |= {"episode_id": ["e"] * 3, "entity": ["b", "a", "b"], "pose_age_ns": [None] * 3}
    table = frames(**keys, tick_ns=[0, 0, 1])
    assert validated(table, Frames) is table
    with pytest.raises(dy.exc.ValidationError, match="primary_key"):
        validated(frames(**keys, tick_ns=[0, 0, 0]), Frames)


def test_a_missing_column_is_refused():
    with pytest.raises(dy.exc.SchemaError):
        validated(frames().drop("grip"), Frames)
