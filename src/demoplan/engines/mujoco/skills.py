"""From steps of a plan to motions: a table that says which skill an activity is, and who plays which part."""

import re
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Literal as OneOf
from typing import TypeAlias

from pydantic import BaseModel, ConfigDict, field_validator

from demoplan.engines.mujoco.session import Motion
from demoplan.errors import UnknownNameError, UsageError
from demoplan.language.atoms import Atom
from demoplan.language.domains import Domain, Operator, Step
from demoplan.manifests.loading import load_yaml, read_text

SkillName: TypeAlias = OneOf["reach", "grasp", "carry", "lift", "release", "rest"]
Part: TypeAlias = OneOf["object", "support"]

_PATTERN = re.compile(r"(adds|deletes|needs|lacks)\s+(.+)")
_ANY = "_"


class SkillCase(BaseModel):
    """One way to carry out an activity."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    skill: SkillName
    parts: dict[Part, tuple[str, ...]] = {}
    """Patterns that find each part, the first that matches counts."""
    numbers: dict[str, float] = {}
    """Numbers that differ from the defaults of skills, by name."""

    @field_validator("parts")
    @classmethod
    def _are_patterns(cls, parts: dict[Part, tuple[str, ...]]) -> dict[Part, tuple[str, ...]]:
        for patterns in parts.values():
            for pattern in patterns:
                if _PATTERN.fullmatch(pattern) is None:
                    raise ValueError(f"not a pattern: {pattern!r}; as in 'adds onTop(object, support)'")
        return parts


class SkillTable(BaseModel):
    """Activities and how they are carried out."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    hand_type: str = "Hand"
    activities: dict[str, tuple[SkillCase, ...]]

    @cached_property
    def skills(self) -> frozenset[str]:
        """Every skill that is named."""
        return frozenset(case.skill for cases in self.activities.values() for case in cases)


def read_skills(path: Path | None = None) -> SkillTable:
    """The table of a YAML file; without one, the table that comes with demoplan.

    Raises:
        ManifestError: If the file breaks the contract; with the line.
        UsageError: If it cannot be read.
    """
    if path is not None:
        return load_yaml(read_text(path), path, SkillTable)
    own = files("demoplan.engines.mujoco") / "skills.yaml"
    return load_yaml(own.read_text(encoding="utf-8"), str(own), SkillTable)


def motion_of(step: Step, domain: Domain, table: SkillTable) -> tuple[str, Motion]:
    """Which hand makes which motion to carry out a step of a plan.

    Args:
        step: A ground operator.
        domain: Where its operator stands.
        table: Which skill an activity is.

    Raises:
        UnknownNameError: If there is no such operator, or its activity is not in the table.
        UsageError: If the operator has no hand, or nothing in it plays a part that every case of its
            activity needs.
    """
    operators = {operator.name: operator for operator in domain.operators}
    if step.operator not in operators:
        raise UnknownNameError("operator", step.operator, operators, f"domain {domain.name!r}")
    operator = operators[step.operator]
    if operator.activity not in table.activities:
        raise UnknownNameError(
            "skill for activity", operator.activity, table.activities, f"skills table {table.name!r}"
        )
    hand = _hand_of(operator, domain, table)
    named = {each.variable: name for each, name in zip(operator.parameters, step.arguments, strict=True)}
    missing: list[str] = []
    for case in table.activities[operator.activity]:
        bound = {"hand": hand}
        for part, patterns in case.parts.items():
            found = next(filter(None, (_find(part, each, operator, bound) for each in patterns)), None)
            if found is None:
                missing.append(f"{case.skill!r} lacks its {part}")
                break
            bound[part] = found
        else:
            return named[hand], Motion(
                activity=operator.activity,
                skill=case.skill,
                object=_name(bound.get("object"), named),
                support=_name(bound.get("support"), named),
                parameters=tuple(sorted(case.numbers.items())),
            )
    raise UsageError(
        f"operator {operator.name!r} cannot be carried out as {operator.activity!r}: {'; '.join(missing)}"
    )


def _name(term: str | None, named: dict[str, str]) -> str | None:
    """The instance that a term stands for: a parameter's, or a constant itself."""
    return None if term is None else named.get(term, term)


def _hand_of(operator: Operator, domain: Domain, table: SkillTable) -> str:
    for parameter in operator.parameters:
        if domain.types.is_subtype(parameter.type_name, table.hand_type):
            return parameter.variable
    raise UsageError(f"operator {operator.name!r} has no parameter of type {table.hand_type!r}")


def _find(part: str, pattern: str, operator: Operator, bound: dict[str, str]) -> str | None:
    """The term that plays a part, by one pattern; the first in order of the operator's literals."""
    match = _PATTERN.fullmatch(pattern)
    assert match is not None
    kind, wanted = match[1], Atom.parse(match[2])
    literals = operator.effects if kind in ("adds", "deletes") else operator.preconditions
    is_positive = kind in ("adds", "needs")
    for literal in sorted(literals):
        atom = literal.atom
        if literal.is_positive != is_positive or atom.predicate != wanted.predicate:
            continue
        if len(atom.arguments) != len(wanted.arguments):
            continue
        found: str | None = None
        for term, role in zip(atom.arguments, wanted.arguments, strict=True):
            if role == _ANY:
                continue
            if role == part:
                # What one part is, another is not: nothing is put on itself or on the hand.
                if term in bound.values():
                    break
                found = term
            elif bound.get(role) != term:
                break
        else:
            if found is not None:
                return found
    return None
