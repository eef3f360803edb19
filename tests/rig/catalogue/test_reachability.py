"""Heights and parts within reach."""

import json
import math
import re
import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile, load_objects, load_rig, load_scene, shipped_objects, shipped_rig
from palpate.config.schema import schema_text
from palpate.recognizer import Catalogue
from palpate.rig.catalogue.finger_model import FingerAtHeight, KnownObjects, check_known
from palpate.rig.catalogue.reachability import (
    HOPELESS,
    Finding,
    Trouble,
    finding_lines,
    findings_of,
    untouched_lines,
)
from palpate.rig.emulated.ground_truth import scene_lines
from palpate.rig.emulated.table import placements_of
from palpate.rig.identification.identify import search
from palpate.rig.reach.approaches import reach_of
from support.benches.parts import OUTLINE, objects_file, part, scene_file
from support.benches.rigs import firm_rig, small
from support.campaign.sampling import sample
from support.commands.command import Ended, Here, missing, violations
from support.commands.repository import EXAMPLES
from support.oracles.plans import SimulatedTouches
from support.oracles.shapely_touches import Placed

# ----------------------------------------------------------------------------------------------------
# Catalogues with objects that are not known where a finger is: refused by every command that takes both.

OUTER = [[-30.0, -20.0], [30.0, -20.0], [30.0, 20.0], [-30.0, 20.0]]


def write(
    folder: Path, heights: list[list[float]] | None, top: float = 30.0, name: str = "parts.json"
) -> Path:
    sections = [{"z": z, "polygons": [{"outer": OUTER}]} for z in heights or [[0, top]]]
    known = {} if heights is None else {"heights": heights}
    state: dict[str, Any] = {"name": "state-2", "height": top, **known, "sections": sections}
    objects = [{"name": "bracket", "states": [state]}]
    file = folder / name
    file.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": objects}))
    return file


def contacts(folder: Path, height: float) -> Path:
    approach = {"direction": 3.14159, "start": [100.0, 0.0]}
    touch = {"finger": "f7", "touched": True, "centre": [35.0, 0.0], "height": height, "tip_radius": 5.0}
    touch |= {"position_bound": 0.5, "approach": approach}
    file = folder / "felt.json"
    content = {"format": "palpate/contacts@1", "units": "mm, rad", "grips": [{"contacts": [touch]}]}
    file.write_text(json.dumps(content))
    return file


@pytest.mark.parametrize(
    ("height", "known"), [(5.0, True), (4.4, False), (10.0, False), (30.0, False), (31.0, True)]
)
def test_a_finger_must_be_where_the_state_is_known(tmp_path: Path, height: float, known: bool) -> None:
    objects = load_objects(write(tmp_path, [[4.5, 5.5], [11.5, 12.5]])).objects
    fingers = [FingerAtHeight("f0", 5.0), FingerAtHeight("f1", height)]
    if known:
        check_known(objects, fingers)
        return
    wanted = ",".join(f"{item:g}" for item in sorted({5.0, height}))
    with pytest.raises(InputError) as caught:
        check_known(objects, fingers)
    known_at = "4.5–5.5 and 11.5–12.5 mm"
    words = ('"bracket"', '"state-2"', known_at, f"f1 is at {height:g} mm", f"for heights {wanted}")
    assert missing(str(caught.value), *words) == []


def test_a_height_that_would_do_is_named(tmp_path: Path) -> None:
    low = load_objects(write(tmp_path, [[4.5, 5.5], [9.0, 9.806]], name="low.json")).objects
    whole = load_objects(write(tmp_path, None, 9.5, name="whole.json")).objects
    with pytest.raises(InputError, match=r"or set the finger to 9\.8 mm, where all states are known"):
        check_known([*low, *whole], [FingerAtHeight("f1", 10.0)])
    high = load_objects(write(tmp_path, [[10.5, 11.0]], name="high.json")).objects
    with pytest.raises(InputError, match=r"\(1 more state is not known where fingers are\)") as caught:
        check_known([*low, *high], [FingerAtHeight("f1", 10.0)])
    assert "set the finger" not in str(caught.value)


