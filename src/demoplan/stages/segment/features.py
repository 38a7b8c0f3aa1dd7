"""What a segmenter sees: features of each hand at each tick.

Features speak of a hand relative to what it holds, will hold, has held, is nearest to, and to the other
hand; never of places in the room, names of instances or left and right. So a segmenter that was trained on
one person, with one layout and one rig, has a chance with the next. Time enters in seconds, not in ticks.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from demoplan.geometry import Array, conjugate, rotate, velocities
from demoplan.stages.segment import windows
from demoplan.stages.segment.carrying import CarryParams, carried
from demoplan.stages.segment.tracks import Tracks


@dataclass(frozen=True, kw_only=True)
class FeatureParams:
    """Windows and thresholds of the features."""

    velocity_window_s: float = 0.1
    """Velocities are fitted over this time [s]: long enough to average sensor noise out."""
    trend_window_s: float = 0.3
    """Distances and tilts grow or shrink over this time [s]."""
    context_s: tuple[float, ...] = (0.25, 0.75, 2.0)
    """Lengths of the windows of past and future over which signals are averaged [s]."""
    horizon_s: float = 3.0
    """Times to events are clipped here [s]: farther events say nothing about now."""
    carrying: CarryParams = field(default_factory=CarryParams)
    """When an object counts as travelling with a hand, besides facts that say that it is in hand."""


@dataclass(frozen=True, eq=False)
class Features:
    """Feature values ``(hand, tick, feature)``, in single precision as trees compare them."""

    names: tuple[str, ...]
    values: NDArray[np.float32]


def features_of(
    tracks: Tracks, params: FeatureParams = FeatureParams(), only: Collection[str] | None = None
) -> Features:
    """Every feature of every hand at every tick of one episode.

    Args:
        tracks: The episode's arrays.
        params: Windows and thresholds.
        only: Features that are asked for; nothing is computed for the others alone. Null: all.

    Returns:
        Values ``(h, t, f)``; finite whatever the episode lacks (objects, a second hand, a grip signal).
    """
    signals = _Signals(tracks, params)
    context = _context(params)
    names = tuple(name for name in feature_names(params) if only is None or name in only)
    # Feature by feature in memory, since each is written, and read by a tree, as a whole.
    values = np.empty((len(names), len(tracks.hands), len(tracks.tick_ns)), dtype=np.float32)
    for index, name in enumerate(names):
        if name in context:
            mean, source, window_s = context[name]
            values[index] = mean(signals.total(source), window_s, tracks.tick_s)
        else:
            values[index] = signals[name] if name in _ASKED_AGAIN else _SIGNALS[name](signals)
    return Features(names, np.moveaxis(values, 0, -1))


def feature_names(params: FeatureParams) -> tuple[str, ...]:
    """Every feature there is, in order."""
    return (*_SIGNALS, *_context(params))


def _context(params: FeatureParams) -> dict[str, tuple[Callable[[Array, float, float], Array], str, float]]:
    """Features that are means over a window: how the mean is taken, of which signal, over how long [s]."""
    return {
        f"{name}.{side}_{window_s:g}s": (mean, name, window_s)
        for name in _WITH_CONTEXT
        for window_s in params.context_s
        for side, mean in (("past", windows.past_mean), ("future", windows.future_mean))
    }


_WITH_CONTEXT = (
    "hand_speed",
    "hand_climb",
    "is_holding",
    "partner_speed",
    "partner_closing",
    "partner_spin",
    "other_speed",
    "grip",
)
"""Signals whose recent past and near future are features too."""

_ASKED_AGAIN = frozenset(
    (
        *_WITH_CONTEXT,
        "since_holding",
        "until_holding",
        "other_is_holding",
        "partner_agitation",
        "partner_to_nearest",
        "partner_tilt",
    )
)
"""Signals that others rest on: these are kept, the others would only take room."""

_FAR_M = 2.0
"""Stands for 'there is none' among distances [m]: beyond any arm's reach."""


