"""Runs in an environment that has lerobot: reads a dataset as its user would, and prints what it holds.

python read_with_lerobot.py FOLDER
"""

import json
import sys

import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset


def text_of(dataset, item):
    """The subtask's text, by whatever means this version of lerobot offers."""
    if "subtask" in item:
        return item["subtask"]
    if "language_persistent" in item:
        from lerobot.datasets.language_render import active_at

        row = active_at(item["timestamp"].item(), persistent=item["language_persistent"], style="subtask")
        return row["content"]
    import pandas

    table = pandas.read_parquet(dataset.root / "meta" / "subtasks.parquet")
    return table.iloc[item["subtask_index"].item()].name


def main(root):
    dataset = LeRobotDataset("local/exported", root=root)
    episodes = []
    for row in dataset.meta.episodes:
        items = [dataset[k] for k in range(row["dataset_from_index"], row["dataset_to_index"])]
        episodes.append(
            {
                "episode_id": row["episode_id"],
                "length": row["length"],
                "success": row["success"],
                "split": row["split"],
                "task": items[0]["task"],
                "subtasks": [text_of(dataset, item) for item in items],
                "timestamps": [item["timestamp"].item() for item in items],
                "state": [item["observation.state"].tolist() for item in items],
                "action": [item["action"].tolist() for item in items],
                "is_seen": [item["observation.is_seen"].tolist() for item in items],
                "done": [item["next.done"].item() for item in items],
            }
        )
    part = LeRobotDataset(
        "local/exported", root=root, episodes=[1], delta_timestamps={"action": [0, 1 / dataset.fps]}
    )
    # What lerobot's own training script uses where there is language; older versions have none.
    try:
        from lerobot.utils.collate import lerobot_collate_fn as collate
    except ImportError:
        collate = None
    batch = next(iter(torch.utils.data.DataLoader(part, batch_size=4, collate_fn=collate)))
    json.dump(
        {
            "episodes": episodes,
            "n_frames": len(dataset),
            "fps": dataset.fps,
            "splits": dataset.meta.info["splits"],
            "shapes": {name: list(shape) for name, shape in dataset.meta.shapes.items()},
            "mean": dataset.meta.stats["observation.state"]["mean"].tolist(),
            "chunk": list(batch["action"].shape),
        },
        sys.stdout,
    )


main(sys.argv[1])
