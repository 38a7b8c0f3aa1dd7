"""What compaction does to file counts and to reading one table: small files beside shards, in one run.

python benchmarks/shards.py --episodes 1200
"""

import argparse
import tempfile
import time
from statistics import median

import polars as pl

from demoplan.store import EpisodeState, Store
from demoplan.store.compacting import compact
from demoplan.store.store import StageOutput
from demoplan.store.sweeping import sweep
from demoplan.tables import Activities, Facts

N_READ = 200
"""Tables that are read, spread over all episodes."""


def made_up():
    """Activities and facts of the size that half a minute with two hands gives."""
    activities = pl.select(start_ns=pl.int_range(40)).with_columns(
        episode_id=pl.lit("e"),
        hand=pl.lit("Right_hand"),
        end_ns=pl.col("start_ns") + 1,
        activity=pl.lit("Reach"),
        acted_on=pl.lit("cube"),
        in_hand=None,
    )
    facts = pl.select(start_ns=pl.int_range(200)).with_columns(
        episode_id=pl.lit("e"),
        predicate=pl.lit("onTop"),
        arguments=pl.lit(["a", "b"], dtype=pl.List(pl.String)),
        end_ns=pl.col("start_ns") + 1,
        value=pl.lit("true"),
    )
    return {
        "activities": (Activities.validate(activities, cast=True), Activities),
        "facts": (Facts.validate(facts, cast=True), Facts),
    }


def fill(store, n_episodes):
    """Store two tables for each episode."""
    tables = made_up()
    for first in range(0, n_episodes, 16):
        with store.together():
            states = []
            for number in range(first, min(first + 16, n_episodes)):
                name = f"e{number:06}"
                output = StageOutput(
                    tables={
                        table: (rows.with_columns(episode_id=pl.lit(name)), schema)
                        for table, (rows, schema) in tables.items()
                    }
                )
                record = store.run("segment", {"log": name}, "{}", "c", lambda output=output: output)
                states.append(
                    EpisodeState(
                        dataset="d", episode_id=name, tables=record.outputs, keys={"segment": record.key}
                    )
                )
        store.manifest.update(states)


def reading_ms(location, states):
    """Time of the first table that a process reads, and the median of others."""
    store = Store(location)
    taken = []
    for state in states[:: max(1, len(states) // N_READ)]:
        start = time.perf_counter()
        store.get(state.tables["activities"], Activities)
        taken.append((time.perf_counter() - start) * 1e3)
    return taken[0], median(taken[1:])


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=1200)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="demoplan-shards-") as folder:
        store = Store(folder)
        fill(store, asked.episodes)
        states = store.manifest.episodes()
        rows = [("small files", len(store.place.names("")), *reading_ms(folder, states))]
        start = time.perf_counter()
        compact(store)
        sweep(store)
        taken_s = time.perf_counter() - start
        rows.append(("shards", len(store.place.names("")), *reading_ms(folder, states)))
    print(f"{asked.episodes} episodes, two tables each; compacting and sweeping took {taken_s:.1f} s\n")
    print(f"{'':14}{'files':>8}{'first table [ms]':>18}{'median of others [ms]':>24}")
    for name, n_files, first_ms, others_ms in rows:
        print(f"{name:14}{n_files:8}{first_ms:18.1f}{others_ms:24.2f}")


if __name__ == "__main__":
    main()
