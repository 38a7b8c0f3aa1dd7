"""What a virtual-reality rig saw of a demonstration: noisy, late, with gaps, on three clocks.

Capture stamps are on the rig's clock; a message is published a little later, and received later still on the
recorder's clock, which differs from the rig's by a constant. Cubes are given in ``world``, hands in the rig's
own ``vr_origin``; a latched transform ties the two.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.demonstration import Demonstration
from demoplan.engines.mujoco.participants import Participant
from demoplan.engines.mujoco.scene import TABLE
from demoplan.geometry import Array, conjugate, multiply, normalised, rotate, slerp

Stamps = NDArray[np.int64]

WORLD = "world"
ORIGIN = "vr_origin"


@dataclass(frozen=True, kw_only=True)
class RigParams:
    """How well a rig sees, and how late."""

    hand_rate_hz: float = 120.0
    object_rate_hz: float = 100.0
    position_noise_m: float = 0.0004
    """Standard deviation per axis of one reading [m]."""
    wander_m: float = 0.0005
    """Slow error of tracking, as a standard deviation [m]."""
    orientation_noise_rad: float = 0.0035
    trigger_noise: float = 0.004
    jitter_s: float = 0.0008
    """Standard deviation of the capture interval [s]."""
    drop_probability: float = 0.008
    """Chance that a message is lost."""
    dropouts_per_minute: float = 4.0
    """How often tracking of one hand, or of one cube, is lost for a while [1/min]."""
    dropout_s: tuple[float, float] = (0.06, 0.22)
    """Shortest and longest loss of tracking [s]."""
    processing_s: float = 0.003
    """Typical time from capture to publication [s]."""
    transport_s: float = 0.004
    """Typical time from publication to receipt [s]."""
    stall_probability: float = 0.002
    """Chance that a message is held up on its way, for up to ``stall_s``."""
    stall_s: float = 0.05


@dataclass(frozen=True)
class Rig:
    """One rig on one day: how its origin lies in the world, and how its clock differs."""

    position_xyz_m: tuple[float, float, float]
    orientation_wxyz: tuple[float, float, float, float]
    clock_offset_ns: int
    """Recorder's clock minus the rig's [ns]."""


def draw_rig(rng: np.random.Generator) -> Rig:
    """A rig as somebody set it up: on the floor before the table, turned somehow."""
    yaw = float(rng.uniform(-0.5, 0.5) + rng.choice([0.0, np.pi / 2, np.pi, -np.pi / 2]))
    return Rig(
        (float(rng.uniform(-0.9, -0.5)), float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.80, -0.70))),
        (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))),
        int(rng.uniform(-0.25, 0.25) * 1e9),
    )


@dataclass(frozen=True)
class Clocks:
    """Three stamps per message [ns], each ``(n,)``; messages are in order of capture."""

    captured_ns: Stamps
    published_ns: Stamps
    received_ns: Stamps


@dataclass(frozen=True)
class SensedBodies:
    """Poses of named bodies, some of which may be missing from a message."""

    frame: str
    names: tuple[str, ...]
    clocks: Clocks
    position_xyz_m: Array
    """``(n, k, 3)``"""
    orientation_wxyz: Array
    """``(n, k, 4)``"""
    is_present: NDArray[np.bool_]
    """``(n, k)``"""


@dataclass(frozen=True)
class SensedTrigger:
    """Readings of a trigger, ``(n,)``: 0 let go, 1 pulled."""

    clocks: Clocks
    trigger: Array


@dataclass(frozen=True)
class Sensed:
    """All that a rig gave of one demonstration."""

    static: SensedBodies
    cubes: SensedBodies
    hands: dict[str, SensedBodies]
    triggers: dict[str, SensedTrigger]


def sense(
    demonstration: Demonstration,
    participant: Participant,
    rig: Rig,
    start_ns: int,
    rng: np.random.Generator,
    params: RigParams = RigParams(),
) -> Sensed:
    """What a rig saw of a demonstration.

    Args:
        demonstration: What really happened.
        participant: Who acted: what a trigger says when it is let go or pulled is personal.
        rig: The rig.
        start_ns: The rig's clock when the demonstration begins [ns].
        rng: Source of noise.
        params: How well the rig sees.
    """
    times = demonstration.time_s
    end_s = float(times[-1])

    def clocks(capture_s: Array) -> Clocks:
        n = len(capture_s)
        captured = start_ns + np.round(capture_s * 1e9).astype(np.int64)
        processing = params.processing_s * (0.5 + rng.gamma(2.0, 0.25, n))
        transport = params.transport_s * (0.3 + rng.gamma(2.0, 0.35, n))
        transport += np.where(
            rng.random(n) < params.stall_probability, rng.uniform(0, params.stall_s, n), 0.0
        )
        published = captured + np.round(processing * 1e9).astype(np.int64)
        # One publisher sends in order; so does its connection.
        published = np.maximum.accumulate(published)
        received = published + np.round(transport * 1e9).astype(np.int64) + rig.clock_offset_ns
        return Clocks(captured, published, np.maximum.accumulate(received))

    def capture(rate_hz: float) -> Array:
        nominal = np.arange(rng.uniform(0.0, 1.0 / rate_hz), end_s, 1.0 / rate_hz)
        jitter = np.clip(rng.normal(0.0, params.jitter_s, len(nominal)), -0.4 / rate_hz, 0.4 / rate_hz)
        kept = np.clip(nominal + jitter, 0.0, end_s)
        return kept[rng.random(len(kept)) >= params.drop_probability]

    def seen_poses(capture_s: Array, position: Array, orientation: Array) -> tuple[Array, Array]:
        n = len(capture_s)
        seen = _interpolated(capture_s, times, position)
        seen += _wander(capture_s, rng, params.wander_m) + rng.normal(0.0, params.position_noise_m, (n, 3))
        turned = _turned(capture_s, times, orientation)
        small = rng.normal(0.0, params.orientation_noise_rad / 2, (n, 3))
        noise = normalised(np.concatenate([np.ones((n, 1)), small], axis=1))
        return seen, multiply(turned, noise)

    object_s = capture(params.object_rate_hz)
    k = len(demonstration.cubes)
    position = np.empty((len(object_s), k, 3))
    orientation = np.empty((len(object_s), k, 4))
    present = np.ones((len(object_s), k), dtype=bool)
    for column in range(k):
        position[:, column], orientation[:, column] = seen_poses(
            object_s,
            demonstration.cube_position_xyz_m[:, column],
            demonstration.cube_orientation_wxyz[:, column],
        )
        present[:, column] = ~_lost(object_s, rng, params, share=1.0 / k)
    cubes = SensedBodies(WORLD, demonstration.cubes, clocks(object_s), position, orientation, present)

    hands: dict[str, SensedBodies] = {}
    triggers: dict[str, SensedTrigger] = {}
    turned_back = conjugate(np.array(rig.orientation_wxyz))
    for name, arrays in sorted(demonstration.hands.items()):
        hand_s = capture(params.hand_rate_hz)
        hand_s = hand_s[~_lost(hand_s, rng, params, share=1.0)]
        seen, turned = seen_poses(hand_s, arrays.position_xyz_m, arrays.orientation_wxyz)
        inverse = np.broadcast_to(turned_back, (len(hand_s), 4))
        hands[name] = SensedBodies(
            ORIGIN,
            (name,),
            clocks(hand_s),
            rotate(inverse, seen - np.array(rig.position_xyz_m))[:, None],
            multiply(inverse, turned)[:, None],
            np.ones((len(hand_s), 1), dtype=bool),
        )
        trigger_s = capture(params.hand_rate_hz)
        pulled = np.interp(trigger_s, times, arrays.trigger)
        reading = participant.trigger_open + pulled * (participant.trigger_closed - participant.trigger_open)
        reading += rng.normal(0.0, params.trigger_noise, len(trigger_s))
        triggers[name] = SensedTrigger(clocks(trigger_s), np.clip(reading, 0.0, 1.0))

    static = SensedBodies(
        WORLD,
        (TABLE, ORIGIN),
        clocks(np.zeros(1)),
        np.array([[(0.0, 0.0, 0.0), rig.position_xyz_m]]),
        np.array([[(1.0, 0.0, 0.0, 0.0), rig.orientation_wxyz]]),
        np.ones((1, 2), dtype=bool),
    )
    return Sensed(static, cubes, hands, triggers)


def _interpolated(at_s: Array, times_s: Array, values: Array) -> Array:
    """Values ``(n, 3)`` between ticks, linearly."""
    return np.stack([np.interp(at_s, times_s, values[:, axis]) for axis in range(3)], axis=1)


def _turned(at_s: Array, times_s: Array, orientation_wxyz: Array) -> Array:
    """Orientations ``(n, 4)`` between ticks, on the shorter arc."""
    after = np.clip(np.searchsorted(times_s, at_s), 1, len(times_s) - 1)
    share = (at_s - times_s[after - 1]) / (times_s[after] - times_s[after - 1])
    return slerp(orientation_wxyz[after - 1], orientation_wxyz[after], np.clip(share, 0.0, 1.0))


def _wander(at_s: Array, rng: np.random.Generator, size_m: float) -> Array:
    """A slow error, ``(n, 3)``: two sinusoids per axis about a constant."""
    pulsation = 2 * np.pi * rng.uniform(0.03, 0.25, (2, 3))
    phase = rng.uniform(0.0, 2 * np.pi, (2, 3))
    swing = np.sin(at_s[:, None, None] * pulsation + phase).sum(axis=1)
    wander: Array = size_m * (0.7 * swing + 0.7 * rng.normal(0.0, 1.0, 3))
    return wander


def _lost(at_s: Array, rng: np.random.Generator, params: RigParams, share: float) -> NDArray[np.bool_]:
    """Which captures fall into a loss of tracking, ``(n,)``."""
    lost = np.zeros(len(at_s), dtype=bool)
    minutes = float(at_s[-1] - at_s[0]) / 60.0
    for _ in range(int(rng.poisson(params.dropouts_per_minute * minutes * share))):
        begin = rng.uniform(at_s[0], at_s[-1])
        lost |= (at_s >= begin) & (at_s < begin + rng.uniform(*params.dropout_s))
    return lost
