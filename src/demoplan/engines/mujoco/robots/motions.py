"""The skills: reach, grasp, carry, release, rest. Each is a script that any arm can carry out.

Skills look at the scene through its sensors and at the hand through its encoders; what becomes of things is
left to physics. A skill that cannot do its work says so.
"""

from collections.abc import Callable, Generator
from itertools import product

import numpy as np

from demoplan.engines.mujoco.robots.arm_control import ArmControl, MotionFailed, Script
from demoplan.engines.mujoco.robots.checking import Held
from demoplan.engines.mujoco.robots.grasps import STEEPEST_TILT_RAD, Grasp, Stance, grasps_of, yaws_on
from demoplan.engines.mujoco.robots.routing import Destination
from demoplan.engines.mujoco.session import Motion
from demoplan.errors import UsageError
from demoplan.geometry import Array, compose, inverted, multiply, rotate

_LOOK_S = 0.5
"""How long to wait for something to be seen [s]."""
_MOVED_M = 0.006
"""What lies this far from where it was seen before has been moved."""
_GRIP_CHANGE_M = 0.008
"""A change of the pads' distance by more than this tells that what was held is lost."""
_LEAST_GAP_M = 0.006
"""Pads that are closer than this hold nothing."""


def _about_z(yaw_rad: float) -> Array:
    return np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])


def _named(motion: Motion) -> str:
    if motion.object is None:
        raise UsageError(f"activity {motion.activity!r}: skill {motion.skill!r} needs an object")
    return motion.object


def _look(control: ArmControl, name: str) -> Script:
    """Wait until an object is seen."""
    waited_s = 0.0
    while control.around.stance(name) is None:
        if waited_s >= _LOOK_S:
            raise MotionFailed("not_seen", f"{name} has not been seen for {waited_s:.1f} s")
        waited_s += control.around.step_s
        yield


def _stance(control: ArmControl, name: str) -> Stance:
    stance = control.around.stance(name)
    if stance is None:
        raise MotionFailed("not_seen", f"{name} is not seen")
    return stance


def reach(control: ArmControl, motion: Motion) -> Script:
    """Bring the open hand about an object, from above."""
    name, arm, params = _named(motion), control.arm, control.params
    if control.held is not None:
        raise MotionFailed("still_holding", f"{arm.hand} still holds {control.held.object}", is_blocked=True)
    control.may_touch = frozenset()
    yield from _look(control, name)
    for _ in range(3):
        grasp = yield from _approach(control, name)
        # Seen again from close by: does it still lie where the hand is going to come down?
        yield from control.wait(params.settle_s)
        yield from _look(control, name)
        stance = _stance(control, name)
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
    grasps = _grasps(control, _stance(control, name))
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
    name, params = _named(motion), control.params
    control.may_touch = frozenset([name])
    yield from control.squeeze(1.0, params.grip_s)
    yield from control.wait(params.settle_s)
    if control.opening_m() < _LEAST_GAP_M:
        raise MotionFailed("grasped_nothing", f"the fingers closed to {1e3 * control.opening_m():.0f} mm")
    yield from _look(control, name)
    pose = control.around.pose(name)
    assert pose is not None
    far = float(np.linalg.norm(pose[0] - control.position_xyz_m()))
    stance = _stance(control, name)
    if far > stance.radius_m + stance.height_m / 2:
        raise MotionFailed("grasped_nothing", f"{name} is seen {1e3 * far:.0f} mm from the grasp")
    control.held = _held(control, name)
    control.held_width_m = control.opening_m()


def _held(control: ArmControl, name: str) -> Held:
    """How an object lies in the hand, by sensors and encoders."""
    pose = control.around.pose(name)
    assert pose is not None
    position, orientation = control.arm.pose(control.around.data)
    back = inverted(position, orientation)
    return Held(name, *compose(*back, *pose))


def _has_hold(control: ArmControl) -> bool:
    """Whether the pads are still as far apart as what they closed on."""
    return abs(control.opening_m() - control.held_width_m) <= _GRIP_CHANGE_M


def _require_hold(control: ArmControl, name: str) -> None:
    if not _has_hold(control):
        control.held = None
        raise MotionFailed(
            "object_lost",
            f"{name} is no longer between the fingers: they went from {1e3 * control.held_width_m:.0f} "
            f"to {1e3 * control.opening_m():.0f} mm",
        )


def carry(control: ArmControl, motion: Motion) -> Script:
    """Lift what is in the hand, carry it over everything, and lower it on its support."""
    name, params = _named(motion), control.params
    if control.held is None or control.held.object != name:
        raise MotionFailed("not_holding", f"{control.arm.hand} does not hold {name}", is_blocked=True)
    _require_hold(control, name)
    support = motion.support or "table"
    control.may_touch = frozenset([name, support])
    seen = [name] if control.around.is_surface(support) else [name, support]
    for each in seen:
        yield from _look(control, each)
    lift_from = _beneath(control, name)
    control.may_touch |= frozenset(lift_from)
    offset = control.placing_offset.pop(0) if control.placing_offset else np.zeros(3)
    aim = yield from _carry_above(control, motion, name, support, offset)
    # Seen again at rest: how does it lie in the hand now, and where is the support?
    yield from control.wait(params.settle_s)
    _require_hold(control, name)
    for each in seen:
        yield from _look(control, each)
    control.held = _held(control, name)
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
            _require_hold(control, name)
            yield


