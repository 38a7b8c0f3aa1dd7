"""Transitions to domain versions, over the store."""

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import dataframely as dy
import polars as pl

from demoplan.errors import UsageError
from demoplan.language.diff import Change, diff
from demoplan.language.domains import Domain
from demoplan.language.invariants import ExclusiveGroup, parse_group
from demoplan.language.pddl import domain_id, parse_domain, render_domain
from demoplan.language.vocabulary import Vocabulary
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.domains.counting import MANY, Bucket, Recipe, learn_many
from demoplan.pipeline.episodes.episode_tables import tables_of
from demoplan.stages.compose import compose, support_of
from demoplan.stages.learn import LearnParams, Retyping, learn, learn_splitting_types
from demoplan.store import DomainVersion, EpisodeState, Store
from demoplan.store.code_version import code_version
from demoplan.store.store import StageOutput, canonical_json
from demoplan.tables import Evidence, Findings, Literals, Operators, Transitions

_SPLITS = "split_types"
_GROUP = re.compile(r"(.+) for # (.+)")


@dataclass(frozen=True, kw_only=True)
class Learned:
    """A domain version with all that belongs to it."""

    version: DomainVersion
    domain: Domain
    text: str
    operators: dy.DataFrame[Operators]
    literals: dy.DataFrame[Literals]
    evidence: dy.DataFrame[Evidence]
    findings: dy.DataFrame[Findings]
    """What was found on the way; empty for versions that were stored without."""


def learn_domain(
    store: Store,
    states: Sequence[EpisodeState],
    vocabulary: Vocabulary,
    *,
    name: str,
    dataset: str,
    params: LearnParams = LearnParams(),
    crew: Crew = Processes(1),
) -> Learned:
    """Learn operators from the transitions of some episodes, and add the domain as a version.

    Thousands of episodes are counted by the crew.

    Raises:
        UsageError: If none of the episodes has transitions.
    """
    chosen = sorted((s for s in states if "transitions" in s.tables), key=lambda s: s.episode_id)
    if not chosen:
        raise UsageError(f"{name}: none of {len(states)} episodes has activities to learn from")
    predicates = [rule.signature for rule in vocabulary.predicates]
    call = learn_call(chosen, vocabulary, params)

    def work() -> StageOutput:
        notes = {}
        if params.splits_types:
            transitions = tables_of(store, chosen, "transitions", Transitions)
            learned, retyping = learn_splitting_types(transitions, vocabulary.types, predicates, params)
            notes[_SPLITS] = canonical_json(retyping.splits)
        elif len(chosen) > MANY:
            learned = learn_many(store, chosen, vocabulary, params, crew=crew)
        else:
            transitions = tables_of(store, chosen, "transitions", Transitions)
            learned = learn(transitions, vocabulary.types, predicates, params)
        schemas = (Operators, Literals, Evidence, Findings)
        return StageOutput(
            tables=dict(zip(learned._fields, zip(learned, schemas, strict=True), strict=True)), notes=notes
        )

    record = store.run("learn", *call, work)
    operators = store.get(record.outputs["operators"], Operators)
    literals = store.get(record.outputs["literals"], Literals)
    evidence = store.get(record.outputs["evidence"], Evidence)
    findings = store.get(record.outputs["findings"], Findings)
    retyping = Retyping.of(vocabulary.types, predicates, json.loads(record.notes.get(_SPLITS, "[]")))
    domain = retyping.domain(compose(operators, literals, retyping.types, retyping.predicates, name))
    text = render_domain(domain)
    version = store.domains.put(
        DomainVersion(
            domain_id=domain_id(domain),
            name=name,
            parent=None,
            dataset=dataset,
            episodes=[state.episode_id for state in chosen],
            snapshot=call[0]["transitions"],
            params=canonical_json(asdict(params)),
            code_version=call[2],
            n_operators=len(domain.operators),
            tables={},
        ),
        text,
        operators,
        literals,
        evidence,
        findings,
    )
    return Learned(
        version=version,
        domain=domain,
        text=text,
        operators=operators,
        literals=literals,
        evidence=evidence,
        findings=findings,
    )


def learn_call(
    states: Sequence[EpisodeState], vocabulary: Vocabulary, params: LearnParams = LearnParams()
) -> tuple[dict[str, str], str, str]:
    """Inputs, parameters and code version that name what learning from these episodes gives."""
    ordered = sorted(states, key=lambda state: state.episode_id)
    return (
        {"transitions": Bucket.of(ordered).key},
        Recipe.of(vocabulary, params).settings,
        code_version("demoplan.stages.learn.counting", "demoplan.stages.compose"),
    )


def params_of(version: DomainVersion | None) -> LearnParams:
    """Parameters that the next version of a domain is learned with: what was chosen for it stays chosen."""
    chosen = json.loads(version.params) if version is not None and version.params else {}
    return LearnParams(splits_types=bool(chosen.get("splits_types", False)))


def stored_domain(store: Store, asked: str) -> Learned:
    """A domain version by id, start of an id, or name."""
    version = store.domains.find(asked)
    text = store.domains.text(version)
    operators, literals, evidence = store.domains.tables(version)
    return Learned(
        version=version,
        domain=parse_domain(text),
        text=text,
        operators=operators,
        literals=literals,
        evidence=evidence,
        findings=store.domains.findings(version),
    )


def latest_evidence(store: Store, name: str) -> dy.DataFrame[Evidence] | None:
    """Which operator each activity matched, by the latest version of a domain; none if there is none."""
    version = store.domains.latest(name)
    return None if version is None else store.domains.tables(version)[2]


def changes_between(old: Learned, new: Learned) -> tuple[Change, ...]:
    """What changed from one version to another: operators, literals, and the counts behind them."""
    return diff(old.domain, new.domain, support_of(old.literals), support_of(new.literals))


def exclusive_groups_of(learned: Learned) -> tuple[tuple[ExclusiveGroup, str], ...]:
    """The groups that demonstrations showed, each with the type of object that it holds for."""
    found = []
    for subject in learned.findings.filter(pl.col("kind") == "exclusion")["subject"]:
        match = _GROUP.fullmatch(subject)
        if match is not None:
            found.append((parse_group(match[1]), match[2]))
    return tuple(found)
