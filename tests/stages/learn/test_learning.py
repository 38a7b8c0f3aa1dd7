"""What is learned from demonstrations: the operators, and that nothing but the evidence decides."""

import random

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.engines.fast_downward import solve
from demoplan.errors import DataError, UnknownNameError
from demoplan.language.execution import ground
from demoplan.language.pddl import render_domain
from demoplan.stages.learn import LearnParams, learn
from demoplan.tables import Transitions


@pytest.fixture(scope="module")
def clean(table_world):
    """One right-handed stacking of two cubes without any noise."""
    habits = table_world.Habits(
        jitter_s=0.0,
        hesitation=0,
        regrasp=0,
        missed_segment=0,
        bystander=0,
        skips_idle=0,
        late_start=0,
        early_stop=0,
    )
    moves, hand = table_world.TASKS["two_right"]
    return table_world.demonstrate("clean", moves, hand, "clean", habits)


@pytest.fixture(scope="module")
def study(table_world):
    return {name: table_world.transitions_of(each) for name, each in table_world.study("tests").items()}


def joined(tables):
    return Transitions.validate(pl.concat(list(tables)))


def learned(table_world, transitions, params=LearnParams()):
    return learn(transitions, table_world.TYPES, table_world.PREDICATES, params)


def text(table_world, transitions):
    return render_domain(table_world.domain_of(transitions))


def by_name(domain):
    return {each.name: each for each in domain.operators}


def test_a_clean_demonstration_gives_the_five_operators_of_the_paper(table_world, clean):
    operators = by_name(table_world.domain_of(table_world.transitions_of(clean)))
    assert sorted(operators) == ["idle_1", "put_1", "reach_1", "release_1", "take_1"]
    put = operators["put_1"]
    assert [(each.variable, each.type_name) for each in put.parameters] == [
        ("?hand", "Hand"),
        ("?object", "Graspable"),
        ("?from", "Surface"),
        ("?to", "Graspable"),
    ]
    before = {str(each) for each in put.preconditions}
    assert {
        "inHand(?hand,?object)",
        "onTop(?object,?from)",
        "inTouch(?object,?from)",
        "not handMove(?hand)",
        "not handOpen(?hand)",
        "clear(?to)",
    } <= before
    after = {str(each) for each in put.effects}
    assert {"handMove(?hand)", "onTop(?object,?to)", "not onTop(?object,?from)", "not clear(?to)"} <= after
    take = operators["take_1"]
    assert {"handOpen(?hand)", "graspable(?hand,?object)"} <= {str(each) for each in take.preconditions}
    assert {"inHand(?hand,?object)", "not handOpen(?hand)"} <= {str(each) for each in take.effects}


def test_what_the_support_stands_on_is_no_condition(table_world, clean):
    put = by_name(table_world.domain_of(table_world.transitions_of(clean)))["put_1"]
    about_scene = [
        each
        for each in put.preconditions
        if "?to" in each.atom.arguments and each.atom.predicate in ("onTop", "inTouch")
    ]
    assert about_scene == []


def test_two_variables_never_stand_for_one_object(table_world, clean):
    put = by_name(table_world.domain_of(table_world.transitions_of(clean)))["put_1"]
    texts = {str(each) for each in put.preconditions}
    assert "inHand(?hand,?object)" in texts
    assert (
        any(each in texts for each in ("not inHand(?hand,?to)", "not actedOn(?hand,?to)"))
        or "not clear(?object)" in texts
    )


def test_a_dozen_noisy_demonstrations_give_few_operators(table_world, study):
    domain = table_world.domain_of(joined(study.values()))
    assert len(domain.operators) <= 15
    assert {each.activity for each in domain.operators} == {"Idle", "Reach", "Take", "Put", "Release"}


def test_counts_never_exceed_transitions_and_evidence_names_every_transition_once(table_world, study):
    transitions = joined(study.values())
    result = learned(table_world, transitions)
    assert result.operators["n_transitions"].sum() == result.evidence.height <= transitions.height
    key = ["episode_id", "hand", "start_ns"]
    assert result.evidence.select(key).is_unique().all()
    assert (
        result.literals["n_support"] + result.literals["n_against"] <= result.literals["n_transitions"]
    ).all()
    widths = result.evidence.join(result.operators, on="operator").select(
        pl.col("binding").list.len() == pl.col("parameters").list.len()
    )
    assert widths.to_series().all()
    assert result.evidence["binding"].list.eval(pl.element().is_null().any()).list.any().any() is False


def test_counter_support_is_named_in_the_evidence(table_world, study):
    result = learned(table_world, joined(study.values()))
    kept = result.literals.filter(pl.col("is_kept"))
    for row in kept.iter_rows(named=True):
        atom = f"{row['predicate']}({','.join(row['variables'])})"
        literal = f"{row['role']} {'' if row['is_positive'] else 'not '}{atom}"
        behind = result.evidence.filter(pl.col("operator") == row["operator"])
        assert behind["contradicts"].list.contains(literal).sum() == row["n_against"], literal


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_neither_the_order_of_rows_nor_names_of_instances_matter(table_world, study, seed):
    rng = random.Random(seed)
    chosen = joined(rng.sample(list(study.values()), 3))
    order = list(range(chosen.height))
    rng.shuffle(order)
    shuffled = Transitions.validate(chosen[order])
    assert text(table_world, shuffled) == text(table_world, chosen)
    instances = [*table_world.CUBES, *table_world.HANDS, "table"]
    fresh = [f"x{number}" for number in range(len(instances))]
    rng.shuffle(fresh)
    names = dict(zip(instances, fresh, strict=True))
    assert text(table_world, renamed(chosen, names)) == text(table_world, chosen)


