"""Objects files and scenes for tests of what no finger can feel: one outline, at any scale and height."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

OUTLINE = ((0.0, 0.0), (70.0, 0.0), (70.0, 25.0), (55.0, 40.0), (0.0, 40.0))


def part(
    name: str, scale: float = 1.0, height: float = 20.0, outline: Sequence[Sequence[float]] = OUTLINE
) -> dict[str, Any]:
    """A flat part, `height` unscaled; its bounding box is 70 by 40 mm."""
    return {"name": name, "outline": [[x * scale, y * scale] for x, y in outline], "height": height}


def objects_file(path: Path, *parts: Mapping[str, Any]) -> Path:
    """Write a catalogue; returns its path."""
    path.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": parts}))
    return path


def scene_file(path: Path, name: str, x: float, y: float, objects: str | None = None) -> Path:
    """Write a scene; returns its path."""
    content: dict[str, Any] = {"format": "palpate/scene@1", "object": name}
    content["configuration"] = {"x": x, "y": y, "theta": 0.0}
    path.write_text(json.dumps(content if objects is None else content | {"objects": objects}))
    return path
