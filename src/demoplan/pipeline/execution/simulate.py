"""Batches as people ask for them: domains by name or pattern, goals, faults and skills by file."""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from demoplan.engines.mujoco.skills import read_skills
from demoplan.errors import UnknownNameError, UsageError
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.faults import AnyFault, read_faults
from demoplan.manifests.goals import read_goals
from demoplan.pipeline.datasets import recall
from demoplan.pipeline.domains.learning import stored_domain
from demoplan.pipeline.execution.evaluate import Evaluation, evaluate, jobs_of
from demoplan.pipeline.execution.execute import ExecuteParams
from demoplan.pipeline.execution.run_views import execution_report
from demoplan.pipeline.reporting import Progress, silent
from demoplan.store import Store


@dataclass(frozen=True, kw_only=True)
class Batch:
    """What to run."""

    domains: tuple[str, ...]
    """Ids, names, or patterns as ``cube-stacking*``."""
    goals: Path
    """Goals file."""
    seeds: range
    robot: str = "gripper"
    faults: Path | None = None
    """Faults file: each of them, and none."""
    monitors: tuple[str, ...] = ("full",)
    skills: Path | None = None
    """Skill table; without one, what comes with demoplan."""
    is_recorded: bool = False
    """Whether poses are kept."""


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """What came of a batch."""

    evaluation: Evaluation
    vocabulary: Vocabulary


def simulate(store: Store, batch: Batch, *, n_workers: int, progress: Progress = silent) -> Simulated:
    """Run a batch; what was run before is not run again.

    Args:
        store: Domains come from it, and runs go into it.
        batch: What to run.
        n_workers: Processes.
        progress: Told about every run.

    Raises:
        UnknownNameError: If a domain or a pattern names nothing.
        UsageError: If a file cannot be used, or the domains come from several datasets.
    """
    chosen = _domains(store, batch.domains)
    datasets = sorted({dataset for _, _, dataset in chosen})
    if len(datasets) > 1:
        raise UsageError(
            f"these domains were learned from several datasets, each with its own words: "
            f"{', '.join(datasets)}; evaluate them one dataset at a time"
        )
    vocabulary = recall(store, datasets[0]).vocabulary
    injected: list[AnyFault | None] = [None, *(read_faults(batch.faults) if batch.faults else ())]
    jobs = jobs_of(
        store,
        [(name, text) for name, text, _ in chosen],
        read_goals(batch.goals),
        vocabulary=vocabulary,
        seeds=batch.seeds,
        robot=batch.robot,
        faults=injected,
        monitors=batch.monitors,
        params=ExecuteParams(skills=read_skills(batch.skills)),
        folder=batch.goals.parent,
        is_recorded=batch.is_recorded,
    )
    with progress("execute", len(jobs)) as done:
        return Simulated(evaluation=evaluate(jobs, n_workers=n_workers, on_done=done), vocabulary=vocabulary)


def keep_report(store: Store, name: str, simulated: Simulated, *, title: str) -> str:
    """Write a batch's page beside the store's other reports; where it is, as a path or URL."""
    path = f"reports/{name}.html"
    store.place.write(path, execution_report(simulated.evaluation, title=title).encode())
    return f"{store.location}/{path}"


def _domains(store: Store, asked: Sequence[str]) -> list[tuple[str, str, str]]:
    """(name, text, dataset) of the latest version of each domain asked for; a pattern may name several."""
    names = list(dict.fromkeys(version.name for version in store.domains.versions()))
    chosen: dict[str, tuple[str, str, str]] = {}
    for text in asked:
        matching = [name for name in names if fnmatchcase(name, text)] if set(text) & set("*?[") else [text]
        if not matching:
            raise UnknownNameError("domain", text, names, f"store {store.location}")
        for name in matching:
            learned = stored_domain(store, name)
            version = learned.version
            chosen.setdefault(str(version.domain_id), (version.name, learned.text, version.dataset))
    return list(chosen.values())
