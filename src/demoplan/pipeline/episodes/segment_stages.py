"""The stages from facts to transitions of one episode, and whether what they gave still stands."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import dataframely as dy
import polars as pl

from demoplan.language.types import TypeHierarchy
from demoplan.pipeline.episodes.episode_tables import EpisodeTables
from demoplan.stages.contrast import ContrastParams, contrast
from demoplan.stages.segment import RuleTree, Segmenter, SegmentParams, segment
from demoplan.store import EpisodeState, stage_key
from demoplan.store.code_version import code_version
from demoplan.store.index import Index
from demoplan.store.store import canonical_json
from demoplan.tables import Activities, Facts, Frames, Transitions

CONTRAST = ContrastParams()
"""How activities are contrasted; part of what makes transitions stale."""

MODULES = {"segment": "demoplan.stages.segment", "contrast": "demoplan.stages.contrast"}
"""What each of these stages is made of, as far as it makes output stale."""

OUTPUT = {"segment": "activities", "contrast": "transitions"}


@dataclass(frozen=True, kw_only=True)
class ChosenSegmenter:
    """A segmenter, with what names it in keys and reports."""

    segmenter: Segmenter | RuleTree
    method: str
    content: str
    """Hash of what it is."""
    source: str
    """Where another process finds it: the name of a rule tree, an absolute path, or a name in the store."""


@dataclass(frozen=True, kw_only=True)
class SegmentRecipe:
    """What the stages from facts to transitions take besides an episode and its segmenter."""

    entities: Mapping[str, str]
    """Instance → type."""
    types: TypeHierarchy
    params: SegmentParams = SegmentParams()

    @cached_property
    def segment_text(self) -> str:
        """Parameters of ``segment``, as canonical JSON."""
        return canonical_json(
            {"params": asdict(self.params), "entities": self.entities, "types": self.types.parents}
        )

    @cached_property
    def contrast_text(self) -> str:
        """Parameters of ``contrast``, as canonical JSON."""
        return canonical_json({"params": asdict(CONTRAST), "entities": self.entities})

    def standing(self, state: EpisodeState, chosen: ChosenSegmenter, index: Index) -> EpisodeState | None:
        """An episode with the activities and transitions that would be made now, if they are there.

        Where the manifest names them already, no record is read.
        """
        for stage, inputs_of, params in (
            ("segment", lambda tables: _segment_inputs(tables, chosen), self.segment_text),
            ("contrast", _contrast_inputs, self.contrast_text),
        ):
            key = stage_key(stage, inputs_of(state.tables), params, code_version(MODULES[stage]))
            content = state.tables.get(OUTPUT[stage])
            if state.keys.get(stage) == key and content is not None:
                if not (index.has_record(stage, key) and index.has(content)):
                    return None
                continue
            record = index.find(stage, key)
            if record is None:
                return None
            state = replace(state, tables=state.tables | record.outputs, keys=state.keys | {stage: key})
        return state


def _segment_inputs(tables: Mapping[str, str], chosen: ChosenSegmenter) -> dict[str, str]:
    return {"frames": tables["frames"], "facts": tables["facts"], "segmenter": chosen.content}


def _contrast_inputs(tables: Mapping[str, str]) -> dict[str, str]:
    return {"activities": tables["activities"], "facts": tables["facts"]}


def segment_stage(
    state: EpisodeState, chosen: ChosenSegmenter, tables: EpisodeTables, recipe: SegmentRecipe
) -> None:
    """Find the activities of an episode if they are not there."""
    tables.contents |= state.tables
    tables.run(
        "segment",
        modules=[MODULES["segment"]],
        inputs=_segment_inputs(state.tables, chosen),
        params=recipe.segment_text,
        make=lambda: {
            "activities": (
                segment(
                    tables.get("frames", Frames),
                    tables.get("facts", Facts),
                    recipe.entities,
                    recipe.types,
                    chosen.segmenter,
                    params=recipe.params,
                ),
                Activities,
            )
        },
    )


def contrast_stage(
    tables: EpisodeTables, recipe: SegmentRecipe, contrasted: "Contrasted | None" = None
) -> None:
    """Find the transitions of an episode if they are not there."""
    tables.run(
        "contrast",
        modules=[MODULES["contrast"]],
        inputs=_contrast_inputs(tables.contents),
        params=recipe.contrast_text,
        make=lambda: {"transitions": ((contrasted or Contrasted(recipe, [tables])).of(tables), Transitions)},
    )


def is_contrasted(tables: EpisodeTables, recipe: SegmentRecipe) -> bool:
    """Whether an episode's transitions are there."""
    inputs = _contrast_inputs(tables.contents)
    return tables.store.is_current(
        "contrast", inputs, recipe.contrast_text, code_version(MODULES["contrast"])
    )


class Contrasted:
    """Transitions of several episodes, made at once when the first of them is asked for.

    The cost of contrasting is that of its queries, whatever the number of rows.
    """

    def __init__(self, recipe: SegmentRecipe, episodes: Sequence[EpisodeTables]) -> None:
        self._recipe, self._episodes = recipe, episodes
        self._found: dict[int, dy.DataFrame[Transitions]] | None = None

    def of(self, tables: EpisodeTables) -> dy.DataFrame[Transitions]:
        """The transitions of one of the episodes."""
        if self._found is None:
            self._found = dict(self._all())
        return self._found[id(tables)]

    def _all(self) -> Iterator[tuple[int, dy.DataFrame[Transitions]]]:
        activities = [tables.get("activities", Activities) for tables in self._episodes]
        facts = [tables.get("facts", Facts) for tables in self._episodes]
        rows = contrast(
            Activities.cast(pl.concat(activities)),
            Facts.cast(pl.concat(facts)),
            self._recipe.entities,
            CONTRAST,
        )
        of = {str(key[0]): part for key, part in rows.partition_by("episode_id", as_dict=True).items()}
        for tables, own in zip(self._episodes, activities, strict=True):
            name = own["episode_id"][0] if len(own) else None
            yield id(tables), Transitions.cast(of[name] if name is not None else rows.clear())
