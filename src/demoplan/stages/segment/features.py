"""What a segmenter sees: features of each hand at each tick.

Features speak of a hand relative to what it holds, will hold, has held, is nearest to, and to the other
hand; never of places in the room, names of instances or left and right. So a segmenter that was trained on
one person, with one layout and one rig, has a chance with the next. Time enters in seconds, not in ticks.
"""

from collections.abc import Collection
from dataclasses import dataclass, field

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
        only: Features that are asked for; the others are left zero, which saves their time. Null: all.

    Returns:
        Values ``(h, t, f)``; finite whatever the episode lacks (objects, a second hand, a grip signal).
    """
    base = _signals(tracks, params)
    context = [
        (f"{name}.{side}_{window_s:g}s", mean, name, window_s)
        for name in _WITH_CONTEXT
        for window_s in params.context_s
        for side, mean in (("past", windows.past_mean), ("future", windows.future_mean))
    ]
    names = (*base, *(name for name, *_ in context))
    # Feature by feature in memory, since each is written, and read by a tree, as a whole.
    values = np.zeros((len(names), len(tracks.hands), len(tracks.tick_ns)), dtype=np.float32)
    for index, signal in enumerate(base.values()):
        values[index] = signal
    for index, (name, mean, source, window_s) in enumerate(context, start=len(base)):
        if only is None or name in only:
            values[index] = mean(base[source], window_s, tracks.tick_s)
    return Features(names, np.moveaxis(values, 0, -1))


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

_FAR_M = 2.0
"""Stands for 'there is none' among distances [m]: beyond any arm's reach."""


def _signals(tracks: Tracks, params: FeatureParams) -> dict[str, Array]:
    """Signals ``(h, t)`` by name, without context."""
    tick_s, horizon_s = tracks.tick_s, params.horizon_s
    hands_m = tracks.hand_position_m
    n_hands, length = hands_m.shape[:2]

    velocity = velocities(hands_m, tick_s, params.velocity_window_s)
    speed = _norm(velocity)
    is_moving = tracks.is_moving
    grip = relative_grip(tracks.grip)
    signals: dict[str, Array] = {
        "hand_speed": speed,
        "hand_drift": _norm(windows.difference(hands_m, 0.6, tick_s, axis=1)),
        "hand_climb": velocity[..., 2],
        "hand_height": _above_low(hands_m[..., 2]),
        "hand_from_start": _norm(hands_m - hands_m[:, :1]),
        "hand_from_end": _norm(hands_m - hands_m[:, -1:]),
        "still_for": windows.seconds_since(is_moving, horizon_s, tick_s),
        "still_until": windows.seconds_until(is_moving, horizon_s, tick_s),
        "moving_for": windows.seconds_since(~is_moving, horizon_s, tick_s),
        "moving_until": windows.seconds_until(~is_moving, horizon_s, tick_s),
        "grip": grip,
        "grip_rate": windows.difference(grip, params.velocity_window_s, tick_s),
    }

    things = _Things.of(tracks, params)
    is_held = tracks.in_hand | carried(things.distance, things.speed, things.height, tick_s, params.carrying)
    is_holding = np.asarray(is_held.any(axis=1))
    held = is_held.argmax(axis=1) if things.n else np.zeros((n_hands, length), dtype=np.int64)
    latest, coming = windows.last_true(is_holding), windows.next_true(is_holding)
    previous = np.take_along_axis(held, np.maximum(latest, 0), axis=1)
    following = np.take_along_axis(held, np.minimum(coming, length - 1), axis=1)
    since = windows.seconds_since(is_holding, horizon_s, tick_s)
    until = windows.seconds_until(is_holding, horizon_s, tick_s)
    order = np.argsort(things.distance, axis=1)[:, :2] if things.n else held[:, None]
    nearest = order[:, 0]
    # What the hand is about: what it holds, else what it grasps next or let go last, whichever is nearer.
    partner = np.where(until <= since, following, previous)
    partner = np.where((since >= horizon_s) & (until >= horizon_s), nearest, partner)

    signals |= {
        "is_holding": is_holding.astype(float),
        "since_holding": since,
        "until_holding": until,
        "partner_distance": things.of_hand(things.distance, partner, _FAR_M),
        "partner_excess": things.of_hand(things.excess, partner, _FAR_M),
        "partner_closing": things.of_hand(things.closing, partner, 0.0),
        "next_distance": np.where(
            until < horizon_s, things.of_hand(things.distance, following, _FAR_M), _FAR_M
        ),
        "previous_distance": np.where(
            since < horizon_s, things.of_hand(things.distance, previous, _FAR_M), _FAR_M
        ),
        "nearest_distance": things.of_hand(things.distance, nearest, _FAR_M),
        "nearest_excess": things.of_hand(things.excess, nearest, _FAR_M),
        "nearest_closing": things.of_hand(things.closing, nearest, 0.0),
        "nearest_speed": things.of_object(things.speed, nearest),
        "second_distance": (
            things.of_hand(things.distance, order[:, 1], _FAR_M)
            if things.n > 1
            else np.full((n_hands, length), _FAR_M)
        ),
        "partner_speed": things.of_object(things.speed, partner),
        "partner_spin": things.of_object(things.spin, partner),
        "partner_tilt": things.of_object(things.tilt, partner),
        "partner_tilt_rate": things.of_object(things.tilt_rate, partner),
        "partner_height": things.of_object(things.height, partner),
        "partner_climb": things.of_object(things.climb, partner),
        "partner_agitation": things.of_object(things.agitation, partner),
        "partner_moved": things.of_object(things.displacement, partner),
        "partner_to_nearest": things.of_object(things.gap, partner),
        "partner_over_nearest": things.of_object(things.flat_gap, partner),
        "partner_gap_closing": things.of_object(things.gap_closing, partner),
    }

    other = _nearest_other_hand(hands_m)
    for name in (
        "hand_speed",
        "is_holding",
        "since_holding",
        "until_holding",
        "partner_speed",
        "partner_agitation",
        "partner_to_nearest",
        "partner_tilt",
    ):
        theirs = np.take_along_axis(signals[name], other, axis=0) if n_hands > 1 else np.zeros_like(speed)
        signals[f"other_{name.removeprefix('hand_')}"] = theirs
    signals["other_distance"] = _distance_to_other(hands_m, other)
    signals["nearest_to_other_partner"] = np.full((n_hands, length), _FAR_M)
    if things.n and n_hands > 1:
        partner_of_other = np.take_along_axis(partner, other, axis=0)
        signals["nearest_to_other_partner"] = np.where(
            signals["other_is_holding"] > 0, things.between(nearest, partner_of_other), _FAR_M
        )
    return signals


