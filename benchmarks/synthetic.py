"""Demonstrations by the thousand, as real MCAP logs: recorded physics, set anew for every episode.

Each episode has two hands and six cubes, and lasts 30 s. Its left hand and three of its cubes come from one
shipped recording in which a left hand stacks, its right hand and the other three cubes from another one in
which a right hand does; each of the two scenes is turned and moved on its half of the table, slowed down to
the length of the episode at a pace that varies, and seen through noise of its own. No two episodes have a
reading in common. Poses come at 60 Hz, as from motion capture; grips at 60 Hz.

The bytes are put together without a loop over messages, so that writing takes a fraction of what is measured.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zstandard
from rosbags.typesys import Stores, get_typestore

from demoplan.geometry import multiply, normalised, rotate
from demoplan.logs import read
from demoplan.logs.writing import JoyStream, PoseStream, Stamped, Stream, TransformStream, serialised
from demoplan.pipeline.datasets import open_dataset
from demoplan.stages.align import align

ROOT = Path(__file__).resolve().parents[1]
RECORDED = ROOT / "datasets" / "cube-stacking"
CUBES = ("cube_red", "cube_blue", "cube_green")
LENGTH_S = 30.0
RATE_HZ = 60.0
NOISE_M, NOISE_RAD = 0.0003, 0.001
"""Of one reading; a good motion capture."""
_CHUNK_BYTES = 1 << 20


@dataclass(frozen=True)
class Side:
    """One hand and its three cubes, as recorded; ``n`` instants at 100 Hz."""

    name: str
    hand: str
    position_xyz_m: np.ndarray
    """``(4, n, 3)``: the hand, then the cubes."""
    orientation_wxyz: np.ndarray
    """``(4, n, 4)``"""
    grip: np.ndarray
    """``(n,)``"""


def sides() -> dict[str, list[Side]]:
    """Hand → its shipped recordings, on the world's clock, from the tables that demoplan makes of them."""
    opened = open_dataset(RECORDED)
    found: dict[str, list[Side]] = {"Left_hand": [], "Right_hand": []}
    for episode in opened.dataset.episodes:
        if not episode.task.startswith("two"):
            continue
        frames = align(
            read(opened.log_of(episode), opened.dataset.mapping, episode.id).samples, opened.dataset.mapping
        )
        of = {str(key[0]): rows for key, rows in frames.partition_by("entity", as_dict=True).items()}
        known = [of[name] for name in (episode.hand, *CUBES)]
        is_whole = np.all([rows["position_xyz_m"].is_not_null().to_numpy() for rows in known], axis=0)
        inside = slice(int(np.argmax(is_whole)), len(is_whole) - int(np.argmax(is_whole[::-1])))
        blocks = [
            rows[inside].with_columns(rows["grip"][inside].fill_null(strategy="forward")) for rows in known
        ]
        position = np.stack([_filled(b["position_xyz_m"], 3) for b in blocks])
        orientation = np.stack([_filled(b["orientation_wxyz"], 4) for b in blocks])
        grip = np.nan_to_num(blocks[0]["grip"].to_numpy(), nan=1.0)
        found[episode.hand].append(Side(episode.id, episode.hand, position, orientation, grip))
    return found


def _filled(column, width):
    values = np.array(column.fill_null(strategy="forward").to_list(), dtype=np.float64)
    return values.reshape(-1, width)


