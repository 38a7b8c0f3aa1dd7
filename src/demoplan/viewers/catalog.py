"""A folder of recordings, served through rerun's catalog so that they can be found by what they are.

Beside ``rerun_adapter``, this is the only module that knows rerun's API, pinned to 0.41.
"""

import importlib.util
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, TypeAlias

import polars as pl
from rerun.catalog import OnDuplicateSegmentLayer
from rerun.chunk import RrdReader
from rerun.server import Server

from demoplan.errors import DemoplanError, UsageError
from demoplan.viewers.rerun_adapter import PROPERTIES

_TABLE = "recordings"
_SEGMENT = "rerun_segment_id"


_Signature: TypeAlias = tuple[int, int]
"""Size [bytes] and time of the last change [ns] of a file."""

LOOK_AGAIN_S = 5.0
"""How often a folder that is served is looked at for new recordings."""


@dataclass(frozen=True, kw_only=True)
class Catalogue:
    """A catalog that is being served."""

    folder: Path
    url: str
    """What a viewer or a client opens: ``rerun+http://HOST:PORT``."""
    recordings: dict[str, dict[Path, _Signature]]
    """Dataset → its recordings as they were taken up. A dataset is a folder; the top one has the name of the
    folder served."""
    server: Any
    """rerun's server."""

    @property
    def n_recordings(self) -> dict[str, int]:
        """Dataset → recordings."""
        return {name: len(paths) for name, paths in self.recordings.items()}

    def take_up(self) -> list[Path]:
        """Serve recordings that have come, or changed, since the folder was last looked at; gives them back.

        One that cannot be read, because it is still being written, is tried again the next time.

        Raises:
            DemoplanError: If datafusion, of which rerun's client is made, is not installed.
        """
        came = []
        for name, found in _recordings(self.folder).items():
            known = self.recordings.get(name, {})
            new = {path: signature for path, signature in found.items() if known.get(path) != signature}
            if new:
                dataset = _client(self.server).create_dataset(name, exist_ok=True)
                taken = _registered(dataset, sorted(new))
                self.recordings.setdefault(name, {}).update({path: new[path] for path in taken})
                came += taken
        return came


@contextmanager
def served(folder: Path, *, host: str = "127.0.0.1", port: int = 0) -> Iterator[Catalogue]:
    """Serve all recordings below a folder for as long as the block lasts.

    Args:
        folder: Where the recordings are; each sub-folder with some is a dataset of its own.
        host: Address to listen on.
        port: Port; 0 takes a free one.

    Raises:
        UsageError: If the folder is not there, or holds no recording.
        DemoplanError: If the server does not start: the port is taken, or a recording cannot be read.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder")
    recordings = _recordings(folder)
    datasets = {name: list(paths) for name, paths in recordings.items()}
    if not datasets:
        raise UsageError(
            f"{folder}: no recordings (.rrd) here; `demoplan view EPISODE -o FILE.rrd` makes one"
        )
    try:
        server = Server(host=host, port=port, datasets=datasets)  # type: ignore[arg-type]
    except Exception as error:  # rerun raises several kinds, none of them its own
        raise DemoplanError(f"rerun's catalog does not serve {folder}: {error}") from error
    try:
        _lay_out(server, datasets)
        yield Catalogue(folder=folder, url=server.url(), recordings=recordings, server=server)
    finally:
        if server.is_running():
            server.shutdown()


def _recordings(folder: Path) -> dict[str, dict[Path, _Signature]]:
    """Dataset → recordings below a folder, in order of their paths."""
    found: dict[str, dict[Path, _Signature]] = {}
    for path in sorted(folder.rglob("*.rrd")):
        if not path.name.startswith("."):
            inner = path.parent.relative_to(folder).as_posix()
            name = folder.resolve().name if inner == "." else inner.replace("/", ":")
            try:
                now = path.stat()
            except FileNotFoundError:  # replaced or removed meanwhile
                continue
            found.setdefault(name, {})[path] = now.st_size, now.st_mtime_ns
    return found


def _registered(dataset: Any, paths: Sequence[Path]) -> list[Path]:
    """Register recordings with rerun's dataset; those that it took, all at once if none is bad."""
    uris = [path.resolve().as_uri() for path in paths]
    try:
        dataset.register(uris, on_duplicate=OnDuplicateSegmentLayer.REPLACE).wait()
    except Exception:  # rerun raises several kinds, none of them its own
        return [path for each in paths for path in _registered(dataset, [each])] if len(paths) > 1 else []
    return list(paths)


