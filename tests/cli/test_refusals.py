"""Input that commands refuse, and places that they write to."""

import json
import os
from collections.abc import Iterator
from inspect import signature
from itertools import combinations, product
from pathlib import Path
from shutil import copy
from typing import Any

import pytest
import typer

from palpate.base.errors import InputError
from palpate.base.file_io import check_place, check_places, write_text
from palpate.cli.main import app
from palpate.cli.terminal import rig_files
from palpate.config import shipped_objects, shipped_rig
from palpate.config.loading import shipped_references
from support.benches.rigs import firm_rig
from support.commands.command import Ended, Here, run
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Whatever is wrong with what people give: one clear line on stderr, exit code 2, nothing on stdout.


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
    "unknown key": (objects_text(part={"outlines": []}), ['"plate"', "outlines", '"outline"']),
    "not JSON": ("{\n  'format': 1", ["line 2"]),
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
    "not TOML": (BENCH + "\nthis is not TOML", ["line"]),
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
        (["identify", "--seed", "-1"], "--seed"),
        (["identify", "extra"], "extra"),
        (["indentify"], "identify"),
        (["recognize", "--objects", "x.json"], "--contacts"),
        (["emulate", "--for", "-3"], "--for"),
    ],
)
def test_wrong_options(here: Here, args: list[str], said: str) -> None:
    refused(here(*args), said)


def test_places_that_cannot_be_written(tmp_path: Path, here: Here) -> None:
    """Found out before the fingers move, not after."""
    (tmp_path / "file").write_text("in the way")
    refused(here("identify", "--sessions", "file/sessions", "--json"), "file/sessions")
    ended = here("identify", "--picture", "no/such/folder/made.svg", "--json")
    refused(ended, "no/such/folder/made.svg", "cannot be written")
    refused(here("emulate", "--rig-out", "no/such/rig.toml", "--for", 1), "no/such/rig.toml")
    recognised = ("recognize", "--objects", shipped_objects(), "--contacts")
    felt = EXAMPLES / "contacts.json"
    refused(here(*recognised, felt, "--picture", "file/x.svg"), "file/x.svg")


def test_the_installed_command_says_it_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "parts.json").write_text(OBJECTS["unknown key"][0])
    refused(run("identify", "--objects", "parts.json", "--json", cwd=tmp_path), *OBJECTS["unknown key"][1])
    refused(run("identify", "--no-such-option", cwd=tmp_path), "--no-such-option")
    version = run("--version", cwd=tmp_path)
    assert (version.code, version.err) == (0, "")
    assert version.out.startswith("palpate ")


# ----------------------------------------------------------------------------------------------------
# No command writes over what it reads, nor over what else it writes: refused before anything is written.

OUTPUTS = {"report", "keep", "picture", "out", "mcap", "csv", "rosbag", "animation", "urdf", "rig_out"}
INPUTS = {
    "rig": "rig.toml",
    "objects": "objects.json",
    "scene": "scene.json",
    "contacts": "contacts.json",
    "references": "references.toml",
    "settings": "settings.toml",
    "session": "session/session.jsonl.zst",
    "file": "objects.json",
    "files": "objects.json",
    "paths": "part.stl",
}
ARGUMENTS = {"session", "file", "files", "paths"}
ELSEWHERE = {"sessions", "folder"}
"""Folders of sessions, in which each run makes one of its own."""
READS_ANYWAY = {"plan": ("contacts",), "recognize": ("objects", "contacts")}


