"""Files given for others, such as a CAD file for object models: to be said before anything about syntax."""

import re
from pathlib import PurePath

from palpate.config.problems import shown

__all__ = ["mistaken_for"]

_CAD = frozenset({".3mf", ".dxf", ".obj", ".ply", ".step", ".stl", ".stp", ".svg"})
_OBJECTS = "palpate/objects@1"
_BEGINNING = 10_000  # characters in which a file says its format
_FORMAT = re.compile(
    r'(?:^|[{,])[ \t]*"?format"?[ \t]*[:=][ \t]*"(palpate/[\w-]{1,40}@\d{1,4})"', re.MULTILINE
)


def mistaken_for(name: str, text: str, wanted: str) -> str | None:
    """What a file is that cannot be read as the format `wanted`; None: one of this with a fault, perhaps."""
    if PurePath(name).suffix.lower() in _CAD:
        rest = f"`palpate objects import {name}` makes object models of it"
        return f"is a CAD file; {rest if wanted == _OBJECTS else f'needed here: {shown(wanted)}'}"
    found = _FORMAT.search(text[:_BEGINNING])
    if found is None or found[1] == wanted:
        return None
    return f"format: is {shown(found[1])}; needed here: {shown(wanted)}"
