"""Wiring: faults are drawn, and what people would see of them must lead back to each and mend the file."""

import copy
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

import palpate.rig.bench as bench_module
from palpate import open_rig, open_session
from palpate.base.errors import InputError
from palpate.cli.check import _ConsoleOnlooker
from palpate.config import RigFile, load_rig
from palpate.config.diagnosis_results import Cause
from palpate.config.wiring_record import ConfirmedWiring, load_confirmed, proof_path
from palpate.config.writers import change_rig, file_text, keep_confirmed
from palpate.jobs.check import CheckAnswer
from palpate.jobs.identification import IdentificationRequest
from palpate.rig.diagnostics.wiring import (
    FingerWiring,
    Seen,
    Side,
    TipMove,
    TipPress,
    Way,
    standing_at,
    wiring_of,
)
from palpate.rig.diagnostics.wiring_check import Sight
from palpate.rig.diagnostics.wiring_findings import judge_wiring
from palpate.rig.emulated import devices
from palpate.rig.emulated.devices import emulate
from palpate.rig.identification.result import WiringProof
from support.benches.calibration_files import MADE
from support.benches.rigs import firm_rig, small, small_objects
from support.commands.command import Here
from support.commands.repository import EXAMPLES

Table = dict[str, Any]

# ----------------------------------------------------------------------------------------------------
# What people see of a true wiring, asked by one who believes the file. Written from its words, not from the
# search for candidates.


def seen_by_people(told: Sequence[FingerWiring], true: Sequence[FingerWiring]) -> Seen:
    bases = [item.base_mm for item in true]
    presses, moves = [], []
    for item in told:
        at = standing_at(bases, item.base_mm)
        presses += [
            TipPress(item.name, side, stood=False) if at is None else _press(told, true[at], item.name, side)
            for side in (Side.FRONT, Side.LEFT)
        ]
        for joint in (0, 1):
            own = next(other for other in true if item.ids[joint] in other.ids)
            moved = own.ids.index(item.ids[joint])
            way = Way((moved, item.signs[joint] * own.signs[moved]))
            moves.append(TipMove(item.name, joint, own.base_mm, way))
    return Seen(tuple(presses), tuple(moves))


def _press(told: Sequence[FingerWiring], true: FingerWiring, asked: str, side: Side) -> TipPress:
    array = next(item for item in told if item.port == true.port)
    angle = math.remainder(side.value - true.array_deg, 360)
    if abs(angle) > true.coverage_deg / 2:
        return TipPress(asked, side)
    angle = angle if array.mirrored == true.mirrored else -angle
    low = (array.inverted == true.inverted) if side is Side.FRONT else None
    return TipPress(asked, side, (array.name,), angle, low)


# ----------------------------------------------------------------------------------------------------
# Faults of a rig file, by what is wrong in it.


def _rotate(told: Table, at: Sequence[int], *paths: str) -> None:
    """Give fingers the values of the next ones."""
    before = copy.deepcopy(told["fingers"])
    for k, source in zip(at, [*at[1:], at[0]], strict=True):
        for path in paths:
            *tables, key = path.split(".")
            into, out = told["fingers"][k], before[source]
            for name in tables:
                into, out = into[name], out[name]
            into[key] = out[key]


def _mirror(told: Table, *, joints: bool) -> None:
    for item in told["fingers"]:
        x, y = item["base_mm"]
        item["base_mm"], item["heading_deg"] = [x, -y], -item["heading_deg"] % 360
        if joints:
            item["aim"]["gear_ratio"] *= -1


def _reverse(told: Table, k: int, joint: str, key: str) -> None:
    table = told["fingers"][k][joint]
    if joint == "slide":
        turns = (table["range_mm"][0] + 1 - table["zero_mm"]) / table[key]
        table["zero_mm"] = table["range_mm"][0] + 1 + table[key] * turns
    table[key] *= -1


