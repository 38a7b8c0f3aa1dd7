"""A stacking domain written by hand, as the bytes that it must render to."""

from pathlib import Path

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Problem, Signature
from demoplan.language.pddl import domain_id, parse_domain, parse_problem, render_domain, render_problem
from demoplan.language.types import TypeHierarchy

GOLDEN = Path(__file__).parents[1] / "golden" / "planning"

TYPES = TypeHierarchy.of(
    {
        "Hand": "object",
        "Table": "Surface",
        "Cube": "Graspable",
        "WoodenCube": "Cube",
    }
)
PREDICATES = (
    Signature("actedOn", ("Hand", "object")),
    Signature("clear", ("Graspable",)),
    Signature("graspable", ("Hand", "Graspable")),
    Signature("handMove", ("Hand",)),
    Signature("handOpen", ("Hand",)),
    Signature("inHand", ("Hand", "Graspable")),
    Signature("onTop", ("Graspable", "object")),
)


def literals(text):
    """Literals of ``p(?a) & !q(?b)``."""
    parts = [part.strip() for part in text.split("&") if part.strip()]
    return frozenset(Literal(Atom.parse(part.removeprefix("!")), not part.startswith("!")) for part in parts)


def operator(name, parameters, before, effects, *, activity, cost, count):
    pairs = [part.split(" - ") for part in parameters.split(", ")]
    return Operator(
        name,
        tuple(Parameter(variable, kind) for variable, kind in pairs),
        literals(before),
        literals(effects),
        activity,
        cost,
        count,
    )


EQUAL = Literal(Atom("=", ("?c", "?to")), is_positive=False)


def put(name, start, target, effects, *, cost, count):
    made = operator(
        name,
        f"?h - Hand, ?c - Cube, ?from - {start}, ?to - {target}",
        "inHand(?h,?c) & !handOpen(?h) & !handMove(?h) & onTop(?c,?from)"
        + (" & clear(?to)" if target == "Cube" else ""),
        f"!onTop(?c,?from) & onTop(?c,?to) & handMove(?h) & {effects}",
        activity="Put",
        cost=cost,
        count=count,
    )
    conditions = made.preconditions | ({EQUAL} if target == "Cube" else frozenset())
    return Operator(made.name, made.parameters, conditions, made.effects, "Put", cost, count)


DOMAIN = Domain(
    "cube-stacking",
    TYPES,
    PREDICATES,
    (
        operator(
            "Idle_1",
            "?h - Hand",
            "handOpen(?h) & handMove(?h)",
            "!handMove(?h)",
            activity="Idle",
            cost=1,
            count=24,
        ),
        put("Put_1", "Table", "Cube", "!clear(?to)", cost=2, count=15),
        put("Put_2", "Cube", "Table", "clear(?from)", cost=4, count=6),
        put("Put_3", "Cube", "Cube", "clear(?from) & !clear(?to)", cost=7, count=3),
        operator(
            "Reach_1",
            "?h - Hand, ?c - Cube",
            "handOpen(?h) & !handMove(?h) & clear(?c)",
            "handMove(?h) & actedOn(?h,?c) & graspable(?h,?c)",
            activity="Reach",
            cost=1,
            count=24,
        ),
        operator(
            "Release_1",
            "?h - Hand, ?c - Cube",
            "inHand(?h,?c) & handMove(?h) & !handOpen(?h)",
            "!inHand(?h,?c) & handOpen(?h) & !actedOn(?h,?c) & clear(?c)",
            activity="Release",
            cost=1,
            count=24,
        ),
        operator(
            "Take_1",
            "?h - Hand, ?c - Cube",
            "graspable(?h,?c) & handOpen(?h) & handMove(?h) & clear(?c)",
            "inHand(?h,?c) & !handOpen(?h) & !handMove(?h) & !graspable(?h,?c) & !clear(?c)",
            activity="Take",
            cost=1,
            count=24,
        ),
    ),
)

CUBES = ("cube_blue", "cube_green", "cube_red", "cube_yellow")
PROBLEM = Problem(
    "two towers, after one",
    "cube-stacking",
    (
        ("Left_hand", "Hand"),
        ("Right_hand", "Hand"),
        *((name, "WoodenCube") for name in CUBES),
        ("table", "Table"),
    ),
    frozenset(
        map(
            Atom.parse,
            [
                "handOpen(Left_hand)",
                "handOpen(Right_hand)",
                "onTop(cube_green,table)",
                "onTop(cube_red,cube_green)",
                "onTop(cube_blue,cube_red)",
                "onTop(cube_yellow,table)",
                "clear(cube_blue)",
                "clear(cube_yellow)",
            ],
        )
    ),
    literals("onTop(cube_red,cube_blue) & onTop(cube_green,cube_yellow) & !inHand(Right_hand,cube_red)"),
)


def test_the_stacking_domain_renders_to_the_golden_bytes():
    assert render_domain(DOMAIN).encode() == (GOLDEN / "stacking-domain.pddl").read_bytes()


def test_the_stacking_domain_without_costs_renders_to_the_golden_bytes():
    assert (
        render_domain(DOMAIN, has_costs=False).encode()
        == (GOLDEN / "stacking-domain-plain.pddl").read_bytes()
    )


def test_the_stacking_problem_renders_to_the_golden_bytes():
    assert render_problem(PROBLEM, DOMAIN).encode() == (GOLDEN / "stacking-problem.pddl").read_bytes()


def test_golden_texts_read_back_as_the_values():
    assert parse_domain((GOLDEN / "stacking-domain.pddl").read_text()) == DOMAIN
    assert parse_problem((GOLDEN / "stacking-problem.pddl").read_text(), DOMAIN) == PROBLEM


def test_a_domain_is_named_by_its_text():
    cheaper = Domain(DOMAIN.name, TYPES, PREDICATES, (DOMAIN.operators[0],))
    assert domain_id(DOMAIN) == "f45565ca065f35a2"
    assert domain_id(cheaper) != domain_id(DOMAIN)
