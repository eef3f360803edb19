"""Calibration of arms from the first step to the file, measured by the simulated prober."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from repository import EXAMPLES
from simulated_prober import SimulatedRig

from palpate.base.errors import InputError
from palpate.calibration.drift_test import contact_uncertainties
from palpate.calibration.frame_alignment import RigidMotion, align_to_nominal, nominal_poses
from palpate.calibration.measurements import RunRecord
from palpate.config import (
    ArmFingerConfig,
    CalibrationFile,
    RigFile,
    apply_calibration,
    check_calibration,
    geometry_sha256,
    load_calibration,
    load_rig,
)
from palpate.config.calibration_file import load_references
from palpate.config.calibration_finger import ArmActuatorsCalibration, ArmPlaceCalibration
from palpate.config.writers import calibration_toml
from palpate.drivers.emulators.mechanics import ArmTruth
from palpate.rig.commissioning.calibration_run import STEPS, CalibrationJob, build_references, calibrate
from palpate.rig.commissioning.hand_prober import joint_sides
from palpate.rig.conversion import arm_kinematics
from palpate.rig.diagnostics.calibration_check import retouch
from palpate.rig.emulated.ground_truth import built_pose
from palpate.views.report.calibration_numbers import finger_tables

ARMS = load_rig(EXAMPLES / "fresh-arms.toml")
LOW = EXAMPLES.parent / "config" / "references" / "low.toml"
SEED = 4


@dataclass(frozen=True)
class Whole:
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


class Unkept:
    """Keeps no record."""

    def load(self) -> RunRecord | None:
        return None

    def save(self, record: RunRecord) -> None:
        del record


@pytest.fixture(scope="module")
def whole() -> Whole:
    rig = ARMS.model_copy(update={"fingers": ARMS.fingers[:2]})
    world = SimulatedRig(rig, SEED)
    made = datetime(2026, 5, 4, tzinfo=UTC)
    job = CalibrationJob(rig, "0" * 64, load_references(LOW), STEPS, 0.999, made, None)
    return Whole(world, rig, calibrate(job, world.connect, Unkept(), lambda _: None))


pytestmark = pytest.mark.slow


def test_arms_are_found_within_what_is_said(whole: Whole) -> None:
    for (spec, truth), found in zip(whole.arms, whole.file.fingers, strict=True):
        place, tactile = found.place, found.tactile
        assert isinstance(place, ArmPlaceCalibration)
        assert isinstance(found.actuators, ArmActuatorsCalibration)
        assert tactile is not None
        there = whole.frame.place(built_pose(spec, truth))
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


def test_the_bounds_hold_for_where_tips_are(whole: Whole) -> None:
    """All over the joints' ranges, with either flank of both plays."""
    known = apply_calibration(whole.rig, whole.file)
    for (_, truth), spec in zip(whole.arms, known.fingers, strict=True):
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
                    true = whole.frame.point_mm((truth.base_mm[0] + x, truth.base_mm[1] + y))
                    off = math.dist(true, kinematics.centre_mm(servos))
                    off += abs(spec.tip.radius_mm - truth.tip_radius_mm)
                    assert off <= kinematics.position_bound_mm(servos) < 0.6


def test_the_file_is_read_again_and_belongs_to_its_rig(whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "arms.calibration.toml"
    path.write_text(calibration_toml(whole.file), encoding="utf-8")
    assert "[fingers.actuators.shoulder]" in path.read_text(encoding="utf-8")
    assert load_calibration(path) == whole.file
    check_calibration(whole.file, whole.rig, "c", "r")
    slides = load_rig(EXAMPLES / "fresh-rig.toml")
    fingers = [
        slide.model_copy(update={"name": arm.name})
        for slide, arm in zip(slides.fingers, whole.rig.fingers, strict=False)
    ]
    other = slides.model_copy(update={"name": whole.rig.name, "fingers": fingers})
    taken = whole.file.model_copy(update={"geometry_sha256": geometry_sha256(other)})
    with pytest.raises(InputError, match='finger "a1" has an aim and a slide, and the calibration is an arm'):
        check_calibration(taken, other, "c", "r")


def test_the_report_has_links_and_joints(whole: Whole) -> None:
    titles = [group.title for group in finger_tables(whole.file)]
    assert "Links in that fit, ± standard deviation" in titles
    assert "Joints, ± standard deviation" in titles
    assert "Slides in that fit" not in titles


def test_touches_again_agree(whole: Whole) -> None:
    rig = apply_calibration(whole.rig, whole.file)
    uncertainties = contact_uncertainties(whole.file, at_rest=False)
    assert uncertainties is not None
    disc = build_references(load_references(LOW))[0]
    with whole.world.connect(rig, moving=True) as there:
        assert not retouch(rig, there.prober, disc, uncertainties).agreement.drifted


def test_joints_count_from_where_they_came_if_they_turned_enough() -> None:
    (spec, *_) = ARMS.fingers
    assert isinstance(spec, ArmFingerConfig)
    # 0.02° of play either way and two encoder steps, behind gears of 3.
    least = 3.0 * math.radians(0.04) + 2 * 2 * math.pi / 4096
    assert joint_sides(spec, np.array([[0.0, 0.0], [1.1 * least, -1.1 * least]])) == (1, -1)
    assert joint_sides(spec, np.array([[0.0, 0.0], [0.9 * least, -0.9 * least]])) == (0, 0)
