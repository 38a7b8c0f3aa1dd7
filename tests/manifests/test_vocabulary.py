import pytest

from demoplan.errors import ManifestError
from demoplan.manifests.vocabulary import parse_vocabulary

GOOD = """\
name: tiny
types:
  Hand: {}
  Graspable:
    shape: {kind: sphere, size_xyz_m: [0.1, 0.1, 0.1]}
  Cube: {parent: Graspable}
predicates:
  near:
    arguments: [Hand, object]
    definition: near
    numbers: {exit_m: 0.2, enter_m: 0.1}
"""


def test_a_vocabulary_is_read_into_values_that_compare():
    vocabulary = parse_vocabulary(GOOD, "v.yaml")
    assert vocabulary.types.ancestors("Cube") == ("Cube", "Graspable", "object")
    assert vocabulary.predicates[0].numbers == (("enter_m", 0.1), ("exit_m", 0.2))
    assert vocabulary == parse_vocabulary(GOOD, "elsewhere.yaml")


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("parent: Graspable", "parent: Graspabel", 6, ["Graspabel", "types: Cube, Graspable, Hand, object"]),
        ("[Hand, object]", "[Hand, thing]", 9, ["near", "thing", "Graspable"]),
        ("kind: sphere", "kind: ball", 5, ["ball", "'cylinder'"]),
        ("definition: near", "defintion: near", 8, ["line 10", "defintion", "unknown key"]),
        ("enter_m: 0.1", "enter_m: .nan", 11, ["finite"]),
        ("[0.1, 0.1, 0.1]", "[0.1, -0.1, 0.1]", 5, ["greater than or equal to 0"]),
        ("Hand: {}", "Hand: {parent: Hand}", None, ["own ancestor"]),
    ],
)
def test_an_error_names_the_line_and_what_is_there(old, new, line, words):
    with pytest.raises(ManifestError) as caught:
        parse_vocabulary(GOOD.replace(old, new, 1), "v.yaml")
    assert caught.value.line == line
    for word in words:
        assert word in str(caught.value)
