"""Operators and literals to a domain: what a planner may do."""

from collections.abc import Sequence
from dataclasses import replace

import dataframely as dy
import polars as pl

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Signature
from demoplan.language.types import TypeHierarchy
from demoplan.tables import Literals, Operators


def support_of(literals: dy.DataFrame[Literals]) -> dict[tuple[str, str, str], tuple[int, int]]:
    """Counts for and against each stated literal, by operator, role and the literal's text."""
    return {
        (
            row["operator"],
            row["role"],
            str(Literal(Atom(row["predicate"], tuple(row["variables"])), row["is_positive"])),
        ): (row["n_support"], row["n_against"])
        for row in literals.filter(pl.col("is_kept")).iter_rows(named=True)
    }


def compose(
    operators: dy.DataFrame[Operators],
    literals: dy.DataFrame[Literals],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    name: str,
) -> Domain:
    """The domain of all operators that are not quarantined, with the literals that are kept.

    Args:
        operators: What was learned, in any row order.
        literals: Literals of these operators; those of others are ignored.
        types: The vocabulary's types, all of which the domain declares.
        predicates: The vocabulary's predicates, all of which the domain declares: states may hold any.
        name: The domain's name.
    """
    stated = literals.filter(pl.col("is_kept"))
    literals_of: dict[tuple[str, str], set[Literal]] = {}
    for row in stated.iter_rows(named=True):
        literal = Literal(Atom(row["predicate"], tuple(row["variables"])), row["is_positive"])
        literals_of.setdefault((row["operator"], row["role"]), set()).add(literal)
    composed = tuple(
        Operator(
            name=row["operator"],
            parameters=tuple(Parameter(each["variable"], each["type"]) for each in row["parameters"]),
            preconditions=frozenset(literals_of.get((row["operator"], "precondition"), ())),
            effects=frozenset(literals_of.get((row["operator"], "effect"), ())),
            activity=row["activity"],
            cost=row["cost"],
            count=row["n_transitions"],
        )
        for row in operators.filter(~pl.col("is_quarantined")).sort("operator").iter_rows(named=True)
    )
    return Domain(name=name, types=types, predicates=tuple(sorted(predicates)), operators=composed)


def pruned(domain: Domain) -> Domain:
    """The domain without the predicates that no operator speaks of.

    A vocabulary may have many more predicates than one task needs. What is pruned can be read and published;
    planning keeps to the whole, since states hold atoms of every predicate.
    """
    used = {
        each.atom.predicate
        for operator in domain.operators
        for each in (*operator.preconditions, *operator.effects)
    }
    kept = tuple(signature for signature in domain.predicates if signature.name in used)
    return replace(domain, predicates=kept)
