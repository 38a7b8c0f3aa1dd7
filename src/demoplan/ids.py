"""Names of things, as distinct types; and what a safe name is."""

import hashlib
import re
from typing import NewType

EpisodeId = NewType("EpisodeId", str)
"""Names one recorded demonstration; safe as a file name."""

DomainId = NewType("DomainId", str)
"""First 16 hex digits of the SHA-256 of a domain's canonical text."""

ContentHash = NewType("ContentHash", str)
"""SHA-256 of some bytes, 64 hex digits."""

_SAFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")


def is_safe_name(name: str) -> bool:
    """Whether a name can stand as one path component: no separators, no leading dot, at most 128 characters.

    >>> is_safe_name("p1-one-left"), is_safe_name("../p1"), is_safe_name("")
    (True, False, False)
    """
    return _SAFE.fullmatch(name) is not None


def content_hash(*parts: bytes | str) -> ContentHash:
    """SHA-256 over parts, each preceded by its length, so that no two lists of parts collide by joining.

    >>> content_hash("ab", "c") == content_hash("a", "bc")
    False
    """
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return ContentHash(digest.hexdigest())
