import random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from demoplan.errors import LogError
from demoplan.logs import inspect, read

NAMES = [
    "mcap zstd",
    "mcap lz4",
    "mcap none",
    "mcap without chunks",
    "rosbag1",
    "rosbag1 bz2",
    "rosbag1 lz4",
    "sqlite3",
]


def file_of(path):
    return next(path.glob("*.db3")) if path.is_dir() else path


@pytest.mark.parametrize("name", NAMES)
def test_what_a_cut_log_still_holds_is_read(name, making, tmp_path):
    recording = making.demonstration(400)
    path = file_of(making.WRITERS[name](tmp_path, recording))
    data = path.read_bytes()
    whole = read(path, making.MAPPING, "e")
    cut = tmp_path / ("cut" + path.suffix)
    found = []
    for percent in (30, 60, 90):
        cut.write_bytes(data[: len(data) * percent // 100])
        part = read(cut, making.MAPPING, "e")
        assert part.status == "truncated"
        assert part.reason
        found.append(part.topics["n_messages"].sum() / whole.topics["n_messages"].sum())
    # Definitions and indexes take their share of the bytes.
    assert all(share >= bound for share, bound in zip(found, (0.15, 0.4, 0.7), strict=True)), found


def test_a_log_cut_before_a_required_topic_begins_says_both(making, recording, tmp_path):
    path = making.to_mcap(tmp_path / "a.mcap", recording)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(LogError, match=r"no topic .*truncated"):
        read(path, making.MAPPING, "e")


def test_a_damaged_chunk_costs_only_itself(making, recording, tmp_path):
    path = making.to_mcap(tmp_path / "a.mcap", recording)
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    data = bytearray(path.read_bytes())
    start = chunks[len(chunks) // 2].chunk_start_offset
    data[start + 60 : start + 100] = bytes(40)
    path.write_bytes(data)
    found = read(path, making.MAPPING, "e")
    assert found.status == "truncated"
    assert "does not decompress" in found.reason
    assert 0.9 < found.topics["n_messages"].sum() / 480 < 1


@pytest.fixture(scope="module")
def logs(making, tmp_path_factory):
    folder = tmp_path_factory.mktemp("damage")
    recording = making.demonstration(30)
    for name in NAMES:
        place = folder / f"place of {name}"
        place.mkdir()
        (folder / name).write_bytes(file_of(making.WRITERS[name](place, recording)).read_bytes())
    return folder


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(NAMES), seed=st.integers(0, 2**32), n_flips=st.integers(1, 30))
def test_damage_of_any_kind_ends_in_a_reading_or_a_sentence(name, seed, n_flips, making, logs):
    data = bytearray((logs / name).read_bytes())
    chance = random.Random(seed)
    for _ in range(n_flips):
        data[chance.randrange(len(data))] = chance.randrange(256)
    path = logs / "damaged"
    path.write_bytes(data)
    for look in (lambda: read(path, making.MAPPING, "e"), lambda: inspect(path)):
        try:
            look()
        except LogError as error:
            assert str(error)
