"""Parts that no finger can feel, on `objects check`, `identify` and `plan`: said before anything moves."""

import json
import re
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from command import Ended, run_here
from firm_rig import firm_rig
from json_schema import violations
from odd_parts import objects_file, part, scene_file
from repository import EXAMPLES
from sampling import sample

from palpate.config import load_objects, load_rig, load_scene
from palpate.config.schema import schema_text
from palpate.rig.emulated.ground_truth import scene_lines
from palpate.rig.emulated.scene import Placement, placement_of

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

Ask = Callable[..., Ended]


ARMS_IDENTIFY = ("identify", "low", "arms")
ASKED = [*product(("objects check", "plan"), NOTICED, RIGS), ("identify", "low", "firm"), ARMS_IDENTIFY]


@pytest.fixture
def ask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Ask:
    """Runs one of the commands in this process, in a folder of its own, on one of the rigs."""
    monkeypatch.chdir(tmp_path)

    def asked(command: str, rig: str, objects: Path, *options: object) -> Ended:
        text = RIGS[rig].read_text(encoding="utf-8")
        (tmp_path / "rig.toml").write_text(re.sub(r"max_grips = \d+", "max_grips = 1", text))
        args: list[object] = [*command.split()]
        args += [objects] if command == "objects check" else ["--objects", objects]
        if command == "plan":
            contacts = (EXAMPLES / "first-grip.json").read_text(encoding="utf-8")
            (tmp_path / "contacts.json").write_text(contacts)
            args += ["--contacts", "contacts.json"]
        return run_here([*args, "--rig", "rig.toml", *options], monkeypatch, capsys)

    return asked


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kind", REFUSED)
def test_a_catalogue_of_which_nothing_can_be_felt_is_refused(
    ask: Ask, tmp_path: Path, rig: str, command: str, kind: str
) -> None:
    entry, said = REFUSED[kind]
    ended = ask(command, rig, objects_file(tmp_path / "parts.json", entry), "--json")
    assert (ended.code, ended.out) == (2, "")
    (line,) = ended.err.splitlines()
    assert line.startswith("error: ")
    for words in ("parts.json", *said):
        assert words in line
    assert not (tmp_path / "palpate-sessions").exists(), "nothing was begun"


@pytest.mark.parametrize(
    ("command", "kind", "rig"), sample(ASKED, [row for row in ASKED if row != ARMS_IDENTIFY])
)
def test_a_part_that_cannot_be_felt_is_noticed_beside_others(
    ask: Ask, tmp_path: Path, rig: str, command: str, kind: str
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
def test_what_can_be_felt_gets_no_notice(ask: Ask, tmp_path: Path, rig: str) -> None:
    objects = objects_file(tmp_path / "parts.json", part("one"), part("two", 0.5))
    for command in ("objects check", "plan"):
        assert "notice" not in ask(command, rig, objects).err


def test_an_untouched_table_is_answered_with_what_to_look_at(ask: Ask, tmp_path: Path) -> None:
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
    placement: Placement = placement_of(load_scene(scene_file(tmp_path / "scene.json", "p", *at)), objects)
    lines = scene_lines(load_rig(firm_rig()), placement)
    assert len(lines) == bool(said)
    for words in said:
        assert words in lines[0]
