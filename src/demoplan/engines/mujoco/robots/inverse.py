"""Inverse kinematics of one arm along a path: mink's differential IK, from each point to the next.

The arm has seven joints and the grasp six degrees of freedom; what is left keeps the posture near a
comfortable one. Between points that are solved, configurations follow a cubic spline.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import daqp  # type: ignore[import-not-found, unused-ignore]  # noqa: F401 - the solver that mink is told to use
import mink
import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from demoplan.engines.mujoco.robots.robot import Unreachable
from demoplan.geometry import Array

_SOLVER = "daqp"


@dataclass(frozen=True, kw_only=True)
class InverseParams:
    """How exactly, and how densely, a path is solved."""

    spacing_m: float = 0.05
    """Longest way between two points that are solved [m]."""
    position_tolerance_m: float = 0.0005
    orientation_tolerance_rad: float = 0.005
    n_iterations: int = 12
    """Most steps of differential IK from one point to the next."""
    n_iterations_afar: int = 25
    """Most of them from a configuration that may be far off."""
    posture_cost: float = 0.02
    n_starts: int = 12
    """Random starts where there is no configuration to begin from."""
    widest_step_rad: float = 0.9
    """A joint that turns by more between two neighbouring points has jumped."""


class Inverse:
    """Configurations of one arm for poses of its grasp."""

    def __init__(
        self, model: mujoco.MjModel, site: str, posture: Array, params: InverseParams = InverseParams()
    ) -> None:
        """Of an arm alone.

        Args:
            model: The robot with no joints but this arm's.
            site: Site in the middle of the grasp, which opens along its y axis and points along its -z.
            posture: Comfortable configuration ``(d,)``.
            params: How exactly.
        """
        self._params = params
        self._configuration = mink.Configuration(model)
        self._task = mink.FrameTask(site, "site", position_cost=10.0, orientation_cost=2.0, lm_damping=1e-4)
        self._posture = mink.PostureTask(model, cost=params.posture_cost)
        self._posture.set_target(posture)
        self._limits = [mink.ConfigurationLimit(model)]
        self._low, self._high = np.array(model.jnt_range).T
        self.posture = posture

    def pose(self, configuration: Array) -> tuple[Array, float]:
        """Position ``(3,)`` and yaw [rad] of the grasp in a configuration ``(d,)``."""
        self._configuration.update(configuration)
        frame = self._configuration.get_transform_frame_to_world(self._task.frame_name, "site")
        turn = frame.rotation().as_matrix()
        return np.array(frame.translation()), float(np.arctan2(turn[1, 0], turn[0, 0]))

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest configuration, ``(d,)`` each."""
        return self._low, self._high

    def solve(
        self, start: Array, position_xyz_m: Array, yaw_rad: float, n_iterations: int | None = None
    ) -> Array | None:
        """The configuration ``(d,)`` for one pose, found from ``start``; None if there is none near it."""
        p = self._params
        turn = mink.SO3(np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)]))
        self._task.set_target(mink.SE3.from_rotation_and_translation(turn, position_xyz_m))
        self._configuration.update(start)
        for _ in range(n_iterations or p.n_iterations):
            error = self._task.compute_error(self._configuration)
            if (
                np.sqrt(error[:3] @ error[:3]) <= p.position_tolerance_m
                and np.sqrt(error[3:] @ error[3:]) <= p.orientation_tolerance_rad
            ):
                return np.array(self._configuration.q)
            velocity = mink.solve_ik(
                self._configuration,
                [self._task, self._posture],
                1.0,
                _SOLVER,
                damping=1e-6,
                limits=self._limits,
            )
            largest = float(np.abs(velocity).max())
            if not np.isfinite(largest):
                return None
            self._configuration.integrate_inplace(velocity * min(1.0, 0.5 / max(largest, 1e-9)), 1.0)
        return None

    def along(self, start: Array, position_xyz_m: Array, yaw_rad: Array) -> Array:
        """Configurations ``(n, d)`` along a dense path.

        Raises:
            Unreachable: If a point cannot be reached from the one before.
        """
        p = self._params
        steps = np.maximum(
            np.linalg.norm(np.diff(position_xyz_m, axis=0), axis=1), 0.12 * np.abs(np.diff(yaw_rad))
        )
        at = np.concatenate([[0.0], np.cumsum(steps)])
        n = max(2, int(np.ceil(at[-1] / p.spacing_m)) + 1)
        rows = np.unique(np.searchsorted(at, np.linspace(0.0, at[-1], n) - 1e-9).clip(0, len(at) - 1))
        solved = []
        before = start
        for row in rows:
            found = self.solve(before, position_xyz_m[row], float(yaw_rad[row]))
            if found is None or np.abs(found - before).max() > p.widest_step_rad:
                x, y, z = position_xyz_m[row]
                raise Unreachable(
                    f"the arm cannot hold its hand upright at ({x:.2f}, {y:.2f}, {z:.2f}) m, "
                    f"turned by {np.degrees(yaw_rad[row]):.0f}°"
                )
            solved.append(found)
            before = found
        if len(rows) == 1:
            return np.repeat(np.array(solved), len(at), axis=0)
        spline = CubicSpline(at[rows], np.array(solved), axis=0)
        return np.asarray(np.clip(spline(at), self._low, self._high))

    def postures(
        self, position_xyz_m: Array, yaw_rad: float, rng: np.random.Generator, near: Array
    ) -> Iterator[Array]:
        """Different configurations ``(d,)`` for a pose: from a near one, the comfortable one, random ones."""
        known: list[Array] = []
        starts = rng.uniform(self._low, self._high, (self._params.n_starts, len(self._low)))
        for start in (near, self.posture, *starts):
            found = self.solve(start, position_xyz_m, yaw_rad, self._params.n_iterations_afar)
            if found is not None and all(np.abs(found - each).max() > 0.2 for each in known):
                known.append(found)
                yield found
