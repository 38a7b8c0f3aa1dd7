"""Pictures and short videos of a session, drawn off screen when it is over, by EGL or by OSMesa.

One process draws at a time: several EGL contexts at once are known to hang. Nothing here is needed to run.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.filming import Film
from demoplan.engines.mujoco.scene import TABLE
from demoplan.errors import SimulationError, UnknownNameError, UsageError
from demoplan.geometry import Array

Image = NDArray[np.uint8]
"""Red, green, blue: ``(height, width, 3)``."""

BACKENDS = ("egl", "osmesa")
PICTURE_SUFFIXES = (".png", ".jpg", ".webp")
VIDEO_SUFFIXES = (".gif", ".webp")

_PACKAGES = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
_WALL_RGB = np.array([0.36, 0.42, 0.48])
_FLOOR_RGB = np.array([0.82, 0.84, 0.87])
_ROOM_M = 9.0
_FLOOR_M = -0.70
_LEG_M = 0.025


@dataclass(frozen=True, kw_only=True)
class DrawParams:
    """What a picture shows."""

    width: int = 960
    height: int = 640
    azimuth_deg: float = 148.0
    """From where one looks, about the vertical; 180 looks at the robot from across the table."""
    elevation_deg: float = -17.0
    distance_m: float = 1.9
    lookat_xyz_m: tuple[float, float, float] = (-0.24, 0.0, 0.10)
    has_shadows: bool = True
    """They cost most of the time that a picture takes."""
    backend: str = "egl"
    """``egl`` or ``osmesa``."""


PICTURE = DrawParams()
VIDEO = DrawParams(width=480, height=320, has_shadows=False)


def require_drawing(picture: Path | None, video: Path | None, backend: str) -> None:
    """Refuse what could not be drawn in the end, before anything is run for it.

    Raises:
        UsageError: If a format is unknown.
        SimulationError: If nothing can draw here, or what writes pictures is missing.
    """
    for path, suffixes in ((picture, PICTURE_SUFFIXES), (video, VIDEO_SUFFIXES)):
        if path is not None:
            _require_suffix(path, suffixes)
    _pillow()
    _open_context(DrawParams(width=16, height=16, backend=backend)).free()


def save_picture(film: Film, path: Path, *, at_s: float | None = None, params: DrawParams = PICTURE) -> None:
    """Draw one instant of a film.

    Args:
        film: What happened.
        path: Where the picture goes; its suffix says in which format.
        at_s: When; by default at the end [s].
        params: What it shows.

    Raises:
        UsageError: If the format is unknown, or the film is empty.
        SimulationError: If nothing can draw here, or what writes pictures is missing.
    """
    _require_suffix(path, PICTURE_SUFFIXES)
    times = np.array(_filled(film).time_ns) / 1e9
    row = len(times) - 1 if at_s is None else int(np.argmin(np.abs(times - at_s)))
    with _drawer(film, params) as draw:
        _pillow().fromarray(draw(row)).save(path)


def save_video(
    film: Film,
    path: Path,
    *,
    speed: float = 4.0,
    rate_hz: float = 10.0,
    params: DrawParams = VIDEO,
) -> None:
    """Draw a film as a short video.

    Args:
        film: What happened.
        path: Where it goes, ``….gif`` or ``….webp``.
        speed: How many times faster than it happened.
        rate_hz: Pictures per second of the video.
        params: What it shows.

    Raises:
        UsageError: If the format is unknown, or the film is empty.
        SimulationError: If nothing can draw here, or what writes videos is missing.
    """
    _require_suffix(path, VIDEO_SUFFIXES)
    times = np.array(_filled(film).time_ns) / 1e9
    wanted = np.arange(times[0], times[-1] + 1e-9, speed / rate_hz)
    rows = np.unique(np.searchsorted(times, wanted).clip(0, len(times) - 1))
    pillow = _pillow()
    with _drawer(film, params) as draw:
        frames = [pillow.fromarray(draw(int(row))) for row in rows]
    if path.suffix == ".gif":
        # One palette for all, else colours flicker.
        palette = frames[len(frames) // 2].quantize(colors=128)
        frames = [each.quantize(palette=palette, dither=0) for each in frames]
    lasts_ms = round(1e3 / rate_hz)
    durations = [lasts_ms] * (len(frames) - 1) + [1500]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=durations, loop=0)


def _filled(film: Film) -> Film:
    if film.model is None:
        raise UsageError("there is nothing to draw: the session has not begun")
    return film


def _require_suffix(path: Path, suffixes: tuple[str, ...]) -> None:
    if path.suffix.lower() not in suffixes:
        raise UsageError(
            f"{path}: cannot be written as {path.suffix or 'a file without suffix'!r}; "
            f"available: {', '.join(suffixes)}"
        )


def _pillow() -> Any:
    try:
        return import_module("PIL.Image")
    except ModuleNotFoundError:
        raise SimulationError("pictures need pillow: install demoplan with the extra 'pictures'") from None


def _open_context(params: DrawParams) -> Any:
    """A context to draw in, off screen."""
    if params.backend not in BACKENDS:
        raise UnknownNameError("way to draw", params.backend, BACKENDS)
    try:
        context = import_module(f"mujoco.{params.backend}").GLContext(params.width, params.height)
        context.make_current()
    except Exception as error:
        other = next(name for name in BACKENDS if name != params.backend)
        raise SimulationError(
            f"nothing can be drawn here by {params.backend} ({type(error).__name__}: {error}): install it "
            f"(Debian: {_PACKAGES[params.backend]}), or set DEMOPLAN_GL={other} ({_PACKAGES[other]}); "
            "runs themselves need neither"
        ) from None
    return context


@contextmanager
def _drawer(film: Film, params: DrawParams) -> Iterator[Callable[[int], Image]]:
    """A function that draws the film's n-th configuration."""
    model = _filled(film).model
    assert model is not None
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, params.width)
    model.vis.quality.shadowsize = 4096
    model.vis.global_.offheight = max(model.vis.global_.offheight, params.height)
    opened = _open_context(params)
    try:
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        data, scene = mujoco.MjData(model), mujoco.MjvScene(model, maxgeom=model.ngeom + 200)
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = params.has_shadows
        scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        seen, camera = mujoco.MjvOption(), mujoco.MjvCamera()
        # Solids for contacts are not for the eye.
        seen.geomgroup[:] = [1, 1, 1, 0, 0, 0]
        camera.azimuth, camera.elevation = params.azimuth_deg, params.elevation_deg
        camera.distance, camera.lookat = params.distance_m, params.lookat_xyz_m
        viewport = mujoco.MjrRect(0, 0, params.width, params.height)

        def draw(row: int) -> Image:
            data.qpos[:], data.mocap_pos[:] = film.positions[row], film.obstacles[row]
            mujoco.mj_forward(model, data)
            mujoco.mjv_updateScene(
                model, data, seen, mujoco.MjvPerturb(), camera, mujoco.mjtCatBit.mjCAT_ALL, scene
            )
            _light(scene, has_shadows=params.has_shadows)
            _add_room(scene, model)
            mujoco.mjr_render(viewport, scene, context)
            image = np.empty((params.height, params.width, 3), dtype=np.uint8)
            mujoco.mjr_readPixels(image, None, viewport, context)
            return image[::-1]

        yield draw
    finally:
        opened.free()


