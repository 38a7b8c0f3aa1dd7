"""Options that several commands share."""

import os
from pathlib import Path
from typing import Annotated

import typer

from demoplan.store import Store

DEFAULT_STORE = ".demoplan"

StoreOption = Annotated[
    str,
    typer.Option(
        "--store",
        metavar="DIR|URL",
        help="Where the store is: a folder, or s3://BUCKET/PREFIX.",
        envvar="DEMOPLAN_STORE",
    ),
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


def existing_store(location: str) -> Store:
    """The store at a place where something was written before.

    Raises:
        typer.BadParameter: If nothing was.
        StoreError: If the place cannot be asked.
    """
    store = Store(location)
    if not store.place.exists():
        raise typer.BadParameter(
            f"{location}: no store here; `demoplan run DATASET` makes one", param_hint="--store"
        )
    return store


def local_folder(store: Store, name: str) -> Path:
    """A folder for what is made from a store and is of use on this machine: in the store, if that is here.

    Args:
        store: The store.
        name: What the folder is called.
    """
    return store.place.path(name) or Path(DEFAULT_STORE, name)
