"""The declared tables as plain values, to publish and to compare in review."""

from typing import Any

import dataframely as dy

from demoplan.tables.migrating import version_of

TABLE_CONTRACT_FORMAT = 1


def contract(schema: type[dy.Schema]) -> dict[str, Any]:
    """Columns, types, units, key and rules of a table, as JSON values."""
    rules = {
        name: " ".join((factory.validation_fn.__doc__ or "").split())
        for name, factory in sorted(vars(schema).items())
        if hasattr(factory, "validation_fn")
    }
    return {
        "table": schema.__name__,
        "format": TABLE_CONTRACT_FORMAT,
        "version": version_of(schema.__name__),
        "description": " ".join((schema.__doc__ or "").split()),
        "key": schema.primary_key(),
        "columns": [
            {
                "name": name,
                "type": str(column.dtype),
                "nullable": column.nullable,
                "description": column.description or "",
                **({"unit": column.metadata["unit"]} if column.metadata else {}),
            }
            for name, column in schema.columns().items()
        ],
        "rules": rules,
    }
