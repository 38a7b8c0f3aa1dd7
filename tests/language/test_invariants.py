"""Groups of atoms of which at most one holds, read off the operators."""

import random
from pathlib import Path

from demoplan.language.atoms import Atom
from demoplan.language.domains import Step
from demoplan.language.execution import ground
from demoplan.language.invariants import ExclusiveGroup, exclusive_groups
from demoplan.language.pddl import parse_domain, parse_problem

GOLDEN = Path(__file__).parents[1] / "golden" / "planning"
DOMAIN = parse_domain((GOLDEN / "stacking-domain.pddl").read_text())
PROBLEM = parse_problem((GOLDEN / "stacking-problem.pddl").read_text(), DOMAIN)
ON_ONE_THING = ExclusiveGroup((("onTop", 0),))
OPEN_OR_HOLDING = ExclusiveGroup((("handOpen", 0), ("inHand", 0)))


def test_a_cube_is_on_one_thing_and_a_hand_is_open_or_holds_one_thing():
    groups = exclusive_groups(DOMAIN, PROBLEM.initial)
    assert ON_ONE_THING in groups
    assert OPEN_OR_HOLDING in groups


def test_what_a_state_contradicts_is_no_group():
    broken = PROBLEM.initial | {Atom("onTop", ("cube_red", "cube_yellow"))}
    assert ON_ONE_THING not in exclusive_groups(DOMAIN, broken)


def test_predicates_that_nothing_adds_are_in_no_group():
    added = {each.atom.predicate for o in DOMAIN.operators for each in o.effects if each.is_positive}
    for group in exclusive_groups(DOMAIN):
        assert {predicate for predicate, _ in group.members} <= added


def test_random_walks_never_break_a_group():
    chance = random.Random(7)
    groups = exclusive_groups(DOMAIN, PROBLEM.initial)
    by_type = {}
    for name, kind in PROBLEM.objects:
        for each in DOMAIN.types.ancestors(kind):
            by_type.setdefault(each, []).append(name)
    state, n_taken = PROBLEM.initial, 0
    for _ in range(6000):
        operator = chance.choice(DOMAIN.operators)
        arguments = tuple(chance.choice(by_type[each.type_name]) for each in operator.parameters)
        action = ground(operator, Step(operator.name, arguments))
        if action.unmet(state):
            continue
        state, n_taken = action.apply(state), n_taken + 1
        for group in groups:
            keys = [group.key(atom) for atom in state if group.key(atom) is not None]
            assert len(keys) == len(set(keys)), group
    assert n_taken > 100
