"""A folder of recordings, served through rerun's catalog so that they can be found by what they are.

Beside ``rerun_adapter``, this is the only module that knows rerun's API, pinned to 0.41.
"""

import importlib.util
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import polars as pl
from rerun.chunk import RrdReader
from rerun.server import Server

from demoplan.errors import DemoplanError, UsageError
from demoplan.viewers.rerun_adapter import PROPERTIES

_TABLE = "recordings"
_SEGMENT = "rerun_segment_id"


@dataclass(frozen=True, kw_only=True)
class Catalogue:
    """A catalog that is being served."""

    url: str
    """What a viewer or a client opens: ``rerun+http://HOST:PORT``."""
    n_recordings: dict[str, int]
    """Dataset → recordings. A dataset is a folder; the top one has the name of the folder served."""
    server: Any
    """rerun's server."""


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
    datasets: dict[str, list[Path]] = {}
    for path in sorted(folder.rglob("*.rrd")):
        if not path.name.startswith("."):
            inner = path.parent.relative_to(folder).as_posix()
            name = folder.resolve().name if inner == "." else inner.replace("/", ":")
            datasets.setdefault(name, []).append(path)
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
        yield Catalogue(
            url=server.url(),
            n_recordings={name: len(paths) for name, paths in datasets.items()},
            server=server,
        )
    finally:
        if server.is_running():
            server.shutdown()


def _lay_out(server: Server, datasets: dict[str, list[Path]]) -> None:
    """Let each dataset open with the layout of its largest recording, which shows most.

    The viewer takes no recording's own layout from a catalog: without this, it makes one up.
    """
    if not _has_client():
        return
    client = server.client()
    for name, paths in datasets.items():
        richest = max(paths, key=lambda path: (path.stat().st_size, path))
        if RrdReader(richest).blueprints():
            client.get_dataset(name).register_blueprint(richest.resolve().as_uri())


def _has_client() -> bool:
    """Whether datafusion is installed, of which rerun's client is made."""
    return importlib.util.find_spec("datafusion") is not None


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
    if not _has_client():
        raise DemoplanError("queries need the extra 'catalog': pip install 'demoplan[catalog]'")
    client = catalogue.server.client()
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


def wait_for_end() -> None:
    """Wait until the process is asked to end, by Ctrl-C or by a signal."""
    ended = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        ended.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        # In slices: a wait without end would not let the signal's handler run on every platform.
        while not ended.wait(0.5):
            pass
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
