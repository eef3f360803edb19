"""Which states of a catalogue a rig cannot feel: every kind of trouble, and none where there is none."""

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from firm_rig import firm_rig
from hypothesis import given
from hypothesis import strategies as st
from odd_parts import OUTLINE, objects_file, part
from repository import EXAMPLES
from sampling import sample
from shapely_bench import Placed
from simulated_touches import SimulatedTouches

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile, load_objects, load_rig, shipped_objects, shipped_rig
from palpate.recognizer import Catalogue
from palpate.rig.catalogue.reachability import (
    HOPELESS,
    Finding,
    Trouble,
    finding_lines,
    findings_of,
    untouched_lines,
)
from palpate.rig.identification.loop import search
from palpate.rig.reach.approaches import reach_of

BENCH = load_rig(firm_rig())
ARMS = load_rig(EXAMPLES / "two-link-rig.toml")
RIGS = {"firm": BENCH, "arms": ARMS}


def at_heights(*heights_mm: float) -> RigFile:
    """The firm rig with its fingers at other heights."""
    fingers = [
        finger.model_copy(update={"height_mm": height})
        for finger, height in zip(BENCH.fingers, heights_mm, strict=True)
    ]
    return BENCH.model_copy(update={"fingers": fingers})


def states(*sections: tuple[float, float], **more: Any) -> dict[str, Any]:
    rings = [{"outer": [list(point) for point in OUTLINE]}]
    entries = [{"z": list(z), "polygons": rings} for z in sections]
    return {"name": "part", "states": [{"name": "s", "sections": entries} | more]}


def drawn(ring: Sequence[Sequence[float]], height: float = 20.0) -> ObjectModel:
    section = Section((0.0, height), (Polygon(np.array(ring, dtype=float)),))
    return ObjectModel("drawn", (State("flat", (section,)),))


def found(folder: Path, rig: RigFile, *parts: dict[str, Any]) -> tuple[Finding, ...]:
    return findings_of(rig, load_objects(objects_file(folder / "parts.json", *parts)).objects)


@pytest.mark.parametrize(
    "path", [shipped_rig(), *sorted(EXAMPLES.glob("*.toml"))], ids=lambda path: path.name
)
def test_the_shipped_catalogue_has_no_finding_on_any_shipped_rig(path: Path) -> None:
    objects = load_objects(shipped_objects()).objects
    begin = time.process_time()
    assert findings_of(load_rig(path), objects) == ()
    assert time.process_time() - begin < 0.1


@pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)
@pytest.mark.parametrize(
    ("entry", "trouble", "scale"),
    [
        (part("low", height=5.0), Trouble.MISSED, None),
        (states((12.0, 20.0)), Trouble.MISSED, None),
        (part("metres", 0.001, 0.02), Trouble.MISSED, 1000.0),
        (part("inches", 1 / 25.4, 20 / 25.4), Trouble.MISSED, 25.4),
        (part("huge", 25.4), Trouble.OVERSIZED, None),
        (part("long", outline=((0, 0), (300, 0), (300, 10), (0, 10))), Trouble.STICKS_OUT, None),
        (part("thread", 0.01, height=20.0), Trouble.TINY, None),
    ],
    ids=lambda value: value["name"] if isinstance(value, dict) else "",
)
def test_every_trouble_is_found(
    tmp_path: Path, rig: RigFile, entry: dict[str, Any], trouble: Trouble, scale: float | None
) -> None:
    (finding,) = found(tmp_path, rig, entry)
    assert finding.trouble is trouble
    if trouble is not Trouble.TINY:  # a thread of 20 mm may be any unit's
        assert finding.scale == (None if scale is None else pytest.approx(scale))


def test_what_was_converted_once_too_often(tmp_path: Path) -> None:
    for rig, trouble in ((BENCH, Trouble.OVERSIZED), (ARMS, Trouble.LINKS)):
        (finding,) = found(tmp_path, rig, part("twice converted", 25.4, height=20.0 * 25.4))
        assert (finding.trouble, finding.scale) == (trouble, pytest.approx(1 / 25.4))


def test_an_arm_cannot_pass_above_a_high_part(tmp_path: Path) -> None:
    entry = part("tower", height=30.0)
    (finding,) = found(tmp_path, ARMS, entry)
    assert (finding.trouble, finding.size_mm) == (Trouble.LINKS, 30.0)
    assert found(tmp_path, BENCH, entry) == ()


def test_some_fingers_pass_above(tmp_path: Path) -> None:
    rig = at_heights(10.0, 25.0, 10.0)
    (finding,) = found(tmp_path, rig, part("middling", height=20.0))
    assert (finding.trouble, finding.fingers) == (Trouble.SOME_FINGERS, ("f1", "f3"))
    assert found(tmp_path, rig, part("high", height=25.0)) == ()