FAULTS: Mapping[str, tuple[Cause, Callable[[Table, Sequence[int]], None]]] = {
    "ports": (Cause.ARRAYS_SWAPPED, lambda told, at: _rotate(told, at, "array.port")),
    "ids": (Cause.SERVOS_SWAPPED, lambda told, at: _rotate(told, at, "aim.dxl_id", "slide.dxl_id")),
    "places": (Cause.PLACES_SWAPPED, lambda told, at: _rotate(told, at, "base_mm", "heading_deg")),
    "aim": (Cause.DIRECTION_WRONG, lambda told, at: _reverse(told, at[0], "aim", "gear_ratio")),
    "slide": (Cause.DIRECTION_WRONG, lambda told, at: _reverse(told, at[0], "slide", "mm_per_turn")),
    "mirrored": (Cause.FRAME_MIRRORED, lambda told, _: _mirror(told, joints=True)),
    "mirrored places": (Cause.FRAME_MIRRORED, lambda told, _: _mirror(told, joints=False)),
    "counts mirrored": (Cause.ARRAY_MOUNTING, lambda told, at: _mount(told, at, first_texel="lower-right")),
    "upside down": (Cause.ARRAY_MOUNTING, lambda told, at: _mount(told, at, first_texel="upper-right")),
    "turned": (Cause.ARRAY_MOUNTING, lambda told, at: _mount(told, at, heading_deg=90.0)),
    "turned by half": (Cause.ARRAY_MOUNTING, lambda told, at: _mount(told, at, heading_deg=180.0)),
}


def _mount(told: Table, at: Sequence[int], **keys: object) -> None:
    told["fingers"][at[0]]["array"].update(keys)


def ring(angles_deg: Sequence[float]) -> Table:
    """A right rig file with fingers at these angles round the table, the second one's joints reversed."""
    file = tomllib.loads(firm_rig().read_text(encoding="utf-8"))
    fingers = []
    for k, angle in enumerate(angles_deg):
        item = copy.deepcopy(file["fingers"][0])
        turn = math.radians(angle)
        item["name"] = item["array"]["port"] = f"mock://q{k}"
        item["base_mm"] = [round(190 * math.cos(turn), 3), round(190 * math.sin(turn), 3)]
        item["heading_deg"] = (angle + 180) % 360
        item["aim"]["dxl_id"], item["slide"]["dxl_id"] = 10 * k + 1, 10 * k + 2
        fingers.append(item)
    fingers[1]["aim"]["gear_ratio"] *= -1
    return file | {"fingers": fingers}


@st.composite
def rings(draw: st.DrawFn) -> Table:
    """Fingers far enough from each other, with nothing symmetrical that would hide a fault."""
    count = draw(st.integers(2, 4))
    offsets = draw(st.lists(st.integers(-12, 12), min_size=count, max_size=count, unique=True))
    return ring([360 * k / count + offset + 20 for k, offset in enumerate(offsets)])


@given(rings(), st.sampled_from(sorted(FAULTS)), st.permutations(range(4)), st.integers(2, 4), st.booleans())
def test_of_any_fault_the_cause_is_named_and_the_file_mended(
    right: Table, name: str, order: list[int], most: int, known_turns: bool
) -> None:
    count = len(right["fingers"])
    at = [k for k in order if k < count][:most]
    wrong, true = copy.deepcopy(right), RigFile.model_validate(right)
    cause, plant = FAULTS[name]
    plant(wrong, at)
    told = RigFile.model_validate(wrong)
    seen = seen_by_people(wiring_of(told), wiring_of(true))
    turns = {servo.dxl_id: 0.06 for servo in true.servos} if known_turns else {}
    verdict = judge_wiring(told, Seen(seen.presses, seen.moves, turns))
    same_places = {Cause.PLACES_SWAPPED, Cause.FRAME_MIRRORED}
    assert {item.cause for item in verdict.findings} <= (same_places if cause in same_places else {cause})
    assert verdict.findings
    document: Any = copy.deepcopy(wrong)
    for change in verdict.changes:
        table, keys = document, change.file_key.replace("[", ".").replace("]", "").split(".")
        for key in keys[:-1]:
            table = table[int(key) if key.isdecimal() else key]
        table[keys[-1]] = change.to
    mended = RigFile.model_validate(document) if name != "slide" or known_turns else None
    if mended is not None:
        assert {item.function for item in wiring_of(mended)} == {item.function for item in wiring_of(true)}


@given(rings())
def test_of_a_right_rig_nothing_is_found(right: Table) -> None:
    rig = RigFile.model_validate(right)
    assert judge_wiring(rig, seen_by_people(wiring_of(rig), wiring_of(rig))).findings == ()