def streams_of(recorded: dict[str, list[Side]], seed: int, index: int) -> list[Stream]:
    """What the sensors of one episode tell; every episode its own, given seed and index."""
    rng = np.random.default_rng([seed, index])
    start_ns = 1_700_000_000_000_000_000 + index * 60_000_000_000
    n = round(LENGTH_S * RATE_HZ)
    stamps = []
    for _ in range(3):
        header = start_ns + np.cumsum(rng.normal(1e9 / RATE_HZ, 2e5, n)).astype(np.int64)
        latency = rng.exponential(1.5e6, n).astype(np.int64)
        log = np.maximum.accumulate(header + 500_000 + latency)
        stamps.append(Stamped(header, header, log))
    found: list[Stream] = [
        TransformStream(
            "/tf_static",
            Stamped(*(np.array([start_ns], np.int64) for _ in range(3))),
            "world",
            ("table",),
            np.zeros((1, 1, 3)),
            np.array([[[1.0, 0.0, 0.0, 0.0]]]),
            np.ones((1, 1), np.bool_),
            is_static=True,
        )
    ]
    cubes_xyz, cubes_wxyz, names = [], [], []
    for number, (hand, offset_y) in enumerate((("Left_hand", 0.45), ("Right_hand", -0.45))):
        side = recorded[hand][int(rng.integers(len(recorded[hand])))]
        position, orientation, grip = _posed(side, rng, offset_y, n)
        label = hand.split("_")[0].lower()
        found.append(PoseStream(f"/hand/{label}/pose", stamps[number], "world", position[0], orientation[0]))
        found.append(JoyStream(f"/hand/{label}/joy", stamps[number], "world", 1.0 - grip[:, None]))
        cubes_xyz.append(position[1:])
        cubes_wxyz.append(orientation[1:])
        names += [f"{cube}_{label}" for cube in CUBES]
    found.append(
        TransformStream(
            "/tf",
            stamps[2],
            "world",
            tuple(names),
            np.concatenate(cubes_xyz).swapaxes(0, 1).copy(),
            np.concatenate(cubes_wxyz).swapaxes(0, 1).copy(),
            np.ones((n, 6), np.bool_),
        )
    )
    return found


def _posed(side: Side, rng: np.random.Generator, offset_y: float, n: int):
    """One side's motion, slowed to the episode's length, elsewhere on the table, with noise."""
    length = side.position_xyz_m.shape[1]
    pace = np.interp(np.linspace(0, 1, n), np.linspace(0, 1, 7), rng.uniform(0.7, 1.3, 7))
    at = np.cumsum(pace)
    at = (at - at[0]) / (at[-1] - at[0]) * (length - 1)
    low = np.minimum(at.astype(np.intp), length - 2)
    share = (at - low)[:, None]
    position = side.position_xyz_m[:, low] * (1 - share) + side.position_xyz_m[:, low + 1] * share
    one, other = side.orientation_wxyz[:, low], side.orientation_wxyz[:, low + 1]
    other = np.where((one * other).sum(axis=-1, keepdims=True) < 0, -other, other)
    orientation = normalised(one * (1 - share) + other * share)
    angle = rng.uniform(-0.6, 0.6)
    turn = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    middle = np.append(side.position_xyz_m[1:, :, :2].mean(axis=(0, 1)), 0.0)
    place = np.array([rng.uniform(-0.05, 0.05), offset_y + rng.uniform(-0.03, 0.03), 0.0])
    position = rotate(np.broadcast_to(turn, (*position.shape[:2], 4)), position - middle) + place
    orientation = multiply(np.broadcast_to(turn, orientation.shape), orientation)
    position = position + rng.normal(0, NOISE_M, position.shape)
    orientation = normalised(orientation + rng.normal(0, NOISE_RAD / 2, orientation.shape))
    return position.round(6), orientation.round(6), side.grip[low].clip(0.0, 1.0).round(4)


