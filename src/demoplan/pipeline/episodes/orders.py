"""What crosses to whoever works on an episode: paths and hashes; what episodes share is kept as a file."""

import functools
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from demoplan.errors import StoreError
from demoplan.ids import ContentHash, content_hash
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.mapping import Mapping
from demoplan.pipeline.datasets import OpenDataset
from demoplan.store.opening import open_place
from demoplan.store.places import AbsentError


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What all episodes of a dataset are read and perceived with."""

    dataset: str
    label_format: str
    mapping: Mapping
    vocabulary: Vocabulary
    definitions_root: Path
    tick_rate_hz: float

    @property
    def entities(self) -> dict[str, str]:
        """Instance → type."""
        return types_of_entities(self.mapping)


def types_of_entities(mapping: Mapping) -> dict[str, str]:
    """Instance → type, as a mapping says, in order of name."""
    return {name: entity.type for name, entity in sorted(mapping.entities.items())}


def setting_of_dataset(opened: OpenDataset) -> Setting:
    """What all episodes of a dataset share."""
    return Setting(
        dataset=opened.dataset.name,
        label_format=opened.dataset.label_format,
        mapping=opened.dataset.mapping,
        vocabulary=opened.vocabulary,
        definitions_root=opened.folder,
        tick_rate_hz=opened.dataset.tick_rate_hz,
    )


@dataclass(frozen=True, kw_only=True)
class IngestOrder:
    """One episode to ingest: a few hundred bytes."""

    store: str
    """What opens the store again."""
    setting: ContentHash
    """Names the file in the store that holds what this episode shares with others."""
    episode: str
    """What the dataset's manifest says of it, as JSON."""
    log: Path
    labels: Path | None
    known_sha256: str | None


_SETTING = TypeAdapter(Setting)


def keep_setting(store: str, setting: Setting) -> ContentHash:
    """Write a setting into the store, if it is not there, and give back what names it."""
    text = _SETTING.dump_json(setting)
    name = content_hash(text)
    place = open_place(store)
    if place.entry(_name_of(name)) is None:
        place.write(_name_of(name), text)
    return name


@functools.lru_cache(maxsize=32)
def setting_of(store: str, name: ContentHash) -> Setting:
    """The setting of that name; it never changes, so a process reads it once.

    Raises:
        StoreError: If it is not there, or its bytes are not those that the name stands for.
    """
    place = open_place(store)
    shown = f"{place.location}: {_name_of(name)}"
    try:
        text = place.read(_name_of(name))
        if content_hash(text) != name:
            raise StoreError(
                f"{shown}: its content is not what its name stands for; delete it, and run again"
            )
        return _SETTING.validate_json(text)
    except (AbsentError, ValidationError) as error:
        raise StoreError(
            f"{shown}: cannot be read by this worker: {error}; every worker needs the store, the logs and "
            "the same version of demoplan"
        ) from None


def _name_of(name: ContentHash) -> str:
    return f"settings/{name}.json"
