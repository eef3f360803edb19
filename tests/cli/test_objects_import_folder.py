"""`palpate objects import` of folders and several files: kept, changed, refused and gone ones."""

import json
import signal
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import trimesh

from palpate.base.confined_reading import UnfinishedReadingError
from palpate.base.errors import InputError, MissingPackageError
from palpate.cad.parts import Solid
from palpate.config import load_objects
from palpate.config.import_settings import load_import_settings
from palpate.config.schema import schema_text
from palpate.rig.catalogue import cad_import, folder_import
from palpate.rig.catalogue.cad_import import Imported, ImportedObject, import_file
from palpate.rig.session.signals import Interrupted
from palpate.rig.workers import in_processes
from support.commands.command import Here, missing, violations

pytestmark = pytest.mark.usefixtures("read_here")


@pytest.fixture
def ask(here: Here) -> Here:
    return lambda *args: here("objects", "import", *args)


OPTIONS = ("--units", "mm", "--states", "as-is", "--out", "all.json", "--json")


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    folder = tmp_path / "parts"
    folder.mkdir()
    for number in (1, 2, 3):
        trimesh.creation.box((10 * number, 20, 10)).export(folder / f"block-{number}.stl")
    return folder


def written(folder: Path) -> dict[str, dict[str, object]]:
    objects = json.loads((folder / "all.json").read_text())["objects"]
    return {item["name"]: item for item in objects}


def test_a_folder_is_a_catalogue_and_again_it_is_the_same(parts: Path, tmp_path: Path, ask: Here) -> None:
    ended = ask(parts, *OPTIONS)
    assert ended.code == 0
    assert [item["kept"] for item in ended.json["files"]] == [False] * 3
    assert [item.name for item in load_objects(tmp_path / "all.json").objects] == [
        "block-1",
        "block-2",
        "block-3",
    ]
    text = (tmp_path / "all.json").read_text()
    assert not violations(json.loads(text), json.loads(schema_text("objects")))
    ended = ask(parts, *OPTIONS)
    assert ended.code == 0
    assert [item["kept"] for item in ended.json["files"]] == [True] * 3
    assert ended.json["objects"] == []
    assert (tmp_path / "all.json").read_text() == text


def test_only_what_changed_is_read_again(parts: Path, tmp_path: Path, ask: Here) -> None:
    ask(parts, *OPTIONS)
    before = written(tmp_path)
    trimesh.creation.box((44, 20, 10)).export(parts / "block-2.stl")
    trimesh.creation.box((15, 15, 15)).export(parts / "cube.stl")
    ended = ask(parts, *OPTIONS)
    assert [item["name"] for item in ended.json["objects"]] == ["block-2", "cube"]
    after = written(tmp_path)
    assert list(after) == ["block-1", "block-2", "block-3", "cube"]
    assert (after["block-1"], after["block-3"]) == (before["block-1"], before["block-3"])
    assert after["block-2"] != before["block-2"]


def test_an_object_keeps_the_name_that_it_was_given(parts: Path, tmp_path: Path, ask: Here) -> None:
    ask(parts, *OPTIONS)
    text = (tmp_path / "all.json").read_text().replace('"block-2"', '"middle one"')
    (tmp_path / "all.json").write_text(text)
    trimesh.creation.box((44, 20, 10)).export(parts / "block-2.stl")
    assert [item["name"] for item in ask(parts, *OPTIONS).json["objects"]] == ["middle one"]
    assert list(written(tmp_path)) == ["block-1", "middle one", "block-3"]


def test_other_options_read_everything_again(parts: Path, ask: Here) -> None:
    (parts / "block-3.stl").unlink()
    ask(parts, *OPTIONS)
    ended = ask(parts, *OPTIONS, "--tolerance", 0.2)
    assert [item["kept"] for item in ended.json["files"]] == [False] * 2


def test_an_object_whose_file_is_gone_is_kept_and_named(parts: Path, tmp_path: Path, ask: Here) -> None:
    ask(parts, *OPTIONS)
    (parts / "block-3.stl").unlink()
    ended = ask(parts, *OPTIONS)
    (line,) = ended.json["warnings"]
    assert not missing(line, "block-3", "parts/block-3.stl is gone", "objects remove")
    assert list(written(tmp_path)) == ["block-1", "block-2", "block-3"]


