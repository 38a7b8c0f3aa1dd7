"""How fast and how surely robots stack: python benchmarks/simulation.py [ROBOT …] [--seeds N].

Each seed draws a layout of four cubes and builds a tower of three. Time is processor time of one core:
physics, controllers, path finding and sensing included; building the scene is given on its own.
"""

import argparse
import sys
import time
from collections import Counter

import numpy as np

from demoplan.engines.mujoco.scene import cube_names
from demoplan.engines.mujoco.scene_spec import random_scene
from demoplan.engines.mujoco.session import ROBOTS, Motion, Session, open_session

TOWER = (("cube_red", "cube_blue"), ("cube_green", "cube_red"))


def wilson(n_successes: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA
    22(158), 1927, doi:10.1080/01621459.1927.10502953.
    """
    share = n_successes / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)


def stack(session: Session, hand: str, cube: str, support: str) -> str | None:
    """Put a cube on another; why not, if a motion fails."""
    for motion in (
        Motion(activity="Reach", skill="reach", object=cube),
        Motion(activity="Take", skill="grasp", object=cube),
        Motion(activity="Put", skill="carry", object=cube, support=support),
        Motion(activity="Release", skill="release", object=cube),
        Motion(activity="Idle", skill="rest"),
    ):
        session.start(hand, motion)
        while (report := session.report(hand)).state == "running":
            session.advance(0.05)
        if report.state != "succeeded":
            return f"{motion.activity}: {report.problem}: {report.reason}"
    session.advance(0.2)
    return None if session.is_resting_on(cube, support) else "it does not rest there"


def measure(robot: str, seeds: range) -> None:
    n, n_good, n_towers = 0, 0, 0
    used_s, simulated_s, opened_s = 0.0, 0.0, []
    offsets_mm: list[float] = []
    reasons: Counter[str] = Counter()
    for seed in seeds:
        begin = time.process_time()
        session = open_session(random_scene(cube_names(4), seed=seed), robot, seed=seed)
        opened_s.append(time.process_time() - begin)
        begin = time.process_time()
        for cube, support in TOWER:
            n += 1
            why = stack(session, session.hands[-1], cube, support)
            if why is not None:
                reasons[f"seed {seed}: {cube} on {support}: {why}"] += 1
                break
            n_good += 1
            last = session.true_frames(session.time_ns - 100_000_000)
            places = {
                row["entity"]: np.array(row["position_xyz_m"])
                for row in last.sort("tick_ns").iter_rows(named=True)
                if row["entity"] in (cube, support)
            }
            offsets_mm.append(1e3 * float(np.linalg.norm((places[cube] - places[support])[:2])))
        else:
            n_towers += 1
        session.frames()
        used_s += time.process_time() - begin
        simulated_s += session.time_ns / 1e9
    low, high = wilson(n_good, n)
    print(
        f"{robot}: {simulated_s / used_s:.0f} x real time per core "
        f"({simulated_s:.0f} s in {used_s:.1f} s), "
        f"opening a scene {1e3 * float(np.median(opened_s)):.0f} ms\n"
        f"  stacks {n_good} of {n} ({n_good / n:.1%}; 95 % interval {low:.1%} to {high:.1%}), "
        f"towers of three {n_towers} of {len(seeds)}\n"
        f"  off by {np.median(offsets_mm):.2f} mm in the median, {max(offsets_mm):.2f} mm at most"
    )
    for reason in reasons:
        print(f"  {reason}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=["gripper", "tiago"], help=", ".join(ROBOTS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    chosen = parser.parse_args()
    for robot in chosen.robots:
        measure(robot, range(chosen.first, chosen.first + chosen.seeds))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
