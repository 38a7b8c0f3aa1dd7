"""Taking things: bring the open hand about one, from above, and close on it."""

from collections.abc import Generator
from itertools import product

import numpy as np

from demoplan.engines.mujoco.robots.arm_control import ArmControl, MotionFailed, Script
from demoplan.engines.mujoco.robots.grasps import STEEPEST_TILT_RAD, Grasp, Stance, grasps_of
from demoplan.engines.mujoco.robots.handling import hold_of, look, named, stance_of_seen
from demoplan.engines.mujoco.robots.routing import Destination
from demoplan.engines.mujoco.session import Motion
from demoplan.geometry import Array

_MOVED_M = 0.006
"""What lies this far from where it was seen before has been moved."""
_LEAST_GAP_M = 0.006
"""Pads that are closer than this hold nothing."""


def reach(control: ArmControl, motion: Motion) -> Script:
    """Bring the open hand about an object, from above."""
    name, arm, params = named(motion), control.arm, control.params
    if control.held is not None:
        raise MotionFailed("still_holding", f"{arm.hand} still holds {control.held.object}", is_blocked=True)
    control.may_touch = frozenset()
    yield from look(control, name)
    for _ in range(3):
        grasp = yield from _approach(control, name)
        # Seen again from close by: does it still lie where the hand is going to come down?
        yield from control.wait(params.settle_s)
        yield from look(control, name)
        stance = stance_of_seen(control, name)
        shift = stance.position_xyz_m - _seen_at(grasp, stance)
        if np.linalg.norm(shift) <= 5 * _MOVED_M:
            break
    else:
        raise MotionFailed("not_seen", f"{name} does not keep still")
    target = _best(grasp, _grasps(control, stance))
    control.may_touch = frozenset([name])
    yield from control.go_straight(
        Destination(
            position_xyz_m=target.position_xyz_m,
            yaw_rad=target.yaw_rad,
            opening_m=target.opening_m,
            speed_m_per_s=params.near_speed_m_per_s,
        )
    )
    yield from control.wait(params.settle_s)
    _check_arrival(control, target.position_xyz_m)


def _seen_at(grasp: Grasp, stance: Stance) -> Array:
    """Where the object's middle was when the grasp was chosen, as far as it can be told across and along."""
    return np.array([grasp.position_xyz_m[0], grasp.position_xyz_m[1], stance.position_xyz_m[2]])


def _best(before: Grasp, grasps: tuple[Grasp, ...]) -> Grasp:
    """The grasp that is turned most like the one before."""
    return min(grasps, key=lambda each: abs((each.yaw_rad - before.yaw_rad + np.pi) % (2 * np.pi) - np.pi))


def _grasps(control: ArmControl, stance: Stance) -> tuple[Grasp, ...]:
    arm = control.arm
    if stance.tilt_rad > STEEPEST_TILT_RAD:
        raise MotionFailed("path_blocked", f"it leans by {np.degrees(stance.tilt_rad):.0f}°", is_blocked=True)
    grasps = grasps_of(
        stance,
        near_yaw_rad=arm.rest_yaw_rad,
        widest_m=arm.widest_opening_m,
        finger_reach_m=arm.finger_reach_m,
        palm_gap_m=arm.palm_gap_m,
    )
    if not grasps:
        widths = ", ".join(f"{1e3 * extent:.0f}" for extent, _ in stance.sides)
        raise MotionFailed(
            "out_of_reach",
            f"it is {widths} mm wide; the hand opens {1e3 * arm.widest_opening_m:.0f} mm",
            is_blocked=True,
        )
    return grasps


def _approach(control: ArmControl, name: str) -> Generator[None, None, Grasp]:
    """Go above an object, for the first grasp of it that is free."""
    arm, params = control.arm, control.params
    failure: MotionFailed | None = None
    grasps = _grasps(control, stance_of_seen(control, name))
    # Close to its body an arm cannot raise its hand far: then from half as high.
    heights = (params.approach_m, 0.5 * params.approach_m)
    for through_joints, height, grasp in product((False, True), heights, grasps):
        above = Destination(
            position_xyz_m=grasp.position_xyz_m + np.array([0.0, 0.0, height]),
            yaw_rad=grasp.yaw_rad,
            opening_m=grasp.opening_m,
            speed_m_per_s=params.speed_m_per_s,
            radius_m=arm.hand_radius_m,
            below_m=arm.finger_reach_m,
            clearance_m=params.clearance_m,
            then_xyz_m=(grasp.position_xyz_m,),
        )
        script = control.go_over(above, through_joints=through_joints)
        try:
            next(script)
        except StopIteration:
            return grasp
        except MotionFailed as problem:
            # Another way to turn may be free; what the first one met is the best reason.
            failure = failure or problem
            continue
        yield from _while_opening(control, script, 1.0 - grasp.opening_m / arm.widest_opening_m)
        return grasp
    assert failure is not None
    raise failure


def _while_opening(control: ArmControl, script: Script, closure: float) -> Script:
    """Go on with a script while the fingers take their opening."""
    step = control.around.step_s / control.params.grip_s
    yield
    for _ in script:
        gap = closure - control.closure
        control.closure += float(np.clip(gap, -step, step))
        yield
    control.closure = closure


def _check_arrival(control: ArmControl, goal_xyz_m: Array) -> None:
    off = float(np.linalg.norm(control.position_xyz_m() - goal_xyz_m))
    if off > control.params.arrival_m:
        raise MotionFailed("off_course", f"ended {1e3 * off:.0f} mm beside its aim: something is in the way")


def grasp(control: ArmControl, motion: Motion) -> Script:
    """Close on an object, and see by the fingers whether there is something between them."""
    name, params = named(motion), control.params
    control.may_touch = frozenset([name])
    yield from control.squeeze(1.0, params.grip_s)
    yield from control.wait(params.settle_s)
    if control.opening_m() < _LEAST_GAP_M:
        raise MotionFailed("grasped_nothing", f"the fingers closed to {1e3 * control.opening_m():.0f} mm")
    yield from look(control, name)
    pose = control.around.pose(name)
    assert pose is not None
    far = float(np.linalg.norm(pose[0] - control.position_xyz_m()))
    stance = stance_of_seen(control, name)
    if far > stance.radius_m + stance.height_m / 2:
        raise MotionFailed("grasped_nothing", f"{name} is seen {1e3 * far:.0f} mm from the grasp")
    control.held = hold_of(control, name)
    control.held_width_m = control.opening_m()
