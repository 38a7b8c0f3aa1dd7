"""The geometric definitions that a vocabulary builds its predicates from, for whoever writes one."""

from typing import Any

from demoplan.cli.output import print_json, print_table, say

NAME = "definitions"
"""What stands in place of a table's name."""


def show_definitions(*, as_json: bool) -> None:
    """Print every definition: what it says, of how many things, and the numbers that it wants."""
    from demoplan.stages.perceive.registry import COMMON_NUMBERS, DEFINITIONS

    rows: list[dict[str, Any]] = [
        {
            "definition": name,
            "n_arguments": definition.arity,
            "numbers": list(definition.numbers),
            "derived_from": list(definition.needs),
            "meaning": (definition.function.__doc__ or "").strip().partition("\n")[0].replace("``", ""),
        }
        for name, definition in sorted(DEFINITIONS.items())
    ]
    if as_json:
        print_json({"definitions": rows, "numbers_of_all": COMMON_NUMBERS})
        return
    print_table(
        "definitions",
        ["definition", "of", "numbers", "derived from", "meaning"],
        [
            (
                row["definition"],
                row["n_arguments"],
                ", ".join(row["numbers"]),
                ", ".join(row["derived_from"]),
                row["meaning"],
            )
            for row in rows
        ],
    )
    say(f"every predicate may state {', '.join(COMMON_NUMBERS)} as well")
