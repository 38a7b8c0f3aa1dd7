"""What a learned domain is worth: problems solved, literals right, transitions foretold."""

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import reference

SEARCH = "let(hff,ff(),let(hcea,cea(),lazy_greedy([hff,hcea],preferred=[hff,hcea])))"
"""The search that AMLGym scores with."""


def fast_downward() -> Path:
    """The compiled planner's driver, from the wheel beside this interpreter."""
    import importlib.util  # noqa: PLC0415

    found = importlib.util.find_spec("up_fast_downward")
    if found is None or found.origin is None:
        raise SystemExit("the planner is not installed: pip install up-fast-downward")
    return Path(found.origin).parent / "downward/fast-downward.py"


def plan(domain_text: str, problem: Path, seconds: int, cache: Path) -> list[list[str]] | str:
    """Steps of a plan, or why there is none; kept by content, since learners often agree.

    What ran out of time is tried again once more time is given.
    """
    key = hashlib.sha256(f"{domain_text}\0{problem.read_text()}\0{SEARCH}".encode()).hexdigest()
    kept = cache / key[:2] / f"{key}.json"
    if kept.exists():
        found = json.loads(kept.read_text())
        if found["seconds"] >= seconds or not found["ran_out"]:
            return found["result"]
    with tempfile.TemporaryDirectory() as folder:
        domain = Path(folder) / "domain.pddl"
        domain.write_text(domain_text)
        out = Path(folder) / "plan"
        command = [sys.executable, fast_downward(), "--plan-file", out, "--overall-time-limit", f"{seconds}s"]
        process = subprocess.Popen(
            [*command, domain, problem, "--search", SEARCH],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True, text=True,
        )  # fmt: skip
        try:
            said, _ = process.communicate(timeout=seconds + 20)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            said = "timeout"
        out_exists = out.exists()
        if out_exists:
            lines = [line for line in out.read_text().splitlines() if not line.startswith(";")]
            result: list[list[str]] | str = [line.strip("() ").split() for line in lines]
        else:
            result = f"exit {process.returncode}: {said[-200:]}"
    kept.parent.mkdir(parents=True, exist_ok=True)
    # Exit codes 21 to 24 are the planner's own limits of time and memory.
    ran_out = not out_exists and (process.returncode < 0 or 21 <= process.returncode <= 24)
    kept.write_text(json.dumps({"seconds": seconds, "ran_out": ran_out, "result": result}))
    return result


def is_valid(model: reference.Model, problem: Path, steps: list[list[str]]) -> bool:
    """Whether the reference accepts the plan: every step applicable, the goal reached."""
    _, state, (wanted, unwanted) = reference.read_problem(problem, model)
    for name, *arguments in steps:
        action = model.actions[name]
        if len(arguments) != len(action.parameters) or not action.is_applicable(state, tuple(arguments)):
            return False
        state = action.apply(state, tuple(arguments))
    return wanted <= state and not unwanted & state


def solved(
    domain_text: str, model: reference.Model, problems: list[Path], seconds: int, cache: Path
) -> float:
    """Part of the problems whose plan the reference accepts."""
    n = 0
    for problem in problems:
        steps = plan(domain_text, problem, seconds, cache)
        n += isinstance(steps, list) and is_valid(model, problem, steps)
    return n / len(problems)


def _renamed(action: reference.Action) -> dict[str, set[reference.Fact]]:
    names = {name: f"?{index}" for index, (name, _) in enumerate(action.parameters)}
    return {
        role: {(fact[0], *(names.get(word, word) for word in fact[1:])) for fact in facts}
        for role, facts in [
            ("pre", action.holds),
            ("not", action.absent),
            ("add", action.adds),
            ("del", action.deletes),
        ]
    }


def syntactic(learned: reference.Model, model: reference.Model) -> tuple[float, float]:
    """Precision and recall over literals by place, averaged over actions as AMLGym does."""
    precisions, recalls = [], []
    for name, action in model.actions.items():
        true = _renamed(action)
        mine = _renamed(learned.actions[name]) if name in learned.actions else {role: set() for role in true}
        hits = sum(len(true[role] & mine[role]) for role in true)
        stated, wanted = sum(map(len, mine.values())), sum(map(len, true.values()))
        precisions.append(hits / stated if stated else 1.0)
        recalls.append(hits / wanted if wanted else 1.0)
    return sum(precisions) / len(precisions), sum(recalls) / len(recalls)


def predictive(
    learned: reference.Model, model: reference.Model, states_file: Path, problems: Path, limit: int
) -> dict:
    """Precision and recall of applicability and of effects, on AMLGym's held-out states.

    For each state and action: every truly applicable ground action, and as many random well-typed ones
    with one argument changed, so that a model that allows too much is seen. Averaged over actions.
    """
    draw = random.Random(0)
    data = json.loads(states_file.read_text())
    counts = {name: dict.fromkeys(("tp", "fp", "fn", "etp", "efp", "efn"), 0) for name in model.actions}
    chosen = [(problem, one) for problem, states in sorted(data.items()) for one in states.values()]
    draw.shuffle(chosen)
    objects_of: dict[str, dict[str, str]] = {}
    for problem, one in chosen[:limit]:
        if problem not in objects_of:
            objects_of[problem] = reference.read_problem(problems / problem, model)[0]
        objects = objects_of[problem]
        state = {tuple(fact.lower().strip("()").split()) for fact in one["fluents"]}
        for name, bindings in one["applicable_actions"].items():
            action, mine, count = (
                model.actions[name.lower()],
                learned.actions.get(name.lower()),
                counts[name.lower()],
            )
            fitting = [model.objects_of(objects, kind) for _, kind in action.parameters]
            if not all(fitting):
                continue
            true = [tuple(word.lower() for word in binding) for binding in bindings]
            draw.shuffle(true)
            true = true[:20]
            tried = set(true)
            for binding in true or [tuple(draw.choice(kind) for kind in fitting)]:
                for place, kind in enumerate(fitting):
                    tried.add((*binding[:place], draw.choice(kind), *binding[place + 1 :]))
            for binding in sorted(tried):
                really = action.is_applicable(state, binding)
                said = mine is not None and mine.is_applicable(state, binding)
                count["tp"] += really and said
                count["fp"] += said and not really
                count["fn"] += really and not said
                if really and said and mine is not None:
                    after, foretold = action.apply(state, binding), mine.apply(state, binding)
                    changed, said_changed = after ^ state, foretold ^ state
                    count["etp"] += len(changed & said_changed)
                    count["efp"] += len(said_changed - changed)
                    count["efn"] += len(changed - said_changed)
    out = {}
    for label, (tp, fp, fn) in {
        "applicability": ("tp", "fp", "fn"),
        "effects": ("etp", "efp", "efn"),
    }.items():
        seen = [c for c in counts.values() if c["tp"] + c["fn"] > 0]
        precision = [c[tp] / (c[tp] + c[fp]) if c[tp] + c[fp] else 1.0 for c in seen]
        recall = [c[tp] / (c[tp] + c[fn]) if c[tp] + c[fn] else 0.0 for c in seen]
        out[label] = (sum(precision) / len(seen), sum(recall) / len(seen))
    return out


def f1(precision: float, recall: float) -> float:
    """Harmonic mean."""
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0
