"""Files of contacts, scenes, results and emulated parts; examples; files taken for others."""

import copy
import json
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import shapely
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from shapely import affinity

from palpate.base.errors import InputError
from palpate.base.vocabulary import RecognitionVerdict
from palpate.config import (
    ContactEntry,
    load_contacts,
    load_objects,
    load_rig,
    load_scene,
    shipped_objects,
    shipped_rig,
)
from palpate.config.emulation import ConfigurationText
from palpate.config.fields import BoundsOut, ConfigurationOut, to_json
from palpate.config.recognition_results import (
    HypothesisOut,
    InterpretationOut,
    LevelOut,
    RecognitionOut,
    StatisticsOut,
)
from palpate.config.writers import file_text
from support.benches.rigs import firm_rig
from support.commands.repository import EXAMPLES

TOUCH: dict[str, Any] = {
    "finger": "f1",
    "touched": True,
    "centre": [10, 0],
    "height": 10.0,
    "tip_radius": 5.0,
    "position_bound": 0.3,
    "normal": [-0.2, 0.2],
    "approach": {"direction": math.pi, "start": [100, 0]},
}
MISS: dict[str, Any] = {
    "finger": "f3",
    "touched": False,
    "height": 10.0,
    "tip_radius": 5.0,
    "position_bound": 0.3,
    "approach": {"direction": 0.0, "start": [-100, 0], "end": [50, 0]},
}


def write(folder: Path, content: object) -> Path:
    file = folder / "input.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    return file


def contacts(*entries: dict[str, Any]) -> dict[str, Any]:
    return {"format": "palpate/contacts@1", "units": "mm, rad", "grips": [{"contacts": list(entries)}]}


def without(entry: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key not in keys}


def test_the_length_of_a_tip(tmp_path: Path) -> None:
    (grip,) = load_contacts(write(tmp_path, contacts(TOUCH | {"tip_length": 12.0}, MISS))).grips
    assert [item.tip_length for item in grip.contacts] == [12.0, 0.0]
    with pytest.raises(InputError, match=r"tip_length.*: is 21, too much for a tip at height 10"):
        load_contacts(write(tmp_path, contacts(TOUCH | {"tip_length": 21})))


