"""Tables and domain versions on disk, by content: added, never overwritten."""

from demoplan.store.domains import DomainStore, DomainVersion
from demoplan.store.manifest import EpisodeState, Manifest
from demoplan.store.objects import ObjectStore
from demoplan.store.records import Record, stage_key
from demoplan.store.store import Store

__all__ = [
    "DomainStore",
    "DomainVersion",
    "EpisodeState",
    "Manifest",
    "ObjectStore",
    "Record",
    "Store",
    "stage_key",
]
