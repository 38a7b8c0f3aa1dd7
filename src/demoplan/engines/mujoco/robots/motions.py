"""The skills by name: reach, grasp, carry, lift, release, rest. Each is a script that any arm can carry out.

Skills look at the scene through its sensors and at the hand through its encoders; what becomes of things is
left to physics. A skill that cannot do its work says so.
"""

from collections.abc import Callable

import numpy as np

from demoplan.engines.mujoco.robots.arm_control import ArmControl, MotionFailed, Script
from demoplan.engines.mujoco.robots.handling import beneath, look, named, require_hold
from demoplan.engines.mujoco.robots.placing import carry
from demoplan.engines.mujoco.robots.routing import Destination
from demoplan.engines.mujoco.robots.taking import grasp, reach
from demoplan.engines.mujoco.session import Motion


def lift(control: ArmControl, motion: Motion) -> Script:
    """Lift what is in the hand straight up, and keep it there."""
    name, params = named(motion), control.params
    if control.held is None or control.held.object != name:
        raise MotionFailed("not_holding", f"{control.arm.hand} does not hold {name}", is_blocked=True)
    require_hold(control, name)
    yield from look(control, name)
    control.may_touch = frozenset([name, *beneath(control, name)])
    goal = control.start_xyz_m() + np.array([0.0, 0.0, params.approach_m])
    yield from control.go_straight(
        Destination(
            position_xyz_m=goal,
            yaw_rad=control.yaw_rad(),
            opening_m=control.opening_m(),
            speed_m_per_s=params.near_speed_m_per_s,
        )
    )
    require_hold(control, name)


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
