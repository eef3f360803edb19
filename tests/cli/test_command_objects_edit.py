"""`palpate objects remove`, `rename`, `merge`: what they change, what they leave, and what they refuse."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Ended, run_here

from palpate.config import load_objects

Ask = Callable[..., Ended]


@pytest.fixture
def ask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Ask:
    monkeypatch.chdir(tmp_path)
    return lambda *args: run_here(["objects", *args], monkeypatch, capsys)


def square(name: str, side: float = 20.0, **more: object) -> dict[str, object]:
    outline = [[0, 0], [side, 0], [side, side], [0, side]]
    return {"name": name, "outline": outline, "height": 12.0, **more}


def saved(path: Path, *objects: dict[str, object], **more: object) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": objects, **more}))
    return path


def source(file: str) -> dict[str, str]:
    return {"file": file, "sha256": "0" * 64, "request": "x"}


def names(path: Path) -> list[str]:
    return [item.name for item in load_objects(path).objects]


def test_remove(tmp_path: Path, ask: Ask) -> None:
    file = saved(tmp_path / "all.json", square("a"), square("b", tolerance=0.1), square("c"))
    ended = ask("remove", "all.json", "a", "c")
    assert (ended.code, ended.out) == (0, "2 objects removed, 1 left in all.json\n")
    assert json.loads(file.read_text())["objects"] == [square("b", tolerance=0.1)]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["remove", "all.json", "wsher"], 'all.json: has no object "wsher"; did you mean "washer"?'),
        (["remove", "all.json", "x"], 'all.json: has no object "x"; it has washer, nut'),
        (["remove", "all.json", "nut", "washer"], "all.json would hold no object any more; delete the file"),
        (["rename", "all.json", "bolt", "x"], 'all.json: has no object "bolt"'),
        (["rename", "all.json", "nut", "washer"], 'another object is named "washer" already'),
        (["rename", "all.json", "nut", " nut"], "NEW must be printable characters without blanks"),
        (["rename", "all.json", "nut", "n" * 91], "NEW has 91 characters; it must have from 1 to 90"),
        (["merge", "all.json", "--out", "all.json"], "all.json is there already"),
        (["merge", "all.json", "none.json", "--out", "new.json"], "none.json"),
    ],
)
def test_what_cannot_be_is_one_line_and_changes_nothing(
    tmp_path: Path, ask: Ask, command: list[str], message: str
) -> None:
    file = saved(tmp_path / "all.json", square("washer"), square("nut"))
    before = file.read_text()
    ended = ask(*command)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert message in ended.err
    assert file.read_text() == before
    assert [item.name for item in tmp_path.iterdir()] == ["all.json"]


def test_rename(tmp_path: Path, ask: Ask) -> None:
    file = saved(tmp_path / "all.json", square("a"), square("b"))
    assert ask("rename", "all.json", "a", "plate, 20 mm").code == 0
    assert names(file) == ["plate, 20 mm", "b"]


def test_merge_takes_the_same_object_once_and_follows_sources(tmp_path: Path, ask: Ask) -> None:
    one = saved(tmp_path / "one" / "a.json", square("a", source=source("cad/a.stl")), square("b"))
    other = saved(
        tmp_path / "b.json",
        square("b"),
        square("c"),
        refused=[{"source": source("x.stl"), "why": "is empty"}],
    )
    ended = ask("merge", one, other, "--out", "new.json")
    assert (ended.code, ended.out) == (0, "3 objects in new.json\n")
    assert names(tmp_path / "new.json") == ["a", "b", "c"]
    made = json.loads((tmp_path / "new.json").read_text())
    assert made["objects"][0]["source"]["file"] == "one/cad/a.stl"
    assert made["refused"][0]["source"]["file"] == "x.stl"


def test_merge_refuses_different_objects_of_one_name(tmp_path: Path, ask: Ask) -> None:
    saved(tmp_path / "a.json", square("a"))
    saved(tmp_path / "b.json", square("a", 21.0))
    ended = ask("merge", "a.json", "b.json", "--out", "new.json")
    assert ended.code == 2
    assert 'b.json and a.json have different objects named "a"; rename one' in ended.err
    assert not (tmp_path / "new.json").exists()
