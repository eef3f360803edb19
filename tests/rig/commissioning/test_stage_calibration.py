"""Calibration of a turning stage: on the emulated bench, and from the first step on a simulated rig."""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from palpate.base.errors import InputError
from palpate.calibration.finger_step import measure_stage
from palpate.calibration.frame_alignment import RigidMotion, align_to_nominal, nominal_poses
from palpate.calibration.measurements import Probe, ReferenceDisc, RunRecord, TouchMeasurement
from palpate.config import (
    CalibrationFile,
    RigFile,
    SlideFingerConfig,
    apply_calibration,
    calibration_toml,
    load_calibration,
    load_rig,
)
from palpate.config.calibration_file import load_references
from palpate.config.calibration_finger import ActuatorsCalibration, RotaryCalibration
from palpate.config.calibration_overlay import frame_offset_bound_mm
from palpate.drivers.emulators.finger import EmulatedFinger
from palpate.drivers.emulators.mechanics import EmulatedStage, FingerTruth
from palpate.drivers.emulators.tip import PartSection
from palpate.rig.bench import emulated_table, environment, set_up
from palpate.rig.commissioning.calibration_run import (
    STEPS,
    CalibrationJob,
    calibrate,
    rig_connector,
    steps_of,
)
from palpate.rig.commissioning.hand_prober import approaches_of
from palpate.rig.emulated.ground_truth import built_pose
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms.slide import slide_kinematics
from palpate.views.report.calibration import summary
from support.benches.calibration_files import bench_calibration, full_calibration
from support.benches.rigs import STAGE, quick_bench
from support.benches.simulated_rig import Kept, SimulatedProber, SimulatedRig
from support.commands.command import Here
from support.commands.repository import EXAMPLES

FRESH = EXAMPLES / "fresh-stage.toml"
SHAPES = EXAMPLES.parent / "src" / "palpate" / "config" / "references" / "standard.toml"
MADE = datetime(2026, 5, 4, tzinfo=UTC)
SEED = 3


def quiet(_: str) -> None:
    """Nothing is said."""


def to_hand(rig: RigFile, fingers: Sequence[EmulatedFinger]) -> RigidMotion:
    """From the truth's frame to the hand frame."""
    built = [built_pose(spec, item.truth) for spec, item in zip(rig.fingers, fingers, strict=True)]
    return align_to_nominal(nominal_poses(rig.fingers), built)


def check_found(file: CalibrationFile, rig: RigFile, truth: EmulatedStage, frame: RigidMotion) -> None:
    """Compare the stage with its truth; what the rig has of it then holds."""
    found = file.stage
    assert found is not None
    off = np.array(found.centre_mm) - frame.point_mm(truth.centre_mm)
    assert off @ np.linalg.solve(np.array(found.covariance), off) < 13.8, "99.9 % of chi-square of 2"
    play_deg = math.degrees(truth.truth.play_rad)
    assert abs(found.backlash_deg - play_deg) < 3.3 * found.backlash_sigma_deg
    known = apply_calibration(rig, file).stage
    assert known is not None
    assert rig.stage is not None
    assert math.hypot(*off) <= known.centre_bound_mm < 0.2
    assert play_deg <= known.backlash_deg < play_deg + 0.05
    assert (known.bound_deg, known.gear_ratio) == (rig.stage.bound_deg, rig.stage.gear_ratio)


def loose_stage(folder: Path) -> RigFile:
    """A small firm rig of two fingers on a stage of which little is known."""
    data = tomllib.loads(quick_bench(folder, fingers=2)[0].read_text(encoding="utf-8"))
    data["stage"] = STAGE | {"backlash_deg": 0.2, "centre_bound_mm": 1.5}
    data["emulation"] |= {"stage_backlash_deg": 0.2, "stage_error_deg": 0.02, "stage_centre_error_mm": 1.5}
    return RigFile.model_validate(data)


def known_but_for_the_stage(rig: RigFile, seed: int) -> CalibrationFile:
    """A calibration of its fingers as good as one can be."""
    exact, plain = bench_calibration(rig, seed), full_calibration(rig)
    fingers = []
    for finger, own in zip(exact.fingers, plain.fingers, strict=True):
        assert isinstance(own.actuators, ActuatorsCalibration)
        aim = RotaryCalibration(
            direction_confirmed=True, backlash_deg=0.01, backlash_sigma_deg=0.01, friction_a=0.02
        )
        fingers.append(finger.model_copy(update={"actuators": own.actuators.model_copy(update={"aim": aim})}))
    return exact.model_copy(update={"fingers": fingers})


