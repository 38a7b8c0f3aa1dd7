"""Text to nested lists, with places: the part of PDDL that has no meaning yet."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from demoplan.errors import PddlError

_TOKEN = re.compile(
    r"(?P<space>[ \t\r\f\v]+)|(?P<newline>\n)|(?P<comment>;[^\n]*)|(?P<bracket>[()])|(?P<word>[^\s();]+)"
)
_WORD = re.compile(r"[!-~]+")
_MAX_DEPTH = 64
"""PDDL as we read it nests six deep; what nests deeper is not PDDL but an attack on the reader."""


@dataclass(frozen=True)
class Place:
    """Where something stands: line and column, from 1."""

    line: int
    column: int

    def __str__(self) -> str:
        """As messages name it."""
        return f"line {self.line}, column {self.column}"


@dataclass(frozen=True)
class Word:
    """A name, a number or a keyword, in lower case, as PDDL does not tell case apart."""

    text: str
    place: Place


@dataclass
class Expression:
    """A bracketed list, and the comments that stand directly in it."""

    place: Place
    items: "list[Node]" = field(default_factory=list)
    comments: list[str] = field(default_factory=list)


Node: TypeAlias = Word | Expression


def shown(node: Node) -> str:
    """A node as short text for a message."""
    if isinstance(node, Word):
        return repr(node.text)
    first = next((item.text for item in node.items if isinstance(item, Word)), "")
    return f"'({first} …)'" if first else "a list"


def read(text: str) -> tuple[list[Expression], list[str]]:
    """Every top-level list of a text, and the comments outside of them.

    Raises:
        PddlError: If brackets do not match, nest too deep, or a character has no place in PDDL.
    """
    root = Expression(Place(1, 1))
    open_lists = [root]
    for kind, piece, place in _tokens(text):
        innermost = open_lists[-1]
        if kind == "comment":
            innermost.comments.append(piece)
        elif piece == "(":
            if len(open_lists) > _MAX_DEPTH:
                raise PddlError(f"{place}: brackets nest deeper than {_MAX_DEPTH}")
            opened = Expression(place)
            innermost.items.append(opened)
            open_lists.append(opened)
        elif piece == ")":
            if innermost is root:
                raise PddlError(f"{place}: ')' without a '(' before it")
            open_lists.pop()
        elif innermost is root:
            raise PddlError(f"{place}: expected '(', found {piece!r}")
        else:
            innermost.items.append(Word(piece.lower(), place))
    if len(open_lists) > 1:
        raise PddlError(f"{open_lists[-1].place}: '(' is never closed")
    return [item for item in root.items if isinstance(item, Expression)], root.comments


def _tokens(text: str) -> Iterator[tuple[str, str, Place]]:
    line, line_start, position = 1, 0, 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        place = Place(line, position - line_start + 1)
        if match is None:
            raise PddlError(f"{place}: unexpected character {text[position]!r}")
        kind = str(match.lastgroup)
        if kind == "newline":
            line, line_start = line + 1, match.end()
        elif kind == "word" and not _WORD.fullmatch(match[0]):
            raise PddlError(f"{place}: PDDL names are ASCII; found {match[0][:40]!r}")
        elif kind != "space":
            yield kind, match[0], place
        position = match.end()
