"""Robots by name."""

from demoplan.engines.mujoco.robots.gripper import GripperRobot
from demoplan.engines.mujoco.robots.robot import Robot
from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.engines.mujoco.session import ROBOTS
from demoplan.errors import SimulationError, UnknownNameError

BOTH = ("Left_hand", "Right_hand")


def make_robot(name: str, scene: SceneSpec) -> Robot:
    """The robot of a name, to be added to a scene.

    Raises:
        UnknownNameError: If there is no such robot.
        SimulationError: If its description is not installed.
    """
    if name == "gripper":
        return GripperRobot()
    if name == "gripper_dual":
        return GripperRobot(BOTH)
    if name in ("tiago", "tiago_dual"):
        return _make_tiago(scene, ("Right_hand",) if name == "tiago" else BOTH)
    raise UnknownNameError("robot", name, ROBOTS)


def _make_tiago(scene: SceneSpec, hands: tuple[str, ...]) -> Robot:
    # TIAGo wants packages that the light robot does without.
    try:
        from demoplan.engines.mujoco.robots.tiago import TiagoRobot  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise SimulationError(
            f"TIAGo needs {error.name}: install demoplan with the extra 'robot', or use the robot 'gripper'"
        ) from None
    return TiagoRobot(scene, hands)
