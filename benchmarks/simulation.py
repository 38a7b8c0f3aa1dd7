"""How fast and how surely robots stack: python benchmarks/simulation.py [ROBOT …] [--task TASK …].

Each seed draws a layout of cubes. Tasks: a tower of three, a tower of five, three towers of two; with
``--two-arms``, two towers of two, each arm building one, against one arm that builds both in the same scenes.
Time is processor time of one core: physics, controllers, path finding and sensing included; building the
scene is given on its own.
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from demoplan.engines.mujoco.opening import open_session
from demoplan.engines.mujoco.scene import cube_names
from demoplan.engines.mujoco.scene_spec import SceneSpec, random_scene
from demoplan.engines.mujoco.session import ROBOTS, Motion, Session

Moves = Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Task:
    """How many cubes there are, and which goes on which."""

    n_cubes: int
    moves: Moves


TASKS = {
    "tower-of-three": Task(4, (("cube_red", "cube_blue"), ("cube_green", "cube_red"))),
    "tower-of-five": Task(
        5,
        (
            ("cube_blue", "cube_red"),
            ("cube_green", "cube_blue"),
            ("cube_yellow", "cube_green"),
            ("cube_orange", "cube_yellow"),
        ),
    ),
    "three-towers": Task(
        6, (("cube_red", "cube_blue"), ("cube_green", "cube_yellow"), ("cube_orange", "cube_purple"))
    ),
}


def wilson(n_successes: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA
    22(158), 1927, doi:10.1080/01621459.1927.10502953.
    """
    share = n_successes / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)


def share(n_successes: int, n: int) -> str:
    low, high = wilson(n_successes, n)
    return f"{n_successes} of {n} ({n_successes / n:.1%}; 95 % interval {low:.1%} to {high:.1%})"


def motions_of(moves: Moves) -> list[Motion]:
    """All that a hand does to put cubes on others, and rest in between."""
    found = []
    for cube, support in moves:
        found += [
            Motion(activity="Reach", skill="reach", object=cube),
            Motion(activity="Take", skill="grasp", object=cube),
            Motion(activity="Put", skill="carry", object=cube, support=support),
            Motion(activity="Release", skill="release", object=cube),
            Motion(activity="Idle", skill="rest"),
        ]
    return found


@dataclass(frozen=True)
class Done:
    """What became of it, and how long it took."""

    why: str | None
    n_good: int
    makespan_s: float
    n_collisions: int


def carry_out(session: Session, moves: Mapping[str, Moves]) -> Done:
    """Let every hand make its moves, all hands at once; each goes on with its next as soon as it can."""
    waiting = {hand: motions_of(each) for hand, each in moves.items()}
    why: str | None = None
    running: set[str] = set()
    n_collisions = 0
    session.advance(0.2)
    while why is None and (running or any(waiting.values())):
        for hand, motions in waiting.items():
            if hand not in running and motions:
                session.start(hand, motions.pop(0))
                running.add(hand)
        session.advance(0.05)
        for hand in sorted(running):
            report = session.report(hand)
            assert report is not None
            if report.state == "running":
                continue
            running.discard(hand)
            n_collisions += report.n_collisions
            if report.state != "succeeded":
                why = f"{hand}: {report.motion.activity}: {report.problem}: {report.reason}"
    makespan_s = session.time_ns / 1e9
    session.advance(0.2)
    pairs = [pair for each in moves.values() for pair in each]
    resting = [session.is_resting_on(*pair) for pair in pairs]
    if why is None and not all(resting):
        why = f"{pairs[resting.index(False)]} does not rest"
    return Done(why, sum(resting), makespan_s, n_collisions)


def offsets_mm(session: Session, moves: Moves) -> list[float]:
    """How far each cube's middle is beside that of its support."""
    last = session.true_frames(session.time_ns - 100_000_000).sort("tick_ns")
    places = {row["entity"]: np.array(row["position_xyz_m"]) for row in last.iter_rows(named=True)}
    return [
        1e3 * float(np.linalg.norm((places[cube] - places[support])[:2]))
        for cube, support in moves
        if session.is_resting_on(cube, support)
    ]


