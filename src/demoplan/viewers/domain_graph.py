"""A domain as a picture: what each operator needs, and what it changes.

Three columns: predicates that are needed, operators, predicates that are changed. SVG is laid out here, so
that it needs nothing; DOT is for Graphviz, which lays out larger domains better.
"""

from dataclasses import dataclass
from html import escape
from typing import Literal as Choice

from demoplan.language.atoms import Literal
from demoplan.language.domains import Domain, Operator
from demoplan.viewers.colours import activity_colour, hex_colour

_NEEDED, _CHANGED = "needs", "changes"
_COLOURS = {
    (_NEEDED, True): "#5b6770",
    (_NEEDED, False): "#b8860b",
    (_CHANGED, True): "#1b7f4b",
    (_CHANGED, False): "#b3261e",
}
"""By side and sign: grey is needed, ochre is needed to be false, green is made true, red is made false."""
_LEGEND = (
    ("needs", _COLOURS[_NEEDED, True]),
    ("needs its absence", _COLOURS[_NEEDED, False]),
    ("makes true", _COLOURS[_CHANGED, True]),
    ("makes false", _COLOURS[_CHANGED, False]),
)
_ROW, _BOX, _GAP, _MARGIN = 34, 24, 230, 16
_WIDTHS = {"left": 190, "middle": 400, "right": 190}


@dataclass(frozen=True)
class _Edge:
    operator: str
    predicate: str
    side: Choice["needs", "changes"]
    is_positive: bool
    label: str


def _edges(domain: Domain) -> list[_Edge]:
    edges: dict[tuple[str, str, Choice["needs", "changes"], bool], list[str]] = {}
    for operator in domain.operators:
        literals: tuple[tuple[Choice["needs", "changes"], frozenset[Literal]], ...] = (
            ("needs", operator.preconditions),
            ("changes", operator.effects),
        )
        for side, stated in literals:
            for each in sorted(stated):
                key = (operator.name, each.atom.predicate, side, each.is_positive)
                edges.setdefault(key, []).append(", ".join(each.atom.arguments))
    return [_Edge(*key, label="; ".join(labels)) for key, labels in sorted(edges.items())]


def _title(operator: Operator) -> str:
    parameters = ", ".join(f"{each.variable} {each.type_name}" for each in operator.parameters)
    return f"{operator.name}({parameters})"


def _fill(operator: Operator) -> str:
    return hex_colour(activity_colour(operator.activity or operator.name))


def domain_dot(domain: Domain) -> str:
    """The picture as a Graphviz description; the same bytes for the same domain."""
    lines = ["digraph domain {", "  rankdir=LR;", '  node [fontname="sans-serif", fontsize=11];']
    lines.append("  edge [arrowsize=0.7];")
    edges = _edges(domain)
    for side in ("needs", "changes"):
        names = sorted({edge.predicate for edge in edges if edge.side == side})
        lines += [f"  {_quoted(f'{side} {name}')} [label={_quoted(name)}, shape=ellipse];" for name in names]
    for operator in domain.operators:
        label = f"{_title(operator)}\\nseen {operator.count}, cost {operator.cost}"
        lines.append(
            f'  {_quoted(operator.name)} [label={_quoted(label)}, shape=box, style="rounded,filled", '
            f"fillcolor={_quoted(_fill(operator))}];"
        )
    for edge in edges:
        node = _quoted(f"{edge.side} {edge.predicate}")
        ends = (node, _quoted(edge.operator)) if edge.side == "needs" else (_quoted(edge.operator), node)
        style = "solid" if edge.is_positive else "dashed"
        colour = _COLOURS[edge.side, edge.is_positive]
        lines.append(f"  {ends[0]} -> {ends[1]} [color={_quoted(colour)}, style={style}];")
    return "\n".join([*lines, "}", ""])


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '\\"') + '"'


