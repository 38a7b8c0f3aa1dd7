"""The place that a path or URL names."""

from pathlib import Path

from demoplan.errors import StoreError
from demoplan.store.folder import Folder
from demoplan.store.places import BUCKET_SCHEME, Place


def open_place(location: str | Path) -> Place:
    """The place of that path or URL; nothing is made, and nothing is asked of it yet.

    Raises:
        StoreError: If the URL is of an unknown kind, or what a bucket needs is not installed.
    """
    text = str(location)
    if text.startswith(BUCKET_SCHEME):
        # A bucket needs an extra.
        from demoplan.store.bucket import Bucket  # noqa: PLC0415

        return Bucket(text)
    if "://" in text:
        raise StoreError(f"{text}: unknown kind of store; known: a folder, {BUCKET_SCHEME}BUCKET/PREFIX")
    return Folder(Path(location))