def commands(group: Any, before: str = "") -> Iterator[tuple[str, list[str]]]:
    """The words of each command, and the names of its parameters that are paths."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, f"{before}{name} ")
        else:
            found = signature(command.callback).parameters.items()
            yield before + name, [key for key, value in found if "pathlib.Path" in str(value.annotation)]


COMMANDS = dict(commands(typer.main.get_command(app)))


def pairs() -> Iterator[tuple[str, str, str]]:
    """Commands, with an output and what it must not be: an input, or another output."""
    for name, paths in COMMANDS.items():
        written = [path for path in paths if path in OUTPUTS]
        read = [path for path in paths if path in INPUTS]
        for one, other in [*product(written, read), *combinations(written, 2)]:
            yield name, one, other


NEEDED = {"objects learn": ("part", "--height", 18)}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "session").mkdir()
    (tmp_path / INPUTS["session"]).touch()
    (tmp_path / "part.stl").write_text("solid\n")
    (tmp_path / "settings.toml").write_text('format = "palpate/import-settings@1"\n')
    (tmp_path / "rig.toml").write_text(shipped_rig().read_text(encoding="utf-8"))
    (tmp_path / "objects.json").write_text(shipped_objects().read_text(encoding="utf-8"))
    (tmp_path / "references.toml").write_text(shipped_references().read_text(encoding="utf-8"))
    copy(EXAMPLES / "scene.json", tmp_path)
    copy(EXAMPLES / "contacts.json", tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def option(name: str) -> str:
    return "--" + name.replace("_", "-")


def test_each_path_of_each_command_is_read_or_written() -> None:
    unknown = {(name, path) for name, paths in COMMANDS.items() for path in paths}
    assert {item for item in unknown if item[1] not in OUTPUTS | INPUTS.keys() | ELSEWHERE} == set()
    assert {name for name, *_ in pairs()} >= {"study", "identify", "plan", "report", "export", "emulate"}


@pytest.mark.parametrize(("name", "written", "other"), list(pairs()))
def test_no_command_writes_over_what_it_reads(
    name: str, written: str, other: str, folder: Path, here: Here
) -> None:
    place = INPUTS.get(other, "new.out")
    words: list[object] = [*name.split(), *NEEDED.get(name, ()), option(written), os.path.join(".", place)]
    for path in COMMANDS[name]:
        if path in ARGUMENTS and name != "watch":
            words.append(INPUTS[path])
        elif path == other or path in READS_ANYWAY.get(name, ()):
            words += [option(path), INPUTS.get(path, place)]
    before = contents(folder)
    ended = here(*words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended
    assert ("is there already" if name == "objects merge" else "it is the same file as") in ended.err
    assert contents(folder) == before


def test_files_are_the_same_by_whatever_link_and_before_they_are_there(folder: Path) -> None:
    read: dict[str, Path | None] = {"--objects": Path("objects.json"), "--scene": None}
    Path("symbolic.json").symlink_to("objects.json")
    os.link("objects.json", "hard.json")
    Path("inside").symlink_to(".")
    before = contents(folder)
    for place in (
        "objects.json",
        "symbolic.json",
        "hard.json",
        "inside/objects.json",
        "session/../hard.json",
    ):
        with pytest.raises(
            InputError, match=r"^--report .* cannot be written: it is the same file as --objects"
        ):
            check_places({"--report": Path(place)}, read)
    with pytest.raises(InputError, match="it is the same file as --keep"):
        check_places({"--report": Path("inside/new"), "--keep": Path("new")}, read)
    # What is being written lies under this name for a while.
    os.rename("hard.json", ".page.html.part")
    with pytest.raises(InputError, match="it is the same file as --objects"):
        check_places({"--report": Path("page.html")}, {"--objects": Path(".page.html.part")})
    os.rename(".page.html.part", "hard.json")
    check_places({"--report": Path("page.html"), "--keep": None}, read)
    assert contents(folder) == before


def test_the_calibration_beside_a_rig_file_is_read(folder: Path) -> None:
    with pytest.raises(InputError, match="it is the same file as the rig's calibration"):
        check_places({"--report": folder / "rig.calibration.toml"}, rig_files(folder / "rig.toml"))


def test_what_is_no_file_is_not_replaced_by_one(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for place, words in (
        (tmp_path / "pipe", "a named pipe"),
        (tmp_path, "a folder"),
        ("/dev/null", "a device"),
    ):
        with pytest.raises(InputError, match=f"cannot be written: it is {words}; choose another place"):
            check_place(Path(place))
        with pytest.raises(InputError, match=words):
            write_text(Path(place), "")


@pytest.mark.parametrize(
    "words",
    [
        ("init", "--bench", "bench", "--out", "rig.schema.json"),
        ("calibrate", "--rig", "rig.toml", "--references", "rig.calibration.toml", "--yes"),
    ],
)
def test_nor_over_files_that_have_no_option(words: tuple[str, ...], folder: Path, here: Here) -> None:
    os.rename("references.toml", "rig.calibration.toml")
    before = contents(folder)
    ended = here(*words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended
    assert "it is the same file as" in ended.err
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--strategy", "best"), "'best' is not one of 'planned', 'random', 'rotate'"),
        (("--seed", "1.5"), "whole number"),
        (("--seed", "-1"), "it must be greater than or equal to 0"),
    ],
)
def test_values_of_options_are_refused_in_plain_words(here: Here, words: tuple[str, str], said: str) -> None:
    ended = here("identify", *words)
    assert ended.code == 2
    assert said in ended.err
    assert not any(word in ended.err for word in ("Value error", "Input should", "parse"))
