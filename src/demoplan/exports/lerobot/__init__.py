"""A dataset in LeRobot's format, version 3.0: Parquet files, metadata and a dataset card.

``content`` says what goes in, ``vectors`` and ``subtasks`` make its columns, ``statistics`` what is told of
them, ``layout`` names and declares everything, ``writing`` puts the folder down whole, ``card`` describes it.

Source: Hugging Face, *LeRobotDataset v3.0*, documentation of lerobot 0.4 to 0.6.
"""

from demoplan.exports.lerobot.content import DatasetFacts, EpisodeContent, LeRobotParams
from demoplan.exports.lerobot.licences import licence_id
from demoplan.exports.lerobot.writing import Written, write_dataset

__all__ = ["DatasetFacts", "EpisodeContent", "LeRobotParams", "Written", "licence_id", "write_dataset"]