@pytest.mark.campaign
@pytest.mark.slow
def test_a_stage_is_calibrated_on_the_emulated_bench(tmp_path: Path) -> None:
    """Its step alone, servos and all, with fingers that were calibrated before."""
    rig = loose_stage(tmp_path)
    bench = set_up(rig, (), SEED)
    before = known_but_for_the_stage(rig, SEED)
    table = emulated_table(bench, SEED)
    assert table is not None
    told: list[str] = []
    job = CalibrationJob(rig, "0" * 64, load_references(SHAPES), ("stage",), 0.999, MADE, before)
    file = calibrate(job, rig_connector(environment(bench), table, quiet), Kept(), told.append)
    assert bench.emulated is not None
    emulated = bench.emulated.bench
    assert emulated.stage is not None
    check_found(file, rig, emulated.stage, to_hand(rig, emulated.fingers))
    assert [item.place for item in file.fingers] == [item.place for item in before.fingers]
    assert "stop 9 of 9: the stage at -30.0°" in told


@dataclass(frozen=True)
class Whole:
    """The fresh rig on its stage, calibrated from the first step, and its hidden truth."""

    world: SimulatedRig
    rig: RigFile
    file: CalibrationFile
    record: RunRecord
    told: list[str]

    def job(self, steps: tuple[str, ...], before: CalibrationFile | None) -> CalibrationJob:
        return CalibrationJob(self.rig, "0" * 64, load_references(SHAPES), steps, 0.999, MADE, before)


@pytest.fixture(scope="module")
def whole() -> Whole:
    rig = load_rig(FRESH)
    world, kept, told = SimulatedRig(rig, SEED), Kept(), list[str]()
    job = CalibrationJob(rig, "0" * 64, load_references(SHAPES), STEPS, 0.999, MADE, None)
    file = calibrate(job, world.connect, kept, told.append)
    return Whole(world, rig, file, RunRecord.model_validate_json(kept.saved[-1]), told)


def truth_of_stage(whole: Whole) -> EmulatedStage:
    bench = set_up(whole.rig, (), SEED)
    assert bench.emulated is not None
    assert bench.emulated.bench.stage is not None
    return bench.emulated.bench.stage


@pytest.mark.slow
def test_a_stage_is_calibrated_with_its_fingers(whole: Whole) -> None:
    check_found(whole.file, whole.rig, truth_of_stage(whole), to_hand(whole.rig, whole.world.fingers))
    assert [line for line in whole.told if line.endswith(":")] == [f"{step}:" for step in STEPS]


@pytest.mark.slow
def test_its_tips_are_where_the_rig_says_at_all_stage_angles(whole: Whole) -> None:
    """Contacts there are within the bounds of finger and stage, on either flank of its play."""
    known, stage = apply_calibration(whole.rig, whole.file), truth_of_stage(whole)
    frame = to_hand(whole.rig, whole.world.fingers)
    assert whole.rig.stage is not None
    for spec, item in zip(known.fingers, whole.world.fingers, strict=True):
        assert isinstance(spec, SlideFingerConfig)
        truth, kinematics = item.truth, slide_kinematics(spec)
        assert isinstance(truth, FingerTruth)
        for angle in np.radians([-30.0, -10.0, 0.0, 20.0, 30.0]).tolist():
            turn = Stage.of(known).planned_turn(angle)
            shaft = math.radians(whole.rig.stage.zero_deg) - math.pi + 5.0 * angle
            for flank in (-1.0, 1.0):
                ring = (shaft - stage.truth.zero_rad) / 5.0 - flank * stage.truth.play_rad
                for servos in ((-2.0, 3.0), (1.5, 6.0)):
                    facing = truth.heading_rad + (servos[0] - truth.aim_zero_rad) / truth.gear_ratio
                    far = truth.zero_mm + truth.mm_per_rad * servos[1] - truth.slide_play_mm
                    x, y = truth.base_mm
                    tip = complex(x + far * math.cos(facing), y + far * math.sin(facing))
                    axis = complex(*stage.centre_mm)
                    tip = axis + (tip - axis) * complex(math.cos(ring), math.sin(ring))
                    found = kinematics.centre_mm(servos)
                    off = math.dist(frame.point_mm((tip.real, tip.imag)), turn.point_mm(found))
                    bound = kinematics.position_bound_mm(servos) + turn.position_bound_mm(found)
                    assert off <= bound < 0.6


