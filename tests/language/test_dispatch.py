"""What must wait for what, held against every order that the graph allows."""

from itertools import permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.language.atoms import Atom, Literal
from demoplan.language.dispatch import dispatch_graph
from demoplan.language.domains import Domain, Operator, Parameter, Plan, Problem, Signature, Step
from demoplan.language.execution import execute, ground
from demoplan.language.momentary import Momentary
from demoplan.language.types import TypeHierarchy

TYPES = TypeHierarchy.of({"Hand": "object", "Cube": "object"})
NAMES = ("p", "q", "r", "s")


def atom(text):
    return Atom.parse(text)


def literal(text):
    return Literal(atom(text.removeprefix("not ")), not text.startswith("not "))


def operator(name, preconditions, effects):
    return Operator(
        name,
        (),
        frozenset(map(literal, preconditions)),
        frozenset(map(literal, effects)),
    )


def domain_of(*operators):
    return Domain("d", TYPES, tuple(Signature(name, ()) for name in NAMES), tuple(operators))


def orders(graph):
    """Every order that follows the edges."""
    n = len(graph.steps)
    for order in permutations(range(n)):
        if all(graph.predecessors(step) <= set(order[:place]) for place, step in enumerate(order)):
            yield order


def test_a_step_waits_for_the_step_that_makes_its_condition_true():
    domain = domain_of(operator("a", [], ["p()"]), operator("b", ["p()"], ["q()"]))
    graph = dispatch_graph(domain, Plan((Step("a"), Step("b"))))
    assert [(edge.before, edge.after, edge.kind, edge.reasons) for edge in graph.edges] == [
        (0, 1, "condition", ("p()",))
    ]
    assert graph.ready(()) == (0,)
    assert graph.ready((0,)) == (1,)
    assert graph.ready((0,), (1,)) == ()


def test_a_step_that_destroys_a_condition_waits_for_those_who_need_it():
    domain = domain_of(operator("a", ["p()"], ["q()"]), operator("b", [], ["not p()"]))
    graph = dispatch_graph(domain, Plan((Step("a"), Step("b"))))
    assert [(edge.kind, edge.reasons) for edge in graph.edges] == [("interference", ("p()",))]


def test_steps_without_anything_in_common_may_run_at_once():
    domain = domain_of(operator("a", [], ["p()"]), operator("b", [], ["q()"]))
    graph = dispatch_graph(domain, Plan((Step("a"), Step("b"))))
    assert graph.edges == ()
    assert graph.ready(()) == (0, 1)


def test_a_hand_does_one_thing_at_a_time():
    hand = (Parameter("?h", "Hand"),)
    one = Operator("one", hand, frozenset(), frozenset({Literal(Atom("p", ("?h",)))}))
    two = Operator("two", hand, frozenset(), frozenset({Literal(Atom("q", ("?h",)))}))
    domain = Domain("d", TYPES, (Signature("p", ("Hand",)), Signature("q", ("Hand",))), (one, two))
    plan = Plan((Step("one", ("left",)), Step("two", ("right",)), Step("two", ("left",))))
    graph = dispatch_graph(domain, plan, actors=("left", "right"))
    assert [(edge.before, edge.after, edge.reasons) for edge in graph.edges] == [(0, 2, ("left",))]


def test_what_a_step_both_deletes_and_adds_counts_as_brought_about():
    domain = domain_of(operator("a", [], ["p()", "not p()"]), operator("b", ["p()"], ["q()"]))
    graph = dispatch_graph(domain, Plan((Step("a"), Step("b"))))
    assert [edge.kind for edge in graph.edges] == ["condition"]


literals = st.builds(lambda name, sign: Literal(Atom(name), sign), st.sampled_from(NAMES), st.booleans())
operators = st.lists(
    st.tuples(st.frozensets(literals, max_size=2), st.frozensets(literals, min_size=1, max_size=2)),
    min_size=1,
    max_size=5,
)


@settings(max_examples=150, deadline=None)
@given(operators, st.frozensets(st.sampled_from(NAMES)))
def test_every_order_that_the_graph_allows_works_and_reaches_the_same_state(parts, start):
    all_operators = tuple(Operator(f"o{k}", (), before, after) for k, (before, after) in enumerate(parts))
    domain = domain_of(*all_operators)
    initial = frozenset(map(Atom, start))
    state, steps = initial, []
    for each in all_operators:
        grounded = ground(each, Step(each.name))
        if not grounded.unmet(state):
            steps.append(Step(each.name))
            state = grounded.apply(state)
    graph = dispatch_graph(domain, Plan(tuple(steps)))
    allowed = list(orders(graph))
    assert tuple(range(len(steps))) in allowed
    for order in allowed:
        run = execute(
            domain,
            Problem("x", "d", (), initial, frozenset()),
            Plan(tuple(steps[k] for k in order)),
        )
        assert run.is_valid
        assert run.states[-1] == state


@settings(max_examples=100, deadline=None)
@given(operators)
def test_no_edge_is_implied_by_others(parts):
    domain = domain_of(*(Operator(f"o{k}", (), before, after) for k, (before, after) in enumerate(parts)))
    graph = dispatch_graph(domain, Plan(tuple(Step(each.name) for each in domain.operators)))
    pairs = {(edge.before, edge.after) for edge in graph.edges}
    for before, after in pairs:
        frontier, seen = {b for a, b in pairs if a == before and b != after}, set()
        while frontier:
            seen |= frontier
            frontier = {b for a, b in pairs if a in frontier} - seen
        assert after not in seen


WORLD = {"left": "Hand", "cube": "Cube", "other": "Cube"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("handMove(left)", True),
        ("actedOn(left,cube)", True),
        ("inTouch(cube,left)", True),
        ("inTouch(cube,other)", False),
        ("inHand(left,cube)", False),
        ("onTop(cube,other)", False),
    ],
)
def test_what_tells_of_a_motion_is_momentary_and_what_a_motion_leaves_lasts(text, expected):
    assert Momentary().is_momentary(atom(text), WORLD, TYPES) is expected


def test_the_lasting_domain_demands_only_what_lasts_and_drops_operators_that_only_move():
    hand, cube = Parameter("?h", "Hand"), Parameter("?c", "Cube")
    take = Operator(
        "take",
        (hand, cube),
        frozenset({literal("handMove(?h)"), literal("inTouch(?c,?h)"), literal("clear(?c)")}),
        frozenset({literal("inHand(?h,?c)"), literal("not handMove(?h)")}),
    )
    idle = Operator(
        "idle", (hand,), frozenset({literal("handMove(?h)")}), frozenset({literal("not handMove(?h)")})
    )
    lasting = Momentary().lasting_domain(Domain("d", TYPES, (), (idle, take)))
    (only,) = lasting.operators
    assert only.name == "take"
    assert only.preconditions == {literal("clear(?c)")}
    assert only.effects == {literal("inHand(?h,?c)")}
