"""What touches hands and what they carry, and whether it should."""

from collections.abc import Sequence

import mujoco
import numpy as np

from demoplan.engines.mujoco.robots.arm_control import ArmControl


class ContactWatch:
    """Contacts of every hand, control step by control step."""

    def __init__(self, model: mujoco.MjModel, controls: Sequence[ArmControl], names: dict[int, str]) -> None:
        """Watch these hands.

        Args:
            model: The scene.
            controls: The hands, in order.
            names: What each geom of objects and table is called.
        """
        self.names = names
        self._controls = controls
        self._owner = np.full(model.ngeom, -1, dtype=np.int64)
        for number, control in enumerate(controls):
            self._owner[list(control.arm.geoms)] = number
        self._geom_of = {name: geom for geom, name in names.items()}
        self._touched: set[tuple[int, int]] = set()

    def read(self, data: mujoco.MjData) -> tuple[list[float], list[int]]:
        """Sum of normal forces on each hand [N], and how many unwanted contacts have begun, per hand."""
        forces, begun = [0.0] * len(self._controls), [0] * len(self._controls)
        touched: set[tuple[int, int]] = set()
        n = data.ncon
        if n:
            pairs = data.contact.geom[:n]
            owners = self._owner[pairs]
            if (owners >= 0).any():
                address = data.contact.efc_address[:n]
                rows = np.flatnonzero((owners >= 0).any(axis=1))
                for row in rows.tolist():
                    normal = float(data.efc_force[address[row]]) if address[row] >= 0 else 0.0
                    for mine, other in ((0, 1), (1, 0)):
                        number = int(owners[row, mine])
                        if number < 0 or owners[row, other] == number:
                            continue
                        forces[number] += normal
                        self._take(touched, number, int(pairs[row, other]))
            for number, control in enumerate(self._controls):
                if control.held is not None:
                    carried = self._geom_of[control.held.object]
                    for first, second in pairs[(pairs == carried).any(axis=1)].tolist():
                        other = second if first == carried else first
                        if self._owner[other] != number:
                            self._take(touched, number, other)
        for number, _ in touched - self._touched:
            begun[number] += 1
        self._touched = touched
        return forces, begun

    def _take(self, touched: set[tuple[int, int]], number: int, geom: int) -> None:
        if self.names.get(geom) not in self._controls[number].may_touch:
            touched.add((number, geom))
