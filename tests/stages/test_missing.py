"""What to demonstrate for goals without a plan: the nearest thing to what was shown."""

from demoplan.engines.fast_downward import SolveParams, solve
from demoplan.language.atoms import Atom
from demoplan.language.domains import Plan, Step
from demoplan.language.goals import parse_goal
from demoplan.language.invariants import parse_group
from demoplan.language.pddl import parse_domain
from demoplan.pipeline.domains.planning import missing_demonstrations
from demoplan.stages.ask import ask
from demoplan.stages.missing import MissingDemonstration, imagine, rank_missing, read_missing

# What stacking from the table shows, and nothing else.
DOMAIN = parse_domain("""
; clear is "clear"
; in_hand is "inHand"
; on_top is "onTop"
(define (domain stacking)
  (:requirements :strips :typing :negative-preconditions)
  (:types hand cube table - object)
  (:predicates (clear ?x - cube) (on_top ?x - cube ?y) (in_hand ?h - hand ?x - cube) (open ?h - hand))
  (:action take
    :parameters (?hand - hand ?object - cube)
    :precondition (and (open ?hand) (clear ?object))
    :effect (and (in_hand ?hand ?object) (not (open ?hand)) (not (clear ?object))))
  (:action put
    :parameters (?hand - hand ?object - cube ?from - table ?to - cube)
    :precondition (and (in_hand ?hand ?object) (on_top ?object ?from) (clear ?to))
    :effect (and (on_top ?object ?to) (not (on_top ?object ?from)) (not (clear ?to))))
  (:action release
    :parameters (?hand - hand ?object - cube)
    :precondition (and (in_hand ?hand ?object))
    :effect (and (open ?hand) (clear ?object) (not (in_hand ?hand ?object)))))
""")
GROUPS = ((parse_group("clear(#), onTop(·,#)"), "cube"), (parse_group("onTop(#,·)"), "cube"))
OBJECTS = {"h": "hand", "red": "cube", "blue": "cube", "green": "cube", "t": "table"}
STACKED = {
    *(Atom("onTop", pair) for pair in (("red", "blue"), ("blue", "t"), ("green", "t"))),
    *(Atom("clear", (name,)) for name in ("red", "green")),
    Atom("open", ("h",)),
}


def problem(goal):
    return ask(DOMAIN, STACKED, OBJECTS, parse_goal(goal, DOMAIN.predicates, OBJECTS, DOMAIN.types), "p")


def missing(goal, groups=GROUPS):
    return missing_demonstrations(DOMAIN, problem(goal), SolveParams(wall_s=20), groups)


def test_operators_themselves_say_what_is_exchanged_where_demonstrations_are_too_few_to_show_it():
    assert [each.changes for each in missing("onTop(blue, red)", groups=())] == [(("?from", "cube"),)]


def test_unstacking_asks_for_a_demonstration_of_taking_a_cube_from_on_top_of_another():
    assert solve(DOMAIN, problem("onTop(blue, red)")).outcome == "unsolvable"
    found = missing("onTop(blue, red)")
    assert [each.changes for each in found] == [(("?from", "cube"),)]
    assert "a demonstration of taking red from on top of blue" in str(found[0])


def test_putting_on_the_table_asks_for_what_differs_in_two_things():
    (found,) = missing("onTop(red, t)")
    assert found.changes == (("?from", "cube"), ("?to", "table"))
    assert found.example == "taking red from on top of blue and putting red onto t"


def test_what_can_be_planned_asks_for_nothing():
    assert missing("onTop(green, red)") == ()


def test_imagined_operators_exchange_what_was_seen_to_exclude_each_other():
    operators = {each.name: each for each in imagine(DOMAIN, problem("onTop(blue, red)"), GROUPS).operators}
    effects = {str(each) for each in operators["put with ?from cube"].effects}
    assert {"clear(?from)", "not onTop(?object,?from)"} <= effects
    onto_table = operators["put with ?to table"]
    assert not any(each.atom == Atom("clear", ("?to",)) for each in onto_table.effects)
    assert not any("?hand" in name or "?object" in name for name in operators if " with " in name)


def test_demonstrations_that_open_more_goals_come_first():
    def needs(*changes):
        return MissingDemonstration(activity="Put", operator="put", changes=changes, example="…")

    one, other = needs(("?from", "cube")), needs(("?to", "table"))
    ranked = rank_missing({"a": [other], "b": [one], "c": [one]})
    assert ranked == ((one, ("b", "c")), (other, ("a",)))


def test_a_plan_without_imagined_steps_asks_for_nothing():
    assert read_missing(Plan((Step("take", ("h", "red")),)), DOMAIN) == ()
