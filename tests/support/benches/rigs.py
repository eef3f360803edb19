"""Rig files of tests and recorded runs."""

import json
import re
import tomllib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import palpate
from palpate.config import ObjectsFile, RigFile, load_objects
from palpate.config.emulation import Scene
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# The rig of tests that are not about parts which slide: quick touches, and an emulated part that stands.


def slow_rig(folder: Path) -> Path:
    """The firm rig with fingers that creep, so that a signal is sure to come while they close."""
    text = firm_rig().read_text(encoding="utf-8")
    path = folder / "slow.toml"
    path.write_text(text.replace("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 5.0"))
    return path


def firm_rig() -> Path:
    """Its rig file."""
    return EXAMPLES / "firm-rig.toml"


# ----------------------------------------------------------------------------------------------------
# Rig files for tests of whole runs: the shipped rig with short ways, so faster, and parts that fit it.


def quick_rig(path: Path, max_grips: int = 8) -> Path:
    """Write it to `path`, and return that."""
    text = _replaced(
        firm_rig().read_text(encoding="utf-8"),
        ("radius_mm = 125.0", "radius_mm = 60.0"),
        ("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 30.0"),
        ("sample_rate_hz = 250.0", "sample_rate_hz = 125.0"),
        ("max_grips = 12", f"max_grips = {max_grips}"),
    )
    path.write_text(text[: text.rindex("[[fingers]]")], encoding="utf-8")
    return path


SMALL_PARTS = {
    "ell": [[0, 0], [60, 0], [60, 20], [22, 20], [22, 45], [0, 45]],
    "wedge": [[0, 0], [58, 8], [20, 47]],
    "tee": [[0, 0], [55, 0], [55, 18], [38, 18], [38, 52], [20, 52], [20, 18], [0, 18]],
}

STAGE = {
    "centre_mm": [3.0, -2.0],
    "dxl_id": 1,
    "model": "XM430-W350",
    "gear_ratio": 5.0,
    "range_deg": [-30.0, 30.0],
    "backlash_deg": 0.02,
    "zero_deg": 180.0,
    "bound_deg": 0.02,
}
"""A turning stage, as in a rig file."""


def small(path: Path) -> str:
    """A rig file's text with slides on a smaller circle round a smaller table; nothing else is changed.

    They wait near where they are switched on, and reach the part in half the time.
    """
    text = _replaced(
        path.read_text(encoding="utf-8"),
        ("radius_mm = 125.0", "radius_mm = 60.0"),
        ("placement_radius_mm = 20.0", "placement_radius_mm = 12.0"),
    )
    return re.sub(r"(?m)^base_mm = \[(\S+), (\S+)\]", _nearer, text)


def _nearer(found: re.Match[str]) -> str:
    x, y = (float(found[group]) * 125.0 / 190.0 for group in (1, 2))
    return f"base_mm = [{x:.3f}, {y:.3f}]"


def quick_rig_of_shipped_size() -> RigFile:
    """The firm rig with quicker ways and half the frames."""
    return RigFile.model_validate(tomllib.loads(quicken(firm_rig().read_text(encoding="utf-8"))))


def small_rig(path: Path | None = None) -> RigFile:
    """A rig made small; that of tests is as quick as the quick bench, another keeps its speeds and frames."""
    if path is not None:
        return RigFile.model_validate(tomllib.loads(small(path)))
    return RigFile.model_validate(tomllib.loads(quicken(small(firm_rig()))))


@cache
def small_objects() -> ObjectsFile:
    """What fits a small rig."""
    with TemporaryDirectory() as folder:
        return load_objects(small_parts(Path(folder)))


def quick_bench(folder: Path, fingers: int = 3) -> tuple[Path, Path]:
    """Write a rig file of some of the fingers round a small table, and a catalogue of small parts."""
    text = quicken(small(firm_rig()))
    rig = folder / "small-bench.toml"
    rig.write_text("[[fingers]]".join(text.split("[[fingers]]")[: 1 + fingers]), encoding="utf-8")
    return rig, small_parts(folder)


def quick_copy(rig: Path, folder: Path) -> Path:
    """The rig file of a copy with quicker ways, in a folder."""
    path = folder / "quick.toml"
    path.write_text(quicken(rig.read_text(encoding="utf-8")), encoding="utf-8")
    return path


def quicken(text: str) -> str:
    """The firm rig's file, or one like it, with quicker ways and half the frames: runs cost two thirds."""
    return _replaced(
        text,
        ("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 30.0"),
        ("sample_rate_hz = 250.0", "sample_rate_hz = 125.0"),
    )


def _replaced(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


def small_parts(folder: Path) -> Path:
    """Write the catalogue of small parts; returns its file."""
    objects = folder / "small-parts.json"
    parts = [{"name": name, "height": 20.0, "outline": ring} for name, ring in SMALL_PARTS.items()]
    objects.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": parts}))
    return objects


# ----------------------------------------------------------------------------------------------------
# Recorded sessions on emulated devices, of seed 7; the fixture `recorded` runs each once.


def grips(folder: Path, count: int, rig: Path, objects: Path | None = None) -> Path:
    """The folder, in `folder`, of a session that gives up after so many grips."""
    text, number = re.subn(r"max_grips = \d+", f"max_grips = {count}", rig.read_text(encoding="utf-8"))
    assert number == 1
    (folder / "brief.toml").write_text(text)
    with palpate.open_rig(folder / "brief.toml", seed=7) as opened:
        opened.identify(objects, sessions=folder / "sessions")
    (found,) = (folder / "sessions").iterdir()
    return found


TWO_PARTS = {
    "format": "palpate/scene@1",
    "parts": [
        {"object": "tr-1", "configuration": {"x": -10.0, "y": 50.0, "theta": 0.3}},
        {"object": "grip", "configuration": {"x": 5.0, "y": -45.0, "theta": 2.0}},
    ],
}


def two_parts(folder: Path) -> Path:
    """The folder, in `folder`, of a whole session with two parts on the table."""
    with palpate.open_rig(quick_copy(firm_rig(), folder), seed=0) as opened:
        answer = opened.identify(scene=Scene.model_validate(TWO_PARTS), parts=2, sessions=folder)
    return Path(str(answer.session))


RUNS: Mapping[str, Callable[[Path], Path]] = {
    "two grips": lambda folder: grips(folder, 2, quick_copy(firm_rig(), folder)),
    "two grips with pads": lambda folder: grips(folder, 2, quick_copy(EXAMPLES / "pad-rig.toml", folder)),
    "one grip": lambda folder: grips(folder, 1, *quick_bench(folder)),
    "whole": lambda folder: grips(folder, 8, *quick_bench(folder)),
    "two parts": two_parts,
}
