"""Execution: how often goals are reached, and what faults do to which monitor.

Run, after ``demoplan run datasets/cube-stacking --store STORE``:

    PYTHONPATH=src python benchmarks/execution.py STORE [--robot gripper] [--seeds 10] [--first-seed 100]
        [--faults datasets/cube-stacking/faults.yaml] [--goals FILE] [--only GOAL …] [--workers 2] [--memory]

Without ``--faults``, the study: every single-demonstration domain and the combined one on every goal. With
it, the combined domain under every fault, watched by each monitor: the full one, conditions at dispatch only
(ROSPlan's way), and open loop. What was run before is taken from the store, so a run that was broken off goes
on, and more seeds cost only themselves.

Whether one can recover is decided for each case without any monitor, so all have the same denominators; it is
checked here that the fault of a case happened at the same instant whoever watched. Shares are given with 95 %
Wilson intervals. Wall times are of runs as they were made; on a busy machine they say little.

With ``--memory``, all runs of the combined domain are made anew in one process, as a worker of ``demoplan
evaluate`` makes them, and its largest resident memory so far is printed: a process that gives back what a run
took stays level.
"""

import argparse
import resource
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import polars as pl

from demoplan.manifests.faults import read_faults
from demoplan.manifests.goals import read_goals
from demoplan.pipeline.datasets import recall
from demoplan.pipeline.domains.learning import stored_domain
from demoplan.pipeline.execution.evaluate import RUN_STAGE, evaluate, jobs_of, run_job
from demoplan.pipeline.execution.execute import MONITORS
from demoplan.stages.score_runs import fault_confusion, score_runs
from demoplan.store import Store

CHECKOUT = Path(__file__).resolve().parents[1]
DATA = CHECKOUT / "datasets" / "cube-stacking"


def share(scores, metric, subject="all", method="monitor: full"):
    """A score as text: share, counts, interval; a dash without one."""
    found = scores.filter(
        (pl.col("metric") == metric) & (pl.col("subject") == subject) & (pl.col("method") == method)
    )
    if found.is_empty():
        return "–"
    row = found.row(0, named=True)
    return f"{row['value']:.1%} ({row['detail']}; {row['low']:.1%} to {row['high']:.1%})"


def study(runs):
    """Print how often goals are reached, by kind of domain, goal by goal."""
    combined = pl.col("domain_name").str.contains("--").not_()
    print("| domains | goal | reached (95 % interval) | unsound dispatches | runs with a false alarm |")
    print("| --- | --- | --- | --- | --- |")
    for kind, part in (("single", runs.filter(~combined)), ("combined", runs.filter(combined))):
        for goal in ["all", *sorted(part["goal"].unique())]:
            own = part if goal == "all" else part.filter(pl.col("goal") == goal)
            if own.height:
                scores = score_runs(own)
                print(
                    f"| {kind} | {goal} | {share(scores, 'goals reached')} | {own['n_unsound'].sum()} "
                    f"| {share(scores, 'runs with a false alarm')} |"
                )
    for row in runs.filter(~pl.col("is_goal_reached")).iter_rows(named=True):
        reason = (row["reason"] or "")[:150]
        print(
            f"  missed: {row['domain_name']}, {row['goal']}, seed {row['seed']}: {row['outcome']}: {reason}"
        )


