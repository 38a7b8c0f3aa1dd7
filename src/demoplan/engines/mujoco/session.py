"""Running motions on a robot in a physics scene: what goes in, what comes back, and who provides it.

A session owns one scene, one robot and their clock. Whoever executes a plan starts motions on hands, lets
time pass, reads what sensors saw, and asks what became of the motions. Everything is deterministic: the same
scene, robot, seed, parameters and calls give the same poses, bit for bit.
"""

from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias

import polars as pl

from demoplan.engines.mujoco.scene_spec import SceneSpec

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

SKILL_NAMES = ("reach", "grasp", "carry", "lift", "release", "rest")

MotionState: TypeAlias = Literal["running", "succeeded", "failed", "blocked", "cancelled"]
MotionProblem: TypeAlias = Literal[
    "out_of_reach",
    "path_blocked",
    "not_seen",
    "grasped_nothing",
    "object_lost",
    "not_holding",
    "still_holding",
    "no_contact",
    "off_course",
    "timeout",
]
"""Why a motion did not succeed, as far as the robot itself can tell; ``reason`` says it in words."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """One motion of one hand, with everything it needs to know."""

    activity: str
    """Activity that the plan's operator is named after."""
    skill: str
    """Which motion carries it out: ``reach``, ``grasp``, ``carry``, ``lift``, ``release``, ``rest``."""
    object: str | None = None
    """What is reached for, taken, carried or let go."""
    support: str | None = None
    """What the object is put on."""
    position_xyz_m: Vector | None = None
    """Where the object's middle is to come, if not to the support's middle or a free spot of a surface."""
    parameters: tuple[tuple[str, float], ...] = ()
    """Numbers that differ from :class:`SkillParams`, by name."""


@dataclass(frozen=True, kw_only=True)
class MotionReport:
    """How the latest motion of a hand goes, or went."""

    motion: Motion
    state: MotionState
    """``failed`` says that it was tried, ``blocked`` that no way was found before moving."""
    problem: MotionProblem | None
    reason: str | None
    """In words, with figures."""
    tracking_error_m: float
    """Largest distance between commanded and reached position of the hand so far [m]."""
    peak_force_n: float
    """Largest sum of contact forces on hand and arm so far, what is grasped included [N]."""
    n_collisions: int
    """Unwanted contacts of hand, arm or carried object that began during the motion."""
    started_ns: int
    ended_ns: int | None
    """None while it runs."""


@dataclass(frozen=True, kw_only=True)
class SensorParams:
    """How poses are sensed; defaults are those of marker-based tracking beside a robot."""

    rate_hz: float = 50.0
    position_noise_m: float = 0.0005
    """Standard deviation per axis of one reading [m]."""
    orientation_noise_rad: float = 0.004
    grip_noise: float = 0.004
    drop_probability: float = 0.01
    """Chance that a reading of one entity is lost."""
    dropouts_per_minute: float = 2.0
    """How often one object is not seen for a while [1/min]."""
    dropout_s: tuple[float, float] = (0.06, 0.20)
    """Shortest and longest such while [s]."""
    latency_s: float = 0.03
    """From what happens to when it can be read [s]."""
    staleness_s: float = 0.10
    """An older reading is not given any more: the pose is then null [s]."""


@dataclass(frozen=True, kw_only=True)
class SkillParams:
    """How skills move; a motion can override single numbers by name."""

    speed_m_per_s: float = 0.45
    """Peak speed of free movements [m/s]."""
    carry_speed_m_per_s: float = 0.35
    near_speed_m_per_s: float = 0.16
    """Peak speed close to objects [m/s]."""
    clearance_m: float = 0.05
    """Free height between what is lowest on a hand, or in it, and what it passes over [m]."""
    approach_m: float = 0.08
    """Height above the grasp from which a hand goes straight down [m]."""
    retreat_m: float = 0.12
    """How far a hand goes straight up after letting go [m]."""
    grip_s: float = 0.35
    """Time to close or open [s]."""
    settle_s: float = 0.15
    """Wait at the end of an approach and after closing [s]."""
    place_gap_m: float = 0.004
    """Height above contact from which an object is lowered slowly until it touches [m]."""
    arrival_m: float = 0.012
    """A hand that ends farther off than this has not arrived [m]."""
    off_course_m: float = 0.06
    """A hand that is farther off its path than this stops [m]."""
    timeout_s: float = 20.0


