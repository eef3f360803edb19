"""A calibrated rig, and drift of its calibration."""

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from palpate.base.errors import InputError
from palpate.base.vocabulary import IdentificationVerdict
from palpate.calibration.frame_alignment import BasePose
from palpate.config import (
    CalibrationFile,
    RigFile,
    RigOnBench,
    StageConfig,
    apply_calibration,
    calibration_path,
    calibration_toml,
    load_calibrated,
    load_objects,
    load_rig,
    shipped_objects,
    shipped_rig,
)
from palpate.config.diagnosis_results import Cause
from palpate.config.schema import schema_text
from palpate.drivers.tactile.patches import PatchFlag
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.bench import choose_placements, connect, set_up
from palpate.rig.diagnostics.calibration_check import calibration_out, judge_calibration
from palpate.rig.diagnostics.diagnosis import check_out, diagnose
from palpate.rig.diagnostics.host_ports import Computer
from palpate.rig.diagnostics.servo_bus import endpoint_of_rig
from palpate.rig.diagnostics.steps import DiagnosisCase
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.ground_truth import placements_in_hand_frame
from palpate.rig.identification.identify import search
from palpate.rig.identification.outcome import Identification
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach, reach_of
from palpate.rig.session.calibration_drift import (
    calibration_used,
    check_devices,
    device_mismatch,
    devices_of,
    session_agreement,
)
from palpate.views.check_table import show_check
from support.benches.calibration_files import (
    MADE,
    bench_calibration,
    full_calibration,
    truth_calibration,
)
from support.benches.rigs import STAGE, firm_rig, quick_rig
from support.commands.command import Here, log_events, log_lines, missing, violations, write_log
from support.devices.array_tips import felt_patch
from support.oracles.plans import SimulatedTouches
from support.oracles.shapely_touches import SHIPPED_OBJECTS, outlines, place_within

# ----------------------------------------------------------------------------------------------------
# A rig file with a calibration beside it: who takes it, who refuses it, and that a replay has it, too.

SEED = 7


@pytest.fixture
def loose(tmp_path: Path) -> Path:
    """The shipped rig as a file, its fingers' places hardly known, and with a search of one grip."""
    text = firm_rig().read_text(encoding="utf-8")
    for old, new, times in (
        (r"max_grips = \d+", "max_grips = 1", 1),
        (r"base_error_mm = 0\.05", "base_error_mm = 1.5", 1),
        (r"heading_error_deg = 0\.02", "heading_error_deg = 1.0", 1),
        (r"base_mm = 0\.05\nheading_deg = 0\.02", "base_mm = 1.5\nheading_deg = 1.0", 3),
    ):
        text, count = re.subn(old, new, text)
        assert count == times
    file = tmp_path / "my-rig.toml"
    file.write_text(text, encoding="utf-8")
    return file


def put_beside(rig: Path, file: CalibrationFile) -> Path:
    beside = calibration_path(rig)
    beside.write_text(calibration_toml(file), encoding="utf-8")
    return beside


def test_the_calibration_beside_the_file_is_taken(loose: Path) -> None:
    described = load_rig(loose)
    assert load_calibrated(loose).rig == described
    file = full_calibration(described)
    beside = put_beside(loose, file)
    found = load_calibrated(loose)
    assert (found.calibration, found.calibration_path) == (file, beside)
    assert found.described == described
    assert found.rig.fingers[0].bounds.position_mm == 0.2
    without = load_calibrated(loose, calibration=False)
    assert (without.rig, without.calibration, without.calibration_path) == (described, None, None)


def test_the_shipped_rig_has_none() -> None:
    found = load_calibrated(None)
    assert found.calibration is None
    assert found.rig == load_rig(shipped_rig())