def test_a_touch_and_a_miss_come_through(tmp_path: Path) -> None:
    (grip,) = load_contacts(write(tmp_path, contacts(TOUCH, MISS))).grips
    touch, miss = grip.contacts
    assert (touch.centre, touch.normal, touch.approach.end) == ((10.0, 0.0), (-0.2, 0.2), None)
    assert (miss.touched, miss.centre, miss.approach.end) == (False, None, (50.0, 0.0))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (without(TOUCH, "centre"), 'grip 0, contact 0: a finger that touched needs the key "centre"'),
        (MISS | {"centre": [0, 0]}, "grip 0, contact 0, centre: a finger that touched nothing has none"),
        (
            MISS | {"approach": TOUCH["approach"]},
            "contact 0, approach: a finger that touched nothing needs the key",
        ),
        (TOUCH | {"approach": MISS["approach"]}, "contact 0, approach.end: a finger that touched stopped"),
        (TOUCH | {"normal": [1, 0]}, "normal: is [1, 0]; hi is counter-clockwise from lo"),
        (TOUCH | {"normal": [0, 7]}, "more than a full turn"),
        (TOUCH | {"centre": [101, 0]}, "contact 0, centre: lies 1 mm behind the start"),
        (TOUCH | {"tip_radius": -1}, "grip 0, contact 0, tip_radius: is -1; it must be at least 0"),
        (TOUCH | {"touched": 1}, "touched: is 1; it must be true or false"),
        (TOUCH | {"hight": 3}, 'grip 0, contact 0: unknown key "hight"; did you mean "height"?'),
    ],
)
def test_contacts_that_contradict_themselves_are_refused(
    tmp_path: Path, entry: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_contacts(write(tmp_path, contacts(entry)))
    assert message in str(caught.value)


def test_a_finger_touches_once_per_grip(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'contact 1, finger: "f1" is contact 0 of this grip already'):
        load_contacts(write(tmp_path, contacts(TOUCH, TOUCH)))


def test_a_scene_finds_its_objects_beside_itself(tmp_path: Path) -> None:
    content = {
        "format": "palpate/scene@1",
        "object": "plate",
        "configuration": {"x": 1, "y": -2.5, "theta": 0.3},
        "objects": "other.json",
    }
    scene = load_scene(write(tmp_path, content))
    assert scene.configuration == ConfigurationText(x=1.0, y=-2.5, theta=0.3)
    assert scene.state is None
    assert scene.objects == str(tmp_path / "other.json")
    with pytest.raises(InputError, match=r"configuration.theta: is nan; it must be a finite number"):
        load_scene(write(tmp_path, content | {"configuration": {"x": 0, "y": 0, "theta": math.nan}}))
    with pytest.raises(InputError, match=r"configuration.theta: is 90; it is in rad"):
        load_scene(write(tmp_path, content | {"configuration": {"x": 0, "y": 0, "theta": 90}}))


def recognition(x: float = 1.23456789) -> RecognitionOut:
    return RecognitionOut(
        verdict=RecognitionVerdict.UNIQUE,
        hypotheses=(
            HypothesisOut(
                object="plate",
                state="flat",
                configuration=ConfigurationOut(x=x, y=-1e-9, theta=0.1),
                bounds=BoundsOut(x=(0.12345678, 0.12345678), y=(-0.12345678, 0.1), theta=(0.0, 3.5)),
                weight=1,
                verified=True,
                symmetry_order=1,
                interpretations=(
                    InterpretationOut(edges=(17, 3, 40), features=("edge 17", "vertex 3", "edge 40")),
                ),
            ),
        ),
        statistics=StatisticsOut(
            levels=(LevelOut(level=2, candidates=9, after_distance=4, after_angle=3),),
            model_tests=1,
            seconds=0.5,
        ),
    )


def test_results_are_rounded_and_bounds_never_inward() -> None:
    written = json.loads(to_json(recognition()))
    assert list(written) == [
        "format",
        "units",
        "verdict",
        "hypotheses",
        "statistics",
        "unfinished",
        "explanation",
        "why",
        "left_out",
    ]
    (hypothesis,) = written["hypotheses"]
    assert hypothesis["configuration"] == {"x": 1.234568, "y": 0.0, "theta": 0.1}
    assert hypothesis["bounds"] == {"x": [0.123456, 0.123457], "y": [-0.123457, 0.1], "theta": [0.0, 3.5]}
    assert hypothesis["interpretations"] == [
        {"edges": [17, 3, 40], "features": ["edge 17", "vertex 3", "edge 40"]}
    ]
    assert "-0.0" not in to_json(recognition())
    assert to_json(recognition()) == to_json(recognition())


def test_a_result_that_is_not_finite_is_a_bug() -> None:
    with pytest.raises(ValidationError, match="finite"):
        recognition(math.inf)


# ----------------------------------------------------------------------------------------------------
# The examples tell one story: `contacts.json` was felt on the part that `scene.json` puts on the bench.

CONTACTS = [contact for grip in load_contacts(EXAMPLES / "contacts.json").grips for contact in grip.contacts]


def part_on_the_table() -> shapely.Polygon:
    scene = load_scene(EXAMPLES / "scene.json")
    (model,) = [m for m in load_objects(shipped_objects()).objects if m.name == scene.object]
    (state,) = [s for s in model.states if s.name == scene.state]
    turned = affinity.rotate(
        shapely.Polygon(state.sections[0].polygons[0].outer),
        scene.configuration.theta,
        origin=(0, 0),
        use_radians=True,
    )
    return affinity.translate(turned, scene.configuration.x, scene.configuration.y)


@pytest.mark.parametrize("contact", [c for c in CONTACTS if c.touched])
def test_touches_lie_on_the_part_within_their_bounds(contact: ContactEntry) -> None:
    assert contact.centre is not None
    assert contact.normal is not None
    part, centre = part_on_the_table(), shapely.Point(contact.centre)
    assert part.distance(centre) == pytest.approx(contact.tip_radius, abs=contact.position_bound)
    foot = shapely.shortest_line(part, centre).coords
    normal = math.atan2(foot[1][1] - foot[0][1], foot[1][0] - foot[0][0])
    lo, hi = contact.normal
    assert (normal - lo) % (2 * math.pi) <= hi - lo


def test_misses_pass_the_part_by() -> None:
    misses = [contact for contact in CONTACTS if not contact.touched]
    assert misses
    for contact in misses:
        assert contact.approach.end is not None
        swept = shapely.LineString([contact.approach.start, contact.approach.end])
        assert part_on_the_table().distance(swept) > contact.tip_radius


def rig_file(folder: Path, *lines: str) -> Path:
    text = firm_rig().read_text(encoding="utf-8")
    table = "\n".join(("[emulation.part]", *lines, "", "[[fingers]]"))
    (folder / "rig.toml").write_text(text.replace("[[fingers]]", table, 1), encoding="utf-8")
    return folder / "rig.toml"


def test_numbers_and_ranges_come_through_and_can_be_written(tmp_path: Path) -> None:
    file = rig_file(tmp_path, 'engine = "mujoco"', "mass_kg = [0.05, 1]", "tip_friction = 0", "feet = 3")
    rig = load_rig(file)
    assert rig.emulation is not None
    part = rig.emulation.part
    assert part is not None
    assert (part.engine, part.mass_kg, part.friction) == ("mujoco", (0.05, 1.0), 0.3)
    assert (part.tip_friction, part.feet) == (0.0, 3)
    (tmp_path / "again.toml").write_text(file_text(rig), encoding="utf-8")
    assert load_rig(tmp_path / "again.toml") == rig


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", 'part: the key "engine" is missing'),
        ('engine = "magic"', '"magic"; allowed: "still", "quasi-static", "mujoco"'),
        ("mass_kg = 0", "mass_kg: is 0; it must be above 0"),
        ('mass_kg = "1"', 'mass_kg: is "1"; it must be a number'),
        ("mass_kg = [1.0, 0.5]", "mass_kg: is [1, 0.5]; the first value must be below the second"),
        ("mass_kg = [1.0]", "mass_kg: has 1 value, more are needed"),
        ("mass_kg = [0.1, nan]", "mass_kg[1]: is nan; it must be a finite number"),
        ("friction = 0.0", "friction: is 0.0; it must be above 0"),
        ("tip_friction = [0.1, 3.0]", "tip_friction[1]: is 3.0; it must be at most 2"),
        ("feet = 2", "feet: is 2; a part stands on 3 feet at least, or on its whole base (0)"),
        ("feets = 3", 'unknown key "feets"; did you mean "feet"?'),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, line: str, words: str) -> None:
    given = [] if line == "" else [line] if line.startswith("engine") else ['engine = "still"', line]
    with pytest.raises(InputError) as caught:
        load_rig(rig_file(tmp_path, *given))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def scene(folder: Path, **part: Any) -> Path:
    text = {
        "format": "palpate/scene@1",
        "object": "plate",
        "configuration": {"x": 1.0, "y": 2.0, "theta": 0.5},
        "part": part,
    }
    (folder / "scene.json").write_text(json.dumps(text), encoding="utf-8")
    return folder / "scene.json"


