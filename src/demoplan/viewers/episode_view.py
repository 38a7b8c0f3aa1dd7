"""What an episode view holds, as plain values that know no viewer.

``compose`` makes them from tables; an adapter hands them to a viewer. All times are ticks of the episode
clock [ns, absolute]; positions are in the world frame [m]; orientations are ``w, x, y, z``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.geometry import Array
from demoplan.language.vocabulary import Shape
from demoplan.viewers.colours import Rgb

Ticks = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Entity:
    """An instance with its type and extent; ``fixed_position_xyz_m`` where no log tracks it."""

    name: str
    type_name: str
    shape: Shape
    is_hand: bool = False
    is_surface: bool = False
    fixed_position_xyz_m: tuple[float, float, float] | None = None
    fixed_orientation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Threshold:
    """A number that decides a predicate from a hand's signal."""

    quantity: str
    """``speed`` [m/s] or ``grip`` [0 closed … 1 open]."""
    name: str
    value: float


@dataclass(frozen=True, kw_only=True)
class Body:
    """An entity's path: rows where it was seen, and the ticks at which it appears and vanishes."""

    entity: Entity
    colour: Rgb
    label: str
    ticks_ns: Ticks
    """``(n,)`` ticks at which the pose was seen."""
    positions_xyz_m: Array
    """``(n, 3)``."""
    orientations_wxyz: Array
    """``(n, 4)``."""
    grips: Array | None
    """``(n,)`` opening of a hand, NaN where unknown; null for what has no grip."""
    change_ticks_ns: Ticks
    """``(k,)`` ticks at which it appears or vanishes, in order."""
    is_visible: NDArray[np.bool_]
    """``(k,)`` whether it is visible from that tick on."""


@dataclass(frozen=True, kw_only=True)
class Segments:
    """Lines between two points, some per tick: trails and contacts."""

    name: str
    colour: Rgb
    ticks_ns: Ticks
    """``(n,)`` ticks, strictly increasing."""
    counts: NDArray[np.int64]
    """``(n,)`` how many lines each tick has; 0 clears."""
    lines_xyz_m: Array
    """``(sum(counts), 2, 3)`` end points, tick after tick."""

    @classmethod
    def none(cls) -> "Segments":
        """No lines at all."""
        nothing = np.zeros(0, np.int64)
        return cls(
            name="none",
            colour=(255, 255, 255),
            ticks_ns=nothing,
            counts=nothing,
            lines_xyz_m=np.zeros((0, 2, 3)),
        )


@dataclass(frozen=True, kw_only=True)
class Lane:
    """What one thing was in at any time: a row of coloured stretches."""

    path: tuple[str, ...]
    """Group, then names; sorts the lanes and labels them."""
    ticks_ns: Ticks
    """``(n,)`` ticks at which the state changes, strictly increasing."""
    states: tuple[str | None, ...]
    """The state from that tick on; null where there is none."""
    colours: tuple[tuple[str, Rgb], ...]
    """(state, colour) pairs, sorted."""
    labels: tuple[tuple[str, str], ...] = ()
    """(state, label) pairs in the order of ``colours``; none where states label themselves."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A signal over time; NaN where it is not known."""

    name: str
    unit: str
    colour: Rgb
    ticks_ns: Ticks
    values: Array


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Curves of one quantity, with the thresholds that it is compared with."""

    name: str
    title: str
    """With the unit."""
    curves: tuple[Curve, ...]
    thresholds: tuple[Threshold, ...]


@dataclass(frozen=True, kw_only=True)
class Note:
    """A line of text at one instant."""

    tick_ns: int
    text: str
    colour: Rgb
    level: str = "INFO"
    """``INFO``, ``WARN`` or ``ERROR``."""


@dataclass(frozen=True, kw_only=True)
class Log:
    """Lines of text along the time axis, in order."""

    name: str
    title: str
    notes: tuple[Note, ...]


@dataclass(frozen=True, kw_only=True)
class EpisodeView:
    """Everything that a person wants to see of one episode, or of one execution."""

    episode_id: str
    kind: str
    """``demonstration`` or ``execution``: views of one kind share their layout."""
    title: str
    properties: tuple[tuple[str, str | int | float | bool], ...]
    """What recordings are found by, as name and value; what is not known is not there."""
    start_ns: int
    end_ns: int
    bodies: tuple[Body, ...]
    trails: tuple[Segments, ...]
    trail_ns: int
    """How far back a trail shows [ns]."""
    contacts: Segments
    plan_lanes: tuple[Lane, ...]
    """What plan was followed, and what went wrong with it."""
    hand_lanes: tuple[Lane, ...]
    relation_lanes: tuple[Lane, ...]
    """Per predicate and first argument: what the second one is."""
    fact_lanes: tuple[Lane, ...]
    """Per atom: whether it holds."""
    charts: tuple[Chart, ...]
    logs: tuple[Log, ...]
    document: str
    """Markdown: what this episode is."""
    focus_xyz_m: tuple[float, float, float]
    """Middle of where things happen."""
    extent_m: float
    """Half the diagonal of where things happen."""
