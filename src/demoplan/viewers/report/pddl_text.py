"""PDDL text with light colouring, token by token; what is not PDDL stays as it is."""

import re

from markupsafe import Markup

from demoplan.viewers.report.markup import text

_TOKEN = re.compile(
    r"(?P<comment>;[^\n]*)|(?P<keyword>:[A-Za-z][\w-]*)|(?P<variable>\?[A-Za-z][\w-]*)"
    r"|(?P<number>(?<![\w-])\d+(?:\.\d+)?(?![\w-]))|(?P<word>[A-Za-z][\w-]*)|(?P<bracket>[()])",
)
_CONNECTIVES = frozenset(
    {"define", "domain", "problem", "and", "not", "or", "forall", "when", "increase", "either"}
)


def coloured(pddl: str) -> Markup:
    """PDDL as HTML for a ``pre``: the same text, with classes on its tokens.

    >>> coloured("(not (clear ?x))")
    Markup('(<b>not</b> (clear <var>?x</var>))')
    """
    parts = []
    last = 0
    for match in _TOKEN.finditer(pddl):
        parts.append(text(pddl[last : match.start()]))
        last = match.end()
        word = text(match.group())
        if match["comment"]:
            parts.append(Markup("<i>{}</i>").format(word))
        elif match["keyword"]:
            parts.append(Markup("<em>{}</em>").format(word))
        elif match["variable"]:
            parts.append(Markup("<var>{}</var>").format(word))
        elif match["number"]:
            parts.append(Markup("<u>{}</u>").format(word))
        elif match["word"] and match.group().lower() in _CONNECTIVES:
            parts.append(Markup("<b>{}</b>").format(word))
        else:
            parts.append(word)
    parts.append(text(pddl[last:]))
    return Markup("").join(parts)
