"""A participant carries out a task: reach, grasp, carry, let go, and what people do when it goes wrong.

The participant is a script that yields one command per control tick and looks at the scene as a person
would: it sees where cubes are, whether the cube comes along, and whether it has come down on something.
What becomes of the cubes is left to physics.
"""

from collections.abc import Generator

import numpy as np

from demoplan.engines.mujoco.demonstration import Demonstration, DemonstrationParams, Phase
from demoplan.engines.mujoco.hands import HandParams
from demoplan.engines.mujoco.moving import Mover, Script
from demoplan.engines.mujoco.participants import Participant
from demoplan.engines.mujoco.scene import TABLE, Layout, SceneParams, free_spot
from demoplan.engines.mujoco.tasks import Step, Task
from demoplan.engines.mujoco.workspace import Workspace, yaw_of, yaw_quaternion
from demoplan.geometry import Array


def nearest_quarter(yaw_rad: float, to_rad: float) -> float:
    """The angle that is a multiple of 90° from ``yaw_rad`` and nearest to ``to_rad``."""
    quarter = np.pi / 2
    return float(yaw_rad + quarter * np.round((to_rad - yaw_rad) / quarter))


class Actor(Mover):
    """A participant who carries out the workspace's task."""

    n_misses = 0
    """Grasps that closed on nothing, or lost the cube, so far."""

    def reach(self, side: str, cube: str) -> Generator[None, None, None]:
        """Go to a cube with an open hand; now and then the aim is off."""
        intent = self.space.intent[side]
        intent.phase = Phase.APPROACH
        yaw = nearest_quarter(self.space.cube_yaw(cube), yaw_of(intent.orientation_wxyz))
        aim = np.append(self.rng.normal(0.0, self.who.aim_sd_m, 2), 0.0)
        aim[2] = self.who.grasp_height_m + self.rng.normal(0.0, 0.0015)
        if self.chance(self.who.miss_probability):
            if self.chance(0.5):
                aim[2] += self.rng.uniform(0.040, 0.052)
            else:
                forward = self.rng.choice([-1.0, 1.0]) * self.rng.uniform(0.041, 0.050)
                aim[:2] += forward * np.array([np.cos(yaw), np.sin(yaw)])
        goal = self.palm_above(self.space.cube(cube) + aim)
        orientation = yaw_quaternion(yaw + self.rng.normal(0.0, self.who.yaw_sd_rad))
        path = self.arc_to(side, goal, lift_m=0.0, onset=0.05, settle=0.22)
        yield from self.follow(side, path, orientation, open_to=0.0)
        yield from self.wait(self.who.dwell_s * float(self.rng.uniform(0.5, 1.6)))

    def grasp(self, side: str) -> Script:
        """Close the fingers; now and then loosen and close them again."""
        intent = self.space.intent[side]
        intent.phase = Phase.GRASP
        yield from self.squeeze(side, 1.0, self.who.grip_s * float(self.rng.uniform(0.85, 1.25)))
        if self.chance(self.who.regrasp_probability):
            yield from self.wait(float(self.rng.uniform(0.05, 0.15)))
            yield from self.squeeze(side, float(self.rng.uniform(0.2, 0.6)), self.who.grip_s)
            shift = np.append(self.rng.normal(0.0, 0.002, 2), 0.0)
            end = intent.position_xyz_m + shift
            path = self.straight(side, end, 0.2)
            yield from self.follow(side, path, intent.orientation_wxyz, may_hesitate=False)
            yield from self.squeeze(side, 1.0, self.who.grip_s)
        yield from self.wait(self.who.dwell_s * float(self.rng.uniform(0.6, 1.8)))

    def spot_for(self, step: Step) -> tuple[Array, float]:
        """Where the middle of the cube is to come, ``(3,)``, and how the cube is to be turned [rad]."""
        edge = self.space.scene.cube_edge_m
        if step.onto != TABLE:
            return self.space.cube(step.onto) + np.array([0.0, 0.0, edge]), self.space.cube_yaw(step.onto)
        others = np.array(
            [self.space.cube(name)[:2] for name in self.space.layout.names if name != step.cube]
        )
        spot = free_spot(others.reshape(-1, 2), self.space.cube(step.cube)[:2], self.rng)
        return np.append(spot, edge / 2), self.space.cube_yaw(step.cube)

    def carry(self, side: str, step: Step) -> Generator[None, None, bool]:
        """Bring the cube to its place; whether it came along."""
        intent = self.space.intent[side]
        intent.phase = Phase.CARRY
        spot, cube_yaw = self.spot_for(step)
        error = np.append(self.rng.normal(0.0, self.who.place_sd_m, 2), 0.0)
        if self.chance(self.who.careless_probability):
            angle, size = self.rng.uniform(0.0, 2 * np.pi), self.rng.uniform(0.007, 0.012)
            error[:2] += size * np.array([np.cos(angle), np.sin(angle)])
        target = spot + error
        in_hand = self.space.cube(step.cube) - intent.position_xyz_m
        turned = self.space.cube_yaw(step.cube) - yaw_of(intent.orientation_wxyz)
        hand_yaw = nearest_quarter(cube_yaw - turned, yaw_of(intent.orientation_wxyz))
        orientation = yaw_quaternion(hand_yaw + self.rng.normal(0.0, self.who.yaw_sd_rad))
        hover_m = float(self.rng.uniform(0.018, 0.040))
        hover = target - in_hand + np.array([0.0, 0.0, hover_m])
        path = self.arc_to(side, hover, lift_m=self.who.clearance_m, onset=0.22, settle=0.16, held=step.cube)
        if not (yield from self.follow(side, path, orientation, watch=step.cube)):
            return False
        # The last bit is done by eye: what counts is where the cube is, not where the hand is.
        in_hand = self.space.cube(step.cube) - intent.position_xyz_m
        release_m = -self.space.params.touch_depth_m
        if self.chance(self.who.careless_probability):
            release_m = float(self.rng.uniform(0.006, 0.016))
        low = target - in_hand + np.array([0.0, 0.0, release_m])
        drop = float(np.linalg.norm(low - intent.position_xyz_m))
        duration = 0.8 * self.who.movement_base_s + 1.6 * drop / self.who.speed_m_per_s
        path = self.straight(side, low, duration)
        is_fine = yield from self.follow(
            side, path, orientation, may_hesitate=False, watch=step.cube, until_contact=step.cube
        )
        yield from self.wait(self.who.dwell_s * float(self.rng.uniform(0.5, 1.6)))
        return is_fine

    def let_go(self, side: str) -> Script:
        """Open the hand, then begin to move away."""
        self.space.intent[side].phase = Phase.LET_GO
        yield from self.squeeze(side, 0.0, self.who.grip_s * float(self.rng.uniform(0.85, 1.2)))
        yield from self.wait(self.who.dwell_s * float(self.rng.uniform(0.2, 0.8)))

    def retreat(self, side: str, *, height_m: float) -> Script:
        """Move straight up, a little back, away from what was let go."""
        intent = self.space.intent[side]
        intent.phase = Phase.RETREAT
        end = intent.position_xyz_m + np.array([-0.2 * height_m, 0.0, height_m])
        duration = 0.8 * self.who.movement_base_s + 1.2 * height_m / self.who.speed_m_per_s
        path = self.straight(side, end, duration)
        yield from self.follow(side, path, intent.orientation_wxyz, may_hesitate=False)

    def go_home(self, side: str) -> Script:
        """Go back to where the hand rests, up first."""
        self.space.intent[side].phase = Phase.RETREAT
        path = self.arc_to(
            side, self.space.rest[side], lift_m=self.who.clearance_m + 0.03, onset=0.36, settle=0.0
        )
        yield from self.follow(side, path, self.space.rest_orientation[side], may_hesitate=False)
        self.space.intent[side].phase = Phase.REST
        self.space.intent[side].step = -1

    def do(self, number: int) -> Generator[None, None, bool]:
        """One step of the task; whether it is done."""
        step = self.space.task.steps[number]
        side = step.hand
        intent = self.space.intent[side]
        for _ in range(self.space.params.most_attempts):
            intent.step = number
            yield from self.reach(side, step.cube)
            yield from self.grasp(side)
            is_placed = yield from self.carry(side, step)
            yield from self.let_go(side)
            if is_placed:
                return True
            self.n_misses += 1
            yield from self.retreat(side, height_m=float(self.rng.uniform(0.05, 0.09)))
            if not self.space.is_reachable(step.cube):
                return False
        return False

    def act(self) -> Script:
        """The whole demonstration."""
        yield from self.wait(float(self.rng.uniform(0.6, 1.3)))
        for number, step in enumerate(self.space.task.steps):
            is_done = yield from self.do(number)
            upcoming = self.space.task.steps[number + 1 :]
            if not is_done or not upcoming or upcoming[0].hand != step.hand:
                yield from self.go_home(step.hand)
                if not is_done:
                    break
                if upcoming:
                    yield from self.wait(self.who.pause_s * float(self.rng.uniform(0.6, 1.4)))
                continue
            yield from self.retreat(step.hand, height_m=self.who.clearance_m * 1.2)
            if self.chance(self.who.pause_probability):
                self.space.intent[step.hand].phase = Phase.REST
                yield from self.wait(self.who.pause_s * float(self.rng.uniform(0.6, 1.5)))
        yield from self.wait(float(self.rng.uniform(0.8, 1.5)))


def demonstrate(
    participant: Participant,
    task: Task,
    layout: Layout,
    rng: np.random.Generator,
    *,
    scene: SceneParams = SceneParams(),
    hand: HandParams = HandParams(),
    params: DemonstrationParams = DemonstrationParams(),
) -> Demonstration:
    """Let a participant carry out a task, and write down what really happened.

    Args:
        participant: Who acts.
        task: What is to be done.
        layout: Where the cubes start.
        rng: Source of every random choice; the same source gives the same demonstration.
        scene: Physics.
        hand: The virtual hands.
        params: How it is run.

    Returns:
        Poses of cubes and hands, triggers and intentions at every control tick. The goal counts as reached if
        in the end every moved cube rests, upright and still, where it was to be.
    """
    space = Workspace(participant, task, layout, rng, scene=scene, hand=hand, params=params)
    actor = Actor(participant, space, rng)
    space.settle()
    for tick, _ in enumerate(actor.act()):
        space.tick()
        if (tick + 1) * params.control_step_s >= params.longest_s:
            break
    return space.finish(actor.n_misses)
