"""What was found on the way to operators: misreadings, exclusive groups, types that split, variants."""

import dataframely as dy


class Findings(dy.Schema):
    """One row per finding, with the evidence for it; none of them is needed to plan."""

    kind = dy.Enum(
        ["misreading", "exclusion", "type", "variant"],
        primary_key=True,
        description="A predicate's rate of wrong readings; atoms of which one holds; a type whose objects "
        "behave unlike; operators of one activity that stand apart",
    )
    subject = dy.String(primary_key=True, description="Predicate, group, type and objects, or operators")
    statement = dy.String(description="The finding in words")
    n_support = dy.Int64(min=0, description="Readings, states or transitions that speak for it")
    n_against = dy.Int64(min=0, description="Those that speak against it")
    rate = dy.Float64(nullable=True, min=0.0, max=1.0, description="Estimated rate, for a misreading")
    log10_bayes_factor = dy.Float64(
        nullable=True, description="Evidence against the simpler account: 1 is ten to one, 2 a hundred to one"
    )
    is_applied = dy.Bool(description="Operators and literals were learned with it")
