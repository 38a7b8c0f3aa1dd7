"""Tables of any number of episodes, one episode at a time."""

import polars as pl


def by_episode(table: pl.DataFrame) -> list[tuple[str, pl.DataFrame]]:
    """Each episode's id and rows, in order of id; rows keep their order.

    A table of one episode, as nearly all are while a log is ingested, is given back as it is: parting it
    would copy every row.
    """
    ids = table["episode_id"]
    if len(ids) == 0:
        return []
    if (ids == ids[0]).all():
        return [(str(ids[0]), table)]
    return [
        (str(key[0]), rows) for key, rows in sorted(table.partition_by("episode_id", as_dict=True).items())
    ]
