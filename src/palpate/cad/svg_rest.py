"""What an SVG file shows that is no outline: counted, so that it can be said."""

import re
from collections import Counter
from xml.etree import ElementTree

__all__ = ["no_outlines"]

_NO_OUTLINES = {"text": "texts", "image": "images", "foreignObject": "foreign objects"}
_CUTTING = {"clip-path": "clip paths, which do not cut outlines here", "mask": "masks"}


def no_outlines(root: ElementTree.Element) -> Counter[str]:
    """Texts, images, and references to clip paths and masks, in words with their number."""
    found: Counter[str] = Counter()
    for element in root.iter():
        kind = str(element.tag).rpartition("}")[2]
        if kind in _NO_OUTLINES:
            found[_NO_OUTLINES[kind]] += 1
        for name, what in _CUTTING.items():
            style = re.search(rf"(?:^|;)\s*{name}\s*:\s*([^;]*)", element.get("style", ""))
            value = style[1] if style else element.get(name, "none")
            if value.strip() not in {"none", ""}:
                found[what] += 1
        if kind == "style":  # a class may cut, too, whoever it is for
            for name, what in _CUTTING.items():
                found[what] += len(re.findall(rf"(?<![\w-]){name}\s*:\s*url", element.text or ""))
    return +found
