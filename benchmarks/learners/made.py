"""Domains that ship no traces: worlds drawn at random and walked at random, in folders like the public data.

``python benchmarks/learners/made.py --source AMLGYM/benchmarks --out FOLDER --seed 0``; then ``run.py`` with
``--source FOLDER``. They serve to try a learner on what nobody developed it on. ``--own`` takes the domains
beside this file instead, which need no source, ``--avoiding`` those about rules and habits; ``--even`` walks
with every ground action equally likely, so that actions with few ways to do them are rare; ``--planned``
demonstrates plans for one goal after another, by who knows the rules and wastes no step.
"""

import argparse
import itertools
import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import reference
import scoring
from avoiding_worlds import AVOIDING, HABITS, Habit
from own_worlds import OWN, World


def hanoi(draw: random.Random) -> World:
    discs = [f"d{n}" for n in range(1, draw.randint(3, 5) + 1)]
    pegs = ["peg1", "peg2", "peg3"]
    # d1 is the smallest; everything is wider than it.
    state = {("smaller", peg, disc) for peg in pegs for disc in discs}
    state |= {("smaller", b, a) for a, b in itertools.combinations(discs, 2)}
    piles: dict[str, list[str]] = {peg: [] for peg in pegs}
    for disc in reversed(discs):
        piles[draw.choice(pegs)].append(disc)
    for peg, pile in piles.items():
        state |= {("on", top, below) for below, top in itertools.pairwise([peg, *pile])}
        state.add(("clear", [peg, *pile][-1]))
    return dict.fromkeys(discs, "disc") | dict.fromkeys(pegs, "table"), state, {"on"}


def grid(draw: random.Random) -> World:
    width, height = draw.randint(3, 4), draw.randint(2, 3)
    places = {(x, y): f"n{x}-{y}" for x in range(width) for y in range(height)}
    shapes, keys = ["circle", "star"], [f"key{n}" for n in range(1, draw.randint(2, 4) + 1)]
    state = {("arm_empty",)}
    for (x, y), name in places.items():
        for other in ((x + 1, y), (x, y + 1)):
            if other in places:
                state |= {("conn", name, places[other]), ("conn", places[other], name)}
    names = sorted(places.values())
    locked = set(draw.sample(names[1:], 2))
    for name in names:
        state.add(("locked" if name in locked else "open", name))
    state |= {("lock_shape", name, draw.choice(shapes)) for name in sorted(locked)}
    shape_of = dict(zip(keys, itertools.cycle(shapes), strict=False))
    state |= {("key_shape", key, shape) for key, shape in shape_of.items()}
    free = [name for name in names if name not in locked]
    state |= {("at", key, draw.choice(free)) for key in keys} | {("at_robot", draw.choice(free))}
    objects = dict.fromkeys(names, "place") | dict.fromkeys(keys, "key") | dict.fromkeys(shapes, "shape")
    return objects, state, {"at"}


def driverlog(draw: random.Random) -> World:
    places = [f"s{n}" for n in range(1, draw.randint(3, 5) + 1)]
    drivers, trucks = ["driver1", "driver2"], ["truck1", "truck2"]
    parcels = [f"package{n}" for n in range(1, draw.randint(2, 4) + 1)]
    state: set[reference.Fact] = {("empty", truck) for truck in trucks}
    for relation in ("link", "path"):
        order = draw.sample(places, len(places))
        pairs = [*itertools.pairwise(order), tuple(draw.sample(places, 2))]
        state |= {(relation, *pair) for one in pairs for pair in (one, one[::-1])}
    state |= {("at", thing, draw.choice(places)) for thing in (*drivers, *trucks, *parcels)}
    objects = dict.fromkeys(places, "location") | dict.fromkeys(drivers, "driver")
    return objects | dict.fromkeys(trucks, "truck") | dict.fromkeys(parcels, "obj"), state, {"at"}


def zenotravel(draw: random.Random) -> World:
    cities = [f"city{n}" for n in range(draw.randint(3, 4))]
    planes, people = ["plane1", "plane2"], [f"person{n}" for n in range(1, draw.randint(3, 4) + 1)]
    levels = [f"fl{n}" for n in range(5)]
    state: set[reference.Fact] = {("next", *pair) for pair in itertools.pairwise(levels)}
    state |= {("at", thing, draw.choice(cities)) for thing in (*planes, *people)}
    state |= {("fuel_level", plane, draw.choice(levels[1:])) for plane in planes}
    objects = dict.fromkeys(cities, "city") | dict.fromkeys(planes, "aircraft")
    return objects | dict.fromkeys(people, "person") | dict.fromkeys(levels, "flevel"), state, {"at"}


WORLDS: dict[str, Callable[[random.Random], World]] = {
    "driverlog": driverlog,
    "grid": grid,
    "hanoi": hanoi,
    "zenotravel": zenotravel,
}


def applicable(
    model: reference.Model, objects: dict[str, str], state: set[reference.Fact]
) -> dict[str, list[tuple[str, ...]]]:
    """Ground actions whose preconditions hold, by name."""
    found, objects = {}, objects | dict(model.constants)
    for name, action in model.actions.items():
        fitting = [model.objects_of(objects, kind) for _, kind in action.parameters]
        found[name] = [one for one in itertools.product(*fitting) if action.is_applicable(state, one)]
    return found