def measure(robot: str, name: str, seeds: range) -> None:
    task = TASKS[name]
    n_good, n_whole, n_collisions = 0, 0, 0
    used_s, simulated_s, opened_s = 0.0, 0.0, []
    offsets: list[float] = []
    reasons: Counter[str] = Counter()
    for seed in seeds:
        begin = time.process_time()
        session = open_session(random_scene(cube_names(task.n_cubes), seed=seed), robot, seed=seed)
        opened_s.append(time.process_time() - begin)
        begin = time.process_time()
        done = carry_out(session, {session.hands[-1]: task.moves})
        session.frames()
        used_s += time.process_time() - begin
        simulated_s += session.time_ns / 1e9
        n_good += done.n_good
        n_collisions += done.n_collisions
        n_whole += done.why is None
        offsets += offsets_mm(session, task.moves)
        if done.why is not None:
            reasons[f"seed {seed}: {done.why}"] += 1
    print(
        f"{robot}, {name}: {simulated_s / used_s:.0f} x real time per core "
        f"({simulated_s:.0f} s in {used_s:.1f} s), "
        f"opening a scene {1e3 * float(np.median(opened_s)):.0f} ms\n"
        f"  whole {share(n_whole, len(seeds))}; cubes {share(n_good, len(seeds) * len(task.moves))}\n"
        f"  unwanted contacts {n_collisions}; off by {np.median(offsets):.2f} mm in the median, "
        f"{max(offsets):.2f} mm at most"
    )
    for reason in reasons:
        print(f"  {reason}")


def shares(scene: SceneSpec) -> dict[str, Moves]:
    """Two towers of two: the two leftmost cubes are the left hand's."""
    names = [each.name for each in sorted(scene.objects, key=lambda each: each.position_xyz_m[1])]
    return {"Right_hand": ((names[0], names[1]),), "Left_hand": ((names[2], names[3]),)}


def measure_two_arms(robot: str, seeds: range) -> None:
    """Each arm its share at once, against one arm that does both in the same scenes."""
    n_whole, n_alone, n_far, n_collisions = 0, 0, 0, 0
    ratios: list[float] = []
    reasons = []
    for seed in seeds:
        scene = random_scene(cube_names(4), seed=seed)
        moves = shares(scene)
        session = open_session(scene, f"{robot}_dual", seed=seed)
        places = {each.name: each.position_xyz_m for each in scene.objects}
        if any(
            session.can_reach(hand, places[name]) is not None
            for hand, each in moves.items()
            for pair in each
            for name in pair
        ):
            n_far += 1
            continue
        both = carry_out(session, moves)
        one = carry_out(
            open_session(scene, robot, seed=seed),
            {"Right_hand": [pair for each in moves.values() for pair in each]},
        )
        n_collisions += both.n_collisions
        n_whole += both.why is None
        n_alone += one.why is None
        if both.why is not None:
            reasons.append(f"  seed {seed}: {both.why}")
        if both.why is None and one.why is None:
            ratios.append(one.makespan_s / both.makespan_s)
    n = len(seeds) - n_far
    print(
        f"{robot}_dual, two towers: {share(n_whole, n)}; {n_far} further scenes in which an arm does not "
        f"reach its share\n  one arm alone {share(n_alone, n)}; unwanted contacts with two {n_collisions}\n"
        f"  two arms are done {np.median(ratios):.2f} times as soon in the median "
        f"({min(ratios):.2f} to {max(ratios):.2f}, n = {len(ratios)})"
    )
    for reason in reasons:
        print(reason)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=["gripper", "tiago"], help=", ".join(ROBOTS))
    parser.add_argument("--task", action="append", choices=sorted(TASKS))
    parser.add_argument(
        "--two-arms", action="store_true", help="Compare with the dual variant of each robot."
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    chosen = parser.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    for robot in chosen.robots:
        if chosen.two_arms:
            measure_two_arms(robot, seeds)
            continue
        for task in chosen.task or ["tower-of-three"]:
            measure(robot, task, seeds)
            sys.stdout.flush()


if __name__ == "__main__":
    main()
