"""A mapping: which topics of a log say what about which entity.

One YAML file per rig serves MCAP, ROS 1 and ROS 2 logs alike. Nothing that is not mapped is decoded.
"""

from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

Clock: TypeAlias = Literal["header", "publish", "log"]
QuaternionOrder: TypeAlias = Literal["fields", "xyzw", "wxyz"]
LengthUnit: TypeAlias = Literal["m", "cm", "mm"]


class Strict(BaseModel):
    """A frozen value that refuses keys it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class TopicMapping(Strict):
    """What every kind of mapped topic has."""

    clock: Clock | None = None
    """Which stamp counts; by default the mapping's."""
    required: bool = True
    """A log without this topic is refused; with ``required: false`` what it feeds is marked unobserved."""


class TransformsTopic(TopicMapping):
    """A ``tf2_msgs/TFMessage``: parents, children and transforms between them."""

    kind: Literal["transforms"]
    path: str = "transforms"
    """Field that holds the list of ``geometry_msgs/TransformStamped``."""
    static: bool = False
    """Latched: each transform holds for the whole episode."""
    entities: dict[str, str] = {}
    """Child frame → entity. Frames that are not named still serve in chains of transforms."""


class PoseTopic(TopicMapping):
    """One body's pose per message."""

    kind: Literal["pose"]
    entity: str
    position: str = "pose.position"
    """Field path of x, y, z (sub-fields, or an array of three)."""
    orientation: str | None = "pose.orientation"
    """Field path of the quaternion (sub-fields, or an array of four); null where there is none."""
    order: QuaternionOrder = "fields"
    """Order of an array quaternion; ``fields`` where sub-fields are named x, y, z, w."""
    unit: LengthUnit = "m"
    frame: str | None = None
    """Reference frame; by default what the header says, else the mapping's world."""
    valid: str | None = None
    """Field path of a flag that says whether the reading is valid."""


class BodiesTopic(TopicMapping):
    """A list of named bodies per message, as motion capture publishes it."""

    kind: Literal["bodies"]
    path: str
    """Field that holds the list."""
    name: str = "name"
    """Field of an element that names the body."""
    entities: dict[str, str]
    """Body name → entity; bodies not named here are counted and left out."""
    position: str = "pose.position"
    orientation: str | None = "pose.orientation"
    order: QuaternionOrder = "fields"
    unit: LengthUnit = "m"
    frame: str | None = None
    valid: str | None = None


class GripTopic(TopicMapping):
    """How far a hand is open."""

    kind: Literal["grip"]
    entity: str
    field: str = "data"
    """Field path of the number, with an index where it is in an array: ``axes[0]``."""
    open_at: float = 1.0
    """The recorded number when the hand is fully open."""
    closed_at: float = 0.0
    """The recorded number when it is fully closed."""


Topic: TypeAlias = Annotated[
    TransformsTopic | PoseTopic | BodiesTopic | GripTopic, Field(discriminator="kind")
]


class FixedPose(Strict):
    """Where a body stands that no topic speaks of, as a table."""

    position_xyz_m: tuple[float, float, float]
    orientation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


class Box(Strict):
    """Extent of one entity, where it differs from its type's."""

    kind: Literal["box", "cylinder", "sphere", "point"] = "box"
    size_xyz_m: tuple[float, float, float]
    centre_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Entity(Strict):
    """An instance: its type in the vocabulary, and where it stands if nothing tracks it."""

    type: str
    shape: Box | None = None
    fixed: FixedPose | None = None


class Mapping(Strict):
    """Topics to entities, for one rig."""

    world: str = "world"
    """Reference frame in which everything is expressed."""
    clock: Clock = "header"
    """Which stamp counts where a topic does not say."""
    entities: dict[str, Entity]
    topics: dict[str, Topic]
    definitions: tuple[str, ...] = ()
    """Folders with ``.msg`` files, relative to the mapping, for logs that do not carry definitions."""
