"""What each hand may be asked for."""

import numpy as np

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Problem, Signature
from demoplan.language.pddl import parse_domain, render_domain
from demoplan.language.types import TypeHierarchy
from demoplan.pipeline.sharing import WITHIN_REACH, beyond_reach, within_reach

TAKE = Operator(
    "take",
    (Parameter("?h", "Hand"), Parameter("?c", "Cube")),
    frozenset(),
    frozenset({Literal(Atom("inHand", ("?h", "?c")))}),
    activity="Take",
)
WAIT = Operator("wait", (Parameter("?h", "Hand"),), frozenset(), frozenset(), activity="Idle")
DOMAIN = Domain(
    "d",
    TypeHierarchy.of({"Hand": "object", "Cube": "object"}),
    (Signature("inHand", ("Hand", "Cube")),),
    (TAKE, WAIT),
)
PROBLEM = Problem(
    "p",
    "d",
    (("L", "Hand"), ("R", "Hand"), ("blue", "Cube"), ("red", "Cube")),
    frozenset(),
    frozenset({Literal(Atom("inHand", ("L", "red")))}),
)


class _Session:
    def __init__(self, *hands):
        self.hands = hands
        self.n_asked = 0

    def can_reach(self, hand, position):
        self.n_asked += 1
        return None if (hand == "L") == (position[1] > 0) else "too far"


class _Senses:
    objects = ("blue", "red", "unseen")

    def __init__(self, session):
        self.session = session

    def position(self, name):
        return {"blue": np.array([0.0, -0.2, 0.0]), "red": np.array([0.0, 0.2, 0.0])}.get(name)


def test_a_hand_is_not_asked_for_what_it_cannot_get_to():
    beyond = beyond_reach(_Senses(_Session("L", "R")))
    assert beyond == {("L", "blue"), ("R", "red")}
    domain, problem = within_reach(DOMAIN, PROBLEM, beyond)
    take, wait = domain.operators
    assert take.preconditions == {Literal(Atom(WITHIN_REACH, ("?h", "?c")))}
    assert wait == WAIT
    assert problem.initial == {Atom(WITHIN_REACH, ("L", "red")), Atom(WITHIN_REACH, ("R", "blue"))}
    assert parse_domain(render_domain(domain)).operators == domain.operators


def test_with_one_hand_or_all_in_reach_nothing_is_asked_or_changed():
    session = _Session("R")
    assert beyond_reach(_Senses(session)) == frozenset()
    assert session.n_asked == 0
    assert within_reach(DOMAIN, PROBLEM, frozenset()) == (DOMAIN, PROBLEM)
