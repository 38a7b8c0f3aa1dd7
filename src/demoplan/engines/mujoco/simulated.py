"""The session that MuJoCo runs: one clock for physics, hands and sensors."""

import weakref
from collections.abc import Iterable
from dataclasses import fields, replace

import mujoco
import numpy as np
import polars as pl

from demoplan.engines.mujoco.filming import Film
from demoplan.engines.mujoco.robots.arm_control import ArmControl
from demoplan.engines.mujoco.robots.checking import Checker
from demoplan.engines.mujoco.robots.contacts import ContactWatch
from demoplan.engines.mujoco.robots.grasps import Stance, stance_of
from demoplan.engines.mujoco.robots.making import make_robot
from demoplan.engines.mujoco.robots.motions import SKILLS
from demoplan.engines.mujoco.robots.paths import Upright
from demoplan.engines.mujoco.scene import TABLE, RestingParams, SceneParams, touching
from demoplan.engines.mujoco.scene_objects import build_objects, check_overlaps
from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.engines.mujoco.sensors import Sensors
from demoplan.engines.mujoco.session import (
    Fault,
    GripSlips,
    Motion,
    MotionReport,
    ObjectDropped,
    ObjectMoved,
    ObjectRemoved,
    PathBlocked,
    PlacingOffset,
    SensorBiased,
    SensorBlind,
    SessionParams,
    SkillParams,
    Vector,
)
from demoplan.errors import SimulationError, UnknownNameError, UsageError
from demoplan.geometry import Array

CONTROL_STEP_S = 0.010
N_OBSTACLES = 4
_HIDDEN = np.array([0.0, 0.0, -3.0])
_REMOVED_SPACING_M = 0.5


def _parked(index: int) -> Array:
    """Where an obstacle waits that is not there."""
    return np.array([2.0 * index, 0.0, -8.0])


