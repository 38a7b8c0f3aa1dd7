"""Commands about domain versions: list, show, diff, lint, test, graph."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from demoplan.cli.options import DEFAULT_STORE, JsonOption, StoreOption, existing_store
from demoplan.cli.output import Exit, print_json, print_table, say, stdout

if TYPE_CHECKING:
    from demoplan.language.domains import Domain

domains = typer.Typer(no_args_is_help=True, help="Domain versions: list, show, diff, lint, test, graph.")


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(domains, name="domain")


@domains.command("list")
def list_versions(store: StoreOption = DEFAULT_STORE, as_json: JsonOption = False) -> None:
    """List what each name stood for, oldest first: a version that came back is listed again."""
    from dataclasses import asdict
    from datetime import UTC, datetime

    opened = existing_store(store).domains
    histories = {name: opened.history(name) for name in opened.names()}
    listed = [
        (each, opened.published(name, each), each is history[-1])
        for name, history in histories.items()
        for each in history
    ]
    if as_json:
        print_json(
            [
                asdict(version) | {"made_at_ns": each.made_at_ns, "is_latest": is_latest}
                for each, version, is_latest in listed
            ]
        )
        return
    print_table(
        f"{len({version.domain_id for _, version, _ in listed})} domain versions",
        ["name", "id", "", "since", "parent", "operators", "episodes", "dataset"],
        [
            (
                v.name,
                v.domain_id,
                "latest" if is_latest else "",
                datetime.fromtimestamp(each.made_at_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
                if each.made_at_ns
                else "",
                v.parent,
                v.n_operators,
                len(v.episodes),
                v.dataset,
            )
            for each, v, is_latest in listed
        ],
    )


@domains.command()
def show(
    domain: Annotated[str, typer.Argument(help="Id, start of an id, or name (then the latest).")],
    evidence: Annotated[
        bool, typer.Option("--evidence", help="The literals with their support, and where it can be seen.")
    ] = False,
    is_pruned: Annotated[
        bool, typer.Option("--pruned", help="Leave out the predicates that no operator speaks of.")
    ] = False,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Print a domain's PDDL text, or the evidence behind each literal of it."""
    from dataclasses import asdict, replace

    from demoplan.language.pddl import render_domain
    from demoplan.pipeline.domains.learning import stored_domain
    from demoplan.stages.compose import pruned

    learned = stored_domain(existing_store(store), domain)
    if is_pruned:
        learned = replace(learned, text=render_domain(pruned(learned.domain)))
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
    from demoplan.pipeline.domains.learning import changes_between, stored_domain

    opened = existing_store(store)
    changes = changes_between(stored_domain(opened, old), stored_domain(opened, new))
    if as_json:
        print_json([asdict(change) for change in changes])
    else:
        stdout.out(in_words(changes))


DomainArgument = Annotated[str, typer.Argument(help="Id, start of an id, or name (then the latest).")]


@domains.command("lint")
def lint_version(
    domain: DomainArgument,
    state: Annotated[
        str | None,
        typer.Option(
            "--state", "-s", help="Also say what cannot be reached from here: EPISODE@start, a file."
        ),
    ] = None,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Say what is suspicious about a domain. Exit code 1 if something in it cannot be meant."""
    from dataclasses import asdict

    from demoplan.language.lint import ERROR
    from demoplan.pipeline.domains.domain_quality import lint_domain
    from demoplan.pipeline.domains.learning import stored_domain

    opened = existing_store(store)
    found = lint_domain(stored_domain(opened, domain), opened, state)
    if as_json:
        print_json([asdict(each) for each in found])
    else:
        for each in found:
            stdout.print(str(each), markup=False, soft_wrap=True)
        n_errors = sum(each.severity == ERROR for each in found)
        say(f"{len(found)} findings, {n_errors} of them errors")
    if any(each.severity == ERROR for each in found):
        raise typer.Exit(int(Exit.FAILED))


@domains.command("test")
def test_version(
    domain: DomainArgument,
    plans: Annotated[
        list[Path],
        typer.Argument(
            help="Plan files: steps, and comments `; start: EPISODE@start`, `; goal: onTop(a, b)`, "
            "`; expect: valid|invalid|solvable|unsolvable`."
        ),
    ],
    time_limit: Annotated[float, typer.Option(min=0.1, help="For each planning attempt [s].")] = 30.0,
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Try plan files as test cases on a domain. Exit code 1 if one of them goes otherwise than expected."""
    from dataclasses import asdict

    from demoplan.engines.fast_downward import SolveParams
    from demoplan.pipeline.domains.domain_quality import read_case, run_cases
    from demoplan.pipeline.domains.learning import stored_domain

    opened = existing_store(store)
    cases = [read_case(path) for path in plans]
    results = run_cases(stored_domain(opened, domain).domain, cases, opened, SolveParams(wall_s=time_limit))
    if as_json:
        print_json([asdict(each) for each in results])
    else:
        print_table(
            f"{sum(each.is_passed for each in results)} of {len(results)} as expected",
            ["case", "expected", "found", "", "reason"],
            [(r.case, r.expected, r.found, "passed" if r.is_passed else "FAILED", r.reason) for r in results],
        )
    if not all(each.is_passed for each in results):
        raise typer.Exit(int(Exit.FAILED))


@domains.command()
def graph(
    domain: DomainArgument,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File to write: .svg, .png or .dot (for Graphviz).")
    ],
    store: StoreOption = DEFAULT_STORE,
    as_json: JsonOption = False,
) -> None:
    """Draw what each operator needs and changes."""
    from demoplan.pipeline.domains.learning import stored_domain
    from demoplan.store.atomic import write_bytes
    from demoplan.viewers.domain_graph import domain_dot, domain_svg
    from demoplan.viewers.domain_png import domain_png

    draws: dict[str, Callable[[Domain], str | bytes]] = {
        ".svg": domain_svg,
        ".png": domain_png,
        ".dot": domain_dot,
    }
    if out.suffix not in draws:
        raise typer.BadParameter(f"{out}: a picture is .svg, .png or .dot", param_hint="--out")
    learned = stored_domain(existing_store(store), domain)
    drawn = draws[out.suffix](learned.domain)
    write_bytes(out, drawn.encode() if isinstance(drawn, str) else drawn)
    if as_json:
        print_json({"path": str(out), "domain_id": learned.version.domain_id})
    else:
        say(f"{out}: {len(learned.domain.operators)} operators of {learned.version.name}")
