"""`palpate objects list`, `show`, `check`, `rename` and `merge`."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from palpate.config import load_objects
from palpate.config.catalogue_results import InventoryStateOut
from palpate.config.schema import schema_text
from palpate.views.catalogue.inventory import common_heights_mm
from support.benches.parts import L_SHAPE, mirrored, objects, polygon, rectangle, section, stacked_part
from support.benches.rigs import firm_rig
from support.campaign.sampling import sample
from support.commands.command import Ended, Here, violations

# ----------------------------------------------------------------------------------------------------
# `palpate objects show` and `check`: what they print, write and return.


FOOT, LEG = rectangle(60, 20), rectangle(8, 20)
NAME = "bracket-with-a-name-as-from-a-drawing-office-revision-C"
PARTS = [
    stacked_part(
        "angle", section(0, 8, FOOT), section(8, 40, LEG), tolerance=0.05, probability=0.4, tipping_angle=0.5
    ),
    stacked_part(NAME, section(0, 5, FOOT), section(5, 40, LEG)),
    stacked_part("L", section(0, 20, L_SHAPE)),
    stacked_part("mirrored", section(0, 20, mirrored(L_SHAPE))),
    stacked_part("block", section(0, 20, rectangle(70, 40))),
    stacked_part("wider", section(0, 20, rectangle(70, 41))),
]


@pytest.fixture
def ask(here: Here) -> Here:
    """Run a command on a file of parts, in a folder of its own."""

    def asked(command: str, parts: list[dict[str, Any]], *options: object) -> Ended:
        Path("parts.objects.json").write_text(json.dumps(objects(*parts)))
        return here("objects", command, "parts.objects.json", *options)

    return asked


def rig_with(*heights: float) -> Path:
    """The shipped rig with its fingers elsewhere; "rig.toml" in the current folder."""
    left = iter(heights)
    text = re.sub(r"height_mm = [\d.]+", lambda _: f"height_mm = {next(left)}", firm_rig().read_text())
    path = Path("rig.toml")
    path.write_text(text)
    return path


def test_check_says_what_is_never_told_apart_and_what_would_help(ask: Here) -> None:
    ended = ask("check", PARTS)
    assert (ended.code, ended.err.count("\n")) == (1, 1)
    assert "walls are not upright beside the tips" in ended.err
    assert re.search(
        r"^6 states, 15 pairs:\n +13 distinguished\n +1 never .*\n +1 may or may not", ended.out, re.M
    )
    never, maybe = ended.out.split("never distinguished\n", 2)[2].split("may or may not be distinguished\n")
    assert f"  angle, s\n  = {NAME}, s\n" in never.replace("  =  ", "\n  = ")
    assert "a finger at 5–8 mm would distinguish them" in never
    assert "block, s  ≈  wider, s" in maybe
    assert "0.50 mm apart at 10 mm" in maybe
    assert "no one height would distinguish them for certain" in maybe
    assert max(map(len, ended.out.splitlines())) <= 80


def test_check_writes_the_same_as_json(ask: Here) -> None:
    ended = ask("check", PARTS, "--json")
    assert ended.code == 1
    assert not violations(ended.json, json.loads(schema_text("objects-check")))
    assert (ended.json["states"], ended.json["pairs_compared"], ended.json["told_apart"]) == (6, 15, 13)
    first, second = ended.json["pairs"]
    assert (first["first"]["object"], first["second"]["object"], first["likeness"]) == ("angle", NAME, "same")
    assert first["separating_mm"] == [[5.0, 8.0]]
    assert (second["likeness"], second["separating_mm"]) == ("doubtful", [])
    assert second["apart_mm"] == pytest.approx(0.5, abs=1e-4)
    assert second["within_mm"] == pytest.approx(2 * ended.json["rig"]["contact_bound_mm"])
    assert [item["height_mm"] for item in ended.json["rig"]["heights"]] == [10.0]


def test_check_ends_well_if_nothing_is_the_same(ask: Here) -> None:
    assert ask("check", PARTS[2:]).code == 0
    low = ask("check", PARTS[:2], "--rig", rig_with(6, 10, 10))
    assert low.code == 0
    assert "at 6 mm: f1, tip of radius 5 mm" in low.out
    assert "0 never distinguished" in low.out


def test_check_says_which_states_are_not_known_where_fingers_are(ask: Here) -> None:
    known = stacked_part("known", section(9, 11, FOOT), heights=[[9, 11]], height=30.0)
    ended = ask("check", [known, stacked_part("foot", section(0, 30, FOOT))], "--rig", rig_with(10, 10, 20))
    assert ended.code == 0
    assert "1 not distinguished as far as their sections are known" in ended.out
    assert "known, s: 20 mm" in ended.out
    assert "no one height at which both are known" in ended.out


def test_show_lists_draws_and_names_twins(ask: Here) -> None:
    ended = ask("show", PARTS)
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.startswith("parts.objects.json: 6 objects, 6 states\n")
    assert re.search(r"^angle ±0.05 mm *\n  s +2 +4 +40 +– +40 % +28.6° +all$", ended.out, re.M)
    assert re.search(r"^block *\n  s +1 +4 +20 +2-fold +– +– +all$", ended.out, re.M)
    assert "fingers of rig bench, the shipped one\n  at 10 mm: f1, f2, f3, tips of radius 5 mm" in ended.out
    assert "block, s  ≈  wider, s" in ended.out
    assert f"  = {NAME}, s" in ended.out.replace("  =  ", "\n  = ")
    assert ended.out.endswith("picture parts.objects.svg\n")
    assert max(len(line.rstrip()) for line in ended.out.splitlines()) <= 80
    picture = Path("parts.objects.svg").read_text()
    assert f"feels like {NAME[:12]}" in picture
    assert "may feel like wider, s" in picture


def test_show_of_named_objects_alone(ask: Here) -> None:
    ended = ask("show", PARTS, "block", "angle", "--json")
    assert [item["object"] for item in ended.json["states"]] == ["angle", "block"]
    ended = ask("show", PARTS, "blok")
    assert (ended.code, 'no object "blok"; did you mean "block"?' in ended.err) == (2, True)


def test_show_as_json_with_a_place_for_the_picture(ask: Here) -> None:
    ended = ask("show", PARTS, "--json", "--picture", "elsewhere.svg")
    assert ended.code == 0
    assert not violations(ended.json, json.loads(schema_text("objects-listing")))
    assert ended.json["picture"] == "elsewhere.svg"
    assert Path("elsewhere.svg").exists()
    assert not Path("parts.objects.svg").exists()
    assert [item["state"] for item in ended.json["states"]] == ["s"] * 6
    assert [item["symmetry_order"] for item in ended.json["states"]] == [1, 1, 1, 1, 2, 2]
    assert ended.json["states"][0]["edges"] == [4, 4]
    assert [item["likeness"] for item in ended.json["twins"]] == ["same", "doubtful"]


def test_show_never_writes_over_the_drawing_that_a_part_came_from(ask: Here) -> None:
    for name in ("parts.svg", "parts.json"):
        Path(name).write_text("a drawing")
    assert ask("show", PARTS[:1]).code == 0
    assert Path("parts.svg").read_text() == Path("parts.json").read_text() == "a drawing"


def many(count: int) -> dict[str, Any]:
    """A part with states that feel alike, known at some heights only."""
    known = {"heights": [[0, 12], [12.02, 20]], "height": 20}
    nut = stacked_part(
        "nut", section(0, 12, rectangle(30, 20)), section(12.02, 20, rectangle(30, 20)), **known
    )
    states = [{**nut["states"][0], "name": f"state-{k}"} for k in range(1, count + 1)]
    return {**nut, "states": states}


@pytest.mark.parametrize("columns", sample([80, 120], [80]))
def test_many_states_that_feel_alike_fit_on_a_screen(
    ask: Here, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    parts = [many(24), stacked_part("block", section(0, 20, rectangle(30, 20.1)))]
    lines = ask("show", parts).out.splitlines()
    assert len(lines) <= 52
    assert max(len(line.rstrip()) for line in lines) <= columns
    said = re.sub(r"\s+", " ", " ".join(lines))
    assert "and 4 more; --all" in said
    assert f"= each two of nut: {', '.join(f'state-{k}' for k in range(1, 25))} the same at 10 mm" in said
    assert "≈ each of nut: state-1," in said
    assert "and each of block: s 0.05 mm apart at 10 mm" in said
    assert "not known at" not in said  # it is known where the fingers are


def test_all_lists_every_state_and_pair(ask: Here) -> None:
    out = ask("show", [many(24)], "--all").out
    assert len(re.findall(r"^  state-\d+ ", out, re.M)) == 24
    assert len(re.findall(r"^  nut, state-\d+  =  nut, state-\d+$", out, re.M)) == 276
    assert "--all" not in out
    assert re.search(r"\* nut: state-1, .*, state-24 are not known at 12–12.02 mm", " ".join(out.split()))


def test_states_that_fingers_do_not_meet_or_do_not_know_are_marked(ask: Here) -> None:
    low = stacked_part("low", section(0, 6, rectangle(30, 20)))
    half = stacked_part("half", section(0, 4, rectangle(30, 20)), heights=[[0, 4]], height=20)
    ended = ask("show", [low, half, stacked_part("block", section(0, 20, rectangle(33, 20)))])
    assert re.findall(r"(\S+) *\n  s .* (\S+)$", ended.out, re.M) == [
        ("low", "none"),
        ("half", "?*"),
        ("block", "all"),
    ]
    assert "* half: s is known at 0–4 mm only" in ended.out


def test_a_large_catalogue_has_pages(ask: Here) -> None:
    parts = [stacked_part(f"p{k}", section(0, 20, rectangle(20 + k, 20))) for k in range(70)]
    ended = ask("show", parts, "--json")
    assert ended.json["pictures"] == ["parts.objects.svg", "parts.objects-2.svg"]
    assert "page 2 of 2" in Path("parts.objects-2.svg").read_text()


def test_no_finger_is_advised_where_tops_differ_by_a_rounding(ask: Here) -> None:
    parts = [stacked_part(name, section(0, top, FOOT)) for name, top in (("a", 20.0), ("b", 20.000001))]
    (pair,) = ask("check", parts, "--json").json["pairs"]
    assert pair["separating_mm"] == []


def test_show_says_that_all_is_told_apart(ask: Here) -> None:
    ended = ask("show", [PARTS[2], stacked_part("disc", section(0, 20, polygon(30, 20)))])
    assert "these fingers distinguish all states" in ended.out


@pytest.mark.parametrize("command", ["list", "show", "check"])
def test_a_file_that_is_wrong_or_missing_is_one_line(ask: Here, command: str, here: Here) -> None:
    crossed = stacked_part("crossed", section(0, 5, [[0, 0], [10, 10], [10, 0], [0, 10]]))
    ended = ask(command, [crossed])
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert 'object "crossed"' in ended.err
    gone = here("objects", command, "gone.json")
    assert (gone.code, gone.err.count("\n")) == (2, 1)


def test_a_picture_that_cannot_be_written_is_refused_first(ask: Here) -> None:
    ended = ask("show", PARTS[:1], "--picture", "no-such-folder/a.svg")
    assert (ended.code, ended.out) == (2, "")
    assert "no-such-folder/a.svg cannot be written" in ended.err


# ----------------------------------------------------------------------------------------------------
# `palpate objects list`: what a file holds, without comparing any of it.


def test_list_says_what_is_known_of_each_object(ask: Here) -> None:
    known = {"heights": [[9, 11], [12, 20]], "height": 30.0, "probability": 0.4}
    made = {
        **stacked_part("made", section(9, 11, FOOT), section(12, 20, LEG), **known),
        "size": [60.0, 20.0, 30.0],
        "mass_g": 12.5,
        "source": source("cad/made.step"),
    }
    ended = ask("list", [*PARTS, made])
    assert (ended.code, ended.err) == (0, "")
    assert re.search(r"^block +– +– +1 +all heights$", ended.out, re.M)
    assert re.search(r"^made +60 × 20 × 30 +12.5 g +1: 40 % +9–20, in part$", ended.out, re.M)
    assert ended.out.endswith("\n7 objects, 7 states in parts.objects.json\n")
    assert max(len(line.rstrip()) for line in ended.out.splitlines()) <= 80
    out = ask("list", [*PARTS, made], "--json").json
    assert not violations(out, json.loads(schema_text("objects-inventory")))
    assert out["objects"][-1]["source"] == "cad/made.step"
    assert out["objects"][-1]["states"][0]["heights"] == [[9, 11], [12, 20]]


def test_list_shows_tags_and_chooses_by_them(ask: Here, here: Here) -> None:
    first, second = (
        {**part, "tags": tags} for part, tags in zip(PARTS, (["steel"], ["steel", "spare"]), strict=False)
    )
    ended = ask("list", [first, second, *PARTS[2:]], "--tag", "steel")
    assert re.search(r"all heights +steel$", ended.out, re.M)
    assert re.search(r"all heights +steel, spare$", ended.out, re.M)
    assert ended.out.endswith("\n2 objects, 2 states in parts.objects.json\n")
    both = here("objects", "list", "parts.objects.json", "--tag", "spare", "--tag", "steel", "--json").json
    assert not violations(both, json.loads(schema_text("objects-inventory")))
    assert [item["tags"] for item in both["objects"]] == [["steel", "spare"]]
    none = here("objects", "list", "parts.objects.json", "--tag", "brass")
    assert (none.code, none.out) == (2, "")
    assert "spare, steel" in none.err


def test_list_with_names_says_which_side_is_down(ask: Here, here: Here) -> None:
    sides = [
        {"name": name, "sections": [section(0, 20, FOOT)], "down": down, "probability": share}
        for name, down, share in (("a", [0, 0, -1], 0.5), ("b", [0.6, -0.8, 0], 0.25))
    ]
    ended = ask("list", [*PARTS, {"name": "sided", "states": sides}], "sided")
    assert (ended.code, ended.err) == (0, "")
    assert re.search(r"^  a +−z +50 % +20 +– +all heights$", ended.out, re.M)
    assert re.search(r"^  b +\(0.6, -0.8, 0\) +25 % +20 +– +all heights$", ended.out, re.M)
    assert "block" not in ended.out
    gone = here("objects", "list", "parts.objects.json", "no-such-part")
    assert (gone.code, gone.out, gone.err.count("\n")) == (2, "", 1)
    assert "no-such-part" in gone.err


@given(
    st.lists(
        st.tuples(
            st.integers(1, 12),
            st.none() | st.lists(st.integers(0, 12), min_size=2, max_size=6, unique=True).map(sorted),
        ),
        min_size=1,
        max_size=4,
    ),
    st.integers(0, 11),
)
def test_common_heights_are_those_at_which_every_state_is_known(
    drawn: list[tuple[int, list[int] | None]], at: int
) -> None:
    ranges = [None if ends is None else tuple(zip(ends[::2], ends[1::2], strict=False)) for _, ends in drawn]
    states = [
        InventoryStateOut(
            name="s", probability=None, down=None, tipping_angle=None, height=top, heights=known
        )
        for (top, _), known in zip(drawn, ranges, strict=True)
    ]
    height = at + 0.5
    known = all(
        mine is None or height > top or any(low < height < high for low, high in mine)
        for (top, _), mine in zip(drawn, ranges, strict=True)
    )
    assume(height < max(top for top, _ in drawn))  # above all parts nothing is listed
    assert any(low < height < high for low, high in common_heights_mm(states)) == known


# ----------------------------------------------------------------------------------------------------
# `palpate objects remove`, `rename`, `merge`: what they change, what they leave, and what they refuse.


@pytest.fixture
def edit(here: Here) -> Here:
    return lambda *args: here("objects", *args)


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


def test_remove(tmp_path: Path, edit: Here) -> None:
    file = saved(tmp_path / "all.json", square("a"), square("b", tolerance=0.1), square("c"))
    ended = edit("remove", "all.json", "a", "c")
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
    tmp_path: Path, edit: Here, command: list[str], message: str
) -> None:
    file = saved(tmp_path / "all.json", square("washer"), square("nut"))
    before = file.read_text()
    ended = edit(*command)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert message in ended.err
    assert file.read_text() == before
    assert [item.name for item in tmp_path.iterdir()] == ["all.json"]


def test_rename(tmp_path: Path, edit: Here) -> None:
    file = saved(tmp_path / "all.json", square("a"), square("b"))
    assert edit("rename", "all.json", "a", "plate, 20 mm").code == 0
    assert names(file) == ["plate, 20 mm", "b"]


def test_merge_takes_the_same_object_once_and_follows_sources(tmp_path: Path, edit: Here) -> None:
    one = saved(tmp_path / "one" / "a.json", square("a", source=source("cad/a.stl")), square("b"))
    other = saved(
        tmp_path / "b.json",
        square("b"),
        square("c"),
        refused=[{"source": source("x.stl"), "why": "is empty"}],
    )
    ended = edit("merge", one, other, "--out", "new.json")
    assert (ended.code, ended.out) == (0, "3 objects in new.json\n")
    assert names(tmp_path / "new.json") == ["a", "b", "c"]
    made = json.loads((tmp_path / "new.json").read_text())
    assert made["objects"][0]["source"]["file"] == "one/cad/a.stl"
    assert made["refused"][0]["source"]["file"] == "x.stl"


def test_merge_refuses_different_objects_of_one_name(tmp_path: Path, edit: Here) -> None:
    saved(tmp_path / "a.json", square("a"))
    saved(tmp_path / "b.json", square("a", 21.0))
    ended = edit("merge", "a.json", "b.json", "--out", "new.json")
    assert ended.code == 2
    assert 'b.json and a.json have different objects named "a"; rename one' in ended.err
    assert not (tmp_path / "new.json").exists()
