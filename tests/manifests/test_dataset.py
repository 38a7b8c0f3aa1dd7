import pytest

from demoplan.errors import ManifestError
from demoplan.manifests.dataset import parse_dataset

GOOD = """\
name: tiny
vocabulary: v.yaml
mapping:
  entities:
    Right_hand: {type: Hand}
    cube: {type: Cube}
  topics:
    /tf: {kind: transforms, entities: {cube_frame: cube}}
    /hand: {kind: pose, entity: Right_hand}
episodes:
  - {id: one, file: one.mcap, participant: p1, task: stack}
splits:
  test: [one]
"""


def test_a_complete_dataset_is_read():
    dataset = parse_dataset(GOOD, "dataset.yaml")
    assert dataset.episodes[0].id == "one"
    assert dataset.mapping.topics["/tf"].kind == "transforms"
    assert hash(dataset.episodes) == hash(parse_dataset(GOOD, "x").episodes)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("kind: pose", "kind: posse", 9, ["posse", "'pose'", "'bodies'"]),
        ("kind: pose", "kind: pose, positon: p", 9, ["positon", "unknown key", "position"]),
        ("{type: Hand}", "{typ: Hand}", 5, ["type"]),
        ("entity: Right_hand", "entity: Left_hand", 9, ["Left_hand", "Right_hand"]),
        ("id: one", "id: ../one", 11, ["id"]),
        ("file: one.mcap", "file: ../../etc/passwd", 11, ["leaves the dataset's root"]),
        ("file: one.mcap", "file: /etc/passwd", 11, ["leaves the dataset's root"]),
        ("test: [one]", "test: [two]", 13, ["two", "one"]),
        ("test: [one]", "train: []\n  test:\n    - one\n    - two", 16, ["two", "one"]),
        ("cube_frame: cube", "cube: cube, frame: box", 8, ["box", "Right_hand"]),
        ("vocabulary: v.yaml", "%YAML 1.1\n---\nvocabulary: v.yaml", 3, ["not YAML"]),
        ("name: tiny", "name: tiny\nname: twice", 2, ["not YAML"]),
        ("name: tiny", "name: [", 3, ["not YAML"]),
        ("name: tiny", "tick_rate_hz: -1\nname: tiny", 1, ["tick_rate_hz", "greater than 0"]),
        ("vocabulary: v.yaml\n", "", None, ["vocabulary: missing"]),
    ],
)
def test_an_error_names_the_line_and_what_is_allowed(old, new, line, words):
    with pytest.raises(ManifestError) as caught:
        parse_dataset(GOOD.replace(old, new), "dataset.yaml")
    if line is not None:
        assert caught.value.line == line
    for word in words:
        assert word in str(caught.value)


def test_every_problem_of_a_file_is_listed():
    text = GOOD.replace("kind: pose", "kind: posse").replace("{type: Hand}", "{typ: Hand}")
    with pytest.raises(ManifestError) as caught:
        parse_dataset(text, "dataset.yaml")
    assert caught.value.line == 5
    assert "line 9" in str(caught.value)


def test_a_repeated_episode_id_is_refused():
    text = GOOD.replace("splits:", "  - {id: one, file: b.mcap, participant: p1, task: stack}\nsplits:")
    with pytest.raises(ManifestError, match="used twice"):
        parse_dataset(text, "dataset.yaml")


def test_aliases_that_multiply_without_end_are_refused():
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n"
    for i in range(1, 9):
        bomb += f"a{i}: &a{i} [" + ", ".join([f"*a{i - 1}"] * 10) + "]\n"
    with pytest.raises(ManifestError, match="refused"):
        parse_dataset(bomb, "dataset.yaml")


@pytest.mark.parametrize(
    "text", ["a: " + "[" * 200_000, "a: " + "{a: " * 50_000 + "}" * 50_000, "- " * 9_000]
)
def test_a_text_without_a_floor_is_refused(text):
    with pytest.raises(ManifestError, match=r"nested too deeply|not YAML"):
        parse_dataset(text, "dataset.yaml")


def test_tags_that_name_a_type_of_a_language_are_not_followed():
    with pytest.raises(ManifestError):
        parse_dataset("name: !!python/object/apply:os.system ['true']\n", "dataset.yaml")
