"""Learning from logged demonstrations: under noise, as demonstrations grow in number, and how fast.

Run: ``PYTHONPATH=src python benchmarks/learning.py noise|growth|speed [options]``.

``noise``: the twelve shipped demonstrations, read and perceived as the product does; then activities are
misnamed, and readings flipped (each atom that types allow, at each end of an activity) or intervals of facts
dropped and invented. A domain is learned from what is left and has to solve the dataset's four goals by plans
that keep to the laws of the tabletop. Beside ours stand the paper's way (an operator whenever unlike any
other, a count otherwise) and a majority vote over the same groups that ours starts from.

``growth``: operators and literals as demonstrations grow in number. Simulated participants take minutes for
a thousand, so these demonstrations are made of symbols by the tests' generator, with the jitter, hesitations
and missed segments of real ones; no physics.

``speed``: a million transitions, which are the symbolic ones repeated under other names, each chunk with
misreadings of its own if asked for; processor time and peak memory of a process that does nothing else.
"""

import argparse
import importlib.util
import json
import random
import resource
import statistics
import subprocess
import sys
import time
from collections import Counter
from functools import cache
from pathlib import Path

import polars as pl

from demoplan.engines.fast_downward import SolveParams, solve
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter
from demoplan.language.goals import parse_goal
from demoplan.language.possibility import impossibility
from demoplan.logs import read
from demoplan.manifests.labels import activities_of_labels
from demoplan.pipeline.datasets import open_dataset
from demoplan.stages.align import AlignParams, align
from demoplan.stages.ask import ask, state_at
from demoplan.stages.compose import compose
from demoplan.stages.contrast import contrast
from demoplan.stages.learn import learn
from demoplan.stages.learn.bind import bind_roles
from demoplan.stages.learn.encode import encode
from demoplan.stages.learn.lift import AFTER, BEFORE, lift
from demoplan.stages.learn.merge import covering_types, universe
from demoplan.stages.learn.params import LearnParams
from demoplan.stages.learn.relevance import LOGGED
from demoplan.stages.learn.settle import settle
from demoplan.stages.perceive import perceive
from demoplan.tables import Activities, Facts, Transitions

ROOT = Path(__file__).resolve().parents[1]
DATASET = ROOT / "datasets" / "cube-stacking"
METHODS = ("ours", "paper: keep all", "majority vote")


