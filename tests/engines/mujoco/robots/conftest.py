import pytest

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.scene_spec import ObjectSpec, SceneSpec
from demoplan.engines.mujoco.session import Motion, MotionReport, Session


class Stacker:
    """Carries out by hand what operators would ask for."""

    def run(self, session: Session, hand: str, motion: Motion) -> MotionReport:
        session.start(hand, motion)
        while (report := session.report(hand)).state == "running":
            session.advance(0.05)
        return report

    def motions(self, cube: str, support: str) -> tuple[Motion, ...]:
        return (
            Motion(activity="Reach", skill="reach", object=cube),
            Motion(activity="Take", skill="grasp", object=cube),
            Motion(activity="Put", skill="carry", object=cube, support=support),
            Motion(activity="Release", skill="release", object=cube),
            Motion(activity="Idle", skill="rest"),
        )

    def stack(self, session: Session, hand: str, cube: str, support: str, n: int = 5) -> list[MotionReport]:
        """Reports up to the first motion that does not succeed, or of the first ``n``."""
        reports = []
        for motion in self.motions(cube, support)[:n]:
            reports.append(self.run(session, hand, motion))
            if reports[-1].state != "succeeded":
                break
        if n == 5:
            session.advance(0.2)
        return reports


@pytest.fixture(scope="session")
def stacker() -> Stacker:
    return Stacker()


@pytest.fixture(scope="session")
def a_pair_each() -> SceneSpec:
    """Two cubes to the left for one hand, two to the right for the other."""
    return SceneSpec(
        objects=(
            ObjectSpec(name="cube_red", position_xyz_m=(0.0, -0.25, 0.025)),
            ObjectSpec(name="cube_blue", position_xyz_m=(0.1, -0.15, 0.025)),
            ObjectSpec(name="cube_green", position_xyz_m=(0.0, 0.25, 0.025)),
            ObjectSpec(name="cube_yellow", position_xyz_m=(0.1, 0.15, 0.025)),
        )
    )
