"""Names, shapes and places: what ``meta/info.json`` declares, and the Arrow types of the files.

Source: lerobot 0.6, ``datasets/utils.py``, ``datasets/feature_utils.py``, ``datasets/language.py``.
"""

import json
from typing import Any

import pyarrow as pa

from demoplan.exports.lerobot.content import DatasetFacts, LeRobotParams
from demoplan.exports.lerobot.vectors import environment_names, seen_names, state_names

CODEBASE_VERSION = "v3.0"
INFO = "meta/info.json"
STATS = "meta/stats.json"
TASKS = "meta/tasks.parquet"
SUBTASKS = "meta/subtasks.parquet"
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

STATE = "observation.state"
ENVIRONMENT = "observation.environment_state"
SEEN = "observation.is_seen"
ACTION = "action"
SUBTASK = "subtask_index"
LANGUAGE = "language_persistent"
DONE = "next.done"
SUCCESS = "next.success"

_ARROW = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}


def hand_subtask(hand: str) -> str:
    """The feature that numbers what one hand does."""
    return f"{SUBTASK}.{hand}"


def features_of(
    facts: DatasetFacts, params: LeRobotParams, *, has_subtasks: bool, has_success: bool
) -> dict[str, dict[str, Any]]:
    """Every feature, as ``meta/info.json`` declares it: dtype, shape, and names of its components."""

    def vector(dtype: str, names: list[str]) -> dict[str, Any]:
        return {"dtype": dtype, "shape": [len(names)], "names": names}

    def number(dtype: str) -> dict[str, Any]:
        return {"dtype": dtype, "shape": [1], "names": None}

    state = state_names(facts)
    features = {STATE: vector("float32", state)}
    if facts.objects:
        features[ENVIRONMENT] = vector("float32", environment_names(facts))
    features[SEEN] = vector("bool", seen_names(facts))
    features[ACTION] = vector("float32", state)
    features[DONE] = number("bool")
    if has_success:
        features[SUCCESS] = number("bool")
    if has_subtasks:
        features[SUBTASK] = number("int64")
        if len(facts.hands) > 1:
            features |= {hand_subtask(hand): number("int64") for hand in facts.hands}
        if params.has_language:
            features[LANGUAGE] = number("language")
    features["timestamp"] = number("float32")
    features |= {name: number("int64") for name in ("frame_index", "episode_index", "index", "task_index")}
    return features


def data_schema(features: dict[str, dict[str, Any]]) -> pa.Schema:
    """The Arrow schema of data files: a feature of shape (1,) is a plain column."""
    fields = []
    for name, feature in features.items():
        width = feature["shape"][0]
        if feature["dtype"] == "language":
            fields.append(pa.field(name, language_type()))
        elif width == 1:
            fields.append(pa.field(name, _ARROW[feature["dtype"]]))
        else:
            fields.append(pa.field(name, pa.list_(_ARROW[feature["dtype"]], width)))
    return pa.schema(fields)


def language_type() -> pa.DataType:
    """A list of what was said or done from some time on, as LeRobot declares ``language_persistent``."""
    return pa.list_(
        pa.struct(
            [
                pa.field("role", pa.string(), nullable=False),
                pa.field("content", pa.string()),
                pa.field("style", pa.string()),
                pa.field("timestamp", pa.float32(), nullable=False),
                pa.field("camera", pa.string()),
                pa.field("tool_calls", pa.list_(pa.json_())),
            ]
        )
    )


def named_rows(texts: list[str] | tuple[str, ...], name: str) -> pa.Table:
    """A table whose rows are found by their text, as pandas reads it: the text is its index."""
    number = f"{name}_index"
    columns = [
        {
            "name": number,
            "field_name": number,
            "pandas_type": "int64",
            "numpy_type": "int64",
            "metadata": None,
        },
        {
            "name": name,
            "field_name": name,
            "pandas_type": "unicode",
            "numpy_type": "object",
            "metadata": None,
        },
    ]
    about = {"index_columns": [name], "column_indexes": [], "columns": columns, "pandas_version": "2.2.0"}
    table = pa.table({number: pa.array(range(len(texts)), pa.int64()), name: pa.array(texts, pa.string())})
    return table.replace_schema_metadata({"pandas": json.dumps(about, sort_keys=True)})
