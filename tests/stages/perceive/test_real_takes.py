from pathlib import Path

import polars as pl

from demoplan.logs import read
from demoplan.manifests.dataset import parse_dataset
from demoplan.manifests.vocabulary import parse_vocabulary
from demoplan.stages.align import AlignParams, align
from demoplan.stages.perceive import perceive

FOLDER = Path(__file__).resolve().parents[3] / "datasets" / "bimanual-cooking"


def test_the_whisk_is_in_the_right_hand_once_and_the_bottle_in_the_left_in_every_real_take(bimanual_root):
    manifest = parse_dataset((FOLDER / "dataset.yaml").read_text(), FOLDER / "dataset.yaml")
    vocabulary = parse_vocabulary((FOLDER / manifest.vocabulary).read_text(), manifest.vocabulary)
    for episode in manifest.episodes:
        taken = read(bimanual_root / episode.file, manifest.mapping, episode.id)
        frames = align(taken.samples, manifest.mapping, AlignParams(tick_rate_hz=manifest.tick_rate_hz))
        facts = perceive(frames, manifest.mapping.entities, vocabulary)
        carried = facts.filter((pl.col("predicate") == "inHand") & (pl.col("value") == "true"))
        seconds = {
            tuple(rows["arguments"][0]): rows["end_ns"].sum() / 1e9 - rows["start_ns"].sum() / 1e9
            for rows in carried.partition_by("arguments")
        }
        assert seconds.pop(("Right_hand", "Whisk")) > 5, episode.id
        assert seconds.pop(("Left_hand", "Bottle")) > 2, episode.id
        assert sum(seconds.values()) < 1.0, (episode.id, seconds)
        whisk = carried.filter(pl.col("arguments") == ["Right_hand", "Whisk"])
        assert len(whisk) == 1, episode.id
