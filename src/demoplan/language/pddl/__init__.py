"""Domains and problems as PDDL text: byte-stable out, strict in.

Text is canonical: every set is sorted, names are ``[a-z][a-z0-9_-]*`` whatever they were in the logs, and
what PDDL cannot say (original names, activities, counts) stands in comments of a fixed form, so that
``parse_domain(render_domain(domain)) == domain``.
"""

from demoplan.language.pddl.parse import parse_domain, parse_problem
from demoplan.language.pddl.render import domain_id, problem_id, render_domain, render_problem
from demoplan.language.pddl.symbols import SymbolMap, domain_symbols, problem_symbols

__all__ = [
    "SymbolMap",
    "domain_id",
    "domain_symbols",
    "parse_domain",
    "parse_problem",
    "problem_id",
    "problem_symbols",
    "render_domain",
    "render_problem",
]
