"""A dataset on disk: its manifest, its vocabulary and where its logs are."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from demoplan.errors import StoreError, UnknownNameError, UsageError
from demoplan.ids import is_safe_name
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.dataset import Dataset, Episode, parse_dataset
from demoplan.manifests.loading import read_text
from demoplan.manifests.vocabulary import parse_vocabulary
from demoplan.store import Store
from demoplan.store.places import AbsentError

MANIFEST_NAME = "dataset.yaml"


@dataclass(frozen=True, kw_only=True)
class OpenDataset:
    """A dataset that has been read and checked; its logs have not been touched."""

    dataset: Dataset
    vocabulary: Vocabulary
    folder: Path
    """Where the manifest is."""
    root: Path
    """Where the logs are."""
    manifest_text: str
    vocabulary_text: str

    def log_of(self, episode: Episode) -> Path:
        """Path of an episode's log."""
        return self.root / episode.file

    def labels_of(self, episode: Episode) -> Path | None:
        """Path of an episode's true labels, if it has any."""
        return self.root / episode.labels if episode.labels is not None else None

    def episode(self, name: str) -> Episode:
        """The episode of that id.

        Raises:
            UnknownNameError: If the dataset has none.
        """
        for episode in self.dataset.episodes:
            if episode.id == name:
                return episode
        raise UnknownNameError("episode", name, [e.id for e in self.dataset.episodes], str(self.folder))


def read_manifest(path: Path) -> tuple[Path, str]:
    """Path and text of the manifest at ``path``, or in the folder ``path``.

    Raises:
        UsageError: If there is none.
    """
    manifest = path / MANIFEST_NAME if path.is_dir() else path
    if not manifest.is_file():
        nearby = sorted(p.parent.name for p in path.parent.glob(f"*/{MANIFEST_NAME}"))
        hint = f"; datasets beside it: {', '.join(nearby)}" if nearby else ""
        raise UsageError(f"{path}: no dataset here; expected a folder with {MANIFEST_NAME}{hint}")
    return manifest, read_text(manifest)


def open_dataset(
    path: Path, *, root: Path | None = None, environment: Mapping[str, str] | None = None
) -> OpenDataset:
    """Read a dataset's manifest and vocabulary, and find its logs.

    Args:
        path: The manifest, or the folder that holds ``dataset.yaml``.
        root: Where the logs are; otherwise the manifest's ``root_variable`` is looked up in ``environment``,
            otherwise its ``root`` is taken, otherwise the manifest's own folder.
        environment: Variables that may name the root.

    Raises:
        UsageError: If the manifest or the root is not there.
        ManifestError: If the manifest or the vocabulary breaks its contract.
    """
    manifest, manifest_text = read_manifest(path)
    dataset = parse_dataset(manifest_text, manifest)
    vocabulary_path = manifest.parent / dataset.vocabulary
    vocabulary_text = read_text(vocabulary_path)
    vocabulary = parse_vocabulary(vocabulary_text, vocabulary_path)
    for name, entity in dataset.mapping.entities.items():
        if entity.type not in vocabulary.types.names:
            raise UnknownNameError("type", entity.type, vocabulary.types.names, f"{manifest}, {name}")
    named = (environment or {}).get(dataset.root_variable or "")
    if root is None and named:
        root = Path(named)
    if root is None:
        if dataset.root is None and dataset.root_variable is not None:
            raise UsageError(
                f"{manifest}: the logs of {dataset.name!r} are not part of this folder; "
                f"give --root FOLDER or set {dataset.root_variable}"
            )
        root = manifest.parent / (dataset.root or ".")
    if not root.is_dir():
        raise UsageError(f"{root}: no such folder; the logs of {dataset.name!r} were looked for there")
    return OpenDataset(
        dataset=dataset,
        vocabulary=vocabulary,
        folder=manifest.parent,
        root=root,
        manifest_text=manifest_text,
        vocabulary_text=vocabulary_text,
    )


