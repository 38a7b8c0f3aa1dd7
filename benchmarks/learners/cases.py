"""Cases for learners: public traces with atoms flipped independently, every ground atom in every state."""

import random
from collections.abc import Iterator
from pathlib import Path

import reference


def flip(states: list[set], facts: list, rate: float, draw: random.Random) -> list[set]:
    """Each fact of each state changed with the same probability, independently.

    Returns:
        New states; the given ones are not changed.
    """
    if rate <= 0:
        return [set(state) for state in states]
    noisy = []
    for state in states:
        flipped = {fact for fact in facts if draw.random() < rate}
        noisy.append(set(state) ^ flipped)
    return noisy


def write_case(root: Path, source: Path, domain: str, rate: float, seed: int, n_traces: int = 10) -> Path:
    """One case folder from the public data of one domain.

    Args:
        root: Folder under which the case is written, as ``domain-rate-seed``.
        source: The benchmark data: ``domains``, ``trajectories/learning``, ``problems/learning``.
        domain: Name of the domain.
        rate: Probability of a flip, of each ground atom in each state.
        seed: Of the flips.
        n_traces: Traces taken, in order of their numbers.
    """
    case = root / f"{domain}-{round(rate * 100):02d}-{seed}"
    if (case / "domain.pddl").exists():
        return case
    model = reference.read_domain(source / "domains" / f"{domain}.pddl")
    (case / "trajectories").mkdir(parents=True, exist_ok=True)
    (case / "problems").mkdir(exist_ok=True)
    draw = random.Random(f"{domain} {rate} {seed}")
    constants = {name for name, _ in model.constants}
    for number in range(n_traces):
        states, actions = reference.read_trace(
            source / "trajectories/learning" / domain / f"{number}_{domain}_traj"
        )
        problem = source / "problems/learning" / domain / f"{number}_{domain}_prob.pddl"
        objects, _, _ = reference.read_problem(problem, model)
        noisy = flip(states, reference.all_facts(model, objects), rate, draw)
        (case / "trajectories" / f"{number}_traj").write_text(reference.trace_text(noisy, actions))
        text = reference.problem_text(f"p{number}", model.name, objects, noisy[0], constants)
        (case / "problems" / f"{number}_prob.pddl").write_text(text)
    (case / "domain.pddl").write_text(reference.signatures_only(source / "domains" / f"{domain}.pddl"))
    return case


def domains_with_traces(source: Path) -> Iterator[str]:
    """Names of the domains that ship traces to learn from, each with its problem, sorted."""
    for folder in sorted((source / "trajectories/learning").iterdir()):
        problems = (source / "problems/learning" / folder.name).glob("*.pddl")
        if folder.is_dir() and all(problem.stat().st_size for problem in problems):
            yield folder.name
