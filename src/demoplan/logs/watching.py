"""What a log looks like, gathered while it streams past: clocks, values, and the tree of frames."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from demoplan.logs.messages import Times

_S = 1e-9


@dataclass(eq=False)
class ClockWatch:
    """Stamps of one clock on one topic, beside the log's own."""

    jump_s: float
    n_stamps: int = 0
    first_ns: int = 0
    last_ns: int = 0
    earliest_ns: int = 0
    latest_ns: int = 0
    n_zero: int = 0
    n_backwards: int = 0
    furthest_back_s: float = 0.0
    n_jumps: int = 0
    largest_jump_s: float = 0.0
    """Change of the distance to the log's clock between two messages; its sign says which way."""
    largest_gap_s: float = 0.0
    gap_at_ns: int = 0
    _last_log_ns: int = 0

    def see(self, stamps: Times, log: Times) -> None:
        """Take further stamps, in file order, with the log's stamps of the same messages."""
        is_set = stamps != 0
        self.n_zero += int(np.count_nonzero(~is_set))
        if not is_set.all():
            stamps, log = stamps[is_set], log[is_set]
        if not len(stamps):
            return
        if self.n_stamps:
            stamps = np.concatenate(([self.last_ns], stamps))
            log = np.concatenate(([self._last_log_ns], log))
        else:
            self.first_ns = self.earliest_ns = self.latest_ns = int(stamps[0])
        steps, log_steps = np.diff(stamps), np.diff(log)
        if len(steps):
            self.n_backwards += int(np.count_nonzero(steps < 0))
            self.furthest_back_s = max(self.furthest_back_s, -float(steps.min()) * _S)
            widest = int(np.argmax(steps))
            if float(steps[widest]) * _S > self.largest_gap_s:
                self.largest_gap_s = float(steps[widest]) * _S
                self.gap_at_ns = int(stamps[widest])
            drifts = (steps - log_steps).astype(np.float64) * _S
            is_jump = np.abs(drifts) > self.jump_s
            self.n_jumps += int(np.count_nonzero(is_jump))
            largest = float(drifts[np.argmax(np.abs(drifts))])
            if abs(largest) > abs(self.largest_jump_s):
                self.largest_jump_s = largest
        self.n_stamps += len(stamps) - (1 if self.n_stamps else 0)
        self.last_ns, self._last_log_ns = int(stamps[-1]), int(log[-1])
        self.earliest_ns = min(self.earliest_ns, int(stamps.min()))
        self.latest_ns = max(self.latest_ns, int(stamps.max()))

    @property
    def rate_hz(self) -> float | None:
        """Messages per second, over the whole log."""
        span = (self.latest_ns - self.earliest_ns) * _S
        return (self.n_stamps - 1) / span if self.n_stamps > 1 and span > 0 else None


@dataclass(eq=False)
class PoseWatch:
    """Positions and orientations on one topic."""

    quaternion_tolerance: float
    n_poses: int = 0
    n_not_finite: int = 0
    n_without_rotation: int = 0
    """Quaternions of no length."""
    n_not_unit: int = 0
    furthest: float = 0.0
    """Largest coordinate, as recorded."""

    def see(self, position: NDArray[np.float64] | None, orientation: NDArray[np.float64] | None) -> None:
        """Take further poses: ``(n, 3)`` and ``(n, 4)``."""
        some = position if position is not None else orientation
        if some is None or not len(some):
            return
        self.n_poses += len(some)
        is_finite = np.ones(len(some), bool)
        if position is not None:
            is_finite &= np.isfinite(position).all(axis=1)
            self.furthest = max(self.furthest, float(np.abs(position[is_finite]).max(initial=0.0)))
        if orientation is not None:
            with np.errstate(over="ignore"):
                norms = np.linalg.norm(orientation, axis=1)
            is_turned = np.isfinite(norms)
            is_finite &= is_turned
            self.n_without_rotation += int(np.count_nonzero(norms == 0))
            is_off = np.abs(norms[is_turned] - 1.0) > self.quaternion_tolerance
            self.n_not_unit += int(np.count_nonzero(is_off & (norms[is_turned] > 0)))
        self.n_not_finite += int(np.count_nonzero(~is_finite))


@dataclass(eq=False)
class FrameGraph:
    """Which frame was given in which."""

    edges: Counter[tuple[str, str]] = field(default_factory=Counter)
    """(parent, child) → number of transforms."""

    def see(self, parents: NDArray[np.int32], children: NDArray[np.int32], names: list[str]) -> None:
        """Take further transforms, as codes of names."""
        if not len(parents):
            return
        pairs = parents.astype(np.int64) * len(names) + children
        for pair, count in zip(*np.unique(pairs, return_counts=True), strict=True):
            parent, child = divmod(int(pair), len(names))
            self.edges[names[parent].lstrip("/"), names[child].lstrip("/")] += int(count)

    @property
    def frames(self) -> tuple[str, ...]:
        """Every frame, sorted."""
        return tuple(sorted({name for edge in self.edges for name in edge}))

    @property
    def trees(self) -> tuple[tuple[str, ...], ...]:
        """Frames that transforms connect, the largest group first."""
        group = {frame: frame for frame in self.frames}

        def find(frame: str) -> str:
            while group[frame] != frame:
                group[frame] = group[group[frame]]
                frame = group[frame]
            return frame

        for parent, child in sorted(self.edges):
            first, second = sorted((find(parent), find(child)))
            group[second] = first
        members: dict[str, list[str]] = {}
        for frame in self.frames:
            members.setdefault(find(frame), []).append(frame)
        return tuple(tuple(m) for m in sorted(members.values(), key=lambda m: (-len(m), m)))

    @property
    def conflicts(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """(child, its parents) where a child has more than one."""
        parents: dict[str, set[str]] = {}
        for parent, child in self.edges:
            parents.setdefault(child, set()).add(parent)
        return tuple((child, tuple(sorted(p))) for child, p in sorted(parents.items()) if len(p) > 1)

    @property
    def loops(self) -> tuple[str, ...]:
        """Frames that are their own ancestor, sorted."""
        children: dict[str, set[str]] = {}
        for parent, child in self.edges:
            children.setdefault(parent, set()).add(child)
        in_loop = set()
        for frame in self.frames:
            pending, seen = [frame], set()
            while pending:
                for child in children.get(pending.pop(), ()):
                    if child == frame:
                        in_loop.add(frame)
                    if child not in seen:
                        seen.add(child)
                        pending.append(child)
        return tuple(sorted(in_loop))


@dataclass(eq=False)
class TopicWatch:
    """Everything gathered about one topic."""

    clocks: dict[str, ClockWatch] = field(default_factory=dict)
    poses: PoseWatch | None = None
    problems: list[str] = field(default_factory=list)
    n_refused: int = 0
    last_index: int = -1
    _waiting: dict[str, list[tuple[Times, Times, Times]]] = field(default_factory=dict)

    def note(self, clock: str, indexes: Times, stamps: Times, log: Times) -> None:
        """Keep stamps until ``settle``: channels of one topic interleave, and come one after the other."""
        self._waiting.setdefault(clock, []).append((indexes, stamps, log))

    def settle(self, jump_s: float) -> None:
        """Look at the stamps kept so far, in file order."""
        for clock, parts in self._waiting.items():
            indexes, stamps, log = (np.concatenate(column) for column in zip(*parts, strict=True))
            order = np.argsort(indexes, kind="stable")
            self.clocks.setdefault(clock, ClockWatch(jump_s)).see(stamps[order], log[order])
        self._waiting.clear()