@pytest.mark.slow
def test_the_file_is_read_again_and_the_report_shows_the_stage(whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "fresh-stage.calibration.toml"
    path.write_text(calibration_toml(whole.file), encoding="utf-8")
    assert "[stage]" in path.read_text(encoding="utf-8")
    assert load_calibration(path) == whole.file
    rows = dict(summary(whole.file))
    assert "Play of the stage, either way" in rows
    assert "stops" in rows["Touches at stage angles"]


@pytest.mark.slow
def test_the_step_alone_finds_the_same(whole: Whole) -> None:
    """By the fingers as the file has them, with their errors each for itself."""
    file = calibrate(whole.job(("stage",), whole.file), whole.world.connect, Kept(), quiet)
    check_found(file, whole.rig, truth_of_stage(whole), to_hand(whole.rig, whole.world.fingers))
    assert file.fingers == whole.file.fingers


@pytest.mark.slow
def test_a_stage_keeps_its_numbers_until_its_fingers_are_placed_anew(whole: Whole) -> None:
    others = whole.record.model_copy(update={"steps": ["fingers"], "stage": None})
    file = calibrate(whole.job(("fingers",), whole.file), whole.world.connect, Kept(others), quiet)
    assert file.stage is None, "the hand frame may be another now"
    rig = apply_calibration(whole.rig, file)
    assert rig.stage is not None
    assert whole.rig.stage is not None
    offset_mm = frame_offset_bound_mm(whole.rig, whole.rig.stage.centre_mm)
    assert rig.stage.centre_bound_mm == whole.rig.stage.centre_bound_mm + offset_mm
    actuators = whole.record.model_copy(update={"steps": ["actuators"], "stage": None, "touched": []})
    file = calibrate(whole.job(("actuators",), whole.file), whole.world.connect, Kept(actuators), quiet)
    assert file.stage == whole.file.stage


class Sliding(SimulatedProber):
    """Fingers push the disc by a tenth of a millimetre somewhere on the way."""

    touches = 0

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        self.touches += 1
        outline = self._world.outline
        if self.touches == 8 and outline is not None:
            start, end = outline.start + np.full(2, 0.1), outline.end + np.full(2, 0.1)
            self._world.outline = PartSection(start, end, outline.top_mm)
        return super().touch(grip, placing)

    @property
    def turned(self) -> "Sliding":
        return Sliding(self._world, self._rig, turned=True)


@pytest.mark.slow
def test_a_disc_that_is_pushed_is_noticed_and_nothing_is_kept(whole: Whole) -> None:
    known = apply_calibration(whole.rig, whole.file)
    touched = measure_stage(Sliding(whole.world, known), known, ReferenceDisc("disc", 25.0), tell=quiet)
    kept = Kept(whole.record.model_copy(update={"steps": ["stage"], "stage": touched, "touched": []}))
    with pytest.raises(InputError, match=r"the disc has moved by about 0\.1\d mm while the stage turned"):
        calibrate(whole.job(("stage",), whole.file), whole.world.connect, kept, quiet)


def test_a_rig_without_a_stage_has_no_such_step(tmp_path: Path, here: Here) -> None:
    plain = load_rig(EXAMPLES / "fresh-rig.toml")
    assert steps_of(plain, STEPS) == ["actuators", "tactile", "fingers"]
    assert steps_of(load_rig(FRESH), STEPS) == list(STEPS)
    path = tmp_path / "rig.toml"
    path.write_bytes((EXAMPLES / "fresh-rig.toml").read_bytes())
    ended = here("calibrate", "--rig", path, "stage")
    assert ended.code == 2
    assert 'rig "fresh" has no turning stage to calibrate' in ended.err


def test_a_dry_run_tells_of_the_stage(tmp_path: Path, here: Here) -> None:
    path = tmp_path / "rig.toml"
    path.write_bytes(FRESH.read_bytes())
    ended = here("calibrate", "--rig", path, "--dry-run")
    assert ended.code == 0
    assert "the disc beside the stage's axis" in ended.err


def test_a_stage_needs_fingers_whose_places_are_known() -> None:
    rig = load_rig(FRESH)
    job = CalibrationJob(rig, "0" * 64, load_references(SHAPES), ("stage",), 0.999, MADE, None)
    with pytest.raises(InputError, match="the stage is measured with fingers whose places are known"):
        calibrate(job, SimulatedRig(rig, SEED).connect, Kept(), quiet)


def test_paths_at_several_angles_leave_out_aims_that_wait() -> None:
    paths = approaches_of(load_rig(FRESH), turned=True)
    angles = np.unique([item.stage_rad for item in paths])
    assert len(angles) >= 5
    assert np.degrees([angles[0], angles[-1]]).tolist() == pytest.approx([-30.0, 30.0])
    # At aim 0 servos stand at zero_deg, half a turn before the angles that they count from.
    assert min(abs(float(item.servos_rad[0, 0])) for item in paths) > math.radians(1.0)
