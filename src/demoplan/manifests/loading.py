"""YAML text to a validated value, with errors that name the line."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import CollectionEndEvent, CollectionStartEvent

from demoplan.errors import ManifestError, UsageError

Model = TypeVar("Model", bound=BaseModel)

Location: TypeAlias = tuple[str | int, ...]
"""Keys and numbers that lead from the top of a text to a part of it."""

Check: TypeAlias = Callable[[Model], Iterable[tuple[Location, str]]]
"""From a value to what is wrong with it, each with its place."""

_HAS_DIRECTIVE = re.compile(r"^%", re.MULTILINE)
"""``%YAML 1.1`` and the like: the quick parser does not follow them."""

_DEEPEST = 100
"""Levels of nesting that the quick parser is given."""

_MOST_NODES = 1_000_000
"""A file that unfolds into more values than this is refused: aliases can multiply without end."""


def read_text(path: Path) -> str:
    """The text of a file that somebody named.

    Raises:
        UsageError: If it is not there, cannot be read, or is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise UsageError(f"{path}: cannot be read: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read: {error}") from None


def load_yaml(
    text: str,
    path: Path | str,
    model: type[Model],
    *,
    unique: Mapping[str, str] = {},
    check: Check[Model] = lambda _: (),
) -> Model:
    """The value that a YAML text describes.

    Args:
        text: The file's content; plain YAML 1.2, tags that name types of a language are not followed.
        path: Where the text comes from, for messages.
        model: What it must be.
        unique: List of the text → key that tells its entries apart: no two may have the same there.
        check: What else is wrong with a value of the right form, and where in it.

    Raises:
        ManifestError: If the text is not YAML, or breaks the model's contract; every problem is listed, the
            first with its line. Or if two entries of a list go by one name; with the line of the second. Or
            if ``check`` finds a problem; with the line of the first.
    """
    if not _HAS_DIRECTIVE.search(text) and _is_shallow(text):
        try:
            return _value(YAML(typ="safe"), text, path, model, unique, check)
        except ManifestError:
            pass  # The parser that knows lines, and takes four times as long, has the last word.
    return _value(YAML(typ="rt", pure=True), text, path, model, unique, check)


def _is_shallow(text: str) -> bool:
    """Whether the quick parser can follow: it recurses without looking where its stack ends."""
    depth = 0
    try:
        for event in YAML(typ="safe").parse(text):
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > _DEEPEST:
                return False
    except YAMLError:
        return False
    return True


def _value(
    yaml: YAML,
    text: str,
    path: Path | str,
    model: type[Model],
    unique: Mapping[str, str],
    check: Check[Model],
) -> Model:
    yaml.allow_duplicate_keys = False
    try:
        tree = yaml.load(text)
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark is not None else None
        problem = (error.problem or "not YAML").split("\n")[0]
        raise ManifestError(path, line, f"not YAML: {problem}") from None
    except YAMLError as error:
        raise ManifestError(path, None, f"not YAML: {error}") from None
    except RecursionError:
        raise ManifestError(path, None, "refused: nested too deeply") from None
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
    for where, problem in check(value):
        raise ManifestError(path, _line_of(tree, where), problem)
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
