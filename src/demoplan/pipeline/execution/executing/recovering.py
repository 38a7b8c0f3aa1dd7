"""The robot's own ways out, which no operator was shown: laying down what it holds, opening a closed hand."""

from collections.abc import Callable

from demoplan.engines.mujoco.session import Motion
from demoplan.language.atoms import Atom
from demoplan.pipeline.execution.executing.hands import Hands
from demoplan.pipeline.execution.executing.params import ExecuteParams
from demoplan.pipeline.execution.executing.rows import Row
from demoplan.pipeline.execution.senses import TABLE, Senses
from demoplan.stages.monitor import SensedState


class Recovery:
    """Motions that no plan asked for; each is a row as any other."""

    def __init__(self, hands: Hands, senses: Senses, params: ExecuteParams) -> None:
        """Move with ``hands``, and look with ``senses``."""
        self._hands, self._senses, self._params = hands, senses, params

    def free_a_hand(self, sensed: SensedState, new_row: Callable[[], Row]) -> bool:
        """A hand that holds something lays it down, a closed one opens; whether that changed anything.

        Learned operators put things where they were shown to be put, and none begins with an object in the
        air or an empty fist.

        Args:
            sensed: What is perceived now.
            new_row: Where each motion is written down.
        """
        for hand in self._hands.session.hands:
            held = sorted(
                atom.arguments[1]
                for atom in sensed.held
                if atom.predicate == self._params.holding and atom.arguments[0] == hand
            )
            is_open = all(Atom(name, (hand,)) in sensed.held for name in self._params.ends_with)
            if len(held) > 1 or (not held and is_open):
                continue
            if held:
                put = Motion(activity="Put", skill="carry", object=held[0], support=TABLE)
                self.move(hand, put, new_row())
            self.open(hand, new_row(), held[0] if held else None)
            self._hands.advance(self._params.lag_s)
            return self._senses.look().held != sensed.held
        return False

    def open(self, hand: str, row: Row, thing: str | None = None) -> None:
        """Open a hand, of which it is known or not what it holds."""
        self.move(hand, Motion(activity="Release", skill="release", object=thing), row)

    def move(self, hand: str, motion: Motion, row: Row) -> None:
        """Make a motion, to its end, and write it down."""
        row |= {
            "operator": f"recover_{motion.skill}",
            "arguments": [hand, *([motion.object] if motion.object else [])],
            "hand": hand,
            "activity": motion.activity,
            "start_ns": self._hands.session.time_ns,
        }
        report = self._hands.move(hand, motion)
        row |= {
            "state": "succeeded" if report.state == "succeeded" else "failed",
            "end_ns": self._hands.session.time_ns,
            "cause": report.reason,
        }
