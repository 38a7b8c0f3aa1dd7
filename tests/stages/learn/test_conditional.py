"""Effects that depend on a property: two operators and the condition that tells them apart."""

import random

import polars as pl
import pytest

from demoplan.language.domains import Signature
from demoplan.stages.compose import compose
from demoplan.stages.learn import learn
from demoplan.tables import Transitions

WET, STAINED = Signature("wet", ("Graspable",)), Signature("stained", ("Graspable",))


def with_wet_cubes(table_world, share=0.5, exceptions=0.0, seed=1):
    """Demonstrations in some of which the cube that is put is wet, and stains what it is put on."""
    rng = random.Random(seed)
    moves, hand = table_world.TASKS["one_right"]
    habits = table_world.Habits(hesitation=0.0, regrasp=0.0, missed_segment=0.0)
    episodes = [
        table_world.demonstrate(f"e{number:02}", moves, hand, f"wet{number}", habits) for number in range(24)
    ]
    is_wet = {f"e{number:02}": rng.random() < share for number in range(24)}
    does_stain = {name: wet != (rng.random() < exceptions) for name, wet in is_wet.items()}
    rows = []
    for row in table_world.transitions_of(*episodes).iter_rows(named=True):
        name, cube, support = row["episode_id"], "cube_red", "cube_blue"
        for side in ("before", "after"):
            atoms = set(row[side])
            if is_wet[name]:
                atoms.add(f"wet({cube})")
            if does_stain[name] and f"onTop({cube},{support})" in atoms:
                atoms.add(f"stained({support})")
            row[side] = sorted(atoms)
        rows.append(row)
    schema = Transitions.create_empty().schema
    return Transitions.validate(pl.DataFrame(rows, schema=schema))


def puts(table_world, transitions):
    predicates = (*table_world.PREDICATES, WET, STAINED)
    learned = learn(transitions, table_world.TYPES, predicates)
    domain = compose(learned.operators, learned.literals, table_world.TYPES, predicates, "stacking")
    notes = dict(zip(learned.operators["operator"], learned.operators["note"], strict=True))
    return [(each, notes[each.name]) for each in domain.operators if each.activity == "Put"]


@pytest.mark.parametrize("exceptions", [0.0, 0.05])
def test_an_effect_that_depends_on_a_property_parts_the_operator_by_it(table_world, exceptions):
    found = puts(table_world, with_wet_cubes(table_world, exceptions=exceptions))
    assert len(found) == 2
    by_condition = {}
    for operator, note in found:
        conditions, effects = ({str(e) for e in side} for side in (operator.preconditions, operator.effects))
        is_wet = "wet(?object)" in conditions
        assert is_wet or "not wet(?object)" in conditions
        by_condition[is_wet] = effects
        assert "parted by wet: stained changes in" in note
    assert "stained(?to)" in by_condition[True]
    assert "stained(?to)" not in by_condition[False]


def test_an_effect_that_comes_by_chance_parts_nothing(table_world):
    found = puts(table_world, with_wet_cubes(table_world, exceptions=0.5, seed=3))
    assert len(found) == 1


def test_a_property_without_an_effect_of_its_own_parts_nothing(table_world):
    transitions = with_wet_cubes(table_world)
    unstained = Transitions.validate(
        transitions.with_columns(
            pl.col("before", "after").list.filter(~pl.element().str.starts_with("stained"))
        )
    )
    assert len(puts(table_world, unstained)) == 1
