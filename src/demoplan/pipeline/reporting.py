"""How a long job says how far it is, without knowing who listens."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Progress(Protocol):
    """Called at the start of a part; gives a context with a function to call with each thing that is done."""

    def __call__(self, description: str, total: int) -> AbstractContextManager[Callable[[str], None]]:
        """Begin a part of ``total`` things."""


def silent(description: str, total: int) -> AbstractContextManager[Callable[[str], None]]:
    """A progress that says nothing."""
    return nullcontext(lambda _: None)
