"""Progress of a long job as a Prefect artifact, from the thread in which the job runs."""

import asyncio
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from typing import Any

from prefect.artifacts import acreate_progress_artifact, aupdate_progress_artifact
from prefect.logging import get_run_logger

from flows.showing import key_of

INTERVAL_S = 2.0
"""Shortest time between two updates: each is a request to the server."""


class ArtifactProgress:
    """What the pipeline calls to say how far it is. Made in the event loop, called from another thread."""

    def __init__(self) -> None:
        """Remember the loop that talks to the server."""
        self._loop = asyncio.get_running_loop()
        self._log = get_run_logger()

    @contextmanager
    def __call__(self, description: str, total: int) -> Iterator[Callable[[str], None]]:
        """Begin a part of ``total`` things."""
        artifact_id = self._wait(acreate_progress_artifact(0.0, key_of("progress", description), description))
        self._log.info("%s: %d", description, total)
        n_done, told_s = 0, time.monotonic()

        def done(name: str) -> None:
            nonlocal n_done, told_s
            n_done += 1
            if time.monotonic() - told_s > INTERVAL_S:
                told_s = time.monotonic()
                text = f"{description}: {n_done} of {total}, {name}"
                self._wait(aupdate_progress_artifact(artifact_id, 100.0 * n_done / max(total, 1), text))

        yield done
        self._wait(aupdate_progress_artifact(artifact_id, 100.0, f"{description}: {n_done} of {total}"))

    def _wait(self, call: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(call, self._loop).result()
