"""Catalogues with objects that are not known where a finger is: refused by every command that takes both."""

import json
from pathlib import Path
from typing import Any

import pytest
from command import Ended, run_here
from firm_rig import firm_rig
from quick_rig import small
from wording import missing

from palpate.base.errors import InputError
from palpate.config import load_objects
from palpate.rig.catalogue.finger_model import FingerAtHeight, check_known

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


@pytest.fixture
def ask(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    return lambda *args: run_here(args, monkeypatch, capsys)


def refused(ended: Ended, finger: str) -> None:
    assert (ended.code, ended.out) == (2, "")
    said = (
        f'error: object "bracket", state "state-2" is known at heights 4.5–5.5 mm only; finger {finger} is at'
    )
    assert ended.err.startswith(said)
    assert ended.err.count("\n") == 1


def test_commands_refuse_such_a_pair(tmp_path: Path, ask: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    low = write(tmp_path, [[4.5, 5.5]])
    felt = contacts(tmp_path, 10.0)
    refused(ask("recognize", "--objects", low, "--contacts", felt), "f7")
    refused(ask("plan", "--objects", low, "--contacts", contacts(tmp_path, 5.0)), "f1")  # the shipped rig's
    refused(ask("identify", "--objects", low), "f1")
    refused(ask("emulate", "--objects", low, "--for", "0.01"), "f1")
    assert not (tmp_path / "palpate-sessions").exists()


def test_a_scene_with_objects_of_its_own_is_refused_too(tmp_path: Path, ask: Any) -> None:
    low = write(tmp_path, [[4.5, 5.5]], name="others.json")
    scene = {"format": "palpate/scene@1", "object": "bracket", "state": "state-2", "objects": low.name}
    scene |= {"configuration": {"x": 0.0, "y": 0.0, "theta": 0.0}}
    file = tmp_path / "scene.json"
    file.write_text(json.dumps(scene))
    refused(ask("identify", "--objects", write(tmp_path, None), "--scene", file), "f1")


def test_contacts_where_the_state_is_known_are_recognised(tmp_path: Path, ask: Any) -> None:
    near = write(tmp_path, [[4.5, 5.5]])
    everywhere = write(tmp_path, None, name="all.json")
    felt = contacts(tmp_path, 5.0)
    found = [
        ask("recognize", "--objects", file, "--contacts", felt, "--json").json for file in (near, everywhere)
    ]
    assert found[0]["hypotheses"] == found[1]["hypotheses"] != []


def test_a_session_is_not_replayed_with_such_objects(tmp_path: Path, ask: Any) -> None:
    sessions = tmp_path / "sessions"
    objects = write(tmp_path, None)
    rig = tmp_path / "rig.toml"
    rig.write_text(small(firm_rig()).replace("max_grips = 8", "max_grips = 1"), encoding="utf-8")
    words = ("--rig", rig, "--objects", objects, "--sessions", sessions)
    assert ask("identify", *words).code in (0, 1)
    (folder,) = sessions.iterdir()
    (folder / "objects.json").write_text(write(tmp_path, [[4.5, 5.5]]).read_text())
    refused(ask("replay", folder), "f1")
