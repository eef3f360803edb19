"""Calibration of slides and of arms."""

import errno
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from palpate.base.errors import InputError, OutputError
from palpate.calibration.consistency_checks import contact_uncertainties
from palpate.calibration.frame_alignment import BasePose, RigidMotion, align_to_nominal, nominal_poses
from palpate.calibration.measurements import Probe, Reference, ReferenceDisc, RunRecord, TouchMeasurement
from palpate.config import (
    ArmFingerConfig,
    CalibrationFile,
    RigFile,
    apply_calibration,
    check_calibration,
    geometry_sha256,
    load_rig,
)
from palpate.config.calibration_file import ReferencesFile, load_calibration, load_references
from palpate.config.calibration_finger import ArmActuatorsCalibration, ArmPlaceCalibration
from palpate.config.loading import shipped_references
from palpate.config.writers import calibration_toml
from palpate.drivers.emulators.mechanics import ArmTruth
from palpate.rig.commissioning.calibration_run import (
    STEPS,
    CalibrationJob,
    ConnectedRig,
    build_references,
    calibrate,
)
from palpate.rig.commissioning.hand_prober import joint_sides
from palpate.rig.diagnostics.calibration_check import retouch
from palpate.rig.emulated.ground_truth import built_pose
from palpate.rig.mechanisms.arm import arm_kinematics
from palpate.views.report.calibration import finger_tables
from support.benches.simulated_rig import Kept, SimulatedProber, SimulatedRig
from support.campaign.sampling import sample
from support.commands.command import missing
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Calibrations from the first step to the file, on a simulated rig with hidden truth.

FRESH = EXAMPLES / "fresh-rig.toml"
MADE = datetime(2026, 11, 22, tzinfo=UTC)


@dataclass(frozen=True)
class Whole:
    """A calibration that was not interrupted."""

    world: SimulatedRig
    rig: RigFile
    file: CalibrationFile
    kept: Kept


def job(
    rig: RigFile, steps: tuple[str, ...] = STEPS, before: CalibrationFile | None = None
) -> CalibrationJob:
    return CalibrationJob(rig, "0" * 64, load_references(shipped_references()), steps, 0.999, MADE, before)


def quiet(_: str) -> None:
    """Nobody is listening."""


@pytest.fixture(scope="module")
def whole() -> Whole:
    return calibrated(load_rig(FRESH))


def calibrated(rig: RigFile) -> Whole:
    world, kept = SimulatedRig(rig, 5), Kept()
    return Whole(world, rig, calibrate(job(rig), world.connect, kept, quiet), kept)


@pytest.fixture(scope="module")
def off_centre() -> Whole:
    """Two of its fingers with encoders that are off by up to 1.2°."""
    rig = load_rig(FRESH)
    assert rig.emulation is not None
    emulation = rig.emulation.model_copy(update={"encoder_error_deg": 1.2})
    return calibrated(rig.model_copy(update={"emulation": emulation, "fingers": rig.fingers[:2]}))


