# ruff: noqa: PLC0415 (each way is imported only in the process that measures it)
"""How fast logs become activities, stage by stage, beside the naive way; and how much memory it takes.

One command prints the table, in some minutes::

    python benchmarks/ingest.py

Measured is CPU time (user and system) of one process with one thread, without its start and imports: reading
the log, aligning, perceiving and segmenting with a trained tree, each through the store, as `demoplan run`
does it: fingerprints, Parquet files, records and the manifest's row included. *× real time* is the length of
the recording over that time. Recordings are one shipped episode of each format, and ten minutes: the same
participant's streams, repeated with the clock running on. A first run of another episode warms up what a
process does once (the hash of the code, compiled rules).

The naive way reads with rosbags' ``AnyReader``, a message at a time, and decides on contact, support and
holding with a few NumPy calls per tick and pair, as scripts do. It knows boxes only by their middles, has no
hysteresis, no gaps, no tables and no segments: less work than demoplan does, not more.

`--large` prints instead the peak memory of each stage against the length of the recording, beside what it is
if every table is held as a whole, and how much it grows per hour.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DATASET = ROOT / "datasets" / "cube-stacking"
EPISODES = {"mcap": "p1-two-right", "rosbag2": "p2-two-right", "rosbag1": "p3-two-right"}
STAGES = ("read", "align", "perceive", "segment")
_ONE_THREAD = {
    "POLARS_MAX_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # As the command line sets it, for both ways.
    "_RJEM_MALLOC_CONF": "dirty_decay_ms:10000,muzzy_decay_ms:10000",
}


def opened_dataset():
    from demoplan.pipeline.datasets import open_dataset

    return open_dataset(DATASET)


def train(path: Path) -> None:
    """The segmenter that `demoplan segmenter train` gives: one tree, fitted to all twelve episodes."""
    from demoplan.pipeline.episodes.activities import train_on
    from demoplan.store import Store

    with tempfile.TemporaryDirectory() as folder:
        _, text = train_on(
            opened_dataset(), Store(Path(folder)), method="decision_tree", split=None, n_workers=1
        )
    path.write_text(text)


def lengthen(log_format: str, path: Path, minutes: float) -> None:
    """Write a shipped episode again and again, one after the other, as one recording."""
    import numpy as np

    from demoplan.logs import read
    from demoplan.logs.writing import JoyStream, PoseStream, Stamped, TransformStream, write_log

    opened = opened_dataset()
    episode = next(e for e in opened.dataset.episodes if e.id == EPISODES[log_format])
    mapping = opened.dataset.mapping
    samples = read(opened.log_of(episode), mapping, episode.id).samples
    first, last = samples["log_ns"].min(), samples["log_ns"].max()
    n_times = max(1, round(minutes * 60e9 / (last - first)))
    shifts = np.arange(n_times) * (last - first + 10_000_000)

    def repeated(stamps: Any) -> Any:
        return (shifts[:, None] + stamps.to_numpy()[None]).reshape(-1)

    streams = []
    for label, topic in mapping.topics.items():
        rows = samples.filter(samples["topic"] == label)
        is_static = getattr(topic, "static", False)
        if topic.kind == "transforms":
            names = rows["entity"].unique().sort().to_list()
            messages = rows.unique("message_index", keep="first").sort("message_index")
            at = np.searchsorted(messages["message_index"].to_numpy(), rows["message_index"].to_numpy())
            which = np.searchsorted(np.array(names), rows["entity"].to_numpy().astype(str))
            position = np.zeros((len(messages), len(names), 3))
            orientation = np.zeros((len(messages), len(names), 4))
            is_present = np.zeros((len(messages), len(names)), bool)
            position[at, which] = rows["position_xyz_m"].to_numpy()
            orientation[at, which] = rows["orientation_wxyz"].to_numpy()
            is_present[at, which] = True
        else:
            messages = rows
        times = 1 if is_static else n_times
        kept = len(messages) * times
        stamps = Stamped(
            *(
                repeated(messages[name].fill_null(messages["log_ns"]))[:kept]
                for name in ("header_ns", "publish_ns", "log_ns")
            )
        )
        if topic.kind == "transforms":
            arrays = (np.tile(a, (times, *(1,) * (a.ndim - 1))) for a in (position, orientation, is_present))
            streams.append(
                TransformStream(label, stamps, rows["reference"][0], tuple(names), *arrays, is_static)
            )
        elif topic.kind == "pose":
            poses = (
                np.tile(rows[name].to_numpy(), (times, 1)) for name in ("position_xyz_m", "orientation_wxyz")
            )
            streams.append(PoseStream(label, stamps, rows["reference"][0], *poses))
        else:
            closing = 1.0 - np.tile(rows["grip"].to_numpy(), times)
            streams.append(JoyStream(label, stamps, "hand", closing[:, None]))
    write_log(path, streams, log_format)


def job_of(opened, store, episode, log: Path | None):
    from demoplan.pipeline.episodes.ingest import jobs_of

    (job,) = jobs_of(opened, store, [episode])
    if log is None:
        return replace(job, labels=None)
    return replace(job, log=log, labels=None, episode=episode.model_copy(update={"sha256": None}))


def measure(log_format: str, segmenter: Path, log: Path | None, n_runs: int) -> Iterator[dict[str, float]]:
    """CPU seconds by stage, of several runs into empty stores."""
    from demoplan.pipeline.episodes import activities, ingest, segmenters
    from demoplan.pipeline.episodes.episode_tables import EpisodeTables
    from demoplan.store import Store

    opened = opened_dataset()
    chosen = segmenters.read_segmenter(segmenter)
    spent: dict[str, float] = {}
    run = EpisodeTables.run

    def timed(self, stage, **options):
        start = time.process_time()
        try:
            return run(self, stage, **options)
        finally:
            spent[stage] = spent.get(stage, 0.0) + time.process_time() - start

    EpisodeTables.run = timed
    episodes = {episode.id: episode for episode in opened.dataset.episodes}

    def whole(name: str, path: Path | None) -> dict[str, float]:
        with tempfile.TemporaryDirectory() as folder:
            store = Store(Path(folder))
            spent.clear()
            start = time.process_time()
            job = job_of(opened, store, episodes[name], path)
            state = ingest.ingest_episode(job)
            assert state.status == "complete", state.reason
            (state,) = activities.segment_episodes(
                opened, store, [state], {state.episode_id: chosen}, is_kept=False
            )
            total = time.process_time() - start
            # Operators are learned from transitions; activities end before.
            total -= spent.pop("contrast")
            frames = store.get(state.tables["episodes"], _episodes())
            length_s = (frames["end_ns"][0] - frames["start_ns"][0]) / 1e9
        return dict(spent) | {"total": total, "length_s": length_s}

    whole("p1-one-right", None)
    for _ in range(n_runs):
        yield whole(EPISODES[log_format], log)


def _episodes():
    from demoplan.tables import Episodes

    return Episodes


def naive(log: Path) -> dict[str, float]:
    """CPU seconds of the naive way; see the top of this file."""
    import numpy as np
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    start = time.process_time()
    latest: dict[str, Any] = {}
    facts: list[tuple[int, str, str, str]] = []
    cubes = ("cube_red", "cube_blue", "cube_green", "cube_yellow")
    hands = ("left", "right")
    times = []
    with AnyReader([log], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic.endswith("pose"):
                p = message.pose.position
                latest[connection.topic.split("/")[2]] = np.array([p.x, p.y, p.z])
            elif connection.topic.endswith("joy"):
                latest[connection.topic.split("/")[2] + "_grip"] = message.axes[0]
            else:
                for transform in message.transforms:
                    p = transform.transform.translation
                    latest[transform.child_frame_id] = np.array([p.x, p.y, p.z])
            if connection.topic != "/tf" or not all(name in latest for name in (*cubes, *hands)):
                continue
            times.append(stamp)
            for i, one in enumerate(cubes):
                for other in cubes[i + 1 :]:
                    away = latest[one] - latest[other]
                    if np.linalg.norm(away) < 0.055:
                        facts.append((stamp, "inTouch", one, other))
                    if np.linalg.norm(away[:2]) < 0.025 and 0.045 < abs(away[2]) < 0.055:
                        facts.append((stamp, "onTop", one, other))
            for hand in hands:
                for cube in cubes:
                    near = np.linalg.norm(latest[hand] - latest[cube])
                    if near < 0.06 and latest.get(f"{hand}_grip", 0.0) > 0.5:
                        facts.append((stamp, "inHand", hand, cube))
                    elif near < 0.15:
                        facts.append((stamp, "actedOn", hand, cube))
    return {"total": time.process_time() - start, "length_s": (times[-1] - times[0]) / 1e9}


def memory(log: Path, segmenter: Path, is_whole: bool) -> dict[str, float]:
    """Peak memory [MiB] of each stage of one ingest, and CPU seconds of all of it.

    Args:
        log: A long recording.
        segmenter: What it is segmented with.
        is_whole: Whether tables are held as a whole, however long.
    """
    from demoplan.pipeline.episodes import activities, segmenters
    from demoplan.pipeline.episodes.episode_tables import EpisodeTables
    from demoplan.pipeline.episodes.ingest import ingest_episode
    from demoplan.store import Store

    if is_whole:
        EpisodeTables.long_rows = sys.maxsize
    peaks: dict[str, float] = {}
    run = EpisodeTables.run

    def watched(self, stage, **options):
        restart_peak()
        try:
            return run(self, stage, **options)
        finally:
            peaks[stage] = current_peak_mib()

    EpisodeTables.run = watched
    opened = opened_dataset()
    chosen = segmenters.read_segmenter(segmenter)
    episode = next(each for each in opened.dataset.episodes if each.id == EPISODES["mcap"])
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        start = time.process_time()
        state = ingest_episode(job_of(opened, store, episode, log))
        assert state.status == "complete", state.reason
        activities.segment_episodes(opened, store, [state], {state.episode_id: chosen}, is_kept=False)
        spent_s = time.process_time() - start
    return {stage: peaks[stage] for stage in STAGES} | {"total": spent_s, "peak_mib": max(peaks.values())}


def restart_peak() -> None:
    """Let the system forget the largest resident memory of this process.

    Source: proc(5), Linux man-pages, /proc/pid/clear_refs.
    """
    Path("/proc/self/clear_refs").write_text("5")


def current_peak_mib() -> float:
    """Largest resident memory of this process since ``restart_peak``."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def memory_table(folder: Path, lengths_min: list[float], n_runs: int) -> None:
    segmenter = folder / "segmenter.json"
    if not segmenter.exists():
        train(segmenter)
    print("peak resident memory [MiB], one process and one thread; medians\n")
    print("| length [min] | log [MiB] | tables | read | align | perceive | segment | peak | CPU [s] |")
    print("| --- " * 9 + "|")
    peaks: dict[str, list[float]] = {"in parts": [], "whole": []}
    for minutes in lengths_min:
        log = folder / f"long-{minutes:g}.mcap"
        if not log.exists():
            lengthen("mcap", log, minutes)
        for way, found in peaks.items():
            whole = ["--whole"] if way == "whole" else []
            runs = [
                child("--memory", str(log), "--segmenter", str(segmenter), *whole)[0] for _ in range(n_runs)
            ]
            median = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
            found.append(median["peak_mib"])
            stages = " | ".join(f"{median[stage]:.0f}" for stage in STAGES)
            print(
                f"| {minutes:g} | {log.stat().st_size / 2**20:.0f} | {way} | {stages} "
                f"| {median['peak_mib']:.0f} | {median['total']:.1f} |",
                flush=True,
            )
    if len(lengths_min) > 1:
        hours = (lengths_min[-1] - lengths_min[-2]) / 60
        for way, found in peaks.items():
            print(f"\n{way}: {(found[-1] - found[-2]) / hours:.0f} MiB more per hour, between the last two")