@cache
def symbols():
    """The tests' generator of symbolic demonstrations, so that there is one of it."""
    path = ROOT / "tests" / "stages" / "learn" / "conftest.py"
    spec = importlib.util.spec_from_file_location("symbolic_demonstrations", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def shipped():
    """Activities and facts of the shipped demonstrations, the mapping's entities, and the vocabulary."""
    opened = open_dataset(DATASET)
    mapping, vocabulary = opened.dataset.mapping, opened.vocabulary
    activities, facts = [], []
    for episode in opened.dataset.episodes:
        reading = read(opened.log_of(episode), mapping, episode.id, definitions_root=opened.folder)
        frames = align(reading.samples, mapping, AlignParams(tick_rate_hz=opened.dataset.tick_rate_hz))
        facts.append(perceive(frames, mapping.entities, vocabulary))
        labels = json.loads(opened.labels_of(episode).read_text(encoding="utf-8"))
        activities.append(
            activities_of_labels(labels, opened.dataset.label_format, episode.id, reading.samples)
        )
    entities = {name: entity.type for name, entity in mapping.entities.items()}
    return opened, pl.concat(activities), pl.concat(facts), entities


def misread_intervals(facts, entities, share, seed):
    """Facts of which a share is dropped, and as many are invented, as long as others are."""
    rng = random.Random(seed)
    universe_ = [Atom.parse(text) for text in symbols().every_atom(sorted(entities.items()))]
    kept, invented = [], []
    for (episode,), rows in facts.group_by("episode_id", maintain_order=True):
        low, high = rows["start_ns"].min(), rows["end_ns"].max()
        spans = (rows["end_ns"] - rows["start_ns"]).to_list()
        taken = {}
        for row in rows.iter_rows(named=True):
            if rng.random() >= share:
                kept.append(row)
                key = Atom(row["predicate"], tuple(row["arguments"]))
                taken.setdefault(key, []).append((row["start_ns"], row["end_ns"]))
        for _ in range(round(share * rows.height)):
            atom, span = rng.choice(universe_), rng.choice(spans)
            start = rng.randrange(low, max(high - span, low + 1))
            end = min(start + span, high)
            if all(end <= first or last <= start for first, last in taken.get(atom, [])):
                taken.setdefault(atom, []).append((start, end))
                invented.append(
                    {
                        "episode_id": episode,
                        "predicate": atom.predicate,
                        "arguments": list(atom.arguments),
                        "start_ns": start,
                        "end_ns": end,
                        "value": "true",
                    }
                )
    return Facts.validate(pl.DataFrame(kept + invented, schema=facts.schema))


def by_ours(transitions, vocabulary):
    predicates = [rule.signature for rule in vocabulary.predicates]
    learned = learn(transitions, vocabulary.types, predicates)
    return compose(learned.operators, learned.literals, vocabulary.types, predicates, "ours")


def lifted(transitions, vocabulary):
    """Bound and lifted as ours are, without anything mended."""
    predicates = [rule.signature for rule in vocabulary.predicates]
    data = encode(transitions, vocabulary.types, predicates)
    settled = settle(data, vocabulary.types, LearnParams())
    return lift(data, bind_roles(data, settled, LearnParams()), settled, LearnParams())


def operator_of(name, types, before, after, variables, count):
    """An operator from (atom, is true) pairs that hold before and after it."""

    def literal(atom, is_positive):
        return Literal(Atom(atom.predicate, tuple(variables[place] for place in atom.variables)), is_positive)

    changed = {(atom, sign) for atom, sign in after if (atom, not sign) in before}
    atoms = {atom for atom, _ in changed}
    stated = {
        (atom, sign)
        for atom, sign in before
        if LOGGED.is_condition(atom, sign, atom in atoms) or (atom in atoms and sign)
    }
    effects = {each for each in changed if LOGGED.is_effect(each[0])}
    if not effects:
        return None
    return Operator(
        name=name,
        parameters=tuple(
            Parameter(variables[place], kind) for place, kind in enumerate(types) if kind is not None
        ),
        preconditions=frozenset(literal(*each) for each in stated),
        effects=frozenset(literal(*each) for each in effects),
        count=count,
    )


def domain_with(operators, vocabulary, name):
    predicates = sorted(rule.signature for rule in vocabulary.predicates)
    unlike = {}
    for each in operators:
        if each is not None:
            key = (each.parameters, each.preconditions, each.effects)
            unlike[key] = unlike.get(key, 0) + each.count
    return Domain(
        name=name,
        types=vocabulary.types,
        predicates=tuple(predicates),
        operators=tuple(
            Operator(f"o_{number}", *key, count=count) for number, (key, count) in enumerate(unlike.items())
        ),
    )


def by_keeping_all(transitions, vocabulary):
    found = lifted(transitions, vocabulary)
    predicates = [rule.signature for rule in vocabulary.predicates]
    operators = []
    for pattern in found.patterns:
        if pattern.is_uneventful:
            continue
        atoms = universe(pattern.types, vocabulary.types, predicates)
        before, after = ({(atom, atom in pattern.true[side]) for atom in atoms} for side in (BEFORE, AFTER))
        operators.append(operator_of("o", pattern.types, before, after, found.variables, pattern.count))
    return domain_with(operators, vocabulary, "all")


def by_vote(transitions, vocabulary):
    found = lifted(transitions, vocabulary)
    predicates = [rule.signature for rule in vocabulary.predicates]
    columns = list(zip(*(pattern.types for pattern in found.patterns), strict=True))
    covers = [covering_types({kind for kind in column if kind}, vocabulary.types) for column in columns]
    groups = {}
    for pattern in found.patterns:
        if not pattern.is_uneventful:
            kinds = tuple(
                cover[kind] if kind else None for kind, cover in zip(pattern.types, covers, strict=True)
            )
            groups.setdefault((pattern.activity, pattern.grip, kinds), []).append(pattern)
    operators = []
    for (_, _, kinds), members in sorted(groups.items(), key=repr):
        total = sum(each.count for each in members)
        sides = []
        for side in (BEFORE, AFTER):
            votes = Counter()
            for each in members:
                for atom in each.true[side]:
                    votes[atom] += each.count
            atoms = universe(kinds, vocabulary.types, predicates)
            sides.append({(atom, 2 * votes[atom] > total) for atom in atoms})
        operators.append(operator_of("o", kinds, *sides, found.variables, total))
    return domain_with(operators, vocabulary, "vote")


def solved_goals(domain, goals, start, objects, wall_s):
    """How many goals are reached by a plan that keeps to the laws of the tabletop."""
    n = 0
    for goal in goals:
        wanted = parse_goal(goal, domain.predicates, objects, domain.types)
        problem = ask(domain, start, objects, wanted, "problem")
        attempt = solve(domain, problem, SolveParams(wall_s=wall_s))
        if attempt.is_validated and impossibility(problem, domain, attempt.plan) is None:
            n += 1
    return n


def wilson(k, n, z=1.96):
    """95 % interval of a share."""
    share, base = k / n, 1 + z * z / n
    middle = (share + z * z / (2 * n)) / base
    half = z * (share * (1 - share) / n + z * z / (4 * n * n)) ** 0.5 / base
    return middle - half, middle + half


def size_of(domain):
    return len(domain.operators), sum(len(o.preconditions) + len(o.effects) for o in domain.operators)


def measure_noise(arguments):
    opened, activities, facts, entities = shipped()
    vocabulary = opened.vocabulary
    first = activities.filter(pl.col("episode_id") == "p1-one-left")
    start = state_at(Facts.validate(facts), "p1-one-left", first["start_ns"].min())
    goals = [goal.goal for goal in opened.dataset.goals]
    makers = dict(zip(METHODS, (by_ours, by_keeping_all, by_vote), strict=True))
    clean = contrast(Activities.validate(activities), Facts.validate(facts), entities)
    print(
        "| noise | method | domains that solve all 4 goals | 95 % interval | goals | operators | literals |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |", flush=True)
    for names, share, where in arguments.levels:
        tables = []
        for seed in range(arguments.seeds if names or share else 1):
            noisy = clean
            if where == "intervals" and share:
                changed = misread_intervals(facts, entities, share, seed)
                noisy = contrast(Activities.validate(activities), changed, entities)
            flips = share if where == "readings" else 0.0
            tables.append(symbols().corrupted(noisy, seed, flips, names) if names or flips else noisy)
        for method in METHODS:
            domains = [makers[method](each, vocabulary) for each in tables]
            reached = [solved_goals(each, goals, start, entities, arguments.wall_s) for each in domains]
            sizes = [size_of(each) for each in domains]
            n, k = len(domains), sum(each == len(goals) for each in reached)
            low, high = wilson(k, n)
            print(
                f"| {names:.0%} misnamed, {share:.0%} of {where} wrong | {method} | {k}/{n} "
                f"| {low:.2f} to {high:.2f} | {sum(reached)}/{len(goals) * n} "
                f"| {statistics.median(each[0] for each in sizes):g} "
                f"| {statistics.median(each[1] for each in sizes):g} |",
                flush=True,
            )


def measure_growth(arguments):
    made = symbols()
    vocabulary = open_dataset(DATASET).vocabulary
    print("| demonstrations | noise | method | transitions | operators | literals | goals |")
    print("| --- | --- | --- | --- | --- | --- | --- |", flush=True)
    for n in arguments.demonstrations:
        clean = made.transitions_of(*made.study("growth", participants=n // 4).values())
        for noise, table in (("none", clean), ("10 %, 5 %", made.corrupted(clean, n))):
            for method, maker in zip(METHODS, (by_ours, by_keeping_all, by_vote), strict=True):
                domain = maker(table, vocabulary)
                problems = [made.problem_of(domain, kind, random.Random(f"{n}{kind}")) for kind in made.GOALS]
                reached = 0
                for problem in problems:
                    attempt = solve(domain, problem, SolveParams(wall_s=arguments.wall_s))
                    reached += attempt.is_validated and impossibility(problem, domain, attempt.plan) is None
                operators, literals = size_of(domain)
                print(
                    f"| {n} | {noise} | {method} | {table.height} | {operators} | {literals} "
                    f"| {reached}/{len(problems)} |",
                    flush=True,
                )


def million(n, flips):
    """So many transitions: a few hundred symbolic demonstrations, again and again under other names."""
    made = symbols()
    base = made.transitions_of(*made.study("speed", participants=100).values())
    if flips:
        base = made.corrupted(base, 1, flips)
    copies = -(-n // base.height)
    table = pl.concat(
        [
            base.with_columns(episode_id=pl.format("{}_{}", pl.lit(f"{copy:05}"), "episode_id"))
            for copy in range(copies)
        ]
    )
    return Transitions.validate(table.head(n))


def measure_speed(arguments):
    if not arguments.alone:
        print(
            "| transitions | misread | table [MB] | learning, wall [s] | processor [s] | peak memory [MB] "
            "| operators |"
        )
        print("| --- | --- | --- | --- | --- | --- | --- |", flush=True)
        for n in arguments.transitions:
            for flips in arguments.flips:
                command = [sys.executable, __file__, "speed", "--alone"]
                subprocess.run([*command, "--transitions", str(n), "--flips", str(flips)], check=True)
        return
    (n,), (flips,) = arguments.transitions, arguments.flips
    table = million(n, flips)
    vocabulary = open_dataset(DATASET).vocabulary
    wall, usage = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
    domain = by_ours(table, vocabulary)
    spent = resource.getrusage(resource.RUSAGE_SELF)
    processor = spent.ru_utime + spent.ru_stime - usage.ru_utime - usage.ru_stime
    print(
        f"| {n} | {flips:.0%} | {table.estimated_size('mb'):.0f} | {time.perf_counter() - wall:.1f} "
        f"| {processor:.1f} | {spent.ru_maxrss / 1024:.0f} | {len(domain.operators)} |",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    noise = commands.add_parser("noise")
    noise.add_argument("--seeds", type=int, default=30)
    growth = commands.add_parser("growth")
    growth.add_argument("--demonstrations", type=int, nargs="+", default=[12, 100, 1000])
    speed = commands.add_parser("speed")
    speed.add_argument("--transitions", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    speed.add_argument("--flips", type=float, nargs="+", default=[0.0, 0.05])
    speed.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    for each in (noise, growth):
        each.add_argument("--wall-s", type=float, default=10.0)
    arguments = parser.parse_args()
    arguments.levels = [
        (0.0, 0.0, "readings"),
        (0.1, 0.05, "readings"),
        (0.1, 0.05, "intervals"),
        (0.2, 0.1, "readings"),
    ]
    {"noise": measure_noise, "growth": measure_growth, "speed": measure_speed}[arguments.command](arguments)


if __name__ == "__main__":
    main()
