# ruff: noqa: PLC0415 (each reader is imported only in the process that measures it)
"""How fast logs decode into columns, beside other readers and the floor; and how much memory it takes.

One command prints the table::

    python benchmarks/decoding.py            # a few minutes
    python benchmarks/decoding.py --large    # also a log of 2 GiB per format: time and peak memory

The log is ten minutes of ``/tf`` at 100 Hz, twelve transforms a message (60 000 messages, 720 000 rows), from
random walks as motion capture gives them. It is written as MCAP (CDR, zstd, chunks of the library's default
1 MiB), rosbag2 sqlite3 (not compressed), and ROS 1 bag (lz4, the library's 1 MiB chunks).

Each reader runs in a process of its own, several times; the figure is the median of the CPU time of the whole
process (user and system, all threads) between opening the file and holding the result, without imports.
What a reader's result is:

- *columns*: arrays of stamps, frame names (as codes), positions and orientations, by demoplan's decoder;
- *samples*: demoplan's validated ``Samples`` table, with four text columns;
- *rerun*: the Arrow chunks of ``McapReader`` with the ``ros2_reflection`` decoder;
- *objects*: one Python object per message, in the other libraries;
- *floor*: every message's bytes, read and decompressed, nothing decoded.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

N_FRAMES = 12
RATE_HZ = 100
FRAMES = [f"tracked_body_{i}" for i in range(N_FRAMES)]
START_NS = 1_760_000_000_000_000_000
_BATCH = 1000


def payloads(n_messages: int, *, is_ros1: bool):
    """(stamp, payload) of each message; the bytes are made as a matrix, in batches."""
    store = typestore(is_ros1=is_ros1)
    types = store.types
    stamp_type, header_type = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    stamped, transform = types["geometry_msgs/msg/TransformStamped"], types["geometry_msgs/msg/Transform"]
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    marker = 0x5EC0_0001
    values = iter(range(1, 1 + 7 * N_FRAMES))
    seq = {"seq": 0} if is_ros1 else {}
    transforms = [
        stamped(
            header_type(stamp=stamp_type(sec=marker, nanosec=marker), frame_id="world", **seq),
            name,
            transform(
                vector(*(float(next(values)) for _ in range(3))),
                quaternion(*(float(next(values)) for _ in range(4))),
            ),
        )
        for name in FRAMES
    ]
    message = types["tf2_msgs/msg/TFMessage"](transforms)
    serialise = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    template = np.frombuffer(bytes(serialise(message, "tf2_msgs/msg/TFMessage")), np.uint8)
    raw = template.tobytes()
    stamps_at = [i for i in range(len(raw) - 8) if raw[i : i + 8] == marker.to_bytes(4, "little") * 2]
    values_at = [raw.index(np.float64(i + 1).tobytes()) for i in range(7 * N_FRAMES)]
    assert len(stamps_at) == N_FRAMES
    random = np.random.default_rng(0)
    at = random.uniform(-1, 1, 7 * N_FRAMES)
    for first in range(0, n_messages, _BATCH):
        n_rows = min(_BATCH, n_messages - first)
        rows = np.tile(template, (n_rows, 1))
        times = START_NS + (first + np.arange(n_rows)) * (1_000_000_000 // RATE_HZ)
        walk = at + np.cumsum(random.normal(0, 1e-3, (n_rows, 7 * N_FRAMES)), axis=0)
        at = walk[-1]
        for place in stamps_at:
            rows[:, place : place + 4] = (times // 1_000_000_000).astype("<i4")[:, None].view(np.uint8)
            rows[:, place + 4 : place + 8] = (times % 1_000_000_000).astype("<u4")[:, None].view(np.uint8)
        for column, place in enumerate(values_at):
            rows[:, place : place + 8] = np.ascontiguousarray(walk[:, column : column + 1]).view(np.uint8)
        for stamp, row in zip(times.tolist(), rows, strict=True):
            yield stamp, row.tobytes()


def typestore(*, is_ros1: bool):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if is_ros1:
        name = "tf2_msgs/msg/TFMessage"
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store


def definition(*, is_ros1: bool) -> str:
    store = typestore(is_ros1=is_ros1)
    text, _ = store.generate_msgdef("tf2_msgs/msg/TFMessage", ros_version=1 if is_ros1 else 2)
    return str(text)


def write_mcap(path: Path, n_messages: int, **options) -> None:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, compression=options.get("compression", CompressionType.ZSTD))
        writer.start("ros2")
        schema = writer.register_schema(
            "tf2_msgs/msg/TFMessage", "ros2msg", definition(is_ros1=False).encode()
        )
        channel = writer.register_channel("/tf", "cdr", schema)
        for stamp, payload in payloads(n_messages, is_ros1=False):
            writer.add_message(channel, stamp, payload, stamp)
        writer.finish()


def write_sqlite3(path: Path, n_messages: int) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection(
            "/tf", "tf2_msgs/msg/TFMessage", typestore=typestore(is_ros1=False)
        )
        for stamp, payload in payloads(n_messages, is_ros1=False):
            writer.write(connection, stamp, payload)


def write_rosbag1(path: Path, n_messages: int) -> None:
    from rosbags.rosbag1 import Writer

    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        connection = writer.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=typestore(is_ros1=True))
        for stamp, payload in payloads(n_messages, is_ros1=True):
            writer.write(connection, stamp, payload)


FORMATS: dict[str, tuple[str, Callable[..., None]]] = {
    "mcap": ("tf.mcap", write_mcap),
    "sqlite3": ("tf_sqlite3", write_sqlite3),
    "rosbag1": ("tf.bag", write_rosbag1),
}


def mapping():
    from demoplan.manifests.mapping import Mapping

    return Mapping.model_validate({"entities": {}, "topics": {"/tf": {"kind": "transforms"}}})


def floor_mcap(path: Path) -> int:
    """Read each chunk and decompress it, by the fastest call there is."""
    import struct

    import zstandard

    n_bytes, unpack = 0, zstandard.ZstdDecompressor()
    with path.open("rb") as file:
        file.seek(8)
        while len(prefix := file.read(9)) == 9:
            op, length = struct.unpack("<BQ", prefix)
            body = file.read(length)
            if op == 6:
                (n_name,) = struct.unpack_from("<I", body, 28)
                n_bytes += len(unpack.decompress(memoryview(body)[40 + n_name :]))
            if op == 2:
                break
    return n_bytes


def floor_sqlite3(path: Path) -> int:
    import sqlite3

    (file,) = path.glob("*.db3")
    database = sqlite3.connect(f"file:{file}?mode=ro&immutable=1", uri=True)
    n_bytes = 0
    cursor = database.execute("SELECT data FROM messages ORDER BY id")
    while rows := cursor.fetchmany(64):
        n_bytes += sum([len(row[0]) for row in rows])
    return n_bytes


def floor_rosbag1(path: Path) -> int:
    import struct

    import lz4.frame

    n_bytes = 0
    with path.open("rb") as file:
        file.readline()
        while len(prefix := file.read(4)) == 4:
            head = file.read(struct.unpack("<I", prefix)[0])
            body = file.read(struct.unpack("<I", file.read(4))[0])
            if b"op=\x05" in head:
                n_bytes += len(lz4.frame.decompress(body))
    return n_bytes


def ours_columns(path: Path) -> int:
    from demoplan.logs.decoding import decoder_for
    from demoplan.logs.definitions import Definitions
    from demoplan.logs.layouts import Interner
    from demoplan.logs.messages import Tally
    from demoplan.logs.opening import files_of
    from demoplan.logs.sampling import wanted_of

    wanted = wanted_of(mapping().topics["/tf"])
    decoder, held = None, []
    for file in files_of(path):
        with file.container(tally := Tally()) as container:
            for block in container.blocks(lambda topic: topic == "/tf", tally):
                decoder = decoder or decoder_for(block.channel, wanted, Definitions(), Interner())
                held.append((block.log_ns, decoder.decode(block)))
    return sum(len(columns.message) for _, columns in held)


def ours_samples(path: Path) -> int:
    from demoplan.logs import read

    return len(read(path, mapping(), "episode").samples)


def rerun_reader(path: Path) -> int:
    from rerun.chunk import McapReader

    reader = McapReader(path, decoders=["ros2_reflection"])
    held = list(reader.stream())
    return N_FRAMES * sum(chunk.num_rows for chunk in held if "/tf" in str(chunk.entity_path))


def mcap_ros2(path: Path) -> int:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        held = [
            m for *_, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        ]
    return sum(len(message.transforms) for message in held)


def mcap_ros2_fast(path: Path) -> int:
    from mcap.reader import make_reader
    from mcap_ros2_support_fast.decoder import DecoderFactory

    with path.open("rb") as file:
        held = [
            m for *_, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        ]
    return sum(len(message.transforms) for message in held)


def rosbags_reader(path: Path) -> int:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        held = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    return sum(len(message.transforms) for message in held)


READERS: dict[str, dict[str, Callable[[Path], int]]] = {
    "mcap": {
        "floor": floor_mcap,
        "demoplan, columns": ours_columns,
        "demoplan, samples": ours_samples,
        "rerun McapReader, ros2_reflection": rerun_reader,
        "mcap-ros2-support-fast": mcap_ros2_fast,
        "rosbags": rosbags_reader,
        "mcap-ros2-support": mcap_ros2,
    },
    "sqlite3": {
        "floor": floor_sqlite3,
        "demoplan, columns": ours_columns,
        "demoplan, samples": ours_samples,
        "rosbags": rosbags_reader,
    },
    "rosbag1": {
        "floor": floor_rosbag1,
        "demoplan, columns": ours_columns,
        "demoplan, samples": ours_samples,
        "rosbags": rosbags_reader,
    },
}


def measure(log_format: str, reader: str, path: Path) -> None:
    """One run, in this process: prints CPU seconds, wall seconds, rows and peak memory as JSON."""
    call = READERS[log_format][reader]
    import_all(reader)
    gc_freeze()
    cpu, wall = time.process_time(), time.perf_counter()
    n_rows = call(path)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"cpu_s": cpu, "wall_s": wall, "n": n_rows, "peak": peak}))


def import_all(reader: str) -> None:
    """Imports are not measured: a process reads many logs."""
    if reader.startswith("demoplan"):
        import demoplan.logs  # noqa: F401
        from demoplan.logs.definitions import Definitions
        from demoplan.logs.messages import Channel

        for name, encoding in (("tf2_msgs/msg/TFMessage", "cdr"), ("geometry_msgs/msg/Pose", "ros1")):
            Definitions().node(Channel("/tf", name, encoding))
    elif reader.startswith("rerun"):
        import rerun.chunk  # noqa: F401
    elif reader == "rosbags":
        from rosbags.typesys import Stores, get_typestore

        get_typestore(Stores.ROS2_HUMBLE)
        get_typestore(Stores.ROS1_NOETIC)
    elif reader == "mcap-ros2-support":
        import mcap_ros2.decoder  # noqa: F401
    elif reader == "mcap-ros2-support-fast":
        import mcap_ros2_support_fast.decoder  # noqa: F401


def gc_freeze() -> None:
    import gc

    gc.collect()
    gc.freeze()


def drain(path: Path) -> None:
    """Go through a log's batches and keep none: prints time and peak memory as JSON."""
    from demoplan.logs import open_log

    stream = open_log(path, mapping(), "episode")
    cpu, wall = time.process_time(), time.perf_counter()
    n_rows = sum(len(batch) for batch in stream.batches())
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"cpu_s": cpu, "wall_s": wall, "n": n_rows, "peak": peak}))


