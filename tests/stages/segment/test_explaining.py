"""Why activities have their names: by the rules in words, by a tree along its path."""

import pytest

from demoplan.stages.segment import PUBLISHED_RULES, RULES, TrainParams, segment, train
from demoplan.stages.segment.explaining import explain


def explained(part, segmenter):
    tables = (part.frames, part.facts)
    activities = segment(*tables, part.entities, part.types, segmenter)
    reasons = explain(*tables, activities, part.entities, part.types, segmenter)
    assert [(r.episode_id, r.hand, r.start_ns, r.activity) for r in reasons] == activities.select(
        "episode_id", "hand", "start_ns", "activity"
    ).rows()
    return [reason for reason in reasons if reason.hand == "Right_hand"]


def test_the_rules_say_what_was_moving_held_and_acted_on(demonstrate):
    reasons = {reason.activity: reason.text for reason in explained(demonstrate(), PUBLISHED_RULES)}
    assert reasons["Reach"] == "moving, holds nothing, acts on cube"
    assert reasons["Put"] == "moving, holds cube, acts on nothing"
    assert reasons["Idle"] == "at rest, holds nothing, acts on nothing"


def test_where_the_instant_alone_says_otherwise_the_reason_says_so(demonstrate):
    texts = [reason.text for reason in explained(demonstrate(), RULES)]
    alone = [text for text in texts if "that alone is" in text]
    for text in alone:
        assert "what comes before and after makes it" in text
    assert len(alone) < len(texts)


@pytest.mark.parametrize(
    ("method", "word"),
    [("decision_tree", "probability"), pytest.param("random_forest", "trees", marks=pytest.mark.slow)],
)
def test_a_trained_segmenter_gives_its_probability_and_a_single_tree_its_path(
    three, demonstrate, method, word
):
    fitted = train(
        three.frames, three.facts, three.truth, three.entities, three.types, params=TrainParams(method=method)
    )
    reasons = explained(demonstrate("new", seed=9), fitted)
    for reason in reasons:
        assert word in reason.text
    if method == "decision_tree":
        used = fitted.features_used
        for reason in reasons:
            conditions, _, _ = reason.text.partition(": probability")
            for condition in conditions.split(", "):
                name, value = _stated(condition, used)
                low = condition.partition(" < ")[0] if " < " in condition else ""
                high = condition.partition(" ≤ ")[2]
                assert name in used
                assert not low or float(low) <= value + 1e-9
                assert not high or value <= float(high) + 1e-9


def _stated(condition, used):
    """The feature that a condition speaks of, and its value."""
    words = condition.replace(" < ", " ").replace(" ≤ ", " ").split()
    name = next(word for word in words if word in used)
    return name, float(words[words.index(name) + 1])
