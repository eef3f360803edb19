"""Check of a PLY header against the length of its file: data that are announced and missing.

trimesh reads as many rows as there are, without a word. Source: G. Turk, The PLY Polygon File Format, 1994.
"""

import re
from itertools import takewhile

__all__ = ["ply_problem"]

_HEADER_BYTES = 100_000
_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Bytes of each type; a list takes its count's, at least."""


def ply_problem(data: bytes) -> str:
    """What keeps a PLY file from being read whole, or nothing."""
    head, end, _ = data[:_HEADER_BYTES].partition(b"end_header")
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    if not end or lines[0] != ["ply"]:
        return "is no PLY file: it does not begin with a header from ply to end_header"
    as_text = ["format", "ascii"] in [line[:2] for line in lines]
    held, needed = len(data) - len(head) - len(end), 0
    for number, line in enumerate(lines):
        if line[:1] != ["element"]:
            continue
        if len(line) != 3 or not re.fullmatch(r"[0-9]{1,12}", line[2]):
            return f"announces no number of elements in '{' '.join(line):.40}'"
        needed += int(line[2]) * _row_bytes(lines[number + 1 :], as_text=as_text)
        if needed > held + 1:  # nothing need follow the last value of a text
            return f"is cut short: it announces {line[2]} of '{line[1]:.40}', and has {held} bytes of data"
    return ""


def _row_bytes(following: list[list[str]], *, as_text: bool) -> int:
    """Least length of an element's row, by the lines of the header behind the element's."""
    own = takewhile(lambda line: line[:1] != ["element"], following)
    kinds = [(line + [""] * 3)[2 if line[1:2] == ["list"] else 1] for line in own if line[:1] == ["property"]]
    # As text, a value takes a character and what separates it from the next.
    return sum(2 if as_text else _BYTES.get(kind, 1) for kind in kinds)
