"""The words of a report, for readers who come from elsewhere."""

GLOSSARY: tuple[tuple[str, str], ...] = (
    (
        "activity",
        "A stretch of time in which one hand does one thing: Idle, Reach, Take, Put, Release. "
        "The activities of a hand follow one another without a gap.",
    ),
    ("atom", "A predicate with its objects, such as onTop(cube_red, table): true, false, or not observed."),
    ("confusion", "Rows are what is true, columns what was inferred; the diagonal is what was right."),
    ("count", "How many transitions an operator explains. What was shown more often costs the planner less."),
    (
        "domain",
        "What a planner may do: types, predicates and operators, as PDDL text. "
        "Its id is the hash of that text.",
    ),
    (
        "edit score",
        "One minus the number of segments to insert, drop or rename, relative to the longer of the two "
        "lists of segments.",
    ),
    ("effect", "A literal that the operator makes true; only changes are stated."),
    (
        "F1@k",
        "F1 over segments; a segment is right if it overlaps a true one of the same name "
        "by at least k percent.",
    ),
    ("goal", "Literals that are to hold in the end; given by a person, not learned."),
    ("interval", "A 95 % interval: of a hundred made in this way, about 95 hold the true figure."),
    ("literal", "An atom or its negation (¬), with variables in an operator and objects in a state."),
    (
        "operator",
        "The transition into an activity, over types instead of single objects: "
        "what must hold, and what changes.",
    ),
    ("precondition", "A literal that must hold before the operator; kept as far as its support says so."),
    ("quarantined", "Left out, with its reason in plain sight; nothing is dropped in silence."),
    (
        "support",
        "In how many of an operator's transitions a literal was observed; the rest showed the opposite "
        "or could not be observed.",
    ),
    ("transition", "One activity with the atoms before and after it."),
    ("truncated", "The log ends early; what it still holds is used."),
    (
        "validated",
        "The plan was carried out step by step by a simulator of its own, which reached the goal.",
    ),
)
"""(term, meaning) pairs, sorted by term."""
