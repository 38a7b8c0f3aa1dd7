"""Tables held to their declarations, quickly where they keep them."""

import contextlib
import functools
from typing import TypeVar

import dataframely as dy
import polars as pl

Table = TypeVar("Table", bound=dy.Schema)


def validated(table: pl.DataFrame, schema: type[Table]) -> dy.DataFrame[Table]:
    """The table, held to its declaration: the same answer as ``schema.validate(table, cast=True)``.

    That filters row by row, so as to say which rows fail, and builds its query anew each time. Here all rules
    are asked at once whether they hold throughout, with expressions that are built once per declaration;
    only a table that fails goes the slow way, which then names the rows.

    Raises:
        dataframely.exc.SchemaError: If a column is missing.
        dataframely.exc.ValidationError: If a rule does not hold.
        polars.exceptions.InvalidOperationError: If a column cannot be cast.
    """
    typed = table
    if not is_typed(table, schema):
        # If a column is missing or cannot be cast, the slow way says which.
        with contextlib.suppress(pl.exceptions.PolarsError, dy.exc.SchemaError):
            typed = schema.cast(table)
    if is_typed(typed, schema):
        conditions, is_key_rising, is_key_unique = _conditions(schema)
        # Whether the key rises is asked with the rest; only if not, whether it is unique: that takes longer.
        *others, is_rising = typed.select(*conditions, is_key_rising).row(0)
        if all(others) and (is_rising or typed.select(is_key_unique).item()):
            return typed  # type: ignore[return-value]
    return schema.validate(table, cast=True)


def are_rows_valid(table: pl.DataFrame, schema: type[dy.Schema]) -> bool:
    """Whether a table has the declared columns, and all rules but that of the key hold."""
    return is_typed(table, schema) and all(table.select(*_conditions(schema)[0]).row(0))


def is_typed(table: pl.DataFrame, schema: type[dy.Schema]) -> bool:
    """Whether a table has exactly the declared columns, in the declared order and of the declared types."""
    return table.schema == _declared(schema)


@functools.cache
def _declared(schema: type[dy.Schema]) -> pl.Schema:
    return schema.create_empty().schema


@functools.cache
def _conditions(schema: type[dy.Schema]) -> tuple[list[pl.Expr], pl.Expr, pl.Expr]:
    """One expression per rule: whether it holds in every row; null, for want of a value, counts as yes.

    The primary key stands apart, in two forms: whether its values rise from row to row, which is quickly seen
    of a table in its own order, and whether they are unique.
    """
    rules = dict(schema._validation_rules(with_cast=False))
    unique = rules.pop("primary_key").expr.all() if "primary_key" in rules else pl.lit(True)
    declared, key = _declared(schema), schema.primary_key()
    rises = pl.lit(not key)
    if not any(declared[name].is_nested() for name in key):
        for name in reversed(key):
            here, before = pl.col(name), pl.col(name).shift()
            rises = (here > before) | ((here == before) & rises)
    conditions = []
    for name, dtype in declared.items():
        asks = [f"{name}|inner_nan", f"{name}|inner_inf"]
        if isinstance(dtype, pl.Array) and dtype.inner.is_float() and all(ask in rules for ask in asks):
            # Where the sum of a row is a number, its entries are. A sum may overflow: the slow way decides.
            conditions.append(pl.col(name).arr.sum().is_finite().all(ignore_nulls=True).alias(asks[0]))
            del rules[asks[0]], rules[asks[1]]
    conditions += [rule.expr.all(ignore_nulls=True).alias(name) for name, rule in rules.items()]
    return conditions, rises.all(ignore_nulls=True).alias("|rises"), unique
