"""Calibration files for tests: of any rig with slides, plain ones and drawn ones."""

import math
from datetime import UTC, datetime

import numpy as np

from palpate.calibration.frame_alignment import BasePose, align_to_nominal
from palpate.config import (
    ActuatorsCalibration,
    CalibrationDevice,
    CalibrationFile,
    CalibrationReference,
    ContactBounds,
    DirectionParts,
    FingerCalibration,
    Overshoot,
    PlaceCalibration,
    PositionParts,
    Residuals,
    RigFile,
    RotaryCalibration,
    SlideCalibration,
    SlideFingerConfig,
    TactileCalibration,
    TouchResidual,
    UnusableTaxel,
    geometry_sha256,
)
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.rig.bench import connect, set_up
from palpate.rig.emulated.devices import emulate
from palpate.rig.session.calibration_drift import devices_of

MADE = datetime(2026, 5, 4, 12, 30, tzinfo=UTC)


def empty_calibration(rig: RigFile, devices: list[CalibrationDevice] | None = None) -> CalibrationFile:
    """One that says nothing of any finger."""
    return CalibrationFile(
        rig=rig.name,
        rig_sha256="0" * 64,
        geometry_sha256=geometry_sha256(rig),
        made=MADE,
        palpate="0.1.0",
        emulated=rig.emulated,
        coverage=0.999,
        devices=devices or [],
        fingers=[FingerCalibration(name=finger.name) for finger in rig.fingers],
    )


def full_calibration(
    rig: RigFile, seed: int = 0, devices: list[CalibrationDevice] | None = None
) -> CalibrationFile:
    """One that says something of everything, a little off what the rig file says."""
    rng = np.random.default_rng(seed)
    fingers = [_finger(finger, rng) for finger in rig.fingers if isinstance(finger, SlideFingerConfig)]
    return empty_calibration(rig, devices).model_copy(
        update={
            "references": [CalibrationReference(name="disc", sha256="a" * 64)],
            "fingers": fingers,
            "residuals": _residuals(rig.fingers[0].name, rng),
        }
    )