@dataclass(frozen=True, kw_only=True, eq=False)
class _Things:
    """Signals of objects ``(o, t)`` and of hand-object pairs ``(h, o, t)``."""

    apart_squared: Array
    """Squared distances of objects ``(o, o, t)``."""
    distance: Array
    excess: Array
    """Distance beyond the pair's smallest in this episode: markers sit elsewhere on every hand."""
    closing: Array
    """Speed at which the hand comes nearer [m/s]."""
    speed: Array
    spin: Array
    """Angular speed [rad/s]."""
    tilt: Array
    """Angle by which the object leans from how it stood first [rad]."""
    tilt_rate: Array
    height: Array
    climb: Array
    agitation: Array
    """Mean speed beyond what displaces the object over a second: to and fro, round and round [m/s]."""
    displacement: Array
    """Distance from where the object stood first [m]."""
    gap: Array
    """Distance to the nearest other object [m]."""
    flat_gap: Array
    """Horizontal distance to the object that is horizontally nearest [m]."""
    gap_closing: Array

    @property
    def n(self) -> int:
        """Number of objects."""
        return len(self.speed)

    def of_hand(self, pair: Array, index: NDArray[np.int64], default: float) -> Array:
        """Values of a pair signal for one object per hand and tick ``(h, t)``."""
        if not self.n:
            return np.full((pair.shape[0], pair.shape[2]), default)
        return np.take_along_axis(pair, index[:, None], axis=1)[:, 0]

    def of_object(self, signal: Array, index: NDArray[np.int64]) -> Array:
        """Values of an object signal for one object per hand and tick ``(h, t)``."""
        if not self.n:
            return np.zeros(index.shape)
        return np.take_along_axis(signal, index, axis=0)

    def between(self, one: NDArray[np.int64], other: NDArray[np.int64]) -> Array:
        """Distances of two objects per hand and tick ``(h, t)``."""
        distance: Array = np.sqrt(self.apart_squared[one, other, np.arange(one.shape[1])])
        return distance

    @classmethod
    def of(cls, tracks: Tracks, params: FeatureParams) -> "_Things":
        """Signals of every object of an episode."""
        tick_s = tracks.tick_s
        position = tracks.object_position_m
        distance = _norm(tracks.hand_position_m[:, None] - position[None])
        # A recording without objects has nothing to fit.
        velocity = velocities(position, tick_s, params.velocity_window_s) if len(position) else position
        speed = _norm(velocity)
        net = _norm(windows.difference(position, 1.0, tick_s, axis=1))
        tilt = _tilt(tracks.object_orientation)
        apart_squared, gap, flat_gap = _gaps(position)
        return cls(
            apart_squared=apart_squared,
            distance=distance,
            excess=distance - distance.min(axis=2, keepdims=True),
            closing=-windows.difference(distance, params.trend_window_s, tick_s),
            speed=speed,
            spin=_spin(tracks.object_orientation, params.velocity_window_s, tick_s),
            tilt=tilt,
            tilt_rate=windows.difference(tilt, params.trend_window_s, tick_s),
            height=_above_low(position[..., 2]),
            climb=velocity[..., 2],
            agitation=np.maximum(windows.centred_mean(speed, 1.0, tick_s) - net, 0.0),
            displacement=_norm(position - position[:, :1]),
            gap=gap,
            flat_gap=flat_gap,
            gap_closing=-windows.difference(gap, params.trend_window_s, tick_s),
        )


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


def _gaps(position_m: Array) -> tuple[Array, Array, Array]:
    """Squared distances ``(o, o, t)``; distance to the nearest other, in space and flat ``(o, t)``."""
    n, length = position_m.shape[:2]
    x, y, z = np.moveaxis(position_m, -1, 0)
    flat = (x[:, None] - x[None]) ** 2 + (y[:, None] - y[None]) ** 2
    apart = flat + (z[:, None] - z[None]) ** 2
    if n < 2:
        return apart, np.full((n, length), _FAR_M), np.full((n, length), _FAR_M)
    others = apart + np.where(np.eye(n, dtype=np.bool_), np.inf, 0.0)[..., None]
    itself = np.arange(n)
    flat[itself, itself] = np.inf
    return apart, np.sqrt(others.min(axis=1)), np.sqrt(flat.min(axis=1))


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
