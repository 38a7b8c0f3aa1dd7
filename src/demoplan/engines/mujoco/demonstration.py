"""What a demonstration leaves: poses of cubes and hands, triggers and intentions, tick by tick."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.tasks import Task
from demoplan.geometry import Array


class Phase(IntEnum):
    """What a participant is about to do with one hand; the commands of a phase begin with the phase."""

    REST = 0
    APPROACH = 1
    GRASP = 2
    CARRY = 3
    LET_GO = 4
    RETREAT = 5


@dataclass(frozen=True, kw_only=True)
class DemonstrationParams:
    """How a demonstration is run."""

    control_step_s: float = 0.004
    """Time between two commands, a multiple of the physics step [s]."""
    most_attempts: int = 4
    """How often a participant tries one step before giving up."""
    longest_s: float = 120.0
    """A demonstration that takes longer is ended [s]."""
    lost_distance_m: float = 0.035
    """A cube that far from the grasp point is not in the hand [m]."""
    touch_depth_m: float = 0.0015
    """How far below contact the hand aims when it sets a cube down [m]."""


@dataclass(frozen=True)
class HandArrays:
    """One hand, one row per tick."""

    position_xyz_m: Array
    """Middle of the grasp, ``(n, 3)``: the point that OpenXR calls the grip pose's origin."""
    orientation_wxyz: Array
    """``(n, 4)``"""
    trigger: Array
    """What the person's finger does: 0 let go, 1 pulled; ``(n,)``."""
    speed_m_per_s: Array
    """Speed of the intended movement, without tremor; ``(n,)``."""
    phase: NDArray[np.int64]
    step: NDArray[np.int64]
    """Index of the task's step, −1 where there is none."""
    is_held: NDArray[np.bool_]
    """The step's cube is in the hand, as physics has it."""


@dataclass(frozen=True)
class Demonstration:
    """What really happened, on the control clock."""

    task: Task
    cubes: tuple[str, ...]
    time_s: Array
    """``(n,)``, from 0, evenly spaced."""
    cube_position_xyz_m: Array
    """``(n, k, 3)``"""
    cube_orientation_wxyz: Array
    """``(n, k, 4)``"""
    hands: dict[str, HandArrays]
    is_goal_reached: bool
    n_misses: int
    """Grasps that closed on nothing, or lost the cube."""
    physics: dict[str, str]
    """Contact options and sizes, for the record."""