class SimulatedSession:
    """A robot in a scene, stepped by MuJoCo; see :class:`demoplan.engines.mujoco.session.Session`."""

    def __init__(
        self,
        scene: SceneSpec,
        robot: str,
        *,
        seed: int,
        params: SessionParams = SessionParams(),
        film: Film | None = None,
    ) -> None:
        """Build the scene, let it come to rest, and take the first reading."""
        self._film = film
        self.scene = scene
        self.robot = robot
        self.params = params
        self.seed = seed
        built = make_robot(robot, scene)
        physics = SceneParams(table_size_xyz_m=scene.table_size_xyz_m, timestep_s=built.timestep_s)
        spec = build_objects(scene, physics)
        for index in range(N_OBSTACLES):
            body = spec.worldbody.add_body(name=f"obstacle:{index}", mocap=True, pos=_parked(index))
            body.add_geom(
                name=f"obstacle:{index}",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[0.01, 0.01, 0.01],
                rgba=[0.55, 0.20, 0.20, 1.0],
            )
        built.add_to(spec)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._n_substeps = max(1, round(CONTROL_STEP_S / built.timestep_s))
        self.step_s = self._n_substeps * built.timestep_s
        self._step_ns = round(self.step_s * 1e9)
        self._arms = built.bind(self.model, self.data, self.step_s)
        self._geoms = {name: self.model.geom(name).id for name in (*scene.names, TABLE)}
        self._bodies = {name: self.model.body(name).id for name in (*scene.names, TABLE)}
        self._joints = {name: int(self.model.joint(name).qposadr[0]) for name in scene.names}
        self._speeds = {name: int(self.model.joint(name).dofadr[0]) for name in scene.names}
        self._obstacles: dict[str, tuple[int, PathBlocked, int]] = {}
        self.checker = Checker(
            self.model, {name: (self._joints[name], self._geoms[name]) for name in scene.names}, self._arms
        )
        # Hands know their session weakly. In a circle its models (with TIAGo, 75 MB that Python's collector
        # does not count) would stay until the collector happens to come by: dozens of runs later.
        around = weakref.proxy(self)
        self._controls = {hand: ArmControl(arm, around, params.skills) for hand, arm in self._arms.items()}
        weakref.finalize(self, _abandon, tuple(self._controls.values())).atexit = False
        self._watch = ContactWatch(
            self.model,
            tuple(self._controls.values()),
            {geom: name for name, geom in self._geoms.items()},
        )
        self._slips: dict[str, int] = {}
        self._removed: set[str] = set()
        self._n_ticks = 0
        self._check_start()
        settle = round(params.settle_s / built.timestep_s)
        mujoco.mj_step(self.model, self.data, nstep=settle)
        self._sensor_every = max(1, round(1.0 / (params.sensors.rate_hz * self.step_s)))
        self._sensors = Sensors(
            (*self.hands, *scene.names, TABLE),
            self.hands,
            (TABLE,),
            params.sensors,
            np.random.default_rng(seed),
        )
        self._seen_ids = [self._bodies[name] for name in (*scene.names, TABLE)]
        self._observe()

    def _check_start(self) -> None:
        mujoco.mj_forward(self.model, self.data)
        names = {geom: name for name, geom in self._geoms.items()}
        for control in self._controls.values():
            names.update(dict.fromkeys(control.arm.geoms, control.arm.hand))
        check_overlaps(self.data, names, self.scene.name)

    # Session -----------------------------------------------------------------------------------------

    @property
    def hands(self) -> tuple[str, ...]:
        """Names of the robot's hands."""
        return tuple(self._controls)

    @property
    def time_ns(self) -> int:
        """Simulated time since the scene came to rest [ns]."""
        return self._n_ticks * self._step_ns

    def _control(self, hand: str) -> ArmControl:
        if hand not in self._controls:
            raise UnknownNameError("hand", hand, self._controls, f"robot {self.robot!r}")
        return self._controls[hand]

    def start(self, hand: str, motion: Motion) -> MotionReport:
        """Begin a motion; see the protocol."""
        control = self._control(hand)
        if control.is_moving:
            raise UsageError(f"{hand} is still moving; cancel that first")
        if motion.skill not in SKILLS:
            raise UnknownNameError("skill", motion.skill, SKILLS, f"the motion of {motion.activity!r}")
        if motion.object is None and motion.skill in ("reach", "grasp", "carry"):
            raise UsageError(f"activity {motion.activity!r}: skill {motion.skill!r} needs an object")
        for name in (motion.object, motion.support):
            if name is not None and name not in self._geoms:
                raise UnknownNameError("object", name, self._geoms, f"scene {self.scene.name!r}")
        params = _with_parameters(self.params.skills, motion)
        control.params = params
        return control.start(motion, SKILLS[motion.skill](control, motion), params)

    def advance(self, duration_s: float) -> None:
        """Let time pass, in whole control steps."""
        for _ in range(max(1, int(np.ceil(duration_s / self.step_s - 1e-9)))):
            self._tick()

    def report(self, hand: str) -> MotionReport | None:
        """How the latest motion of a hand goes; None before the first."""
        return self._control(hand).report()

    def cancel(self, hand: str) -> None:
        """Stop a motion where it is."""
        self._control(hand).cancel()

    def frames(self, since_ns: int = -1) -> pl.DataFrame:
        """What sensors saw after ``since_ns``, as rows of ``Frames``."""
        return self._sensors.frames(since_ns, self.time_ns)

    def true_frames(self, since_ns: int = -1) -> pl.DataFrame:
        """The same as it truly was, up to now."""
        return self._sensors.true_frames(since_ns)

    def is_resting_on(self, name: str, support: str) -> bool:
        """Whether by physics an object rests on another, or on the table, and no hand touches it."""
        for each in (name, support):
            if each not in self._geoms:
                raise UnknownNameError("object", each, self._geoms, f"scene {self.scene.name!r}")
        if name in self._removed or support in self._removed or name == TABLE:
            return False
        resting = RestingParams()
        own = self._true_stance(name)
        bottom = 0.0 if support == TABLE else self._true_stance(support).top_m
        speed = self.data.qvel[self._speeds[name] : self._speeds[name] + 3]
        return bool(
            abs(own.top_m - own.height_m - bottom) <= resting.height_tolerance_m
            and own.tilt_rad <= resting.tilt_limit_rad
            and np.linalg.norm(speed) <= resting.speed_limit_m_per_s
            and touching(self.data, self._geoms[name], self._geoms[support])
        )

    def can_reach(self, hand: str, position_xyz_m: Vector) -> str | None:
        """Why a hand's grasp cannot come to a position from above; None if it can."""
        return self._control(hand).arm.reachable(np.array(position_xyz_m, dtype=float))

    # Time --------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        self._expire()
        for control in self._controls.values():
            control.tick()
        mujoco.mj_step(self.model, self.data, nstep=self._n_substeps)
        self._n_ticks += 1
        self._measure()
        if self._film is not None:
            self._film.take(self.time_ns, self.model, self.data)
        if self._n_ticks % self._sensor_every == 0:
            self._observe()

    def _measure(self) -> None:
        """Tell every hand where it got, what pushes on it, and what it has begun to touch."""
        forces, begun = self._watch.read(self.data)
        for number, control in enumerate(self._controls.values()):
            if control.is_moving:
                control.measure(control.position_xyz_m(), forces[number], begun[number])

    def _observe(self) -> None:
        n = len(self.hands)
        k = n + len(self._seen_ids)
        position, orientation = np.empty((k, 3)), np.empty((k, 4))
        grip = np.empty(n)
        for row, control in enumerate(self._controls.values()):
            position[row], orientation[row] = control.arm.pose(self.data)
            grip[row] = 1.0 - control.closure
        position[n:] = self.data.xpos[self._seen_ids]
        orientation[n:] = self.data.xquat[self._seen_ids]
        self._sensors.observe(self.time_ns, position, orientation, grip)

    # What hands know -----------------------------------------------------------------------------------

    def pose(self, name: str) -> tuple[Array, Array] | None:
        """Where an object seems to be."""
        belief = self._sensors.believed(name, self.time_ns)
        return None if belief is None else (belief.position_xyz_m, belief.orientation_wxyz)

    def stance(self, name: str) -> Stance | None:
        """How an object seems to stand; None where it is not seen."""
        pose = self.pose(name)
        if pose is None:
            return None
        each = self.scene.require(name)
        return stance_of(each.kind, np.array(each.size_xyz_m), *pose)

    def _true_stance(self, name: str) -> Stance:
        each, body = self.scene.require(name), self._bodies[name]
        return stance_of(each.kind, np.array(each.size_xyz_m), self.data.xpos[body], self.data.xquat[body])

    def things(self, without: Iterable[str]) -> list[Upright]:
        """What seems to stand about, obstacles that are known of included."""
        left_out = set(without)
        found = []
        for name in self.scene.names:
            stance = None if name in left_out else self.stance(name)
            if stance is not None:
                x, y, _ = stance.position_xyz_m
                found.append(Upright(name, float(x), float(y), stance.radius_m, stance.top_m))
        for name, (_, fault, _) in self._obstacles.items():
            if fault.is_seen:
                x, y, z = fault.position_xyz_m
                depth, width, height = fault.size_xyz_m
                found.append(Upright(name, x, y, float(np.hypot(depth, width)) / 2, z + height / 2))
        return found

    def arrange(self) -> None:
        """Put the checker's copy in the state that is believed."""
        self.checker.arrange(self.data, {name: self.pose(name) for name in self.scene.names})

    def others_of(self, hand: str) -> list[ArmControl]:
        """The other hands."""
        return [control for name, control in self._controls.items() if name != hand]

    def hidden_geoms(self) -> tuple[int, ...]:
        """Obstacles that the robot does not know of."""
        return tuple(
            self.model.geom(f"obstacle:{index}").id
            for index, fault, _ in self._obstacles.values()
            if not fault.is_seen
        )

    def is_surface(self, name: str) -> bool:
        """Whether it is the table, rather than an object."""
        return name == TABLE

    def free_spots(self, name: str, room_m: float) -> list[Array]:
        """Places on the table for an object, ``(2,)``: apart from everything, the nearest first."""
        depth, width, _ = self.scene.table_size_xyz_m
        x = np.arange(-depth / 2 + 0.10, depth / 2 - 0.10, 0.03)
        y = np.arange(-width / 2 + 0.10, width / 2 - 0.10, 0.03)
        spots = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        for thing in self.things((name,)):
            away = np.hypot(spots[:, 0] - thing.x_m, spots[:, 1] - thing.y_m)
            spots = spots[away >= thing.radius_m + room_m]
        pose = self.pose(name)
        origin = np.zeros(2) if pose is None else pose[0][:2]
        distance = np.round(np.linalg.norm(spots - origin, axis=1), 6)
        return list(spots[np.argsort(distance, kind="stable")])

    # Faults --------------------------------------------------------------------------------------------

    def inject(self, fault: Fault) -> None:
        """Let something go wrong, now; see the protocol."""
        until = self._until(getattr(fault, "duration_s", float("inf")))
        match fault:
            case ObjectMoved():
                self._require_object(fault.object)
                self._removed.discard(fault.object)
                self._sensors.set_present(fault.object, True)
                self._place(fault.object, np.array(fault.position_xyz_m), np.array(fault.orientation_wxyz))
            case ObjectRemoved():
                self._require_object(fault.object)
                # Out of everybody's way, on nothing: it is held there by :meth:`_keep_removed`.
                self._removed.add(fault.object)
                self._sensors.set_present(fault.object, False)
                self._keep_removed()
            case GripSlips():
                self._control(fault.hand).arm.set_pads_friction(self.model, fault.friction)
                self._slips[fault.hand] = until
            case ObjectDropped():
                control = self._control(fault.hand)
                control.closure = 0.0
            case PlacingOffset():
                control = self._control(fault.hand)
                control.placing_offset.extend([np.array(fault.offset_xyz_m)] * fault.n_times)
            case PathBlocked():
                self._block(fault, until)
            case SensorBiased():
                self._require_sensed(fault.entity)
                self._sensors.bias(fault.entity, np.array(fault.offset_xyz_m), until)
            case SensorBlind():
                self._require_sensed(fault.entity)
                self._sensors.blind(fault.entity, until)

    def _until(self, duration_s: float) -> int:
        return int(np.iinfo(np.int64).max) if np.isinf(duration_s) else self.time_ns + round(1e9 * duration_s)

    def _require_object(self, name: str) -> None:
        if name not in self._joints:
            raise UnknownNameError("object", name, self._joints, f"scene {self.scene.name!r}")

    def _require_sensed(self, name: str) -> None:
        if name not in self._sensors.entities:
            raise UnknownNameError("entity", name, self._sensors.entities, f"scene {self.scene.name!r}")

    def _place(self, name: str, position_xyz_m: Array, orientation_wxyz: Array) -> None:
        address, speed = self._joints[name], self._speeds[name]
        self.data.qpos[address : address + 3] = position_xyz_m
        self.data.qpos[address + 3 : address + 7] = orientation_wxyz
        self.data.qvel[speed : speed + 6] = 0.0

    def _keep_removed(self) -> None:
        """Hold what was taken away far below the table, where nothing touches it."""
        for number, name in enumerate(sorted(self._removed)):
            self._place(
                name, _HIDDEN - [0.0, _REMOVED_SPACING_M * number, 0.0], np.array([1.0, 0.0, 0.0, 0.0])
            )

    def _block(self, fault: PathBlocked, until: int) -> None:
        free = sorted(set(range(N_OBSTACLES)) - {index for index, _, _ in self._obstacles.values()})
        if fault.name in self._obstacles:
            raise UsageError(f"there is an obstacle {fault.name!r} already")
        if not free:
            raise SimulationError(f"a scene has room for {N_OBSTACLES} obstacles at a time")
        index = free[0]
        geom = self.model.geom(f"obstacle:{index}").id
        half = np.array(fault.size_xyz_m) / 2
        self.model.geom_size[geom] = half
        self.model.geom_rbound[geom] = np.linalg.norm(half)
        self.model.geom_aabb[geom] = np.concatenate([np.zeros(3), half])
        self.data.mocap_pos[self.model.body(f"obstacle:{index}").mocapid[0]] = fault.position_xyz_m
        self._obstacles[fault.name] = (index, fault, until)
        self._watch.names[geom] = self.checker.names[geom] = fault.name

    def _expire(self) -> None:
        """End what was to last for a while only."""
        if self._removed:
            self._keep_removed()
        for hand in [hand for hand, until in self._slips.items() if self.time_ns >= until]:
            self._control(hand).arm.set_pads_friction(self.model, None)
            del self._slips[hand]
        for name in [name for name, (_, _, until) in self._obstacles.items() if self.time_ns >= until]:
            index = self._obstacles.pop(name)[0]
            self.data.mocap_pos[self.model.body(f"obstacle:{index}").mocapid[0]] = _parked(index)


def _abandon(controls: Iterable[ArmControl]) -> None:
    for control in controls:
        control.abandon()


def _with_parameters(params: SkillParams, motion: Motion) -> SkillParams:
    known = [each.name for each in fields(SkillParams)]
    for name, _ in motion.parameters:
        if name not in known:
            raise UnknownNameError("skill parameter", name, known, f"the motion of {motion.activity!r}")
    return replace(params, **dict(motion.parameters))
