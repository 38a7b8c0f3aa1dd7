"""Goals files: what robots shall reach, and in which scenes it is tried."""

from pathlib import Path

from pydantic import Field

from demoplan.manifests.dataset import SafeName
from demoplan.manifests.loading import load_yaml, read_text
from demoplan.manifests.mapping import Strict


class GoalCase(Strict):
    """A goal, and the kind of scene that it is tried in."""

    name: SafeName
    goal: str
    """Goal text, as ``onTop(cube_red,cube_blue) & onTop(cube_blue,cube_green)``."""
    cubes: tuple[str, ...] = ("cube_red", "cube_blue", "cube_green", "cube_yellow")
    """Cubes at places drawn from the seed."""
    stacked: tuple[tuple[str, str], ...] = ()
    """(cube, cube below it) pairs that hold at the start."""
    edges_m: tuple[float, ...] = Field(default=(0.05,), min_length=1)
    """Edges of cubes; one is drawn for each."""
    scene: str | None = None
    """A scene's file, relative to this one, in place of a drawn scene."""


class GoalsFile(Strict):
    """The form of a goals file."""

    goals: tuple[GoalCase, ...]


def parse_goals(text: str, path: Path | str) -> tuple[GoalCase, ...]:
    """The goals that a file describes.

    Raises:
        ManifestError: If its form is wrong, or a name is used twice; with the line.
    """
    return load_yaml(text, path, GoalsFile, unique={"goals": "name"}).goals


def read_goals(path: Path) -> tuple[GoalCase, ...]:
    """The goals that a file describes; see :func:`parse_goals`."""
    return parse_goals(read_text(path), path)