def peak_mib() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def child(*arguments: str) -> list[dict[str, float]]:
    """What a process of its own measured."""
    done = subprocess.run(
        [sys.executable, __file__, *arguments],
        env=os.environ | _ONE_THREAD,
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def row(name: str, way: str, runs: list[dict[str, float]]) -> None:
    median = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
    stages = " | ".join(f"{1e3 * median[stage]:.1f}" if stage in median else "" for stage in STAGES)
    totals = [run["total"] for run in runs]
    print(
        f"| {name} | {median['length_s']:.1f} | {way} | {stages} | {1e3 * median['total']:.1f} "
        f"| {1e3 * min(totals):.1f}–{1e3 * max(totals):.1f} | {median['length_s'] / median['total']:.0f} "
        f"| {median['peak_mib']:.0f} |",
        flush=True,
    )


def table(folder: Path, formats: list[str], minutes: float, n_runs: int) -> None:
    segmenter = folder / "segmenter.json"
    if not segmenter.exists():
        train(segmenter)
    print("CPU time [ms], one process and one thread; medians\n")
    print(
        "| recording | length [s] | way | read | align | perceive | segment | total | spread "
        "| × real time | peak [MiB] |"
    )
    print("| --- " * 11 + "|")
    suffix = {"mcap": ".mcap", "rosbag2": "", "rosbag1": ".bag"}
    for log_format in formats:
        name = EPISODES[log_format]
        log = DATASET / "logs" / f"{name}{suffix[log_format]}"
        runs = child("--one", log_format, "--segmenter", str(segmenter), "--runs", str(n_runs))
        row(f"{log_format}, {name}", "demoplan", runs)
        row("", "naive", [run for _ in range(3) for run in child("--naive", str(log))])
        long = folder / f"long-{log_format}{suffix[log_format]}"
        if not long.exists():
            lengthen(log_format, long, minutes)
        runs = child(
            "--one", log_format, "--segmenter", str(segmenter), "--log", str(long), "--runs", str(n_runs // 2)
        )
        row(f"{log_format}, {minutes:g} min", "demoplan", runs)
        row("", "naive", child("--naive", str(long)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--runs", type=int, default=9, help="runs on a shipped episode [9]; half on a long one"
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the long recording [10]")
    parser.add_argument("--format", choices=list(EPISODES), action="append", help="only this format")
    parser.add_argument("--folder", type=Path, help="keep logs and segmenter here, and use what is there")
    parser.add_argument("--large", action="store_true", help="memory against the length of the recording")
    parser.add_argument(
        "--lengths", type=float, nargs="+", default=[10.0, 20.0, 40.0, 80.0], help="for --large [min]"
    )
    parser.add_argument("--memory", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--whole", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--one", choices=list(EPISODES), help=argparse.SUPPRESS)
    parser.add_argument("--segmenter", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--naive", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.naive:
        print(json.dumps(naive(options.naive) | {"peak_mib": peak_mib()}))
        return
    if options.memory:
        print(json.dumps(memory(options.memory, options.segmenter, options.whole)))
        return
    if options.one:
        for run in measure(options.one, options.segmenter, options.log, options.runs):
            print(json.dumps(run | {"peak_mib": peak_mib()}))
        return
    with tempfile.TemporaryDirectory(prefix="demoplan-") as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        if options.large:
            memory_table(folder, options.lengths, max(1, options.runs // 3))
            return
        table(folder, options.format or list(EPISODES), options.minutes, options.runs)


if __name__ == "__main__":
    main()
