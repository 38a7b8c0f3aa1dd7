"""A trace with nothing unusual in it, cut at its brackets into pieces, each looked at once.

A trace of a million states has tens of millions of atoms, but few different ones. Between two opening
brackets there is a name with objects and what closes behind it; such pieces repeat, so each is parsed when it
is first met and from then on is a number. Whether brackets and turns are as they should be is arithmetic on
numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.language.traces.values import Codes

_HEAD, _STATE, _ACTION, _LEAF = range(4)
_DEPTH = np.array([1, 2, 2, 3])
"""How deep each kind of list stands."""
_OPENERS = {
    **dict.fromkeys(("", "trajectory", ":trajectory", "observation", ":observation"), _HEAD),
    **dict.fromkeys((":state", ":init"), _STATE),
    **dict.fromkeys((":action", ":operator", "operator:"), _ACTION),
}
_FEWEST = 3
"""States and actions of the shortest trace: one action between two states."""
_ODD = -1
"""Number of pieces that no regular trace has."""


@dataclass(frozen=True, eq=False)
class RegularTrace:
    """States and actions in turn, beginning and ending with a state."""

    sizes: Codes
    """Atoms of each state."""
    atoms: Codes
    """Leaves of all states, one state after the other; see ``Pieces.leaves``."""
    actions: Codes
    """Leaf of each action."""


class Pieces(dict[str, int]):
    """Numbers of pieces by their text; grows as texts are read."""

    def __init__(self) -> None:
        """Start without pieces."""
        super().__init__()
        self.leaves: list[str] = []
        """Texts of innermost lists, without brackets and surrounding blanks."""
        self._leaf_of: dict[str, int] = {}
        self._rows: list[tuple[int, int, int]] = []
        self._table = np.zeros((0, 3), dtype=np.int64)

    def __missing__(self, piece: str) -> int:
        body, bracket, tail = piece.partition(")")
        name, n_closed = body.strip(), (bracket + tail).count(")")
        if tail.replace(")", "").strip():
            self[piece] = _ODD
            return _ODD
        kind = _OPENERS.get(name.lower(), _LEAF)
        if kind == _LEAF and n_closed:
            leaf = self._leaf_of.setdefault(name, len(self.leaves))
            if leaf == len(self.leaves):
                self.leaves.append(name)
            row = (_LEAF, n_closed, leaf)
        elif kind == _STATE or (kind != _LEAF and not n_closed):
            row = (kind, n_closed, -1)
        else:
            self[piece] = _ODD
            return _ODD
        self[piece] = number = len(self._rows)
        self._rows.append(row)
        return number

    def regular(self, text: str) -> RegularTrace | None:
        """The trace, if there is nothing unusual in it; comments must be gone."""
        before, *pieces = text.split("(")
        if before.strip() or not pieces:
            return None
        numbers = np.fromiter(map(self.__getitem__, pieces), dtype=np.int64, count=len(pieces))
        if numbers.min() < 0:
            return None
        if len(self._table) < len(self._rows):
            self._table = np.concatenate([self._table, np.array(self._rows[len(self._table) :])])
        kind, n_closed, leaf = self._table[numbers].T
        return _checked(kind, n_closed, leaf)


def _checked(kind: Codes, n_closed: Codes, leaf: Codes) -> RegularTrace | None:
    """The trace of these pieces, if brackets match and states and actions take turns."""
    depth = np.cumsum(1 - n_closed)
    is_leaf: NDArray[np.bool_] = kind == _LEAF
    opened = np.flatnonzero((kind == _STATE) | (kind == _ACTION))
    turns = kind[opened]
    if (
        kind[0] != _HEAD
        or (kind[1:] == _HEAD).any()
        or depth[-1] != 0
        or (depth + n_closed != _DEPTH[kind]).any()
        or len(turns) < _FEWEST
        or len(turns) % 2 == 0
        or (turns[::2] != _STATE).any()
        or (turns[1::2] != _ACTION).any()
    ):
        return None
    counts = np.diff(np.r_[opened, len(kind)]) - 1
    if (counts[1::2] != 1).any():
        return None
    is_atom = is_leaf.copy()
    is_atom[opened[1::2] + 1] = False
    return RegularTrace(sizes=counts[::2], atoms=leaf[is_atom], actions=leaf[opened[1::2] + 1])
