"""Bounds of what flows take. Prefect makes the form of a deployment of these types and of docstrings."""

import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from demoplan.pipeline.datasets import OpenDataset, open_dataset
from demoplan.store import Store

Workers = Annotated[int, Field(ge=1, le=256)]
Runner = Annotated[Literal["processes", "threads", "dask", "ray"] | None, Field()]
Address = Annotated[str | None, Field(pattern=r"^[A-Za-z0-9_.:/\[\]-]+$")]
Bucket = Annotated[str | None, Field(pattern=r"^s3://[^/]+(/.*)?$")]
QuietSeconds = Annotated[float, Field(ge=0.0)]


def store_at(location: str) -> Store:
    """A store, by a path that does not depend on the folder in which a worker was started, or by its URL."""
    return Store(location if "://" in location else str(Path(location).absolute()))


def opened(dataset: Path, root: Path | None) -> OpenDataset:
    """A dataset, with paths that do not depend on the folder in which a worker was started."""
    return open_dataset(dataset.absolute(), root=root and root.absolute(), environment=os.environ)
