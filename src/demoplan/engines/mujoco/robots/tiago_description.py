"""TIAGo's description, as an installed package has it, made fit for a table-top scene.

It comes from the package ``example-robot-data`` (its TIAGo is PAL Robotics', Apache-2.0). Wheels, sensors and
hands are left out; torso lift and head are fixed; zero inertias are mended; meshes are for the eye, and
capsules fitted to them for contacts.
"""

import xml.etree.ElementTree as ET
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import mujoco
import numpy as np

from demoplan.errors import SimulationError

PACKAGE = "example-robot-data"

_KEPT = ("base_footprint", "base_link", "base_cover_link", "torso_", "head_1_link", "head_2_link", "arm_")
_LEAST_INERTIA_KG_M2 = 1e-5
_UPPER_ARM = ("_2_link", "_3_link")
_CAPSULES = (*_UPPER_ARM, "_4_link", "_5_link", "_6_link")
"""Links that meet things: the first turns inside the shoulder, the last inside the wrist."""
_ELBOW = "_4_link"

BODY_BIT = 32
"""Contact bit of base, torso and head."""


def arm_bit(number: int) -> int:
    """Contact bit of an arm: arms meet each other, things and the body."""
    return 2 << number


def upper_arm_bit(number: int) -> int:
    """Contact bit of an upper arm, which its own hand and forearm meet."""
    return 8 << number


def description_path(name: str) -> Path:
    """Where an installed description lies.

    Raises:
        SimulationError: If the package is missing.
    """
    try:
        installed = files(PACKAGE) or []
    except PackageNotFoundError:
        raise SimulationError(
            f"TIAGo's description is missing: install demoplan with the extra 'robot' "
            f"(it brings {PACKAGE}, 414 MB unpacked), or use the robot 'gripper'"
        ) from None
    for each in installed:
        if each.name == name:
            return Path(str(each.locate()))
    raise SimulationError(f"{PACKAGE} is installed, but has no {name}")


def load_tiago(urdf: str, torso_lift_m: float, head_tilt_rad: float = -0.7) -> mujoco.MjSpec:
    """A TIAGo on its base, with free arm joints and nothing else.

    Args:
        urdf: File name of the description.
        torso_lift_m: How far the torso is raised.
        head_tilt_rad: How far the head looks down.

    Raises:
        SimulationError: If the package is missing.
    """
    path = description_path(urdf)
    share = path.parents[4]
    root = ET.parse(path).getroot()  # noqa: S314 - an installed package is as trusted as code
    for link in root.findall("link"):
        if not _is_kept(link.get("name", "")):
            root.remove(link)
            continue
        for collision in link.findall("collision"):
            link.remove(collision)
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            if mesh.get("filename", "").endswith(".stl"):
                inside = mesh.get("filename", "").removeprefix("package://")
                mesh.set("filename", str(share / inside))
            else:
                # MuJoCo does not read Collada.
                link.remove(visual)
        inertia = link.find("inertial/inertia")
        if (
            inertia is not None
            and min(float(inertia.get(axis, "0")) for axis in ("ixx", "iyy", "izz")) <= 0.0
        ):
            for axis in ("ixx", "iyy", "izz"):
                inertia.set(axis, str(_LEAST_INERTIA_KG_M2))
            for axis in ("ixy", "ixz", "iyz"):
                inertia.set(axis, "0")
    for joint in root.findall("joint"):
        ends = [joint.find(end) for end in ("parent", "child")]
        if not all(end is not None and _is_kept(end.get("link", "")) for end in ends):
            root.remove(joint)
        elif joint.get("name") in ("torso_lift_joint", "head_1_joint", "head_2_joint"):
            _fix(joint, torso_lift_m, head_tilt_rad)
    for tag in ("transmission", "gazebo"):
        for each in root.findall(tag):
            root.remove(each)
    settings = ET.SubElement(root, "mujoco")
    ET.SubElement(
        settings,
        "compiler",
        strippath="false",
        discardvisual="false",
        fusestatic="false",
        balanceinertia="true",
        boundmass="0.001",
        boundinertia=str(_LEAST_INERTIA_KG_M2),
    )
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    _dress(spec)
    return spec