def _lay_out(server: Server, datasets: dict[str, list[Path]]) -> None:
    """Let each dataset open with the layout of its largest recording, which shows most.

    The viewer takes no recording's own layout from a catalog: without this, it makes one up.
    """
    if not has_client():
        return
    client = _client(server)
    for name, paths in datasets.items():
        richest = max(paths, key=lambda path: (path.stat().st_size, path))
        if RrdReader(richest).blueprints():
            client.get_dataset(name).register_blueprint(richest.resolve().as_uri())


def has_client() -> bool:
    """Whether datafusion is installed, of which rerun's client is made."""
    return importlib.util.find_spec("datafusion") is not None


def _client(server: Server) -> Any:
    if not has_client():
        raise DemoplanError("queries need the extra 'catalog': pip install 'demoplan[catalog]'")
    return server.client()


def matching(catalogue: Catalogue, where: str) -> pl.DataFrame:
    """The recordings for which a condition holds, asked of the server through rerun's client.

    Args:
        catalogue: A catalog that is being served.
        where: SQL condition over the recordings' properties: ``success = false AND fault IS NOT NULL``. What
            a recording does not state is null. A doubled ``==`` is taken as ``=``.

    Returns:
        One row per recording: its dataset, id, address, and all properties, sorted by dataset and id.

    Raises:
        DemoplanError: If datafusion, of which the client is made, is not installed.
        UsageError: If the condition is none; the message names the columns.
    """
    client = _client(catalogue.server)
    found = []
    for name in sorted(catalogue.n_recordings):
        dataset = client.get_dataset(name)
        table = _properties(dataset.segment_table())
        urls = [dataset.segment_url(segment) for segment in table["id"]]
        found.append(table.with_columns(pl.lit(name).alias("dataset_of"), pl.Series("url", urls, pl.String)))
    whole = pl.concat(found, how="diagonal_relaxed").rename({"dataset_of": "folder"})
    try:
        # Asked here, over all folders at once: the server has a table for each.
        rows = pl.SQLContext({_TABLE: whole}).execute(
            f"SELECT * FROM {_TABLE} WHERE {where.replace('==', '=')}",  # noqa: S608
            eager=True,
        )
    except pl.exceptions.PolarsError as error:
        raise UsageError(f"--where {where!r}: {error}; columns: {', '.join(sorted(whole.columns))}") from None
    first = ["folder", "id"]
    return rows.select(*first, pl.exclude(*first, "url"), "url").sort(first)


def _properties(segments: Any) -> pl.DataFrame:
    """Id and properties of a dataset's recordings: each property has one value, or is null."""
    from datafusion import col  # noqa: PLC0415 - an extra

    prefix = f"property:{PROPERTIES}:"
    names = [field.name for field in segments.schema() if field.name.startswith(prefix)]
    # Column names hold colons and capitals, which must not be read as SQL.
    chosen = [col(f'"{_SEGMENT}"'), *(col(f'"{name}"') for name in names)]
    table = pl.from_arrow(segments.select(*chosen).to_arrow_table())
    assert isinstance(table, pl.DataFrame)
    values = [
        pl.col(name).list.first().alias(name.removeprefix(prefix))
        for name in names
        if name.removeprefix(prefix) != "id"
    ]
    return table.select(pl.col(_SEGMENT).alias("id"), *values)


def wait_for_end(look: Callable[[], None], every_s: float = LOOK_AGAIN_S) -> None:
    """Wait until the process is asked to end, by Ctrl-C or by a signal; look at something now and then."""
    ended = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        ended.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        # In slices: a wait without end would not let the signal's handler run on every platform.
        looked_s = time.monotonic()
        while not ended.wait(0.5):
            if time.monotonic() - looked_s >= every_s:
                look()
                looked_s = time.monotonic()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
