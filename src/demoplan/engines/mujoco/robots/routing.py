"""Ways of an arm to where its hand is to come: straight ones first, else any path of its joints.

A straight way leads the upright hand over or around everything. Where an arm cannot follow it, for the limits
of its joints or for what is in the way, a path is looked for through configurations; there the hand may lean.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from demoplan.engines.mujoco.robots.checking import Checker, Held, Touch
from demoplan.engines.mujoco.robots.connecting import connect, shortened
from demoplan.engines.mujoco.robots.paths import Upright, Way, way_through, ways_over
from demoplan.engines.mujoco.robots.robot import Arm, Unreachable
from demoplan.geometry import Array

JOINT_M_PER_SPACING = 0.012
"""A change of joints by one spacing takes as long as this way of the hand."""


@dataclass(frozen=True, kw_only=True)
class Destination:
    """Where a hand is to come, and what it needs on its way there."""

    position_xyz_m: Array
    yaw_rad: float
    opening_m: float
    """How far the fingers are open."""
    speed_m_per_s: float
    radius_m: float = 0.0
    """Radius of the hand, or of what it carries."""
    below_m: float = 0.0
    """How far the hand, or what it carries, reaches below the grasp."""
    clearance_m: float = 0.0
    """Free height over things."""
    without: tuple[str, ...] = ()
    """Things that are not in the way."""
    then_xyz_m: tuple[Array, ...] = ()
    """Places that must be free and in reach after that, too."""
    configuration: Array | None = None
    """The arm's there ``(d,)``, if it shall be that one; asked of ways through joints only."""


@dataclass(frozen=True)
class Track:
    """Configurations ``(n, d)``, positions of the grasp ``(n, 3)``, length of the way up to each ``(n,)``."""

    configurations: Array
    position_xyz_m: Array
    lengths_m: Array


@dataclass(frozen=True)
class NoWay:
    """Why there is none: what would be touched, or why it cannot be reached."""

    touch: Touch | None = None
    why: str | None = None

    @property
    def is_hand(self) -> bool:
        """Whether a hand is in the way, which may move away again."""
        return self.touch is not None and self.touch.is_hand


@dataclass(frozen=True, kw_only=True)
class RouteParams:
    """How hard to look for paths through joints."""

    n_goals: int = 3
    """Configurations of the arm at the destination that are tried."""
    lifts_m: tuple[float, ...] = (0.08, 0.05, 0.025, 0.0)
    """How far the hand first goes straight up."""
    clearances_m: tuple[float, ...] = (0.010, 0.003)
    """Room about arm and load that is asked for, the widest first."""
    most_lean_rad: float = 1.0
    """How far a hand that carries something may lean."""
    smoothing: int = 7
    """Configurations over which corners are rounded."""


@dataclass(frozen=True)
class Start:
    """Where an arm is when it looks for a way."""

    configuration: Array
    position_xyz_m: Array
    yaw_rad: float
    held: Held | None
    step_s: float
    others: Sequence["Other"] = ()
    hidden: tuple[int, ...] = ()
    """Geoms that the robot does not know of."""


@dataclass(frozen=True)
class Other:
    """Another arm, and its next configurations, one per control step ``(n, d)``; at least one."""

    arm: Arm
    upcoming: Array

    def at(self, n: int, every: int) -> Array:
        """``n`` of them, ``every`` steps apart ``(n, d)``; then it stays."""
        return np.asarray(self.upcoming[np.minimum(every * np.arange(n), len(self.upcoming) - 1)])