def test_a_session_keeps_its_calibration(loose: Path, here: Here) -> None:
    put_beside(loose, bench_calibration(load_rig(loose), SEED))
    assert here("identify", "--rig", loose.name, "--seed", SEED + 1).code == 2, "it is of other arrays"
    (session,) = Path("palpate-sessions").iterdir()
    assert log_events(session / "session.jsonl.zst")[0]["calibration"] is True
    kept = session / "rig.calibration.toml"
    assert kept.read_bytes() == calibration_path(loose).read_bytes()
    again = here("replay", session)
    assert (again.code, again.err) == (0, "")
    assert "all as recorded; ended by InputError: the calibration of rig" in again.out
    assert here("watch", "--session", session, "--for", 0.1, "--json").code == 0
    kept.unlink()
    told = here("replay", session)
    assert (told.code, told.out) == (2, "")
    assert missing(told.err, session, "cannot be replayed", f"{kept.name} is missing") == []


def test_other_arrays_than_were_calibrated_are_refused(loose: Path, here: Here) -> None:
    file = bench_calibration(load_rig(loose), SEED)
    put_beside(loose, file)
    done = here("identify", "--rig", loose.name, "--seed", SEED + 1)
    assert done.code == 2
    assert done.err.startswith('error: the calibration of rig "firm-bench" was made with array 66310000')
    assert f"palpate calibrate --rig {loose.name}" in done.err
    assert "--no-calibration" in done.err
    assert here("watch", "--rig", loose.name, "--for", 0.1).code == 2
    assert here("watch", "--rig", loose.name, "--for", 0.1, "--no-calibration").code == 0


@pytest.mark.parametrize("command", ["identify", "check", "watch", "plan"])
def test_a_calibration_of_the_rig_before_it_was_changed_is_refused(
    loose: Path, here: Here, command: str
) -> None:
    beside = put_beside(loose, full_calibration(load_rig(loose)))
    loose.write_text(loose.read_text().replace("zero_mm = 40.0", "zero_mm = 41.0", 1))
    more = ["--contacts", "contacts.json"] if command == "plan" else []
    done = here(command, "--rig", loose, *more)
    assert (done.code, done.out) == (2, "")
    words = (
        beside,
        "fingers or stage",
        f"changed in {loose}",
        "2026-05-04",
        f"`palpate calibrate --rig {loose}`",
    )
    assert missing(done.err, *words) == []
    assert done.err.count("\n") == 1


def test_devices_are_told_apart() -> None:
    rig = load_rig(firm_rig())
    with connect(set_up(rig, (), SEED)) as hand:
        devices = devices_of(hand)
        file = full_calibration(rig, devices=devices)
        check_devices(file, hand)
        check_devices(None, hand)
        swapped = [*devices[:6], devices[7], devices[6], devices[8]]
        with pytest.raises(InputError, match="on finger f1, which has array 6631"):
            check_devices(full_calibration(rig, devices=swapped), hand)
        with pytest.raises(InputError, match="names 2 arrays for 3 fingers"):
            check_devices(full_calibration(rig, devices=devices[:-1]), hand)
    assert [device.kind for device in devices] == ["servo"] * 6 + ["array"] * 3
    assert [device.id for device in devices[:6]] == ["11", "12", "21", "22", "31", "32"]
    assert devices[0].model == "XM430-W350"
    assert devices[6].model == "palpate, 8 x 20 cylinder"
    other = device_mismatch(file, {12: "XC330-M288"}, {})
    assert missing(str(other), "servo 12", "made with", "XM430-W350", "is a XC330-M288 now") == []
    assert device_mismatch(file, {}, {}) is None


