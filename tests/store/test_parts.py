"""A table that is written part by part has the bytes of one that is written at once."""

import itertools

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.store import Store, objects
from demoplan.tables import Frames


def frames(n, seed=0):
    rng = np.random.default_rng(seed)
    is_seen = pl.Series(rng.random(n) < 0.8)
    return Frames.validate(
        pl.DataFrame(
            {
                "episode_id": ["e"] * n,
                "entity": sorted(f"cube_{k}" for k in rng.integers(3, size=n)),
                "tick_ns": np.arange(n) * 10_000_000,
                "position_xyz_m": rng.normal(size=(n, 3)),
                "orientation_wxyz": rng.normal(size=(n, 4)),
                "grip": rng.random(n),
                "pose_age_ns": rng.integers(10**8, size=n),
            }
        ).with_columns(pl.when(is_seen).then(pl.col("position_xyz_m", "orientation_wxyz", "pose_age_ns"))),
        cast=True,
    )


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 3000), st.lists(st.integers(0, 3000), max_size=6), st.sampled_from([64, 1000, 1 << 20]))
def test_the_bytes_are_the_same_wherever_the_parts_end(tmp_path_factory, n, cuts, rows_at_once):
    table = frames(n)
    bounds = [0, *sorted(min(cut, n) for cut in cuts), n]
    parts = [table[start:end] for start, end in itertools.pairwise(bounds)]
    folder = tmp_path_factory.mktemp("parts")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(objects, "ROWS_AT_ONCE", rows_at_once)
        whole = objects.write_table(table, Frames, folder / "whole.parquet")
    found = objects.write_parts(parts, Frames, folder / "parts.parquet", rows_at_once)
    assert (folder / "parts.parquet").read_bytes() == (folder / "whole.parquet").read_bytes()
    assert found == whole


def test_a_drafted_table_is_there_once_it_is_put_and_reads_back_in_parts(tmp_path, monkeypatch):
    store, table = Store(tmp_path), frames(500)
    with store.objects.drafted(table.iter_slices(90), Frames) as draft:
        assert not store.objects.has(draft.content)
        assert pl.concat(list(draft.parts(Frames))).equals(table)
        assert store.objects.put(draft, Frames) == draft.content
    with store.objects.drafted([table[:10]], Frames) as forgotten:
        pass
    assert not store.objects.has(forgotten.content)
    assert not forgotten.path.exists()
    content = draft.content
    assert store.objects.put(table, Frames) == content
    assert pl.concat(list(store.objects.parts(content, Frames))).equals(table)
    sizes = [200, 200, 100]
    assert [len(part) for part in objects.parts_of(store.objects.path_of(content), Frames, 200)] == sizes
    assert store.objects.n_rows(content) == 500
    assert store.objects.extent(content, "tick_ns") == (0, 499 * 10_000_000)