class Router:
    """Finds ways for one arm."""

    def __init__(self, arm: Arm, checker: Checker, params: RouteParams = RouteParams()) -> None:
        """For an arm in the scene of a checker, which is to be arranged before each question."""
        self._arm, self._checker, self._params = arm, checker, params

    def straight(
        self, start: Start, corners_xyz_m: Iterable[Array], to: Destination, depth_m: float = 0.0015
    ) -> Track | NoWay:
        """The first of several ways that the arm can go, its hand upright, without touching anything.

        Args:
            start: Where the arm is.
            corners_xyz_m: Corners ``(m, 3)`` of each way.
            to: Where they end.
            depth_m: Depth of contacts that are put down to sensing.
        """
        end_yaw = start.yaw_rad + float((to.yaw_rad - start.yaw_rad + np.pi) % (2 * np.pi) - np.pi)
        touch: Touch | None = None
        why: str | None = None
        for corners in corners_xyz_m:
            way = way_through(corners, start.yaw_rad + _turning(len(corners)) * (end_yaw - start.yaw_rad))
            whole = way
            if to.then_xyz_m:
                more = way_through(
                    np.array([corners[-1], *to.then_xyz_m]), np.full(1 + len(to.then_xyz_m), end_yaw)
                )
                whole = Way(
                    np.concatenate([way.position_xyz_m, more.position_xyz_m[1:]]),
                    np.concatenate([way.yaw_rad, more.yaw_rad[1:]]),
                )
            try:
                found = self._arm.configurations(start.configuration, whole.position_xyz_m, whole.yaw_rad)
            except Unreachable as error:
                why = str(error)
                continue
            duration_s = 1.875 * float(whole.lengths_m[-1]) / to.speed_m_per_s
            touch = self._touch(start, found, to.opening_m, depth_m, every_s=duration_s / len(found))
            if touch is None:
                n = len(way.yaw_rad)
                return Track(found[:n], way.position_xyz_m, way.lengths_m)
        return NoWay(touch, why)

    def over(self, start: Start, to: Destination, things: Sequence[Upright]) -> Track | NoWay:
        """A straight way over, or around, what stands about."""
        return self.straight(
            start,
            ways_over(
                start.position_xyz_m,
                to.position_xyz_m,
                things,
                radius_m=to.radius_m,
                below_m=to.below_m,
                clearance_m=to.clearance_m,
                approach_m=0.0,
                highest_m=self._arm.highest_m,
            ),
            to,
        )

    def through_joints(self, start: Start, to: Destination, rng: np.random.Generator) -> Track | NoWay:
        """A path through configurations, found by chance; while another hand moves there is none."""
        for other in start.others:
            if np.ptp(other.upcoming, axis=0).max() > 1e-6:
                return NoWay(Touch(0, self._arm.hand, other.arm.hand, True))
        goals = list(self._goals(start, to, rng))
        if not goals:
            return NoWay(why="no configuration of the arm that is found there is free all the way down")
        lift = self._lift(start, to)
        space = self._arm.space
        for clearance_m in self._params.clearances_m:

            def count_free(line: Array, clearance_m: float = clearance_m) -> int:
                return self._count_free(start, line, to.opening_m, clearance_m)

            above = lift.configurations[-1]
            free = [goal for goal in goals if count_free(goal[None]) == 1]
            if not free or count_free(above[None]) == 0:
                continue
            corners = connect(above, free, space, count_free, rng)
            if corners is None:
                continue
            corners = shortened(corners, space, count_free, rng, n_shortcuts=60)
            path = _smoothed(space.dense(corners), self._params.smoothing)
            if count_free(path) < len(path):
                path = space.dense(corners)
            return self._joined(lift, path)
        return NoWay(why="no path through its joints was found")

    def _goals(self, start: Start, to: Destination, rng: np.random.Generator) -> Iterator[Array]:
        """Configurations at the destination from which the hand can go on to where it is to go then."""
        n = 0
        postures = (
            self._arm.postures(to.position_xyz_m, to.yaw_rad, rng)
            if to.configuration is None
            else iter([to.configuration])
        )
        for goal in postures:
            if to.then_xyz_m:
                more = way_through(
                    np.array([to.position_xyz_m, *to.then_xyz_m]), np.full(1 + len(to.then_xyz_m), to.yaw_rad)
                )
                try:
                    found = self._arm.configurations(goal, more.position_xyz_m, more.yaw_rad)
                except Unreachable:
                    continue
            else:
                found = goal[None]
            if self._touch(start, found, to.opening_m, 0.0015) is None:
                yield goal
                n += 1
                if n == self._params.n_goals:
                    return

    def _lift(self, start: Start, to: Destination) -> Track:
        """Straight up first, so that nothing is brushed aside; as far as the arm can."""
        for rise in self._params.lifts_m:
            if rise == 0.0:
                break
            end = start.position_xyz_m + np.array([0.0, 0.0, rise])
            found = self.straight(start, [np.array([start.position_xyz_m, end])], _upwards(start, to, end))
            if isinstance(found, Track):
                return found
        return Track(start.configuration[None], start.position_xyz_m[None], np.zeros(1))

    def _joined(self, lift: Track, path: Array) -> Track:
        """One track from two."""
        position, _ = self._checker.poses(self._arm, path)
        steps = np.maximum(
            np.linalg.norm(np.diff(position, axis=0), axis=1),
            JOINT_M_PER_SPACING * np.abs(np.diff(path, axis=0) / self._arm.space.spacing).max(axis=1),
        )
        return Track(
            np.concatenate([lift.configurations, path[1:]]),
            np.concatenate([lift.position_xyz_m, position[1:]]),
            np.concatenate([lift.lengths_m, lift.lengths_m[-1] + np.cumsum(steps)]),
        )

    def _count_free(self, start: Start, line: Array, opening_m: float, clearance_m: float) -> int:
        touch = self._touch(start, line, opening_m, 0.0, clearance_m=clearance_m)
        n = len(line) if touch is None else touch.at
        if start.held is not None and n:
            _, leans = self._checker.poses(self._arm, line[:n])
            too_far = leans > self._params.most_lean_rad
            n = int(np.argmax(too_far)) if too_far.any() else n
        return n

    def _touch(
        self,
        start: Start,
        found: Array,
        opening_m: float,
        depth_m: float,
        *,
        every_s: float = 0.0,
        clearance_m: float = 0.0,
    ) -> Touch | None:
        every = max(1, round(every_s / start.step_s)) if every_s else 0
        others = [(other.arm, other.at(len(found), every)) for other in start.others]
        return self._checker.first_touch(
            self._arm, found, opening_m, start.held, others, start.hidden, depth_m, clearance_m
        )


def _turning(n_corners: int) -> Array:
    """Share of the turn that is done at each corner: on the way across, not on the ways up and down."""
    if n_corners <= 2:
        return np.linspace(0.0, 1.0, n_corners)
    return np.concatenate([[0.0, 0.0], np.linspace(0.0, 1.0, n_corners - 2)[1:], [1.0]])


def _upwards(start: Start, to: Destination, end: Array) -> Destination:
    return Destination(
        position_xyz_m=end, yaw_rad=start.yaw_rad, opening_m=to.opening_m, speed_m_per_s=to.speed_m_per_s
    )


def _smoothed(path: Array, width: int) -> Array:
    """A path with rounded corners: a moving mean over ``width`` configurations, with the same ends."""
    if width < 2 or len(path) < 3:
        return path
    half = width // 2
    padded = np.concatenate([np.repeat(path[:1], half, axis=0), path, np.repeat(path[-1:], half, axis=0)])
    kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    rounded = np.column_stack([np.convolve(padded[:, k], kernel, mode="valid") for k in range(path.shape[1])])
    rounded[0], rounded[-1] = path[0], path[-1]
    return rounded
