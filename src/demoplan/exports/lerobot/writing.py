"""A dataset's folder, written beside its place and moved there when it is whole."""

import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from demoplan.errors import StoreError, UsageError
from demoplan.exports.lerobot import layout
from demoplan.exports.lerobot.card import CardContent, card_of
from demoplan.exports.lerobot.columns import Place, arrow_of, columns_of
from demoplan.exports.lerobot.content import DatasetFacts, EpisodeContent, LeRobotParams
from demoplan.exports.lerobot.statistics import Figures, figures_of, joined
from demoplan.exports.lerobot.subtasks import SubtaskTable


@dataclass(frozen=True, kw_only=True)
class Written:
    """What was exported."""

    path: Path
    n_episodes: int
    n_frames: int
    n_subtasks: int
    splits: dict[str, str]
    """Split → range of episode indices, ``from:to``."""


def write_dataset(
    output: Path,
    facts: DatasetFacts,
    episodes: Sequence[EpisodeContent],
    params: LeRobotParams,
    *,
    is_overwriting: bool = False,
    on_episode: Callable[[str], None] = lambda _: None,
) -> Written:
    """Write a dataset. Episodes of a split stand together, in the order given; equal arguments, equal bytes.

    Args:
        output: The dataset's folder.
        facts: What holds for all of it.
        episodes: What goes in.
        params: Choices.
        is_overwriting: Whether a LeRobot dataset that is there may be replaced.
        on_episode: Called with each episode's id when it is written.

    Raises:
        UsageError: If there is nothing to write, or something is there already.
        StoreError: If the folder cannot be written.
        DataError: If an episode is too short, or its clock slower than the export's.
    """
    if not episodes:
        raise UsageError(f"nothing to export: dataset {facts.name!r} has no episode that could be read")
    splits = list(dict.fromkeys(episode.split for episode in episodes))
    ordered = sorted(episodes, key=lambda episode: splits.index(episode.split))
    with _folder_at(output, is_overwriting=is_overwriting) as folder:
        return _write(folder, output, facts, ordered, params, on_episode)


def _write(
    folder: Path,
    output: Path,
    facts: DatasetFacts,
    episodes: Sequence[EpisodeContent],
    params: LeRobotParams,
    on_episode: Callable[[str], None],
) -> Written:
    features = layout.features_of(
        facts,
        params,
        has_subtasks=any(episode.activities is not None for episode in episodes),
        has_success=all(episode.is_goal_reached is not None for episode in episodes),
    )
    schema = layout.data_schema(features)
    tasks = tuple(dict.fromkeys(episode.task for episode in episodes))
    subtasks = SubtaskTable()
    rows: list[dict[str, Any]] = []
    statistics: list[dict[str, Figures]] = []
    subtask_frames: dict[int, int] = {}
    n_frames = 0
    with _DataFiles(folder, schema, params) as files:
        for number, episode in enumerate(episodes):
            place = Place(episode_index=number, first_index=n_frames, task_index=tasks.index(episode.task))
            columns = columns_of(episode, facts, place, features, subtasks, params.fps)
            chunk, file = files.write(arrow_of(columns, schema, subtasks))
            statistics.append({name: figures_of(values) for name, values in columns.items()})
            n = len(columns["index"])
            rows.append(_episode_row(episode, place, n, chunk, file))
            if layout.SUBTASK in columns:
                for k, count in zip(*np.unique(columns[layout.SUBTASK], return_counts=True), strict=True):
                    subtask_frames[int(k)] = subtask_frames.get(int(k), 0) + int(count)
            n_frames += n
            on_episode(episode.episode_id)
    ranges = _ranges([episode.split for episode in episodes])
    info = _info(features, params, n_episodes=len(episodes), n_frames=n_frames, n_tasks=len(tasks))
    _write_json(folder / layout.INFO, {**info, "splits": ranges})
    _write_json(
        folder / layout.STATS,
        {name: {key: value.tolist() for key, value in f.items()} for name, f in joined(statistics).items()},
    )
    _write_table(folder / layout.TASKS, layout.named_rows(tasks, "task"))
    if layout.SUBTASK in features:
        _write_table(folder / layout.SUBTASKS, layout.named_rows(subtasks.texts, "subtask"))
    _write_table(
        folder / layout.EPISODES.format(chunk_index=0, file_index=0), _episodes_table(rows, statistics)
    )
    content = CardContent(
        facts=facts,
        params=params,
        episodes=tuple(episodes),
        features=features,
        splits=ranges,
        n_frames=n_frames,
        subtask_s={subtasks.texts[k]: n / params.fps for k, n in sorted(subtask_frames.items())},
    )
    (folder / "README.md").write_text(card_of(content), encoding="utf-8")
    return Written(
        path=output,
        n_episodes=len(episodes),
        n_frames=n_frames,
        n_subtasks=len(subtasks.texts),
        splits=ranges,
    )


