"""One hand at work: its motion, command by command, and what it measures meanwhile."""

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import mujoco
import numpy as np

from demoplan.engines.mujoco.robots.checking import Checker, Held, Touch
from demoplan.engines.mujoco.robots.grasps import Stance
from demoplan.engines.mujoco.robots.paths import Upright, Way, progress, way_through, ways_over
from demoplan.engines.mujoco.robots.robot import Arm, Unreachable
from demoplan.engines.mujoco.session import Motion, MotionProblem, MotionReport, MotionState, SkillParams
from demoplan.geometry import Array

Script: TypeAlias = Generator[None, None, None]
"""What a hand does; it is resumed once per control step."""


class MotionFailed(Exception):  # noqa: N818
    """A motion cannot go on. An expected outcome: it ends in a report."""

    def __init__(self, problem: MotionProblem, reason: str, *, is_blocked: bool = False) -> None:
        """Keep what went wrong, and whether it did before the hand moved."""
        super().__init__(reason)
        self.problem: MotionProblem = problem
        self.reason = reason
        self.is_blocked = is_blocked


class Surroundings(Protocol):
    """What a hand knows of the scene: by sensors, never by physics."""

    step_s: float
    checker: Checker
    model: mujoco.MjModel
    data: mujoco.MjData

    @property
    def time_ns(self) -> int:
        """Now."""

    def stance(self, name: str) -> Stance | None:
        """How an object seems to stand; None where it is not seen."""

    def pose(self, name: str) -> tuple[Array, Array] | None:
        """Where an object seems to be."""

    def things(self, without: Iterable[str]) -> list[Upright]:
        """What seems to stand about, obstacles included."""

    def arrange(self) -> None:
        """Put the checker's copy in the state that is believed."""

    def others_of(self, hand: str) -> "list[ArmControl]":
        """The other hands."""

    def hidden_geoms(self) -> tuple[int, ...]:
        """Obstacles that the robot does not know of."""

    def is_surface(self, name: str) -> bool:
        """Whether it is the table, rather than an object."""

    def free_spots(self, name: str, room_m: float) -> Iterable[Array]:
        """Places on the table for an object, ``(2,)``, the nearest first."""


@dataclass
class _Measured:
    tracking_error_m: float = 0.0
    peak_force_n: float = 0.0
    n_collisions: int = 0


