"""Types that behaviour splits, applied: plans with the new types."""

from pathlib import Path

import polars as pl
import pytest

from demoplan.engines.fast_downward import solve
from demoplan.language.atoms import Atom, Literal
from demoplan.language.pddl import parse_domain, render_domain
from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.domains.learning import learn_call, learn_domain, params_of, stored_domain
from demoplan.pipeline.domains.planning import Start, problem_of
from demoplan.stages.ask import ask
from demoplan.stages.compose import compose
from demoplan.stages.learn import LearnParams, learn, learn_splitting_types
from demoplan.store import EpisodeState, Store
from demoplan.tables import Transitions

CHECKOUT = Path(__file__).resolve().parents[3]
BALL = "cube_green"


@pytest.fixture(scope="module")
def with_a_ball(table_world):
    """Demonstrations in which what is put onto one object, and that object itself, rolls off to the table."""
    habits = table_world.Habits(missed_segment=0.0, hesitation=0.0, regrasp=0.0)
    moves = [
        ("cube_red", "cube_blue"),
        (BALL, "cube_yellow"),
        ("cube_red", BALL),
        ("cube_red", "cube_yellow"),
    ]
    hands = ("Right_hand", "Left_hand")
    episodes = [
        table_world.demonstrate(f"e{number}", moves, hands[number % 2], f"ball{number}", habits)
        for number in range(10)
    ]
    rows = []
    for row in table_world.transitions_of(*episodes).iter_rows(named=True):
        for side in ("before", "after"):
            atoms = [Atom.parse(text) for text in row[side]]
            rolled = [
                a
                for a in atoms
                if a.predicate == "onTop" and BALL in a.arguments and "table" not in a.arguments
            ]
            for atom in rolled:
                one, other = atom.arguments
                atoms = [
                    a for a in atoms if not (a.predicate == "inTouch" and set(a.arguments) == {one, other})
                ]
                atoms[atoms.index(atom)] = Atom("onTop", (one, "table"))
                atoms += [Atom("inTouch", (one, "table")), Atom("clear", (other,))]
            row[side] = sorted({str(a) for a in atoms})
        rows.append(row)
    return Transitions.validate(pl.DataFrame(rows, schema=pl.Schema(Transitions.create_empty().schema)))


def put_onto(table_world, domain, cube, support):
    state = {Atom("handOpen", (hand,)) for hand in table_world.HANDS}
    for each in table_world.CUBES:
        state |= {Atom("onTop", (each, "table")), Atom("inTouch", (each, "table")), Atom("clear", (each,))}
    goal = [Literal(Atom("onTop", (cube, support)))]
    return solve(domain, ask(domain, state, table_world.ENTITIES, goal, "put"))


def test_nothing_is_stacked_onto_what_rolls_once_its_type_is_split(table_world, with_a_ball):
    learned, retyping = learn_splitting_types(with_a_ball, table_world.TYPES, table_world.PREDICATES)
    assert dict(retyping.type_of) == {BALL: "WoodenCube_2"}
    split = compose(learned.operators, learned.literals, retyping.types, retyping.predicates, "split")
    domain = parse_domain(render_domain(retyping.domain(split)))
    for cube in ("cube_red", "cube_yellow"):
        assert put_onto(table_world, domain, cube, "cube_blue").is_validated
        assert put_onto(table_world, domain, cube, BALL).outcome == "unsolvable"
    applied = learned.findings.filter((pl.col("kind") == "type") & pl.col("is_applied"))
    assert applied["subject"].to_list() == [f"WoodenCube: {BALL}"]

    plain = learn(with_a_ball, table_world.TYPES, table_world.PREDICATES)
    as_before = compose(plain.operators, plain.literals, table_world.TYPES, table_world.PREDICATES, "plain")
    assert put_onto(table_world, as_before, "cube_red", BALL).is_validated


@pytest.mark.parametrize("noise", [None, 1, 2])
def test_without_a_reason_no_type_is_split_and_the_same_is_learned(table_world, noise):
    clean = table_world.transitions_of(*table_world.study("retyping", participants=40).values())
    transitions = clean if noise is None else table_world.corrupted(clean, noise)
    learned, retyping = learn_splitting_types(transitions, table_world.TYPES, table_world.PREDICATES)
    assert not retyping.type_of
    assert retyping.types == table_world.TYPES
    plain = learn(transitions, table_world.TYPES, table_world.PREDICATES)
    assert all(one.equals(other) for one, other in zip(learned, plain, strict=True))


def test_a_stored_domain_keeps_its_split_types_and_problems_take_them_from_it(
    table_world, with_a_ball, tmp_path
):
    vocabulary = open_dataset(CHECKOUT / "datasets/cube-stacking").vocabulary
    store = Store(tmp_path)
    states = []
    for (name,), rows in with_a_ball.group_by("episode_id", maintain_order=True):
        content = store.objects.put(Transitions.validate(rows), Transitions)
        states.append(EpisodeState(dataset="d", episode_id=str(name), tables={"transitions": str(content)}))
    learn_domain(store, states, vocabulary, name="balls", dataset="d", params=LearnParams(splits_types=True))
    learned = stored_domain(store, "balls")
    atoms = {Atom("handOpen", (hand,)) for hand in table_world.HANDS}
    for cube in table_world.CUBES:
        atoms |= {Atom("onTop", (cube, "table")), Atom("inTouch", (cube, "table")), Atom("clear", (cube,))}
    start = Start(objects=table_world.ENTITIES, atoms=frozenset(atoms), origin="a table")
    problem = problem_of(learned.domain, start, f"onTop(cube_red, {BALL})")
    assert dict(problem.objects)[BALL] == "WoodenCube_2"
    assert dict(problem.objects)["cube_red"] == "WoodenCube"
    assert solve(learned.domain, problem).outcome == "unsolvable"
    assert solve(learned.domain, problem_of(learned.domain, start, "onTop(cube_red, cube_blue)")).is_validated
    # Learned again for the same name, it is split again.
    params = params_of(learned.version)
    assert params.splits_types
    assert store.find("learn", *learn_call(states, vocabulary, params)) is not None
    assert store.find("learn", *learn_call(states, vocabulary)) is None
