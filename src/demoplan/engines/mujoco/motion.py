"""How a hand moves: superposed minimum-jerk submovements, tremor, and hesitations as a slowed clock."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from demoplan.geometry import Array


def minimum_jerk(fraction: Array) -> Array:
    """Share of the way that is done after ``fraction`` of the time, for the path of least squared jerk.

    Source: T. Flash, N. Hogan, "The coordination of arm movements: an experimentally confirmed mathematical
    model", Journal of Neuroscience 5(7), 1985, doi:10.1523/JNEUROSCI.05-07-01688.1985, equation 3.
    """
    t = np.clip(fraction, 0.0, 1.0)
    return t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)


@dataclass(frozen=True)
class Submovement:
    """One minimum-jerk displacement, which may overlap others in time."""

    delta_xyz_m: tuple[float, float, float]
    onset_s: float
    duration_s: float


class Path:
    """A sum of submovements, evaluated at any time.

    Source: T. Flash, E. Henis, "Arm trajectory modifications during reaching towards visual targets", Journal
    of Cognitive Neuroscience 3(3), 1991, doi:10.1162/jocn.1991.3.3.220: movements superpose as vectors.
    """

    def __init__(self, start_xyz_m: Array, submovements: Sequence[Submovement]) -> None:
        """A path from ``start_xyz_m``, ``(3,)``, through all submovements."""
        self._start = np.asarray(start_xyz_m, dtype=float)
        self._deltas = np.array([each.delta_xyz_m for each in submovements], dtype=float).reshape(-1, 3)
        self._onsets = np.array([each.onset_s for each in submovements], dtype=float)
        self._durations = np.array([each.duration_s for each in submovements], dtype=float)
        self.duration_s = float(np.max(self._onsets + self._durations, initial=0.0))
        self.end_xyz_m = self._start + self._deltas.sum(axis=0)

    def at(self, time_s: float) -> Array:
        """Position ``(3,)`` after ``time_s``."""
        done = minimum_jerk((time_s - self._onsets) / self._durations)
        position: Array = self._start + done @ self._deltas
        return position


@dataclass(frozen=True, kw_only=True)
class ArcParams:
    """How a hand goes from one place above the table to another."""

    duration_s: float
    clearance_m: float
    """Height to pass over, above the higher of start and end [m]."""
    curvature: float = 0.0
    """Sideways bulge as a share of the horizontal distance; positive to the left of the way."""
    onset_share: float = 0.2
    """Share of the duration after which the hand goes sideways: 0 at once, 0.3 only when it is well up."""
    settle_share: float = 0.2
    """Share of the duration, at the end, in which the hand only goes down."""


def arc(start_xyz_m: Array, end_xyz_m: Array, params: ArcParams) -> Path:
    """A path that rises, goes across with a sideways bulge, and comes down, each overlapping the next."""
    top = max(start_xyz_m[2], end_xyz_m[2]) + params.clearance_m
    across = np.array([end_xyz_m[0] - start_xyz_m[0], end_xyz_m[1] - start_xyz_m[1], 0.0])
    bulge = params.curvature * np.array([-across[1], across[0], 0.0])
    whole = params.duration_s
    onset = params.onset_share * whole
    travel = whole - onset - params.settle_share * whole
    rise, fall = 0.55 * whole, 0.60 * whole
    half = travel / 2

    def vector(values: Array) -> tuple[float, float, float]:
        return (float(values[0]), float(values[1]), float(values[2]))

    return Path(
        start_xyz_m,
        (
            Submovement((0.0, 0.0, float(top - start_xyz_m[2])), 0.0, rise),
            Submovement(vector(across), onset, travel),
            Submovement(vector(bulge), onset, 1.3 * half),
            Submovement(vector(-bulge), onset + travel - 1.3 * half, 1.3 * half),
            Submovement((0.0, 0.0, float(end_xyz_m[2] - top)), whole - fall, fall),
        ),
    )


@dataclass(frozen=True)
class Hesitation:
    """A slowing of the hand on its way."""

    at_s: float
    """When on the movement's own clock it is slowest."""
    duration_s: float
    depth: float
    """Share of the speed that is lost: 1 stops the hand."""


class MovementClock:
    """Time as the movement has it: slower than the world's while the hand hesitates or brakes."""

    def __init__(self, hesitations: Sequence[Hesitation] = ()) -> None:
        """Start at zero; each hesitation happens once, when its time comes."""
        self.time_s = 0.0
        self._pending = sorted(hesitations, key=lambda each: each.at_s)
        self._active: Hesitation | None = None
        self._since_s = 0.0
        self._brake_s: float | None = None
        self._braking_s = 0.0

    def brake(self, within_s: float) -> None:
        """Come to rest within a time, wherever the hand then is."""
        if self._brake_s is None:
            self._brake_s = within_s

    @property
    def is_stopped(self) -> bool:
        """Whether a brake has come to its end."""
        return self._brake_s is not None and self._braking_s >= self._brake_s

    def advance(self, step_s: float) -> None:
        """Let the world's clock go on by ``step_s``."""
        rate = 1.0
        if self._active is None and self._pending and self.time_s >= self._pending[0].at_s:
            self._active, self._since_s = self._pending.pop(0), 0.0
        if self._active is not None:
            self._since_s += step_s
            share = self._since_s / self._active.duration_s
            if share >= 1.0:
                self._active = None
            else:
                # A plateau with quarter-long flanks: the hand slows, waits and goes on.
                flank = min(share, 1.0 - share) / 0.25
                rate -= self._active.depth * float(minimum_jerk(np.array(flank)))
        if self._brake_s is not None:
            self._braking_s += step_s
            rate *= 1.0 - float(minimum_jerk(np.array(self._braking_s / self._brake_s)))
        self.time_s += rate * step_s


class Tremor:
    """Small involuntary movement: a few sinusoids of random phase per axis, the same for the same source.

    Physiological tremor of an outstretched hand lies at 8 to 12 Hz, postural drift below 1 Hz.

    Source: J. H. McAuley, C. D. Marsden, "Physiological and pathological tremors and rhythmic central motor
    control", Brain 123(8), 2000, doi:10.1093/brain/123.8.1545.
    """

    def __init__(self, rng: np.random.Generator, tremor_rms_m: float, drift_rms_m: float) -> None:
        """Draw frequencies and phases."""
        n = 4
        frequencies = np.concatenate([rng.uniform(7.5, 12.0, (n, 3)), rng.uniform(0.15, 0.7, (n, 3))])
        rms = np.repeat([tremor_rms_m, drift_rms_m], n)[:, None]
        self._pulsation = 2.0 * np.pi * frequencies
        self._phase = rng.uniform(0.0, 2.0 * np.pi, frequencies.shape)
        self._amplitude = rms * np.sqrt(2.0 / n)

    def at(self, time_s: float) -> Array:
        """Displacement ``(3,)`` in metres."""
        shift: Array = (self._amplitude * np.sin(self._pulsation * time_s + self._phase)).sum(axis=0)
        return shift
