"""A table with cubes on it, as a model that a hand or a robot can be added to.

World: z up, metres; the table's top is at z = 0. Whatever is attached to the scene shares its contact
options, which change outcomes and are therefore parameters that are recorded with every episode.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from demoplan.errors import UnknownNameError, UsageError
from demoplan.geometry import Array

TABLE = "table"

COLOURS: dict[str, tuple[float, float, float]] = {
    "red": (0.80, 0.16, 0.14),
    "blue": (0.14, 0.32, 0.74),
    "green": (0.16, 0.58, 0.24),
    "yellow": (0.90, 0.76, 0.16),
    "orange": (0.90, 0.48, 0.12),
    "purple": (0.46, 0.22, 0.58),
    "white": (0.90, 0.90, 0.88),
    "black": (0.14, 0.14, 0.14),
}
"""Cubes are named ``cube_<colour>``; a scene takes as many of these as it needs, in this order."""


def cube_names(n_cubes: int) -> tuple[str, ...]:
    """The first ``n_cubes`` cubes.

    >>> cube_names(2)
    ('cube_red', 'cube_blue')

    Raises:
        UsageError: If there are not that many colours, or none are asked for.
    """
    if not 1 <= n_cubes <= len(COLOURS):
        raise UsageError(f"asked for {n_cubes} cubes; a scene has 1 to {len(COLOURS)}")
    return tuple(f"cube_{colour}" for colour in list(COLOURS)[:n_cubes])


@dataclass(frozen=True, kw_only=True)
class SceneParams:
    """What the physics depends on."""

    cube_edge_m: float = 0.05
    cube_mass_kg: float = 0.08
    """A beech cube of that edge [kg]."""
    cube_friction: float = 0.55
    """Sliding friction of wood on wood and on the table."""
    table_size_xyz_m: tuple[float, float, float] = (0.80, 1.00, 0.04)
    timestep_s: float = 0.002
    friction_cone: str = "elliptic"
    """``elliptic`` or ``pyramidal``: it changes outcomes, so it is fixed and recorded."""
    impedance_ratio: float = 10.0
    """Ratio of frictional to normal constraint impedance: high values keep a grasp from creeping."""
    settle_s: float = 0.4
    """Time that a scene gets to come to rest before anybody acts [s]."""


@dataclass(frozen=True)
class Placement:
    """Where one cube starts."""

    name: str
    position_xyz_m: tuple[float, float, float]
    yaw_rad: float


@dataclass(frozen=True)
class Layout:
    """Where all cubes start."""

    placements: tuple[Placement, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The cubes, in order."""
        return tuple(placement.name for placement in self.placements)


@dataclass(frozen=True, kw_only=True)
class LayoutParams:
    """Where cubes may lie at the start."""

    x_range_m: tuple[float, float] = (-0.14, 0.22)
    y_range_m: tuple[float, float] = (-0.28, 0.28)
    shortest_gap_m: float = 0.075
    """Shortest distance between the sides of two cubes, so that fingers fit in between [m]."""
    largest_yaw_rad: float = 0.6
    stack_offset_sd_m: float = 0.002
    """How far a cube of a tower that stands there already is off its support's middle [m]."""


def draw_layout(
    names: Sequence[str],
    stacked: Sequence[tuple[str, str]],
    rng: np.random.Generator,
    scene: SceneParams = SceneParams(),
    params: LayoutParams = LayoutParams(),
) -> Layout:
    """A random layout: cubes apart and within reach, with towers where they are asked for.

    Args:
        names: The cubes.
        stacked: (cube, cube below it) pairs that hold from the start; everything else lies on the table.
        rng: Source of randomness.
        scene: Sizes.
        params: Where cubes may lie.

    Raises:
        UnknownNameError: If a tower names a cube that is not there.
        UsageError: If towers are circular or the cubes do not fit.
    """
    below = dict(stacked)
    for name in {*below, *below.values()} - {TABLE}:
        if name not in names:
            raise UnknownNameError("cube", name, names, "the start layout")
    below = {cube: support for cube, support in below.items() if support != TABLE}
    edge = scene.cube_edge_m
    apart = edge * np.sqrt(2) + params.shortest_gap_m
    bases: dict[str, Array] = {}
    for name in (name for name in names if name not in below):
        for _ in range(10_000):
            spot = np.array([rng.uniform(*params.x_range_m), rng.uniform(*params.y_range_m)])
            if all(np.linalg.norm(spot - other) >= apart for other in bases.values()):
                bases[name] = spot
                break
        else:
            raise UsageError(
                f"{len(names)} cubes do not fit {apart:.3f} m apart into "
                f"{params.x_range_m} × {params.y_range_m} m"
            )
    placed: dict[str, Placement] = {}
    pending = list(names)
    while pending:
        ready = [name for name in pending if name in bases or below[name] in placed]
        if not ready:
            raise UsageError(f"the start layout stacks in a circle: {sorted(below.items())}")
        for name in ready:
            yaw = rng.uniform(-params.largest_yaw_rad, params.largest_yaw_rad)
            if name in bases:
                x, y = bases[name]
                height = edge / 2
            else:
                support = placed[below[name]]
                x, y = rng.normal(support.position_xyz_m[:2], params.stack_offset_sd_m)
                yaw = support.yaw_rad + 0.15 * yaw
                height = support.position_xyz_m[2] + edge
            placed[name] = Placement(name, (float(x), float(y), float(height)), float(yaw))
            pending.remove(name)
    return Layout(tuple(placed[name] for name in names))


