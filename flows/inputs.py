"""Bounds of what flows take. Prefect makes the form of a deployment of these types and of docstrings."""

from typing import Annotated

from pydantic import Field

Workers = Annotated[int, Field(ge=1, le=256)]
QuietSeconds = Annotated[float, Field(ge=0.0)]