@pytest.mark.parametrize(("beside", "again"), [([[9.5, 9.8], [10.1, 10.5]], False), ([[4.5, 5.5]], True)])
def test_importing_again_is_advised_only_where_it_helps(
    tmp_path: Path, beside: list[list[float]], again: bool
) -> None:
    """The import for a height leaves out what is too nearly level just there, and would do so again."""
    low = load_objects(write(tmp_path, beside, name="low.json")).objects
    whole = load_objects(write(tmp_path, None, name="whole.json")).objects
    notice = KnownObjects.of([*low, *whole], [FingerAtHeight("f1", 10.0)]).notice
    assert notice is not None
    assert ("import them again for heights 10" in notice) is again


def test_all_along_a_tip_the_state_must_be_known(tmp_path: Path) -> None:
    objects = load_objects(write(tmp_path, [[4.5, 14.0]])).objects
    check_known(objects, [FingerAtHeight("f1", 9.0, 4.0)])
    words = r"4\.5–14 mm only; finger f1 is at 10 mm \(its tip from 4 to 16 mm\): .* for heights 4-16, with"
    with pytest.raises(InputError, match=words):
        check_known(objects, [FingerAtHeight("f1", 10.0, 6.0)])
    with pytest.raises(InputError, match=r"or set the finger to 9\.5 mm"):
        check_known(objects, [FingerAtHeight("f1", 10.0, 4.5)])


def test_objects_without_heights_are_known(tmp_path: Path) -> None:
    check_known(load_objects(write(tmp_path, None)).objects, [FingerAtHeight("f1", 10.0)])


def refused(ended: Ended, finger: str) -> None:
    assert (ended.code, ended.out) == (2, "")
    said = (
        f'error: object "bracket", state "state-2" is known at heights 4.5–5.5 mm only; finger {finger} is at'
    )
    assert ended.err.startswith(said)
    assert ended.err.count("\n") == 1


def test_commands_refuse_such_a_pair(tmp_path: Path, here: Here) -> None:
    low = write(tmp_path, [[4.5, 5.5]])
    felt = contacts(tmp_path, 10.0)
    refused(here("recognize", "--objects", low, "--contacts", felt), "f7")
    refused(here("plan", "--objects", low, "--contacts", contacts(tmp_path, 5.0)), "f1")  # the shipped rig's
    refused(here("identify", "--objects", low), "f1")
    refused(here("emulate", "--objects", low, "--for", "0.01"), "f1")
    assert not (tmp_path / "palpate-sessions").exists()


def test_a_scene_with_objects_of_its_own_is_refused_too(tmp_path: Path, here: Here) -> None:
    low = write(tmp_path, [[4.5, 5.5]], name="others.json")
    scene = {"format": "palpate/scene@1", "object": "bracket", "state": "state-2", "objects": low.name}
    scene |= {"configuration": {"x": 0.0, "y": 0.0, "theta": 0.0}}
    file = tmp_path / "scene.json"
    file.write_text(json.dumps(scene))
    refused(here("identify", "--objects", write(tmp_path, None), "--scene", file), "f1")


def test_contacts_where_the_state_is_known_are_recognised(tmp_path: Path, here: Here) -> None:
    near = write(tmp_path, [[4.5, 5.5]])
    everywhere = write(tmp_path, None, name="all.json")
    felt = contacts(tmp_path, 5.0)
    found = [
        here("recognize", "--objects", file, "--contacts", felt, "--json").json for file in (near, everywhere)
    ]
    assert found[0]["hypotheses"] == found[1]["hypotheses"] != []


def test_answers_name_the_states_that_were_not_looked_for(tmp_path: Path, here: Here) -> None:
    known, low = (json.loads(write(tmp_path, heights).read_text()) for heights in (None, [[4.5, 5.5]]))
    (other,) = low["objects"][0]["states"]
    known["objects"][0]["states"][0] |= {"name": "state-1", "probability": 0.75}
    known["objects"][0]["states"].append(other | {"probability": 0.25})
    objects, felt = tmp_path / "both.json", contacts(tmp_path, 10.0)
    objects.write_text(json.dumps(known))
    rig = tmp_path / "rig.toml"
    rig.write_text(small(firm_rig()).replace("max_grips = 12", "max_grips = 1"), encoding="utf-8")
    for words in (
        ("recognize", "--contacts", felt),
        ("plan", "--contacts", felt),
        ("identify", "--rig", rig, "--seed", "1"),
    ):
        ended = here(*words, "--objects", objects, "--json")
        assert ended.json["left_out"] == [{"object": "bracket", "state": "state-2", "probability": 0.25}]
        assert "bracket, state-2 (25 % of cases)" in ended.err
    everything = here("recognize", "--objects", write(tmp_path, None), "--contacts", felt, "--json")
    assert everything.json["left_out"] == []