def test_a_wide_base_below_the_fingers_is_no_trouble(tmp_path: Path) -> None:
    """Only what is at a finger's height counts; and what is not known there is not called missing."""
    base = [[x * 5, y * 5] for x, y in OUTLINE]
    small = [list(point) for point in OUTLINE]
    sections = [
        {"z": [0, 8], "polygons": [{"outer": base}]},
        {"z": [8, 20], "polygons": [{"outer": small}]},
    ]
    assert found(tmp_path, BENCH, {"name": "hat", "states": [{"name": "s", "sections": sections}]}) == ()
    unknown = states((4.5, 5.5), height=20.0, heights=[[4.5, 5.5]])
    assert found(tmp_path, BENCH, unknown) == ()


def test_a_catalogue_is_refused_only_if_all_of_it_is_hopeless(tmp_path: Path) -> None:
    low = objects_file(tmp_path / "low.json", part("low", height=5.0), part("m", 0.001, 0.02))
    with pytest.raises(InputError) as refused:
        finding_lines(BENCH, load_objects(low).objects, "low.json")
    for words in (
        "low.json",
        '"firm-bench"',
        "low, flat (5 mm high)",
        "10 mm (f1, f2, f3)",
        "metres",
        "1000",
    ):
        assert words in str(refused.value)
    assert "\n" not in str(refused.value)
    mixed = objects_file(tmp_path / "mixed.json", part("low", height=5.0), part("ok"))
    (line,) = finding_lines(BENCH, load_objects(mixed).objects, "mixed.json")
    assert line.startswith("mixed.json: low, flat (5 mm high)")
    assert "metres" not in line


def test_many_of_a_kind_are_one_line(tmp_path: Path) -> None:
    many = objects_file(tmp_path / "many.json", part("ok"), *(part(f"low-{n}", height=5.0) for n in range(9)))
    (line,) = finding_lines(BENCH, load_objects(many).objects, "many.json")
    assert "low-4, flat" in line
    assert "4 more states" in line
    assert "low-5" not in line


def test_advice_names_region_and_heights(tmp_path: Path) -> None:
    two = objects_file(tmp_path / "two.json", part("ok"), part("other", height=12.5))
    said = "\n".join(untouched_lines(at_heights(10.0, 15.0, 10.0), load_objects(two).objects))
    for words in ("250 mm", "(0, 0)", "10 mm (f1, f3) and 15 mm (f2)", "12.5 to 20 mm", "palpate watch"):
        assert words in said


@given(
    st.floats(4.0, 120.0),
    st.floats(4.0, 120.0),
    st.floats(10.0, 200.0),
    st.floats(0, 2 * math.pi),
)
def test_parts_that_fit_are_never_refused(width: float, depth: float, height: float, turn: float) -> None:
    """Rectangles that fit into the workspace, in any frame, as high as the fingers or higher."""
    cos, sin = math.cos(turn), math.sin(turn)
    corners = ((0, 0), (width, 0), (width, depth), (0, depth))
    ring = [[900 + cos * x - sin * y, sin * x + cos * y] for x, y in corners]
    model = drawn(ring, height)
    assert findings_of(BENCH, [model]) == ()
    lower = [item.trouble for item in findings_of(ARMS, [model])]
    assert lower == ([Trouble.LINKS] if height >= 30.0 else [])


@pytest.mark.parametrize("seeds", sample([16, 40], [16]))
def test_what_a_search_identifies_is_never_hopeless(seeds: int) -> None:
    """Triangles and slabs from 1 to 350 mm, also such as stick out of the workspace, felt by simulation."""
    reach, identified = reach_of(BENCH), 0
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 31])
        long, wide = np.exp(rng.uniform(np.log(1.0), np.log([350.0, 120.0])))
        ring = [[0, 0], [long, 0], [long * rng.uniform(0.2, 1), wide], [0, wide * rng.uniform(0.2, 1)]]
        model = drawn((np.array(ring) - np.mean(ring, axis=0)).tolist())
        away = rng.uniform(-20, 20, 2)
        placed = Placed(model, float(away[0]), float(away[1]), float(rng.uniform(-3, 3)))
        touches = SimulatedTouches(reach, placed, rng)
        result = search(BENCH, reach, touches, Catalogue([model]), seed=seed)
        if result.outcome is IdentificationVerdict.IDENTIFIED:
            identified += 1
            assert not {item.trouble for item in findings_of(BENCH, [model])} & HOPELESS, seed
    assert identified >= 0.37 * seeds


def test_no_unit_is_guessed_of_what_is_known_near_some_heights_only(tmp_path: Path) -> None:
    (finding,) = found(tmp_path, BENCH, states((1.5, 2.5), height=2.5, heights=[[1.5, 2.5]]))
    assert (finding.trouble, finding.scale) == (Trouble.MISSED, None)
