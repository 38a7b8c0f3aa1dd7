"""Logs that arrived beside a dataset: found, and written into its manifest as new episodes."""

import io
import re
import time
from dataclasses import dataclass
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap

from demoplan.errors import ManifestError, UsageError
from demoplan.ids import is_safe_name
from demoplan.manifests.dataset import parse_dataset
from demoplan.pipeline.datasets import OpenDataset, read_manifest
from demoplan.store.atomic import locked, write_bytes

LOG_SUFFIXES = (".mcap", ".bag", ".db3")
BAG_METADATA = "metadata.yaml"


@dataclass(frozen=True, kw_only=True)
class ArrivalParams:
    """Which files are new episodes, and what their names say."""

    pattern: str = r"(?P<participant>[A-Za-z0-9]+)-(?P<task>[A-Za-z0-9-]+)"
    """Regular expression over the whole name without its suffix; its groups ``participant`` and ``task``
    fill the episode. A name that does not fit is told, and left alone."""
    quiet_s: float = 30.0
    """A log is taken when nothing was written to it for this time [s]: it may be recorded right now."""


@dataclass(frozen=True, order=True)
class Arrival:
    """A log that is not in the manifest yet."""

    file: str
    """Relative to the dataset's root."""
    episode_id: str
    participant: str
    task: str
    refusal: str = ""
    """Why it is not taken, if it is not."""


def find_arrivals(
    opened: OpenDataset, params: ArrivalParams = ArrivalParams(), *, now_s: float | None = None
) -> list[Arrival]:
    """Logs below a dataset's root that its manifest does not name, sorted.

    Args:
        opened: The dataset.
        params: Which files to take.
        now_s: The time now, as seconds since the epoch; the wall clock if it is not given.

    Raises:
        UsageError: If the pattern is not a regular expression with the two groups.
    """
    try:
        pattern = re.compile(params.pattern)
    except re.error as error:
        raise UsageError(f"pattern {params.pattern!r} is not a regular expression: {error}") from None
    missing = {"participant", "task"} - pattern.groupindex.keys()
    if missing:
        raise UsageError(f"pattern {params.pattern!r} has no group named {' or '.join(sorted(missing))}")
    now_s = time.time() if now_s is None else now_s
    named = {(opened.root / episode.file).resolve() for episode in opened.dataset.episodes}
    taken = {episode.id for episode in opened.dataset.episodes}
    arrivals = []
    for path in sorted(_logs_below(opened.root)):
        if path.resolve() in named:
            continue
        name = path.stem if path.is_file() else path.name
        match = pattern.fullmatch(name)
        refusal = ""
        if match is None:
            refusal = f"its name does not fit {params.pattern!r}"
        elif not is_safe_name(name):
            refusal = "its name cannot be an episode's: letters, digits, '.', '_' and '-' only"
        elif name in taken:
            refusal = f"episode {name!r} is there already, with another log"
        elif now_s - _changed_s(path) < params.quiet_s:
            refusal = f"was written to less than {params.quiet_s:g} s ago"
        taken.add(name)
        groups = match.groupdict() if match is not None else {}
        arrivals.append(
            Arrival(
                file=path.relative_to(opened.root).as_posix(),
                episode_id=name,
                participant=groups.get("participant") or "",
                task=groups.get("task") or "",
                refusal=refusal,
            )
        )
    return arrivals


def enrol(dataset: Path, arrivals: list[Arrival]) -> int:
    """Write arrivals into a dataset's manifest as episodes; comments and order of the file stay.

    Args:
        dataset: The manifest, or its folder.
        arrivals: What to write; those that were refused are passed over.

    Returns:
        How many episodes were added.

    Raises:
        ManifestError: If the manifest would not be valid: then it stays as it is.
    """
    accepted = [arrival for arrival in arrivals if not arrival.refusal]
    if not accepted:
        return 0
    manifest, _ = read_manifest(dataset)
    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 4096
    yaml.indent(mapping=2, sequence=4, offset=2)
    with locked(manifest.with_name(f".{manifest.name}.lock")):
        _, text = read_manifest(dataset)
        content = yaml.load(text)
        known = {str(entry["id"]) for entry in content["episodes"]}
        new = [arrival for arrival in accepted if arrival.episode_id not in known]
        for arrival in new:
            content["episodes"].append(
                CommentedMap(
                    id=arrival.episode_id,
                    file=arrival.file,
                    participant=arrival.participant,
                    task=arrival.task,
                )
            )
        out = io.StringIO()
        yaml.dump(content, out)
        try:
            parse_dataset(out.getvalue(), manifest)
        except ManifestError as error:
            raise ManifestError(manifest, None, f"new episodes do not fit: {error.problem}") from None
        if new:
            write_bytes(manifest, out.getvalue().encode())
    return len(new)


def _logs_below(root: Path) -> set[Path]:
    """Logs: files by their ending; of a rosbag2 with metadata or several parts, its folder."""
    logs = set()
    for path in root.rglob("*"):
        if path.suffix not in LOG_SUFFIXES or not path.is_file() or path.name.startswith("."):
            continue
        is_part = path.parent != root and (path.parent / BAG_METADATA).is_file()
        logs.add(path.parent if is_part else path)
    return logs


def _changed_s(path: Path) -> float:
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    return max((file.stat().st_mtime for file in files), default=0.0)
