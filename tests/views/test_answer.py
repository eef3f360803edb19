"""What `palpate identify` says in the end, and what its result says of alternatives."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from palpate.base.errors import quantity
from palpate.base.vocabulary import (
    BoundSource,
    ContradictionCause,
    IdentificationVerdict,
    SetUpFault,
    Strategy,
)
from palpate.config.fields import BoundsOut, ConfigurationOut
from palpate.config.recognition_results import (
    AlternativeOut,
    CalibrationUsedOut,
    ContradictionOut,
    IdentificationOut,
    Relation,
    WidthsWithoutOut,
)
from palpate.config.schema import schema_text
from palpate.views.answer import answer_lines
from support.benches.rigs import quick_bench
from support.commands.command import Ended, Here, missing, violations

AT = ConfigurationOut(x=1.0, y=2.0, theta=0.5)
BOUNDS = BoundsOut(x=(0.5, 1.5), y=(1.5, 2.5), theta=(0.4, 0.6))
TWIN = AlternativeOut(
    object="other",
    state="flat",
    configuration=AT,
    bounds=BOUNDS,
    relation=Relation.TWIN,
    turned=None,
    moved=None,
)
TURNED = TWIN.model_copy(
    update={"object": "plate", "relation": Relation.SYMMETRY, "turned": math.radians(179.8), "moved": 0.42}
)


def ended(verdict: IdentificationVerdict, **values: Any) -> IdentificationOut:
    known: dict[str, Any] = {"object": "plate", "state": "flat", "configuration": AT, "bounds": BOUNDS}
    rest: dict[str, Any] = {
        "alternatives": (),
        "symmetry_order": 1,
        "strategy": Strategy.PLANNED,
        "grips": 2,
        "touches": 5,
        "predicted": 0,
        "moved_before": (),
        "detectable_shift": None,
        "emulated": True,
        "rig_seconds": 1.0,
        "wall_seconds": 1.0,
        "session": None,
    }
    return IdentificationOut(verdict=verdict, **(known | rest | values))


NOTHING: dict[str, Any] = {"object": None, "state": None, "configuration": None, "bounds": None}


SURE, TWINS, OPEN, NONE = (
    IdentificationVerdict.IDENTIFIED,
    IdentificationVerdict.INDISTINGUISHABLE,
    IdentificationVerdict.UNRESOLVED,
    IdentificationVerdict.UNKNOWN,
)


@pytest.mark.parametrize(
    ("verdict", "values", "line"),
    [
        (SURE, {"predicted": 3}, "3 touches matched"),
        (SURE, {"predicted": 3, "detectable_shift": 6.25}, "before the last grip: 6.2 mm"),
        (SURE, {"predicted": 3, "detectable_shift": None}, "would hardly have been detected"),
        (SURE, {"predicted": 3, "detectable_shift": 1229.0}, "would hardly have been detected"),
        (SURE, {"predicted": 3, "stranger_probability": 0.0043}, "with probability 0.43 %"),
        (SURE, {"predicted": 9, "stranger_probability": 0.000002}, "with probability less than 0.01 %"),
        (SURE, {"predicted": 9, "stranger_probability": 0.01}, "2 mm over a fifth of its outline"),
        (SURE, {"predicted": 9, "altered_probability": 0.72}, "2 mm in one feature only"),
        (SURE, {"predicted": 9, "altered_probability": 0.72}, "probability 72 %"),
        (SURE, {"moved_before": (2,)}, "moved before grip 2"),
        (TWINS, {"alternatives": (TWIN,)}, "  or other, flat at x 1.00 mm, y 2.00 mm, θ 28.65°"),
        (TWINS, {"alternatives": (TURNED,)}, "  or turned by 179.8° and moved by 0.4 mm: x 1.00 mm"),
        (OPEN, {"alternatives": (TWIN,) * 20}, "one of 8 more; the JSON"),
        (NONE, {"moved_before": (3,), **NOTHING}, "moved before grip 3"),
    ],
)
def test_words(verdict: IdentificationVerdict, values: dict[str, Any], line: str) -> None:
    first, *others = answer_lines(ended(verdict, **values))
    assert first.startswith(f"{verdict.value}: " + ("" if "object" in values else "plate, flat"))
    assert any(line in other for other in others)


def test_a_missed_goal_names_what_would_help_most() -> None:
    rows = [
        WidthsWithoutOut(source=source, position=at, orientation=math.radians(at))
        for source, at in ((BoundSource.MOTION, 0.31), (BoundSource.FINGERS, 0.42), (BoundSource.DENTS, 0.9))
    ]
    told = answer_lines(ended(IdentificationVerdict.IDENTIFIED, goal_met=False, narrower_without=tuple(rows)))
    assert [line for line in told if "±" in line] == [
        "  ±0.31 mm, ±0.31° if the part could not move",
        "  ±0.42 mm, ±0.42° if fingers were where they are thought to be",
    ]
    assert not any(
        "±" in line
        for line in answer_lines(ended(IdentificationVerdict.IDENTIFIED, narrower_without=tuple(rows)))
    )


def test_one_object_is_named_in_all_of_its_states_that_are_left() -> None:
    standing = TWIN.model_copy(update={"object": "plate", "state": "standing"})
    first, *_ = answer_lines(ended(TWINS, alternatives=(standing,)))
    assert first.startswith("indistinguishable: plate, flat or standing: ")
    near = standing.model_copy(update={"relation": Relation.NEAR})
    first, *_ = answer_lines(ended(TWINS, alternatives=(near,)))
    assert first.startswith("indistinguishable: plate, flat or standing: at the same place")
    other = standing.model_copy(update={"state": "leaning"})
    first, *_ = answer_lines(ended(TWINS, alternatives=(near, other)))
    assert (
        "plate, flat or standing or leaning: no touch within reach distinguishes those that are not" in first
    )
    first, *_ = answer_lines(ended(TWINS, alternatives=(standing, TWIN)))
    assert first.startswith("indistinguishable: plate, flat, or something ")


def test_nothing_is_said_that_is_not_so() -> None:
    said = "\n".join(answer_lines(ended(IdentificationVerdict.UNKNOWN, **NOTHING)))
    assert "moved" not in said
    said = "\n".join(answer_lines(ended(IdentificationVerdict.UNRESOLVED, stranger_probability=0.037)))
    assert not missing(said, "not confirmed", "2 mm over a fifth of its outline", "with probability 3.7 %")
    assert "the only one that agrees" in said
    assert "not confirmed: " in said
    advice = ["is a part on the table?"]
    for values, words in (
        ({"contacts": 0}, "nothing was touched in 2 grips"),
        ({"contacts": 0, "swept": True}, "no part of the catalogue has room"),
        ({"contacts": 1}, "1 contact is too few"),
    ):
        told = answer_lines(ended(IdentificationVerdict.UNRESOLVED, **NOTHING, **values), advice)
        assert words in told[0]
        assert told[1] == "  is a part on the table?"
    assert advice[0] not in "\n".join(answer_lines(ended(IdentificationVerdict.UNKNOWN, **NOTHING), advice))
    assert [quantity(n, "grip", "grips") for n in (0, 1, 2)] == ["0 grips", "1 grip", "2 grips"]


def identified(folder: Path, here: Here, outlines: dict[str, list[list[float]]], *options: object) -> Ended:
    """Run a small emulated bench with a catalogue of these outlines."""
    rig, objects = quick_bench(folder)
    rig.write_text(
        rig.read_text(encoding="utf-8").replace("max_grips = 12", "max_grips = 4"), encoding="utf-8"
    )
    entries = [{"name": name, "height": 20.0, "outline": ring} for name, ring in outlines.items()]
    objects.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": entries}))
    args = ["identify", "--rig", rig, "--objects", objects, "--sessions", folder / "sessions", *options]
    return here(*args)


def test_an_all_but_symmetric_part_is_turned_not_another(tmp_path: Path, here: Here) -> None:
    """A plate that half a turn changes by 0.06 mm: less than the bench can feel."""
    almost = {"almost": [[0.0, 0.0], [70.0, 0.0], [70.0, 30.0], [35.0, 30.06], [0.0, 30.0]]}
    told = identified(tmp_path, here, almost, "--json").json
    assert violations(told, json.loads(schema_text("identification"))) == []
    assert told["verdict"] == "indistinguishable"
    (other,) = told["alternatives"]
    assert other["relation"] == "symmetry"
    assert abs(abs(other["turned"]) - math.pi) < 0.02
    # The plate turns about its middle, which stays where it is, far from the origin of its file.
    assert 0 <= other["moved"] < 1.0
    apart = [other["configuration"][key] - told["configuration"][key] for key in ("x", "y")]
    assert math.hypot(*apart) > 50


@pytest.mark.campaign
def test_twins_when_grips_are_drawn(tmp_path: Path, here: Here) -> None:
    wedge = [[0.0, 0.0], [60.0, 0.0], [70.0, 40.0], [5.0, 30.0]]
    twins = {"wedge": wedge, "wedge-2": wedge}
    told = identified(tmp_path, here, twins, "--json", "--strategy", "random").json
    assert violations(told, json.loads(schema_text("identification"))) == []
    # This strategy does not look for touches that confirm an answer: grips may run out before there is one.
    assert told["verdict"] in {"indistinguishable", "unresolved"}
    assert told["strategy"] == "random"
    (other,) = told["alternatives"]
    assert {told["object"], other["object"]} == set(twins)
    assert (other["relation"], other["turned"], other["moved"]) == ("twin", None, None)
    assert told["moved_before"] == []
    assert 0 < told["predicted"] <= told["touches"]


def test_what_the_bounds_rest_on_is_said() -> None:
    grips = (
        {"grip": 1, "position": 0.01, "orientation": 0.001},
        {"grip": 2, "position": 0.04, "orientation": 0.002},
    )
    held = answer_lines(ended(IdentificationVerdict.IDENTIFIED, assumed_holds_n=0.3, motion_bounds=grips))
    assert any(not missing(line, "0.3 N", "0.04 mm", "0.11°") for line in held)
    free = {"grip": 3, "position": None, "orientation": None}
    out = ended(
        IdentificationVerdict.MOVING,
        assumed_holds_n=0.3,
        motion_bounds=(*grips, free),
        moved_before=(2, 3),
        hold_contradicted=True,
    )
    said = "\n".join(answer_lines(out))
    assert not missing(said, "moving:", "before grips 2, 3", "plate", "without a bound", "hold less")
    assert not missing(
        answer_lines(ended(IdentificationVerdict.MOVING, moved_before=(2, 3), **NOTHING))[0], "moving"
    )


def contradiction(cause: ContradictionCause, **values: Any) -> ContradictionOut:
    rest: dict[str, Any] = {"grip": 3, "repeated_in": 4, "touches": 3, "apart": 0.42, "hidden": 1.1}
    return ContradictionOut(cause=cause, **(rest | values))


def test_what_touches_made_again_showed_is_said_with_what_to_do() -> None:
    """A part outside the catalogue is not said to move, and one that moved is not said to be unknown."""
    still = contradiction(ContradictionCause.NOT_IN_CATALOGUE)
    first, said, *_ = answer_lines(ended(IdentificationVerdict.UNKNOWN, contradictions=(still,), **NOTHING))
    assert first.startswith("unknown")
    assert not missing(said, "lay still", "3 touches", "grip 4", "0.4 mm", "add it to the catalogue")
    open_ = contradiction(ContradictionCause.EITHER)
    first, said, *_ = answer_lines(ended(IdentificationVerdict.UNKNOWN, contradictions=(open_,), **NOTHING))
    assert first.startswith("unknown")
    assert not missing(said, "or it moved before grip 3", "within 0.4 mm", "hold it")
    for apart, words in ((7.31, "7.3 mm elsewhere"), (None, "met nothing")):
        moved = contradiction(ContradictionCause.MOVED, apart=apart)
        out = ended(IdentificationVerdict.MOVING, contradictions=(moved,), moved_before=(3, 5), **NOTHING)
        assert not missing(answer_lines(out)[0], "moving", "grips 3, 5", words, "grip 4", "hold it")


def test_a_run_that_ends_with_a_contradiction_says_so() -> None:
    for cause in (ContradictionCause.EITHER, ContradictionCause.MOVED):
        out = ended(IdentificationVerdict.UNRESOLVED, contradictions=(contradiction(cause),), **NOTHING)
        assert not missing(answer_lines(out)[0], "unresolved", "grip 3 contradicts", "moved", "hold it")
        assert "too few" not in answer_lines(out)[0]


@pytest.mark.parametrize("what", list(SetUpFault))
def test_hints_at_the_set_up_name_the_finger_and_what_shows_it(what: SetUpFault) -> None:
    values = {
        SetUpFault.JOINT_OFFSET: {"joint": "aim", "value": (0.1, 0.2)},
        SetUpFault.TRAVEL_SCALE: {"value": (2.0, 2.0)},
    }
    doubt = {"what": what, "finger": "f2", "explains": 9, **values.get(what, {})}
    first, *others = answer_lines(ended(IdentificationVerdict.UNKNOWN, setup_doubts=(doubt,), **NOTHING))
    assert first.startswith("unknown")
    (said,) = [line for line in others if "`palpate c" in line]
    assert "9" in said
    assert "f2" in said or what is SetUpFault.FRAME_MIRRORED
    assert "5.7 to 11.5°" in said or what is not SetUpFault.JOINT_OFFSET


def test_a_state_that_may_tip_or_roll_is_named() -> None:
    why = "may roll: its base reaches only 0 mm from below its centre of mass"
    states = tuple(
        {"object": "pin", "state": name, "when_pushed": "may-roll", "why": why} for name in ("lying", "other")
    )
    said = answer_lines(ended(IdentificationVerdict.IDENTIFIED, not_bounded=states))
    (line,) = [line for line in said if "rolls" in line]
    assert not missing(line, "no bound holds", "pin, lying may roll", "and 1 other state")
    assert "rolls" not in "\n".join(answer_lines(ended(IdentificationVerdict.IDENTIFIED)))


@pytest.mark.parametrize(
    ("verdict", "drifted", "words"),
    [
        (SURE, True, ("0.081 mm", "0.020")),
        (NONE, None, ("unknown: ",)),
    ],
)
def test_a_rig_that_is_not_as_it_was_calibrated_is_said(
    verdict: IdentificationVerdict, drifted: bool | None, words: tuple[str, ...]
) -> None:
    used = CalibrationUsedOut(
        made="2026-05-04T12:30:00Z",
        age_days=12,
        residual_rms_mm=0.0812,
        expected_rms_mm=0.0204,
        drifted=drifted,
    )
    values = NOTHING if verdict is NONE else {}
    said = "\n".join(answer_lines(ended(verdict, calibration=used, **values)))
    advice = ("rig", "changed", "calibration of 2026-05-04", "`palpate check --touch`")
    assert missing(said, *words, *advice) == []
    steady = used.model_copy(update={"drifted": False})
    assert advice[-1] not in "\n".join(answer_lines(ended(SURE, calibration=steady)))