def renamed(transitions, names):
    def atoms(column):
        element = pl.element()
        for old, new in names.items():
            element = element.str.replace_all(rf"\b{old}\b", new)
        return pl.col(column).list.eval(element).list.sort()

    objects = pl.col("objects").list.eval(
        pl.struct(name=pl.element().struct["name"].replace(names), type=pl.element().struct["type"])
    )
    return Transitions.validate(
        transitions.with_columns(
            pl.col("hand", "acted_on", "in_hand").replace(names),
            objects.list.sort(),
            *(atoms(column) for column in ("before", "after", "unknown_before", "unknown_after")),
        )
    )


def test_learning_twice_gives_the_same_tables(table_world, study):
    transitions = joined(study.values())
    first, second = (learned(table_world, transitions) for _ in range(2))
    assert all(a.equals(b) for a, b in zip(first, second, strict=True))


def test_lifting_in_small_chunks_changes_nothing(table_world, study):
    transitions = joined(study.values())
    whole, parts = (
        learned(table_world, transitions),
        learned(table_world, transitions, LearnParams(rows_per_chunk=7)),
    )
    assert all(a.equals(b) for a, b in zip(whole, parts, strict=True))


def test_every_demonstration_twice_doubles_counts_and_keeps_clean_literals(table_world, clean):
    once = table_world.transitions_of(clean)
    twice = joined([once, once.with_columns(episode_id=pl.lit("again"))])
    one, two = learned(table_world, once), learned(table_world, twice)
    key = ["operator", "role", "predicate", "variables", "is_positive"]
    assert two.operators["n_transitions"].to_list() == [2 * n for n in one.operators["n_transitions"]]
    assert two.literals.filter("is_kept").select(key).equals(one.literals.filter("is_kept").select(key))


def test_what_was_not_observed_counts_for_neither_side(table_world, clean):
    transitions = table_world.transitions_of(clean)
    hidden = Transitions.validate(
        transitions.with_columns(
            pl.col("before", "after").list.filter(~pl.element().str.starts_with("clear")),
            *(
                pl.concat_list(
                    column, pl.col(source).list.filter(pl.element().str.starts_with("clear"))
                ).alias(column)
                for column, source in (("unknown_before", "before"), ("unknown_after", "after"))
            ),
        )
    )
    rows = learned(table_world, hidden).literals.filter(
        (pl.col("predicate") == "clear") & (pl.col("n_support") > 0)
    )
    assert rows.filter("is_kept", is_positive=True).is_empty()


def test_no_transitions_give_no_operators(table_world):
    result = learned(table_world, Transitions.create_empty())
    assert all(table.is_empty() for table in result)


def test_a_predicate_that_the_vocabulary_lacks_is_named(table_world, clean):
    transitions = table_world.transitions_of(clean)
    with pytest.raises(UnknownNameError, match=r"predicate 'clear'.*available: actedOn"):
        learn(
            transitions, table_world.TYPES, [each for each in table_world.PREDICATES if each.name != "clear"]
        )


def test_an_object_without_a_type_is_named(table_world, clean):
    transitions = table_world.transitions_of(clean).with_columns(
        pl.col("objects").list.filter(pl.element().struct["name"] != "cube_red")
    )
    with pytest.raises(DataError, match=r"object 'cube_red' of episode 'clean' has no type"):
        learned(table_world, Transitions.validate(transitions))


def judged(table_world, domain, kind, seed, hands):
    problem = table_world.problem_of(domain, kind, random.Random(seed), hands)
    attempt = solve(domain, problem)
    if attempt.plan is None:
        return attempt.outcome
    world, operators = table_world.Tabletop(problem), by_name(domain)
    for step in attempt.plan.steps:
        grounded = ground(operators[step.operator], step)
        wrong = world.wrong(grounded.adds, grounded.deletes)
        if wrong:
            return f"{step}: {wrong}"
    return "solved" if world.reaches(problem.goal) else "the goal is not reached in the world"


@pytest.mark.parametrize("kind", ["one on one", "tower of three", "tower of four", "two towers of two"])
def test_the_combined_domain_reaches_goals_never_shown_by_possible_steps(table_world, study, kind):
    domain = table_world.domain_of(joined(study.values()))
    assert judged(table_world, domain, kind, kind, ("Right_hand",)) == "solved"
    assert judged(table_world, domain, kind, kind, table_world.HANDS) == "solved"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_single_demonstrations_suffice_and_never_give_impossible_steps(table_world, seed):
    n_solved = 0
    for name, each in table_world.study(seed).items():
        domain = table_world.domain_of(table_world.transitions_of(each))
        results = {
            judged(table_world, domain, kind, f"{name}{kind}", ("Right_hand",)) for kind in table_world.GOALS
        }
        assert results <= {"solved", "unsolvable"}, (name, results)
        n_solved += results == {"solved"}
    assert n_solved >= 11
