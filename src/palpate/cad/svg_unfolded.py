"""Size of an SVG file with every copy drawn, computed before any is.

A `use` is a copy of another element with all that it holds. A few lines of copies of copies are more than any
computer draws ("billion laughs").
"""

import re
from pathlib import Path
from xml.etree.ElementTree import Element

from palpate.base.errors import InputError
from palpate.base.files.limits import DRAWN_NUMBERS, DRAWN_PIECES, NESTING

__all__ = ["check_unfolded"]

_NUMBER = re.compile(r"[0-9.]+")


def check_unfolded(root: Element, path: Path) -> None:
    """Raise InputError for too deep a nesting, too many elements or numbers, and copies within themselves."""
    named = {name: element for element in root.iter() if (name := element.get("id"))}
    came_to: dict[Element, tuple[int, int]] = {}
    open_elements: dict[Element, int] = {}
    stack = [(root, False)]
    while stack:
        element, done = stack.pop()
        if done:
            del open_elements[element]
            parts = [came_to[inner] for inner in _within(element, named)]
            numbers = sum(len(_NUMBER.findall(element.get(key, ""))) for key in ("d", "points"))
            pieces = 1 + sum(part[0] for part in parts)
            came_to[element] = pieces, numbers + sum(part[1] for part in parts)
        elif element in open_elements:
            raise InputError(f"{path}: uses '#{element.get('id')}' within itself; remove this copy")
        elif element not in came_to:
            open_elements[element] = len(stack)
            if len(open_elements) > NESTING:
                raise InputError(f"{path}: elements are nested more than {NESTING} deep; take groups apart")
            stack.append((element, True))
            stack += [(inner, False) for inner in _within(element, named)]
    pieces, numbers = came_to[root]
    for count, most, what in ((pieces, DRAWN_PIECES, "elements"), (numbers, DRAWN_NUMBERS, "numbers")):
        if count > most:
            raise InputError(
                f"{path}: draws {min(count, 10**15):.6g} {what}, those of copies counted each time; "
                f"at most {most} are read: keep the outlines only"
            )


def _within(element: Element, named: dict[str, Element]) -> list[Element]:
    """What is drawn where an element is."""
    inner = list(element)
    if element.tag.rpartition("}")[2] == "use":
        hrefs = (value for key, value in element.attrib.items() if key.rpartition("}")[2] == "href")
        target = named.get(next(hrefs, "")[1:])
        if target is not None:
            inner.append(target)
    return inner