class _Signals:
    """Signals ``(h, t)`` by name, without context. Each, and what it rests on, is computed when asked for."""

    def __init__(self, tracks: Tracks, params: FeatureParams) -> None:
        self.tracks = tracks
        self.params = params
        self.tick_s = tracks.tick_s
        self.hands_m = tracks.hand_position_m
        self.shape = (len(tracks.hands), len(tracks.tick_ns))
        self.things = _Things(tracks, params)
        self._found: dict[str, Array] = {}
        self._totals: dict[str, Array] = {}

    def __getitem__(self, name: str) -> Array:
        """One signal."""
        if name not in self._found:
            self._found[name] = _SIGNALS[name](self)
        return self._found[name]

    def total(self, name: str) -> Array:
        """A signal's sum over all ticks before each ``(h, t + 1)``, from which means over windows come."""
        if name not in self._totals:
            # All windows over one signal come one after the other.
            self._totals.clear()
            self._totals[name] = windows.running_total(self[name])
        return self._totals[name]

    def far(self) -> Array:
        """Distances from nothing."""
        return np.full(self.shape, _FAR_M)

    @cached_property
    def velocity(self) -> Array:
        """Of hands ``(h, t, 3)``."""
        return velocities(self.hands_m, self.tick_s, self.params.velocity_window_s)

    def time_since(self, mask: NDArray[np.bool_]) -> Array:
        """Time since a mask was last true."""
        return windows.seconds_since(mask, self.params.horizon_s, self.tick_s)

    def time_until(self, mask: NDArray[np.bool_]) -> Array:
        """Time until a mask is next true."""
        return windows.seconds_until(mask, self.params.horizon_s, self.tick_s)

    @cached_property
    def is_held(self) -> NDArray[np.bool_]:
        """Which object is in which hand ``(h, o, t)``."""
        things = self.things
        return self.tracks.in_hand | carried(
            things.distance, things.speed, things.height, self.tick_s, self.params.carrying
        )

    @cached_property
    def is_holding(self) -> NDArray[np.bool_]:
        """Whether anything is in hand ``(h, t)``."""
        return np.asarray(self.is_held.any(axis=1))

    @cached_property
    def held(self) -> "_Choice":
        """What is in hand; the first object where nothing is."""
        if not self.things.n:
            return _Choice.of(np.zeros(self.shape, dtype=np.int64))
        return _Choice.of(self.is_held.argmax(axis=1))

    @cached_property
    def previous(self) -> "_Choice":
        """What is or was in hand last."""
        latest = windows.last_true(self.is_holding)
        return _Choice.of(np.take_along_axis(self.held.index, np.maximum(latest, 0), axis=1))

    @cached_property
    def following(self) -> "_Choice":
        """What is or will be in hand next."""
        coming = windows.next_true(self.is_holding)
        return _Choice.of(np.take_along_axis(self.held.index, np.minimum(coming, self.shape[1] - 1), axis=1))

    @cached_property
    def nearest(self) -> "_Choice":
        """The object nearest to each hand."""
        return _Choice.of(self.things.distance.argmin(axis=1)) if self.things.n else self.held

    @cached_property
    def partner(self) -> "_Choice":
        """What the hand is about: what it holds, else what it grasps next or let go last, what is nearer."""
        since, until, horizon_s = self["since_holding"], self["until_holding"], self.params.horizon_s
        partner = np.where(until <= since, self.following.index, self.previous.index)
        is_far = (since >= horizon_s) & (until >= horizon_s)
        return _Choice.of(np.where(is_far, self.nearest.index, partner))

    def soon(self, time: str, distance: Array) -> Array:
        """A distance where a time is within the horizon."""
        return np.where(self[time] < self.params.horizon_s, distance, _FAR_M)

    def second_distance(self) -> Array:
        """Distance to the object that is second nearest."""
        if self.things.n < 2:
            return self.far()
        return np.asarray(np.partition(self.things.distance, 1, axis=1)[:, 1])

    @cached_property
    def other(self) -> NDArray[np.int64]:
        """The other hand that is nearest ``(h, t)``."""
        return _nearest_other_hand(self.hands_m)

    def of_other(self, name: str) -> Array:
        """A signal of the other hand."""
        if self.shape[0] < 2:
            return np.zeros(self.shape)
        return np.take_along_axis(self[name], self.other, axis=0)

    def nearest_to_other_partner(self) -> Array:
        """Distance from the object nearest to this hand to what the other hand holds."""
        if not self.things.n or self.shape[0] < 2:
            return self.far()
        partner_of_other = np.take_along_axis(self.partner.index, self.other, axis=0)
        apart = self.things.between(self.nearest.index, partner_of_other)
        return np.where(self["other_is_holding"] > 0, apart, _FAR_M)


