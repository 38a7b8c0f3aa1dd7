"""Episode views in rerun: the one module that knows rerun's API, pinned to 0.41.

Everything is sent in columns. Two timelines: ``episode`` counts from the first tick, ``clock`` is the
absolute time of the log. Data is sent after the layout, so that a viewer that streams shows it at once.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_cli  # type: ignore[import-untyped]
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from demoplan.errors import DemoplanError
from demoplan.viewers.episode_view import Body, Chart, EpisodeView, Lane, Segments, Ticks

APPLICATIONS = {"demonstration": "demoplan", "execution": "demoplan-execution"}
"""Kind of view → application: recordings of one application share their layout in the viewer."""

PROPERTIES = "episode"
"""Recording property under which a catalog finds what an episode or execution is."""

EPISODE_TIMELINE = "episode"
CLOCK_TIMELINE = "clock"

_HAND_RADIUS_M = 0.014
_GRIP_RADIUS_M = 0.012
_WORLD = "world"
_NOTICES_S = 7.0
"""How long the viewer's notices stay at most, each frame drawn by software [s]."""

# Heights in the viewer at its usual scale, from which the shares of the layout come.
_HEADER_PX = 84.0
_LANE_PX = 40.0
_CHART_PX = 145.0


def write_recording(view: EpisodeView, path: Path) -> None:
    """Write a view to a file; an existing file is overwritten.

    The recording's id is the episode's id, so that further files of the same episode open as layers of it.
    """
    # Without strict mode, what rerun cannot take becomes a warning and is missing from the recording.
    was_strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        with rr.RecordingStream(
            APPLICATIONS[view.kind], recording_id=view.episode_id, send_properties=False
        ) as recording:
            recording.save(str(path), default_blueprint=_blueprint(view))
            _send(view, recording)
            recording.flush()
            recording.disconnect()
    finally:
        rr.set_strict_mode(was_strict)


def show(path: Path, *, url: str | None = None) -> None:
    """Open a written recording in a viewer.

    Args:
        path: The recording.
        url: A running viewer, ``rerun+http://127.0.0.1:9876/proxy``; by default one is started and left
            running, which listens on this machine only.

    Raises:
        DemoplanError: If no viewer starts, or none answers at ``url``.
    """
    if url is not None:
        try:
            ViewerClient.connect(url).open(str(path.resolve()))
        except Exception as error:  # rerun raises several kinds, none of them its own
            raise DemoplanError(f"no rerun viewer answers at {url}: {error}") from error
        return
    command = [_viewer_executable(), "--bind", "127.0.0.1", "--port", "auto", str(path.resolve())]
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    child = subprocess.Popen(command, start_new_session=True, **quiet)  # type: ignore[call-overload]
    time.sleep(1.0)
    if child.poll() not in (None, 0):
        raise DemoplanError(
            f"the rerun viewer ended at once with code {child.returncode}; is there a screen? "
            f"The recording is in {path}: open it elsewhere with 'rerun {path.name}'"
        )


def picture(path: Path, png: Path, *, at_ns: int | None, size_px: tuple[int, int], timeout_s: float) -> None:
    """Draw a recording's prepared layout into a PNG, without a screen.

    Needs a Vulkan driver; a software one will do (Debian: ``mesa-vulkan-drivers``).

    Args:
        path: The recording.
        png: Where the picture goes.
        at_ns: Where the time cursor stands, from the episode's start [ns].
        size_px: Width and height [px].
        timeout_s: How long the viewer may take to start and load [s].

    Raises:
        DemoplanError: If the viewer does not start or does not answer in time.
    """
    with _headless_viewer(size_px, timeout_s) as client:
        begun = time.monotonic()
        try:
            client.open(str(path.resolve()))
            deadline = time.monotonic() + timeout_s
            while client.get_state().loading and time.monotonic() < deadline:
                time.sleep(0.1)
            if at_ns is not None:
                client.set_time(EPISODE_TIMELINE, duration=at_ns * 1e-9)
            # The camera eases to its place, time axes settle over the first frames, and what the viewer has
            # to say about the machine lies over the views for a while: the picture is taken after that.
            while time.monotonic() < begun + _NOTICES_S:
                client.take_screenshot()
                time.sleep(0.3)
            png.write_bytes(client.take_screenshot())
        except Exception as error:
            raise DemoplanError(f"the rerun viewer did not draw {path}: {error}") from error


def _viewer_executable() -> str:
    """The viewer itself: killing the script around it would leave it running."""
    name = "rerun.exe" if sys.platform.startswith("win") else "rerun"
    return str(Path(rerun_cli.__file__).parent / name)


