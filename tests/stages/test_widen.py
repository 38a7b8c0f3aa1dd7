"""The ladder from frequent operators to all of them."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Problem, Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.widen import WidenParams, is_worth_trying, widen


def domain(*counts):
    operators = tuple(
        Operator(f"o{n:03}", (), frozenset(), frozenset(), count=c) for n, c in enumerate(counts)
    )
    return Domain("d", TypeHierarchy(()), (Signature("p", ()),), operators)


@given(st.lists(st.integers(0, 50), max_size=40), st.integers(1, 10))
def test_each_rung_adds_the_next_most_frequent_operators_until_all_are_there(counts, max_rungs):
    ladder = widen(domain(*counts), WidenParams(max_rungs=max_rungs))
    assert 1 <= len(ladder) <= max_rungs
    assert ladder[-1] == domain(*counts)
    for narrow, wide in itertools.pairwise(ladder):
        assert set(narrow.operators) < set(wide.operators)
    for rung in ladder:
        left_out = set(domain(*counts).operators) - set(rung.operators)
        assert not left_out or max(o.count for o in left_out) < min(o.count for o in rung.operators)


def test_every_count_is_a_rung_where_there_are_few():
    assert [len(rung.operators) for rung in widen(domain(5, 1, 5, 3))] == [2, 3, 4]


def test_many_counts_share_rungs():
    assert [len(rung.operators) for rung in widen(domain(*range(100)), WidenParams(max_rungs=4))] == [
        25,
        50,
        75,
        100,
    ]


def test_a_domain_without_operators_is_its_own_ladder():
    assert widen(domain()) == (domain(),)


def test_a_rung_without_a_needed_effect_is_not_worth_trying():
    p = Literal(Atom("p"))
    nothing, adds = (
        domain(),
        Domain("d", TypeHierarchy(()), (), (Operator("o", (), frozenset(), frozenset({p})),)),
    )
    wish = Problem("q", "d", (), frozenset(), frozenset({p}))
    held = Problem("q", "d", (), frozenset({p.atom}), frozenset({p}))
    unwished = Problem("q", "d", (), frozenset({p.atom}), frozenset({p.negated()}))
    assert [is_worth_trying(nothing, each) for each in (wish, held, unwished)] == [False, True, False]
    assert [is_worth_trying(adds, each) for each in (wish, held, unwished)] == [True, True, False]
