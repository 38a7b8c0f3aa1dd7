"""Everything on one clock: one row per entity and tick."""

import dataframely as dy


class Frames(dy.Schema):
    """One row per entity × tick; sorted by entity, then tick; every entity has every tick of its episode.

    A pose is null where nothing was seen within the staleness limit.
    """

    episode_id = dy.String(primary_key=True, description="The demonstration")
    entity = dy.String(primary_key=True, description="Hand or object instance")
    tick_ns = dy.Int64(primary_key=True, description="Tick of the episode clock", metadata={"unit": "ns"})
    position_xyz_m = dy.Array(
        dy.Float64(nullable=True),
        3,
        nullable=True,
        description="Position in the world",
        metadata={"unit": "m"},
    )
    orientation_wxyz = dy.Array(
        dy.Float64(nullable=True), 4, nullable=True, description="Unit quaternion, body to world"
    )
    grip = dy.Float64(nullable=True, min=0.0, max=1.0, description="Opening of a hand: 0 closed, 1 open")
    pose_age_ns = dy.Int64(
        nullable=True,
        min=0,
        description="Distance in time to the nearest sample that the pose comes from",
        metadata={"unit": "ns"},
    )
