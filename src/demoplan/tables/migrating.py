"""Tables that were written by earlier versions of their declarations, as they are declared now.

A declaration has a version: 1, and one more with each change after which tables that were written before do
not keep it any more. Each such change has one function here that turns a table of the version before into one
of the version after; tables pass through all that they missed, in order. A table of a version that is not
known is refused: a newer demoplan wrote it, and what it means is not guessed.
"""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import polars as pl

Migration: TypeAlias = Callable[[pl.DataFrame], pl.DataFrame]


def _runs_without_time_of_fault(table: pl.DataFrame) -> pl.DataFrame:
    """Version 1 of ``Runs`` did not say when a fault happened: that is not known of its runs.

    Its ``is_recoverable`` is what the faults file said, and stays.
    """
    return table.with_columns(pl.lit(None, dtype=pl.Int64).alias("fault_ns"))


MIGRATIONS: Mapping[str, tuple[Migration, ...]] = {"Runs": (_runs_without_time_of_fault,)}
"""Name of a declaration → what turns its version 1 into 2, 2 into 3, and so on; others are in version 1."""


def version_of(name: str, migrations: Mapping[str, tuple[Migration, ...]] = MIGRATIONS) -> int:
    """The version of a declaration, by its name.

    >>> version_of("Runs"), version_of("Facts")
    (2, 1)
    """
    return 1 + len(migrations.get(name, ()))


def migrated(
    table: pl.DataFrame,
    name: str,
    version: int,
    migrations: Mapping[str, tuple[Migration, ...]] = MIGRATIONS,
) -> pl.DataFrame:
    """A table of some version of a declaration as one of the version now; the given one is not changed.

    Args:
        table: As it was written.
        name: The declaration's name.
        version: The version that it was written by.
        migrations: What turns each version into the next.

    Raises:
        ValueError: If there is no such version.
    """
    if not 1 <= version <= version_of(name, migrations):
        raise ValueError(f"{name} version {version}; known: 1 to {version_of(name, migrations)}")
    for migration in migrations.get(name, ())[version - 1 :]:
        table = migration(table)
    return table
