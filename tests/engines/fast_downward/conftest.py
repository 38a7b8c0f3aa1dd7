"""A hand-written stacking domain, and towers to build with it."""

from pathlib import Path

import pytest

from demoplan.engines.fast_downward import find_installation
from demoplan.language.atoms import Atom
from demoplan.language.domains import Problem
from demoplan.language.goals import parse_goal
from demoplan.language.pddl import parse_domain

GOLDEN = Path(__file__).parents[2] / "golden" / "planning"


@pytest.fixture
def planner():
    """Fast Downward, or a skip with the word that it is missing."""
    found = find_installation()
    if found is None:
        pytest.skip("Fast Downward is missing: pip install 'demoplan[planner]'")
    return found


@pytest.fixture(scope="session")
def stacking():
    return parse_domain((GOLDEN / "stacking-domain.pddl").read_text())


@pytest.fixture(scope="session")
def towers(stacking):
    """Makes a problem: towers as lists of cubes from the bottom up, and a goal as text."""

    def make(*piles, goal, hands=("Left_hand", "Right_hand")):
        facts = {Atom("handOpen", (hand,)) for hand in hands}
        objects = [*((hand, "Hand") for hand in hands), ("table", "Table")]
        for pile in piles:
            below = "table"
            for cube in pile:
                facts.add(Atom("onTop", (cube, below)))
                objects.append((cube, "WoodenCube"))
                below = cube
            facts.add(Atom("clear", (below,)))
        goal = parse_goal(goal, stacking.predicates, objects, stacking.types)
        return Problem("towers", stacking.name, tuple(sorted(objects)), frozenset(facts), goal)

    return make