_SIGNALS: dict[str, Callable[[_Signals], Array]] = {
    "hand_speed": lambda s: _norm(s.velocity),
    "hand_drift": lambda s: _norm(windows.difference(s.hands_m, 0.6, s.tick_s, axis=1)),
    "hand_climb": lambda s: s.velocity[..., 2],
    "hand_height": lambda s: _above_low(s.hands_m[..., 2]),
    "hand_from_start": lambda s: _norm(s.hands_m - s.hands_m[:, :1]),
    "hand_from_end": lambda s: _norm(s.hands_m - s.hands_m[:, -1:]),
    "still_for": lambda s: s.time_since(s.tracks.is_moving),
    "still_until": lambda s: s.time_until(s.tracks.is_moving),
    "moving_for": lambda s: s.time_since(~s.tracks.is_moving),
    "moving_until": lambda s: s.time_until(~s.tracks.is_moving),
    "grip": lambda s: relative_grip(s.tracks.grip),
    "grip_rate": lambda s: windows.difference(s["grip"], s.params.velocity_window_s, s.tick_s),
    "is_holding": lambda s: s.is_holding.astype(float),
    "since_holding": lambda s: s.time_since(s.is_holding),
    "until_holding": lambda s: s.time_until(s.is_holding),
    "partner_distance": lambda s: s.things.of_hand("distance", s.partner, _FAR_M),
    "partner_excess": lambda s: s.things.of_hand("excess", s.partner, _FAR_M),
    "partner_closing": lambda s: s.things.of_hand("closing", s.partner, 0.0),
    "next_distance": lambda s: s.soon("until_holding", s.things.of_hand("distance", s.following, _FAR_M)),
    "previous_distance": lambda s: s.soon("since_holding", s.things.of_hand("distance", s.previous, _FAR_M)),
    "nearest_distance": lambda s: s.things.of_hand("distance", s.nearest, _FAR_M),
    "nearest_excess": lambda s: s.things.of_hand("excess", s.nearest, _FAR_M),
    "nearest_closing": lambda s: s.things.of_hand("closing", s.nearest, 0.0),
    "nearest_speed": lambda s: s.things.of_object("speed", s.nearest),
    "second_distance": lambda s: s.second_distance(),
    "partner_speed": lambda s: s.things.of_object("speed", s.partner),
    "partner_spin": lambda s: s.things.of_object("spin", s.partner),
    "partner_tilt": lambda s: s.things.of_object("tilt", s.partner),
    "partner_tilt_rate": lambda s: s.things.of_object("tilt_rate", s.partner),
    "partner_height": lambda s: s.things.of_object("height", s.partner),
    "partner_climb": lambda s: s.things.of_object("climb", s.partner),
    "partner_agitation": lambda s: s.things.of_object("agitation", s.partner),
    "partner_moved": lambda s: s.things.of_object("displacement", s.partner),
    "partner_to_nearest": lambda s: s.things.of_object("gap", s.partner),
    "partner_over_nearest": lambda s: s.things.of_object("flat_gap", s.partner),
    "partner_gap_closing": lambda s: s.things.of_object("gap_closing", s.partner),
    "other_speed": lambda s: s.of_other("hand_speed"),
    "other_is_holding": lambda s: s.of_other("is_holding"),
    "other_since_holding": lambda s: s.of_other("since_holding"),
    "other_until_holding": lambda s: s.of_other("until_holding"),
    "other_partner_speed": lambda s: s.of_other("partner_speed"),
    "other_partner_agitation": lambda s: s.of_other("partner_agitation"),
    "other_partner_to_nearest": lambda s: s.of_other("partner_to_nearest"),
    "other_partner_tilt": lambda s: s.of_other("partner_tilt"),
    "other_distance": lambda s: _distance_to_other(s.hands_m, s.other),
    "nearest_to_other_partner": lambda s: s.nearest_to_other_partner(),
}
"""How each signal is found, in the order of the features."""


@dataclass(frozen=True, eq=False)
class _Choice:
    """One object per hand and tick ``(h, t)``."""

    index: NDArray[np.int64]
    place: NDArray[np.int64]
    """Where its value stands among an object signal's ``(o, t)``, one after the other."""

    @classmethod
    def of(cls, index: NDArray[np.int64]) -> "_Choice":
        length = index.shape[1]
        return cls(index, index * length + np.arange(length))


