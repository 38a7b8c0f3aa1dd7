"""Operators of thousands of episodes: counted in buckets, so that a change costs what its bucket costs.

An episode belongs to a bucket by the hash of its id. What a bucket shows is kept in the store under the hash
of its members' transitions, so that adding, changing or forgetting an episode counts one bucket anew; the
others are only added up. The sums are those of a full recount, to the last bit: they are counts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TypeAlias

import dataframely as dy
import polars as pl

from demoplan.ids import content_hash
from demoplan.language.vocabulary import Vocabulary
from demoplan.pipeline.episodes.activities import tables_of
from demoplan.stages.learn import Learned, LearnParams, learn
from demoplan.stages.learn.counting import (
    grip_votes,
    learn_from_sightings,
    needs_mending,
    ranks,
    sight,
    support_votes,
)
from demoplan.store import EpisodeState, Record, Store
from demoplan.store.code_version import code_version
from demoplan.store.store import StageOutput, canonical_json
from demoplan.tables import Findings, Patterns, Sightings, Transitions, Votes

MANY = 256
"""Of fewer episodes, operators are learned from all transitions at once."""
IN_BUCKET = 64
"""Episodes of a bucket, about: half as many again or less. It is what one change makes be counted anew."""
SAMPLE = 256
"""Episodes that tell how good readings are; those whose ids have the smallest hashes, so that few change."""

_MODULES = ("demoplan.stages.learn.counting",)
_IS_MENDED = "is_mended"

_Ranks: TypeAlias = Mapping[tuple[str, int, int], int]


@dataclass(frozen=True, kw_only=True)
class Counted:
    """What the buckets show, all together."""

    sightings: pl.DataFrame
    patterns: pl.DataFrame


def learn_many(
    store: Store, states: Sequence[EpisodeState], vocabulary: Vocabulary, params: LearnParams = LearnParams()
) -> Learned:
    """Operators of many episodes, from counts that are kept.

    Where a sample shows that readings are wrong so often that they have to be mended, which looks at all of
    them together, nothing is counted apart: all transitions are learned from at once.

    Args:
        store: Where transitions are, and counts are kept.
        states: The episodes; all have transitions.
        vocabulary: Types and predicates.
        params: Learning choices.
    """
    counting = _Counting(store, vocabulary, params)
    survey = counting.survey(sorted(states, key=lambda state: content_hash(state.episode_id))[:SAMPLE])
    if survey.notes[_IS_MENDED] == "true":
        transitions = _joined(store, states)
        return learn(transitions, vocabulary.types, counting.predicates, params)
    found = counting.count(buckets_of(states))
    learned = learn_from_sightings(
        found.sightings, found.patterns, vocabulary.types, counting.predicates, params
    )
    return learned._replace(findings=store.get(survey.outputs["findings"], Findings))


def buckets_of(states: Sequence[EpisodeState]) -> list[list[EpisodeState]]:
    """Episodes in buckets by the hash of their ids; in order, empty ones left out.

    There are a power of two of them, so that they part anew only when episodes have doubled.
    """
    n_buckets = 1
    while n_buckets * IN_BUCKET < len(states):
        n_buckets *= 2
    buckets: dict[int, list[EpisodeState]] = {}
    for state in sorted(states, key=lambda each: (each.dataset, each.episode_id)):
        number = int(content_hash(state.dataset, state.episode_id)[:8], 16) % n_buckets
        buckets.setdefault(number, []).append(state)
    return [members for _, members in sorted(buckets.items())]


class _Counting:
    """The stages of counting, over a store."""

    def __init__(self, store: Store, vocabulary: Vocabulary, params: LearnParams) -> None:
        self.predicates = [rule.signature for rule in vocabulary.predicates]
        self._store, self._types, self._params = store, vocabulary.types, params
        settings = {
            "params": asdict(params),
            "types": vocabulary.types.parents,
            "predicates": [asdict(signature) for signature in self.predicates],
        }
        self._settings = canonical_json(settings)
        self._version = code_version(*_MODULES)

    def survey(self, sample: Sequence[EpisodeState]) -> Record:
        """What a sample of episodes tells of the readings, and what is found on the way."""

        def work() -> StageOutput:
            transitions = _joined(self._store, sample)
            is_mended = needs_mending(transitions, self._types, self.predicates, self._params)
            findings = learn(transitions, self._types, self.predicates, self._params).findings
            return StageOutput(
                tables={"findings": (findings, Findings)}, notes={_IS_MENDED: str(is_mended).lower()}
            )

        return self._store.run("survey", _inputs(sample), self._settings, self._version, work)

    def count(self, buckets: Sequence[Sequence[EpisodeState]]) -> Counted:
        """Count what was not counted before; give back all of it."""
        store = self._store
        with store.together():
            gathered = [self._gather(members) for members in buckets]
        grip = ranks([store.get(record.outputs["votes"], Votes) for record in gathered])
        with store.together():
            supported = [self._support(record.outputs["transitions"], grip) for record in gathered]
        support = ranks([store.get(record.outputs["votes"], Votes) for record in supported])
        with store.together():
            sighted = [self._sight(record.outputs["transitions"], grip, support) for record in gathered]
        return Counted(
            sightings=pl.concat([store.get(record.outputs["sightings"], Sightings) for record in sighted]),
            patterns=pl.concat([store.get(record.outputs["patterns"], Patterns) for record in sighted]),
        )

    def _gather(self, members: Sequence[EpisodeState]) -> Record:
        def work() -> StageOutput:
            transitions = _joined(self._store, members)
            votes = grip_votes(transitions, self._types, self.predicates, self._params)
            return StageOutput(tables={"transitions": (transitions, Transitions), "votes": (votes, Votes)})

        return self._store.run("gather", _inputs(members), self._settings, self._version, work)

    def _support(self, content: str, grip: _Ranks) -> Record:
        def work() -> StageOutput:
            transitions = self._store.get(content, Transitions)
            votes = support_votes(transitions, self._types, self.predicates, grip, self._params)
            return StageOutput(tables={"votes": (votes, Votes)})

        inputs = {"transitions": content, "grip": _hash(grip)}
        return self._store.run("support", inputs, self._settings, self._version, work)

    def _sight(self, content: str, grip: _Ranks, support: _Ranks) -> Record:
        def work() -> StageOutput:
            transitions = self._store.get(content, Transitions)
            found = sight(transitions, self._types, self.predicates, grip, support, self._params)
            return StageOutput(
                tables={"sightings": (found.sightings, Sightings), "patterns": (found.patterns, Patterns)}
            )

        inputs = {"transitions": content, "grip": _hash(grip), "support": _hash(support)}
        return self._store.run("sight", inputs, self._settings, self._version, work)


def _joined(store: Store, states: Sequence[EpisodeState]) -> dy.DataFrame[Transitions]:
    return tables_of(store, states, "transitions", Transitions)


def _inputs(states: Sequence[EpisodeState]) -> dict[str, str]:
    return {"transitions": content_hash(*(f"{s.episode_id}={s.tables['transitions']}" for s in states))}


def _hash(votes: _Ranks) -> str:
    return content_hash(canonical_json(sorted([*key, rank] for key, rank in votes.items())))
