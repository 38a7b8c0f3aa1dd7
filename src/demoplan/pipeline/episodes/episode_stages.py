"""The stages of ingesting one episode, and whether what they gave still stands."""

import json
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.errors import DataError, LogError
from demoplan.language.vocabulary import Vocabulary
from demoplan.logs import SampleStream, fingerprint, open_log
from demoplan.manifests.dataset import Episode
from demoplan.manifests.labels import activities_of_labels
from demoplan.manifests.mapping import Mapping
from demoplan.pipeline.datasets import OpenDataset
from demoplan.pipeline.episodes.episode_tables import EpisodeTables, Made
from demoplan.pipeline.episodes.memory import give_memory_back
from demoplan.pipeline.episodes.plausibility import are_within, refuse_empty, refuse_implausible, refuse_units
from demoplan.pipeline.episodes.seen import settled_signature, signature_of
from demoplan.stages.align import AlignParams, align, align_parts
from demoplan.stages.perceive import PerceiveParams, perceive, perceive_parts
from demoplan.store import EpisodeState, Store, stage_key
from demoplan.store.code_version import code_version
from demoplan.store.index import Index
from demoplan.store.objects import Draft
from demoplan.store.store import canonical_json
from demoplan.tables import Activities, Facts, Frames, Samples, Topics

OUTPUTS = {
    "read": ("samples", "topics"),
    "align": ("frames",),
    "perceive": ("facts",),
    "labels": ("labels",),
}
"""Stages of ingesting, in order, and the tables that they give."""

MODULES = {
    "read": ("demoplan.logs", "demoplan.pipeline.episodes.plausibility"),
    "align": ("demoplan.stages.align",),
    "perceive": ("demoplan.stages.perceive",),
    "labels": ("demoplan.manifests.labels",),
}
"""What each of them is made of, as far as it makes output stale."""


@dataclass(frozen=True, kw_only=True)
class IngestJob:
    """All that a process needs to ingest one episode."""

    store: str
    """What opens the store, in this process or another."""
    dataset: str
    episode: Episode
    log: Path
    labels: Path | None
    label_format: str
    mapping: Mapping
    vocabulary: Vocabulary
    definitions_root: Path
    tick_rate_hz: float
    known_sha256: str | None = None
    """Hash of the log's bytes where it is not there to be read any more, but was read before."""


def jobs_of(opened: OpenDataset, store: Store, episodes: Sequence[Episode]) -> list[IngestJob]:
    """One job for each of these episodes."""
    return [
        IngestJob(
            store=store.location,
            dataset=opened.dataset.name,
            episode=episode,
            log=opened.log_of(episode),
            labels=opened.labels_of(episode),
            label_format=opened.dataset.label_format,
            mapping=opened.dataset.mapping,
            vocabulary=opened.vocabulary,
            definitions_root=opened.folder,
            tick_rate_hz=opened.dataset.tick_rate_hz,
        )
        for episode in episodes
    ]


class _Texts:
    """Parameters of stages as canonical JSON, made once for all episodes that share them."""

    def __init__(self, job: IngestJob) -> None:
        self.shared = job.mapping, job.vocabulary
        """Kept, so that their ids stay theirs."""
        self.align_params = AlignParams(tick_rate_hz=job.tick_rate_hz)
        self.perceive_params = PerceiveParams()
        mapping = job.mapping.model_dump(mode="json")
        self.mapping = canonical_json(mapping)
        self.align = canonical_json({"params": asdict(self.align_params), "mapping": mapping})
        self.perceive = canonical_json(
            {
                "params": asdict(self.perceive_params),
                "entities": {name: e.model_dump(mode="json") for name, e in job.mapping.entities.items()},
                "vocabulary": asdict(job.vocabulary),
            }
        )

    def read(self, episode_id: str) -> str:
        """The same text as ``canonical_json`` gives for all of it, without rendering the mapping anew."""
        return f'{{"episode_id":{json.dumps(episode_id)},"mapping":{self.mapping}}}'