class ArmControl:
    """One hand of a session."""

    def __init__(self, arm: Arm, around: Surroundings, params: SkillParams) -> None:
        """At rest, open."""
        self.arm = arm
        self.around = around
        self.defaults = params
        self.params = params
        self.closure = 0.0
        self.held: Held | None = None
        self.held_width_m = 0.0
        """How far the pads were apart when they had closed on what is held."""
        self.placing_offset: list[Array] = []
        """Faults still to come: each is added to the aim of one placing."""
        self.may_touch: frozenset[str] = frozenset()
        """Objects that hand or carried object may touch now; any other contact is a collision."""
        self._ahead = np.zeros((0, len(arm.commanded())))
        self._at = 0
        self._aim_xyz_m = np.array(arm.rest_xyz_m)
        self._script: Script | None = None
        self._report: MotionReport | None = None
        self._measured = _Measured()

    # What is asked of it -----------------------------------------------------------------------------

    @property
    def is_moving(self) -> bool:
        """Whether a motion runs."""
        return self._script is not None

    def start(self, motion: Motion, script: Script, params: SkillParams) -> MotionReport:
        """Begin a motion; what is planned before moving is planned at once."""
        self.params = params
        self._measured = _Measured()
        self._report = MotionReport(
            motion=motion,
            state="running",
            problem=None,
            reason=None,
            tracking_error_m=0.0,
            peak_force_n=0.0,
            n_collisions=0,
            started_ns=self.around.time_ns,
            ended_ns=None,
        )
        self._script = script
        self._resume()
        assert self._report is not None
        return self._report

    def report(self) -> MotionReport | None:
        """How the latest motion goes."""
        if self._report is None or self._report.ended_ns is not None:
            return self._report
        return self._with_measures("running", None, None, None)

    def cancel(self) -> None:
        """Stop where the hand is."""
        if self._script is not None:
            self._script.close()
            self._end("cancelled", None, "cancelled")
            self.hold_still()

    def hold_still(self) -> None:
        """Command the place where the hand has been commanded to be last."""
        self._ahead = self._ahead[:0]

    def tick(self) -> None:
        """Command the next control step."""
        if self._script is not None:
            assert self._report is not None
            if self.around.time_ns - self._report.started_ns > 1e9 * self.params.timeout_s:
                self._script.close()
                self._end("failed", "timeout", f"not done within {self.params.timeout_s:g} s")
                self.hold_still()
            else:
                self._resume()
        self.arm.command(self.around.data, self._configuration(), self.closure)

    def _configuration(self) -> Array:
        return self._ahead[self._at] if self._at < len(self._ahead) else self.arm.commanded()

    def _resume(self) -> None:
        assert self._script is not None
        try:
            next(self._script)
        except StopIteration:
            self._end("succeeded", None, None)
        except MotionFailed as failure:
            self._end("blocked" if failure.is_blocked else "failed", failure.problem, failure.reason)
            self.hold_still()

    def _end(self, state: MotionState, problem: MotionProblem | None, reason: str | None) -> None:
        self._script = None
        self._report = self._with_measures(state, problem, reason, self.around.time_ns)

    def _with_measures(
        self, state: MotionState, problem: MotionProblem | None, reason: str | None, ended_ns: int | None
    ) -> MotionReport:
        assert self._report is not None
        return replace(
            self._report,
            state=state,
            problem=problem,
            reason=reason,
            tracking_error_m=self._measured.tracking_error_m,
            peak_force_n=self._measured.peak_force_n,
            n_collisions=self._measured.n_collisions,
            ended_ns=ended_ns,
        )

    # What it measures --------------------------------------------------------------------------------

    def measure(self, position_xyz_m: Array, force_n: float, n_new_collisions: int) -> None:
        """Take in what the last control step brought."""
        if self._script is not None:
            gap = position_xyz_m - self._aim_xyz_m
            error = float(np.sqrt(gap @ gap))
            self._measured.tracking_error_m = max(self._measured.tracking_error_m, error)
            self._measured.peak_force_n = max(self._measured.peak_force_n, force_n)
            self._measured.n_collisions += n_new_collisions

    def position_xyz_m(self) -> Array:
        """Middle of the grasp, by the joints' encoders ``(3,)``."""
        return self.arm.pose(self.around.data)[0]

    def yaw_rad(self) -> float:
        """How the hand is turned, by the joints' encoders [rad]."""
        w, x, y, z = self.arm.pose(self.around.data)[1]
        return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))

    def opening_m(self) -> float:
        """How far the pads are apart, by the joint's encoder [m]."""
        return self.arm.opening_m(self.around.data)

    def upcoming(self, n: int, every: int) -> Array:
        """Its next ``n`` configurations, ``every`` control steps apart, ``(n, d)``."""
        last = self._ahead[-1] if len(self._ahead) else self.arm.commanded()
        if self._at >= len(self._ahead):
            return np.broadcast_to(last, (n, len(last)))
        rows = np.minimum(self._at + every * np.arange(n), len(self._ahead) - 1)
        return self._ahead[rows]

    # What motions are made of ------------------------------------------------------------------------

    def wait(self, duration_s: float) -> Script:
        """Stay where the hand is."""
        for _ in range(round(duration_s / self.around.step_s)):
            yield

    def squeeze(self, closure: float, duration_s: float) -> Script:
        """Open or close the fingers."""
        begin, n = self.closure, max(1, round(duration_s / self.around.step_s))
        for step in range(1, n + 1):
            self.closure = begin + (closure - begin) * step / n
            yield

    def follow(
        self, way: Way, configurations: Array, speed_m_per_s: float, stop: Callable[[], bool] | None = None
    ) -> Script:
        """Go along a way that has been found free.

        Args:
            way: Poses of the grasp.
            configurations: The arm's, for each of them.
            speed_m_per_s: Peak speed.
            stop: Ends the way early when it says so.

        Raises:
            MotionFailed: If the hand is pushed off its way.
        """
        lengths = way.lengths_m
        if lengths[-1] < 1e-6:
            return
        done = progress(float(lengths[-1]), speed_m_per_s, self.around.step_s)
        self._ahead = _columns(done, lengths, configurations)
        rates = np.abs(np.diff(self._ahead, axis=0, prepend=configurations[:1])) / self.around.step_s
        excess = float((rates.max(axis=0) / self.arm.speed_limits).max())
        if excess > 1.0:
            done = progress(float(lengths[-1]), speed_m_per_s, self.around.step_s, excess)
            self._ahead = _columns(done, lengths, configurations)
        aims = _columns(done, lengths, way.position_xyz_m)
        limit = self.params.off_course_m**2
        for at in range(len(done)):
            self._at = at
            self._aim_xyz_m = aims[at]
            yield
            gap = self.position_xyz_m() - aims[at]
            if gap @ gap > limit:
                raise MotionFailed(
                    "off_course", f"pushed {1e3 * np.sqrt(gap @ gap):.0f} mm off its way: something is in it"
                )
            if stop is not None and stop():
                break
        self.hold_still()

    def find_way(
        self,
        corners_xyz_m: Iterable[Array],
        yaw_rad: float,
        opening_m: float,
        *,
        speed_m_per_s: float,
        depth_m: float = 0.0015,
        tail_xyz_m: Sequence[Array] = (),
    ) -> tuple[Way, Array, Touch | None, str | None]:
        """The first of several ways that the arm can go without touching anything.

        Args:
            corners_xyz_m: Corners of each way.
            yaw_rad: How the hand is to be turned in the end.
            opening_m: How far it is open.
            speed_m_per_s: Peak speed, for where other hands will be meanwhile.
            depth_m: Depth of contacts that are put down to sensing.
            tail_xyz_m: Places that must be free and in reach after the way's end, too.

        Returns:
            Way and configurations, and if there is none, what was touched or why it cannot be reached.
        """
        self.around.arrange()
        start_yaw = self.yaw_now()
        end_yaw = start_yaw + float((yaw_rad - start_yaw + np.pi) % (2 * np.pi) - np.pi)
        touch: Touch | None = None
        why: str | None = None
        empty = Way(np.zeros((0, 3)), np.zeros(0))
        for corners in corners_xyz_m:
            n = len(corners)
            share = (
                np.linspace(0.0, 1.0, n)
                if n <= 2
                else np.concatenate([[0, 0], np.linspace(0, 1, n - 2)[1:], [1]])
            )
            way = way_through(corners, start_yaw + share * (end_yaw - start_yaw))
            whole = way
            if len(tail_xyz_m):
                more = way_through(
                    np.array([corners[-1], *tail_xyz_m]), np.full(1 + len(tail_xyz_m), end_yaw)
                )
                whole = Way(
                    np.concatenate([way.position_xyz_m, more.position_xyz_m[1:]]),
                    np.concatenate([way.yaw_rad, more.yaw_rad[1:]]),
                )
            try:
                configurations = self.arm.configurations(
                    self.arm.commanded(), whole.position_xyz_m, whole.yaw_rad
                )
            except Unreachable as error:
                why = str(error)
                continue
            others = [
                (other.arm, other.upcoming(len(configurations), self._spacing(whole, speed_m_per_s)))
                for other in self.around.others_of(self.arm.hand)
            ]
            touch = self.around.checker.first_touch(
                self.arm,
                configurations,
                opening_m,
                self.held,
                others,
                self.around.hidden_geoms(),
                depth_m,
            )
            if touch is None:
                n_way = len(way.position_xyz_m)
                return way, configurations[:n_way], None, None
        return empty, np.zeros((0, 0)), touch, why

    def yaw_now(self) -> float:
        """How the hand is commanded to be turned [rad]."""
        return self.yaw_rad()

    def _spacing(self, way: Way, speed_m_per_s: float) -> int:
        """Control steps between two points of a way."""
        duration = 1.875 * float(way.lengths_m[-1]) / speed_m_per_s
        return max(1, round(duration / self.around.step_s / max(1, len(way.yaw_rad))))

    def start_xyz_m(self) -> Array:
        """Where the next way begins: the place that was commanded last ``(3,)``."""
        return np.array(self._aim_xyz_m)

    def go_over(
        self,
        goal_xyz_m: Array,
        yaw_rad: float,
        *,
        opening_m: float,
        speed_m_per_s: float,
        radius_m: float,
        below_m: float,
        without: Iterable[str],
        tail_xyz_m: Sequence[Array] = (),
        approach_m: float | None = None,
    ) -> Script:
        """Go over, or around, everything to a place, from above; wait while another hand is in the way.

        Raises:
            MotionFailed: If there is no way.
        """
        waited_s = 0.0
        while True:
            way, configurations, touch, why = self._over(
                goal_xyz_m,
                yaw_rad,
                opening_m,
                speed_m_per_s,
                radius_m,
                below_m,
                tuple(without),
                tail_xyz_m,
                self.params.approach_m if approach_m is None else approach_m,
            )
            if len(way.yaw_rad):
                break
            if touch is None or not touch.is_hand or waited_s > self.params.timeout_s / 2:
                raise _no_way(goal_xyz_m, touch, why)
            waited_s += 0.2
            yield from self.wait(0.2)
        yield from self.follow(way, configurations, speed_m_per_s)

    def _over(
        self,
        goal: Array,
        yaw: float,
        opening_m: float,
        speed: float,
        radius_m: float,
        below_m: float,
        without: Sequence[str],
        tail: Sequence[Array],
        approach_m: float,
    ) -> tuple[Way, Array, Touch | None, str | None]:
        corners = ways_over(
            self.start_xyz_m(),
            goal,
            self.around.things(without),
            radius_m=radius_m,
            below_m=below_m,
            clearance_m=self.params.clearance_m,
            approach_m=approach_m,
            highest_m=self.arm.highest_m,
        )
        return self.find_way(corners, yaw, opening_m, speed_m_per_s=speed, tail_xyz_m=tail)

    def go_straight(
        self,
        goal_xyz_m: Array,
        yaw_rad: float,
        speed_m_per_s: float,
        *,
        opening_m: float,
        stop: Callable[[], bool] | None = None,
        depth_m: float = 0.003,
    ) -> Script:
        """Go straight to a place close by.

        Raises:
            MotionFailed: If something is in the way, or it is out of reach.
        """
        corners = np.array([self.start_xyz_m(), goal_xyz_m])
        way, configurations, touch, why = self.find_way(
            [corners], yaw_rad, opening_m, speed_m_per_s=speed_m_per_s, depth_m=depth_m
        )
        if not len(way.yaw_rad):
            raise _no_way(goal_xyz_m, touch, why)
        yield from self.follow(way, configurations, speed_m_per_s, stop)


def _columns(at: Array, known_at: Array, values: Array) -> Array:
    """Rows of ``values`` at lengths between those that are known, ``(n, d)``."""
    return np.column_stack([np.interp(at, known_at, values[:, k]) for k in range(values.shape[1])])


def _no_way(goal_xyz_m: Array, touch: Touch | None, why: str | None) -> MotionFailed:
    x, y, z = goal_xyz_m
    if touch is not None:
        return MotionFailed(
            "path_blocked",
            f"no free way to ({x:.2f}, {y:.2f}, {z:.2f}) m: {touch.part} would touch {touch.other}",
            is_blocked=True,
        )
    if why is not None:
        return MotionFailed("out_of_reach", f"({x:.2f}, {y:.2f}, {z:.2f}) m: {why}", is_blocked=True)
    return MotionFailed(
        "path_blocked",
        f"no way to ({x:.2f}, {y:.2f}, {z:.2f}) m that the arm is high enough for",
        is_blocked=True,
    )