def domain_svg(domain: Domain) -> str:
    """The picture as SVG without external resources; the same bytes for the same domain."""
    edges = _edges(domain)
    columns = {
        "left": sorted({edge.predicate for edge in edges if edge.side == "needs"}),
        "middle": [operator.name for operator in domain.operators],
        "right": sorted({edge.predicate for edge in edges if edge.side == "changes"}),
    }
    n_rows = max(1, *(len(names) for names in columns.values()))
    top = 2 * _MARGIN + _BOX
    lefts = {
        "left": _MARGIN,
        "middle": _MARGIN + _WIDTHS["left"] + _GAP,
        "right": _MARGIN + _WIDTHS["left"] + _WIDTHS["middle"] + 2 * _GAP,
    }
    width = lefts["right"] + _WIDTHS["right"] + _MARGIN
    height = top + n_rows * _ROW * 2 + _MARGIN
    middles = {
        (column, name): top + (number + 0.5) * (n_rows * _ROW * 2) / len(names)
        for column, names in columns.items()
        for number, name in enumerate(names)
    }
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="system-ui, sans-serif" font-size="13">',
        f"<title>{escape(domain.name)}: what operators need and change</title>",
        f'<rect width="{width}" height="{height}" fill="white"/>',
        *_legend(),
    ]
    parts += [_line(edge, lefts, middles) for edge in edges]
    for column in ("left", "right"):
        for name in columns[column]:
            parts.append(_box(lefts[column], middles[column, name], _WIDTHS[column], name, "#f4f6f8", 12))
    for operator in domain.operators:
        parts.append(
            _box(
                lefts["middle"],
                middles["middle", operator.name],
                _WIDTHS["middle"],
                operator.name,
                _fill(operator),
                4,
                detail=", ".join(f"{each.variable} {each.type_name}" for each in operator.parameters),
            )
        )
    return "\n".join([*parts, "</svg>", ""])


def _legend() -> list[str]:
    parts, x = [], _MARGIN
    for text, colour in _LEGEND:
        parts.append(
            f'<line x1="{x}" y1="{_MARGIN + 4}" x2="{x + 28}" y2="{_MARGIN + 4}" stroke="{colour}" '
            f'stroke-width="2"/><text x="{x + 34}" y="{_MARGIN + 9}" fill="#30363b">{text}</text>'
        )
        x += 60 + 8 * len(text)
    return parts


def _line(edge: _Edge, lefts: dict[str, int], middles: dict[tuple[str, str], float]) -> str:
    # What is made true and what is made false of one predicate run beside each other.
    aside = -3 if edge.is_positive else 3
    operator = middles["middle", edge.operator] + aside
    if edge.side == "needs":
        start = (lefts["left"] + _WIDTHS["left"], middles["left", edge.predicate] + aside)
        end = (lefts["middle"], operator)
    else:
        start = (lefts["middle"] + _WIDTHS["middle"], operator)
        end = (lefts["right"], middles["right", edge.predicate] + aside)
    bend = (end[0] - start[0]) / 2
    dash = "" if edge.is_positive else ' stroke-dasharray="5 3"'
    sign = "" if edge.is_positive else "not "
    return (
        f'<path d="M{start[0]} {start[1]:.1f} C{start[0] + bend:.1f} {start[1]:.1f} '
        f'{end[0] - bend:.1f} {end[1]:.1f} {end[0]} {end[1]:.1f}" fill="none" '
        f'stroke="{_COLOURS[edge.side, edge.is_positive]}" stroke-width="1.6"{dash}>'
        f"<title>{escape(f'{edge.operator} {edge.side} {sign}{edge.predicate}({edge.label})')}</title></path>"
    )


def _box(x: int, middle: float, width: int, text: str, fill: str, radius: int, *, detail: str = "") -> str:
    height = _BOX + (16 if detail else 0)
    y = middle - height / 2
    first = middle + 4.5 - (8 if detail else 0)
    second = (
        f'<text x="{x + width / 2}" y="{first + 16:.1f}" text-anchor="middle" font-size="11" '
        f'fill="#30363b">{escape(detail)}</text>'
        if detail
        else ""
    )
    return (
        f'<rect x="{x}" y="{y:.1f}" width="{width}" height="{height}" rx="{radius}" fill="{fill}" '
        f'stroke="#8a949c"/><text x="{x + width / 2}" y="{first:.1f}" text-anchor="middle" '
        f'fill="#15191c">{escape(text)}</text>{second}'
    )
