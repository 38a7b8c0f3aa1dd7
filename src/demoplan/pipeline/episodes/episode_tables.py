"""The tables of one episode, while stages make them one from another; and those of several, joined."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeAlias

import dataframely as dy
import polars as pl

from demoplan.ids import ContentHash
from demoplan.pipeline.episodes.memory import give_memory_back
from demoplan.store import EpisodeState, Store, stage_key
from demoplan.store.code_version import code_version
from demoplan.store.objects import ROWS_AT_ONCE, Draft, Table
from demoplan.store.store import StageOutput

Made: TypeAlias = dict[str, tuple[pl.DataFrame | Draft, type[dy.Schema]]]
"""What a stage gives: its tables by name, long ones as drafts, with their declarations."""


class EpisodeTables:
    """The tables of one episode while its stages run: stored as they come, kept in memory unless long."""

    long_rows = ROWS_AT_ONCE
    """A table with more rows is written as it is made and read in parts: it is never in memory as a whole."""

    def __init__(self, store: Store) -> None:
        """Run stages over ``store``."""
        self.store = store
        self._memory: dict[str, pl.DataFrame] = {}
        self.contents: dict[str, str] = {}
        self.keys: dict[str, str] = {}
        self.notes: dict[str, str] = {}
        self.attempt: str | None = None
        """Key of the stage that runs now; it stays if the stage fails."""
        self._drafts = contextlib.ExitStack()
        """Of the stage that runs now."""

    def run(
        self,
        stage: str,
        *,
        modules: Sequence[str],
        inputs: dict[str, str],
        params: str,
        make: Callable[[], Made],
    ) -> bool:
        """Run a stage if its output is not there; say whether it was made anew.

        Args:
            stage: Its name.
            modules: What it is made of.
            inputs: Name of each input → hash of its content.
            params: Its parameters, as canonical JSON.
            make: What gives its tables.
        """
        made: dict[str, pl.DataFrame | Draft] = {}

        def work() -> StageOutput:
            tables = make()
            made.update({name: table for name, (table, _) in tables.items()})
            return StageOutput(tables=tables, notes=dict(self.notes))

        version = code_version(*modules)
        self.attempt = str(stage_key(stage, inputs, params, version))
        with contextlib.ExitStack() as self._drafts:
            record = self.store.run(stage, inputs, params, version, work)
        self.attempt = None
        self.contents |= record.outputs
        self.keys[stage] = str(record.key)
        self.notes |= record.notes
        for name, table in made.items():
            if isinstance(table, Draft):
                give_memory_back()
            else:
                self._memory[record.outputs[name]] = table
        return bool(made)

    def get(self, name: str, schema: type[Table]) -> dy.DataFrame[Table]:
        """A table of this episode, from memory if it was made just now."""
        content = self.contents[name]
        if content in self._memory:
            return self._memory[content]  # type: ignore[return-value]
        return self.store.get(content, schema)

    def drafted(self, parts: Iterable[pl.DataFrame], schema: type[dy.Schema]) -> Draft:
        """Write a long table of the stage that runs now, part by part."""
        return self._drafts.enter_context(self.store.objects.drafted(parts, schema))

    def is_long(self, name: str) -> bool:
        """Whether a table is not to be had as a whole."""
        content = ContentHash(self.contents[name])
        if content in self._memory:
            return False
        n_rows = self.store.objects.n_rows(content)
        return n_rows is not None and n_rows > self.long_rows

    def parts(self, name: str, schema: type[Table]) -> Iterator[dy.DataFrame[Table]]:
        """A long table of this episode, some rows at a time."""
        return self.store.objects.parts(ContentHash(self.contents[name]), schema)


def tables_of(
    store: Store, states: Sequence[EpisodeState], name: str, schema: type[Table]
) -> dy.DataFrame[Table]:
    """One table of several episodes, joined in order of episode."""
    return schema.cast(store.joined([s.tables[name] for s in states if name in s.tables], schema))
