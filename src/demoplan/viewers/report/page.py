"""What every page is made with: the templates, their filters, and the stylesheet that goes into the page."""

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from demoplan.viewers.report.markup import counted, number, visible

_TEMPLATES = "demoplan.viewers.report"


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=visible,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["number"] = number
    environment.filters["counted"] = counted
    environment.filters["percent"] = lambda share: "–" if share is None else f"{100 * share:.1f} %"
    return environment


def page_of(template: str, **content: Any) -> str:
    """A page that extends ``base.html``: it needs no other file, no network and no script.

    It follows the reader's light or dark setting, and prints. Names and texts from outside are shown as
    text, whatever they hold.

    Args:
        template: Name of the template.
        content: What the template names.
    """
    environment = _environment()
    stylesheet, _, _ = environment.loader.get_source(environment, "report.css")  # type: ignore[union-attr]
    ours = Markup(stylesheet)  # noqa: S704 - from beside the template
    return environment.get_template(template).render(stylesheet=ours, **content)