class _Things:
    """Signals of objects ``(o, t)`` and of hand-object pairs ``(h, o, t)``, computed when asked for."""

    def __init__(self, tracks: Tracks, params: FeatureParams) -> None:
        self.tracks = tracks
        self.params = params
        self.tick_s = tracks.tick_s
        self.position = tracks.object_position_m
        self.n = len(self.position)

    def of_hand(self, name: str, choice: _Choice, default: float) -> Array:
        """Values of a pair signal for one object per hand and tick ``(h, t)``."""
        if not self.n:
            return np.full(choice.index.shape, default)
        pair: Array = getattr(self, name)
        offset = np.arange(len(pair))[:, None] * (pair.shape[1] * pair.shape[2])
        return np.asarray(np.take(pair, choice.place + offset))

    def of_object(self, name: str, choice: _Choice) -> Array:
        """Values of an object signal for one object per hand and tick ``(h, t)``."""
        if not self.n:
            return np.zeros(choice.index.shape)
        return np.asarray(np.take(getattr(self, name), choice.place))

    def between(self, one: NDArray[np.int64], other: NDArray[np.int64]) -> Array:
        """Distances of two objects per hand and tick ``(h, t)``."""
        x, y, z = np.moveaxis(self.position, -1, 0)
        ticks = np.arange(one.shape[1])
        flat = (x[one, ticks] - x[other, ticks]) ** 2 + (y[one, ticks] - y[other, ticks]) ** 2
        distance: Array = np.sqrt(flat + (z[one, ticks] - z[other, ticks]) ** 2)
        return distance

    @cached_property
    def distance(self) -> Array:
        """Distance of each hand to each object [m]."""
        return _norm(self.tracks.hand_position_m[:, None] - self.position[None])

    @cached_property
    def excess(self) -> Array:
        """Distance beyond the pair's smallest in this episode: markers sit elsewhere on every hand."""
        return np.asarray(self.distance - self.distance.min(axis=2, keepdims=True))

    @cached_property
    def closing(self) -> Array:
        """Speed at which the hand comes nearer [m/s]."""
        return -windows.difference(self.distance, self.params.trend_window_s, self.tick_s)

    @cached_property
    def velocity(self) -> Array:
        """``(o, t, 3)``."""
        # A recording without objects has nothing to fit.
        if not self.n:
            return self.position
        return velocities(self.position, self.tick_s, self.params.velocity_window_s)

    @cached_property
    def speed(self) -> Array:
        """[m/s]."""
        return _norm(self.velocity)

    @cached_property
    def climb(self) -> Array:
        """Upward speed [m/s]."""
        return self.velocity[..., 2]

    @cached_property
    def spin(self) -> Array:
        """Angular speed [rad/s]."""
        return _spin(self.tracks.object_orientation, self.params.velocity_window_s, self.tick_s)

    @cached_property
    def tilt(self) -> Array:
        """Angle by which the object leans from how it stood first [rad]."""
        return _tilt(self.tracks.object_orientation)

    @cached_property
    def tilt_rate(self) -> Array:
        """[rad/s]."""
        return windows.difference(self.tilt, self.params.trend_window_s, self.tick_s)

    @cached_property
    def height(self) -> Array:
        """Above the object's own low [m]."""
        return _above_low(self.position[..., 2])

    @cached_property
    def agitation(self) -> Array:
        """Mean speed beyond what displaces the object over a second: to and fro, round and round [m/s]."""
        net = _norm(windows.difference(self.position, 1.0, self.tick_s, axis=1))
        mean = windows.centred_mean(windows.running_total(self.speed), 1.0, self.tick_s)
        return np.maximum(mean - net, 0.0)

    @cached_property
    def displacement(self) -> Array:
        """Distance from where the object stood first [m]."""
        return _norm(self.position - self.position[:, :1])

    @cached_property
    def gap(self) -> Array:
        """Distance to the nearest other object [m]."""
        return _gaps(self.position)

    @cached_property
    def flat_gap(self) -> Array:
        """Horizontal distance to the object that is horizontally nearest [m]."""
        return _gaps(self.position[..., :2])

    @cached_property
    def gap_closing(self) -> Array:
        """Speed at which the nearest other object comes nearer [m/s]."""
        return -windows.difference(self.gap, self.params.trend_window_s, self.tick_s)