def _beneath(control: ArmControl, name: str) -> list[str]:
    """What an object seems to rest on, or touch, where it is lifted from."""
    own = _stance(control, name)
    bottom = own.top_m - own.height_m
    near = [
        thing.name
        for thing in control.around.things((name,))
        if abs(thing.top_m - bottom) < 0.01
        and np.hypot(thing.x_m - own.position_xyz_m[0], thing.y_m - own.position_xyz_m[1])
        < thing.radius_m + own.radius_m
    ]
    return [*near, "table"]


def _carry_above(
    control: ArmControl, motion: Motion, name: str, support: str, offset: Array
) -> Generator[None, None, Callable[[bool], tuple[Array, float]]]:
    """Go above the place; gives a function that says anew where hand and object are to come to."""
    params = control.params
    held = control.held
    assert held is not None
    own = _stance(control, name)
    spots: list[Array | None] = [None]
    if motion.position_xyz_m is None and control.around.is_surface(support):
        spots = list(control.around.free_spots(name, own.radius_m + control.arm.hand_radius_m))
        if not spots:
            raise MotionFailed("path_blocked", f"no free spot on {support} for {name}", is_blocked=True)
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
            _require_hold(control, name)
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
    own = _stance(control, name)
    hand_turn = control.arm.pose(control.around.data)[1]
    if motion.position_xyz_m is not None:
        middle = np.array(motion.position_xyz_m)
    elif spot is not None:
        middle = np.array([spot[0], spot[1], own.height_m / 2])
    else:
        on = _stance(control, support)
        middle = on.position_xyz_m + np.array([0.0, 0.0, on.height_m / 2 + own.height_m / 2])
        if turn is None:
            turn = yaws_on(own, on)[0]
    turned = multiply(_about_z(turn or 0.0), hand_turn)
    goal = middle - rotate(turned, held.position_xyz_m) + offset
    w, x, y, z = turned
    return goal, float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


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


def lift(control: ArmControl, motion: Motion) -> Script:
    """Lift what is in the hand straight up, and keep it there."""
    name, params = _named(motion), control.params
    if control.held is None or control.held.object != name:
        raise MotionFailed("not_holding", f"{control.arm.hand} does not hold {name}", is_blocked=True)
    _require_hold(control, name)
    yield from _look(control, name)
    control.may_touch = frozenset([name, *_beneath(control, name)])
    goal = control.start_xyz_m() + np.array([0.0, 0.0, params.approach_m])
    yield from control.go_straight(
        Destination(
            position_xyz_m=goal,
            yaw_rad=control.yaw_rad(),
            opening_m=control.opening_m(),
            speed_m_per_s=params.near_speed_m_per_s,
        )
    )
    _require_hold(control, name)


def release(control: ArmControl, motion: Motion) -> Script:
    """Open, and go straight up."""
    name, arm, params = motion.object, control.arm, control.params
    if name is not None:
        control.may_touch = frozenset([name])
    width = control.opening_m()
    opening = min(arm.widest_opening_m, max(width + 0.03, 0.75 * arm.widest_opening_m))
    control.held = None
    yield from control.squeeze(1.0 - opening / arm.widest_opening_m, params.grip_s)
    yield from control.wait(0.5 * params.settle_s)
    if control.opening_m() < opening - 0.010:
        raise MotionFailed(
            "off_course", f"the fingers opened to {1e3 * control.opening_m():.0f} of {1e3 * opening:.0f} mm"
        )
    start = control.start_xyz_m()
    failure: MotionFailed | None = None
    for rise in params.retreat_m * np.array([1.0, 0.6, 0.35, 0.2]):
        up = Destination(
            position_xyz_m=start + np.array([0.0, 0.0, rise]),
            yaw_rad=control.yaw_rad(),
            opening_m=opening,
            speed_m_per_s=2.0 * params.near_speed_m_per_s,
        )
        script = control.go_straight(up, depth_m=0.006)
        try:
            next(script)
        except StopIteration:
            return
        except MotionFailed as problem:
            failure = failure or problem
            continue
        yield
        yield from script
        return
    assert failure is not None
    raise failure


def rest(control: ArmControl, motion: Motion) -> Script:
    """Go to the rest pose, over everything, with whatever is in the hand."""
    arm, params = control.arm, control.params
    control.may_touch = frozenset() if control.held is None else frozenset([control.held.object])
    if np.linalg.norm(control.start_xyz_m() - arm.rest_xyz_m) < 0.002:
        yield from control.wait(params.settle_s)
        return
    home = Destination(
        position_xyz_m=arm.rest_xyz_m,
        yaw_rad=arm.rest_yaw_rad,
        opening_m=control.opening_m(),
        speed_m_per_s=params.speed_m_per_s,
        radius_m=arm.hand_radius_m,
        below_m=arm.finger_reach_m if control.held is None else 0.06,
        clearance_m=params.clearance_m,
        without=() if control.held is None else (control.held.object,),
    )
    yield from control.go_home(home)
    yield from control.wait(params.settle_s)


SKILLS: dict[str, Callable[[ArmControl, Motion], Script]] = {
    "reach": reach,
    "grasp": grasp,
    "carry": carry,
    "lift": lift,
    "release": release,
    "rest": rest,
}
"""What a skills table can name."""