def test_the_truth_is_told_as_the_calibrated_hand_sees_it(loose: Path) -> None:
    rig = load_rig(loose)
    (lying,) = choose_placements(rig, load_objects(shipped_objects()), None, SEED)
    put_beside(loose, bench_calibration(rig, SEED))
    on_bench = load_calibrated(loose)
    assert placements_in_hand_frame(load_calibrated(loose, calibration=False), [lying], SEED) == (lying,)
    (seen,) = placements_in_hand_frame(on_bench, [lying], SEED)
    assert math.dist((seen.x_mm, seen.y_mm), (lying.x_mm, lying.y_mm)) > 0.1
    bench = set_up(rig, [lying], SEED)
    assert bench.emulated is not None
    for finger, emulated in zip(on_bench.rig.fingers, bench.emulated.bench.fingers, strict=True):
        truth = emulated.truth
        really = BasePose(truth.base_mm, truth.heading_rad)
        found = BasePose(finger.base_mm, math.radians(finger.heading_deg))
        expected = from_finger(really, lying.x_mm, lying.y_mm, lying.theta_rad)
        assert from_finger(found, seen.x_mm, seen.y_mm, seen.theta_rad) == pytest.approx(expected, abs=1e-4)


def from_finger(at: BasePose, x_mm: float, y_mm: float, theta_rad: float) -> tuple[float, float, float]:
    """A pose as a finger sees it: distance, bearing from its heading, turn from its heading."""
    dx, dy = x_mm - at.base_mm[0], y_mm - at.base_mm[1]
    bearing = math.remainder(math.atan2(dy, dx) - at.heading_rad, 2 * math.pi)
    return math.hypot(dx, dy), bearing, math.remainder(theta_rad - at.heading_rad, 2 * math.pi)


@pytest.fixture(scope="module")
def shipped() -> RigFile:
    return load_rig(firm_rig())


def test_check_says_what_the_calibration_promises(shipped: RigFile, tmp_path: Path) -> None:
    rig_path = tmp_path / "bench.toml"
    rig_path.write_bytes(firm_rig().read_bytes())
    with connect(set_up(shipped, (), 0)) as hand:
        file = full_calibration(shipped, devices=devices_of(hand))
    put_beside(rig_path, file)
    on_bench = load_calibrated(rig_path)
    case = DiagnosisCase(on_bench, endpoint_of_rig(on_bench.described), Computer(tmp_path), listen_s=0.2)
    found = diagnose(case, MADE + timedelta(days=90, hours=23))
    fresh = check_out(found)
    assert violations(json.loads(fresh.model_dump_json()), json.loads(schema_text("check"))) == []
    assert fresh.calibration is not None
    assert fresh.calibration.model_dump() == {
        "file": str(calibration_path(rig_path)),
        "made": "2026-05-04T12:30:00Z",
        "age_days": 90,
        "coverage": 0.999,
        "position_mm": 0.2,
        "direction_deg": 1.0,
        "devices_match": True,
        "touch": None,
    }
    assert judge_calibration(case, found.readings)[1] == []

    old = replace(found.readings, now=MADE + timedelta(days=91))
    assert [item.cause for item in judge_calibration(case, old)[1]] == [Cause.CALIBRATION_OLD]

    silent = replace(found.readings, arrays=found.readings.arrays[:1])
    unknown = calibration_out(case, silent)
    assert unknown is not None
    assert unknown.devices_match is None

    described = found.readings.arrays[0].description
    assert described is not None
    stranger = replace(found.readings.arrays[0], description=replace(described, unique_id=bytes(16)))
    other = replace(found.readings, arrays=[stranger])
    assert [item.cause for item in judge_calibration(case, other)[1]] == [Cause.OTHER_DEVICES]
    wrong = calibration_out(case, other)
    assert wrong is not None
    assert wrong.devices_match is False

    bare = [item.model_copy(update={"bounds": None}) for item in file.fingers[:1]]
    partly = file.model_copy(update={"fingers": [*bare, *file.fingers[1:]]})
    partly_known = replace(case, on_bench=RigOnBench(on_bench.rig, shipped, partly, rig_path))
    (missing_bounds,) = judge_calibration(partly_known, found.readings)[1]
    assert (missing_bounds.cause, "of f1" in missing_bounds.saw) == (Cause.BOUNDS_MISSING, True)
    loose = calibration_out(partly_known, found.readings)
    assert loose is not None
    assert loose.position_mm is None

    for known, line in (
        (None, "calibration  none\n"),
        (
            calibration_out(case, old),
            "2026-05-04, 91 days old, 99.9 % of contacts within ±0.2 mm and ±1°, of these devices",
        ),
        (wrong, "of other devices\n"),
        (loose, "without bounds on contacts"),
    ):
        text = StringIO()
        show_check(fresh.model_copy(update={"calibration": known}), Console(file=text, width=200))
        assert line in text.getvalue()


