"""An episode, to look at: saved for later, opened in a viewer, or drawn into a picture."""

import os
import tempfile
from pathlib import Path

from demoplan.errors import UsageError
from demoplan.viewers import rerun_adapter
from demoplan.viewers.compose import compose_episode
from demoplan.viewers.sources import EpisodeTables, EpisodeViewParams


def save_episode(path: Path, tables: EpisodeTables, params: EpisodeViewParams | None = None) -> Path:
    """Write an episode's recording; whole, or not at all.

    Args:
        path: Where it goes, ``….rrd``; its folder is made, an older file is replaced.
        tables: What is known of the episode.
        params: Choices of the view.

    Returns:
        The path, for the next call.

    Raises:
        UsageError: If the name does not end in ``.rrd``.
        UnknownNameError: If the frames hold nothing of the episode.
    """
    if path.suffix != ".rrd":
        raise UsageError(f"a recording is written to a file that ends in .rrd; asked for {path.name!r}")
    view = compose_episode(tables, params)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=".rrd")
    os.close(handle)
    partial = Path(name)
    try:
        rerun_adapter.write_recording(view, partial)
        with partial.open("rb") as written:
            os.fsync(written.fileno())
        partial.chmod(0o644)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    return path


def open_episode(path: Path, *, url: str | None = None) -> None:
    """Open a saved recording: in the viewer at ``url`` if given, else in a new one that is left running.

    Raises:
        UsageError: If there is no such recording.
        DemoplanError: If no viewer starts (no screen), or none answers at ``url``.
    """
    _require(path)
    rerun_adapter.show(path, url=url)


def render_episode_png(
    path: Path,
    png: Path,
    *,
    at_ns: int | None = None,
    size_px: tuple[int, int] = (1680, 1000),
    timeout_s: float = 60.0,
) -> Path:
    """Draw a saved recording's prepared layout into a PNG; needs no screen, but a Vulkan driver.

    Args:
        path: The recording.
        png: Where the picture goes.
        at_ns: Where the time cursor stands, from the episode's start [ns]; by default at its end.
        size_px: Width and height [px].
        timeout_s: How long the viewer may take to start and load [s].

    Raises:
        UsageError: If there is no such recording.
        DemoplanError: If the viewer does not start or does not draw in time.
    """
    _require(path)
    png.parent.mkdir(parents=True, exist_ok=True)
    rerun_adapter.picture(path, png, at_ns=at_ns, size_px=size_px, timeout_s=timeout_s)
    return png


def _require(path: Path) -> None:
    if not path.is_file():
        raise UsageError(
            f"no recording at {path}; write one first with 'demoplan view EPISODE -o {path.name}'"
        )