def remember(opened: OpenDataset, store: Store, *, segmenter: str | None = None) -> None:
    """Keep a dataset's manifest and vocabulary beside what they produced.

    Args:
        opened: The dataset.
        store: The store.
        segmenter: What its activities are found with, as ``run`` takes it; otherwise what was kept stays.
            A file is kept with its whole path.
    """
    if segmenter is None:
        segmenter = segmenter_of(store, opened.dataset.name)
    elif Path(segmenter).is_file():
        segmenter = str(Path(segmenter).resolve())
    kept = {
        "segmenter": segmenter,
        "folder": str(opened.folder),
        "root": str(opened.root),
        "manifest": opened.manifest_text,
        "parsed": opened.dataset.model_dump_json(),
        "vocabulary": opened.vocabulary_text,
    }
    store.place.write(
        _kept_name(opened.dataset.name),
        (json.dumps(kept, sort_keys=True, indent=1) + "\n").encode(),
    )


def remembered(store: Store) -> list[str]:
    """Names of the datasets that the store has seen, sorted."""
    paths = (PurePosixPath(name) for name in store.place.names("datasets"))
    return sorted(path.stem for path in paths if path.suffix == ".json" and is_safe_name(path.stem))


def _kept_name(dataset: str) -> str:
    """What the store keeps of a dataset is called so."""
    return f"datasets/{dataset}.json"


def segmenter_of(store: Store, name: str) -> str | None:
    """What a dataset's activities were last found with; None if the store does not know."""
    try:
        segmenter = json.loads(store.place.read(_kept_name(name))).get("segmenter")
    except AbsentError:
        return None
    except (ValueError, AttributeError) as error:
        path = f"{store.location}/{_kept_name(name)}"
        raise StoreError(f"{path}: cannot be read: {error}; ingest the dataset again") from None
    return None if segmenter is None else str(segmenter)


def reopen(store: Store, name: str, environment: Mapping[str, str] | None = None) -> OpenDataset:
    """A dataset as it is now, where the store last saw it; as it was then if its manifest is gone.

    Its logs need not be there.

    Raises:
        UnknownNameError: If the store has not seen it.
        ManifestError: If its manifest or its vocabulary now breaks its contract.
    """
    kept = recall(store, name)
    if not (kept.folder / MANIFEST_NAME).is_file():
        return kept
    texts = read_text(kept.folder / MANIFEST_NAME), read_text(kept.folder / kept.dataset.vocabulary)
    if texts == (kept.manifest_text, kept.vocabulary_text):
        named = (environment or {}).get(kept.dataset.root_variable or "")
        return replace(kept, root=Path(named)) if named else kept
    # Any folder serves as root while the manifest is read: the logs may be on a disk that is away.
    opened = open_dataset(kept.folder, root=kept.folder)
    named = (environment or {}).get(opened.dataset.root_variable or "")
    return replace(opened, root=Path(named) if named else kept.root)


def recall(store: Store, name: str) -> OpenDataset:
    """A dataset as it was when the store last saw it; its logs need not be there any more.

    Raises:
        UnknownNameError: If the store has not seen it.
        StoreError: If what was kept cannot be read.
    """
    known = remembered(store)
    if name not in known:
        raise UnknownNameError("dataset", name, known, where=f"store {store.location}")
    try:
        kept = json.loads(store.place.read(_kept_name(name)))
        folder = Path(kept["folder"])
        dataset = _parsed(kept, folder)
        vocabulary = parse_vocabulary(kept["vocabulary"], folder / dataset.vocabulary)
    except (ValueError, KeyError, TypeError) as error:
        path = f"{store.location}/{_kept_name(name)}"
        raise StoreError(f"{path}: cannot be read: {error}; ingest the dataset again") from None
    return OpenDataset(
        dataset=dataset,
        vocabulary=vocabulary,
        folder=folder,
        root=Path(kept["root"]),
        manifest_text=kept["manifest"],
        vocabulary_text=kept["vocabulary"],
    )


def _parsed(kept: Mapping[str, str], folder: Path) -> Dataset:
    """The dataset that a kept text says: from its parsed form, since YAML of many episodes takes long."""
    try:
        return Dataset.model_validate_json(kept["parsed"])
    except (KeyError, ValueError):  # kept before there was one, or by another version
        return parse_dataset(kept["manifest"], folder / MANIFEST_NAME)
