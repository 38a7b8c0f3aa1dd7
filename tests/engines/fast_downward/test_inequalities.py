"""Inequality as facts: the same problem in every state, and the same task from the translator."""

import itertools
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from demoplan.engines.fast_downward.inequalities import MAX_FACTS, state_inequalities
from demoplan.engines.fast_downward.translating import translate_cold
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Problem, Signature, Step
from demoplan.language.execution import ground
from demoplan.language.pddl import parse_domain, render_domain, render_problem
from demoplan.language.types import TypeHierarchy

TYPES = TypeHierarchy.of({"cup": "thing", "mug": "cup", "shelf": "object"})
VARIABLES = ("?a", "?b", "?c")
OBJECTS = (("cup_1", "cup"), ("cup_2", "cup"), ("high", "shelf"), ("mug_1", "mug"), ("mug_2", "mug"))


def unlike(one, other):
    return Literal(Atom("=", (one, other)), is_positive=False)


@st.composite
def operators(draw, name):
    kinds = draw(
        st.lists(st.sampled_from(("cup", "mug", "shelf", "thing", "object")), min_size=3, max_size=3)
    )
    pairs = st.tuples(st.sampled_from(VARIABLES), st.sampled_from((*VARIABLES, "mug_1")))
    comparisons = st.builds(lambda pair, positive: Literal(Atom("=", pair), positive), pairs, st.booleans())
    touched = Literal(Atom("touched", (draw(st.sampled_from(VARIABLES)),)), draw(st.booleans()))
    return Operator(
        name,
        tuple(Parameter(variable, kind) for variable, kind in zip(VARIABLES, kinds, strict=True)),
        draw(st.frozensets(comparisons, max_size=3)) | {touched},
        frozenset({touched.negated()}),
    )


@st.composite
def domains(draw):
    name = draw(st.sampled_from(("touched2", "different", "Different")))
    return Domain(
        "cups",
        TYPES,
        tuple(sorted((Signature("touched", ("object",)), Signature(name, ("object", "object"))))),
        (draw(operators("move")), draw(operators("turn"))),
        (("mug_1", "mug"),),
    )


def possible_steps(domain, problem, state):
    """Every ground step whose conditions hold in a state."""
    kinds = dict(problem.objects)
    found = set()
    for operator in domain.operators:
        choices = [
            [name for name, kind in kinds.items() if domain.types.is_subtype(kind, each.type_name)]
            for each in operator.parameters
        ]
        for arguments in itertools.product(*choices):
            step = Step(operator.name, arguments)
            if not ground(operator, step).unmet(state):
                found.add(step)
    return found


@given(domains(), st.frozensets(st.sampled_from([name for name, _ in OBJECTS])))
def test_the_same_steps_are_possible_in_every_state(domain, touched):
    state = frozenset(Atom("touched", (name,)) for name in touched)
    problem = Problem("one", "cups", OBJECTS, state, frozenset({Literal(Atom("touched", ("high",)))}))
    stated_domain, stated = state_inequalities(domain, problem)
    assert possible_steps(stated_domain, stated, stated.initial) == possible_steps(domain, problem, state)
    assert stated.initial >= state
    assert (stated.goal, stated.objects) == (problem.goal, problem.objects)
    for before, after in zip(domain.operators, stated_domain.operators, strict=True):
        assert replace(after, preconditions=before.preconditions) == before
        assert after.preconditions >= before.preconditions
        assert not {literal.atom.predicate for literal in after.effects} - {"touched"}
    assert parse_domain(render_domain(stated_domain)) == stated_domain
    render_problem(stated, stated_domain)


def test_nothing_is_stated_where_nothing_has_to_differ_or_types_see_to_it(stacking, towers):
    problem = towers(["a"], ["b"], goal="onTop(a, b)")
    operators = tuple(
        replace(
            operator,
            preconditions=frozenset(
                literal for literal in operator.preconditions if literal.atom.predicate != "="
            )
            | ({unlike("?c", "?h")} if operator.name == "Take_1" else set()),
        )
        for operator in stacking.operators
    )
    domain = replace(stacking, operators=operators)
    assert state_inequalities(domain, problem) == (domain, problem)


def test_too_many_objects_are_left_as_they_are(stacking, towers):
    many = [[f"cube_{number}"] for number in range(33)]
    problem = towers(*many, goal="onTop(cube_1, cube_2)")
    assert MAX_FACTS < 33**2
    assert state_inequalities(stacking, problem) == (stacking, problem)
    fewer = towers(*many[:31], goal="onTop(cube_1, cube_2)")
    stated = state_inequalities(stacking, fewer)[1]
    assert len(stated.initial - fewer.initial) == 31 * 30


@pytest.mark.parametrize("goal", ["onTop(a, b) & onTop(b, c)", "onTop(c, a) & !onTop(b, c)"])
def test_the_translator_makes_the_same_task_and_has_nothing_to_take_out(
    planner, stacking, towers, tmp_path, goal
):
    problem = towers(["a"], ["b", "c"], goal=goal)
    tasks, n_removed = [], []
    for domain, asked in ((stacking, problem), state_inequalities(stacking, problem)):
        folder = tmp_path / f"{len(tasks)}"
        folder.mkdir()
        (folder / "domain.pddl").write_text(render_domain(domain))
        (folder / "problem.pddl").write_text(render_problem(asked, domain))
        ended = translate_cold(
            ["--sas-file", "task.sas", "domain.pddl", "problem.pddl"],
            folder=folder,
            installation=planner,
            wall_s=30.0,
            memory_bytes=None,
        )
        tasks.append((folder / "task.sas").read_bytes())
        n_removed.append(int(re.search(r"(\d+) operators removed", ended.output)[1]))
    assert tasks[0] == tasks[1]
    assert n_removed[0] > 0 == n_removed[1]
