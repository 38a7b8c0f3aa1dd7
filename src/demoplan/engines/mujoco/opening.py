"""A robot in a scene, ready to act."""

from demoplan.engines.mujoco.filming import Film
from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.engines.mujoco.session import ROBOTS, Session, SessionParams
from demoplan.engines.mujoco.simulated import SimulatedSession
from demoplan.errors import UnknownNameError


def open_session(
    scene: SceneSpec,
    robot: str = "gripper",
    *,
    seed: int,
    params: SessionParams = SessionParams(),
    film: Film | None = None,
) -> Session:
    """A robot at rest in a scene that has come to rest.

    Args:
        scene: What stands where.
        robot: One of :data:`ROBOTS`.
        seed: For everything random: sensor noise and gaps.
        params: Sensors, skills.
        film: Keeps what the scene looked like, if it is to be drawn.

    Raises:
        UnknownNameError: If there is no such robot.
        SimulationError: If objects of the scene stand in each other, or the robot's description is missing.
    """
    if robot not in ROBOTS:
        raise UnknownNameError("robot", robot, ROBOTS)
    return SimulatedSession(scene, robot, seed=seed, params=params, film=film)
