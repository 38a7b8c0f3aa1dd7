"""Options that several commands share."""

import os
from pathlib import Path
from typing import Annotated

import typer

from demoplan.store import Store

DEFAULT_STORE = Path(".demoplan")

StoreOption = Annotated[
    Path,
    typer.Option("--store", metavar="DIR", help="Folder of the store.", envvar="DEMOPLAN_STORE"),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]
RootOption = Annotated[
    Path | None, typer.Option("--root", metavar="DIR", help="Where the dataset's logs are.")
]
WorkersOption = Annotated[
    int, typer.Option("--workers", min=0, metavar="N", help="Processes; 0 takes one for each core.")
]


def workers_of(asked: int) -> int:
    """How many processes to use."""
    return asked or len(os.sched_getaffinity(0))


def existing_store(folder: Path) -> Store:
    """The store in a folder that must be there.

    Raises:
        typer.BadParameter: If the folder is not there.
    """
    if not folder.is_dir():
        raise typer.BadParameter(
            f"{folder}: no store here; `demoplan run DATASET` makes one", param_hint="--store"
        )
    return Store(folder)
