"""Commands about domain versions: list, show, diff."""

from typing import Annotated

import typer

from demoplan.cli.options import DEFAULT_STORE, JsonOption, StoreOption, existing_store
from demoplan.cli.output import print_json, print_table, stdout

domains = typer.Typer(no_args_is_help=True, help="Domain versions: list, show, diff.")


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(domains, name="domain")


@domains.command("list")
def list_versions(store: StoreOption = DEFAULT_STORE, as_json: JsonOption = False) -> None:
    """List every version, by name, in the order in which they were added."""
    from dataclasses import asdict

    versions = existing_store(store).domains.versions()
    if as_json:
        print_json([asdict(version) for version in versions])
        return
    print_table(
        f"{len(versions)} domain versions",
        ["name", "id", "parent", "operators", "episodes", "dataset"],
        [(v.name, v.domain_id, v.parent, v.n_operators, len(v.episodes), v.dataset) for v in versions],
    )


@domains.command()
def show(
    domain: Annotated[str, typer.Argument(help="Id, start of an id, or name (then the latest).")],
    evidence: Annotated[
        bool, typer.Option("--evidence", help="The literals with their support, and where it can be seen.")
    ] = False,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Print a domain's PDDL text, or the evidence behind each literal of it."""
    from dataclasses import asdict

    from demoplan.pipeline.learning import stored_domain

    learned = stored_domain(existing_store(store), domain)
    if as_json:
        print_json(
            {
                "metadata": asdict(learned.version),
                "text": learned.text,
                "operators": learned.operators,
                "literals": learned.literals,
                "evidence": learned.evidence,
                "findings": learned.findings,
            }
        )
        return
    if not evidence:
        stdout.out(learned.text, end="")
        return
    if learned.findings.height:
        print_table(
            "found on the way",
            ["kind", "subject", "finding", "for", "against", "odds"],
            [
                (
                    row["kind"],
                    row["subject"],
                    row["statement"],
                    row["n_support"],
                    row["n_against"],
                    "" if row["log10_bayes_factor"] is None else f"10^{row['log10_bayes_factor']:.1f}",
                )
                for row in learned.findings.iter_rows(named=True)
            ],
        )
    for operator in learned.operators.iter_rows(named=True):
        name = operator["operator"]
        parameters = ", ".join(f"{p['variable']} {p['type']}" for p in operator["parameters"])
        print_table(
            f"{name}({parameters}): {operator['n_transitions']} transitions, cost {operator['cost']}"
            + (f"; set aside: {operator['note']}" if operator["is_quarantined"] else ""),
            ["literal", "role", "support", "against", "probability", "stated", "note"],
            [
                (
                    f"{'' if row['is_positive'] else 'not '}{row['predicate']}({','.join(row['variables'])})",
                    row["role"],
                    f"{row['n_support']} of {row['n_transitions']}",
                    row["n_against"],
                    f"{row['probability']:.3f}",
                    "yes" if row["is_kept"] else "no",
                    row["note"],
                )
                for row in learned.literals.iter_rows(named=True)
                if row["operator"] == name
            ],
        )
        print_table(
            f"behind {name}",
            ["episode", "hand", "from [s]", "to [s]", "objects", "does not show"],
            [
                (
                    row["episode_id"],
                    row["hand"],
                    f"{row['start_ns'] / 1e9:.3f}",
                    f"{row['end_ns'] / 1e9:.3f}",
                    ", ".join(row["binding"]),
                    ", ".join(row["contradicts"]),
                )
                for row in learned.evidence.iter_rows(named=True)
                if row["operator"] == name
            ],
        )


@domains.command()
def diff(
    old: Annotated[str, typer.Argument(help="Id, start of an id, or name.")],
    new: Annotated[str, typer.Argument(help="Id, start of an id, or name.")],
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Say in words what changed between two versions: operators, literals, counts."""
    from dataclasses import asdict

    from demoplan.language.diff import in_words
    from demoplan.pipeline.learning import changes_between, stored_domain

    opened = existing_store(store)
    changes = changes_between(stored_domain(opened, old), stored_domain(opened, new))
    if as_json:
        print_json([asdict(change) for change in changes])
    else:
        stdout.out(in_words(changes))
