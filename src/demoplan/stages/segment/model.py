"""A trained segmenter as a value, and its text form."""

import json
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from demoplan.errors import DataError
from demoplan.geometry import Array
from demoplan.ids import ContentHash, content_hash
from demoplan.stages.segment.carrying import CarryParams
from demoplan.stages.segment.decoding import Grammar
from demoplan.stages.segment.features import FeatureParams
from demoplan.stages.segment.trees import Trees, from_plain, to_plain

FORMAT = "demoplan-segmenter-1"


@dataclass(frozen=True, kw_only=True, eq=False)
class Segmenter:
    """A tree, or an ensemble of trees, with all that is needed to use it and to know where it comes from."""

    method: str
    """``decision_tree``, ``distilled_tree``, ``random_forest``, ``extra_trees`` or ``gradient_boosting``."""
    activities: tuple[str, ...]
    """Classes, sorted."""
    feature_names: tuple[str, ...]
    feature_params: FeatureParams
    trees: Trees
    grammar: Grammar
    training_hash: ContentHash
    """Hash of the frames, facts and labels that it was fitted to."""
    training_episodes: tuple[str, ...]
    options: tuple[tuple[str, str], ...]
    """Options of the fit, sorted by name, as text."""
    versions: tuple[tuple[str, str], ...]
    """Versions of what fitted it, sorted by name."""

    @cached_property
    def features_used(self) -> frozenset[str]:
        """Features that some tree asks about; the others need not be computed."""
        return frozenset(self.feature_names[index] for index in np.unique(self.trees.feature) if index >= 0)

    @property
    def segmenter_id(self) -> str:
        """First 16 hex digits of the hash of the text form."""
        return content_hash(render_segmenter(self))[:16]


def render_segmenter(segmenter: Segmenter) -> str:
    """A segmenter as JSON text; the same segmenter always gives the same text."""
    plain = {
        "format": FORMAT,
        "method": segmenter.method,
        "activities": list(segmenter.activities),
        "feature_names": list(segmenter.feature_names),
        "feature_params": asdict(segmenter.feature_params),
        "training_hash": segmenter.training_hash,
        "training_episodes": list(segmenter.training_episodes),
        "options": dict(segmenter.options),
        "versions": dict(segmenter.versions),
        "grammar": {
            "initial": segmenter.grammar.initial.tolist(),
            "change": segmenter.grammar.change.tolist(),
            "leave_per_s": segmenter.grammar.leave_per_s.tolist(),
        },
        "trees": to_plain(segmenter.trees),
    }
    lines = [f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in plain.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def parse_segmenter(text: str) -> Segmenter:
    """The segmenter that a text holds, fully checked: a file cannot run code, nor make evaluation fail.

    Raises:
        DataError: If the text is not a segmenter, or its parts do not fit together.
    """
    try:
        plain = json.loads(text)
    except ValueError as error:
        raise DataError(f"segmenter: not JSON: {error}") from None
    if not isinstance(plain, dict) or plain.get("format") != FORMAT:
        found = plain.get("format") if isinstance(plain, dict) else type(plain).__name__
        raise DataError(f"segmenter: format is {found!r}; this version reads {FORMAT!r}")
    try:
        activities = _names(plain["activities"], "activities")
        feature_names = _names(plain["feature_names"], "feature_names")
        grammar = Grammar(
            initial=_array(plain["grammar"]["initial"], (len(activities),), "grammar.initial"),
            change=_array(plain["grammar"]["change"], (len(activities),) * 2, "grammar.change"),
            leave_per_s=_array(plain["grammar"]["leave_per_s"], (len(activities),), "grammar.leave_per_s"),
        )
        if not (grammar.leave_per_s > 0).all():
            raise DataError("segmenter: grammar.leave_per_s must be positive")
        return Segmenter(
            method=str(plain["method"]),
            activities=activities,
            feature_names=feature_names,
            feature_params=_feature_params(plain["feature_params"]),
            trees=from_plain(plain["trees"], len(feature_names), len(activities)),
            grammar=grammar,
            training_hash=ContentHash(str(plain["training_hash"])),
            training_episodes=_names(plain["training_episodes"], "training_episodes"),
            options=tuple(sorted((str(k), str(v)) for k, v in plain["options"].items())),
            versions=tuple(sorted((str(k), str(v)) for k, v in plain["versions"].items())),
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise DataError(f"segmenter: a part is missing or of the wrong kind: {error}") from None


def _names(values: Any, what: str) -> tuple[str, ...]:
    if not isinstance(values, list) or not values or not all(isinstance(value, str) for value in values):
        raise DataError(f"segmenter: {what} must be a list of names, not {type(values).__name__}")
    if len(set(values)) != len(values):
        raise DataError(f"segmenter: {what} repeats a name")
    return tuple(values)


def _array(values: Any, shape: tuple[int, ...], what: str) -> Array:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise DataError(f"segmenter: {what} is not made of numbers: {error}") from None
    if array.shape != shape or not np.isfinite(array).all():
        raise DataError(f"segmenter: {what} must be finite and of shape {shape}, not {array.shape}")
    return array


def _feature_params(plain: Any) -> FeatureParams:
    carrying = _numbers(plain["carrying"], CarryParams, "feature_params.carrying")
    rest = {name: value for name, value in plain.items() if name != "carrying"}
    return FeatureParams(
        **_numbers(rest, FeatureParams, "feature_params", besides="carrying"),
        carrying=CarryParams(**carrying),
    )


def _numbers(plain: Any, of: type, what: str, besides: str = "") -> dict[str, Any]:
    """Positive numbers, or tuples of them, for exactly the fields of a dataclass."""
    known = {field.name for field in fields(of)} - {besides}
    if not isinstance(plain, dict) or set(plain) != known:
        raise DataError(f"segmenter: {what} must have exactly {sorted(known)}")
    numbers = {
        name: tuple(float(v) for v in value) if isinstance(value, list) else float(value)
        for name, value in plain.items()
    }
    for name, value in numbers.items():
        if not (np.all(np.isfinite(value)) and np.all(np.asarray(value) > 0)):
            raise DataError(f"segmenter: {what}.{name} must be finite and positive, not {value}")
    return numbers