def free_spot(occupied_xy_m: Array, near_xy_m: Array, rng: np.random.Generator) -> Array:
    """A place on the table, ``(2,)``, away from all ``(n, 2)`` on it and not far from ``near_xy_m``."""
    best, best_gap = near_xy_m, -np.inf
    for _ in range(200):
        spot = np.array([rng.uniform(-0.16, 0.24), rng.uniform(-0.30, 0.30)])
        gap = np.linalg.norm(occupied_xy_m - spot, axis=1).min(initial=np.inf)
        if gap >= 0.14 and np.linalg.norm(spot - near_xy_m) <= 0.30:
            return spot
        if gap > best_gap:
            best, best_gap = spot, gap
    return best


def build_scene(layout: Layout, params: SceneParams = SceneParams()) -> mujoco.MjSpec:
    """Table and cubes, as a specification to which hands or robots can still be added.

    Bodies are named ``table`` and as the layout names its cubes. Each cube has a free joint of its own name.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "tabletop"
    option = spec.option
    option.timestep = params.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    cones = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
    if params.friction_cone not in cones:
        raise UnknownNameError("friction cone", params.friction_cone, cones)
    option.cone = cones[params.friction_cone]
    option.impratio = params.impedance_ratio
    spec.worldbody.add_light(pos=[0.3, -0.6, 1.6], dir=[-0.1, 0.4, -1.0], castshadow=False)
    depth, width, thickness = params.table_size_xyz_m
    table = spec.worldbody.add_body(name=TABLE, pos=[0.0, 0.0, 0.0])
    table.add_geom(
        name=TABLE,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[depth / 2, width / 2, thickness / 2],
        pos=[0.0, 0.0, -thickness / 2],
        friction=[params.cube_friction, 0.005, 0.0001],
        rgba=[0.72, 0.66, 0.58, 1.0],
    )
    half = params.cube_edge_m / 2
    for placement in layout.placements:
        yaw = placement.yaw_rad
        body = spec.worldbody.add_body(
            name=placement.name,
            pos=list(placement.position_xyz_m),
            quat=[np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)],
        )
        body.add_freejoint(name=placement.name)
        colour = COLOURS.get(placement.name.removeprefix("cube_"), (0.6, 0.6, 0.6))
        body.add_geom(
            name=placement.name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[half, half, half],
            mass=params.cube_mass_kg,
            condim=4,
            friction=[params.cube_friction, 0.005, 0.0001],
            rgba=[*colour, 1.0],
        )
    return spec


@dataclass(frozen=True, kw_only=True)
class RestingParams:
    """When a cube counts as resting on something, for judging a demonstration from its physics."""

    height_tolerance_m: float = 0.006
    tilt_limit_rad: float = 0.15
    speed_limit_m_per_s: float = 0.01
    """A cube that is faster is still moving."""


@dataclass(frozen=True)
class CubeIndex:
    """Where each body and geom stands in a compiled model."""

    bodies: dict[str, int] = field(hash=False)
    geoms: dict[str, int] = field(hash=False)
    velocities: dict[str, int] = field(hash=False)

    @classmethod
    def of(cls, model: mujoco.MjModel, names: Sequence[str]) -> "CubeIndex":
        """Indices of the cubes ``names`` and of the table."""
        return cls(
            {name: model.body(name).id for name in (*names, TABLE)},
            {name: model.geom(name).id for name in (*names, TABLE)},
            {name: int(model.joint(name).dofadr[0]) for name in names},
        )


def touching(data: mujoco.MjData, first: int, second: int) -> bool:
    """Whether two geoms are in contact."""
    pairs = data.contact.geom[: data.ncon]
    hits = ((pairs[:, 0] == first) & (pairs[:, 1] == second)) | (
        (pairs[:, 0] == second) & (pairs[:, 1] == first)
    )
    return bool(hits.any())


def is_resting_on(
    data: mujoco.MjData,
    index: CubeIndex,
    cube: str,
    support: str,
    scene: SceneParams = SceneParams(),
    params: RestingParams = RestingParams(),
) -> bool:
    """Whether a cube rests on the table or on another cube: level, at its height, in contact and still."""
    position = data.xpos[index.bodies[cube]]
    # Whichever face it stands on: a cube that has rolled over is as good as before.
    upright = np.abs(data.xmat[index.bodies[cube]].reshape(3, 3)[2]).max()
    speed = np.linalg.norm(data.qvel[index.velocities[cube] : index.velocities[cube] + 3])
    height = scene.cube_edge_m / 2
    if support != TABLE:
        height = data.xpos[index.bodies[support]][2] + scene.cube_edge_m
    return bool(
        abs(position[2] - height) <= params.height_tolerance_m
        and np.arccos(np.clip(upright, -1.0, 1.0)) <= params.tilt_limit_rad
        and speed <= params.speed_limit_m_per_s
        and touching(data, index.geoms[cube], index.geoms[support])
    )
