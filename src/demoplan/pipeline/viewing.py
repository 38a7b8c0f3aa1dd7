"""A stored episode to a recording that a person can look at."""

from pathlib import Path

import dataframely as dy

from demoplan.errors import UsageError
from demoplan.pipeline.datasets import OpenDataset
from demoplan.store import EpisodeState, Store
from demoplan.store.objects import Table
from demoplan.tables import Activities, Episodes, Evidence, Facts, Frames
from demoplan.viewers.episode import save_episode
from demoplan.viewers.sources import EpisodeTables, entities_of, thresholds_of


def record_view(
    store: Store,
    opened: OpenDataset,
    state: EpisodeState,
    output: Path,
    evidence: dy.DataFrame[Evidence] | None = None,
) -> Path:
    """Write the recording of a stored episode: scene, trails, activities, predicates, operators.

    Args:
        store: Where the episode's tables are.
        opened: The episode's dataset: its mapping and vocabulary give shapes and thresholds.
        state: The episode.
        output: Where the recording goes, ``….rrd``.
        evidence: Which operator each activity matched, if a domain was learned from the episode.

    Raises:
        UsageError: If the episode has no frames.
    """
    if "frames" not in state.tables:
        raise UsageError(
            f"episode {state.episode_id!r} has nothing to show: {state.reason or 'not ingested'}"
        )

    def table(name: str, schema: type[Table]) -> dy.DataFrame[Table] | None:
        return store.get(state.tables[name], schema) if name in state.tables else None

    return save_episode(
        output,
        EpisodeTables(
            episode_id=state.episode_id,
            frames=store.get(state.tables["frames"], Frames),
            entities=entities_of(opened.dataset.mapping, opened.vocabulary),
            episodes=table("episodes", Episodes),
            facts=table("facts", Facts),
            activities=table("activities", Activities),
            truth=table("labels", Activities),
            evidence=evidence,
            thresholds=thresholds_of(opened.vocabulary),
        ),
    )
