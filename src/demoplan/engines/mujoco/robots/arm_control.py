"""One hand at work: its motion, command by command, and what it measures meanwhile."""

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import mujoco
import numpy as np

from demoplan.engines.mujoco.robots.checking import Checker, Held
from demoplan.engines.mujoco.robots.grasps import Stance
from demoplan.engines.mujoco.robots.paths import Upright, progress
from demoplan.engines.mujoco.robots.robot import Arm
from demoplan.engines.mujoco.robots.routing import Destination, NoWay, Other, Router, Start, Track
from demoplan.engines.mujoco.session import Motion, MotionProblem, MotionReport, MotionState, SkillParams
from demoplan.geometry import Array

Script: TypeAlias = Generator[None, None, None]
"""What a hand does; it is resumed once per control step."""


_FAR_POSTURE_SPACINGS = 6.0
"""An arm that rests farther than this from its posture puts itself right."""


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
    seed: int
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
        """At rest, open; whoever makes it keeps ``around`` alive, as long as it is to move."""
        self.arm = arm
        self.around = around
        self.defaults = params
        self.params = params
        self._router = Router(arm, around.checker)
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

    def abandon(self) -> None:
        """Forget what is under way, without a report: the session is gone."""
        # A script that waits for its next step holds the hand, and the hand holds the script.
        if self._script is not None:
            self._script.close()
            self._script = None

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

    def upcoming(self) -> Array:
        """Its configurations from now on, one per control step, ``(n, d)``; at least one."""
        if self._at >= len(self._ahead):
            return self.arm.commanded()[None]
        return self._ahead[self._at :]

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

    def follow(self, track: Track, speed_m_per_s: float, stop: Callable[[], bool] | None = None) -> Script:
        """Go along a track that has been found free.

        Args:
            track: Where to.
            speed_m_per_s: Peak speed.
            stop: Ends the way early when it says so.

        Raises:
            MotionFailed: If the hand is pushed off its way.
        """
        lengths, step_s = track.lengths_m, self.around.step_s
        if lengths[-1] < 1e-6:
            return
        done = progress(float(lengths[-1]), speed_m_per_s, step_s)
        self._ahead = _columns(done, lengths, track.configurations)
        rates = np.abs(np.diff(self._ahead, axis=0, prepend=track.configurations[:1])) / step_s
        excess = float((rates.max(axis=0) / self.arm.speed_limits).max())
        if excess > 1.0:
            done = progress(float(lengths[-1]), speed_m_per_s, step_s, excess)
            self._ahead = _columns(done, lengths, track.configurations)
        aims = _columns(done, lengths, track.position_xyz_m)
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

    def start_xyz_m(self) -> Array:
        """Where the next way begins: the place that was commanded last ``(3,)``."""
        return np.array(self._aim_xyz_m)

    def _start(self) -> Start:
        """What a way is looked for from."""
        self.around.arrange()
        return Start(
            self.arm.commanded(),
            self.start_xyz_m(),
            self.yaw_rad(),
            self.held,
            self.around.step_s,
            tuple(Other(each.arm, each.upcoming()) for each in self.around.others_of(self.arm.hand)),
            self.around.hidden_geoms(),
        )

    def go_over(self, to: Destination, *, through_joints: bool = False) -> Script:
        """Go over, or around, everything to a place, from above; wait while another hand is in the way.

        Args:
            to: Where, and what the hand needs on its way.
            through_joints: Look for any path of the arm, where the hand need not stay upright.

        Raises:
            MotionFailed: If there is no way.
        """
        waited_s = 0.0
        while True:
            start = self._start()
            if through_joints:
                rng = np.random.default_rng((self.around.seed, self.around.time_ns))
                found = self._router.through_joints(start, to, rng)
            else:
                found = self._router.over(start, to, self.around.things(to.without))
            if isinstance(found, Track):
                break
            if not found.is_hand or waited_s > self.params.timeout_s / 2:
                raise _no_way(to.position_xyz_m, found)
            waited_s += 0.2
            yield from self.wait(0.2)
        yield from self.follow(found, to.speed_m_per_s)

    def go_home(self, to: Destination) -> Script:
        """Go to the rest, in its own posture as far as there is a way: from there most can be reached.

        Raises:
            MotionFailed: If there is no way to the place at all.
        """
        home = replace(to, configuration=self.arm.rest_configuration)
        try:
            yield from self.go_over(to)
        except MotionFailed as failure:
            if not failure.is_blocked:
                raise
            yield from self.go_over(home, through_joints=True)
        off = np.abs(self.arm.commanded() - self.arm.rest_configuration) / self.arm.space.spacing
        if off.max() > _FAR_POSTURE_SPACINGS:
            try:
                yield from self.go_over(home, through_joints=True)
            except MotionFailed as failure:
                if not failure.is_blocked:
                    raise

    def go_straight(
        self, to: Destination, *, stop: Callable[[], bool] | None = None, depth_m: float = 0.003
    ) -> Script:
        """Go straight to a place close by.

        Raises:
            MotionFailed: If something is in the way, or it is out of reach.
        """
        corners = np.array([self.start_xyz_m(), to.position_xyz_m])
        found = self._router.straight(self._start(), [corners], to, depth_m)
        if isinstance(found, NoWay):
            raise _no_way(to.position_xyz_m, found)
        yield from self.follow(found, to.speed_m_per_s, stop)


def _columns(at: Array, known_at: Array, values: Array) -> Array:
    """Rows of ``values`` at lengths between those that are known, ``(n, d)``."""
    return np.column_stack([np.interp(at, known_at, values[:, k]) for k in range(values.shape[1])])


def _no_way(goal_xyz_m: Array, found: NoWay) -> MotionFailed:
    place = "({:.2f}, {:.2f}, {:.2f}) m".format(*goal_xyz_m)
    if found.touch is not None:
        problem: MotionProblem = "path_blocked"
        reason = f"no free way to {place}: {found.touch.part} would touch {found.touch.other}"
    elif found.why is not None:
        problem, reason = "out_of_reach", f"{place}: {found.why}"
    else:
        problem, reason = "path_blocked", f"no way to {place} that the arm is high enough for"
    return MotionFailed(problem, reason, is_blocked=True)
