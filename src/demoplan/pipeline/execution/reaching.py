"""Whether a robot gets everywhere that a plan asks it to: asked before anything moves."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from demoplan.engines.mujoco.opening import open_session
from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.engines.mujoco.session import Session
from demoplan.engines.mujoco.skills import SkillTable, motion_of, read_skills
from demoplan.errors import UsageError
from demoplan.language.domains import Domain, Plan
from demoplan.pipeline.domains.planning import Start
from demoplan.pipeline.execution.senses import TABLE

FROM_ABOVE_M = {"reach": 0.04, "grasp": 0.0, "carry": 0.02}
"""From so far above its place a hand comes straight down, by skill: the least that motions try [m]."""


def out_of_reach(
    plan: Plan, domain: Domain, session: Session, places: Mapping[str, np.ndarray], skills: SkillTable
) -> str | None:
    """The first place of a plan that its hand cannot get to, before anything moves; None if there is none.

    Args:
        plan: Its own steps move things: a tower grows by the height of each object that is put on it.
        domain: What the steps mean.
        session: The robot, and the sizes of things.
        places: Where the middle of each object is now, ``(3,)`` in the world [m].
        skills: What tells where the steps' objects go.
    """
    heights = {each.name: each.size_xyz_m[2] for each in session.scene.objects}
    places = dict(places)
    told: set[tuple[str, str, tuple[float, ...]]] = set()
    for number, step in enumerate(plan.steps, 1):
        hand, motion = motion_of(step, domain, skills)
        thing, support = motion.object, motion.support
        if thing is None or thing not in places:
            continue
        if support is not None and support != TABLE and support in places:
            rise = (heights[support] + heights[thing]) / 2
            places[thing] = places[support] + np.array([0.0, 0.0, rise])
        spot = tuple(float(value) for value in np.round(places[thing], 3))
        if (hand, motion.skill, spot) in told:
            continue
        told.add((hand, motion.skill, spot))
        for above_m in sorted({0.0, FROM_ABOVE_M.get(motion.skill, 0.0)}):
            why = session.can_reach(hand, (spot[0], spot[1], round(spot[2] + above_m, 3)))
            if why is not None:
                way = f"come down from {above_m:.2f} m above" if above_m else "get"
                return f"step {number}, {step}: {hand} cannot {way} to {spot}, for {thing}: {why}"
    return None


def reach_of_plan(
    plan: Plan, domain: Domain, session: Session, skills: SkillTable | None = None
) -> str | None:
    """Why a robot cannot get everywhere that a plan asks it to; None if it can.

    Args:
        plan: From the session's scene; its hands are the robot's.
        domain: What its steps mean.
        session: The robot, at rest in the scene.
        skills: What tells where the steps' objects go; by default, what comes with demoplan.
    """
    places = {each.name: np.array(each.position_xyz_m) for each in session.scene.objects}
    return out_of_reach(plan, domain, session, places, skills or read_skills())


def open_for(scene: SceneSpec, robot: str) -> Session:
    """A session to ask about reach; nothing will move in it."""
    return open_session(scene, robot, seed=0)


def with_hands_of(
    start: Start, session: Session, domain: Domain, *, hand_type: str = "Hand", holding: str = "inHand"
) -> Start:
    """The start as a robot finds it: only its own hands are there, and they are empty.

    Args:
        start: A logged state; whatever other hands hold in it cannot be planned with.
        session: The robot.
        domain: Its types tell what a hand is.
        hand_type: Type of hands.
        holding: Predicate (hand, object).

    Raises:
        UsageError: If something is in a hand that the robot does not have.
    """
    others = {
        name
        for name, kind in start.objects.items()
        if domain.types.is_subtype(kind, hand_type) and name not in session.hands
    }
    held = sorted(atom for atom in start.atoms if atom.predicate == holding and others & set(atom.arguments))
    if held:
        raise UsageError(f"{start.origin}: {held[0]}; {session.robot} has {', '.join(session.hands)} only")
    known = next(kind for name, kind in start.objects.items() if domain.types.is_subtype(kind, hand_type))
    objects = {name: kind for name, kind in start.objects.items() if name not in others}
    for hand in session.hands:
        objects.setdefault(hand, known)
    atoms = frozenset(atom for atom in start.atoms if not others & set(atom.arguments))
    return replace(start, objects=objects, atoms=atoms)
