"""Text from logs made safe to show, and the small pieces of HTML and SVG that a report repeats.

Whatever comes from a log, a mapping or a planner is data: characters that could hide or turn text around
are made visible, and everything is escaped by type (``Markup`` is ours, ``str`` is theirs).
"""

import math
import re

from markupsafe import Markup, escape

from demoplan.viewers.colours import Rgb, hex_colour

# C0 and C1 controls, lone surrogates, and the marks that turn the direction of text or hide it.
_INVISIBLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u202a-\u202e\u2060-\u2069\ufeff\ud800-\udfff]"
)


def visible(value: object) -> object:
    r"""The value, with characters that do not show replaced where it is text; our own markup stays.

    >>> visible("a\x00b\u202ec")
    'a�b�c'
    """
    if isinstance(value, str) and not isinstance(value, Markup):
        return _INVISIBLE.sub("\ufffd", value)
    return value


def text(value: object) -> Markup:
    """Text from outside, visible and escaped."""
    return escape(visible(str(value)))


def number(value: float | None, digits: int = 3) -> str:
    """A figure as a person reads it: at most ``digits`` decimals, none for whole numbers beyond 100.

    >>> number(0.97431), number(12.0), number(None), number(1234.5)
    ('0.974', '12', '–', '1234')
    """
    if value is None or math.isnan(value):
        return "–"
    if float(value).is_integer() and abs(value) >= 2:
        return str(int(value))
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.{digits}f}"


def counted(n: int, noun: str) -> str:
    """A count with its noun.

    >>> counted(1, "time"), counted(0, "episode")
    ('1 time', '0 episodes')
    """
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def ink_on(colour: Rgb) -> str:
    """Black or white, whichever reads better on a colour.

    Source: W3C, Web Content Accessibility Guidelines 2.1, 2018, "relative luminance" and "contrast ratio".
    """
    linear = [c / 255 / 12.92 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in colour]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    return "#111" if (luminance + 0.05) / 0.05 > 1.05 / (luminance + 0.05) else "#fff"


def swatch(colour: Rgb) -> Markup:
    """A small square of a colour, for a legend."""
    return Markup('<span class="swatch" style="background:{}"></span>').format(hex_colour(colour))


def support_bar(n_support: int, n_against: int, n_transitions: int) -> Markup:
    """How many transitions show a literal, how many its opposite, and how many say nothing."""
    total = max(n_transitions, 1)
    good, bad = 100 * n_support / total, 100 * n_against / total
    return Markup(
        '<svg class="support" role="img" aria-label="{} of {} for, {} against">'
        '<rect class="rail" width="100%" height="100%"/>'
        '<rect class="for" width="{:.2f}%" height="100%"/>'
        '<rect class="against" x="{:.2f}%" width="{:.2f}%" height="100%"/></svg>'
    ).format(n_support, n_transitions, n_against, good, 100 - bad, bad)


def interval_bar(
    value: float | None, low: float | None, high: float | None, reference: float | None
) -> Markup:
    """A figure between 0 and 1 with its interval, and a mark for what it is held against."""
    if value is None or not 0.0 <= value <= 1.0:
        return Markup("")
    parts = [
        Markup(
            '<svg class="interval" role="img" aria-label="{:.3f}">'
            '<line class="rail" x1="0" x2="100%" y1="8" y2="8"/>'
        ).format(value)
    ]
    if low is not None and high is not None:
        parts.append(
            Markup('<line class="range" x1="{:.2f}%" x2="{:.2f}%" y1="8" y2="8"/>').format(
                100 * max(low, 0.0), 100 * min(high, 1.0)
            )
        )
    if reference is not None:
        parts.append(
            Markup('<line class="reference" x1="{0:.2f}%" x2="{0:.2f}%" y1="1" y2="15"/>').format(
                100 * reference
            )
        )
    parts.append(Markup('<circle class="value" cx="{:.2f}%" cy="8" r="4"/></svg>').format(100 * value))
    return Markup("").join(parts)
