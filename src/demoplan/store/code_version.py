"""The version of a stage's code: a hash over what it does, not over how it is commented."""

import ast
import functools
import importlib.util
import threading
from pathlib import Path

from demoplan.ids import content_hash

_PACKAGE = "demoplan"

_PARSING = threading.Lock()
"""Threads that parse at once fail now and then in Python 3.11: "AST constructor recursion depth mismatch"."""


@functools.cache
def code_version(*modules: str) -> str:
    """A hash over the syntax trees of modules and of all of demoplan that they import, directly or not.

    Comments, docstrings and formatting do not count, so that an edit to them makes nothing stale.

    Args:
        modules: Full names of modules, as ``demoplan.stages.align``.

    Returns:
        16 hex digits.
    """
    seen: dict[str, str] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        tree_hash, imported = _module(name)
        seen[name] = tree_hash
        waiting.extend(imported)
    return content_hash(*(f"{name}={seen[name]}" for name in sorted(seen)))[:16]


@functools.cache
def _module(name: str) -> tuple[str, tuple[str, ...]]:
    """Hash of a module's tree without docstrings, and the modules of demoplan that it imports."""
    spec = importlib.util.find_spec(name)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(name)
    with _PARSING:
        tree = ast.parse(Path(spec.origin).read_text())
    imported: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported.update(alias.name for alias in node.names if alias.name.startswith(_PACKAGE))
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith(_PACKAGE):
            parent = node.module or ""
            imported.add(parent)
            for alias in node.names:
                if _is_module(f"{parent}.{alias.name}"):
                    imported.add(f"{parent}.{alias.name}")
        body = getattr(node, "body", None)
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and body
            and isinstance(body[0], ast.Expr)
            and isinstance(body[0].value, ast.Constant)
            and isinstance(body[0].value.value, str)
        ):
            body[0].value.value = ""
    imported.discard(_PACKAGE)
    return content_hash(ast.dump(tree)), tuple(sorted(imported))


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False
