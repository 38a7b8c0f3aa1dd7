"""Pictures of domains: every operator and predicate is in them, and they are well-formed."""

from io import BytesIO
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import matplotlib.image
import pytest

from demoplan.language.pddl import parse_domain
from demoplan.viewers.domain_graph import domain_dot, domain_layout, domain_svg
from demoplan.viewers.domain_png import domain_png

DOMAIN = parse_domain(
    (Path(__file__).parents[1] / "golden" / "planning" / "stacking-domain.pddl").read_text()
)


def test_the_svg_is_well_formed_and_names_every_operator_and_what_it_needs_and_changes():
    root = ElementTree.fromstring(domain_svg(DOMAIN))
    texts = {element.text for element in root.iter() if element.tag.endswith("}text")}
    assert {operator.name for operator in DOMAIN.operators} <= texts
    used = {each.atom.predicate for o in DOMAIN.operators for each in (*o.preconditions, *o.effects)}
    assert used <= texts
    titles = " ".join(e.text for e in root.iter() if e.tag.endswith("}title"))
    for operator in DOMAIN.operators:
        for effect in operator.effects:
            sign = "" if effect.is_positive else "not "
            assert f"{operator.name} changes {sign}{effect.atom.predicate}(" in titles


def test_boxes_of_a_column_do_not_overlap_and_lie_within_the_picture():
    root = ElementTree.fromstring(domain_svg(DOMAIN))
    height = float(root.get("height"))
    columns = {}
    for box in root.iter("{http://www.w3.org/2000/svg}rect"):
        if box.get("x") is not None:
            columns.setdefault(box.get("x"), []).append((float(box.get("y")), float(box.get("height"))))
    assert len(columns) == 3
    for boxes in columns.values():
        boxes.sort()
        assert boxes[0][0] >= 0
        assert boxes[-1][0] + boxes[-1][1] <= height
        assert all(y + size <= below for (y, size), (below, _) in pairwise(boxes))


def test_the_dot_text_has_a_node_for_every_operator_and_names_are_quoted():
    text = domain_dot(DOMAIN)
    assert text.startswith("digraph domain {")
    assert text.count("{") == text.count("}")
    for operator in DOMAIN.operators:
        assert f'"{operator.name}" [label=' in text


def test_the_png_shows_the_boxes_of_the_svg_where_it_has_them():
    png = domain_png(DOMAIN, dots_per_pixel=1.0)
    assert png == domain_png(DOMAIN, dots_per_pixel=1.0)
    layout = domain_layout(DOMAIN)
    pixels = matplotlib.image.imread(BytesIO(png), format="png")
    assert pixels.shape[:2] == (layout.height, layout.width)
    for box in layout.boxes:
        # Inside, at the left edge, where no letter stands.
        shown = pixels[round(box.middle), box.x + 4, :3]
        wanted = [int(box.fill[place : place + 2], 16) / 255 for place in (1, 3, 5)]
        assert shown == pytest.approx(wanted, abs=0.02)