def _norm(vectors: Array) -> Array:
    length: Array = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return length


def _above_low(height_m: Array) -> Array:
    """Height above a body's own low of the episode: the table's height does not matter."""
    return height_m - np.quantile(height_m, 0.02, axis=-1, keepdims=True)


def relative_grip(grip: Array) -> Array:
    """Opening of each hand ``(h, t)`` within the range that it uses; −1 throughout without a signal.

    Triggers and fingers end at other readings for every person and device. A hand that keeps still is open or
    closed by its reading alone. Gaps keep the last reading.
    """
    is_known = np.isfinite(grip)
    has_signal = is_known.any(axis=1, keepdims=True)
    latest = np.maximum(windows.last_true(is_known), is_known.argmax(axis=1)[:, None])
    filled = np.where(has_signal, np.take_along_axis(grip, latest, axis=1), -1.0)
    low = np.quantile(filled, 0.01, axis=1, keepdims=True)
    span = np.quantile(filled, 0.99, axis=1, keepdims=True) - low
    is_used = span > _GRIP_SPAN
    relative = np.clip((filled - low) / np.where(is_used, span, 1.0), 0.0, 1.0)
    return np.where(has_signal, np.where(is_used, relative, np.round(filled)), -1.0)


_GRIP_SPAN = 0.3
"""A hand whose opening varies less than this has not grasped: noise must not be stretched to a full range."""


def _tilt(orientation: Array) -> Array:
    """Lean ``(o, t)`` of each object from how it stood first [rad]; turning on the spot is none."""
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(orientation), 1, 3))
    up_in_body = rotate(conjugate(orientation[:, :1]), up)
    now = rotate(orientation, np.broadcast_to(up_in_body, (*orientation.shape[:2], 3)))
    lean: Array = np.arccos(np.clip(now[..., 2], -1.0, 1.0))
    return lean


def _spin(orientation: Array, window_s: float, tick_s: float) -> Array:
    """Angular speed ``(o, t)`` [rad/s]."""
    length = orientation.shape[1]
    half = windows.n_ticks(window_s / 2.0, tick_s)
    ticks = np.arange(length)
    later, earlier = np.minimum(ticks + half, length - 1), np.maximum(ticks - half, 0)
    cosine = np.abs(np.einsum("otq,otq->ot", orientation[:, later], orientation[:, earlier]))
    angle = 2.0 * np.arccos(np.clip(cosine, 0.0, 1.0))
    return np.asarray(angle / (np.maximum(later - earlier, 1) * tick_s))


def _gaps(position_m: Array) -> Array:
    """Distance of each object to the nearest other ``(o, t)``, over the given axes ``(o, t, axis)``."""
    n, length = position_m.shape[:2]
    if n < 2:
        return np.full((n, length), _FAR_M)
    axes = np.ascontiguousarray(np.moveaxis(position_m, -1, 0))
    nearest = np.full((n, length), np.inf)
    for one in range(n):
        for other in range(one + 1, n):
            apart = (axes[0, one] - axes[0, other]) ** 2
            for along in axes[1:]:
                apart += (along[one] - along[other]) ** 2
            np.minimum(nearest[one], apart, out=nearest[one])
            np.minimum(nearest[other], apart, out=nearest[other])
    return np.asarray(np.sqrt(nearest))


def _nearest_other_hand(hands_m: Array) -> NDArray[np.int64]:
    """Which other hand is nearest to each ``(h, t)``; a single hand has itself."""
    n, length = hands_m.shape[:2]
    if n <= 2:
        return np.repeat(np.arange(n)[::-1, None], length, axis=1)
    apart = np.sum((hands_m[:, None] - hands_m[None]) ** 2, axis=-1)
    apart[np.arange(n), np.arange(n)] = np.inf
    nearest: NDArray[np.int64] = apart.argmin(axis=1)
    return nearest


def _distance_to_other(hands_m: Array, other: NDArray[np.int64]) -> Array:
    if len(hands_m) < 2:
        return np.full(hands_m.shape[:2], _FAR_M)
    return _norm(hands_m - hands_m[other, np.arange(hands_m.shape[1])])
