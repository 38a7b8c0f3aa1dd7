"""Placing things: carry what is in the hand over everything, and lower it on its support."""

from collections.abc import Callable, Generator
from itertools import product

import numpy as np

from demoplan.engines.mujoco.robots.arm_control import ArmControl, MotionFailed, Script
from demoplan.engines.mujoco.robots.grasps import yaws_on
from demoplan.engines.mujoco.robots.handling import (
    beneath,
    hold_of,
    look,
    named,
    require_hold,
    stance_of_seen,
)
from demoplan.engines.mujoco.robots.routing import Destination
from demoplan.engines.mujoco.session import Motion
from demoplan.geometry import Array, multiply, rotate

_ROOM_M = 0.05
"""Places on the table that are so far inside the arm's reach come first."""


def carry(control: ArmControl, motion: Motion) -> Script:
    """Lift what is in the hand, carry it over everything, and lower it on its support."""
    name, params = named(motion), control.params
    if control.held is None or control.held.object != name:
        raise MotionFailed("not_holding", f"{control.arm.hand} does not hold {name}", is_blocked=True)
    require_hold(control, name)
    support = motion.support or "table"
    control.may_touch = frozenset([name, support])
    seen = [name] if control.around.is_surface(support) else [name, support]
    for each in seen:
        yield from look(control, each)
    lift_from = beneath(control, name)
    control.may_touch |= frozenset(lift_from)
    offset = control.placing_offset.pop(0) if control.placing_offset else np.zeros(3)
    aim = yield from _carry_above(control, motion, name, support, offset)
    # Seen again at rest: how does it lie in the hand now, and where is the support?
    yield from control.wait(params.settle_s)
    require_hold(control, name)
    for each in seen:
        yield from look(control, each)
    control.held = hold_of(control, name)
    goal, yaw = aim(True)
    down = control.go_straight(
        Destination(
            position_xyz_m=goal + np.array([0.0, 0.0, params.place_gap_m]),
            yaw_rad=yaw,
            opening_m=control.opening_m(),
            speed_m_per_s=params.near_speed_m_per_s,
        )
    )
    for script in (down, _lower(control, goal, yaw)):
        for _ in script:
            require_hold(control, name)
            yield


def _carry_above(
    control: ArmControl, motion: Motion, name: str, support: str, offset: Array
) -> Generator[None, None, Callable[[bool], tuple[Array, float]]]:
    """Go above the place; gives a function that says anew where hand and object are to come to."""
    params = control.params
    held = control.held
    assert held is not None
    own = stance_of_seen(control, name)
    spots: list[Array | None] = [None]
    if motion.position_xyz_m is None and control.around.is_surface(support):
        spots = list(control.around.free_spots(name, own.radius_m + control.arm.hand_radius_m))
        if not spots:
            raise MotionFailed("path_blocked", f"no free spot on {support} for {name}", is_blocked=True)
        # What is put at the very edge of the reach can hardly be taken, or built on, again.
        spots.sort(key=lambda spot: spot is not None and control.arm.room_m(spot) < _ROOM_M)
    failure: MotionFailed | None = None
    support_stance = None if control.around.is_surface(support) else control.around.stance(support)
    # Close to its body an arm cannot raise its hand far: then it passes over the place from less high.
    heights = (params.clearance_m, 0.4 * params.clearance_m)
    turns = yaws_on(own, support_stance)
    for through_joints, spot, height, turn in product((False, True), spots[:8], heights, turns):

        def aim(has_turned: bool, spot: Array | None = spot, turn: float = turn) -> tuple[Array, float]:
            return _aim(control, motion, name, support, spot, None if has_turned else turn, offset)

        goal, yaw = aim(False)
        above = Destination(
            position_xyz_m=goal + np.array([0.0, 0.0, height]),
            yaw_rad=yaw,
            opening_m=control.opening_m(),
            speed_m_per_s=params.carry_speed_m_per_s,
            radius_m=max(control.arm.hand_radius_m, own.radius_m),
            # What is carried hangs below the grasp, by as much as it was when it was taken.
            below_m=max(control.arm.finger_reach_m, own.height_m / 2 - held.position_xyz_m[2]),
            clearance_m=params.clearance_m,
            without=(name,),
            then_xyz_m=(goal + np.array([0.0, 0.0, params.place_gap_m]),),
        )
        script = control.go_over(above, through_joints=through_joints)
        try:
            next(script)
        except StopIteration:
            return aim
        except MotionFailed as problem:
            failure = failure or problem
            continue
        yield
        for _ in script:
            require_hold(control, name)
            yield
        return aim
    assert failure is not None
    raise failure


def _aim(
    control: ArmControl,
    motion: Motion,
    name: str,
    support: str,
    spot: Array | None,
    turn: float | None,
    offset: Array,
) -> tuple[Array, float]:
    """Where the grasp is to come, and how turned, so that the object lies in the middle of its place.

    ``turn`` is None once the hand has turned: what is left is the smallest turn that lays the object square.
    """
    held = control.held
    assert held is not None
    own = stance_of_seen(control, name)
    hand_turn = control.arm.pose(control.around.data)[1]
    if motion.position_xyz_m is not None:
        middle = np.array(motion.position_xyz_m)
    elif spot is not None:
        middle = np.array([spot[0], spot[1], own.height_m / 2])
    else:
        on = stance_of_seen(control, support)
        middle = on.position_xyz_m + np.array([0.0, 0.0, on.height_m / 2 + own.height_m / 2])
        if turn is None:
            turn = yaws_on(own, on)[0]
    turned = multiply(_about_z(turn or 0.0), hand_turn)
    goal = middle - rotate(turned, held.position_xyz_m) + offset
    w, x, y, z = turned
    return goal, float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _about_z(yaw_rad: float) -> Array:
    return np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])


def _lower(control: ArmControl, goal_xyz_m: Array, yaw_rad: float) -> Script:
    """Come down slowly until the arm feels that something bears the object."""
    below = goal_xyz_m - np.array([0.0, 0.0, 0.002])

    def has_landed() -> bool:
        return bool(control.position_xyz_m()[2] - control.start_xyz_m()[2] > 0.004)

    yield from control.go_straight(
        Destination(position_xyz_m=below, yaw_rad=yaw_rad, opening_m=control.opening_m(), speed_m_per_s=0.04),
        stop=has_landed,
        depth_m=0.008,
    )
    yield from control.wait(control.params.settle_s)