@contextmanager
def _headless_viewer(size_px: tuple[int, int], timeout_s: float) -> Iterator[ViewerClient]:
    """A viewer without a window, in a process group of its own, that answers on loopback only."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory(prefix="demoplan-view-") as home:
        command = [_viewer_executable(), "--headless", "--hide-welcome-screen", "--bind", "127.0.0.1"]
        command += ["--port", str(port), "--window-size", f"{size_px[0]}x{size_px[1]}"]
        # A home of its own: none of the user's settings or state. With CI set, nothing is reported home.
        environment = {**os.environ, "HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home, "CI": "1"}
        log = Path(home) / "viewer.log"
        with log.open("wb") as sink:
            child = subprocess.Popen(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=sink,
                start_new_session=True,
            )
        try:
            deadline = time.monotonic() + timeout_s
            client = None
            while client is None:
                if child.poll() is not None or time.monotonic() > deadline:
                    said = log.read_text(errors="replace").strip().splitlines()[-1:] or ["nothing"]
                    raise DemoplanError(
                        "the rerun viewer does not start without a screen; it said: "
                        f"{said[0]}. It needs a Vulkan driver (Debian: mesa-vulkan-drivers)"
                    )
                try:
                    client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                    client.get_state()
                except Exception:
                    client = None
                    time.sleep(0.1)
            yield client
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGTERM)
                try:
                    child.wait(timeout=5)
                except subprocess.TimeoutExpired:
                    os.killpg(child.pid, signal.SIGKILL)
                    child.wait()


def _path(*parts: str) -> str:
    """An entity path; parts are escaped, since they come from logs."""
    return str(rr.new_entity_path(list(parts)))


_TAKEN = frozenset({"world", "about", "signals", "log"})
"""First parts of paths that are no lanes."""


def _lane_path(lane: Lane) -> str:
    """A lane's path. The viewer shows it as the lane's name, so that nothing stands before it."""
    first, *rest = lane.path
    return _path(f"{first}_" if first in _TAKEN else first, *rest)


def _send(view: EpisodeView, recording: rr.RecordingStream) -> None:
    def times(ticks_ns: Ticks) -> list[Any]:
        return [
            rr.TimeColumn(EPISODE_TIMELINE, duration=(ticks_ns - view.start_ns).astype("timedelta64[ns]")),
            rr.TimeColumn(CLOCK_TIMELINE, timestamp=ticks_ns.astype("datetime64[ns]")),
        ]

    recording.send_recording_name(view.title)
    values: dict[str, Any] = dict(view.properties)
    recording.send_property(PROPERTIES, rr.AnyValues(**values))
    recording.log(_path(_WORLD), rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("about", rr.TextDocument(view.document, media_type=rr.MediaType.MARKDOWN), static=True)
    for body in view.bodies:
        _send_body(body, recording, times)
    for trail in view.trails:
        _send_segments(_path(_WORLD, "trails", trail.name), trail, 0.0022, recording, times)
    _send_segments(_path(_WORLD, "contacts"), view.contacts, 0.0028, recording, times)
    sent: set[str] = set()
    for lane in (*view.plan_lanes, *view.hand_lanes, *view.relation_lanes, *view.fact_lanes):
        path = _lane_path(lane)
        if path not in sent:
            sent.add(path)
            _send_lane(path, lane, recording, times)
    for chart in view.charts:
        _send_chart(chart, view, recording, times)
    for log in view.logs:
        ticks = np.array([note.tick_ns for note in log.notes], dtype=np.int64)
        columns = rr.TextLog.columns(
            text=[note.text for note in log.notes],
            level=[note.level for note in log.notes],
            color=[note.colour for note in log.notes],
        )
        recording.send_columns(_path("log", log.name), times(ticks), columns)


def _send_body(body: Body, recording: rr.RecordingStream, times: Callable[[Ticks], list[Any]]) -> None:
    """Poses per tick; geometry where the body appears, and none from where it is lost from sight.

    Static geometry would stay where it was last seen; a cleared transform would put it at the origin.
    """
    entity = body.entity
    path = _path(_WORLD, "hands" if entity.is_hand else "objects", entity.name)
    recording.log(path, rr.AnyValues(type=entity.type_name, shape=entity.shape.kind), static=True)
    if len(body.change_ticks_ns) == 0:
        return
    columns = rr.Transform3D.columns(
        translation=body.positions_xyz_m, quaternion=body.orientations_wxyz[:, [1, 2, 3, 0]]
    )
    recording.send_columns(path, times(body.ticks_ns), columns)
    counts = body.is_visible.astype(np.int64)
    n = int(counts.sum())
    size = np.array(entity.shape.size_xyz_m, dtype=np.float64)
    centre = np.tile(entity.shape.centre_xyz_m, (n, 1))
    colour = np.tile(np.array(body.colour, dtype=np.uint8), (n, 1))
    kind = entity.shape.kind
    drawn: Any
    if kind == "box" and entity.is_surface:
        recording.log(path, rr.Boxes3D.from_fields(fill_mode="solid"), static=True)
        drawn = rr.Boxes3D.columns(half_sizes=np.tile(size / 2, (n, 1)), centers=centre, colors=colour)
        # A label in the middle of a table would hide what stands there.
        corner = np.array(entity.shape.centre_xyz_m) + size / 2 * np.array([-0.96, -0.92, 1.0])
        label = rr.Points3D([corner], radii=[0.0005], labels=[body.label], colors=[body.colour])
        recording.log(path + "/label", label, static=True)
    elif kind == "box":
        recording.log(path, rr.Boxes3D.from_fields(fill_mode="transparentfillmajorwireframe"), static=True)
        drawn = rr.Boxes3D.columns(
            half_sizes=np.tile(size / 2, (n, 1)), centers=centre, labels=[body.label] * n, colors=colour
        )
    elif kind == "cylinder":
        recording.log(
            path, rr.Cylinders3D.from_fields(fill_mode="transparentfillmajorwireframe"), static=True
        )
        drawn = rr.Cylinders3D.columns(
            lengths=np.full(n, size[2]),
            radii=np.full(n, size[:2].mean() / 2),
            centers=centre,
            labels=[body.label] * n,
            colors=colour,
        )
    elif kind == "sphere":
        style = rr.Ellipsoids3D.from_fields(fill_mode="transparentfillmajorwireframe")
        recording.log(path, style, static=True)
        drawn = rr.Ellipsoids3D.columns(
            half_sizes=np.tile(size / 2, (n, 1)), centers=centre, labels=[body.label] * n, colors=colour
        )
    else:
        drawn = []
    if entity.is_hand or kind == "point":
        # A hand is seen through its extent: what it holds must not hide in it.
        radii = np.full(n, _HAND_RADIUS_M) if body.grips is None else None
        labels = None if drawn else [body.label] * n
        points = rr.Points3D.columns(positions=centre, radii=radii, labels=labels, colors=colour)
        drawn = [*drawn, *points]
        if body.grips is not None:
            _send_grip(path, body, recording, times)
    recording.send_columns(path, times(body.change_ticks_ns), [column.partition(counts) for column in drawn])


def _send_grip(
    path: str, body: Body, recording: rr.RecordingStream, times: Callable[[Ticks], list[Any]]
) -> None:
    """A hand is a point that swells as it opens; sent where the opening changes only."""
    assert body.grips is not None
    known = np.flatnonzero(np.isfinite(body.grips))
    grips = body.grips[known]
    is_new = np.concatenate(([True], grips[1:] != grips[:-1]))[: len(grips)]
    radii = _HAND_RADIUS_M + _GRIP_RADIUS_M * grips[is_new]
    recording.send_columns(path, times(body.ticks_ns[known[is_new]]), rr.Points3D.columns(radii=radii))


def _send_segments(
    path: str,
    segments: Segments,
    radius_m: float,
    recording: rr.RecordingStream,
    times: Callable[[Ticks], list[Any]],
) -> None:
    if len(segments.ticks_ns) == 0:
        return
    style = rr.LineStrips3D.from_fields(colors=[segments.colour], radii=[radius_m])
    recording.log(path, style, static=True)
    columns = rr.LineStrips3D.columns(strips=list(segments.lines_xyz_m.astype(np.float32)))
    recording.send_columns(path, times(segments.ticks_ns), [c.partition(segments.counts) for c in columns])


def _send_lane(
    path: str, lane: Lane, recording: rr.RecordingStream, times: Callable[[Ticks], list[Any]]
) -> None:
    states = [state for state, _ in lane.colours]
    labels = [label for _, label in lane.labels] if lane.labels else states
    style = rr.StateConfiguration(values=states, labels=labels, colors=[colour for _, colour in lane.colours])
    recording.log(path, style, static=True)
    # An empty text ends the state before it.
    recording.send_columns(
        path, times(lane.ticks_ns), rr.StateChange.columns(state=[s or "" for s in lane.states])
    )


def _send_chart(
    chart: Chart, view: EpisodeView, recording: rr.RecordingStream, times: Callable[[Ticks], list[Any]]
) -> None:
    for curve in chart.curves:
        path = _path("signals", chart.name, curve.name)
        recording.log(
            path, rr.SeriesLines(colors=[curve.colour], names=[curve.name], widths=[1.6]), static=True
        )
        # NaN breaks a line, as a gap should; one NaN per run is enough, but all keep the row count plain.
        recording.send_columns(path, times(curve.ticks_ns), rr.Scalars.columns(scalars=curve.values))
    span = np.array([view.start_ns, view.end_ns], dtype=np.int64)
    for threshold in chart.thresholds:
        path = _path("signals", chart.name, "thresholds", threshold.name)
        style = rr.SeriesLines(
            colors=[(150, 154, 160)], names=[f"{threshold.name} {threshold.value:g}"], widths=[0.8]
        )
        recording.log(path, style, static=True)
        recording.send_columns(path, times(span), rr.Scalars.columns(scalars=np.full(2, threshold.value)))


def _blueprint(view: EpisodeView) -> rrb.Blueprint:
    """Scene and description on the left; lanes and signals on one shared time axis on the right."""
    left = _left(view)
    right, shares = _right(view)
    columns: list[Any] = [left]
    if right:
        columns.append(rrb.Vertical(*right, row_shares=shares))
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=[1.0, 1.25][: len(columns)]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=EPISODE_TIMELINE, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


def _left(view: EpisodeView) -> Any:
    """The scene; below it what the recording is, beside what was noted."""
    details: list[Any] = [rrb.TextDocumentView(origin="about", name="About")]
    if view.logs:
        only_text = rrb.TextLogColumns(text_log_columns=["body"])
        logs = [
            rrb.TextLogView(origin=_path("log", log.name), name=log.title, columns=only_text)
            for log in view.logs
        ]
        details.append(rrb.Tabs(*logs, active_tab=0) if len(logs) > 1 else logs[0])
    below = rrb.Horizontal(*details, column_shares=[1.0, 1.3][: len(details)])
    if not view.bodies:
        return below
    # Most of what is to be seen rests low, with the hands above it.
    focus = np.array(view.focus_xyz_m) - np.array([0.0, 0.0, 0.2 * view.extent_m])
    eye = focus + view.extent_m * np.array([0.25, -1.75, 1.4])
    trail = rrb.VisibleTimeRanges(
        timeline=EPISODE_TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-view.trail_ns * 1e-9),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    scene = rrb.Spatial3DView(
        origin=_path(_WORLD),
        name="Scene",
        background=(24, 26, 30),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=focus, eye_up=(0.0, 0.0, 1.0)),
        overrides={_path(_WORLD, "trails", segments.name): trail for segments in view.trails},
    )
    return rrb.Vertical(scene, below, row_shares=[2.0, 1.0])


def _right(view: EpisodeView) -> tuple[list[Any], list[float]]:
    """Lanes and charts from top to bottom, and the share of the height that each takes."""
    axis = rrb.archetypes.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)

    def lanes_view(lanes: Sequence[Lane], name: str) -> Any:
        contents = [f"+ {_lane_path(lane)}" for lane in lanes]
        return rrb.StateTimelineView(origin="/", contents=contents, name=name, time_view=axis)

    views: list[Any] = []
    shares: list[float] = []
    for lanes, name in ((view.plan_lanes, "Plan"), (view.hand_lanes, "Hands")):
        if lanes:
            views.append(lanes_view(lanes, name))
            shares.append(_HEADER_PX + _LANE_PX * min(len(lanes), 8))
    predicates = [
        lanes_view(lanes, name)
        for lanes, name in ((view.relation_lanes, "Relations"), (view.fact_lanes, "All predicates"))
        if lanes
    ]
    if predicates:
        views.append(rrb.Tabs(*predicates, active_tab=0) if len(predicates) > 1 else predicates[0])
        first = view.relation_lanes or view.fact_lanes
        shares.append(_HEADER_PX + _LANE_PX * min(max(len(first), 4), 9))
    for chart in view.charts:
        # All charts show the same hands in the same colours: one legend is enough.
        views.append(_chart_view(chart, axis, has_legend=chart is view.charts[0]))
        shares.append(_CHART_PX)
    return views, shares


def _chart_view(chart: Chart, axis: Any, *, has_legend: bool) -> Any:
    return rrb.TimeSeriesView(
        origin=_path("signals", chart.name),
        name=chart.title,
        axis_x=axis,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=has_legend),
    )


def viewer_paths(path: Path) -> dict[str, int]:
    """Rows per entity path of a written recording, static rows left out: what a check reads back."""
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        if not chunk.is_static:
            rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    return rows


__all__: Sequence[str] = ("picture", "show", "viewer_paths", "write_recording")
