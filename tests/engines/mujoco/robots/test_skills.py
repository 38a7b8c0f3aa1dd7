from pathlib import Path

import pytest

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.robots.motions import SKILLS
from demoplan.engines.mujoco.session import SKILL_NAMES
from demoplan.engines.mujoco.skills import motion_of, read_skills
from demoplan.errors import ManifestError, UnknownNameError, UsageError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Signature, Step
from demoplan.language.types import TypeHierarchy


def literals(*texts):
    return frozenset(
        Literal(Atom.parse(text.removeprefix("not ")), is_positive=not text.startswith("not "))
        for text in texts
    )


def domain_of(activity, needs, effects, parameters):
    operator = Operator(
        name="op_1",
        parameters=tuple(Parameter(variable, kind) for variable, kind in parameters),
        preconditions=literals(*needs),
        effects=literals(*effects),
        activity=activity,
    )
    types = TypeHierarchy.of({"Hand": "object", "Cube": "object", "Table": "object"})
    return Domain("d", types, (Signature("inHand", ("Hand", "Cube")),), (operator,))


HAND_AND_CUBE = (("?h", "Hand"), ("?c", "Cube"))


def test_every_skill_has_a_name_and_every_name_a_skill():
    assert set(SKILLS) == set(SKILL_NAMES)
    assert read_skills().skills <= set(SKILL_NAMES)


def test_a_put_finds_what_is_carried_and_where_to_by_its_literals_whatever_the_order_of_parameters():
    domain = domain_of(
        "Put",
        ["inHand(?h,?c)", "onTop(?c,?from)"],
        ["onTop(?c,?to)", "not onTop(?c,?from)"],
        (("?to", "Cube"), ("?from", "Table"), ("?c", "Cube"), ("?h", "Hand")),
    )
    hand, motion = motion_of(Step("op_1", ("blue", "table", "red", "Left_hand")), domain, read_skills())
    assert hand == "Left_hand"
    assert (motion.skill, motion.object, motion.support) == ("carry", "red", "blue")


def test_a_put_that_only_takes_away_is_a_lift():
    domain = domain_of("Put", ["inHand(?h,?c)"], ["not onTop(?c,?c2)"], (*HAND_AND_CUBE, ("?c2", "Cube")))
    _, motion = motion_of(Step("op_1", ("Right_hand", "red", "blue")), domain, read_skills())
    assert (motion.skill, motion.object, motion.support) == ("lift", "red", None)


def test_a_constant_in_an_operator_is_found_too():
    domain = domain_of("Put", ["inHand(?h,?c)"], ["onTop(?c,table)"], HAND_AND_CUBE)
    _, motion = motion_of(Step("op_1", ("Right_hand", "red")), domain, read_skills())
    assert motion.support == "table"


def test_a_letting_go_that_is_named_a_reach_is_carried_out_as_what_it_does():
    domain = domain_of("Reach", ["inHand(?h,?c)"], ["not inHand(?h,?c)", "handOpen(?h)"], HAND_AND_CUBE)
    _, motion = motion_of(Step("op_1", ("Right_hand", "red")), domain, read_skills())
    assert (motion.activity, motion.skill, motion.object) == ("Reach", "release", "red")


def test_what_cannot_be_resolved_is_named():
    table = read_skills()
    step = Step("op_1", ("Right_hand", "red"))
    with pytest.raises(UnknownNameError, match=r"skill for activity 'Pour'.*Idle, Put, Reach"):
        motion_of(step, domain_of("Pour", [], ["handOpen(?h)"], HAND_AND_CUBE), table)
    with pytest.raises(UsageError, match="'grasp' lacks its object"):
        motion_of(step, domain_of("Take", [], ["handOpen(?h)"], HAND_AND_CUBE), table)
    with pytest.raises(UsageError, match="no parameter of type 'Hand'"):
        motion_of(Step("op_1", ("red",)), domain_of("Idle", [], [], (("?c", "Cube"),)), table)
    with pytest.raises(UnknownNameError, match="unknown operator 'op_2'"):
        motion_of(Step("op_2"), domain_of("Idle", [], [], HAND_AND_CUBE), table)


def test_a_users_table_adds_an_activity_with_numbers_of_its_own(tmp_path: Path):
    path = tmp_path / "skills.yaml"
    path.write_text(
        "name: mine\nactivities:\n  Fetch:\n    - skill: reach\n      numbers: {speed_m_per_s: 0.2}\n"
        "      parts:\n        object: ['needs clear(object)']\n"
    )
    domain = domain_of("Fetch", ["clear(?c)"], ["handOpen(?h)"], HAND_AND_CUBE)
    _, motion = motion_of(Step("op_1", ("Right_hand", "red")), domain, read_skills(path))
    assert motion.parameters == (("speed_m_per_s", 0.2),)
    path.write_text("name: mine\nactivities:\n  Fetch:\n    - skill: dance\n")
    with pytest.raises(ManifestError, match="skill"):
        read_skills(path)
    path.write_text(
        "name: mine\nactivities:\n  Fetch:\n    - {skill: reach, parts: {object: ['clear(object)']}}\n"
    )
    with pytest.raises(ManifestError, match="not a pattern"):
        read_skills(path)