def test_everything_is_found_within_what_is_asked_and_what_is_said(whole: Whole) -> None:
    truths = [whole.world.truth(k) for k in range(3)]
    drawn = [BasePose(spec.base_mm, math.radians(spec.heading_deg)) for spec in whole.rig.fingers]
    frame = align_to_nominal(drawn, [BasePose(truth.base_mm, truth.heading_rad) for truth in truths])
    for truth, emulated, found in zip(truths, whole.world.fingers, whole.file.fingers, strict=True):
        assert found.place is not None
        assert found.tactile is not None
        assert found.actuators is not None
        there = frame.place(BasePose(truth.base_mm, truth.heading_rad))
        assert math.dist(found.place.base_mm, there.base_mm) < 0.1
        assert math.degrees(there.heading_rad) % 360 == pytest.approx(found.place.heading_deg % 360, abs=0.15)
        assert found.place.tip_radius_mm == pytest.approx(truth.tip_radius_mm, abs=0.05)
        assert found.place.array_heading_deg == pytest.approx(math.degrees(truth.array_heading_rad), abs=0.6)
        assert found.actuators.slide.backlash_mm == pytest.approx(truth.slide_play_mm, abs=0.01)
        assert found.actuators.slide.mm_per_turn == pytest.approx(2 * math.pi * truth.mm_per_rad, rel=3e-4)
        gain, bound = np.array(found.tactile.gain), np.array(found.tactile.gain_bound)
        off = np.abs(emulated.array.taxels.gain / gain - 1)
        dead = {(taxel.row, taxel.col) for taxel in found.tactile.unusable}
        assert dead == set(emulated.array.taxels.dead)
        for place in dead:
            off[place] = 0.0
        assert (off <= bound).all()
        assert off[bound < 0.05].max() < 0.05
        assert (bound < 0.05).sum() > 40
        assert (bound < 0.15).sum() > 60


@pytest.mark.parametrize("rig", sample(["whole", "off_centre"], ["whole"]))
def test_the_bounds_hold_for_where_tips_are(rig: str, request: pytest.FixtureRequest) -> None:
    """The rig with its calibration says where tips are, all over the workspace, within its bounds."""
    from palpate.drivers.slide_kinematics import SlideKinematics
    from palpate.rig.mechanisms import kinematics_of

    whole: Whole = request.getfixturevalue(rig)
    known = apply_calibration(whole.rig, whole.file)
    assert [spec.bounds.encoder_deg for spec in known.fingers] == [0.0] * len(known.fingers)
    truths = [whole.world.truth(k) for k in range(len(known.fingers))]
    drawn = [BasePose(spec.base_mm, math.radians(spec.heading_deg)) for spec in whole.rig.fingers]
    frame = align_to_nominal(drawn, [BasePose(truth.base_mm, truth.heading_rad) for truth in truths])
    for spec, truth, emulated in zip(known.fingers, truths, whole.world.fingers, strict=True):
        kinematics = kinematics_of(spec)
        assert isinstance(kinematics, SlideKinematics)
        for aim in np.linspace(-2.5, 2.5, 7):
            for slide in np.linspace(-1.5, 9.5, 7):
                near, far = (s.angle_rad(read) for s, read in zip(emulated.servos, (aim, slide), strict=True))
                angle = truth.heading_rad + (near - truth.aim_zero_rad) / truth.gear_ratio
                distance = truth.zero_mm + truth.mm_per_rad * far - truth.slide_play_mm
                x, y = truth.base_mm
                true = frame.point_mm((x + distance * math.cos(angle), y + distance * math.sin(angle)))
                off = math.dist(true, kinematics.centre_mm((aim, slide)))
                off += abs(spec.tip.radius_mm - truth.tip_radius_mm)
                assert off <= kinematics.position_bound_mm((aim, slide)) < 0.5