def _is_kept(link: str) -> bool:
    return link.startswith(_KEPT)


def _fix(joint: ET.Element, torso_lift_m: float, head_tilt_rad: float) -> None:
    """Fix a joint of torso or head where it is to stay."""
    joint.set("type", "fixed")
    origin = joint.find("origin")
    assert origin is not None
    if joint.get("name") == "torso_lift_joint":
        x, y, z = (float(each) for each in origin.get("xyz", "0 0 0").split())
        origin.set("xyz", f"{x} {y} {z + torso_lift_m}")
    elif joint.get("name") == "head_2_joint":
        # The head's axis is z of a frame that is rolled by 90°: a turn about it looks up or down.
        roll, pitch, yaw = (float(each) for each in origin.get("rpy", "0 0 0").split())
        origin.set("rpy", f"{roll} {pitch + head_tilt_rad} {yaw}")


def _dress(spec: mujoco.MjSpec) -> None:
    """Make meshes mere looks, fit capsules to arms, and give every body gravity compensation."""
    for body in spec.bodies:
        if body.name == "world":
            continue
        body.gravcomp = 1.0
        for geom in list(body.geoms):
            geom.contype = geom.conaffinity = 0
            geom.group = 1
            geom.rgba = [0.92, 0.92, 0.93, 1.0] if "arm" not in body.name else [0.80, 0.81, 0.83, 1.0]
            if body.name.startswith("arm") and body.name.endswith(_CAPSULES):
                _fit(body, geom, mujoco.mjtGeom.mjGEOM_CAPSULE)
    for name, kind in _BODY_SOLIDS.items():
        body = spec.body(name)
        looks = next(iter(body.geoms), None) if body is not None else None
        if looks is not None:
            solid = _fit(body, looks, kind)
            solid.contype, solid.conaffinity = BODY_BIT, 0


_BODY_SOLIDS = {
    "base_link": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "torso_fixed_column_link": mujoco.mjtGeom.mjGEOM_BOX,
    "torso_lift_link": mujoco.mjtGeom.mjGEOM_MESH,
    "head_2_link": mujoco.mjtGeom.mjGEOM_MESH,
}
"""What arms could run into, and which solid is fitted to it; a mesh counts as its convex hull."""


def _fit(body: mujoco.MjsBody, looks: mujoco.MjsGeom, kind: mujoco.mjtGeom) -> mujoco.MjsGeom:
    """A solid of some kind that fits a mesh; what looks like a simple solid is that."""
    is_mesh = looks.type == mujoco.mjtGeom.mjGEOM_MESH
    return body.add_geom(
        name=f"{body.name}:solid",
        type=kind if is_mesh else looks.type,
        size=np.zeros(3) if is_mesh else np.array(looks.size),
        rgba=[0.3, 0.5, 0.8, 0.3],
        meshname=looks.meshname,
        pos=np.array(looks.pos),
        quat=np.array(looks.quat),
        group=3,
        mass=0.0,
    )


def set_contacts(body: mujoco.MjsBody, number: int, n_arms: int) -> None:
    """Let the solids of one arm's body meet things, other arms, and what of the robot does not adjoin them.

    An upper arm adjoins the torso; hand and forearm meet the upper arm, from which the elbow parts them.
    """
    others = sum(arm_bit(other) for other in range(n_arms) if other != number)
    is_upper = body.name.endswith(_UPPER_ARM)
    for geom in body.geoms:
        if geom.group == 1:
            continue
        geom.contype = arm_bit(number) | (upper_arm_bit(number) if is_upper else 0)
        geom.conaffinity = 1 | others
        if not is_upper:
            geom.conaffinity |= BODY_BIT
            if not body.name.endswith(_ELBOW):
                geom.conaffinity |= upper_arm_bit(number)
