"""What a robot believes of its world: poses from its sensors, through the same perception as the logs."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import polars as pl

from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.engines.mujoco.session import Session
from demoplan.language.atoms import Atom
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.mapping import Box, Entity, FixedPose
from demoplan.stages.monitor import MonitorParams, SensedState, sensed_state
from demoplan.stages.perceive import PerceiveParams, perceive
from demoplan.tables import Frames

TABLE = "table"


@dataclass(frozen=True, kw_only=True)
class SenseParams:
    """What can be chosen about looking at the world."""

    window_s: float = 0.8
    """How much of the past perception sees at each look [s]; hysteresis and velocities need some."""
    hand_type: str = "Hand"
    table_type: str = "Table"
    perceiving: PerceiveParams = field(default_factory=PerceiveParams)
    monitoring: MonitorParams = field(default_factory=MonitorParams)


@dataclass(frozen=True, kw_only=True)
class Misreading:
    """Perception errs about some atoms until some time, whatever the poses are: a fault that is injected."""

    atoms: frozenset[Atom]
    until_ns: int
    says: frozenset[Atom] | None = None
    """Those of the atoms that are said to hold; None says the opposite of what is seen of each."""

    def change(self, state: SensedState) -> SensedState:
        """What is believed instead of a state."""
        said = self.atoms - state.held if self.says is None else self.atoms & self.says
        return SensedState(state.tick_ns, (state.held - self.atoms) | said, state.unknown - self.atoms)


class Senses:
    """Looks at a session's world; one look per instant is enough, so looks are remembered."""

    def __init__(self, session: Session, vocabulary: Vocabulary, params: SenseParams = SenseParams()) -> None:
        """Look at ``session`` with the words of ``vocabulary``."""
        self.session, self.vocabulary, self.params = session, vocabulary, params
        self.entities = entities_of_scene(session.scene, session.hands, params)
        self.type_of = {name: entity.type for name, entity in self.entities.items()}
        self.misreadings: list[Misreading] = []
        self._last: SensedState | None = None
        self._last_ns = -1

    @property
    def objects(self) -> tuple[str, ...]:
        """Loose objects, in the scene's order."""
        return self.session.scene.names

    def look(self) -> SensedState:
        """What is perceived now."""
        if self._last is None or self._last_ns != self.session.time_ns:
            self._last = self._perceived(self.session.frames(self._since_ns()))
            self._last_ns = self.session.time_ns
        state = self._last
        for misreading in self.misreadings:
            if misreading.until_ns > self.session.time_ns:
                state = misreading.change(state)
        return state

    def truth(self) -> SensedState:
        """What perfect sensors would show: for scoring only."""
        return self._perceived(self.session.true_frames(self._since_ns()))

    def frames(self, since_ns: int) -> pl.DataFrame:
        """What sensors saw of hands, objects and the table after an instant."""
        return with_fixed(self.session.frames(since_ns), self.entities)

    def position(self, name: str) -> np.ndarray | None:
        """Where an object was last seen within the window, ``(3,)``; None if it was not."""
        rows = self.session.frames(self._since_ns()).filter(
            (pl.col("entity") == name) & pl.col("position_xyz_m").is_not_null()
        )
        if rows.is_empty():
            return None
        return np.asarray(np.median(rows["position_xyz_m"].to_numpy()[-5:], axis=0))

    def _since_ns(self) -> int:
        return max(-1, self.session.time_ns - round(self.params.window_s * 1e9))

    def _perceived(self, frames: pl.DataFrame) -> SensedState:
        if frames.is_empty():
            return SensedState(self.session.time_ns, frozenset())
        whole = Frames.validate(with_fixed(frames, self.entities), cast=True)
        facts = perceive(whole, self.entities, self.vocabulary, self.params.perceiving)
        end_ns = facts["end_ns"].max()
        instant_ns = end_ns if isinstance(end_ns, int) else self.session.time_ns
        return sensed_state(facts, instant_ns, self.params.monitoring)


def entities_of_scene(
    scene: SceneSpec, hands: tuple[str, ...], params: SenseParams = SenseParams()
) -> dict[str, Entity]:
    """Type and shape of everything in a scene: hands, objects, the table."""
    entities = {hand: Entity(type=params.hand_type) for hand in hands}
    for each in scene.objects:
        entities[each.name] = Entity(type=each.type, shape=Box(kind=each.kind, size_xyz_m=each.size_xyz_m))
    depth, width, thickness = scene.table_size_xyz_m
    entities[TABLE] = Entity(
        type=params.table_type,
        shape=Box(size_xyz_m=(depth, width, thickness), centre_xyz_m=(0.0, 0.0, -thickness / 2)),
        fixed=FixedPose(position_xyz_m=(0.0, 0.0, 0.0)),
    )
    return entities


def with_fixed(frames: pl.DataFrame, entities: Mapping[str, Entity]) -> pl.DataFrame:
    """The frames with a row per tick for every fixed body that no sensor follows; sorted."""
    if frames.is_empty():
        return frames
    seen = set(frames["entity"].unique())
    ticks = frames.select(pl.col("episode_id").first(), pl.col("tick_ns").unique().sort())
    parts = [frames]
    for name, entity in entities.items():
        if entity.fixed is None or name in seen:
            continue
        n = ticks.height
        parts.append(
            ticks.select(
                "episode_id",
                pl.lit(name).alias("entity"),
                "tick_ns",
                pl.Series("position_xyz_m", np.tile(entity.fixed.position_xyz_m, (n, 1))),
                pl.Series("orientation_wxyz", np.tile(entity.fixed.orientation_wxyz, (n, 1))),
                pl.lit(None, dtype=pl.Float64).alias("grip"),
                pl.lit(0, dtype=pl.Int64).alias("pose_age_ns"),
            ).select(frames.columns)
        )
    return pl.concat(parts, how="vertical_relaxed").sort("entity", "tick_ns")
