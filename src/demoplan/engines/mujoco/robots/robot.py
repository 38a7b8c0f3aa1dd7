"""What a robot offers: bodies for a scene, and arms that are commanded by configurations.

Poses of a hand are those of the middle of its grasp: the fingers point along its -z and open along its y.
Hands grasp from above, so a pose is a position and a turn about the vertical.
"""

from collections.abc import Iterator
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.robots.connecting import Space
from demoplan.geometry import Array


class Unreachable(Exception):  # noqa: N818
    """No configuration brings the grasp to a pose; the text says why. An expected outcome, not an error."""


class Arm(Protocol):
    """One hand, and what carries it."""

    hand: str
    rest_xyz_m: Array
    """Where its grasp rests, ``(3,)``."""
    rest_yaw_rad: float
    widest_opening_m: float
    """Distance between the pads when the hand is fully open."""
    finger_reach_m: float
    """How far fingertips reach below the middle of the grasp."""
    palm_gap_m: float
    """Free height between the middle of the grasp and the palm."""
    hand_radius_m: float
    """Radius of the upright cylinder that holds the open hand."""
    highest_m: float
    """Height up to which it makes sense to pass over things."""
    rest_configuration: Array
    """The arm's configuration at rest ``(d,)``."""
    space: Space
    """Its configurations, and how densely paths are checked."""
    joint_addresses: NDArray[np.intp]
    """Where its configuration stands in ``qpos``."""
    speed_limits: Array
    """Fastest change of each element of its configuration ``(d,)``, per second."""
    geoms: frozenset[int]
    """All of hand and arm."""
    hand_geoms: frozenset[int]
    """Those of the hand: they may touch what it holds."""

    def configurations(self, start: Array, position_xyz_m: Array, yaw_rad: Array) -> Array:
        """Configurations ``(n, d)`` along a dense path of the grasp, beginning near ``start`` ``(d,)``.

        Args:
            start: Configuration at, or near, the first pose.
            position_xyz_m: Path of the grasp ``(n, 3)``; neighbours are a few centimetres apart.
            yaw_rad: Its turn at each point ``(n,)``.

        Raises:
            Unreachable: If a point has no configuration near the one before.
        """

    def postures(self, position_xyz_m: Array, yaw_rad: float, rng: np.random.Generator) -> Iterator[Array]:
        """Different configurations ``(d,)`` that bring the upright grasp to a pose, as far as there are."""

    def room_m(self, position_xy_m: Array) -> float:
        """How far inside its reach a place on the table is, roughly; negative outside [m]."""

    def reachable(self, position_xyz_m: Array) -> str | None:
        """Why the upright grasp cannot come to a position, however turned; None if it can.

        It speaks of the arm alone: what stands about may still be in the way.
        """

    def command(self, data: mujoco.MjData, configuration: Array, closure: float) -> None:
        """Drive towards a configuration ``(d,)``, and the fingers to a closure: 0 open, 1 closed."""

    def commanded(self) -> Array:
        """The configuration that was commanded last."""

    def opening_m(self, data: mujoco.MjData) -> float:
        """How far the pads are apart, as the joints tell [m]."""

    def pose(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Middle of the grasp: position ``(3,)`` and orientation ``(4,)``."""

    def set_pads_friction(self, model: mujoco.MjModel, friction: float | None) -> None:
        """Change the sliding friction of its pads; None restores it."""


class Robot(Protocol):
    """Bodies in a scene, with one or more arms."""

    name: str
    hands: tuple[str, ...]
    timestep_s: float

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Attach the robot to a scene."""

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData, step_s: float) -> dict[str, Arm]:
        """Its arms in the compiled scene, which get a command every ``step_s``; ``data`` is set to rest."""


def lead_steps(model: mujoco.MjModel, actuators: NDArray[np.intp], step_s: float) -> Array:
    """By how many control steps each position actuator's command has to run ahead ``(d,)``.

    A position actuator damps the joint's speed, not its deviation from the speed that is wanted: it trails by
    its damping over its stiffness. Running ahead by that time makes up for it.
    """
    stiffness = -model.actuator_biasprm[actuators, 1]
    damping = -model.actuator_biasprm[actuators, 2]
    return np.asarray(damping / stiffness / step_s)