@dataclass(frozen=True, kw_only=True)
class SessionParams:
    """What can be chosen about a session."""

    sensors: SensorParams = field(default_factory=SensorParams)
    skills: SkillParams = field(default_factory=SkillParams)
    settle_s: float = 0.4
    """Time that a scene gets to come to rest before the clock starts [s]."""


@dataclass(frozen=True, kw_only=True)
class ObjectMoved:
    """Somebody puts an object elsewhere. It is not carried there: it is gone here and appears there."""

    object: str
    position_xyz_m: Vector
    orientation_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class ObjectRemoved:
    """Somebody takes an object away; sensors see it no more."""

    object: str


@dataclass(frozen=True, kw_only=True)
class GripSlips:
    """The fingers of a hand lose their friction for a while: what they carry slips."""

    hand: str
    duration_s: float = 1.0
    friction: float = 0.02


@dataclass(frozen=True, kw_only=True)
class ObjectDropped:
    """A hand opens by itself, now."""

    hand: str


@dataclass(frozen=True, kw_only=True)
class PlacingOffset:
    """Everything that a hand puts down from now on, or the next ``n_times``, comes down beside the aim."""

    hand: str
    offset_xyz_m: Vector
    n_times: int = 1


@dataclass(frozen=True, kw_only=True)
class PathBlocked:
    """A solid box stands in the scene for a while; it moves for nobody."""

    name: str
    position_xyz_m: Vector
    size_xyz_m: Vector
    duration_s: float = float("inf")
    is_seen: bool = True
    """Whether the robot knows of it when it looks for a path; else it runs into it."""


@dataclass(frozen=True, kw_only=True)
class SensorBiased:
    """Sensors see one entity beside where it is, for a while."""

    entity: str
    offset_xyz_m: Vector
    duration_s: float = float("inf")


@dataclass(frozen=True, kw_only=True)
class SensorBlind:
    """Sensors do not see one entity for a while."""

    entity: str
    duration_s: float


Fault: TypeAlias = (
    ObjectMoved
    | ObjectRemoved
    | GripSlips
    | ObjectDropped
    | PlacingOffset
    | PathBlocked
    | SensorBiased
    | SensorBlind
)


class Session(Protocol):
    """One robot in one scene, and their clock."""

    scene: SceneSpec
    robot: str

    @property
    def hands(self) -> tuple[str, ...]:
        """Names of the robot's hands."""

    @property
    def time_ns(self) -> int:
        """Simulated time since the scene came to rest [ns]; a multiple of the control step."""

    def start(self, hand: str, motion: Motion) -> MotionReport:
        """Begin a motion; it runs while time is let pass.

        A motion that cannot begin (nothing to grasp in sight, no way to the target) is reported as blocked
        or failed at once, which is an outcome and not an error.

        Raises:
            UnknownNameError: If the hand, the skill, an object or a parameter does not exist.
            UsageError: If the hand is still moving: cancel that first; or if the skill lacks an object.
        """

    def advance(self, duration_s: float) -> None:
        """Let time pass, in whole control steps: at least ``duration_s``, by less than a step more."""

    def report(self, hand: str) -> MotionReport | None:
        """How the latest motion of a hand goes; None before the first."""

    def cancel(self, hand: str) -> None:
        """Stop a motion where it is; the hand keeps what it holds."""

    def inject(self, fault: Fault) -> None:
        """Let something go wrong, now.

        Raises:
            UnknownNameError: If a hand or an object does not exist.
        """

    def frames(self, since_ns: int = -1) -> pl.DataFrame:
        """What sensors saw of hands and objects after ``since_ns``, as rows of ``Frames``.

        With latency: the last tick lies before ``time_ns``. The pose of a hand is the middle of its grasp;
        its grip is what the gripper is told to, as a trigger is. Sorted by entity, then tick.
        """

    def true_frames(self, since_ns: int = -1) -> pl.DataFrame:
        """The same as it truly was, up to now: for scoring and pictures, never for deciding."""

    def is_resting_on(self, name: str, support: str) -> bool:
        """Whether by physics an object rests on another, or on the table: for scoring only."""

    def can_reach(self, hand: str, position_xyz_m: Vector) -> str | None:
        """Why a hand's grasp cannot come to a position from above; None if it can."""


ROBOTS = ("gripper", "gripper_dual", "tiago", "tiago_dual")