def test_a_session_is_not_replayed_with_such_objects(tmp_path: Path, here: Here) -> None:
    sessions = tmp_path / "sessions"
    objects = write(tmp_path, None)
    rig = tmp_path / "rig.toml"
    rig.write_text(small(firm_rig()).replace("max_grips = 12", "max_grips = 1"), encoding="utf-8")
    words = ("--rig", rig, "--objects", objects, "--sessions", sessions)
    assert here("identify", *words).code in (0, 1)
    (folder,) = sessions.iterdir()
    (folder / "objects.json").write_text(write(tmp_path, [[4.5, 5.5]]).read_text())
    refused(here("replay", folder), "f1")


# ----------------------------------------------------------------------------------------------------
# Parts that no finger can feel, on `objects check`, `identify` and `plan`: said before anything moves.

RIGS = {"firm": firm_rig(), "arms": EXAMPLES / "two-link-rig.toml"}
COMMANDS = ("objects check", "identify", "plan")
REFUSED = {
    "low": (part("p", height=5.0), ["p, flat (5 mm high)", "any finger, 10 mm"]),
    "metres": (part("p", 0.001, 0.02), ["0.02 mm high", "metres", "1000"]),
    "inches": (part("p", 1 / 25.4, 20 / 25.4), ["0.787 mm high", "inches", "25.4"]),
    "huge": (part("p", 25.4), ["mm across", "larger in all directions", "round (0, 0)"]),
}
NOTICED = {
    "low": (part("p", height=5.0), ["p, flat (5 mm high)", "any finger, 10 mm"]),
    "long": (
        part("p", outline=((0, 0), (300, 0), (300, 10), (0, 10))),
        ["300 mm across", "too long"],
    ),
    "thread": (part("p", 0.01), ["0.806 mm across", "smaller"]),
}


ARMS_IDENTIFY = ("identify", "low", "arms")
ASKED = [
    *product(("objects check",), NOTICED, RIGS),
    ("plan", "low", "firm"),
    ("identify", "low", "firm"),
    ARMS_IDENTIFY,
]


@pytest.fixture
def ask(tmp_path: Path, here: Here) -> Here:
    """Runs one of the commands in this process, in a folder of its own, on one of the rigs."""

    def asked(command: str, rig: str, objects: Path, *options: object) -> Ended:
        text = RIGS[rig].read_text(encoding="utf-8")
        (tmp_path / "rig.toml").write_text(re.sub(r"max_grips = \d+", "max_grips = 1", text))
        args: list[object] = [*command.split()]
        args += [objects] if command == "objects check" else ["--objects", objects]
        if command == "plan":
            contacts = (EXAMPLES / "first-grip.json").read_text(encoding="utf-8")
            (tmp_path / "contacts.json").write_text(contacts)
            args += ["--contacts", "contacts.json"]
        return here(*args, "--rig", "rig.toml", *options)

    return asked


