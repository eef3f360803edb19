"""No command writes over what it reads, nor over what else it writes: refused before anything is written."""

import os
from collections.abc import Iterator
from inspect import signature
from itertools import combinations, product
from pathlib import Path
from shutil import copy
from typing import Any

import pytest
import typer
from command import run_here
from repository import EXAMPLES

from palpate.base.errors import InputError
from palpate.base.file_io import check_place, check_places, write_text
from palpate.cli.main import app
from palpate.cli.options import rig_files
from palpate.config import shipped_objects, shipped_rig
from palpate.config.loading import shipped_references

OUTPUTS = {"report", "keep", "picture", "out", "mcap", "csv", "rosbag", "rig_out"}
INPUTS = {
    "rig": "rig.toml",
    "objects": "objects.json",
    "scene": "scene.json",
    "contacts": "contacts.json",
    "references": "references.toml",
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


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "session").mkdir()
    (tmp_path / INPUTS["session"]).touch()
    (tmp_path / "part.stl").write_text("solid\n")
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
    name: str,
    written: str,
    other: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    place = INPUTS.get(other, "new.out")
    words: list[object] = [*name.split(), option(written), os.path.join(".", place)]
    for path in COMMANDS[name]:
        if path in ARGUMENTS and name != "watch":
            words.append(INPUTS[path])
        elif path == other or path in READS_ANYWAY.get(name, ()):
            words += [option(path), INPUTS.get(path, place)]
    before = contents(folder)
    ended = run_here(words, monkeypatch, capsys)
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
def test_nor_over_files_that_have_no_option(
    words: tuple[str, ...], folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    os.rename("references.toml", "rig.calibration.toml")
    before = contents(folder)
    ended = run_here(words, monkeypatch, capsys)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended
    assert "it is the same file as" in ended.err
    assert contents(folder) == before
