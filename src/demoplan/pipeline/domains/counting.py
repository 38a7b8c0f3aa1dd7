"""Operators of thousands of episodes: counted in buckets, so that a change costs what its bucket costs.

An episode belongs to a bucket by the hash of its id. What a bucket shows is kept in the store under the hash
of its members' transitions, so that adding, changing or forgetting an episode counts one bucket anew; the
others are only added up. The sums are those of a full recount, to the last bit: they are counts.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial

import dataframely as dy
import polars as pl

from demoplan.errors import DemoplanError
from demoplan.ids import content_hash
from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.language.vocabulary import Vocabulary
from demoplan.pipeline.crews import Crew, Processes
from demoplan.stages.learn import Learned, LearnParams, learn
from demoplan.stages.learn.counting import (
    grip_votes,
    learn_from_sightings,
    needs_mending,
    ranks,
    sight,
    support_votes,
)
from demoplan.stages.learn.settle import Votes as Ranks
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

MANY_BUCKETS = 24
"""From so many on they are counted by a crew: starting its processes costs what some ten buckets cost."""
IN_ORDER = 4
"""Buckets that one worker takes at once."""

_MODULES = ("demoplan.stages.learn.counting",)
_IS_MENDED = "is_mended"


@dataclass(frozen=True, kw_only=True)
class Counted:
    """What the buckets show, all together."""

    sightings: pl.DataFrame
    patterns: pl.DataFrame


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What transitions are counted with, and learned from."""

    types: TypeHierarchy
    predicates: tuple[Signature, ...]
    params: LearnParams

    @classmethod
    def of(cls, vocabulary: Vocabulary, params: LearnParams) -> "Recipe":
        """What is learned in a vocabulary's words."""
        predicates = tuple(rule.signature for rule in vocabulary.predicates)
        return cls(types=vocabulary.types, predicates=predicates, params=params)

    @cached_property
    def settings(self) -> str:
        """All of it, as canonical JSON."""
        values = {
            "params": asdict(self.params),
            "types": self.types.parents,
            "predicates": [asdict(signature) for signature in self.predicates],
        }
        return canonical_json(values)


@dataclass(frozen=True, kw_only=True)
class Bucket:
    """The transitions of some episodes, by hash."""

    key: str
    """Names them, in records."""
    contents: tuple[str, ...]
    """The tables that hold them, in order of episode."""

    @classmethod
    def of(cls, states: Sequence[EpisodeState]) -> "Bucket":
        """The transitions of some episodes as they were written."""
        contents = tuple(state.tables["transitions"] for state in states)
        named = (f"{s.episode_id}={content}" for s, content in zip(states, contents, strict=True))
        return cls(key=content_hash(*named), contents=contents)

    def transitions(self, store: Store) -> dy.DataFrame[Transitions]:
        """The transitions, in one table."""
        return Transitions.cast(store.joined(self.contents, Transitions))


def learn_many(
    store: Store,
    states: Sequence[EpisodeState],
    vocabulary: Vocabulary,
    params: LearnParams = LearnParams(),
    *,
    crew: Crew = Processes(1),
) -> Learned:
    """Operators of many episodes, from counts that are kept.

    Where a sample shows that readings are wrong so often that they have to be mended, which looks at all of
    them together, nothing is counted apart: all transitions are learned from at once.

    Args:
        store: Where transitions are, and counts are kept.
        states: The episodes; all have transitions.
        vocabulary: Types and predicates.
        params: Learning choices.
        crew: Who counts, if it is many buckets.

    Raises:
        DemoplanError: If whoever counted some buckets died, again and again.
    """
    recipe = Recipe.of(vocabulary, params)
    sample = sorted(states, key=lambda state: content_hash(state.episode_id))[:SAMPLE]
    survey = _survey(store, recipe, Bucket.of(sample))
    if survey.notes[_IS_MENDED] == "true":
        transitions = Bucket.of(states).transitions(store)
        return learn(transitions, recipe.types, recipe.predicates, params)
    found = count_buckets(store, recipe, [Bucket.of(members) for members in buckets_of(states)], crew)
    learned = learn_from_sightings(found.sightings, found.patterns, recipe.types, recipe.predicates, params)
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


