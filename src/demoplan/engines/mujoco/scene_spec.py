"""What stands where before a robot acts: objects of several shapes and sizes on a table.

A scene comes from YAML, from a seed, or from the state of a logged episode.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from demoplan.engines.mujoco.scene import TABLE, LayoutParams, SceneParams, draw_layout
from demoplan.errors import ManifestError, UnknownNameError, UsageError
from demoplan.ids import is_safe_name
from demoplan.manifests.loading import load_yaml

ObjectKind: TypeAlias = Literal["box", "cylinder", "sphere"]
Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

RESERVED = frozenset({TABLE, "Left_hand", "Right_hand"})
"""Names that other bodies of a scene have."""

CUBE_DENSITY_KG_PER_M3 = 640.0
"""Beech: a cube of 50 mm weighs 80 g."""


class ObjectSpec(BaseModel):
    """One loose object."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str
    kind: ObjectKind = "box"
    size_xyz_m: Vector = (0.05, 0.05, 0.05)
    """Full extents [m]; a cylinder's axis is z and its diameter x, a sphere's diameter is x."""
    position_xyz_m: Vector
    """Where its middle starts, in the world [m]."""
    orientation_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    mass_kg: float | None = Field(default=None, gt=0.0)
    """By default that of beech."""
    friction: float = Field(default=0.55, gt=0.0)
    """Sliding friction; 0.55 is wood on wood."""
    type: str = "WoodenCube"
    """Type in the vocabulary."""

    @field_validator("name")
    @classmethod
    def _is_free_name(cls, name: str) -> str:
        if not is_safe_name(name):
            raise ValueError("give letters, digits, '.', '-' and '_', at most 128, a letter or digit first")
        if name in RESERVED:
            raise ValueError(f"{name!r} is no name for an object: {', '.join(sorted(RESERVED))} are taken")
        return name

    @field_validator("size_xyz_m")
    @classmethod
    def _has_extent(cls, size_xyz_m: Vector) -> Vector:
        if min(size_xyz_m) <= 0.0:
            raise ValueError("every extent must be positive")
        return size_xyz_m

    @field_validator("orientation_wxyz")
    @classmethod
    def _is_a_rotation(cls, orientation_wxyz: Quaternion) -> Quaternion:
        if abs(float(np.linalg.norm(orientation_wxyz)) - 1.0) > 0.01:
            raise ValueError("a rotation is a quaternion of length 1, w first")
        return orientation_wxyz

    @property
    def volume_m3(self) -> float:
        """Its volume [m³]."""
        x, y, z = self.size_xyz_m
        share = {"box": 1.0, "cylinder": np.pi / 4, "sphere": np.pi / 6}[self.kind]
        return float(share * x * y * z)

    @property
    def weight_kg(self) -> float:
        """Its mass [kg]."""
        return self.mass_kg if self.mass_kg is not None else CUBE_DENSITY_KG_PER_M3 * self.volume_m3


class SceneSpec(BaseModel):
    """Objects on a table whose top is at z = 0, in metres, z up."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    objects: tuple[ObjectSpec, ...]
    table_size_xyz_m: Vector = (0.80, 1.00, 0.04)
    name: str = "scene"

    @field_validator("objects")
    @classmethod
    def _have_names_of_their_own(cls, objects: tuple[ObjectSpec, ...]) -> tuple[ObjectSpec, ...]:
        names = [each.name for each in objects]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"these names stand for more than one object: {', '.join(twice)}")
        return objects

    def require(self, name: str) -> ObjectSpec:
        """The object of a name.

        Raises:
            UnknownNameError: If there is none.
        """
        for each in self.objects:
            if each.name == name:
                return each
        raise UnknownNameError("object", name, self.names, f"scene {self.name!r}")

    @property
    def names(self) -> tuple[str, ...]:
        """The objects, in order."""
        return tuple(each.name for each in self.objects)


def read_scene(path: Path) -> SceneSpec:
    """The scene that a YAML file describes.

    Raises:
        ManifestError: If the file is missing or breaks the contract.
    """
    if not path.is_file():
        raise ManifestError(path, None, "there is no such scene file")
    return load_yaml(path.read_text(encoding="utf-8"), path, SceneSpec)


@dataclass(frozen=True, kw_only=True)
class RandomSceneParams:
    """What a random scene is drawn from."""

    edges_m: Sequence[float] = (0.05,)
    """Edges of cubes; one is drawn for each cube."""
    layout: LayoutParams = field(default_factory=LayoutParams)


def random_scene(
    names: Sequence[str],
    *,
    seed: int,
    stacked: Sequence[tuple[str, str]] = (),
    params: RandomSceneParams = RandomSceneParams(),
) -> SceneSpec:
    """Cubes at random places of the table, apart and within reach.

    Args:
        names: The cubes.
        seed: Of places, turns and sizes.
        stacked: (cube, cube below it) pairs that hold from the start.
        params: Sizes, and where cubes may lie.

    Raises:
        UnknownNameError: If a tower names a cube that is not there.
        UsageError: If towers are circular or the cubes do not fit.
    """
    rng = np.random.default_rng(seed)
    edges = {name: float(rng.choice(np.asarray(params.edges_m))) for name in names}
    layout = draw_layout(names, stacked, rng, SceneParams(cube_edge_m=max(edges.values())), params.layout)
    below = {cube: support for cube, support in stacked if support != TABLE}

    def height(name: str) -> float:
        base = 0.0 if name not in below else height(below[name]) + edges[below[name]] / 2
        return base + edges[name] / 2

    objects = []
    for placement in layout.placements:
        edge = edges[placement.name]
        x, y, _ = placement.position_xyz_m
        half = placement.yaw_rad / 2
        objects.append(
            ObjectSpec(
                name=placement.name,
                size_xyz_m=(edge, edge, edge),
                position_xyz_m=(x, y, height(placement.name)),
                orientation_wxyz=(float(np.cos(half)), 0.0, 0.0, float(np.sin(half))),
            )
        )
    return SceneSpec(objects=tuple(objects), name=f"random-{seed}")


def scene_of_poses(
    poses: Mapping[str, tuple[Vector, Quaternion]],
    shapes: Mapping[str, tuple[ObjectKind, Vector]],
    types: Mapping[str, str] | None = None,
    *,
    table_size_xyz_m: Vector = (0.80, 1.00, 0.04),
    name: str = "logged",
) -> SceneSpec:
    """The scene of a logged instant.

    Args:
        poses: Position and orientation of each object; hands and the table are left out by the caller.
        shapes: Kind and full extents of each object.
        types: Type of each object in the vocabulary; a wooden cube where it is not said.
        table_size_xyz_m: The table, its top at z = 0.
        name: The scene's name.

    Raises:
        UnknownNameError: If an object has no shape.
        UsageError: If there is no object at all.
    """
    if not poses:
        raise UsageError("a scene needs at least one object")
    objects = []
    for each, (position, orientation) in sorted(poses.items()):
        if each not in shapes:
            raise UnknownNameError("shape of object", each, shapes)
        kind, size = shapes[each]
        objects.append(
            ObjectSpec(
                name=each,
                kind=kind,
                size_xyz_m=size,
                position_xyz_m=position,
                orientation_wxyz=orientation,
                type=(types or {}).get(each, "WoodenCube"),
            )
        )
    return SceneSpec(objects=tuple(objects), table_size_xyz_m=table_size_xyz_m, name=name)
