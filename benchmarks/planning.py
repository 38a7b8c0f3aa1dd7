"""Planning: how long a problem takes beyond the planner's own search, and how far the searches reach.

Run: ``PYTHONPATH=src python benchmarks/planning.py [--cubes 3 4 5 6 8 10 15] [--seeds 3]``.

Each problem builds random towers out of random towers with the hand-written stacking domain of the tests (two
hands, seven operators). Overhead is everything that ``solve`` takes but for the time that the search program
says it searched: rendering, both programs' starts, translation, reading and checking the plan. Figures are
medians over problems; on a busy machine processor time is the one to compare.
"""

import argparse
import random
import re
import resource
import statistics
import time
from pathlib import Path
from unittest import mock

from demoplan.engines.fast_downward import FIRST, OPTIMAL, SolveParams, processes, solve
from demoplan.engines.fast_downward import solve as solve_function
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Problem
from demoplan.language.pddl import parse_domain

DOMAIN = parse_domain(
    (Path(__file__).parents[1] / "tests" / "golden" / "planning" / "stacking-domain.pddl").read_text()
)
HANDS = ("Left_hand", "Right_hand")
_SEARCH_TIME = re.compile(r"Search time: ([\d.]+)s")


def towers(names, chance):
    """Random towers of all the names: (cube, what it is on) pairs, and the cubes on top."""
    piles = []
    for name in chance.sample(names, len(names)):
        if piles and chance.random() < 0.7:
            chance.choice(piles).append(name)
        else:
            piles.append([name])
    on = [(cube, below) for pile in piles for cube, below in zip(pile, ["table", *pile], strict=False)]
    return on, [pile[-1] for pile in piles]


def random_problem(n_cubes, seed):
    """Towers to be built out of towers."""
    chance = random.Random(seed)
    names = [f"cube_{number:02}" for number in range(n_cubes)]
    (start, clear), (goal, _) = towers(names, chance), towers(names, chance)
    facts = {Atom("handOpen", (hand,)) for hand in HANDS}
    facts |= {Atom("onTop", pair) for pair in start} | {Atom("clear", (name,)) for name in clear}
    objects = [
        *((hand, "Hand") for hand in HANDS),
        *((name, "WoodenCube") for name in names),
        ("table", "Table"),
    ]
    return Problem(
        f"towers-{n_cubes}-{seed}",
        DOMAIN.name,
        tuple(sorted(objects)),
        frozenset(facts),
        frozenset(Literal(Atom("onTop", pair)) for pair in goal),
    )


def processor_s():
    """Processor time of this process and of its children so far [s]."""
    usages = (resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def timed(problem, params, searches):
    """The attempt, its wall time, its processor time, and how long the search says it searched [s]."""
    outputs = []

    def listen(*arguments, **options):
        ended = processes.run_limited(*arguments, **options)
        outputs.append(ended.output)
        return ended

    with mock.patch.object(__import__("sys").modules[solve_function.__module__], "run_limited", listen):
        start, start_cpu = time.perf_counter(), processor_s()
        attempt = solve(DOMAIN, problem, params, searches=searches)
        wall_s, cpu_s = time.perf_counter() - start, processor_s() - start_cpu
    said = [float(match[1]) for output in outputs if (match := _SEARCH_TIME.search(output))]
    return attempt, wall_s, cpu_s, sum(said)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cubes", type=int, nargs="+", default=[3, 4, 5, 6, 8, 10, 15])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--wall-s", type=float, default=30.0)
    arguments = parser.parse_args()
    params = SolveParams(wall_s=arguments.wall_s)
    print(
        "| cubes | search | solved | wall [s] | translate [s] | beyond search, wall [s] "
        "| beyond search, processor [s] | mean cost |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for n_cubes in arguments.cubes:
        problems = [random_problem(n_cubes, 100 + seed) for seed in range(arguments.seeds)]
        for label, searches in (("default", None), ("cheapest", (OPTIMAL,)), ("any", (FIRST,))):
            if label == "cheapest" and n_cubes > 6:
                continue
            runs = [timed(problem, params, searches) for problem in problems]
            solved = [run for run in runs if run[0].is_validated]
            costs = [run[0].plan.cost for run in solved]
            print(
                f"| {n_cubes} | {label} | {len(solved)}/{len(runs)} "
                f"| {statistics.median(run[1] for run in runs):.3f} "
                f"| {statistics.median(run[0].translate_s for run in runs):.3f} "
                f"| {statistics.median(run[1] - run[3] for run in runs):.3f} "
                f"| {statistics.median(run[2] - run[3] for run in runs):.3f} "
                f"| {statistics.mean(costs) if costs else '–'} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