def _info(
    features: dict[str, dict[str, Any]],
    params: LeRobotParams,
    *,
    n_episodes: int,
    n_frames: int,
    n_tasks: int,
) -> dict[str, Any]:
    return {
        "codebase_version": layout.CODEBASE_VERSION,
        "robot_type": "human_hands",
        "fps": params.fps,
        "features": features,
        "total_episodes": n_episodes,
        "total_frames": n_frames,
        "total_tasks": n_tasks,
        "chunks_size": params.files_per_chunk,
        "data_files_size_in_mb": params.data_file_mb,
        "data_path": layout.DATA,
        "video_path": None,
    }


def _episode_row(episode: EpisodeContent, place: Place, n: int, chunk: int, file: int) -> dict[str, Any]:
    return {
        "episode_index": place.episode_index,
        "tasks": [episode.task],
        "length": n,
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": place.first_index,
        "dataset_to_index": place.first_index + n,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        "episode_id": episode.episode_id,
        "participant": episode.participant,
        "split": episode.split,
        "manifest_splits": list(episode.manifest_splits),
        "success": episode.is_goal_reached,
        "goal": episode.goal,
        "status": episode.status,
        "log_sha256": episode.log_sha256,
    }


_EPISODE_TYPES = {
    "tasks": pa.list_(pa.string()),
    "manifest_splits": pa.list_(pa.string()),
    "success": pa.bool_(),
}


def _episodes_table(rows: Sequence[dict[str, Any]], statistics: Sequence[dict[str, Figures]]) -> pa.Table:
    """One row per episode: where it is, what is known of it, and the figures of each feature."""
    columns: dict[str, pa.Array] = {}
    for name, first in rows[0].items():
        number_or_text = pa.int64() if isinstance(first, int) else pa.string()
        kind = _EPISODE_TYPES.get(name, number_or_text)
        columns[name] = pa.array([row[name] for row in rows], kind)
    for feature, figures in statistics[0].items():
        for figure in figures:
            values = [each[feature][figure] for each in statistics]
            kind = pa.list_(pa.int64() if figure == "count" else pa.float64())
            as_type = np.int64 if figure == "count" else np.float64
            columns[f"stats/{feature}/{figure}"] = pa.array([v.astype(as_type) for v in values], kind)
    return pa.table(columns)


def _ranges(splits: Sequence[str]) -> dict[str, str]:
    """Split → ``from:to`` over episodes that stand together.

    >>> _ranges(["train", "train", "test"])
    {'train': '0:2', 'test': '2:3'}
    """
    ends = {split: k + 1 for k, split in enumerate(splits)}
    return {split: f"{splits.index(split)}:{end}" for split, end in ends.items()}


class _DataFiles:
    """Data files of bounded size, one row group per episode."""

    def __init__(self, folder: Path, schema: pa.Schema, params: LeRobotParams) -> None:
        self._folder = folder
        self._schema = schema
        self._params = params
        self._number = 0
        self._writer: pq.ParquetWriter | None = None
        self._path = folder

    def __enter__(self) -> "_DataFiles":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()

    def write(self, table: pa.Table) -> tuple[int, int]:
        """Append an episode; gives the numbers of the chunk and file that it is in."""
        if self._writer is not None and self._path.stat().st_size >= self._params.data_file_mb * 2**20:
            self._writer.close()
            self._writer = None
            self._number += 1
        chunk, file = divmod(self._number, self._params.files_per_chunk)
        if self._writer is None:
            self._path = self._folder / layout.DATA.format(chunk_index=chunk, file_index=file)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(self._path, self._schema, compression="snappy")
        self._writer.write_table(table, row_group_size=max(1, table.num_rows))
        return chunk, file


def _write_json(path: Path, value: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4, allow_nan=False) + "\n", encoding="utf-8")


def _write_table(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path, compression="snappy")


@contextmanager
def _folder_at(output: Path, *, is_overwriting: bool) -> Iterator[Path]:
    """A folder to write into, which takes its place when the block ends without error."""
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        if not (output / layout.INFO).is_file():
            raise UsageError(f"{output} is there already, and is no LeRobot dataset; choose another place")
        if not is_overwriting:
            raise UsageError(f"{output} holds a LeRobot dataset already; --overwrite replaces it")
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{output.name}-", dir=output.parent))
    except OSError as error:
        raise StoreError(f"cannot write {output}: {error.strerror or error}") from error
    try:
        partial.chmod(0o755)
        yield partial
        if output.exists():
            shutil.rmtree(output)
        partial.rename(output)
    except OSError as error:
        raise StoreError(f"cannot write {output}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
