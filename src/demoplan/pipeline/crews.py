"""Who works on many things at once: processes of this machine here, the workers of a cluster in ``flows``."""

import multiprocessing
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Protocol, TypeVar

Order = TypeVar("Order")
Result = TypeVar("Result")

_AHEAD = 2
"""Orders that wait in the pool for each process: none is ever idle, and few are lost when one dies."""

TRIES_ALONE = 2
"""How often an order is tried with nobody beside it, before it is held to be what kills its process."""


class Crew(Protocol):
    """Does the same work for many orders, somewhere else.

    Work is a function that can be imported by its name. Orders and results are small: paths, hashes, words;
    tables stay in the store.
    """

    def __call__(
        self, work: Callable[[Order], Result], orders: Sequence[Order]
    ) -> Iterator[tuple[Order, Result | None]]:
        """Each order with its result, as they end; None if whoever worked on it died, again and again.

        An error of the work itself is raised.
        """
        ...


@dataclass(frozen=True)
class Processes:
    """Processes of this machine; with one, or one order only, this process itself."""

    n_workers: int

    def __call__(
        self, work: Callable[[Order], Result], orders: Sequence[Order]
    ) -> Iterator[tuple[Order, Result | None]]:
        """See ``Crew``. Of a process that died, every order that may have been its own is tried alone."""
        if self.n_workers <= 1 or len(orders) <= 1:
            yield from ((order, work(order)) for order in orders)
            return
        waiting = deque(orders)
        while waiting:
            suspects = yield from self._until_one_dies(work, waiting)
            for order in suspects:
                yield order, _alone(work, order)

    def _until_one_dies(
        self, work: Callable[[Order], Result], waiting: deque[Order]
    ) -> Generator[tuple[Order, Result | None], None, list[Order]]:
        """Take orders until none waits or a process dies; give back those that were in hand then."""
        suspects: list[Order] = []
        running: dict[Future[Result], Order] = {}
        with _pool(min(self.n_workers, len(waiting))) as pool:
            while (waiting and not suspects) or running:
                while waiting and not suspects and len(running) < _AHEAD * self.n_workers:
                    order = waiting.popleft()
                    try:
                        running[pool.submit(work, order)] = order
                    except BrokenProcessPool:
                        suspects.append(order)
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    order = running.pop(future)
                    try:
                        yield order, future.result()
                    except BrokenProcessPool:
                        suspects.append(order)
        return suspects


def _alone(work: Callable[[Order], Result], order: Order) -> Result | None:
    for _ in range(TRIES_ALONE):
        with _pool(1) as pool:
            try:
                return pool.submit(work, order).result()
            except BrokenProcessPool:
                continue
    return None


def _pool(n_workers: int) -> ProcessPoolExecutor:
    # Never a fork: polars' thread pool does not survive one.
    return ProcessPoolExecutor(n_workers, mp_context=multiprocessing.get_context("spawn"))
