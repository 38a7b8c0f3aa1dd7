"""How a participant moves: triggers, paths that clear what stands by the way, hesitations, reactions."""

from collections.abc import Generator
from typing import TypeAlias

import numpy as np

from demoplan.engines.mujoco.motion import (
    ArcParams,
    Hesitation,
    MovementClock,
    Path,
    Submovement,
    arc,
    minimum_jerk,
)
from demoplan.engines.mujoco.participants import Participant
from demoplan.engines.mujoco.workspace import Workspace
from demoplan.geometry import Array, slerp

Script: TypeAlias = Generator[None, None, None]
"""Something that takes time: it yields once per control tick, after saying what it wants of the hands."""


class Mover:
    """A participant's hands in a workspace, and what they can do by themselves."""

    def __init__(self, who: Participant, space: Workspace, rng: np.random.Generator) -> None:
        """Move as ``who`` does."""
        self.who, self.space, self.rng = who, space, rng

    def chance(self, probability: float) -> bool:
        """A coin that falls on this side with a probability."""
        return bool(self.rng.random() < probability)

    def wait(self, duration_s: float) -> Script:
        """Leave everything as it is."""
        for _ in range(max(1, round(duration_s / self.space.params.control_step_s))):
            yield

    def squeeze(self, side: str, closure: float, duration_s: float) -> Script:
        """Move the trigger."""
        intent = self.space.intent[side]
        start = intent.closure
        n = max(2, round(duration_s / self.space.params.control_step_s))
        for k in range(1, n + 1):
            intent.closure = start + (closure - start) * float(minimum_jerk(np.array(k / n)))
            yield

    def follow(
        self,
        side: str,
        path: Path,
        orientation_wxyz: Array,
        *,
        may_hesitate: bool = True,
        watch: str | None = None,
        until_contact: str | None = None,
        open_to: float | None = None,
    ) -> Generator[None, None, bool]:
        """Move the hand along a path; whether it got to the end as it meant to.

        Args:
            side: The hand.
            path: Where to.
            orientation_wxyz: How to be turned in the end.
            may_hesitate: Whether this person may hesitate on this way.
            watch: A cube that should come along: when it does not, the hand stops after a reaction time.
            until_contact: A held cube: when it comes down on something, the hand stops.
            open_to: Closure that the hand goes to on the way.
        """
        intent = self.space.intent[side]
        start_orientation, start_closure = intent.orientation_wxyz, intent.closure
        hesitations: list[Hesitation] = []
        if may_hesitate and path.duration_s > 0.5 and self.chance(self.who.hesitation_probability):
            hesitations.append(
                Hesitation(
                    float(self.rng.uniform(0.3, 0.75) * path.duration_s),
                    float(self.rng.uniform(0.25, 0.75)),
                    float(self.rng.uniform(0.7, 1.0)),
                )
            )
        clock = MovementClock(hesitations)
        step_s = self.space.params.control_step_s
        reaction_s, missing_s = float(self.rng.uniform(0.18, 0.35)), 0.0
        is_fine = True
        while clock.time_s < path.duration_s and not clock.is_stopped:
            clock.advance(step_s)
            done = minimum_jerk(np.array([clock.time_s / path.duration_s]))
            intent.position_xyz_m = path.at(clock.time_s)
            intent.orientation_wxyz = slerp(start_orientation[None], orientation_wxyz[None], done)[0]
            if open_to is not None:
                early = minimum_jerk(np.array(clock.time_s / (0.5 * path.duration_s)))
                intent.closure = start_closure + (open_to - start_closure) * float(early)
            yield
            if watch is not None:
                missing_s = 0.0 if self.space.holds(side, watch) else missing_s + step_s
                if missing_s >= reaction_s:
                    is_fine = False
                    clock.brake(0.20)
            if until_contact is not None and self.space.has_come_down(until_contact):
                clock.brake(0.05)
        return is_fine

    def duration_of(self, start: Array, end: Array, clearance_m: float) -> float:
        """How long this person takes from one place to another [s]."""
        across = float(np.linalg.norm(end[:2] - start[:2]))
        top = max(start[2], end[2]) + clearance_m
        length = across + 0.7 * float((top - start[2]) + (top - end[2]))
        varied = float(np.exp(self.rng.normal(0.0, 0.08)))
        return varied * (self.who.movement_base_s + length / self.who.speed_m_per_s)

    def arc_to(
        self, side: str, end: Array, *, lift_m: float, onset: float, settle: float, held: str | None = None
    ) -> Path:
        """An arc from where the hand is, at this person's speed and curvature.

        Args:
            side: The hand.
            end: Where the palm is to come.
            lift_m: How far the hand goes up from where it is before it may go across [m].
            onset: Share of the time after which it goes across.
            settle: Share of the time, at the end, in which it only goes down.
            held: The cube in the hand.
        """
        start = self.space.intent[side].position_xyz_m
        usual = self.who.clearance_m * float(self.rng.uniform(0.85, 1.2))
        highest = max(float(start[2]), float(end[2]))
        if lift_m == 0.0 and start[2] > end[2] and np.linalg.norm(end[:2] - start[:2]) < 0.08:
            # Already above it: straight down, as after a grasp that missed.
            return self.straight(side, end, self.duration_of(start, end, 0.0))
        clearance = max(start[2] + lift_m, end[2] + usual, highest) - highest
        sign = 1.0 if side == "Right_hand" else -1.0
        curvature = sign * self.who.curvature * float(self.rng.uniform(0.6, 1.4))
        duration_s = self.duration_of(start, end, clearance)
        for _ in range(6):
            path = arc(
                start,
                end,
                ArcParams(
                    duration_s=duration_s,
                    clearance_m=clearance,
                    curvature=curvature,
                    onset_share=onset,
                    settle_share=settle,
                ),
            )
            if not self.would_hit(path, held):
                break
            clearance += 0.03
            duration_s += 0.03 / self.who.speed_m_per_s
        return path

    def would_hit(self, path: Path, held: str | None) -> bool:
        """Whether fingers or cargo would touch a cube while they go across, between both ends of a path."""
        way = np.array([path.at(time_s) for time_s in np.linspace(0.0, path.duration_s, 32)])
        across = way[:, :2]
        is_between = (np.linalg.norm(across - across[0], axis=1) > 0.02) & (
            np.linalg.norm(across - across[-1], axis=1) > 0.02
        )
        spots = np.array([self.space.cube(name) for name in self.space.layout.names if name != held]).reshape(
            -1, 3
        )
        aside = np.linalg.norm(across[:, None] - spots[None, :, :2], axis=2)
        lowest = way[:, 2] - self.space.hand_params.grasp_point_m - self.space.scene.cube_edge_m / 2 - 0.005
        is_low = lowest[:, None] < spots[None, :, 2] + self.space.scene.cube_edge_m / 2
        return bool((is_low & (aside < 0.10) & is_between[:, None]).any())

    def straight(self, side: str, end: Array, duration_s: float) -> Path:
        """A straight way from where the hand is."""
        start = self.space.intent[side].position_xyz_m
        dx, dy, dz = (float(value) for value in end - start)
        return Path(start, (Submovement((dx, dy, dz), 0.0, duration_s),))

    def palm_above(self, point: Array) -> Array:
        """Where the palm is when the fingers close at a point."""
        palm: Array = point + np.array([0.0, 0.0, self.space.hand_params.grasp_point_m])
        return palm
