"""Who demonstrates: habits that are drawn once per participant."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Participant:
    """One person's habits."""

    name: str
    speed_m_per_s: float
    """Mean speed over a long reach [m/s]."""
    movement_base_s: float
    """What every movement takes, however short [s]."""
    curvature: float
    """Sideways bulge of a reach, as a share of its distance."""
    clearance_m: float
    """Height above start and end at which the hand passes [m]."""
    tremor_rms_m: float
    drift_rms_m: float
    hesitation_probability: float
    """Chance that a movement hesitates."""
    regrasp_probability: float
    """Chance that the grip is loosened and closed again before lifting."""
    miss_probability: float
    """Chance that a grasp closes beside or above the cube."""
    careless_probability: float
    """Chance that a cube is set down off its middle, and, apart from that, that it is let go too high."""
    pause_probability: float
    """Chance of a rest between two cubes, instead of turning to the next one at once."""
    pause_s: float
    """Typical rest [s]."""
    dwell_s: float
    """Typical wait before the grip moves, at the object [s]."""
    grip_s: float
    """Time in which the trigger is pulled or let go [s]."""
    trigger_open: float
    trigger_closed: float
    """What the trigger says when this person's hand is open, and when it is closed."""
    grasp_height_m: float
    """Where on the cube the fingers close, from its middle [m]."""
    aim_sd_m: float
    place_sd_m: float
    yaw_sd_rad: float
    rest_xyz_m: tuple[float, float, float]
    """Where the right hand rests; the left rests on the other side."""


def draw_participant(name: str, rng: np.random.Generator) -> Participant:
    """A person with habits within what people do.

    Args:
        name: How the participant is called.
        rng: Source of randomness; the same source gives the same person.
    """

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    return Participant(
        name=name,
        speed_m_per_s=between(0.38, 0.75),
        movement_base_s=between(0.30, 0.55),
        curvature=between(-0.14, 0.14),
        clearance_m=between(0.05, 0.11),
        tremor_rms_m=between(0.00005, 0.00025),
        drift_rms_m=between(0.0003, 0.0012),
        hesitation_probability=between(0.08, 0.32),
        regrasp_probability=between(0.04, 0.20),
        miss_probability=between(0.04, 0.16),
        careless_probability=between(0.03, 0.15),
        pause_probability=between(0.3, 0.9),
        pause_s=between(0.45, 1.1),
        dwell_s=between(0.05, 0.16),
        grip_s=between(0.16, 0.34),
        trigger_open=between(0.0, 0.05),
        trigger_closed=between(0.88, 1.0),
        grasp_height_m=between(-0.004, 0.008),
        aim_sd_m=between(0.002, 0.005),
        place_sd_m=between(0.0012, 0.0032),
        yaw_sd_rad=between(0.02, 0.06),
        rest_xyz_m=(between(-0.36, -0.28), between(-0.30, -0.20), between(0.08, 0.14)),
    )