def walk(
    model: reference.Model,
    world: World,
    length: int,
    draw: random.Random,
    *,
    is_even: bool = False,
    habit: Habit | None = None,
) -> tuple[list[set[reference.Fact]], list[reference.Fact]]:
    """A random walk: an action's name first, so that rare ones are seen, then objects; or both at once.

    It ends early where nothing can be done.
    """
    objects, state, _ = world
    states, actions = [state], []
    for _ in range(length):
        options = {name: ways for name, ways in applicable(model, objects, states[-1]).items() if ways}
        if not options:
            break
        if is_even:
            name, arguments = draw.choice([(name, way) for name in sorted(options) for way in options[name]])
        else:
            name = draw.choice(sorted(options))
            ways = options[name]
            weights = [habit((name, *way), states[-1]) for way in ways] if habit else None
            arguments = draw.choices(ways, weights)[0] if habit else draw.choice(ways)
        states.append(model.actions[name].apply(states[-1], arguments))
        actions.append((name, *arguments))
    return states, actions


def errands(
    path: Path, world: World, length: int, draw: random.Random, cache: Path
) -> tuple[list[set[reference.Fact]], list[reference.Fact]]:
    """Plans for one small goal after another, as long as a walk; each goal can be reached by a walk."""
    model = reference.read_domain(path)
    objects, state, wanted = world
    states, actions = [state], list[reference.Fact]()
    cache.mkdir(exist_ok=True)
    constants = {name for name, _ in model.constants}
    for _ in range(length):
        ahead = walk(model, (objects, states[-1], wanted), 40, draw)[0][-1]
        new = sorted(fact for fact in ahead - states[-1] if fact[0] in wanted)
        goal = draw.sample(new, min(len(new), draw.randint(1, 3)))
        text = reference.problem_text("errand", model.name, objects, states[-1], constants)
        problem = cache / "errand.pddl"
        facts = " ".join(f"({' '.join(fact)})" for fact in goal)
        problem.write_text(text.replace("(and )", f"(and {facts})"))
        steps = scoring.plan(path.read_text(), problem, 60, cache) if goal else []
        for name, *arguments in steps if isinstance(steps, list) else []:
            states.append(model.actions[name].apply(states[-1], tuple(arguments)))
            actions.append((name, *arguments))
        if len(actions) >= length:
            break
    return states[: length + 1], actions[:length]


def make(
    path: Path,
    out: Path,
    draw_world: Callable[[random.Random], World],
    seed: int,
    *,
    is_even: bool,
    is_planned: bool,
) -> None:
    """Traces, problems and held-out states of one domain."""
    domain = path.stem
    (out / "domains").mkdir(parents=True, exist_ok=True)
    shutil.copy(path, out / "domains")
    model = reference.read_domain(path)
    draw = random.Random(f"{domain} {seed}")
    for kind in (
        "trajectories/learning",
        "problems/learning",
        "problems/solving",
        "problems/predictive_power",
    ):
        (out / kind / domain).mkdir(parents=True, exist_ok=True)
    tested = {}
    for number, length in enumerate((4, 6, 11, 14, 18, 20, 21, 23, 26, 29)):
        world = draw_world(draw)
        if is_planned:
            states, actions = errands(path, world, length, draw, out / "plans")
        else:
            states, actions = walk(model, world, length, draw, is_even=is_even, habit=HABITS.get(domain))
        (out / f"trajectories/learning/{domain}/{number}_{domain}_traj").write_text(
            reference.trace_text(states, actions)
        )
        text = reference.problem_text(f"p{number}", model.name, world[0], states[0], set())
        (out / f"problems/learning/{domain}/{number}_{domain}_prob.pddl").write_text(text)
        world = draw_world(draw)
        states, _ = walk(model, world, 40, draw)
        goal = " ".join(f"({' '.join(fact)})" for fact in sorted(states[-1]) if fact[0] in world[2])
        text = reference.problem_text(f"p{number}", model.name, world[0], states[0], set())
        name = f"{number}_{domain}_prob.pddl"
        (out / f"problems/solving/{domain}/{name}").write_text(text.replace("(and )", f"(and {goal})"))
        (out / f"problems/predictive_power/{domain}/{name}").write_text(text)
        tested[name] = {
            str(n): {
                "fluents": [f"({' '.join(fact)})" for fact in sorted(state)],
                "applicable_actions": applicable(model, world[0], state),
            }
            for n, state in enumerate(states[::8])
        }
    folder = out / "states/predictive_power_fast" / domain
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "test_states.json").write_text(json.dumps(tested))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--source", type=Path, help="amlgym's benchmarks folder")
    parser.add_argument("--own", action="store_true", help="domains beside this file")
    parser.add_argument(
        "--avoiding", action="store_true", help="domains beside this file, of rules and habits"
    )
    parser.add_argument("--planned", action="store_true", help="plans instead of walks")
    parser.add_argument("--even", action="store_true", help="every ground action equally likely")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if args.own + args.avoiding + (args.source is not None) != 1:
        parser.error("give one of --source, --own and --avoiding")
    folder = args.source or Path(__file__).parent
    worlds = OWN if args.own else AVOIDING if args.avoiding else WORLDS
    for domain, world in worlds.items():
        path = folder / "domains" / f"{domain}.pddl"
        make(path, args.out, world, args.seed, is_even=args.even, is_planned=args.planned)


main()
