"""A scene's objects as bodies of a physics model."""

import mujoco
import numpy as np

from demoplan.engines.mujoco.scene import COLOURS, Layout, SceneParams, build_scene
from demoplan.engines.mujoco.scene_spec import ObjectSpec, SceneSpec
from demoplan.errors import SimulationError
from demoplan.geometry import Array

KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}

DEEPEST_OVERLAP_M = 0.003
"""Objects that stand in each other by more than this are no scene."""


def geom_size(kind: str, size_xyz_m: Array) -> Array:
    """MuJoCo's half sizes ``(3,)`` of a solid with full extents ``(3,)``."""
    x, y, z = np.asarray(size_xyz_m, dtype=float) / 2
    return {"box": np.array([x, y, z]), "cylinder": np.array([x, z, 0.0]), "sphere": np.array([x, 0.0, 0.0])}[
        kind
    ]


def build_objects(scene: SceneSpec, params: SceneParams) -> mujoco.MjSpec:
    """Table and objects, as a specification to which a robot can still be added.

    Bodies, geoms and free joints are named as the objects.
    """
    spec = build_scene(Layout(()), params)
    for each in scene.objects:
        _add_object(spec, each)
    return spec


def _add_object(spec: mujoco.MjSpec, each: ObjectSpec) -> None:
    body = spec.worldbody.add_body(
        name=each.name, pos=list(each.position_xyz_m), quat=list(each.orientation_wxyz)
    )
    body.add_freejoint(name=each.name)
    colour = COLOURS.get(each.name.removeprefix("cube_"), (0.6, 0.6, 0.6))
    is_box = each.kind == "box"
    body.add_geom(
        name=each.name,
        type=KINDS[each.kind],
        size=geom_size(each.kind, np.array(each.size_xyz_m)),
        mass=each.weight_kg,
        # What can roll needs friction against rolling, else it never comes to rest.
        condim=4 if is_box else 6,
        friction=[each.friction, 0.005, 0.0001 if is_box else 0.001],
        rgba=[*colour, 1.0],
    )


def check_overlaps(data: mujoco.MjData, names: dict[int, str], scene: str) -> None:
    """Refuse a scene whose bodies stand in each other.

    Args:
        data: After ``mj_forward``.
        names: What each geom is called; others are not looked at.
        scene: The scene's name, for the message.

    Raises:
        SimulationError: If two geoms overlap by more than :data:`DEEPEST_OVERLAP_M`.
    """
    deep = []
    for (first, second), distance in zip(
        data.contact.geom[: data.ncon], data.contact.dist[: data.ncon], strict=True
    ):
        if distance < -DEEPEST_OVERLAP_M and first in names and second in names:
            deep.append(f"{names[first]} and {names[second]} by {-1e3 * distance:.0f} mm")
    if deep:
        raise SimulationError(f"scene {scene!r}: these stand in each other: {'; '.join(sorted(set(deep)))}")
