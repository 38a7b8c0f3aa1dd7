"""Planning: what a problem costs beyond the planner's own search, and how far the searches reach.

Run: ``PYTHONPATH=src python benchmarks/planning.py [--cubes 3 4 5 6 8 10 15] [--seeds 10] [--reach]``.

Each problem builds random towers out of random towers with the hand-written stacking domain of the tests (two
hands, seven operators). Everybody gets the same PDDL and the same search, the first iteration of LAMA:

- **demoplan**: ``solve``, from domain and problem values to a checked plan; the translator is kept warm;
- **cold**: the same with a Python process for each translation;
- **driver**: Fast Downward's own driver on two files, its plan not read;
- **unified-planning**: its reader and its Fast Downward engine, on the same two files, if it is installed.

Overhead is all that is used, by us and by every program started, but for the time that the search program
says it took in all. Processor time is a mean over problems, with the one start of the warm translator and its
practice in it; wall time is a median, and says little on a busy machine.
"""

import argparse
import contextlib
import importlib
import importlib.util
import os
import random
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

from demoplan.engines.fast_downward import (
    FIRST,
    OPTIMAL,
    SolveParams,
    close_translators,
    find_installation,
    processes,
    solve,
    translating,
)
from demoplan.engines.fast_downward import solve as solve_function
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Problem
from demoplan.language.pddl import parse_domain, render_domain, render_problem

DOMAIN = parse_domain(
    (Path(__file__).parents[1] / "tests" / "golden" / "planning" / "stacking-domain.pddl").read_text()
)
HANDS = ("Left_hand", "Right_hand")
_SEARCH_TIME = re.compile(r"Total time: ([\d.]+)s")
SOLVE = sys.modules[solve_function.__module__]


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


def said_in(outputs):
    """How long the search program says that it took [s]."""
    return sum(float(match[1]) for output in outputs for match in _SEARCH_TIME.finditer(output))


def ours(problem, searches=(FIRST,), params=SolveParams()):
    """Whether there is a plan, and how long the search says it searched [s]; the attempt itself."""
    outputs = []

    def listen(*arguments, **options):
        ended = processes.run_limited(*arguments, **options)
        outputs.append(ended.output)
        return ended

    with mock.patch.object(SOLVE, "run_limited", listen):
        attempt = solve(DOMAIN, problem, params, searches=searches)
    return attempt.is_validated, said_in(outputs), attempt


def cold(problem):
    with mock.patch.object(SOLVE, "translate", translating.translate_cold):
        return ours(problem)


def written(problem, folder):
    (folder / "domain.pddl").write_text(render_domain(DOMAIN))
    (folder / "problem.pddl").write_text(render_problem(problem, DOMAIN))


def driver(problem):
    program = find_installation().search.parents[3] / "fast-downward.py"
    with tempfile.TemporaryDirectory() as name:
        written(problem, Path(name))
        command = [sys.executable, program, "--alias", "lama-first", "domain.pddl", "problem.pddl"]
        ended = subprocess.run(command, cwd=name, capture_output=True, text=True, check=False)
    return ended.returncode == 0, said_in([ended.stdout]), None


def by_unified_planning(problem):
    shortcuts = importlib.import_module("unified_planning.shortcuts")
    reader = importlib.import_module("unified_planning.io").PDDLReader()
    shortcuts.get_environment().credits_stream = None
    with tempfile.TemporaryDirectory() as name, Path(os.devnull).open("w") as nothing:
        folder = Path(name)
        written(problem, folder)
        with contextlib.redirect_stdout(nothing), shortcuts.OneshotPlanner(name="fast-downward") as planner:
            read = reader.parse_problem(str(folder / "domain.pddl"), str(folder / "problem.pddl"))
            result = planner.solve(read)
    outputs = [message.message for message in result.log_messages or ()]
    return result.plan is not None, said_in(outputs), None


def overhead(all_cubes, n_problems):
    """Print what everybody takes beyond the search."""
    contenders = {"demoplan": ours, "cold": cold, "driver": driver}
    if importlib.util.find_spec("unified_planning") and importlib.util.find_spec("up_fast_downward"):
        contenders["unified-planning"] = by_unified_planning
    else:
        print("unified-planning is not installed: left out\n")
    print("| cubes | who | solved | search [s] | overhead, processor [s] | × | overhead, wall [s] |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for n_cubes in all_cubes:
        problems = [random_problem(n_cubes, 100 + seed) for seed in range(n_problems)]
        first_s = None
        for who, function in contenders.items():
            if who == "unified-planning":
                # What it does once for a process is not held against it.
                function(problems[0])
            close_translators()
            begin_s, walls, said, n_solved = processor_s(), [], [], 0
            for problem in problems:
                start = time.perf_counter()
                is_solved, search_s, _ = function(problem)
                walls.append(time.perf_counter() - start - search_s)
                said.append(search_s)
                n_solved += is_solved
            # What ran in a process shows here only once that has ended.
            close_translators()
            used_s = (processor_s() - begin_s - sum(said)) / n_problems
            first_s = first_s or used_s
            print(
                f"| {n_cubes} | {who} | {n_solved}/{n_problems} | {statistics.median(said):.3f} "
                f"| {used_s:.3f} | {used_s / first_s:.1f} | {statistics.median(walls):.3f} |",
                flush=True,
            )


def reach(all_cubes, n_problems, params):
    """Print how far each search reaches, and what its plans cost."""
    print("| cubes | search | solved | wall [s] | translate [s] | mean cost |")
    print("| --- | --- | --- | --- | --- | --- |")
    for n_cubes in all_cubes:
        problems = [random_problem(n_cubes, 100 + seed) for seed in range(n_problems)]
        for label, searches in (("default", None), ("cheapest", (OPTIMAL,)), ("any", (FIRST,))):
            if label == "cheapest" and n_cubes > 6:
                continue
            attempts, walls = [], []
            for problem in problems:
                start = time.perf_counter()
                attempts.append(ours(problem, searches, params)[2])
                walls.append(time.perf_counter() - start)
            costs = [attempt.plan.cost for attempt in attempts if attempt.is_validated]
            print(
                f"| {n_cubes} | {label} | {len(costs)}/{n_problems} | {statistics.median(walls):.3f} "
                f"| {statistics.median(attempt.translate_s for attempt in attempts):.3f} "
                f"| {statistics.mean(costs) if costs else '–'} |",
                flush=True,
            )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cubes", type=int, nargs="+", default=[3, 4, 5, 6, 8, 10, 15])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--wall-s", type=float, default=30.0)
    parser.add_argument("--reach", action="store_true", help="how far the searches reach, too")
    arguments = parser.parse_args()
    overhead(arguments.cubes, arguments.seeds)
    if arguments.reach:
        print()
        reach(arguments.cubes, arguments.seeds, SolveParams(wall_s=arguments.wall_s))


if __name__ == "__main__":
    main()
