"""Retries, where a second try can help: disks and network shares come back, a bad log does not."""

from collections.abc import Mapping
from typing import Any

from prefect.cache_policies import NO_CACHE

from demoplan.errors import StoreError

RETRIES = 3
RETRY_DELAYS_S = [10, 60, 300]


def is_worth_retrying(task: object, run: object, state: Any) -> bool:
    """Whether a task failed on the way to a disk, and not by what it was given."""
    return isinstance(state.data, (StoreError, OSError))


EDGE: Mapping[str, Any] = {
    "retries": RETRIES,
    "retry_delay_seconds": RETRY_DELAYS_S,
    "retry_condition_fn": is_worth_retrying,
    "cache_policy": NO_CACHE,
    "persist_result": False,
}
"""Options of a task that reads or writes files. Nothing is cached by Prefect: our own content keys decide."""
