"""A log and a mapping to findings on how they fit: topics, bodies, units, frames."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import polars as pl

from demoplan.errors import LogError, UsageError
from demoplan.logs.diagnosing import InspectParams, as_sentence
from demoplan.logs.reading import SampleStream, definitions_of, topic_of
from demoplan.logs.reporting import Finding
from demoplan.logs.watching import FrameGraph
from demoplan.manifests.mapping import BodiesTopic, Mapping, TransformsTopic


def fit(
    path: Path,
    mapping: Mapping,
    root: Path | str | None,
    available: Collection[str],
    graph: FrameGraph,
    params: InspectParams,
) -> Iterator[Finding]:
    """How a log fits a mapping: its ``available`` topics, their values, and the ``graph`` of its frames."""
    usable = {}
    for label, topic in mapping.topics.items():
        if topic_of(label) not in available:
            consequence = "the log is refused" if topic.required else "what it feeds is unobserved"
            yield Finding(
                severity="error" if topic.required else "warning",
                subject=label,
                rule="missing-topic",
                sentence=f"The mapping reads it, but the log has no such topic, so that {consequence}; "
                f"available: {', '.join(sorted(available)) or 'none'}.",
            )
            continue
        usable[label] = topic
    for label, topic in usable.items():
        single = mapping.model_copy(update={"topics": {label: topic}})
        try:
            stream = SampleStream(path, single, "doctor", definitions_of(mapping, root))
            seen = _Seen()
            for batch in stream.batches():
                seen.add(batch)
        except (LogError, UsageError) as error:
            problem = error.problem if isinstance(error, LogError) else str(error)
            yield Finding(
                severity="error", subject=label, rule="mapping", sentence=f"{as_sentence(problem)}."
            )
            continue
        yield from seen.findings(label, topic, mapping, graph, params)


@dataclass(eq=False)
class _Seen:
    """What came of one mapped topic."""

    furthest_m: dict[str, float] = field(default_factory=dict)
    n_rows: dict[str, int] = field(default_factory=dict)
    n_untracked: dict[str, int] = field(default_factory=dict)
    references: set[str] = field(default_factory=set)
    grips: list[tuple[float, float]] = field(default_factory=list)

    def add(self, batch: pl.DataFrame) -> None:
        """Take a batch of samples."""
        far = pl.col("position_xyz_m").arr.eval(pl.element().abs().fill_nan(0.0)).arr.max()
        summary = batch.group_by("entity", maintain_order=True).agg(
            pl.len(),
            (~pl.col("is_tracked")).sum().alias("lost"),
            far.max().alias("far"),
            pl.col("reference").unique(),
        )
        for row in summary.iter_rows(named=True):
            name = row["entity"]
            self.n_rows[name] = self.n_rows.get(name, 0) + row["len"]
            self.n_untracked[name] = self.n_untracked.get(name, 0) + row["lost"]
            self.furthest_m[name] = max(self.furthest_m.get(name, 0.0), row["far"] or 0.0)
            self.references |= set(row["reference"])
        if batch["kind"][0] == "grip":
            self.grips.append((float(batch["grip"].min()), float(batch["grip"].max())))  # type: ignore[arg-type]

    def findings(
        self, label: str, topic: object, mapping: Mapping, graph: FrameGraph, params: InspectParams
    ) -> Iterator[Finding]:
        """What looks wrong."""

        def found(severity: str, rule: str, sentence: str) -> Finding:
            return Finding(severity=severity, subject=label, rule=rule, sentence=sentence)  # type: ignore[arg-type]

        if isinstance(topic, BodiesTopic | TransformsTopic):
            named = set(topic.entities.values()) if isinstance(topic, BodiesTopic) else set(topic.entities)
            if absent := sorted(named - set(self.n_rows)):
                yield found(
                    "warning",
                    "never-seen",
                    f"Never holds {', '.join(absent)}; it holds "
                    f"{', '.join(sorted(self.n_rows)) or 'nothing'}.",
                )
        mapped = {
            n: v
            for n, v in self.furthest_m.items()
            if not isinstance(topic, TransformsTopic) or n in topic.entities
        }
        if far := {name: value for name, value in mapped.items() if value > params.reach_m}:
            name, value = max(far.items(), key=lambda item: item[1])
            unit = "mm" if value > 20 * params.reach_m else "cm"
            yield found(
                "warning",
                "unit",
                f"{name} is up to {value:.4g} m away, which no hand reaches: the positions seem to be "
                f"in {unit}; "
                f"map the topic with 'unit: {unit}'.",
            )
        if not isinstance(topic, TransformsTopic) and mapped and 0 < max(mapped.values()) < params.nearest_m:
            yield found(
                "warning",
                "unit",
                f"No position is further than {max(mapped.values()):.3g} m away: check the topic's 'unit'.",
            )
        for name, n_rows in sorted(self.n_rows.items()):
            share = self.n_untracked[name] / n_rows
            if share > params.untracked_share:
                yield found(
                    "warning",
                    "untracked",
                    f"{name} is not tracked in {share:.0%} of its {n_rows} rows: look for occlusion.",
                )
        if self.grips and max(high for _, high in self.grips) - min(low for low, _ in self.grips) < 0.1:
            yield found(
                "warning",
                "grip",
                "The grip hardly changes: check the topic's 'field', 'open_at' and 'closed_at'.",
            )
        connected = next((tree for tree in graph.trees if mapping.world in tree), (mapping.world,))
        lost = sorted(self.references - set(connected))
        if lost and not isinstance(topic, TransformsTopic) and not self.grips:
            yield found(
                "error",
                "reference",
                f"Its poses are given in {', '.join(lost)}, which no transform connects to the "
                f"mapping's world "
                f"{mapping.world!r}: name the frame with 'frame', or set 'world'.",
            )