def test_a_file_that_fails_is_a_line_and_costs_nothing_else(parts: Path, tmp_path: Path, ask: Here) -> None:
    (parts / "bad.stl").write_text("nothing")
    ended = ask(parts, *OPTIONS[:-1])
    assert ended.code == 1
    assert "bad.stl: is no STL file" in ended.out
    assert "3 of 4 files in all.json" in ended.out
    assert list(written(tmp_path)) == ["block-1", "block-2", "block-3"]


def test_a_file_that_was_refused_is_read_again_only_when_it_has_changed(
    parts: Path, tmp_path: Path, ask: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    (parts / "bad.stl").write_text("nothing")
    first = ask(parts, *OPTIONS)
    text = (tmp_path / "all.json").read_text()
    (kept,) = json.loads(text)["refused"]
    assert kept["why"] == "is no STL file: it has 7 bytes"
    assert not violations(json.loads(text), json.loads(schema_text("objects")))
    with monkeypatch.context() as patched:
        patched.setattr("palpate.rig.catalogue.folder_import.import_file", None)
        again = ask(parts, *OPTIONS)
    assert (first.code, again.code) == (1, 1)
    assert [item["kept"] for item in again.json["files"]] == [True] * 4
    assert [item["failure"] for item in again.json["files"]] == [
        item["failure"] for item in first.json["files"]
    ]
    trimesh.creation.box((15, 15, 15)).export(parts / "bad.stl")
    assert ask(parts, *OPTIONS).code == 0
    assert "refused" not in json.loads((tmp_path / "all.json").read_text())


@pytest.mark.parametrize(
    "error",
    [
        MissingPackageError("reading STL files needs trimesh: pip install 'palpate[cad]'"),
        UnfinishedReadingError("was not read within 60 s"),
    ],
)
def test_what_this_computer_lacks_is_not_held_against_the_file(
    parts: Path, tmp_path: Path, ask: Here, monkeypatch: pytest.MonkeyPatch, error: InputError
) -> None:
    def without(path: Path, *_: object) -> Imported:
        if path.stem == "block-2":
            raise error
        return import_file(path, *_)

    with monkeypatch.context() as patched:
        patched.setattr("palpate.rig.catalogue.folder_import.import_file", without)
        assert ask(parts, *OPTIONS).code == 1
    assert ask(parts, *OPTIONS).code == 0
    assert sorted(written(tmp_path)) == ["block-1", "block-2", "block-3"]


def test_an_interruption_leaves_what_was_done(
    parts: Path, tmp_path: Path, ask: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Ctrl-C or a kill would end it after the second file; the third is read by the next command."""

    def two_of(*_: object) -> Iterator[tuple[int, object]]:
        yield from islice(in_processes(*_), 2)  # type: ignore[arg-type]
        raise Interrupted(signal.SIGINT)

    with monkeypatch.context() as patched:
        patched.setattr("palpate.rig.catalogue.folder_import.in_processes", two_of)
        ended = ask(parts, *OPTIONS)
    assert ended.code == 130
    assert "what was done is in all.json; the same command goes on with the rest" in ended.err
    assert len(written(tmp_path)) == 2
    again = ask(parts, *OPTIONS)
    assert sorted(item["kept"] for item in again.json["files"]) == [False, True, True]
    assert sorted(written(tmp_path)) == ["block-1", "block-2", "block-3"]


def test_a_mistake_of_our_own_in_one_file_costs_no_other(
    parts: Path, tmp_path: Path, ask: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(path: Path, *_: object) -> Imported:
        if path.stem == "block-2":
            raise IndexError("list index out of range")
        return import_file(path, *_)

    monkeypatch.setattr("palpate.rig.catalogue.folder_import.import_file", broken)
    ended = ask(parts, *OPTIONS)
    assert ended.code == 1
    (failure,) = [item["failure"] for item in ended.json["files"] if item["failure"]]
    assert failure == (
        f"{parts}/block-2.stl: cannot be imported, by a mistake in palpate: "
        "IndexError: list index out of range"
    )
    assert list(written(tmp_path)) == ["block-1", "block-3"]


def test_where_all_fail_nothing_is_written(tmp_path: Path, ask: Here) -> None:
    for name in ("a.stl", "b.stl"):
        (tmp_path / name).write_text("nothing")
    ended = ask(tmp_path / "a.stl", tmp_path / "b.stl", *OPTIONS[:-1])
    assert ended.code == 2
    assert not (tmp_path / "all.json").exists()
    assert "nothing was written" in ended.out


def test_of_one_part_in_several_formats_one_is_read(parts: Path, tmp_path: Path, ask: Here) -> None:
    box = trimesh.creation.box((10, 10, 10))
    for suffix in ("ply", "3mf"):
        box.export(parts / f"block-1.{suffix}")
    box.export(parts / "BLOCK-9.STL")
    ended = ask(parts, *OPTIONS)
    assert ended.code == 0
    files = [Path(item["file"]).name for item in ended.json["files"]]
    assert files == ["BLOCK-9.STL", "block-1.3mf", "block-2.stl", "block-3.stl"]
    (line,) = ended.json["warnings"]
    assert not missing(line, "block-1.stl", "block-1.ply", "block-1.3mf", "by itself")


def test_folders_in_a_folder_are_entered_only_if_asked(parts: Path, tmp_path: Path, ask: Here) -> None:
    for inner in ("old", ".git", "old/__MACOSX", "empty"):
        (parts / inner).mkdir()
    for place in ("old", ".git", "old/__MACOSX"):
        trimesh.creation.box((11, 12, 13)).export(parts / place / "block-1.stl")
    ended = ask(parts, *OPTIONS)
    assert (ended.code, len(ended.json["files"])) == (0, 3)
    (line,) = ended.json["warnings"]
    assert not missing(line, "old", "not entered")
    assert "empty" not in line
    ended = ask(parts, *OPTIONS, "--recursive")
    assert [item["name"] for item in ended.json["objects"]] == ["block-1-2"]
    assert len(ended.json["files"]) == 4
    assert not missing("\n".join(ended.json["warnings"]), ".git", "__MACOSX")


SETTINGS = """
format = "palpate/import-settings@1"
tolerance_mm = 0.2
density_g_cm3 = 1.2
friction = 0.5

[files."block-1*"]
units = "inch"
name = "inches"
mass_g = 100.0
tags = ["gauge", "steel"]

[files."block-[12].stl"]
deviation_mm = 0.3

[files."block-3.stl"]
leave_out = true

[files."gone.stl"]
units = "mm"
"""


def test_settings_say_of_each_file_what_it_is(parts: Path, tmp_path: Path, ask: Here) -> None:
    trimesh.creation.box((1, 2, 0.5)).export(parts / "block-1.stl")
    (parts / "palpate-import.toml").write_text(SETTINGS)
    ended = ask(parts, *OPTIONS[2:], "--units", "mm")
    sizes = {item["name"]: item["size"] for item in ended.json["objects"]}
    assert sizes["inches"] == [1.0, 2.0, 0.5], "the command line goes before settings"
    (parts / "palpate-import.toml").write_text(SETTINGS.replace("tolerance", 'units = "mm"\ntolerance', 1))
    ended = ask(parts, *OPTIONS[2:])
    assert ended.code == 0, ended.err
    (changed,) = ended.json["objects"]
    assert (changed["name"], changed["size"]) == ("inches", [25.4, 50.8, 12.7])
    assert not missing("\n".join(ended.json["warnings"]), "block-3.stl", "gone.stl")
    made = written(tmp_path)
    # 0.1 kg; 4 cm³ of 1.2 g each
    assert made["inches"]["part_holds_n"] == pytest.approx(0.5 * 0.1 * 9.81, abs=1e-3)
    assert made["block-2"]["part_holds_n"] == pytest.approx(0.5 * 0.0048 * 9.81, abs=1e-3)
    assert (made["inches"]["size"], made["inches"]["mass_g"]) == ([25.4, 50.8, 12.7], 100.0)
    assert made["block-2"]["mass_g"] == pytest.approx(4.8)
    assert (made["inches"]["tags"], "tags" in made["block-2"]) == (["gauge", "steel"], False)
    assert changed["deviation"] == 0.3
    again = ask(parts, *OPTIONS[2:])
    assert [item["kept"] for item in again.json["files"]] == [True, True]
    alone = ask(parts / "block-2.stl", "--states", "as-is", "--out", "one.json", "--json")
    assert (alone.code, alone.json["warnings"]) == (0, []), "a file by itself has its folder's settings, too"
    assert alone.json["objects"][0]["deviation"] == 0.3
    other = tmp_path / "other.toml"
    other.write_text(SETTINGS.replace("leave_out", "leave_it_out"))
    ended = ask(parts, *OPTIONS, "--settings", other)
    assert ended.code == 2
    assert not missing(ended.err, "other.toml", "leave_it_out")


def test_a_name_with_brackets_is_written_out_in_settings(parts: Path, ask: Here) -> None:
    (parts / "block-1.stl").rename(parts / "[a]_block.stl")
    text = 'format = "palpate/import-settings@1"\n[files."[a]_block.stl"]\nname = "arm"\n'
    (parts / "palpate-import.toml").write_text(text)
    assert "arm" in [item["name"] for item in ask(parts, *OPTIONS).json["objects"]]


def test_settings_to_be_filled_in_are_written_once(parts: Path, ask: Here) -> None:
    (parts / "plate.svg").write_text("<svg/>")
    assert ask(parts, "--write-settings").code == 0
    text = (parts / "palpate-import.toml").read_text()
    assert not missing(text, '[files."*.stl"]', '# units = "mm"', '[files."*.svg"]', "# thickness_mm = 10.0")
    assert load_import_settings(parts / "palpate-import.toml").files.keys() == {"*.stl", "*.svg"}
    ended = ask(parts, "--write-settings")
    assert (ended.code, "is there already" in ended.err) == (2, True)


def test_a_part_may_point_up_along_any_axis(parts: Path, tmp_path: Path, ask: Here) -> None:
    (parts / "palpate-import.toml").write_text(
        'format = "palpate/import-settings@1"\n[files."block-3.stl"]\nup = "-x"\nstates = "as-is"\n'
    )
    ended = ask(parts, *OPTIONS)
    assert ended.code == 0
    heights = {item["name"]: item["states"][0]["height"] for item in ended.json["objects"]}
    assert heights == {"block-1": 10.0, "block-2": 10.0, "block-3": 30.0}
    (frame,) = [item["states"][0]["frame"] for item in ended.json["objects"] if item["name"] == "block-3"]
    top, bottom = (np.array(frame["rotation"]) @ (x, 0, 0) + frame["offset"] for x in (-15, 15))
    assert [top[2], bottom[2]] == pytest.approx([30.0, 0.0]), "the frame is that of the file"


def test_a_model_that_could_not_be_read_again_costs_no_other(
    parts: Path, tmp_path: Path, ask: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As what once made a folder end in nothing: an outline that encloses no area."""

    def spoilt(solid: Solid, name: str, *args: object) -> ImportedObject:
        item = make_object(solid, name, *args)
        if name != "block-2":
            return item
        sections = item.text.states[0].sections
        (polygon,) = sections[0].polygons
        line = polygon.model_copy(update={"outer": [(0.0, 0.0), (5.0, 0.0), (9.0, 0.0)]})
        flat = sections[0].model_copy(update={"polygons": [line]})
        state = item.text.states[0].model_copy(update={"sections": [flat]})
        text = item.text.model_copy(update={"states": [state]})
        return replace(item, text=text)

    make_object = cad_import._solid_object  # no file is known that spoils a model today
    monkeypatch.setattr(cad_import, "_solid_object", spoilt)
    monkeypatch.setattr(
        folder_import, "in_processes", lambda work, jobs: enumerate(work(*job) for job in jobs)
    )
    ended = ask(parts, *OPTIONS)
    assert ended.code == 1
    assert set(written(tmp_path)) == {"block-1", "block-3"}
    (failed,) = [item for item in ended.json["files"] if item["failure"]]
    assert not missing(failed["failure"], "block-2.stl", "no sound one")


def test_an_empty_folder_is_refused(tmp_path: Path, ask: Here) -> None:
    (tmp_path / "none").mkdir()
    ended = ask(tmp_path / "none", *OPTIONS)
    assert (ended.code, "holds no CAD file" in ended.err) == (2, True)


def test_units_count_only_where_a_file_states_none(parts: Path, tmp_path: Path, ask: Here) -> None:
    trimesh.creation.box((12, 12, 12)).export(parts / "stated.3mf")
    ended = ask(parts, "--units", "inch", *OPTIONS[2:])
    assert ended.code == 0
    sizes = {item["name"]: item["size"] for item in ended.json["objects"]}
    assert sizes["block-1"] == pytest.approx([254, 508, 254])
    (stated,) = [size for name, size in sizes.items() if not name.startswith("block")]
    assert stated == pytest.approx([12, 12, 12])


def test_a_catalogue_written_by_hand_is_not_brought_up_to_date_unasked(
    parts: Path, tmp_path: Path, ask: Here
) -> None:
    mine = {"name": "block-1", "outline": [[0, 0], [70, 0], [70, 25]], "height": 20}
    text = json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": [mine]})
    (tmp_path / "all.json").write_text(text)
    ended = ask(parts, *OPTIONS)
    assert ended.code == 2
    assert "not imported" in ended.err
    assert (tmp_path / "all.json").read_text() == text
    assert ask(parts, *OPTIONS, "--add").code == 0
    after = written(tmp_path)
    assert after["block-1"] == mine
    assert list(after) == ["block-1", "block-1-2", "block-2", "block-3"]


def test_a_refused_part_costs_no_other_and_is_named_again(parts: Path, tmp_path: Path, ask: Here) -> None:
    step = Path(__file__).parents[1] / "cad" / "step" / "plate_and_chip.step"
    (parts / "both.step").write_bytes(step.read_bytes())
    for is_kept in (False, True):
        ended = ask(parts, *OPTIONS)
        assert ended.code == 1
        (file,) = [item for item in ended.json["files"] if item["refused"]]
        assert (file["objects"], file["kept"], file["failure"]) == (["both"], is_kept, None)
        (line,) = file["refused"]
        assert "0.5" in line
        assert line in ended.err
    assert {"both", "block-1"} <= written(tmp_path).keys()
    (parts / "both.step").unlink()
    assert ask(parts, *OPTIONS).code == 0


def test_a_catalogue_that_could_not_be_read_again_is_not_written(
    parts: Path, tmp_path: Path, ask: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    ask(parts, *OPTIONS)
    before = (tmp_path / "all.json").read_bytes()
    trimesh.creation.box((15, 15, 15)).export(parts / "more.stl")
    monkeypatch.setattr("palpate.config.loading.JSON_BYTES", len(before) + 10)
    ended = ask(parts, *OPTIONS)
    assert (ended.code, ended.out) == (2, "")
    assert "put some of it into another file" in ended.err
    assert (tmp_path / "all.json").read_bytes() == before


def test_files_that_are_refused_later_take_no_object_away(parts: Path, tmp_path: Path, ask: Here) -> None:
    ask(parts, *OPTIONS)
    again = ask(parts, "--states", "as-is", "--out", "all.json")
    assert again.code == 2
    assert sorted(written(tmp_path)) == ["block-1", "block-2", "block-3"]
    assert "nothing was written" not in again.out


def test_pictures_of_objects_are_no_drawings(parts: Path, tmp_path: Path, ask: Here, here: Here) -> None:
    """`objects show` draws into the current folder, which may be the one that is imported."""
    assert ask(parts, *OPTIONS).code == 0
    picture = parts / "all.objects.svg"
    assert here("objects", "show", "all.json", "--picture", picture).code == 0
    picture.with_stem("all.objects-2").write_text(picture.read_text("utf-8"), encoding="utf-8")
    again = ask(parts, *OPTIONS)
    assert again.code == 0
    assert [item["kept"] for item in again.json["files"]] == [True] * 3
    assert picture.name in again.err
