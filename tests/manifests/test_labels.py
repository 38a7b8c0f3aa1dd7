import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from demoplan.errors import DataError, UnknownNameError
from demoplan.logs import read
from demoplan.manifests.dataset import parse_dataset
from demoplan.manifests.labels import activities_of_labels
from demoplan.tables import Samples


def samples(n=10, period_ns=100, offset_ns=0, names=("Right_hand", "Whisk", "Bowl")):
    """Every second message holds no body at all, so that frames and messages differ."""
    index = np.repeat(np.arange(n) * 2, len(names))
    stamps = index // 2 * period_ns
    return Samples.validate(
        pl.DataFrame(
            {
                "episode_id": ["e"] * len(index),
                "topic": ["/t"] * len(index),
                "entity": list(names) * n,
                "kind": ["pose"] * len(index),
                "reference": ["world"] * len(index),
                "is_static": [False] * len(index),
                "message_index": index,
                "stamp_ns": stamps + offset_ns,
                "log_ns": stamps + 7,
                "publish_ns": pl.Series([None] * len(index), dtype=pl.Int64),
                "header_ns": stamps,
                "position_xyz_m": np.zeros((len(index), 3)),
                "orientation_wxyz": np.tile([1.0, 0, 0, 0], (len(index), 1)),
                "grip": pl.Series([None] * len(index), dtype=pl.Float64),
                "is_tracked": [True] * len(index),
            }
        ),
        cast=True,
    )


def rows(table):
    return table.select("start_ns", "end_ns", "activity", "acted_on", "in_hand").rows()


def test_frames_count_messages_with_bodies_and_what_was_lifted_stays_in_hand():
    track = [
        0,
        [0, None, None],
        2,
        [1, 4, "whisk_2"],
        4,
        [3, 4, "whisk_2"],
        6,
        [10, 0, "bowl_3"],
        8,
        [2, 4, "whisk_9"],
        10,
    ]
    table = activities_of_labels({"right_hand": track}, "bimanual-frames", "e", samples())
    assert rows(table) == [
        (0, 200, "Idle", None, None),
        (200, 400, "Approach", "Whisk", None),
        (400, 600, "Lift", None, "Whisk"),
        (600, 800, "Stir", "Bowl", "Whisk"),
        (800, 1000, "Retreat", "Whisk", None),
    ]
    assert set(table["hand"]) == {"Right_hand"}


def test_where_a_boundary_runs_back_the_later_entry_wins():
    track = [0, [0, None, None], 6, [1, 4, "whisk"], 4, [3, 4, "whisk"], 9]
    table = activities_of_labels({"right_hand": track}, "bimanual-frames", "e", samples())
    assert rows(table) == [(0, 400, "Idle", None, None), (400, 900, "Lift", None, "Whisk")]


@pytest.mark.parametrize(
    ("track", "error", "words"),
    [
        ([0, [0, None, None], 11], DataError, "frames 0 to 11, but the log has 10"),
        ([0, [99, None, None], 5], UnknownNameError, "unknown action '99'"),
        ([0, [1, 4, "spoon_2"], 5], UnknownNameError, "unknown instance 'spoon_2'.*Bowl, Right_hand, Whisk"),
        ([0, 3, [0, None, None]], DataError, "expected"),
        ("nothing", DataError, "right_hand"),
    ],
)
def test_labels_that_do_not_fit_are_refused(track, error, words):
    with pytest.raises(error, match=words):
        activities_of_labels({"right_hand": track}, "bimanual-frames", "e", samples())


def test_intervals_are_brought_on_to_the_clock_that_the_mapping_chose():
    document = {
        "format": "activities",
        "hands": {
            "h": [
                {"start_ns": "0", "end_ns": "500", "activity": "Idle"},
                {"start_ns": 500, "end_ns": 900, "activity": "Reach", "acted_on": "c"},
            ]
        },
    }
    table = activities_of_labels(document, "activities", "e", samples(offset_ns=10**15))
    assert rows(table) == [
        (10**15, 10**15 + 500, "Idle", None, None),
        (10**15 + 500, 10**15 + 900, "Reach", "c", None),
    ]


@pytest.mark.parametrize(
    ("second", "words"), [(("400", "900"), "overlap at 400"), (("900", "900"), "Reach of h is empty at 900")]
)
def test_intervals_that_overlap_or_are_empty_are_refused(second, words):
    start, end = second
    hands = {
        "h": [
            {"start_ns": "0", "end_ns": "500", "activity": "Idle"},
            {"start_ns": start, "end_ns": end, "activity": "Reach"},
        ]
    }
    with pytest.raises(DataError, match=words):
        activities_of_labels({"hands": hands}, "activities", "e", samples())


def test_labels_of_another_episode_are_refused():
    with pytest.raises(DataError, match="of episode 'f'"):
        activities_of_labels({"episode_id": "f", "hands": {}}, "activities", "e", samples())


def test_an_unknown_format_is_refused():
    with pytest.raises(UnknownNameError, match="bimanual-frames"):
        activities_of_labels({}, "elan", "e", samples())


def test_the_real_takes_are_labelled_from_their_first_frame_on(bimanual_root):
    manifest = bimanual_manifest()
    for episode in manifest.episodes:
        taken = read(bimanual_root / episode.file, manifest.mapping, episode.id).samples
        document = json.loads((bimanual_root / episode.labels).read_text())
        table = activities_of_labels(document, manifest.label_format, episode.id, taken)
        for hand in ("Left_hand", "Right_hand"):
            mine = table.filter(pl.col("hand") == hand)
            assert mine["start_ns"][0] == taken["stamp_ns"].min()
            assert (mine["start_ns"][1:] == mine["end_ns"][:-1]).all()
            assert taken["stamp_ns"].max() - mine["end_ns"][-1] < 100_000_000


def bimanual_manifest():
    path = Path(__file__).resolve().parents[2] / "datasets" / "bimanual-cooking" / "dataset.yaml"
    return parse_dataset(path.read_text(), path)
