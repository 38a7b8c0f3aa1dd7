"""Why a stage is stale, told from the record of its last run."""

import json
from collections.abc import Iterator, Mapping

from demoplan import tables as declared
from demoplan.errors import StoreError
from demoplan.ids import ContentHash
from demoplan.store import Record, Store
from demoplan.store.records import schema_version

PENDING = "pending"
"""Stands for the content of a table that a stale stage has yet to give; no key is made from it twice."""

_MOST_PATHS = 4
"""Changed parameters that a reason names."""


def reason_of(
    store: Store, stage: str, key: str | None, inputs: Mapping[str, str], params: str, version: str
) -> tuple[str, str]:
    """Why a stage's output is not there: what differs from its last run.

    Args:
        store: The store.
        stage: The stage's name.
        key: Key of its last run; None if it never ran.
        inputs: Name of each input → hash of its content now, or ``PENDING``.
        params: Its parameters now, as canonical JSON.
        version: The version of its code now.

    Returns:
        One of the reasons of ``Staleness``, and the same in words.
    """
    if key is None:
        pending = sorted(name for name, content in inputs.items() if content == PENDING)
        return "new", "never ran" + (f"; waits for {', '.join(pending)}" if pending else "")
    try:
        last = store.records.get(stage, ContentHash(key))
    except StoreError as error:
        return "output", str(error)
    if last is None:
        return "output", "the record of its last run is gone"
    changed = [name for name, was in sorted(last.schemas.items()) if was != _schema_now(was)]
    if changed:
        return "schema", f"the declaration of {', '.join(changed)} changed"
    if last.code_version != version:
        return "code", f"code {last.code_version} → {version}"
    if last.params != params:
        return "parameters", _parameter_changes(last, params)
    differing = sorted(
        name for name in inputs.keys() | last.inputs.keys() if inputs.get(name) != last.inputs.get(name)
    )
    pending = [name for name in differing if inputs.get(name) == PENDING]
    if pending:
        return "upstream", f"{', '.join(pending)} to be made again"
    if differing:
        return "input", f"{', '.join(differing)} changed"
    gone = [name for name, content in last.outputs.items() if not store.objects.has(ContentHash(content))]
    return "output", f"{', '.join(sorted(gone))} not in the store"


def _schema_now(was: str) -> str | None:
    schema = getattr(declared, was.partition(":")[0], None)
    return None if schema is None else schema_version(schema)


def _parameter_changes(last: Record, params: str) -> str:
    found = list(_differences(json.loads(last.params), json.loads(params), ""))
    more = f" and {len(found) - _MOST_PATHS} more" if len(found) > _MOST_PATHS else ""
    return "; ".join(found[:_MOST_PATHS]) + more


def _differences(old: object, new: object, path: str) -> Iterator[str]:
    """Where two JSON values differ, as ``a.b[2]: old → new``."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in sorted(old.keys() | new.keys()):
            yield from _differences(old.get(name), new.get(name), f"{path}.{name}".lstrip("."))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from _differences(before, after, f"{path}[{index}]")
    elif old != new:
        yield f"{path}: {_short(old)} → {_short(new)}"


def _short(value: object, limit: int = 40) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= limit else text[: limit - 1] + "…"