_TEXTS: dict[tuple[int, int, float], _Texts] = {}
_MOST_TEXTS = 16


def _texts_of(job: IngestJob) -> _Texts:
    key = id(job.mapping), id(job.vocabulary), job.tick_rate_hz
    if key not in _TEXTS:
        if len(_TEXTS) >= _MOST_TEXTS:
            _TEXTS.clear()
        _TEXTS[key] = _Texts(job)
    return _TEXTS[key]


def log_hash(job: IngestJob) -> str:
    """The hash of the bytes of a job's log.

    Raises:
        LogError: If the log cannot be read, or is not the one that the dataset's manifest names.
    """
    sha256 = job.known_sha256 or str(fingerprint(job.log))
    if job.episode.sha256 is not None and job.episode.sha256 != sha256:
        raise LogError(
            job.log,
            f"its content is not what the manifest names: sha256 {sha256}, expected {job.episode.sha256}; "
            "it was changed or damaged on the way",
        )
    return sha256


def run_stages(job: IngestJob, tables: EpisodeTables, sha256: str) -> None:
    """Run every stage of ingesting an episode whose output is not there."""
    _read(job, tables, sha256)
    _align(job, tables)
    _perceive(job, tables)
    if job.labels is not None:
        _labels(job, tables)


def _read(job: IngestJob, tables: EpisodeTables, sha256: str) -> None:
    def make() -> Made:
        before = signature_of(job.log)
        stream = open_log(job.log, job.mapping, job.episode.id, definitions_root=job.definitions_root)
        batches = stream.batches()
        held = _up_to(batches, tables.long_rows)
        if sum(map(len, held)) > tables.long_rows:
            samples: pl.DataFrame | Draft = _read_long(job, tables, _flowing(held, batches), stream)
        else:
            samples = pl.concat(held) if held else Samples.create_empty()
            refuse_implausible(Samples.cast(samples), stream.topics, job.mapping)
        _require_unchanged(job, before, sha256)
        tables.notes |= {"status": stream.status, "reason": stream.reason or ""}
        return {"samples": (samples, Samples), "topics": (stream.topics, Topics)}

    tables.run(
        "read",
        modules=MODULES["read"],
        inputs={"log": sha256},
        params=_texts_of(job).read(job.episode.id),
        make=make,
    )


def _up_to(batches: Iterable[dy.DataFrame[Samples]], n_rows: int) -> deque[dy.DataFrame[Samples]]:
    """Batches until there are more rows than that, or no more batches."""
    held: deque[dy.DataFrame[Samples]] = deque()
    n_held = 0
    for batch in batches:
        held.append(batch)
        n_held += len(batch)
        if n_held > n_rows:
            break
    return held


def _flowing(
    held: deque[dy.DataFrame[Samples]], batches: Iterable[dy.DataFrame[Samples]]
) -> Iterator[dy.DataFrame[Samples]]:
    """What is held, which is let go of one by one, and what comes after it."""
    while held:
        yield held.popleft()
    yield from batches


def _read_long(
    job: IngestJob,
    tables: EpisodeTables,
    batches: Iterable[dy.DataFrame[Samples]],
    stream: SampleStream,
) -> Draft:
    """Samples of a long log, written while they are read.

    Raises:
        DataError: If they are implausible.
    """
    is_within = True

    def watched() -> Iterator[pl.DataFrame]:
        nonlocal is_within
        for batch in batches:
            is_within &= are_within(batch)
            yield batch

    samples = tables.drafted(watched(), Samples)
    refuse_empty(stream.topics, job.mapping)
    if not is_within:
        refuse_units(samples.parts(Samples), job.mapping)
    return samples


class ChangedLogError(LogError):
    """A log was written to while it was read."""


