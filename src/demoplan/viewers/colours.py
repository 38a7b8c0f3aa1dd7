"""Colours that stay the same for the same name, in every view and every run.

Activities known from the field have a fixed hue; any other name takes one from a palette by its hash, so
that a colour never depends on which other names are present.
"""

import hashlib
import re
from typing import TypeAlias

Rgb: TypeAlias = tuple[int, int, int]
"""Red, green, blue, each 0 to 255."""

# Paul Tol, "Colour schemes", technical note SRON/EPS/TN/09-002, 2021: 'muted' and 'light', which stay
# apart for colour-blind readers and carry dark text.
_PALETTE: tuple[Rgb, ...] = (
    (136, 204, 238),
    (68, 170, 153),
    (153, 153, 51),
    (221, 204, 119),
    (204, 102, 119),
    (170, 68, 153),
    (119, 170, 221),
    (187, 204, 51),
    (238, 136, 102),
    (153, 221, 255),
    (170, 170, 0),
    (255, 170, 187),
)

_ACTIVITIES: dict[str, Rgb] = {
    "idle": (176, 183, 191),
    "reach": (119, 170, 221),
    "approach": (119, 170, 221),
    "take": (238, 200, 80),
    "lift": (226, 160, 60),
    "put": (238, 136, 102),
    "place": (221, 110, 90),
    "release": (102, 187, 153),
    "retreat": (102, 187, 153),
    "hold": (187, 160, 210),
    "pour": (68, 187, 221),
    "stir": (210, 120, 175),
    "cut": (204, 102, 119),
}

_WORDS: dict[str, Rgb] = {
    "red": (214, 62, 54),
    "green": (56, 158, 84),
    "blue": (52, 112, 204),
    "yellow": (236, 188, 44),
    "orange": (236, 132, 40),
    "purple": (140, 84, 176),
    "white": (232, 232, 228),
    "black": (48, 50, 54),
    "brown": (140, 98, 64),
    "pink": (232, 130, 170),
    "grey": (140, 144, 150),
    "gray": (140, 144, 150),
    "left": (0, 160, 160),
    "right": (200, 80, 150),
    "table": (112, 102, 92),
}

SURFACE: Rgb = (112, 102, 92)
"""Tables and other surfaces."""

UNKNOWN: Rgb = (120, 124, 130)
"""What could not be observed."""

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def colour_of(name: str) -> Rgb:
    """A colour from the palette, by the name's hash alone.

    >>> colour_of("inHand") == colour_of("inHand")
    True
    """
    return _PALETTE[hashlib.sha256(name.encode()).digest()[0] % len(_PALETTE)]


def activity_colour(activity: str) -> Rgb:
    """The colour of an activity's name.

    >>> activity_colour("Idle")
    (176, 183, 191)
    """
    return _ACTIVITIES.get(activity.lower()) or colour_of(activity)


def operator_colour(operator: str) -> Rgb:
    """The colour of the activity that an operator's name starts with.

    >>> operator_colour("put_2") == activity_colour("Put")
    True
    """
    return activity_colour(re.sub(r"[_-]?\d+$", "", operator))


def entity_colour(name: str) -> Rgb:
    """The colour that an instance's name speaks of, as ``cube_red`` does, else one by its hash.

    >>> entity_colour("cube_red"), entity_colour("Cube_green1")
    ((214, 62, 54), (56, 158, 84))
    """
    for word in _WORD.findall(name):
        if word.lower() in _WORDS:
            return _WORDS[word.lower()]
    return colour_of(name)


def hex_colour(colour: Rgb) -> str:
    """A colour as CSS writes it.

    >>> hex_colour((255, 0, 16))
    '#ff0010'
    """
    return "#{:02x}{:02x}{:02x}".format(*colour)
