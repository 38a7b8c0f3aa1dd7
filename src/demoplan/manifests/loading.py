"""YAML text to a validated value, with errors that name the line."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from demoplan.errors import ManifestError

Model = TypeVar("Model", bound=BaseModel)

_MOST_NODES = 1_000_000
"""A file that unfolds into more values than this is refused: aliases can multiply without end."""


def load_yaml(text: str, path: Path | str, model: type[Model], *, unique: Mapping[str, str] = {}) -> Model:
    """The value that a YAML text describes.

    Args:
        text: The file's content; plain YAML 1.2, tags that name types of a language are not followed.
        path: Where the text comes from, for messages.
        model: What it must be.
        unique: List of the text → key that tells its entries apart: no two may have the same there.

    Raises:
        ManifestError: If the text is not YAML, or breaks the model's contract; every problem is listed, the
            first with its line. Or if two entries of a list go by one name; with the line of the second.
    """
    yaml = YAML(typ="rt", pure=True)
    yaml.allow_duplicate_keys = False
    try:
        tree = yaml.load(text)
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark is not None else None
        problem = (error.problem or "not YAML").split("\n")[0]
        raise ManifestError(path, line, f"not YAML: {problem}") from None
    except YAMLError as error:
        raise ManifestError(path, None, f"not YAML: {error}") from None
    try:
        plain = _plain(tree, [_MOST_NODES])
    except ValueError as error:
        raise ManifestError(path, None, f"refused: {error}") from None
    except RecursionError:
        raise ManifestError(path, None, "refused: nested too deeply") from None
    try:
        value = model.model_validate(plain)
    except ValidationError as error:
        problems = [(_line_of(tree, found["loc"]), _sentence(found, model)) for found in error.errors()]
        problems.sort(key=lambda problem: (problem[0] is None, problem[0] or 0))
        first_line, first = problems[0]
        rest = [f"\n  line {line}: {text}" if line else f"\n  {text}" for line, text in problems[1:10]]
        more = f"\n  … and {len(problems) - 10} more" if len(problems) > 10 else ""
        raise ManifestError(path, first_line, first + "".join(rest) + more) from None
    for listed, key in unique.items():
        _refuse_repeats(tree, path, listed, key)
    return value


def _refuse_repeats(tree: Any, path: Path | str, listed: str, key: str) -> None:
    first: dict[str, int] = {}
    for number, entry in enumerate(tree.get(listed) or ()):
        name = str(entry[key])
        if name in first:
            raise ManifestError(
                path,
                _line_of(tree, (listed, number, key)),
                f"{listed}: {key} {name!r} is used twice; first on line "
                f"{_line_of(tree, (listed, first[name], key))}",
            )
        first[name] = number


def _plain(node: Any, budget: list[int]) -> Any:
    """The tree as plain dicts, lists and scalars."""
    budget[0] -= 1
    if budget[0] < 0:
        raise ValueError(f"it unfolds into more than {_MOST_NODES} values")
    if isinstance(node, dict):
        return {str(key): _plain(value, budget) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_plain(value, budget) for value in node]
    if isinstance(node, bool):
        return bool(node)
    for kind in (int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node


def _line_of(tree: Any, location: Sequence[str | int]) -> int | None:
    """1-based line of the deepest part of ``location`` that stands in the text."""
    line: int | None = None
    node = tree
    for part in location:
        marks = getattr(node, "lc", None)
        if marks is None:
            break
        if isinstance(node, dict) and part in node:
            line = marks.key(part)[0] + 1
            node = node[part]
        elif isinstance(node, list) and isinstance(part, int) and part < len(node):
            line = marks.item(part)[0] + 1
            node = node[part]
        elif isinstance(node, dict) and line is None:
            line = marks.line + 1
        # A part that is not in the text is the tag of a union, or a key that is missing: stay where we are.
    return line


def _sentence(found: ErrorDetails, model: type[BaseModel]) -> str:
    """What is wrong, where, and what would be right."""
    where = ".".join(str(part) for part in found["loc"])
    kind, context = found["type"], found.get("ctx", {})
    if kind == "extra_forbidden":
        fields = _fields_at(model, found["loc"][:-1])
        allowed = f"; allowed: {', '.join(fields)}" if fields else ""
        return f"{where}: unknown key{allowed}"
    if kind == "missing":
        return f"{where}: missing"
    if kind == "union_tag_invalid":
        return f"{where}: kind {context.get('tag')!r} is unknown; allowed: {context.get('expected_tags')}"
    if kind == "union_tag_not_found":
        return f"{where}: needs a 'kind'"
    if kind == "literal_error":
        return f"{where}: {found['input']!r} is not allowed; allowed: {context.get('expected')}"
    return f"{where}: {found['msg']}, found {found['input']!r:.80}"


def _fields_at(model: type[BaseModel], location: Sequence[str | int]) -> list[str]:
    """Field names of the model that stands at ``location``, as far as its JSON schema tells."""
    schema = model.model_json_schema()
    definitions = schema.get("$defs", {})
    node: dict[str, Any] = schema
    for part in location:
        node = _resolved(node, definitions)
        if "properties" in node and part in node["properties"]:
            node = node["properties"][part]
        elif "discriminator" in node and isinstance(part, str) and part in node["discriminator"]["mapping"]:
            node = {"$ref": node["discriminator"]["mapping"][part]}
        elif isinstance(part, int) and "items" in node:
            node = node["items"]
        elif "additionalProperties" in node and isinstance(node["additionalProperties"], dict):
            node = node["additionalProperties"]
        else:
            return []
    return list(_resolved(node, definitions).get("properties", {}))


def _resolved(node: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in node:
        node = definitions[node["$ref"].rsplit("/", 1)[-1]]
    for choice in node.get("anyOf", []):
        if choice.get("type") != "null":
            return _resolved(choice, definitions)
    return node