def _require_unchanged(job: IngestJob, before: str, sha256: str) -> None:
    """Raise if a log is not what it was before it was read.

    An old signature that stayed says that it is. Otherwise the content decides: a file may have been written
    to within a tick of the file system's clock, and a folder may have got a file that is no part of the log.
    """
    after = signature_of(job.log)
    is_surely_same = after == before and bool(settled_signature(after))
    if not is_surely_same and str(fingerprint(job.log)) != sha256:
        raise ChangedLogError(job.log, "it changed while it was read; is it still being recorded?")


def _align(job: IngestJob, tables: EpisodeTables) -> None:
    texts = _texts_of(job)

    def make() -> Made:
        if not tables.is_long("samples"):
            samples = tables.get("samples", Samples)
            return {"frames": (align(samples, job.mapping, texts.align_params), Frames)}
        parts = align_parts(tables.parts("samples", Samples), job.mapping, texts.align_params)
        return {"frames": (tables.drafted(parts, Frames), Frames)}

    tables.run(
        "align",
        modules=MODULES["align"],
        inputs={"samples": tables.contents["samples"]},
        params=texts.align,
        make=make,
    )


def _perceive(job: IngestJob, tables: EpisodeTables) -> None:
    texts = _texts_of(job)

    def make() -> Made:
        known = job.mapping.entities, job.vocabulary, texts.perceive_params
        if not tables.is_long("frames"):
            return {"facts": (perceive(tables.get("frames", Frames), *known), Facts)}
        facts = perceive_parts(tables.parts("frames", Frames), *known)
        give_memory_back()
        return {"facts": (facts, Facts)}

    tables.run(
        "perceive",
        modules=MODULES["perceive"],
        inputs={"frames": tables.contents["frames"]},
        params=texts.perceive,
        make=make,
    )


def _labels(job: IngestJob, tables: EpisodeTables) -> None:
    """True activities: stored apart, for training and scoring only."""
    text = _label_text(job)
    tables.run(
        "labels",
        modules=MODULES["labels"],
        inputs={"labels": text, "samples": tables.contents["samples"]},
        params=_label_params(job),
        make=lambda: {
            "labels": (
                activities_of_labels(
                    json.loads(text), job.label_format, job.episode.id, tables.get("samples", Samples)
                ),
                Activities,
            )
        },
    )


def _label_text(job: IngestJob) -> str:
    assert job.labels is not None
    try:
        return job.labels.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{job.labels}: labels cannot be read: {error}") from None


def _label_params(job: IngestJob) -> str:
    return canonical_json({"format": job.label_format, "episode_id": job.episode.id})


def is_standing(job: IngestJob, state: EpisodeState, sha256: str, index: Index) -> bool:
    """Whether an episode is as ingesting it now would leave it, by the keys of its stages alone.

    Args:
        job: How it would be ingested.
        state: What the manifest says of it.
        sha256: Hash of its log's bytes.
        index: What is in the store.
    """
    if state.status == "quarantined":
        return False
    stages = [stage for stage in OUTPUTS if stage != "labels" or job.labels is not None]
    if any(name not in state.tables for stage in stages for name in OUTPUTS[stage]):
        return False
    for stage, inputs, params in _calls(job, state, sha256):
        key = stage_key(stage, inputs, params, code_version(*MODULES[stage]))
        if state.keys.get(stage) != key or not index.has_record(stage, key):
            return False
        if not all(index.has(state.tables[name]) for name in OUTPUTS[stage]):
            return False
    return True


def _calls(job: IngestJob, state: EpisodeState, sha256: str) -> Iterator[tuple[str, dict[str, str], str]]:
    """Stage, inputs and parameters of every stage of ingesting, on what the manifest names."""
    texts = _texts_of(job)
    yield "read", {"log": sha256}, texts.read(job.episode.id)
    yield "align", {"samples": state.tables["samples"]}, texts.align
    yield "perceive", {"frames": state.tables["frames"]}, texts.perceive
    if job.labels is not None:
        inputs = {"labels": _label_text(job), "samples": state.tables["samples"]}
        yield "labels", inputs, _label_params(job)