def test_the_file_is_the_same_when_it_is_read_again(whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "fresh-rig.calibration.toml"
    path.write_text(calibration_toml(whole.file), encoding="utf-8")
    assert load_calibration(path) == whole.file


def test_every_record_that_was_kept_can_be_taken_up(whole: Whole) -> None:
    """What an interruption after any step or placing leaves is whole; the last ones are carried on."""
    records = [RunRecord.model_validate_json(text) for text in whole.kept.saved]
    assert [len(record.touched) for record in records] == [0, 0, 1, 2, 3, 4, 5, 6]
    assert [record.tactile is None for record in records] == [True, *[False] * 7]
    told: list[str] = []
    kept = Kept(resume=records[-2])
    again = calibrate(job(whole.rig), whole.world.connect, kept, told.append)
    assert missing(told[0], "resuming", "actuators", "tactile", "5 placings") == []
    (placing,) = (line for line in told if line.startswith("placing"))
    assert missing(placing, "6 of 6", "plate", "(-49, 28) mm") == []
    assert again.residuals is not None
    assert whole.file.residuals is not None
    assert again.residuals.touches >= 0.9 * whole.file.residuals.touches
    for old, new in zip(whole.file.fingers, again.fingers, strict=True):
        assert old.place is not None
        assert new.place is not None
        assert math.dist(old.place.base_mm, new.place.base_mm) < 0.05


class Interrupting(SimulatedProber):
    """Somebody presses Ctrl-C before the third touch."""

    touches = 0

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        self.touches += 1
        if self.touches == 3:
            raise KeyboardInterrupt
        return super().touch(grip, placing)


def test_an_interruption_keeps_what_was_done(whole: Whole) -> None:
    kept = Kept(resume=RunRecord.model_validate_json(whole.kept.saved[3]))

    @contextmanager
    def connect(rig: RigFile, *, moving: bool) -> Iterator[ConnectedRig]:
        with whole.world.connect(rig, moving=moving) as there:
            yield replace(there, prober=Interrupting(whole.world, rig))

    with pytest.raises(KeyboardInterrupt):
        calibrate(job(whole.rig), connect, kept, quiet)
    assert kept.saved == []  # the placing under way is done again, the record stays as it was


def test_a_record_that_cannot_be_kept_ends_the_calibration(whole: Whole) -> None:
    class Full(Kept):
        def save(self, record: RunRecord) -> None:
            del record
            raise OSError(errno.ENOSPC, "No space left on device")

    resumed = Full(RunRecord.model_validate_json(whole.kept.saved[3]))
    with pytest.raises(OutputError, match=r"the run record failed: .*No space left on device"):
        calibrate(job(whole.rig), whole.world.connect, resumed, quiet)


def test_a_record_of_other_steps_is_not_taken_up(whole: Whole) -> None:
    kept = Kept(resume=RunRecord.model_validate_json(whole.kept.saved[3]))
    with pytest.raises(InputError, match=r"finish that one, or restart"):
        calibrate(job(whole.rig, ("tactile",)), whole.world.connect, kept, quiet)


def test_fingers_need_actuators_and_arrays(whole: Whole) -> None:
    with pytest.raises(InputError, match="calibrate these first"):
        calibrate(job(whole.rig, ("fingers",)), whole.world.connect, Kept(), quiet)


def test_one_step_leaves_the_others_as_they_were(whole: Whole) -> None:
    file = calibrate(job(whole.rig, ("actuators",), whole.file), whole.world.connect, Kept(), quiet)
    for old, new in zip(whole.file.fingers, file.fingers, strict=True):
        assert (new.place, new.bounds, new.tactile) == (old.place, old.bounds, old.tactile)
        assert new.actuators is not None
        assert new.actuators != old.actuators
    assert file.residuals == whole.file.residuals


def shrunk(by_mm: float) -> Callable[[Reference, int], Reference]:
    def put(reference: Reference, _: int) -> Reference:
        return (
            ReferenceDisc("disc", reference.radius_mm - by_mm)
            if isinstance(reference, ReferenceDisc)
            else reference
        )

    return put


def test_a_disc_of_another_size_is_detected(whole: Whole) -> None:
    """Devices are known from the record; fingers touch a disc that is 0.4 mm too small all round."""
    world = SimulatedRig(whole.rig, 5, shrunk(0.4))
    resume = json.loads(whole.kept.saved[1])
    with pytest.raises(InputError, match=r"the plate seems 0\.4|its tip would have a radius"):
        calibrate(job(whole.rig), world.connect, Kept(resume=RunRecord.model_validate(resume)), quiet)


def test_references_that_are_not_convex_are_refused() -> None:
    rig = load_rig(FRESH)
    shapes = load_references(shipped_references()).model_dump()
    shapes["plate"]["outline_mm"] = [[0.0, 0.0], [40.0, 0.0], [10.0, 10.0], [0.0, 40.0]]
    wrong = CalibrationJob(rig, "0" * 64, ReferencesFile(**shapes), STEPS, 0.999, MADE, None)
    with pytest.raises(InputError, match=r"plate\.outline_mm is not convex"):
        calibrate(wrong, SimulatedRig(rig, 5).connect, Kept(), quiet)


# ----------------------------------------------------------------------------------------------------
# Calibration of arms from the first step to the file, measured by the simulated prober.

ARMS = load_rig(EXAMPLES / "fresh-arms.toml")
LOW = EXAMPLES.parent / "src" / "palpate" / "config" / "references" / "low.toml"
SEED = 4


@dataclass(frozen=True)
class WholeArms:
    """Two arms that have been calibrated, and their hidden truth."""

    world: SimulatedRig
    rig: RigFile
    file: CalibrationFile

    @property
    def arms(self) -> Sequence[tuple[ArmFingerConfig, ArmTruth]]:
        found = []
        for k, spec in enumerate(self.rig.fingers):
            truth = self.world.truth(k)
            assert isinstance(spec, ArmFingerConfig)
            assert isinstance(truth, ArmTruth)
            found.append((spec, truth))
        return found

    @property
    def frame(self) -> RigidMotion:
        """From the truth's frame to the hand frame."""
        return align_to_nominal(
            nominal_poses(self.rig.fingers), [built_pose(spec, truth) for spec, truth in self.arms]
        )


@pytest.fixture(scope="module")
def whole_arms() -> WholeArms:
    rig = ARMS.model_copy(update={"fingers": ARMS.fingers[:2]})
    world = SimulatedRig(rig, SEED)
    made = datetime(2026, 5, 4, tzinfo=UTC)
    job = CalibrationJob(rig, "0" * 64, load_references(LOW), STEPS, 0.999, made, None)
    return WholeArms(world, rig, calibrate(job, world.connect, Kept(), lambda _: None))


@pytest.mark.slow
def test_arms_are_found_within_what_is_said(whole_arms: WholeArms) -> None:
    for (spec, truth), found in zip(whole_arms.arms, whole_arms.file.fingers, strict=True):
        place, tactile = found.place, found.tactile
        assert isinstance(place, ArmPlaceCalibration)
        assert isinstance(found.actuators, ArmActuatorsCalibration)
        assert tactile is not None
        there = whole_arms.frame.place(built_pose(spec, truth))
        zero_rad = math.radians(spec.elbow.zero_deg) - math.pi
        off = np.array(
            [
                place.base_mm[0] - there.base_mm[0],
                place.base_mm[1] - there.base_mm[1],
                math.remainder(math.radians(place.heading_deg) - there.heading_rad, 2 * math.pi),
                place.tip_radius_mm - truth.tip_radius_mm,
                place.upper_mm - truth.upper_mm,
                place.fore_mm - truth.fore_mm,
                math.radians(place.elbow_zero_deg) - (zero_rad - truth.elbow.zero_rad) / 3.0,
            ]
        )
        assert off @ np.linalg.solve(np.array(place.covariance), off) < 24.3, "99.9 % of chi-square of 7"
        assert np.hypot(off[0], off[1]) < 0.2
        assert abs(tactile.stiffness_n_per_mm / truth.stiffness_n_per_mm - 1) < 0.03
        assert abs(place.array_heading_deg - math.degrees(truth.array_heading_rad)) < 0.6
        for joint, built in (
            (found.actuators.shoulder, truth.shoulder),
            (found.actuators.elbow, truth.elbow),
        ):
            off_deg = joint.backlash_deg - math.degrees(built.play_rad)
            assert abs(off_deg) < 4 * joint.backlash_sigma_deg
            assert joint.direction_confirmed


@pytest.mark.slow
def test_the_bounds_hold_for_where_tips_of_arms_are(whole_arms: WholeArms) -> None:
    """All over the joints' ranges, with either flank of both plays."""
    known = apply_calibration(whole_arms.rig, whole_arms.file)
    for (_, truth), spec in zip(whole_arms.arms, known.fingers, strict=True):
        assert isinstance(spec, ArmFingerConfig)
        kinematics = arm_kinematics(spec)
        for shoulder in np.radians(np.linspace(-50, 50, 5)):
            for elbow in np.radians(np.linspace(40, 125, 5)):
                servos = (
                    truth.shoulder.zero_rad + 3.0 * float(shoulder),
                    truth.elbow.zero_rad + 3.0 * float(elbow),
                )
                for flank in (-1.0, 1.0):
                    first = truth.heading_rad + float(shoulder) - flank * truth.shoulder.play_rad
                    second = first + float(elbow) - flank * truth.elbow.play_rad
                    x = truth.upper_mm * math.cos(first) + truth.fore_mm * math.cos(second)
                    y = truth.upper_mm * math.sin(first) + truth.fore_mm * math.sin(second)
                    true = whole_arms.frame.point_mm((truth.base_mm[0] + x, truth.base_mm[1] + y))
                    off = math.dist(true, kinematics.centre_mm(servos))
                    off += abs(spec.tip.radius_mm - truth.tip_radius_mm)
                    assert off <= kinematics.position_bound_mm(servos) < 0.6


@pytest.mark.slow
def test_the_file_is_read_again_and_belongs_to_its_rig(whole_arms: WholeArms, tmp_path: Path) -> None:
    path = tmp_path / "arms.calibration.toml"
    path.write_text(calibration_toml(whole_arms.file), encoding="utf-8")
    assert "[fingers.actuators.shoulder]" in path.read_text(encoding="utf-8")
    assert load_calibration(path) == whole_arms.file
    check_calibration(whole_arms.file, whole_arms.rig, "c", "r")
    slides = load_rig(EXAMPLES / "fresh-rig.toml")
    fingers = [
        slide.model_copy(update={"name": arm.name})
        for slide, arm in zip(slides.fingers, whole_arms.rig.fingers, strict=False)
    ]
    other = slides.model_copy(update={"name": whole_arms.rig.name, "fingers": fingers})
    taken = whole_arms.file.model_copy(update={"geometry_sha256": geometry_sha256(other)})
    with pytest.raises(InputError, match='finger "a1" has an aim and a slide, and the calibration is an arm'):
        check_calibration(taken, other, "c", "r")


@pytest.mark.slow
def test_the_report_has_links_and_joints(whole_arms: WholeArms) -> None:
    titles = [group.title for group in finger_tables(whole_arms.file)]
    assert "Links in that fit, ± standard deviation" in titles
    assert "Joints, ± standard deviation" in titles
    assert "Slides in that fit" not in titles


@pytest.mark.slow
def test_touches_again_agree(whole_arms: WholeArms) -> None:
    rig = apply_calibration(whole_arms.rig, whole_arms.file)
    uncertainties = contact_uncertainties(whole_arms.file, at_rest=False)
    assert uncertainties is not None
    disc = build_references(load_references(LOW))[0]
    with whole_arms.world.connect(rig, moving=True) as there:
        assert not retouch(rig, there.prober, disc, uncertainties).agreement.drifted


@pytest.mark.slow
def test_joints_count_from_where_they_came_if_they_turned_enough() -> None:
    (spec, *_) = ARMS.fingers
    assert isinstance(spec, ArmFingerConfig)
    # 0.02° of play either way and two encoder steps, behind gears of 3.
    least = 3.0 * math.radians(0.04) + 2 * 2 * math.pi / 4096
    assert joint_sides(spec, np.array([[0.0, 0.0], [1.1 * least, -1.1 * least]])) == (1, -1)
    assert joint_sides(spec, np.array([[0.0, 0.0], [0.9 * least, -0.9 * least]])) == (0, 0)