def test_what_nothing_explains_is_said_without_a_cause() -> None:
    rig = load_rig(firm_rig())
    told = wiring_of(rig)
    right = seen_by_people(told, told)
    silent = tuple(TipPress(item.asked, item.side) if item.asked == "f2" else item for item in right.presses)
    both = (TipPress("f1", Side.FRONT, ("f1", "f3")), *right.presses[1:])
    still = (TipMove("f1", 0, None, None), *right.moves[1:])
    twice = (*right.moves[:-1], TipMove("f3", 1, told[0].base_mm, Way.OUT))
    for seen in (Seen(silent), Seen(both), Seen((), still), Seen(right.presses, twice)):
        verdict = judge_wiring(rig, seen)
        assert {item.cause for item in verdict.findings} == {Cause.WIRING_UNCLEAR}
        assert verdict.changes == ()


def test_a_ring_assigned_round_is_not_many_signs() -> None:
    rig, wrong = load_rig(firm_rig()), tomllib.loads(firm_rig().read_text(encoding="utf-8"))
    _rotate(wrong, [0, 1, 2], "base_mm", "heading_deg")
    told = RigFile.model_validate(wrong)
    seen = seen_by_people(wiring_of(told), wiring_of(rig))
    (found,) = judge_wiring(told, seen).findings
    assert found.cause is Cause.PLACES_SWAPPED
    assert "1 place round" in found.saw
    for half in (Seen(presses=seen.presses), Seen(moves=seen.moves)):
        assert {item.cause for item in judge_wiring(told, half).findings} == {Cause.WIRING_UNCLEAR}


# ----------------------------------------------------------------------------------------------------
# The emulated person at an emulated bench, whose truth is another rig file.


_ARM_IDS = ("shoulder.dxl_id", "elbow.dxl_id")