def write_mcap(path: Path, streams: Sequence[Stream]) -> None:
    """A chunked, indexed MCAP file with these streams, in order of receipt."""
    types = {
        TransformStream: "tf2_msgs/msg/TFMessage",
        PoseStream: "geometry_msgs/msg/PoseStamped",
        JoyStream: "sensor_msgs/msg/Joy",
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n" + _record(1, _text("ros2") + _text("demoplan benchmark")))
        ids = {name: number for number, name in enumerate(types.values(), 1)}
        for name, number in ids.items():
            head = struct.pack("<H", number) + _text(name) + _text("ros2msg")
            file.write(_record(3, head + _text(_definition(name))))
        channels = list(range(1, len(streams) + 1))
        for channel, stream in zip(channels, streams, strict=True):
            head = struct.pack("<HH", channel, ids[types[type(stream)]]) + _text(stream.topic) + _text("cdr")
            file.write(_record(4, head + struct.pack("<I", 0)))
        records, times, owners = _records(streams, channels)
        ends = np.cumsum([len(record) for record in records])
        number_of = ends // _CHUNK_BYTES
        for number in np.unique(number_of):
            rows = np.flatnonzero(number_of == number)
            data = b"".join(records[row] for row in rows)
            file.write(_chunk(data, times[rows]))
            offsets = ends[rows] - ends[rows[0]] + len(records[rows[0]])
            offsets = np.append(0, offsets[:-1])
            for channel in channels:
                mine = owners[rows] == channel
                if mine.any():
                    entries = np.stack([times[rows][mine], offsets[mine]], axis=1).astype("<u8").tobytes()
                    file.write(_record(7, struct.pack("<HI", channel, len(entries)) + entries))
        file.write(_record(15, bytes(4)) + _record(2, bytes(20)) + b"\x89MCAP0\r\n")


def _record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def _text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data


_DEFINITIONS: dict[str, str] = {}


def _definition(name: str) -> str:
    if name not in _DEFINITIONS:
        _DEFINITIONS[name] = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(name, ros_version=2)[0]
    return _DEFINITIONS[name]


def _records(streams: Sequence[Stream], channels: Sequence[int]):
    """Message records in order of receipt, with their times and channels."""
    payloads = [serialised(stream, is_cdr=True) for stream in streams]
    counts = [len(each) for each in payloads]
    owner = np.repeat(np.arange(len(streams)), counts)
    sequence = np.concatenate([np.arange(count) for count in counts])
    received = np.concatenate([stream.stamps.log_ns for stream in streams])
    published = np.concatenate([stream.stamps.publish_ns for stream in streams])
    head = np.zeros(
        len(owner),
        np.dtype([("op", "u1"), ("n", "<u8"), ("c", "<u2"), ("s", "<u4"), ("l", "<u8"), ("p", "<u8")]),
    )
    flat = [payload for each in payloads for payload in each]
    head["op"], head["n"] = 5, np.array([len(payload) for payload in flat]) + 22
    head["c"], head["s"], head["l"], head["p"] = np.array(channels)[owner], sequence, received, published
    heads, size = head.tobytes(), head.itemsize
    order = np.lexsort((sequence, owner, received))
    return (
        [heads[k * size : (k + 1) * size] + flat[k] for k in order],
        received[order],
        np.array(channels)[owner[order]],
    )


def _chunk(data: bytes, times: np.ndarray) -> bytes:
    packed = zstandard.ZstdCompressor(level=1).compress(data)
    body = struct.pack("<QQQII", int(times.min()), int(times.max()), len(data), 0, 4) + b"zstd"
    body += struct.pack("<Q", len(packed)) + packed
    return _record(6, body)


def write_dataset(folder: Path, n_episodes: int, name: str) -> Path:
    """The manifest of so many episodes, and a copy of the vocabulary; logs are written apart."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "vocabulary.yaml").write_text((ROOT / "schemas/vocabularies/tabletop.yaml").read_text())
    cubes = [f"{cube}_{side}" for side in ("left", "right") for cube in CUBES]
    lines = [
        f"name: {name}",
        "vocabulary: vocabulary.yaml",
        "mapping:",
        "  world: world",
        "  clock: header",
        "  entities:",
        "    Left_hand: {type: Hand}",
        "    Right_hand: {type: Hand}",
        *[f"    {cube}: {{type: WoodenCube}}" for cube in cubes],
        "    table:",
        "      type: Table",
        "      shape: {kind: box, size_xyz_m: [1.0, 2.0, 0.04], centre_xyz_m: [0.0, 0.0, -0.02]}",
        "  topics:",
        "    /tf_static: {kind: transforms, static: true, entities: {table: table}}",
        f"    /tf: {{kind: transforms, entities: {{{', '.join(f'{c}: {c}' for c in cubes)}}}}}",
    ]
    for hand in ("left", "right"):
        entity = f"{hand.title()}_hand"
        lines.append(f"    /hand/{hand}/pose: {{kind: pose, entity: {entity}}}")
        lines.append(
            f"    /hand/{hand}/joy: {{kind: grip, entity: {entity}, field: 'axes[0]', open_at: 0.0, "
            "closed_at: 1.0}"
        )
    lines.append("episodes:")
    lines += [
        f"  - {{id: {episode_id(k)}, file: {file_of(k)}, participant: p{k % 50}, task: two-and-two}}"
        for k in range(n_episodes)
    ]
    (folder / "dataset.yaml").write_text("\n".join(lines) + "\n")
    return folder


def episode_id(index: int) -> str:
    return f"e{index:05d}"


def file_of(index: int) -> str:
    return f"logs/{index // 500:03d}/{episode_id(index)}.mcap"
