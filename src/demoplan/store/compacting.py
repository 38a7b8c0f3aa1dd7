"""Many small files into few large ones; what is there stays until the large ones are proven to hold it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import pyarrow as pa
import pyarrow.parquet as pq

from demoplan.errors import StoreError
from demoplan.ids import ContentHash
from demoplan.store.shards import FOLDER, Spot, write_shard
from demoplan.store.store import SWEEP, Store

SHARD_BYTES = 100_000_000
"""A shard is closed when it holds tables of so many bytes."""

MOST_PARTS = 1000
"""A shard is closed when it holds so many tables: its footer, which every reader reads, grows with them."""

FULL_SHARE = 0.5
"""Shards smaller than this share of a full one, by bytes and by tables, are joined with what is new."""


@dataclass(frozen=True, kw_only=True)
class Compacted:
    """What was put into shards."""

    shard: str
    table: str
    """Name of the table, or ``records``."""
    n_parts: int
    n_bytes: int


@dataclass(frozen=True, kw_only=True, order=True)
class _Part:
    """One table that is to go into a shard."""

    episode_id: str
    dataset: str
    content: str
    n_bytes: int
    spot: Spot | None
    """Where it is now, if it is in a shard already."""


def compact(
    store: Store,
    *,
    shard_bytes: int = SHARD_BYTES,
    on_done: Callable[[str], None] = lambda _: None,
) -> list[Compacted]:
    """Put the tables that the manifest names, and all records, into shards.

    Nothing is removed: sweeping takes away small files that a shard holds, and shards that others hold.
    Killed at any moment, a shard is wholly there or not at all.

    Args:
        store: The store. Writers go on; sweeping waits.
        shard_bytes: How large shards become.
        on_done: Called with the name of each table when its shards are there, then with ``records``.

    Raises:
        StoreError: If a table cannot be read: `verify` names it. The shards that are done stay.
    """
    done = []
    with store.place.guard(SWEEP, is_shared=True):
        for name, parts in sorted(_parts(store).items()):
            for chosen in _chosen(store, name, parts, shard_bytes):
                done += _shard(store, name, chosen)
            on_done(name)
        packed = _pack(store, shard_bytes)
        if packed is not None:
            done.append(packed)
        on_done("records")
    return done


def _parts(store: Store) -> dict[str, list[_Part]]:
    """Table name → what the manifest names of it, in order of episode; equal tables once."""
    sizes = {PurePosixPath(e.name).stem: e.n_bytes for e in store.place.entries(store.objects.folder)}
    spots = store.shards.contents()
    found: dict[str, dict[str, _Part]] = {}
    for state in store.manifest.episodes():
        for name, content in state.tables.items():
            part = _Part(
                episode_id=state.episode_id,
                dataset=state.dataset,
                content=content,
                n_bytes=sizes.get(content, 0),
                spot=spots.get(content),
            )
            if part.spot is not None or content in sizes:
                found.setdefault(name, {}).setdefault(content, part)
    return {name: sorted(parts.values(), key=_order) for name, parts in found.items()}


def _order(part: _Part) -> tuple[str, str, str]:
    return part.episode_id, part.dataset, part.content


def _chosen(store: Store, name: str, parts: Sequence[_Part], shard_bytes: int) -> Iterator[list[_Part]]:
    """Groups of parts, each of which becomes a shard: what is new, and what small shards hold."""
    sizes = {entry.name: entry.n_bytes for entry in store.shards.entries()}
    mine = {part.spot.shard for part in parts if part.spot is not None}
    n_parts = {shard: len(store.shards.spots_of(shard)) for shard in mine}
    small = {
        shard
        for shard in mine
        if sizes[shard] < FULL_SHARE * shard_bytes and n_parts[shard] < FULL_SHARE * MOST_PARTS
    }
    new = [part for part in parts if part.spot is None]
    if not new and len(small) < 2:
        return
    n_in_shard = {shard: sum(p.spot is not None and p.spot.shard == shard for p in parts) for shard in small}
    group: list[_Part] = []
    n_bytes = 0.0
    for part in parts:
        if part.spot is not None and part.spot.shard not in small:
            continue
        group.append(part)
        n_bytes += part.n_bytes or (sizes[part.spot.shard] / n_in_shard[part.spot.shard] if part.spot else 0)
        if n_bytes >= shard_bytes or len(group) >= MOST_PARTS:
            yield group
            group, n_bytes = [], 0.0
    if group:
        yield group


def _shard(store: Store, name: str, parts: Sequence[_Part]) -> list[Compacted]:
    """Write parts as shards, one for each schema among them, and prove that these hold them."""
    by_schema: dict[pa.Schema, list[_Part]] = {}
    for part in parts:
        schema = _read(store, part).schema
        key = next((known for known in by_schema if known.equals(schema, check_metadata=True)), schema)
        by_schema.setdefault(key, []).append(part)
    made = []
    for members in by_schema.values():
        with store.place.draft(".parquet") as draft:
            content = write_shard(((part.content, _read(store, part)) for part in members), draft)
            _prove(store, draft, members)
            shard = f"{FOLDER}/{name}/{content}.parquet"
            n_bytes = draft.stat().st_size
            store.place.settle(draft, shard)
        made.append(Compacted(shard=shard, table=name, n_parts=len(members), n_bytes=n_bytes))
    return made


def _read(store: Store, part: _Part) -> pa.Table:
    """A part as it was written: from its own file if there is one, else from its shard."""
    name = store.objects.name_of(ContentHash(part.content))
    if part.spot is not None:
        return store.shards.read_spot(part.spot)
    if not store.objects.is_intact(ContentHash(part.content)):
        raise StoreError(
            f"{store.location}: {name} is damaged, and is not put into a shard; "
            "`demoplan store repair` sets it aside, `demoplan reprocess` makes it again"
        )
    with store.place.open(name) as file:
        return pq.ParquetFile(file).read(use_threads=False)


def _prove(store: Store, draft: Path, parts: Sequence[_Part]) -> None:
    """Read every part back from a written shard.

    Raises:
        StoreError: If one is not as it was.
    """
    with pq.ParquetFile(draft) as file:
        group = 0
        for part in parts:
            expected = _read(store, part)
            n_groups = int(len(expected) > 0)
            found = file.read_row_groups(list(range(group, group + n_groups)), use_threads=False)
            group += n_groups
            if not found.equals(expected.replace_schema_metadata(found.schema.metadata)):
                raise StoreError(f"{store.location}: a shard does not hold {part.content} as it was")


def _pack(store: Store, shard_bytes: int) -> Compacted | None:
    """Put records that are files of their own into a pack, together with small packs."""
    loose = store.records.loose()
    entries = store.place.entries(store.packs.folder)
    small = [entry.name for entry in entries if entry.n_bytes < FULL_SHARE * shard_bytes]
    packed = {key for entry in entries for key in store.packs.records_of(entry.name)}
    if loose <= packed and len(small) < 2:
        return None
    records = {key: record for name in small for key, record in store.packs.records_of(name).items()}
    for stage, key in loose:
        record = store.records.get(stage, key)
        if record is not None:
            records[stage, key] = record
    name = store.packs.put(records.values())
    entry = store.place.entry(name)
    return Compacted(shard=name, table="records", n_parts=len(records), n_bytes=entry.n_bytes if entry else 0)
