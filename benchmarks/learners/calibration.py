"""How often literals are right that are said to be right with some probability: a reliability table.

``python benchmarks/learners/calibration.py --work WORK --source AMLGYM/benchmarks`` takes every case that
``run.py`` left in ``WORK/cases``, learns it, and looks each literal up. A condition counts as right if it
truly held before every instance of its action, which only the clean traces can tell: whether it was needed no
trace shows. An effect counts as right if the reference domain states it.
"""

import argparse
import math
from collections import defaultdict
from pathlib import Path

import reference

BINS = (0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0)


def held(source: Path, domain: str, model: reference.Model) -> dict[tuple[str, reference.Fact], int]:
    """How often each literal over an action's parameters was false before it, in the clean traces."""
    false: dict[tuple[str, reference.Fact], int] = defaultdict(int)
    for number in range(10):
        path = source / "trajectories/learning" / domain / f"{number}_{domain}_traj"
        states, actions = reference.read_trace(path)
        for state, (name, *arguments) in zip(states, actions, strict=False):
            action = model.actions[name]
            for fact in _over(model, action):
                (ground,) = action.ground({fact}, tuple(arguments))
                false[name, fact] += ground not in state
    return false


def _over(model: reference.Model, action: reference.Action) -> list[reference.Fact]:
    from vote import candidates  # noqa: PLC0415

    return candidates(model, action)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True, help="a folder that run.py worked in")
    parser.add_argument("--source", type=Path, required=True, help="where run.py took its traces from")
    parser.add_argument("--rates", default="00,01,05,10,20", help="as in the names of cases")
    args = parser.parse_args()
    from demoplan.pipeline.domains.learn_traces import learn_traces  # noqa: PLC0415

    false: dict[str, dict] = {}
    print("| flips | what | " + " | ".join(_label(n) for n in range(len(BINS) - 1)) + " | error |")
    print("| --- " * (len(BINS) + 2) + "|")
    for rate in args.rates.split(","):
        found: dict[str, list[tuple[float, bool]]] = {"condition": [], "effect": []}
        rates: list[float] = []
        for case in sorted((args.work / "cases").glob(f"*-{rate}-*")):
            domain = case.name.rsplit("-", 2)[0]
            model = reference.read_domain(args.source / "domains" / f"{domain}.pddl")
            if domain not in false:
                false[domain] = held(args.source, domain, model)
            report = learn_traces(case, args.work / "calibration.pddl")
            rates.append(report.denoised.flip_rate)
            for row in report.denoised.literals.iter_rows(named=True):
                action = model.actions[row["operator"].lower()]
                fact = tuple(word.lower() for word in (row["predicate"], *row["variables"]))
                if row["role"] == "effect":
                    is_right = fact in (action.adds if row["is_positive"] else action.deletes)
                    found["effect"].append((row["probability"], is_right))
                elif row["is_positive"]:
                    found["condition"].append((row["probability"], not false[domain][action.name, fact]))
        for what, pairs in found.items():
            print(f"| {int(rate)} % | {what} | {_row(pairs)} |", flush=True)
        if rates:
            print(f"| {int(rate)} % | rate as estimated | {min(rates):.3%} to {max(rates):.3%} |")


def _label(n: int) -> str:
    return f"{BINS[n]:g}–{BINS[n + 1]:g}"


def _row(pairs: list[tuple[float, bool]]) -> str:
    """Per bin: share that was right, of how many; and the expected calibration error."""
    cells, error = [], 0.0
    for n in range(len(BINS) - 1):
        is_last = n == len(BINS) - 2
        inside = [pair for pair in pairs if BINS[n] <= pair[0] < BINS[n + 1] or (is_last and pair[0] == 1)]
        if not inside:
            cells.append("–")
            continue
        right = sum(is_right for _, is_right in inside) / len(inside)
        said = math.fsum(probability for probability, _ in inside) / len(inside)
        error += abs(right - said) * len(inside) / len(pairs)
        cells.append(f"{right:.1%} of {len(inside)}")
    return " | ".join([*cells, f"{error:.2%}"])


main()
