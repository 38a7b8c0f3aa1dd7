"""A domain as a picture: what each operator needs, and what it changes.

Three columns: predicates that are needed, operators, predicates that are changed. SVG and PNG are laid out
here, so that they need no program; DOT is for Graphviz, which lays out larger domains better.
"""

from collections.abc import Iterator
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


@dataclass(frozen=True)
class Box:
    """A predicate or an operator, in pixels from the upper left."""

    x: int
    middle: float
    width: int
    text: str
    fill: str
    radius: int
    detail: str = ""
    """A second line, in smaller letters."""

    @property
    def height(self) -> int:
        """Enough for its lines."""
        return _BOX + (16 if self.detail else 0)

    @property
    def baseline(self) -> float:
        """Where its first line of text stands."""
        return self.middle + 4.5 - (8 if self.detail else 0)


@dataclass(frozen=True)
class Curve:
    """A line from what is needed to an operator, or from an operator to what it changes."""

    start: tuple[int, float]
    end: tuple[int, float]
    colour: str
    is_dashed: bool
    title: str

    @property
    def controls(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Control points of the cubic curve: it leaves and arrives level."""
        bend = (self.end[0] - self.start[0]) / 2
        return (self.start[0] + bend, self.start[1]), (self.end[0] - bend, self.end[1])


@dataclass(frozen=True)
class Key:
    """An entry of the legend: a short line, and what its colour means."""

    x: int
    y: int
    text: str
    colour: str


@dataclass(frozen=True)
class Layout:
    """Where everything stands, in pixels; whoever draws it adds nothing."""

    title: str
    width: int
    height: int
    keys: tuple[Key, ...]
    curves: tuple[Curve, ...]
    boxes: tuple[Box, ...]


def domain_layout(domain: Domain) -> Layout:
    """Where boxes and lines stand: three columns, each spread over the whole height."""
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
    middles = {
        (column, name): top + (number + 0.5) * (n_rows * _ROW * 2) / len(names)
        for column, names in columns.items()
        for number, name in enumerate(names)
    }
    predicates = [
        Box(lefts[column], middles[column, name], _WIDTHS[column], name, "#f4f6f8", 12)
        for column in ("left", "right")
        for name in columns[column]
    ]
    operators = [
        Box(
            lefts["middle"],
            middles["middle", operator.name],
            _WIDTHS["middle"],
            operator.name,
            _fill(operator),
            4,
            detail=", ".join(f"{each.variable} {each.type_name}" for each in operator.parameters),
        )
        for operator in domain.operators
    ]
    return Layout(
        title=f"{domain.name}: what operators need and change",
        width=lefts["right"] + _WIDTHS["right"] + _MARGIN,
        height=top + n_rows * _ROW * 2 + _MARGIN,
        keys=tuple(_keys()),
        curves=tuple(_curve(edge, lefts, middles) for edge in edges),
        boxes=(*predicates, *operators),
    )


def _keys() -> Iterator[Key]:
    x = _MARGIN
    for text, colour in _LEGEND:
        yield Key(x, _MARGIN + 4, text, colour)
        x += 60 + 8 * len(text)


def _curve(edge: _Edge, lefts: dict[str, int], middles: dict[tuple[str, str], float]) -> Curve:
    # What is made true and what is made false of one predicate run beside each other.
    aside = -3 if edge.is_positive else 3
    operator = middles["middle", edge.operator] + aside
    if edge.side == "needs":
        start = (lefts["left"] + _WIDTHS["left"], middles["left", edge.predicate] + aside)
        end = (lefts["middle"], operator)
    else:
        start = (lefts["middle"] + _WIDTHS["middle"], operator)
        end = (lefts["right"], middles["right", edge.predicate] + aside)
    sign = "" if edge.is_positive else "not "
    return Curve(
        start,
        end,
        _COLOURS[edge.side, edge.is_positive],
        not edge.is_positive,
        f"{edge.operator} {edge.side} {sign}{edge.predicate}({edge.label})",
    )


def domain_svg(domain: Domain) -> str:
    """The picture as SVG without external resources; the same bytes for the same domain."""
    layout = domain_layout(domain)
    width, height = layout.width, layout.height
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="system-ui, sans-serif" font-size="13">',
        f"<title>{escape(layout.title)}</title>",
        f'<rect width="{width}" height="{height}" fill="white"/>',
        *(_svg_key(each) for each in layout.keys),
        *(_svg_curve(each) for each in layout.curves),
        *(_svg_box(each) for each in layout.boxes),
    ]
    return "\n".join([*parts, "</svg>", ""])


def _svg_key(key: Key) -> str:
    return (
        f'<line x1="{key.x}" y1="{key.y}" x2="{key.x + 28}" y2="{key.y}" stroke="{key.colour}" '
        f'stroke-width="2"/><text x="{key.x + 34}" y="{key.y + 5}" fill="#30363b">{key.text}</text>'
    )


def _svg_curve(curve: Curve) -> str:
    (x1, y1), (x2, y2) = curve.controls
    dash = ' stroke-dasharray="5 3"' if curve.is_dashed else ""
    return (
        f'<path d="M{curve.start[0]} {curve.start[1]:.1f} C{x1:.1f} {y1:.1f} {x2:.1f} {y2:.1f} '
        f'{curve.end[0]} {curve.end[1]:.1f}" fill="none" stroke="{curve.colour}" stroke-width="1.6"{dash}>'
        f"<title>{escape(curve.title)}</title></path>"
    )


def _svg_box(box: Box) -> str:
    x = box.x + box.width / 2
    second = (
        f'<text x="{x}" y="{box.baseline + 16:.1f}" text-anchor="middle" font-size="11" '
        f'fill="#30363b">{escape(box.detail)}</text>'
        if box.detail
        else ""
    )
    return (
        f'<rect x="{box.x}" y="{box.middle - box.height / 2:.1f}" width="{box.width}" '
        f'height="{box.height}" rx="{box.radius}" fill="{box.fill}" stroke="#8a949c"/>'
        f'<text x="{x}" y="{box.baseline:.1f}" text-anchor="middle" '
        f'fill="#15191c">{escape(box.text)}</text>{second}'
    )