def child(*arguments: str) -> dict[str, float]:
    """The JSON that this script prints when called with ``arguments``."""
    done = subprocess.run([sys.executable, __file__, *arguments], check=False, capture_output=True, text=True)
    if done.returncode:
        return {"error": 1, "why": done.stderr.strip().splitlines()[-1]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def table(folder: Path, n_messages: int, n_runs: int, formats: list[str], slow_runs: int) -> None:
    print(f"{n_messages} messages of /tf, {N_FRAMES} transforms each; median CPU time, one process a run\n")
    print("| format | reader | CPU [s] | spread [s] | peak [MiB] | × floor | demoplan is … times as fast |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for log_format in formats:
        name, write = FORMATS[log_format]
        path = folder / name
        if not path.exists():
            write(path, n_messages)
        medians: dict[str, float] = {}
        for reader in READERS[log_format]:
            is_quick = reader.startswith(("floor", "demoplan", "rerun"))
            n_times = n_runs if is_quick else slow_runs
            if not n_times:
                continue
            runs = [child("--one", log_format, reader, str(path)) for _ in range(n_times)]
            if any("error" in run for run in runs):
                print(f"| {log_format} | {reader} | failed: {runs[0].get('why', '')} | | | | |", flush=True)
                continue
            times = [run["cpu_s"] for run in runs]
            assert reader == "floor" or runs[0]["n"] == n_messages * N_FRAMES, (reader, runs[0])
            medians[reader] = statistics.median(times)
            ours = medians.get("demoplan, columns")
            peak = max(run["peak"] for run in runs) / 2**20
            print(
                f"| {log_format} | {reader} | {medians[reader]:.3f} | {min(times):.3f}–{max(times):.3f} "
                f"| {peak:.0f} | {medians[reader] / medians['floor']:.1f} "
                f"| {'' if ours is None else f'{medians[reader] / ours:.1f}'} |",
                flush=True,
            )


def large(folder: Path, formats: list[str], n_bytes: int) -> None:
    """Time and peak memory on logs of 2 GiB, whatever their layout."""
    size = len(next(payloads(1, is_ros1=False))[1])
    n_messages = n_bytes // size + 1
    print(f"\nlogs of {n_bytes / 2**30:.1f} GiB of messages, streamed\n")
    print("| layout | rows | CPU [s] | wall [s] | peak [MiB] |\n| --- | --- | --- | --- | --- |")
    layouts: dict[str, Callable[[Path], None]] = {}
    if "mcap" in formats:
        layouts["mcap, zstd"] = lambda path: write_mcap(path, n_messages)
        layouts["mcap, not chunked"] = lambda path: unchunked(path, n_messages)
        layouts["mcap, one chunk"] = lambda path: one_chunk(path, n_messages)
    if "sqlite3" in formats:
        layouts["sqlite3"] = lambda path: write_sqlite3(path, n_messages)
    if "rosbag1" in formats:
        layouts["rosbag1, lz4"] = lambda path: write_rosbag1(path, n_messages)
    for name, write in layouts.items():
        with tempfile.TemporaryDirectory(dir=folder) as place:
            path = Path(place) / "log"
            write(path)
            run = child("--drain", str(path))
            print(
                f"| {name} | {run.get('n')} | {run.get('cpu_s', 0):.1f} | {run.get('wall_s', 0):.1f} "
                f"| {run.get('peak', 0) / 2**20:.0f} | {run.get('why', '')}",
                flush=True,
            )


def unchunked(path: Path, n_messages: int) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("ros2")
        schema = writer.register_schema(
            "tf2_msgs/msg/TFMessage", "ros2msg", definition(is_ros1=False).encode()
        )
        channel = writer.register_channel("/tf", "cdr", schema)
        for stamp, payload in payloads(n_messages, is_ros1=False):
            writer.add_message(channel, stamp, payload, stamp)
        writer.finish()


def one_chunk(path: Path, n_messages: int) -> None:
    """All messages in a single zstd chunk, written as a stream since no library holds it."""
    import struct

    import zstandard

    text = definition(is_ros1=False).encode()

    def record(op: int, body: bytes) -> bytes:
        return struct.pack("<BQ", op, len(body)) + body

    def string(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    declared = record(
        3, struct.pack("<H", 1) + string(b"tf2_msgs/msg/TFMessage") + string(b"ros2msg") + string(text)
    )
    declared += record(4, struct.pack("<HH", 0, 1) + string(b"/tf") + string(b"cdr") + struct.pack("<I", 0))
    magic = b"\x89MCAP0\r\n"
    with path.open("wb") as file:
        file.write(magic + record(1, string(b"ros2") + string(b"")))
        at = file.tell()
        head = struct.Struct("<BQQQQII4sQ")
        file.write(bytes(head.size))
        packer = zstandard.ZstdCompressor(level=1).compressobj()
        n_unpacked = len(declared)
        file.write(packer.compress(declared))
        last = START_NS
        for number, (stamp, payload) in enumerate(payloads(n_messages, is_ros1=False)):
            data = record(5, struct.pack("<HIQQ", 0, number, stamp, stamp) + payload)
            n_unpacked += len(data)
            file.write(packer.compress(data))
            last = stamp
        file.write(packer.flush())
        end = file.tell()
        file.write(record(15, bytes(4)) + record(2, bytes(20)) + magic)
        file.seek(at)
        length = end - at - 9
        packed = end - at - head.size
        file.write(head.pack(6, length, START_NS, last, n_unpacked, 0, 4, b"zstd", packed))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=7, help="runs of the fast readers [7]")
    parser.add_argument("--slow-runs", type=int, default=3, help="runs of the slow readers [3]")
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the log [10]")
    parser.add_argument("--format", choices=list(FORMATS), action="append", help="only this format")
    parser.add_argument("--large", action="store_true", help="also logs of 2 GiB: time and peak memory")
    parser.add_argument("--large-only", action="store_true", help="only logs of 2 GiB")
    parser.add_argument("--gib", type=float, default=2.0, help="size of the large logs [2]")
    parser.add_argument("--folder", type=Path, help="keep the logs here, and use what is there")
    parser.add_argument("--one", nargs=3, metavar=("FORMAT", "READER", "PATH"), help=argparse.SUPPRESS)
    parser.add_argument("--drain", metavar="PATH", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        measure(options.one[0], options.one[1], Path(options.one[2]))
        return
    if options.drain:
        drain(Path(options.drain))
        return
    with tempfile.TemporaryDirectory(prefix="demoplan-") as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        formats = options.format or list(FORMATS)
        if not options.large_only:
            table(folder, round(options.minutes * 60 * RATE_HZ), options.runs, formats, options.slow_runs)
        if options.large or options.large_only:
            large(folder, formats, round(options.gib * 2**30))


if __name__ == "__main__":
    main()
