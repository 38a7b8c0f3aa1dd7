from dataclasses import replace

from demoplan.language.atoms import Atom, Literal
from demoplan.language.diff import diff, in_words
from demoplan.language.domains import Domain, Operator, Parameter, Signature
from demoplan.language.types import TypeHierarchy

HAND = Parameter("?hand", "Hand")
OPEN = Literal(Atom("handOpen", ("?hand",)))
MOVE = Literal(Atom("handMove", ("?hand",)))
REACH = Operator("reach_1", (HAND,), frozenset({OPEN}), frozenset({MOVE}), activity="Reach", cost=10, count=5)
IDLE = Operator(
    "idle_1", (HAND,), frozenset({MOVE}), frozenset({MOVE.negated()}), activity="Idle", cost=12, count=3
)


def domain(*operators, types=None):
    return Domain(
        "d", TypeHierarchy.of(types or {"Hand": "object"}), (Signature("handMove", ("Hand",)),), operators
    )


def test_equal_domains_have_no_difference():
    assert diff(domain(REACH, IDLE), domain(REACH, IDLE)) == ()
    assert in_words(diff(domain(), domain())) == "no difference"


def test_operators_that_come_and_go_are_named_with_what_they_do():
    words = in_words(diff(domain(REACH), domain(IDLE)))
    assert "operator idle_1 added: (?hand Hand) gives not handMove(?hand); seen 3 times" in words
    assert "operator reach_1 removed: (?hand Hand) gives handMove(?hand); seen 5 times" in words


def test_literals_counts_and_costs_are_compared():
    changed = replace(REACH, preconditions=frozenset({OPEN.negated()}), count=6, cost=9)
    words = in_words(diff(domain(REACH), domain(changed)))
    assert "precondition of reach_1 removed: handOpen(?hand)" in words
    assert "precondition of reach_1 added: not handOpen(?hand)" in words
    assert "count of reach_1 changed from 5 to 6" in words
    assert "cost of reach_1 changed from 10 to 9" in words
    assert "effect" not in words


def test_an_operator_that_was_renumbered_is_found_again():
    other = replace(
        REACH,
        name="reach_2",
        preconditions=frozenset({OPEN, MOVE.negated()}),
        effects=frozenset({OPEN.negated()}),
    )
    old = domain(REACH, other)
    new = domain(replace(other, name="reach_1"), replace(REACH, name="reach_2"))
    assert {(each.subject, each.old, each.new) for each in diff(old, new)} == {
        ("name", "reach_1", "reach_2"),
        ("name", "reach_2", "reach_1"),
    }


def test_types_are_compared():
    (change,) = diff(domain(REACH), domain(REACH, types={"Hand": "object", "Cube": "object"}))
    assert str(change) == "type added: Cube < object"


def test_counts_behind_literals_are_compared_where_given():
    old = {("reach_1", "effect", "handMove(?hand)"): (5, 0)}
    new = {("reach_1", "effect", "handMove(?hand)"): (6, 2)}
    (change,) = diff(domain(REACH), domain(REACH), old, new)
    assert (
        str(change)
        == "support of effect handMove(?hand) of reach_1 changed from 5 for, 0 against to 6 for, 2 against"
    )