def test_a_scene_may_say_mass_and_friction(tmp_path: Path) -> None:
    found = load_scene(scene(tmp_path, mass_kg=0.3))
    assert (found.part.mass_kg, found.part.friction) == (0.3, None)
    (tmp_path / "again.json").write_text(file_text(found), encoding="utf-8")
    assert load_scene(tmp_path / "again.json") == found
    with pytest.raises(InputError, match=r"part\.friction: is -1; it must be above 0"):
        load_scene(scene(tmp_path, friction=-1))


# ----------------------------------------------------------------------------------------------------
# Files given for others: said as that, and not as faults of their syntax.


@pytest.mark.parametrize("name", ["part.dxf", "PART.STL", "a part.step"])
@pytest.mark.parametrize("content", [b"  0\nSECTION\n", b"\x00\xc0\xff", b""])
def test_a_cad_file_is_to_be_imported(name: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as refused:
        load_objects(path)
    advice = f"{path}: is a CAD file; `palpate objects import {path}` makes object models of it"
    assert str(refused.value) == advice
    if content:
        with pytest.raises(InputError, match=r'is a CAD file; needed here: "palpate/rig@1"$'):
            load_rig(path)


def test_objects_are_no_rig(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(shipped_objects().read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(InputError, match=r'format: is "palpate/objects@1"; needed here: "palpate/rig@1"$'):
        load_rig(path)


# ----------------------------------------------------------------------------------------------------
# Whatever a file holds: it is read, or refused with one `InputError` line. Never anything else.

QUICK = settings(max_examples=120, derandomize=True)

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(min_value=-(10**30), max_value=10**30),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["mm", "palpate/rig@1", "f1", "mock://bus", 10**400, -0.0, 1e308, 5e-324]),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=8,
)


def accepted_or_refused(load: Callable[[Path], object], raw: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "input"
        file.write_bytes(raw)
        try:
            load(file)
        except InputError as error:
            message = str(error)
            assert message.startswith(f"{file}: ")
            assert len(message.splitlines()) == 1
            assert "pydantic" not in message
            assert "://errors" not in message


def mutated(data: st.DataObject, document: Any) -> Any:
    """`document` with one random node replaced, left out, renamed or repeated."""
    document = copy.deepcopy(document)
    node = document
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return document
        key = data.draw(st.sampled_from(keys))
        deeper = isinstance(node[key], dict | list)
        if not deeper or data.draw(st.integers(0, 3)) == 0:
            break
        node = node[key]
    action = data.draw(st.sampled_from(["replace", "remove", "repeat"]))
    if action == "replace":
        node[key] = data.draw(values)
    elif action == "remove":
        del node[key]
    elif isinstance(node, dict):
        node[data.draw(st.text(max_size=6))] = node[key]
    else:
        node.append(node[key])
    return document


@pytest.mark.parametrize("load", [load_objects, load_contacts, load_scene, load_rig])
@given(raw=st.binary(max_size=80))
@QUICK
def test_any_bytes(load: Callable[[Path], object], raw: bytes) -> None:
    accepted_or_refused(load, raw)


JSON_FILES = [
    (load_objects, shipped_objects().read_text(encoding="utf-8")),
    (load_contacts, (EXAMPLES / "contacts.json").read_text(encoding="utf-8")),
    (load_scene, (EXAMPLES / "scene.json").read_text(encoding="utf-8")),
]


@pytest.mark.parametrize(("load", "text"), JSON_FILES, ids=["objects", "contacts", "scene"])
@given(data=st.data())
@QUICK
def test_json_files_with_one_thing_changed(
    load: Callable[[Path], object], text: str, data: st.DataObject
) -> None:
    accepted_or_refused(load, json.dumps(mutated(data, json.loads(text))).encode())


@given(data=st.data())
@QUICK
def test_rigs_with_one_thing_changed(data: st.DataObject) -> None:
    document = mutated(data, tomlkit.parse(shipped_rig().read_text(encoding="utf-8")).unwrap())
    try:
        raw = tomlkit.dumps(document).encode()
    except (tomlkit.exceptions.TOMLKitError, TypeError, ValueError):
        return  # TOML cannot say it, null for one
    accepted_or_refused(load_rig, raw)
