"""Robots by name."""

from demoplan.engines.mujoco.robots.gripper import GripperRobot
from demoplan.engines.mujoco.robots.robot import Robot
from demoplan.errors import UnknownNameError

BOTH = ("Left_hand", "Right_hand")


def make_robot(name: str) -> Robot:
    """The robot of a name, to be added to a scene.

    Raises:
        UnknownNameError: If there is no such robot.
        SimulationError: If its description is not installed.
    """
    if name == "gripper":
        return GripperRobot()
    if name == "gripper_dual":
        return GripperRobot(BOTH)
    raise UnknownNameError("robot", name, ("gripper", "gripper_dual"))