def faults(runs):
    """Print what faults do to which monitor."""
    scores = score_runs(runs)
    faulty = runs.filter(pl.col("fault").is_not_null())
    keys = ["domain_name", "goal", "seed", "fault"]
    instants = faulty.group_by(keys).agg(n=pl.col("fault_ns").n_unique())
    n_alike = instants.filter(pl.col("n") == 1).height
    print(
        f"\nthe fault happened at the same instant for every monitor in {n_alike} of {instants.height} cases"
    )
    able = faulty.unique(keys).group_by("is_recoverable").len().sort("is_recoverable")
    print("one can recover:", ", ".join(f"{value}: {n}" for value, n in able.iter_rows()), "cases\n")
    print("| monitor | recovered | class named rightly | fault-free: reached | with a false alarm |")
    print("| --- | --- | --- | --- | --- |")
    for monitor in MONITORS:
        method = f"monitor: {monitor}"
        cells = [
            share(scores, metric, method=method)
            for metric in ("recovered", "class named rightly", "goals reached", "runs with a false alarm")
        ]
        print(f"| {monitor} | {' | '.join(cells)} |")
    print("\n| fault | can recover | full | preconditions | none | class, full |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in faulty["fault"].unique(maintain_order=True):
        own = faulty.filter(pl.col("fault") == name)
        n = own.unique(keys)["is_recoverable"].sum()
        cells = []
        for monitor in MONITORS:
            part = own.filter(pl.col("is_recoverable") & (pl.col("monitor") == monitor))
            cells.append(f"{part['is_goal_reached'].sum()}/{part.height}")
        named = share(scores, "class named rightly", f"fault: {name}")
        print(f"| {name} | {n}/{own.unique(keys).height} | {' | '.join(cells)} | {named.split(' (')[0]} |")
    print("\ntrue class → named:")
    for truth, named, n in fault_confusion(runs).iter_rows():
        print(f"  {truth} → {named}: {n}")
    missed = faulty.filter(pl.col("is_recoverable") & ~pl.col("is_goal_reached"))
    for row in missed.filter(pl.col("monitor") == "full").iter_rows(named=True):
        reason = (row["reason"] or "")[:170]
        print(f"  missed: {row['goal']}, {row['fault']}, seed {row['seed']}: {row['outcome']}: {reason}")


def memory(jobs):
    """Print how much memory a process has taken after so many runs."""
    print("| runs | largest resident memory so far, MB |")
    print("| --- | --- |")
    shown = {0, 1, 2, 5, 10, 30, 60, len(jobs), *range(100, len(jobs), 100)}
    with tempfile.TemporaryDirectory() as folder:
        for n, job in enumerate([None, *jobs]):
            if job is not None:
                run_job(replace(job, store=folder))
            if n in shown:
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                print(f"| {n} | {peak:.0f} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("--dataset", default="cube-stacking")
    parser.add_argument("--robot", default="gripper")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--goals", type=Path, default=DATA / "goals.yaml")
    parser.add_argument("--only", nargs="+", help="names of goals")
    parser.add_argument("--faults", type=Path)
    parser.add_argument("--fault", nargs="+", help="names of faults")
    parser.add_argument("--monitors", nargs="+", choices=MONITORS, default=MONITORS)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--memory", action="store_true", help="runs in one process, and what it grows to")
    chosen = parser.parse_args()
    store = Store(chosen.store)
    names = sorted({version.name for version in store.domains.versions()})
    wanted = (
        [chosen.dataset]
        if chosen.faults or chosen.memory
        else [n for n in names if n.startswith(chosen.dataset)]
    )
    goals = [goal for goal in read_goals(chosen.goals) if not chosen.only or goal.name in chosen.only]
    injected = read_faults(chosen.faults) if chosen.faults else ()
    jobs = jobs_of(
        store,
        [(name, stored_domain(store, name).text) for name in wanted],
        goals,
        vocabulary=recall(store, chosen.dataset).vocabulary,
        seeds=range(chosen.first_seed, chosen.first_seed + chosen.seeds),
        robot=chosen.robot,
        faults=[None, *(fault for fault in injected if not chosen.fault or fault.name in chosen.fault)],
        monitors=chosen.monitors if chosen.faults else ("full",),
        folder=chosen.goals.parent,
    )
    if chosen.memory:
        memory(jobs)
        return
    n_stored = sum(store.is_current(RUN_STAGE, *job.key()) for job in jobs)
    begin = time.perf_counter()
    runs = evaluate(jobs, n_workers=chosen.workers).runs
    wall_s = time.perf_counter() - begin
    print(
        f"{chosen.robot}: {len(wanted)} domains × {len(goals)} goals × {chosen.seeds} seeds from "
        f"{chosen.first_seed}: {len(jobs)} runs, {n_stored} of them from the store; "
        f"{wall_s:.0f} s on {chosen.workers} processes\n"
    )
    study(runs.filter(pl.col("fault").is_null() & (pl.col("monitor") == "full")))
    if chosen.faults:
        faults(runs)
    times = store.timings.of(RUN_STAGE)
    found = [store.find(RUN_STAGE, *job.key()) for job in jobs]
    known = [times[record.key] for record in found if record is not None and record.key in times]
    simulated = statistics.median(runs["simulated_s"])
    print(
        f"\na run: {statistics.median(runs['n_steps']):.0f} steps, {simulated:.1f} simulated seconds"
        + (f", {statistics.median(known):.2f} s of wall time" if known else "")
        + " in the median"
    )


if __name__ == "__main__":
    main()