def _survey(store: Store, recipe: Recipe, sample: Bucket) -> Record:
    """What a sample of episodes tells of the readings, and what is found on the way."""

    def work() -> StageOutput:
        call = sample.transitions(store), recipe.types, recipe.predicates, recipe.params
        return StageOutput(
            tables={"findings": (learn(*call).findings, Findings)},
            notes={_IS_MENDED: str(needs_mending(*call)).lower()},
        )

    return store.run("survey", {"transitions": sample.key}, recipe.settings, code_version(*_MODULES), work)


def count_buckets(
    store: Store, recipe: Recipe, buckets: Sequence[Bucket], crew: Crew = Processes(1)
) -> Counted:
    """Count what was not counted before; give back all of it.

    Raises:
        DemoplanError: If whoever counted some buckets died, again and again.
    """

    def taken(stage: str, parts: Sequence[Bucket], *found: Ranks) -> list[Record]:
        return _taken(store, Step(store=store.location, recipe=recipe, stage=stage, ranks=found), parts, crew)

    gathered = taken("gather", buckets)
    joined = [Bucket(key=content, contents=(content,)) for content in _outputs(gathered, "transitions")]
    grip = ranks([store.joined(_outputs(gathered, "votes"), Votes)])
    supported = taken("support", joined, grip)
    support = ranks([store.joined(_outputs(supported, "votes"), Votes)])
    sighted = taken("sight", joined, grip, support)
    return Counted(
        sightings=store.joined(_outputs(sighted, "sightings"), Sightings),
        patterns=store.joined(_outputs(sighted, "patterns"), Patterns),
    )


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of counting, for a worker to take with some buckets: only hashes and ranks cross."""

    store: str
    recipe: Recipe
    stage: str
    ranks: tuple[Ranks, ...]
    """What the steps before found of all buckets: how votes on grips, then on supports, rank activities."""

    def call(self, bucket: Bucket) -> tuple[str, dict[str, str], str, str]:
        """What the step's record for a bucket is found by: stage, inputs, parameters, code."""
        votes = {name: _hash(each) for name, each in zip(("grip", "support"), self.ranks, strict=False)}
        inputs = {"transitions": bucket.key} | votes
        return self.stage, inputs, self.recipe.settings, code_version(*_MODULES)

    def __call__(self, buckets: Sequence[Bucket]) -> list[Record]:
        """Take the step with some buckets."""
        store = Store(self.store)
        with store.together():
            return [store.run(*self.call(bucket), partial(self._output, store, bucket)) for bucket in buckets]

    def _output(self, store: Store, bucket: Bucket) -> StageOutput:
        transitions = bucket.transitions(store)
        call, params = (transitions, self.recipe.types, self.recipe.predicates), self.recipe.params
        tables: dict[str, tuple[pl.DataFrame, type[dy.Schema]]]
        if self.stage == "gather":
            votes = grip_votes(*call, params)
            tables = {"transitions": (transitions, Transitions), "votes": (votes, Votes)}
        elif self.stage == "support":
            tables = {"votes": (support_votes(*call, self.ranks[0], params), Votes)}
        else:
            found = sight(*call, self.ranks[0], self.ranks[1], params)
            tables = {"sightings": (found.sightings, Sightings), "patterns": (found.patterns, Patterns)}
        return StageOutput(tables=tables)


def _taken(store: Store, step: Step, buckets: Sequence[Bucket], crew: Crew) -> list[Record]:
    """The records of a step for all buckets; it is taken with those that have none."""
    found = {bucket.key: store.find(*step.call(bucket)) for bucket in buckets}
    lacking = [bucket for bucket in buckets if found[bucket.key] is None]
    if len(lacking) < MANY_BUCKETS:
        crew = Processes(1)
    orders = [lacking[start : start + IN_ORDER] for start in range(0, len(lacking), IN_ORDER)]
    for order, records in crew(step, orders):
        if records is None:
            raise DemoplanError(
                f"{step.stage}: every process that counted {len(order)} buckets of about {IN_BUCKET} "
                "episodes died (out of memory?); with fewer workers, each has more"
            )
        found.update(zip((bucket.key for bucket in order), records, strict=True))
    return [record for bucket in buckets if (record := found[bucket.key]) is not None]


def _outputs(records: Sequence[Record], name: str) -> list[str]:
    return [record.outputs[name] for record in records]


def _hash(votes: Ranks) -> str:
    return content_hash(canonical_json(sorted([*key, rank] for key, rank in votes.items())))
