"""A dataset: its episodes, and what is known of each."""

from typing import Annotated

from pydantic import Field

from demoplan.manifests.mapping import Mapping, Strict

SafeName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$")]


class Episode(Strict):
    """One demonstration."""

    id: SafeName
    file: str
    """Log, or folder of a rosbag2, relative to the dataset's root."""
    sha256: str | None = None
    """Hash of the log's bytes (for a folder: of its data files, in name order)."""
    labels: str | None = None
    """True activities, relative to the dataset's root: only scoring and training read them."""
    participant: SafeName
    task: str
    hand: str | None = None
    """Hand instance that was asked to act; null where both do."""
    is_goal_reached: bool | None = None
    goal: str | None = None
    """What the demonstration was to reach, as goal text."""


class Dataset(Strict):
    """Episodes, mapping, vocabulary and splits."""

    name: SafeName
    description: str = ""
    licence: str = ""
    source: str = ""
    root: str | None = None
    """Where the logs are, relative to this file. Null: given by ``--root`` or ``root_variable``."""
    root_variable: str | None = None
    """Environment variable that may name the root."""
    vocabulary: str
    """Vocabulary file, relative to this file."""
    label_format: str = "activities"
    """``activities`` (our JSON of intervals) or ``bimanual-frames`` (KIT numbering by frame)."""
    tick_rate_hz: float = Field(default=100.0, gt=0)
    """Clock on to which everything is resampled [Hz]."""
    mapping: Mapping
    episodes: tuple[Episode, ...]
    splits: dict[str, tuple[str, ...]] = {}
    """Named sets of episode ids."""
