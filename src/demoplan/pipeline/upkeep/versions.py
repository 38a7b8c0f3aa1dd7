"""A dataset to the next version of its domain, with what changed; planning comes after."""

from dataclasses import dataclass

from demoplan.language.diff import Change
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.datasets import OpenDataset, remember
from demoplan.pipeline.domains.learning import (
    Learned,
    changes_between,
    learn_domain,
    params_of,
    stored_domain,
)
from demoplan.pipeline.episodes.activities import segment_dataset
from demoplan.pipeline.episodes.ingest import ingest_dataset
from demoplan.pipeline.episodes.segmenters import segmenters_for
from demoplan.pipeline.reporting import Progress, silent
from demoplan.store import EpisodeState, Store


@dataclass(frozen=True, kw_only=True)
class NewVersion:
    """The version of a dataset's domain that its evidence gives now."""

    learned: Learned
    previous: Learned | None
    """The latest version before; None if this is the first."""
    changes: tuple[Change, ...]
    states: tuple[EpisodeState, ...]

    @property
    def is_new(self) -> bool:
        """Whether it says something else than the version before."""
        return self.previous is None or self.previous.version.domain_id != self.learned.version.domain_id


def learn_version(
    opened: OpenDataset,
    store: Store,
    *,
    segmenter: str = "auto",
    n_workers: int = 1,
    crew: Crew | None = None,
    progress: Progress = silent,
) -> NewVersion:
    """Learn a dataset's domain from all its usable episodes; what is up to date is not done again.

    Args:
        opened: The dataset.
        store: Where everything is kept.
        segmenter: As ``demoplan run`` takes it.
        n_workers: Processes of this machine.
        crew: Who works on episodes in place of these processes.
        progress: How to say how far it is.

    Raises:
        UsageError: If no episode can be used.
    """
    name = opened.dataset.name
    crew = crew or Processes(n_workers)
    remember(opened, store, segmenter=segmenter)
    latest = store.domains.latest(name)
    previous = stored_domain(store, latest.domain_id) if latest is not None else None
    states = ingest_dataset(opened, store, crew=crew, progress=progress)
    states, _ = segment_dataset(
        opened,
        store,
        states,
        lambda found: segmenters_for(opened, store, found, segmenter),
        crew=crew,
        progress=progress,
    )
    learned = learn_domain(
        store, states, opened.vocabulary, name=name, dataset=name, params=params_of(latest), crew=crew
    )
    store.snapshots.take(store.manifest.episodes(), f"learn {name}")
    return NewVersion(
        learned=learned,
        previous=previous,
        changes=changes_between(previous, learned) if previous is not None else (),
        states=tuple(states),
    )
