"""Rig files for tests of whole runs: the shipped rig with short ways, so faster, and parts that fit it."""

import json
from pathlib import Path

from palpate.config import shipped_rig


def quick_rig(path: Path, max_grips: int = 8) -> Path:
    """Write it to `path`, and return that."""
    text = shipped_rig().read_text(encoding="utf-8")
    for old, new in (
        ("radius_mm = 125.0", "radius_mm = 60.0"),
        ("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 30.0"),
        ("sample_rate_hz = 250.0", "sample_rate_hz = 125.0"),
        ("max_grips = 8", f"max_grips = {max_grips}"),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text[: text.rindex("[[fingers]]")], encoding="utf-8")
    return path


SMALL_PARTS = {
    "ell": [[0, 0], [60, 0], [60, 20], [22, 20], [22, 45], [0, 45]],
    "wedge": [[0, 0], [58, 8], [20, 47]],
    "tee": [[0, 0], [55, 0], [55, 18], [38, 18], [38, 52], [20, 52], [20, 18], [0, 18]],
}


def quick_bench(folder: Path) -> tuple[Path, Path]:
    """Write a rig file of all three fingers round a small table, and a catalogue of small parts."""
    text = shipped_rig().read_text(encoding="utf-8")
    for old, new in (
        ("radius_mm = 125.0", "radius_mm = 60.0"),
        ("sample_rate_hz = 250.0", "sample_rate_hz = 125.0"),
        ("placement_radius_mm = 20.0", "placement_radius_mm = 12.0"),
    ):
        assert old in text
        text = text.replace(old, new)
    rig, objects = folder / "small-bench.toml", folder / "small-parts.json"
    rig.write_text(text, encoding="utf-8")
    parts = [{"name": name, "height": 20.0, "outline": ring} for name, ring in SMALL_PARTS.items()]
    objects.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": parts}))
    return rig, objects
