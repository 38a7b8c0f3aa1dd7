"""What goes into an exported dataset."""

from collections.abc import Callable
from dataclasses import dataclass

import dataframely as dy

from demoplan.tables import Activities, Frames


@dataclass(frozen=True, kw_only=True)
class LeRobotParams:
    """What can be chosen about an export."""

    fps: int
    """Frames per second [Hz]."""
    has_language: bool = False
    """Also write subtasks as rows of ``language_persistent``, which lerobot 0.6 and later resolve."""
    data_file_mb: int = 100
    """Size at which the next data file begins [MB]."""
    files_per_chunk: int = 1000
    """Files in one folder."""


@dataclass(frozen=True, kw_only=True)
class DatasetFacts:
    """What holds for a dataset as a whole."""

    name: str
    description: str
    licence: str | None
    """Identifier of its licence; None where it states none that lets it be passed on."""
    licence_words: str
    """What its manifest says of its licence."""
    source: str
    world: str
    """Frame of all positions and orientations."""
    tick_rate_hz: float
    hands: tuple[str, ...]
    """In order of the state."""
    gripping: tuple[str, ...]
    """Those of the hands whose opening is recorded."""
    objects: tuple[str, ...]
    """Tracked instances that are not hands."""
    activities_from: str
    """Where the subtasks come from, in words."""
    version: str
    """Version of demoplan."""
    manifest_sha256: str


@dataclass(frozen=True, kw_only=True)
class EpisodeContent:
    """One episode; its tables are loaded when its turn comes."""

    episode_id: str
    participant: str
    task: str
    goal: str | None
    is_goal_reached: bool | None
    status: str
    """``complete``, or ``truncated``: what could be read of a damaged log."""
    log_sha256: str | None
    split: str
    manifest_splits: tuple[str, ...]
    """Sets of the dataset's manifest that it is in; they may overlap."""
    frames: Callable[[], dy.DataFrame[Frames]]
    activities: Callable[[], dy.DataFrame[Activities]] | None