@pytest.mark.parametrize("command", COMMANDS)
def test_a_catalogue_of_which_nothing_can_be_felt_is_refused(ask: Here, tmp_path: Path, command: str) -> None:
    ended = ask(command, "firm", objects_file(tmp_path / "parts.json", part("p", height=5.0)), "--json")
    assert (ended.code, ended.out) == (2, "")
    (line,) = ended.err.splitlines()
    assert line.startswith("error: ")
    assert missing(line, "parts.json", "p, flat (5 mm high)") == []
    assert not (tmp_path / "palpate-sessions").exists(), "nothing was begun"


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_wrong_with_all_parts_is_said(tmp_path: Path, rig: str, kind: str) -> None:
    entry, said = REFUSED[kind]
    objects = load_objects(objects_file(tmp_path / "parts.json", entry)).objects
    with pytest.raises(InputError) as refused:
        finding_lines(load_rig(RIGS[rig]), objects, "parts.json")
    assert missing(str(refused.value), "parts.json", *said) == []
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("command", "kind", "rig"), sample(ASKED, [row for row in ASKED if row != ARMS_IDENTIFY])
)
def test_a_part_that_cannot_be_felt_is_noticed_beside_others(
    ask: Here, tmp_path: Path, rig: str, command: str, kind: str
) -> None:
    entry, said = NOTICED[kind]
    objects = objects_file(tmp_path / "parts.json", entry, part("other"))
    scene = scene_file(tmp_path / "scene.json", "other", -30, -20)
    options = ("--scene", scene) if command == "identify" else ()
    ended = ask(command, rig, objects, "--json", *options)
    assert ended.code in (0, 1)
    assert ended.json["format"].startswith("palpate/")
    notices = [line for line in ended.err.splitlines() if line.startswith("notice: ")]
    assert len(notices) == 1
    for words in ("parts.json", *said):
        assert words in notices[0]
    assert "other" not in notices[0]


@pytest.mark.parametrize("rig", RIGS)
def test_what_can_be_felt_gets_no_notice(ask: Here, tmp_path: Path, rig: str) -> None:
    objects = objects_file(tmp_path / "parts.json", part("one"), part("two", 0.5))
    for command in ("objects check", "plan"):
        assert "notice" not in ask(command, rig, objects).err


def test_an_untouched_table_is_answered_with_what_to_look_at(ask: Here, tmp_path: Path) -> None:
    """A scene off the table is allowed, and said; the run ends with region, heights and arrays."""
    objects = objects_file(tmp_path / "parts.json", part("one"))
    scene = scene_file(tmp_path / "scene.json", "one", 400, 0)
    ended = ask("identify", "firm", objects, "--scene", scene)
    assert ended.code == 1
    assert "scene: one, flat: lies outside of the workspace" in ended.err
    answer = ended.out.split("emulator's truth")[0]
    for words in ("unresolved: nothing was touched in 1 grip", "250 mm", "(0, 0)", "10 mm", "20 mm", "watch"):
        assert words in answer
    (folder,) = (tmp_path / "palpate-sessions").iterdir()
    result = json.loads((folder / "result.json").read_text())
    assert violations(result, json.loads(schema_text("identification"))) == []
    assert (result["verdict"], result["contacts"], result["swept"]) == ("unresolved", 0, False)


SCENES: dict[str, tuple[dict[str, Any], tuple[float, float], list[str]]] = {
    "inside": (part("p"), (-35, -20), []),
    "beside it": (part("p"), (300, 0), ["outside of the workspace", "250 mm", "seem empty"]),
    "over the rim": (part("p"), (80, -20), ["sticks out of the workspace", "26.3 mm"]),
    "too low": (part("p", height=5.0), (-35, -20), ["5 mm high", "10 mm (f1, f2, f3)", "seem empty"]),
}


@pytest.mark.parametrize("name", SCENES)
def test_scenes_that_fingers_cannot_feel(tmp_path: Path, name: str) -> None:
    entry, at, said = SCENES[name]
    objects = load_objects(objects_file(tmp_path / "parts.json", entry))
    placements = placements_of(load_scene(scene_file(tmp_path / "scene.json", "p", *at)), objects)
    lines = scene_lines(load_rig(firm_rig()), placements)
    assert len(lines) == bool(said)
    for words in said:
        assert words in lines[0]


# ----------------------------------------------------------------------------------------------------
# Which states of a catalogue a rig cannot feel: every kind of trouble, and none where there is none.

BENCH = load_rig(firm_rig())
ARMS = load_rig(EXAMPLES / "two-link-rig.toml")
TWO_RIGS = {"firm": BENCH, "arms": ARMS}


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
    assert time.process_time() - begin < 2.0, "a tenth of a second on an idle computer"


@pytest.mark.parametrize("rig", TWO_RIGS.values(), ids=TWO_RIGS)
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
    words = ("low.json", '"firm-bench"', "low, flat (5 mm high)", "10 mm (f1, f2, f3)", "metres", "1000")
    assert missing(str(refused.value), *words) == []
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
