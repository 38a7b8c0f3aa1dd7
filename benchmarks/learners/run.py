"""Learners side by side on public domains: same traces, same flips, same problems.

``python benchmarks/learners/run.py --source AMLGYM/benchmarks --peers-python PEERS/bin/python --work FOLDER``
(README.md says how to get them). Results are added to ``FOLDER/results.jsonl``, one row per learner, domain,
rate and seed; what is there already is not done again.
"""

import argparse
import json
import random
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

import cases
import reference
import scoring
from vote import vote

PEERS = ("NOLAM", "OffLAM", "SAM")
MEASURES = ("solved", "syntactic_f1", "applicability_f1", "effects_f1", "learn_s")


def learn(name: str, case: Path, out: Path, rate: float, peers_python: Path, limit_s: int) -> float | None:
    """Seconds that a learner took, without start-up; nothing if it failed."""
    start = time.perf_counter()
    if name == "vote":
        out.write_text(vote(case))
        return time.perf_counter() - start
    if name == "demoplan":
        from demoplan.pipeline.domains.learn_traces import learn_traces  # noqa: PLC0415

        report = learn_traces(case, out)
        return report.read_s + report.learn_s
    # Peers do not change between runs of this script, so what they learned once is kept.
    taken, failed = out.with_suffix(".seconds"), out.with_suffix(".failed")
    if taken.exists():
        return float(taken.read_text())
    if failed.exists():
        return None
    script = Path(__file__).with_name("learn_peer.py")
    try:
        done = subprocess.run(
            [peers_python, script, name, case, out, str(rate)],
            capture_output=True, text=True, timeout=limit_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        failed.write_text(f"stopped after {limit_s} s\n")
        return None
    if done.returncode != 0 or not out.exists():
        failed.write_text(done.stderr[-2000:])
        return None
    taken.write_text(done.stdout.split()[-1])
    return float(taken.read_text())


def score(out: Path, domain: str, source: Path, args: argparse.Namespace) -> dict[str, float]:
    """All measures of one learned domain; zeros if it cannot be read."""
    model = reference.read_domain(source / "domains" / f"{domain}.pddl")
    try:
        learned = reference.read_domain(out)
    except (IndexError, KeyError, OSError, StopIteration, ValueError):
        return dict.fromkeys(MEASURES[:-1], 0.0)
    problems = sorted((source / "problems/solving" / domain).glob("*.pddl"))
    problems = problems[:: max(1, len(problems) // args.problems)][: args.problems]
    states = source / "states/predictive_power_fast" / domain / "test_states.json"
    foretold = scoring.predictive(
        learned, model, states, source / "problems/predictive_power" / domain, args.states
    )
    return {
        "solved": scoring.solved(out.read_text(), model, problems, args.seconds, args.work / "plans"),
        "syntactic_f1": scoring.f1(*scoring.syntactic(learned, model)),
        "applicability_f1": scoring.f1(*foretold["applicability"]),
        "effects_f1": scoring.f1(*foretold["effects"]),
    }


def table(rows: list[dict], names: list[str], rates: list[float]) -> str:
    """Means over domains and seeds, with n, and the 95 % interval of what was solved (bootstrap)."""
    lines = [
        "| flips | learner | n | solved | 95 % | syntactic F1 | applicability F1 | effects F1 | s | failed |"
    ]
    lines.append("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    grouped = defaultdict(list)
    for row in rows:
        grouped[row["rate"], row["learner"]].append(row)
    for rate in rates:
        for name in names:
            group = grouped[rate, name]
            if not group:
                continue
            solved = [row["solved"] for row in group]
            low, high = interval(solved)
            means = [statistics.fmean(row[key] for row in group) for key in MEASURES[1:-1]]
            seconds = [row["learn_s"] for row in group if row["learn_s"] is not None]
            middle = f"{statistics.median(seconds):.2f}" if seconds else "–"
            lines.append(
                f"| {rate:.0%} | {name} | {len(group)} "
                f"| {statistics.fmean(solved):.1%} | {low:.0%}–{high:.0%} | "
                + " | ".join(f"{mean:.3f}" for mean in means)
                + f" | {middle} | {len(group) - len(seconds)} |"
            )
    return "\n".join(lines)


def interval(values: list[float], n_draws: int = 4000) -> tuple[float, float]:
    """Where 95 % of the means of as many values lie, drawn from these with replacement."""
    draw = random.Random(0)
    means = sorted(statistics.fmean(draw.choices(values, k=len(values))) for _ in range(n_draws))
    return means[round(0.025 * n_draws)], means[round(0.975 * n_draws) - 1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--source", type=Path, required=True, help="amlgym's benchmarks folder")
    parser.add_argument(
        "--work", type=Path, required=True, help="folder for cases, learned domains, plans, results"
    )
    parser.add_argument(
        "--peers-python", type=Path, help="interpreter that has amlgym; without it no peers run"
    )
    parser.add_argument("--learners", default="demoplan,vote,NOLAM,OffLAM,SAM")
    parser.add_argument("--domains", default="", help="comma-separated; all that ship traces if empty")
    parser.add_argument("--rates", default="0,0.01,0.05,0.1,0.2")
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--problems", type=int, default=10, help="test problems per domain")
    parser.add_argument("--states", type=int, default=60, help="held-out states per domain")
    parser.add_argument("--seconds", type=int, default=60, help="planner's limit per problem")
    parser.add_argument("--limit-s", type=int, default=600, help="a learner's limit per case")
    parser.add_argument("--again", action="store_true", help="learn and score again what is there already")
    args = parser.parse_args()
    names = [name for name in args.learners.split(",") if name not in PEERS or args.peers_python]
    rates = [float(rate) for rate in args.rates.split(",")]
    args.work.mkdir(parents=True, exist_ok=True)
    results = args.work / "results.jsonl"
    known = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
    rows = {(row["learner"], row["domain"], row["rate"], row["seed"]): row for row in known}
    domains = args.domains.split(",") if args.domains else list(cases.domains_with_traces(args.source))
    seeds = [int(seed) for seed in args.seeds.split(",")]
    for rate in rates:
        for seed in seeds:
            for domain in domains:
                case = cases.write_case(args.work / "cases", args.source, domain, rate, seed)
                for name in names:
                    key = (name, domain, rate, seed)
                    if key in rows and not args.again:
                        continue
                    out = args.work / "learned" / f"{name}-{case.name}.pddl"
                    out.parent.mkdir(exist_ok=True)
                    seconds = learn(name, case, out, rate, args.peers_python, args.limit_s)
                    measured = score(out, domain, args.source, args) if seconds is not None else {}
                    row = dict.fromkeys(MEASURES[:-1], 0.0) | measured | {"learn_s": seconds}
                    rows[key] = dict(zip(("learner", "domain", "rate", "seed"), key, strict=True)) | row
                    print(json.dumps(rows[key]), file=sys.stderr, flush=True)
                    with results.open("a") as file:
                        file.write(json.dumps(rows[key]) + "\n")
    wanted = [row for key, row in rows.items() if key[1] in domains and key[2] in rates and key[3] in seeds]
    print(table(wanted, names, rates))


main()
