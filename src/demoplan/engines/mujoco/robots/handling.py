"""What every skill does: look at things, and keep track of what is in the hand."""

import numpy as np

from demoplan.engines.mujoco.robots.arm_control import ArmControl, MotionFailed, Script
from demoplan.engines.mujoco.robots.checking import Held
from demoplan.engines.mujoco.robots.grasps import Stance
from demoplan.engines.mujoco.session import Motion
from demoplan.errors import UsageError
from demoplan.geometry import compose, inverted

_LOOK_S = 0.5
"""How long to wait for something to be seen [s]."""
_GRIP_CHANGE_M = 0.008
"""A change of the pads' distance by more than this tells that what was held is lost."""


def named(motion: Motion) -> str:
    """The object of a motion.

    Raises:
        UsageError: If it has none.
    """
    if motion.object is None:
        raise UsageError(f"activity {motion.activity!r}: skill {motion.skill!r} needs an object")
    return motion.object


def look(control: ArmControl, name: str) -> Script:
    """Wait until an object is seen."""
    waited_s = 0.0
    while control.around.stance(name) is None:
        if waited_s >= _LOOK_S:
            raise MotionFailed("not_seen", f"{name} has not been seen for {waited_s:.1f} s")
        waited_s += control.around.step_s
        yield


def stance_of_seen(control: ArmControl, name: str) -> Stance:
    """How an object stands that is seen now.

    Raises:
        MotionFailed: If it is not seen.
    """
    stance = control.around.stance(name)
    if stance is None:
        raise MotionFailed("not_seen", f"{name} is not seen")
    return stance


def hold_of(control: ArmControl, name: str) -> Held:
    """How an object lies in the hand, by sensors and encoders."""
    pose = control.around.pose(name)
    assert pose is not None
    position, orientation = control.arm.pose(control.around.data)
    back = inverted(position, orientation)
    return Held(name, *compose(*back, *pose))


def has_hold(control: ArmControl) -> bool:
    """Whether the pads are still as far apart as what they closed on."""
    return abs(control.opening_m() - control.held_width_m) <= _GRIP_CHANGE_M


def require_hold(control: ArmControl, name: str) -> None:
    """Notice that what is held is lost.

    Raises:
        MotionFailed: If it is.
    """
    if not has_hold(control):
        control.held = None
        raise MotionFailed(
            "object_lost",
            f"{name} is no longer between the fingers: they went from {1e3 * control.held_width_m:.0f} "
            f"to {1e3 * control.opening_m():.0f} mm",
        )


def beneath(control: ArmControl, name: str) -> list[str]:
    """What an object seems to rest on, or touch, where it is lifted from."""
    own = stance_of_seen(control, name)
    bottom = own.top_m - own.height_m
    near = [
        thing.name
        for thing in control.around.things((name,))
        if abs(thing.top_m - bottom) < 0.01
        and np.hypot(thing.x_m - own.position_xyz_m[0], thing.y_m - own.position_xyz_m[1])
        < thing.radius_m + own.radius_m
    ]
    return [*near, "table"]
