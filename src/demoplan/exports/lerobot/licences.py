"""Which words of a manifest name a licence that lets data be passed on."""

_PERMITTING = (
    "apache-2.0",
    "mit",
    "bsd-2-clause",
    "bsd-3-clause",
    "cc0-1.0",
    "cc-by-3.0",
    "cc-by-4.0",
    "cc-by-sa-3.0",
    "cc-by-sa-4.0",
    "cc-by-nc-3.0",
    "cc-by-nc-4.0",
    "cc-by-nc-sa-3.0",
    "cc-by-nc-sa-4.0",
    "cdla-permissive-1.0",
    "cdla-permissive-2.0",
    "cdla-sharing-1.0",
    "odbl",
    "odc-by",
    "pddl",
    "unlicense",
)
"""Identifiers as dataset cards write them: SPDX, in lower case. All of them let the data be redistributed."""

_SAME = {"odbl-1.0": "odbl", "odc-by-1.0": "odc-by", "pddl-1.0": "pddl"}


def licence_id(stated: str) -> str | None:
    """The identifier of a licence that lets data be passed on; None if the words name no such licence.

    >>> licence_id("Apache-2.0"), licence_id("none stated; for local evaluation only"), licence_id("")
    ('apache-2.0', None, None)
    """
    name = stated.strip().lower().replace(" ", "-")
    name = _SAME.get(name, name)
    return name if name in _PERMITTING else None
