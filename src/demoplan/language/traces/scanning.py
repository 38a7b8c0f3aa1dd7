"""The text of a trace cut into states and actions, whatever learner it was written for.

Expressions here never have two repetitions side by side that could share a text: a hostile file costs no more
time than a friendly one of its length.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

LEAF = re.compile(r"\(([^()]*)\)")
"""An innermost list: an atom, or an action with its objects."""
NEGATION = re.compile(r"\(\s*not\s*\(([^()]*)\)\s*\)", re.IGNORECASE)
_ITEM = re.compile(r"\(\s*(:state|:init|:action|:operator|operator:)(?=[\s()])", re.IGNORECASE)
_ACTIONS = frozenset({":action", ":operator", "operator:"})
# The next two are matched against texts whose white space was reduced to single blanks.
_HEAD = re.compile(r"\( ?(:?(trajectory|observation) ?)?\)?", re.IGNORECASE)
_PARTIAL_HEAD = re.compile(r"\( ?(:?(trajectory|observation) ?)?\(? ?:partial ?\)?", re.IGNORECASE)
_CONJUNCTION = re.compile(r"\s*\(\s*and(?=[\s()])", re.IGNORECASE)
_COMMENT = re.compile(r";[^\n]*")
_MAX_TEXT = 60


@dataclass(frozen=True)
class Item:
    """A state or an action as it stands in the text."""

    is_action: bool
    start: int
    """Where its contents begin."""
    body: str
    problem: str = ""
    """What is wrong with its brackets; empty if nothing is."""


def without_comments(text: str) -> str:
    """The text with comments blanked out, so that places stay where they were."""
    return _COMMENT.sub(lambda match: " " * len(match[0]), text) if ";" in text else text


def head_of(text: str) -> tuple[bool, str]:
    """Whether a trace says that its states are partial, and what is wrong with how it begins."""
    first = _ITEM.search(text)
    head = " ".join((text[: first.start()] if first else text).split())
    if _PARTIAL_HEAD.fullmatch(head):
        return True, ""
    is_fine = not head or _HEAD.fullmatch(head)
    return False, "" if is_fine else f"expected (:trajectory …), found {short(head)!r}"


def items(text: str) -> Iterator[Item]:
    """States and actions in order; what stands between them must be brackets that close."""
    openers = list(_ITEM.finditer(text))
    for n, opener in enumerate(openers):
        is_last = n + 1 == len(openers)
        body = text[opener.end() : len(text) if is_last else openers[n + 1].start()]
        yield Item(opener[1].lower() in _ACTIONS, opener.end(), body, _malformed(body, is_last=is_last))


def _malformed(body: str, *, is_last: bool) -> str:
    """What is wrong with the brackets of an item; empty if nothing is."""
    rest = LEAF.sub("", NEGATION.sub("", body))
    conjunction = _CONJUNCTION.match(rest)
    rest = "".join((rest[conjunction.end() :] if conjunction else rest).split())
    if rest.strip(")"):
        return f"not an atom: {short(rest.replace(')', ' ').strip())!r}"
    missing = 1 + bool(conjunction) + is_last - len(rest)
    return "" if missing == 0 else ("'(' is never closed" if missing > 0 else "')' without a '(' before it")


def short(text: str) -> str:
    """A text on one line, and not too long for a message."""
    words = " ".join(text[: 10 * _MAX_TEXT].split())
    return words if len(words) <= _MAX_TEXT else words[: _MAX_TEXT - 1] + "…"