# ----------------------------------------------------------------------------------------------------
# Sessions on a calibrated rig: one that has changed a little is noticed, one that has not is not.

RIG = load_rig(firm_rig())
SIX = outlines(SHIPPED_OBJECTS)
CATALOGUE = Catalogue(SIX)
SEEDS = range(4)
BOUND_MM, ERROR_MM = 0.25, 0.02


@dataclass
class Felt:
    """Touches that are `ERROR_MM` off at most, of a rig on which one finger's base is elsewhere."""

    touches: SimulatedTouches
    off_mm: tuple[float, float]

    def __call__(self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None]) -> list[Touch]:
        del tell
        return [self._declared(touch) for touch in self.touches(grip)]

    def _declared(self, touch: Touch) -> Touch:
        dx, dy = self.off_mm if touch.finger_index == 1 else (0.0, 0.0)
        (x, y), (u, v) = touch.contact.start_mm, touch.contact.end_mm
        contact = replace(
            touch.contact,
            start_mm=(x + dx, y + dy),
            end_mm=(u + dx, v + dy),
            position_bound_mm=BOUND_MM,
            path_bound_mm=BOUND_MM + 0.3,
        )
        return replace(touch, contact=contact, patch=felt_patch() if contact.touched else None)


@pytest.fixture(scope="module")
def file() -> CalibrationFile:
    return truth_calibration(RIG, emulate(RIG, (), 0).bench.fingers)


@pytest.fixture(scope="module")
def rig(file: CalibrationFile) -> RigFile:
    return apply_calibration(RIG, file)


@pytest.fixture(scope="module")
def reach(rig: RigFile) -> Reach:
    return reach_of(rig)


def session(
    rig: RigFile, reach: Reach, seed: int, off_mm: tuple[float, float] = (0.0, 0.0)
) -> Identification:
    """A whole search for a part that the seed draws."""
    rng = np.random.default_rng([seed, 0])
    placed = place_within(SIX[int(rng.integers(len(SIX)))], rng)
    touches = SimulatedTouches(reach, placed, np.random.default_rng([seed, 5]))
    touches.share = ERROR_MM / reach.approaches[0].position_bound_mm
    return search(rig, reach, Felt(touches, off_mm), CATALOGUE, seed=seed)


def test_a_rig_that_is_as_it_was_is_not_said_to_have_changed(
    file: CalibrationFile, rig: RigFile, reach: Reach
) -> None:
    identified = 0
    for seed in SEEDS:
        found = session_agreement(session(rig, reach, seed), rig, file)
        if found is not None:
            identified += 1
            assert not found.drifted, seed
            assert found.rms_mm < 0.03
    assert identified >= 3


def test_a_finger_that_moved_within_its_bound_is_mostly_noticed(
    file: CalibrationFile, rig: RigFile, reach: Reach
) -> None:
    noticed = identified = 0
    for seed in SEEDS:
        result = session(rig, reach, seed, (0.13, 0.075))
        found = session_agreement(result, rig, file)
        if result.outcome is IdentificationVerdict.IDENTIFIED:
            assert found is not None
            identified += 1
            noticed += found.drifted
    assert identified >= 3
    assert noticed >= 0.6 * identified, (noticed, identified)


