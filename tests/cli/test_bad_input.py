"""Whatever is wrong with what people give: one clear line on stderr, exit code 2, nothing on stdout."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command import Ended, run, run_here
from firm_rig import firm_rig
from repository import EXAMPLES

from palpate.config import shipped_objects

Here = Callable[..., Ended]


@pytest.fixture
def here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Ended]:
    """Runs the command's entry point in this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def command(*args: object) -> Ended:
        return run_here(args, monkeypatch, capsys)

    return command


def refused(ended: Ended, *said: str) -> None:
    assert ended.code == 2, ended
    assert ended.out == ""
    line, *others = ended.err.splitlines()
    assert line.startswith("error: ")
    assert all(other.startswith(line.removeprefix("error: ").split(": ")[0]) for other in others)
    assert len(others) <= 10
    for words in said:
        assert words in line


def objects_text(**changes: Any) -> str:
    part: dict[str, Any] = {"name": "plate", "outline": [[0, 0], [40, 0], [40, 30], [0, 30]], "height": 20.0}
    whole: dict[str, Any] = {"format": "palpate/objects@1", "units": "mm", "objects": [part]}
    part |= changes.pop("part", {})
    return json.dumps(whole | changes)


OBJECTS = {
    "self-intersecting outline": (
        objects_text(part={"outline": [[0, 0], [40, 30], [40, 0], [0, 30]]}),
        ['"plate"', "itself"],
    ),
    "nan": (
        objects_text(part={"outline": [[0, 0], [40, float("nan")], [40, 30]]}),
        ['"plate"', "outline point 1", "nan"],
    ),
    "infinite": (objects_text(part={"height": float("inf")}), ['"plate"', "height"]),
    "unknown key": (objects_text(part={"outlines": []}), ['"plate"', "outlines", '"outline"']),
    "unknown unit": (objects_text(units="furlong"), ["furlong", "mm"]),
    "another unit": (objects_text(units="inch"), ["inch", "mm"]),
    "another format": (objects_text(format="palpate/objects@2"), ["palpate/objects@2", "palpate/objects@1"]),
    "no objects": (objects_text(objects=[]), ["objects"]),
    "two of a name": (
        json.dumps(json.loads(objects_text()) | {"objects": json.loads(objects_text())["objects"] * 2}),
        ['"plate"'],
    ),
    "not JSON": ("{\n  'format': 1", ["line 2"]),
    "empty": ("", []),
    "a list": ("[]", []),
    "binary": ("\udcff\udc80\udcfe", []),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_that_cannot_be_used(here: Here, tmp_path: Path, name: str) -> None:
    text, said = OBJECTS[name]
    (tmp_path / "parts.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    refused(here("identify", "--objects", "parts.json", "--json"), "parts.json", *said)
    refused(
        here("recognize", "--objects", "parts.json", "--contacts", "none.json", "--json"), "parts.json", *said
    )
    assert os.listdir(tmp_path) == ["parts.json"], "nothing was begun"


BENCH = firm_rig().read_text(encoding="utf-8")
RIGS = {
    "two servos of one id": (BENCH.replace("dxl_id = 22", "dxl_id = 12"), ["12", '"f1"', '"f2"']),
    "unknown key": (
        BENCH.replace("backlash_mm = 0.08\nzero_mm", "backlsh_mm = 0.08\nzero_mm"),
        ["backlsh_mm", '"backlash_mm"'],
    ),
    "nan": (BENCH.replace("radius_mm = 125.0", "radius_mm = nan"), ["workspace.radius_mm"]),
    "another model": (BENCH.replace("XM430-W350", "XM999", 1), ["XM999"]),
    "a number as text": (BENCH.replace("max_grips = 8", 'max_grips = "many"'), ["max_grips"]),
    "a real port beside emulation": (BENCH.replace("mock://bus", "/dev/ttyUSB0"), ["/dev/ttyUSB0"]),
    "not TOML": (BENCH + "\nthis is not TOML", ["line"]),
    "empty": ("", []),
}


@pytest.mark.parametrize("name", RIGS)
def test_rigs_that_cannot_be_used(here: Here, tmp_path: Path, name: str) -> None:
    text, said = RIGS[name]
    (tmp_path / "bench.toml").write_text(text)
    refused(here("identify", "--rig", "bench.toml", "--json"), "bench.toml", *said)
    refused(here("emulate", "--rig", "bench.toml", "--for", "0"), "bench.toml", *said)
    assert os.listdir(tmp_path) == ["bench.toml"]


def scene_text(**changes: Any) -> str:
    whole = {
        "format": "palpate/scene@1",
        "object": "tr-1",
        "configuration": {"x": 0.0, "y": 0.0, "theta": 0.0},
    }
    return json.dumps(whole | changes)


SCENES = {
    "no such object": (scene_text(object="tr-9"), ["tr-9", "tr-1"]),
    "no such state": (scene_text(state="upright"), ["upright", "flat"]),
    "unknown key": (scene_text(sate="flat"), ["sate", '"state"']),
    "degrees": (scene_text(configuration={"x": 0, "y": 0, "theta_deg": 3}), ["theta_deg", '"theta"']),
    "nan": (scene_text(configuration={"x": float("nan"), "y": 0, "theta": 0}), ["configuration.x"]),
    "its objects are missing": (scene_text(objects="other.json"), ["other.json"]),
    "not JSON": ("object: tr-1", ["line 1"]),
}


@pytest.mark.parametrize("name", SCENES)
def test_scenes_that_cannot_be_used(here: Here, tmp_path: Path, name: str) -> None:
    text, said = SCENES[name]
    (tmp_path / "scene.json").write_text(text)
    refused(here("identify", "--scene", "scene.json", "--json"), *said)


@pytest.mark.parametrize("option", ["--rig", "--objects", "--scene"])
def test_missing_files_and_folders(here: Here, tmp_path: Path, option: str) -> None:
    refused(here("identify", option, "none.file"), "none.file", "no such file")
    (tmp_path / "folder").mkdir()
    refused(here("identify", option, "folder"), "folder: is a folder")


def test_contacts_that_cannot_be_used(here: Here, tmp_path: Path) -> None:
    (tmp_path / "parts.json").write_text(objects_text())
    for text, said in (
        ('{"format": "palpate/contacts@1", "units": "mm, rad", "grips": [{"contact": []}]}', '"contacts"'),
        ('{"format": "palpate/contacts@1", "units": "mm, deg", "grips": []}', "mm, rad"),
    ):
        (tmp_path / "felt.json").write_text(text)
        refused(here("recognize", "--objects", "parts.json", "--contacts", "felt.json"), "felt.json", said)


def test_a_scene_on_a_real_rig(here: Here, tmp_path: Path) -> None:
    real = EXAMPLES / "real-rig.toml"
    (tmp_path / "scene.json").write_text(scene_text())
    refused(
        here("identify", "--rig", real, "--scene", "scene.json"),
        "a scene is for emulated rigs",
        "real devices",
    )
    refused(here("emulate", "--rig", real), "nothing to emulate")


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["identify", "--sed", "7"], "--seed"),
        (["identify", "--seed", "seven"], "--seed"),
        (["identify", "--seed", "-1"], "--seed"),
        (["identify", "extra"], "extra"),
        (["indentify"], "identify"),
        (["recognize", "--objects", "x.json"], "--contacts"),
        (["emulate", "--for", "-3"], "--for"),
    ],
)
def test_wrong_options(here: Here, args: list[str], said: str) -> None:
    refused(here(*args), said)


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    """Found out before the fingers move, not after."""
    (tmp_path / "file").write_text("in the way")
    refused(run("identify", "--sessions", "file/sessions", "--json", cwd=tmp_path), "file/sessions")
    ended = run("identify", "--picture", "no/such/folder/made.svg", "--json", cwd=tmp_path)
    refused(ended, "no/such/folder/made.svg", "cannot be written")
    refused(run("emulate", "--rig-out", "no/such/rig.toml", "--for", 1, cwd=tmp_path), "no/such/rig.toml")
    recognised = ("recognize", "--objects", shipped_objects(), "--contacts")
    felt = EXAMPLES / "contacts.json"
    refused(run(*recognised, felt, "--picture", "file/x.svg", cwd=tmp_path), "file/x.svg")


def test_the_installed_command_says_it_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "parts.json").write_text(OBJECTS["unknown key"][0])
    refused(run("identify", "--objects", "parts.json", "--json", cwd=tmp_path), *OBJECTS["unknown key"][1])
    refused(run("identify", "--no-such-option", cwd=tmp_path), "--no-such-option")
    version = run("--version", cwd=tmp_path)
    assert (version.code, version.err) == (0, "")
    assert version.out.startswith("palpate ")