def _light(scene: mujoco.MjvScene, *, has_shadows: bool) -> None:
    """Soft light from everywhere, and one lamp that casts shadows."""
    for light in scene.lights[: scene.nlight]:
        light.ambient[:] = 0.35 if light.headlight else 0.10
        light.diffuse[:] = 0.30 if light.headlight else 0.55
        light.specular[:] = 0.05 if light.headlight else 0.20
        if not light.headlight:
            light.type, light.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, has_shadows
            light.pos[:], light.dir[:] = (1.4, -1.1, 2.6), (-0.45, 0.35, -0.82)


def _add_room(scene: mujoco.MjvScene, model: mujoco.MjModel) -> None:
    """A floor, a wall all about that is as bright everywhere, and legs for the table: for the eye alone."""
    table = model.geom(TABLE)
    depth, width, _ = table.size
    # What is under a table top of some thickness; it lies at z = 0.
    height = (-_FLOOR_M - 2.0 * table.size[2]) / 2
    _add(scene, [_ROOM_M, _ROOM_M, 0.01], [0.0, 0.0, _FLOOR_M - 0.01], _FLOOR_RGB)
    for x, y in ((-_ROOM_M, 0.0), (_ROOM_M, 0.0), (0.0, -_ROOM_M), (0.0, _ROOM_M)):
        half_size = [0.01 if x else _ROOM_M, 0.01 if y else _ROOM_M, _ROOM_M]
        _add(scene, half_size, [x, y, 0.0], _WALL_RGB, emission=0.55)
    for x, y in product((-depth + 0.05, depth - 0.05), (-width + 0.05, width - 0.05)):
        centre = [x, y, _FLOOR_M + height]
        _add(scene, [_LEG_M, _LEG_M, height], centre, 0.8 * table.rgba[:3])


def _add(
    scene: mujoco.MjvScene,
    half_size: list[float],
    centre: list[float],
    rgb: Array,
    *,
    emission: float = 0.0,
) -> None:
    geom = scene.geoms[scene.ngeom]
    colour = np.append(rgb, 1.0).astype(np.float32)
    mujoco.mjv_initGeom(
        geom, mujoco.mjtGeom.mjGEOM_BOX, np.array(half_size), np.array(centre), np.eye(3).ravel(), colour
    )
    geom.emission = emission
    scene.ngeom += 1