def test_what_is_said_of_a_session(file: CalibrationFile, rig: RigFile, reach: Reach) -> None:
    result = session(rig, reach, 0)
    used = calibration_used(result, rig, file, MADE + timedelta(days=12, hours=3))
    assert (used.made, used.age_days, used.drifted) == ("2026-05-04T12:30:00Z", 12, False)
    assert calibration_used(result, rig, file, MADE - timedelta(days=1)).age_days == 0
    assert session_agreement(result, rig, None) is None
    bare = file.model_copy(update={"residuals": None})
    assert calibration_used(result, rig, bare, MADE).drifted is None
    assert session_agreement(replace(result, recognition=None), rig, file) is None


def test_touches_that_do_not_count_are_left_out(file: CalibrationFile, rig: RigFile, reach: Reach) -> None:
    """Which way a tip is dented by two edges at once is not known; before a shift, the part lay elsewhere."""
    results = (session(rig, reach, seed) for seed in range(30))
    result = next(item for item in results if len(item.grips) >= 3 and item.touches >= 7)
    wide = felt_patch(flags=frozenset({PatchFlag.WIDE}))
    first = [replace(touch, patch=touch.patch and wide) for touch in result.grips[0]]
    others = replace(result, grips=(tuple(first), *result.grips[1:]))
    later = replace(result, moved_before=(2,))
    counts = []
    for item in (result, others, later):
        found = session_agreement(item, rig, file)
        assert found is not None
        counts.append(len(found.residual_mm))
    touched = sum(touch.patch is not None for touch in result.grips[0])
    assert counts == [counts[0], counts[0] - touched, counts[0] - touched]


def test_the_age_counts_from_the_start_of_the_session(here: Here) -> None:
    """So that a replay, whenever it is made, says the same."""
    path = quick_rig(Path("rig.toml"), max_grips=1)
    made = datetime.now(UTC).replace(microsecond=0) - timedelta(days=40)
    file = bench_calibration(load_rig(path), 3).model_copy(update={"made": made})
    calibration_path(path).write_text(calibration_toml(file))
    done = here("identify", "--rig", path, "--seed", 3, "--json")
    assert violations(done.json, json.loads(schema_text("identification"))) == []
    used = done.json["calibration"]
    assert (used["age_days"], used["made"]) == (40, made.isoformat().replace("+00:00", "Z"))
    folder = Path(done.json["session"])
    again = here("replay", folder)
    assert (again.code, again.err) == (0, "")

    log = folder / "session.jsonl.zst"
    first, *rest = log_lines(log)
    header = json.loads(first) | {"started": "some day"}
    write_log(log, [json.dumps(header) + "\n", *rest])
    assert '"started" must be a date and time in UTC' in here("replay", folder).err


def test_what_a_stage_puts_contacts_off_by_is_no_change_of_the_rig(
    file: CalibrationFile, rig: RigFile, reach: Reach
) -> None:
    """Every other grip at another angle, its contacts turned by as much as the rig file allows of a stage."""
    result, off_rad = session(rig, reach, 0), math.radians(0.3)
    stage = StageConfig(**STAGE | {"bound_deg": 0.3})
    c, s = math.cos(off_rad), math.sin(off_rad)

    def turned(touch: Touch) -> Touch:
        x, y = np.array(touch.contact.end_mm) - stage.centre_mm
        end = (stage.centre_mm[0] + c * x - s * y, stage.centre_mm[1] + s * x + c * y)
        return replace(touch, contact=replace(touch.contact, end_mm=end), stage_rad=0.3)

    grips = [[turned(item) if k % 2 else item for item in grip] for k, grip in enumerate(result.grips)]
    again = replace(result, grips=grips)
    without = session_agreement(again, rig, file)
    staged = session_agreement(again, rig.model_copy(update={"stage": stage}), file)
    assert without is not None
    assert without.drifted
    assert staged is not None
    assert not staged.drifted