def proven(told: RigFile, true: RigFile, folder: Path, monkeypatch: pytest.MonkeyPatch) -> CheckAnswer:
    path = folder / "rig.toml"
    path.write_text("# mine\n" + file_text(told), encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(bench_module, "emulate", lambda _, placements, seed: emulate(true, placements, seed))
        return open_rig(path).check(press=True, move=True)


@pytest.mark.parametrize(
    ("example", "plant", "cause"),
    [
        ("firm-rig", lambda told: _rotate(told, [0, 1, 2], "base_mm", "heading_deg"), Cause.PLACES_SWAPPED),
        pytest.param(
            "pad-rig",
            lambda told: _mount(told, [1], first_texel="upper-right"),
            Cause.ARRAY_MOUNTING,
            marks=pytest.mark.campaign,
        ),
        pytest.param(
            "two-link-rig",
            lambda told: _rotate(told, [2, 0], *_ARM_IDS),
            Cause.SERVOS_SWAPPED,
            marks=pytest.mark.campaign,
        ),
        ("two-link-rig", lambda _: None, None),
    ],
)
def test_on_a_bench_the_file_is_mended(
    example: str,
    plant: Callable[[Table], None],
    cause: Cause | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    true = load_rig(EXAMPLES / f"{example}.toml")
    wrong = tomllib.loads((EXAMPLES / f"{example}.toml").read_text(encoding="utf-8"))
    plant(wrong)
    found = proven(RigFile.model_validate(wrong), true, tmp_path, monkeypatch)
    wiring = found.result.wiring
    assert wiring is not None
    assert wiring.confirmed is (cause is None)
    assert {item.cause for item in found.findings} - {Cause.LIMITS_NOT_SET} == ({cause} if cause else set())
    if cause is not None:
        text = found.apply()
        assert text.startswith("# mine\n")
        mended = wiring_of(load_rig(tmp_path / "rig.toml"))
        assert {item.function for item in mended} == {item.function for item in wiring_of(true)}


def test_a_wiring_that_was_mended_ends_well_and_says_what_to_run_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, here: Here
) -> None:
    true, wrong = load_rig(firm_rig()), tomllib.loads(firm_rig().read_text(encoding="utf-8"))
    _mount(wrong, [1], first_texel="upper-right")
    path = tmp_path / "rig.toml"
    path.write_text(tomlkit.dumps(wrong), encoding="utf-8")
    monkeypatch.setattr(bench_module, "emulate", lambda _, placements, seed: emulate(true, placements, seed))
    press = ("check", "--rig", path, "--press")
    found = here(*press)
    assert found.code == 1
    assert f"palpate check --rig {path} --press --apply" in found.out
    mended = here(*press, "--apply")
    assert mended.code == 0
    assert mended.err.splitlines()[-1].endswith(f"palpate check --rig {path} --press --move")
    assert wiring_of(load_rig(path)) == wiring_of(true)
    assert here(*press).code == 0


def test_changes_keep_comments_and_a_file_that_would_be_wrong_is_left(tmp_path: Path) -> None:
    rig, wrong = load_rig(firm_rig()), tomllib.loads(firm_rig().read_text(encoding="utf-8"))
    _rotate(wrong, [0, 1], "array.port")
    told = RigFile.model_validate(wrong)
    path = tmp_path / "rig.toml"
    text = tomlkit.dumps(wrong).replace('port = "mock://f2"', 'port = "mock://f2" # left cable', 1)
    path.write_text(text, encoding="utf-8")
    changes = judge_wiring(told, seen_by_people(wiring_of(told), wiring_of(rig))).changes
    with pytest.raises(InputError, match="is the port of"):
        change_rig(path, changes[:1])
    assert path.read_text(encoding="utf-8") == text
    change_rig(path, changes)
    assert 'port = "mock://f1" # left cable' in path.read_text(encoding="utf-8")
    assert wiring_of(load_rig(path)) == wiring_of(rig)


# ----------------------------------------------------------------------------------------------------
# Confirmed wiring.


def test_a_run_asks_for_proof_of_these_devices_wired_like_this(tmp_path: Path) -> None:
    rig = load_rig(firm_rig())
    arrays = {finger.name: f"{k:032x}" for k, finger in enumerate(rig.fingers)}
    path = tmp_path / "rig.toml"
    keep_confirmed(path, ConfirmedWiring.of(rig, arrays, MADE, "check"))
    confirmed = load_confirmed(proof_path(path))
    WiringProof(rig, confirmed, "palpate check").check(arrays)
    corrected = copy.deepcopy(tomllib.loads(firm_rig().read_text(encoding="utf-8")))
    corrected["fingers"][0]["base_mm"] = [3.0, 188.0]
    WiringProof(RigFile.model_validate(corrected), confirmed, "palpate check").check(arrays)
    refused = [(rig, None, arrays), (rig, confirmed, arrays | {"f2": arrays["f3"]})]
    for plant in (
        lambda told: _rotate(told, [0, 1], "aim.dxl_id"),
        lambda told: _rotate(told, [0, 1, 2], "base_mm", "heading_deg"),
        lambda told: _reverse(told, 0, "aim", "gear_ratio"),
        lambda told: _mount(told, [0], first_texel="lower-right"),
    ):
        changed = copy.deepcopy(tomllib.loads(firm_rig().read_text(encoding="utf-8")))
        plant(changed)
        refused.append((RigFile.model_validate(changed), confirmed, arrays))
    for described, known, found in refused:
        with pytest.raises(InputError, match="palpate check --press"):
            WiringProof(described, known, "palpate check --press").check(found)


def test_an_unproven_rig_is_refused_before_torque_and_its_session_replays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(small(firm_rig()), encoding="utf-8")
    proof = WiringProof(load_rig(path), None, "palpate check --press --move")
    made = devices._flat_description
    monkeypatch.setattr(devices, "_flat_description", lambda *of: replace(made(*of), emulated=False))
    monkeypatch.setattr(
        IdentificationRequest, "proof", property(lambda asked: None if asked.unconfirmed else proof)
    )
    with pytest.raises(InputError, match="never confirmed"):
        open_rig(path).identify(small_objects(), sessions=tmp_path)
    (session,) = tmp_path.glob("identify-*")
    assert open_session(session).replay().complete


def test_somebody_at_a_real_rig_is_asked_until_the_answer_says_something(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig, console, asked = load_rig(firm_rig()), Console(file=StringIO()), list[str]()
    answers = iter(["maybe", "n", "", "", "7", "2", "x", "L", "-160, 95", "o", "0"])

    def answer(what: str, **_: object) -> str:
        asked.append(what)
        return next(answers)

    monkeypatch.setattr(console, "input", answer)
    person = _ConsoleOnlooker(console, rig)
    assert not person.press(rig.fingers[0], Side.FRONT)
    assert person.press(rig.fingers[1], Side.LEFT)
    assert "f2 at the near left (base -165, -95)" in asked[-1]
    person.watch()
    assert person.saw() == Sight(rig.fingers[1].base_mm, Way.LEFT)
    assert person.saw() == Sight((-160.0, 95.0), Way.OUT)
    assert person.saw() is None
