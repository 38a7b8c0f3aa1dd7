"""A dataset: its episodes, and what is known of each."""

from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Annotated

from pydantic import Field

from demoplan.manifests.loading import Location, load_yaml
from demoplan.manifests.mapping import BodiesTopic, Mapping, Strict, TransformsTopic

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


class Goal(Strict):
    """A goal that the learned domains are tried on."""

    name: SafeName
    goal: str
    """Goal text, as ``onTop(cube_red,cube_blue) & onTop(cube_blue,cube_green)``."""
    start: str | None = None
    """``EPISODE@start``, ``EPISODE@end`` or ``EPISODE@12.5`` [s]; by default the first episode's start."""


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
    goals: tuple[Goal, ...] = ()
    splits: dict[str, tuple[str, ...]] = Field(default={})
    """Named sets of episode ids."""


def parse_dataset(text: str, path: Path | str) -> Dataset:
    """The dataset that a ``dataset.yaml`` describes, checked beyond its form.

    Args:
        text: Content of the file.
        path: Where it comes from, for messages.

    Raises:
        ManifestError: If its form is wrong, an episode's id or a goal's name is used twice, a path leaves the
            root, a topic feeds an entity that is not listed, or a split names an episode that does not exist.
    """
    return load_yaml(text, path, Dataset, unique={"episodes": "id", "goals": "name"}, check=_problems)


def _problems(dataset: Dataset) -> Iterator[tuple[Location, str]]:
    """What the form alone does not rule out."""
    for number, episode in enumerate(dataset.episodes):
        for key, file in (("file", episode.file), ("labels", episode.labels)):
            if file and (
                PurePosixPath(file).is_absolute() or ".." in PurePosixPath(file).parts or "\\" in file
            ):
                yield (
                    ("episodes", number, key),
                    f"episode {episode.id!r}: file {file!r} leaves the dataset's root; "
                    "give a path below it, without '..'",
                )
    entities = dataset.mapping.entities
    for name, topic in dataset.mapping.topics.items():
        fed: list[tuple[Location, str]]
        if isinstance(topic, TransformsTopic | BodiesTopic):
            fed = [(("entities", frame), entity) for frame, entity in topic.entities.items()]
        else:
            fed = [(("entity",), topic.entity)]
        for part, entity in fed:
            if entity not in entities:
                yield (
                    ("mapping", "topics", name, *part),
                    f"topic {name!r} feeds entity {entity!r}, which mapping.entities does not list; "
                    f"listed: {', '.join(sorted(entities))}",
                )
    ids = {episode.id for episode in dataset.episodes}
    for split, members in dataset.splits.items():
        for number, member in enumerate(members):
            if member not in ids:
                yield (
                    ("splits", split, number),
                    f"split {split!r} names episode {member!r}, which does not exist; "
                    f"episodes: {', '.join(episode.id for episode in dataset.episodes)}",
                )