def tactile(rng: np.random.Generator, rows: int = 8, cols: int = 20) -> TactileCalibration:
    return TactileCalibration(
        gain=rng.uniform(0.7, 1.3, (rows, cols)).tolist(),
        gain_bound=rng.uniform(0.01, 0.04, (rows, cols)).tolist(),
        unusable=[UnusableTaxel(row=1, col=cols // 2, what="dead")],
        noise_counts=float(rng.uniform(1.5, 2.5)),
        offset_counts=20.3,
        drift_counts_per_s=float(rng.uniform(0.1, 0.3)),
        crosstalk=0.0583,
        crosstalk_bound=0.004,
        stiffness_n_per_mm=float(rng.uniform(2.5, 3.5)),
        stiffness_bound=0.03,
        least_contact_force_n=0.05,
        saturates_n=None,
        phase_deg=float(rng.uniform(-2, 2)),
        phase_sigma_deg=0.2,
        presses=11,
        residual_share=0.012,
    )


def _finger(finger: SlideFingerConfig, rng: np.random.Generator) -> FingerCalibration:
    x, y = finger.base_mm
    slide = SlideCalibration(
        direction_confirmed=True,
        mm_per_turn=finger.slide.mm_per_turn * 1.0002,
        mm_per_turn_sigma=0.004,
        zero_mm=finger.slide.zero_mm + 0.03,
        zero_sigma_mm=0.01,
        homed=True,
        backlash_mm=0.06,
        backlash_sigma_mm=0.004,
        touch_zero_mm=finger.slide.zero_mm + 0.5 * finger.slide.mm_per_turn,
        touch_covariance=[[1e-4, 2e-7], [2e-7, 1.6e-9]],
        friction_a=0.03,
        latency_s=0.012,
        latency_bound_s=0.02,
        settle_s=0.015,
        overshoots=[Overshoot(speed_mm_s=20.0, largest_mm=0.31, bound_mm=0.4)],
    )
    aim = RotaryCalibration(
        direction_confirmed=True, backlash_deg=0.015, backlash_sigma_deg=0.002, friction_a=0.02
    )
    return FingerCalibration(
        name=finger.name,
        tactile=tactile(rng),
        actuators=ActuatorsCalibration(slide=slide, aim=aim),
        place=PlaceCalibration(
            base_mm=(x + 0.02, y - 0.01),
            base_sigma_mm=(0.011, 0.012),
            heading_deg=finger.heading_deg + 0.01,
            heading_sigma_deg=0.005,
            tip_radius_mm=finger.tip.radius_mm + 0.01,
            tip_radius_sigma_mm=0.006,
            array_heading_deg=finger.array.heading_deg + 0.1,
            array_heading_sigma_deg=0.1,
            zero_mm=finger.slide.zero_mm + 0.05,
            mm_per_turn=finger.slide.mm_per_turn * 1.0003,
            covariance=np.diag([1.21e-4, 1.44e-4, 7.6e-9, 3.6e-5, 1e-4]).tolist(),
        ),
        bounds=ContactBounds(
            position_mm=0.2,
            direction_deg=1.0,
            parts_mm=PositionParts(
                fit=0.05, repeatability=0.03, quantisation=0.02, play=0.05, overshoot=0.05
            ),
            normal_parts_deg=DirectionParts(fit=0.4, repeatability=0.3, quantisation=0.1, play=0.2),
        ),
    )


def _residuals(finger: str, rng: np.random.Generator) -> Residuals:
    off = rng.normal(0, 0.02, 4)
    return Residuals(
        rms_mm=float(np.sqrt((off**2).mean())),
        largest_mm=float(np.abs(off).max()),
        touches=4,
        degrees_of_freedom=2,
        chi_square=2.2,
        outliers=0,
        held_out=0,
        held_out_rms_mm=0.0,
        held_out_largest_mm=0.0,
        touches_seen=[
            TouchResidual(
                finger=finger,
                placing=0,
                x_mm=float(value),
                y_mm=30.0,
                normal_deg=91.25,
                residual_mm=float(value),
                held_out=False,
                outlier=False,
            )
            for value in off
        ],
    )


def true_calibration(rig: RigFile, seed: int) -> CalibrationFile:
    """Places of an emulated rig's fingers as a perfect calibration would find them, in the hand frame."""
    bench = emulate(rig, None, seed)
    truths = [finger.truth for finger in bench.bench.fingers]
    to_hand = align_to_nominal(
        [BasePose(finger.base_mm, math.radians(finger.heading_deg)) for finger in rig.fingers],
        [BasePose(truth.base_mm, truth.heading_rad) for truth in truths],
    )
    fingers = []
    for template, truth in zip(full_calibration(rig).fingers, truths, strict=True):
        assert isinstance(truth, FingerTruth)
        assert template.place is not None
        assert template.bounds is not None
        found = to_hand.place(BasePose(truth.base_mm, truth.heading_rad))
        place = template.place.model_copy(
            update={
                "base_mm": found.base_mm,
                "heading_deg": math.degrees(found.heading_rad),
                "tip_radius_mm": truth.tip_radius_mm,
                "array_heading_deg": math.degrees(truth.array_heading_rad),
                "zero_mm": truth.zero_mm - math.pi * truth.mm_per_rad,
                "mm_per_turn": 2 * math.pi * truth.mm_per_rad,
            }
        )
        place = PlaceCalibration.model_validate(place.model_dump())
        bounds = template.bounds.model_copy(update={"position_mm": truth.slide_play_mm + 0.05})
        fingers.append(FingerCalibration(name=template.name, place=place, bounds=bounds))
    with connect(set_up(rig, None, seed)) as hand:
        devices = devices_of(hand)
    return empty_calibration(rig, devices).model_copy(update={"fingers": fingers})
