"""A domain's picture as PNG, drawn from the layout of its SVG."""

from io import BytesIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, PathPatch
from matplotlib.path import Path

from demoplan.language.domains import Domain
from demoplan.viewers.domain_graph import Layout, domain_layout


def domain_png(domain: Domain, *, dots_per_pixel: float = 2.0) -> bytes:
    """The picture as PNG, as fine as so many dots for each pixel of the SVG."""
    layout = domain_layout(domain)
    # One pixel of the layout is a point of 1/72 inch, so that sizes of letters and lines carry over.
    figure = Figure(figsize=(layout.width / 72, layout.height / 72), dpi=72 * dots_per_pixel)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0, layout.width)
    axes.set_ylim(layout.height, 0)
    axes.axis("off")
    _draw(layout, axes)
    target = BytesIO()
    figure.savefig(target, format="png", metadata={"Software": None})
    return target.getvalue()


def _draw(layout: Layout, axes: Axes) -> None:

    for key in layout.keys:
        axes.plot([key.x, key.x + 28], [key.y, key.y], color=key.colour, linewidth=2)
        axes.text(key.x + 34, key.y + 5, key.text, color="#30363b", fontsize=13, parse_math=False)
    for curve in layout.curves:
        path = Path([curve.start, *curve.controls, curve.end], [Path.MOVETO, *[Path.CURVE4] * 3])
        style = (0, (3, 2)) if curve.is_dashed else "solid"
        axes.add_patch(PathPatch(path, fill=False, edgecolor=curve.colour, linewidth=1.6, linestyle=style))
    for box in layout.boxes:
        corner = (box.x, box.middle - box.height / 2)
        rounded = f"round,pad=0,rounding_size={box.radius}"
        axes.add_patch(
            FancyBboxPatch(
                corner, box.width, box.height, boxstyle=rounded, facecolor=box.fill, edgecolor="#8a949c"
            )
        )
        for text, size, y, colour in (
            (box.text, 13, box.baseline, "#15191c"),
            (box.detail, 11, box.baseline + 16, "#30363b"),
        ):
            x = box.x + box.width / 2
            axes.text(x, y, text, ha="center", color=colour, fontsize=size, parse_math=False)
