"""What a session looked like, kept while it runs, so that it can be drawn when it is over."""

from dataclasses import dataclass, field

import mujoco

from demoplan.geometry import Array


@dataclass
class Film:
    """Configurations of a scene, a few per second. Nothing is drawn while physics runs."""

    rate_hz: float = 25.0
    model: mujoco.MjModel | None = None
    """The scene, once a session has begun to fill the film."""
    time_ns: list[int] = field(default_factory=list)
    positions: list[Array] = field(default_factory=list)
    """``qpos`` at each of these times."""
    obstacles: list[Array] = field(default_factory=list)
    """``mocap_pos`` at each of these times, ``(k, 3)``."""

    def take(self, time_ns: int, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Keep the configuration of now, if it is time for it."""
        if self.time_ns and (time_ns - self.time_ns[-1]) * self.rate_hz < 1e9:
            return
        self.model = model
        self.time_ns.append(time_ns)
        self.positions.append(data.qpos.copy())
        self.obstacles.append(data.mocap_pos.copy())
