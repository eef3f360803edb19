"""What a perfect calibration would find of an emulated rig, from its hidden truth; or one that is off."""

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

from palpate.calibration.frame_alignment import BasePose, align_to_nominal
from palpate.config import (
    CalibrationDevice,
    CalibrationFile,
    ContactBounds,
    DirectionParts,
    FingerCalibration,
    PlaceCalibration,
    PositionParts,
    Residuals,
    RigFile,
    TactileCalibration,
    geometry_sha256,
)
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.bench import EmulatedFinger
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.rig.bench import connect, set_up
from palpate.rig.session.calibration_drift import devices_of

MADE = datetime(2026, 5, 4, 12, 30, tzinfo=UTC)

_FARTHEST_MM = 220.0
_SIGMAS, _PLANE = 3.29, 3.72  # that 99.9 % of a normal distribution lie within, along a line and in a plane
_SCATTER_MM, _FIT_MM = 0.003, 0.006
_STIFFNESS_BOUND, _GAIN_BOUND = 0.02, 0.02


def truth_calibration(
    rig: RigFile,
    fingers: Sequence[EmulatedFinger],
    devices: Sequence[CalibrationDevice] = (),
    off_mm: Mapping[str, tuple[float, float]] | None = None,
) -> CalibrationFile:
    """The truth of `fingers`, which `rig` describes, in the hand frame, with bases of some `off_mm`.

    Bounds are as wide as good calibrations make them: 0.2 mm on the shipped bench.
    """
    frame = align_to_nominal(
        [BasePose(spec.base_mm, math.radians(spec.heading_deg)) for spec in rig.fingers],
        [BasePose(finger.truth.base_mm, finger.truth.heading_rad) for finger in fingers],
    )
    found = []
    for spec, finger in zip(rig.fingers, fingers, strict=True):
        truth = finger.truth
        assert isinstance(truth, FingerTruth)
        there = frame.place(BasePose(truth.base_mm, truth.heading_rad))
        dx, dy = (off_mm or {}).get(spec.name, (0.0, 0.0))
        moved = BasePose((there.base_mm[0] + dx, there.base_mm[1] + dy), there.heading_rad)
        found.append(
            FingerCalibration(
                name=spec.name,
                tactile=_tactile(rig, truth, finger),
                place=_place(truth, moved),
                bounds=_bounds(truth),
            )
        )
    return CalibrationFile(
        rig=rig.name,
        rig_sha256="0" * 64,
        geometry_sha256=geometry_sha256(rig),
        made=MADE,
        palpate="0.1.0",
        emulated=True,
        coverage=0.999,
        devices=list(devices),
        fingers=found,
        residuals=Residuals(
            rms_mm=_SCATTER_MM,
            largest_mm=0.04,
            touches=160,
            degrees_of_freedom=140,
            chi_square=140.0,
            outliers=0,
            held_out=0,
            held_out_rms_mm=0.0,
            held_out_largest_mm=0.0,
        ),
    )


def bench_calibration(rig: RigFile, seed: int) -> CalibrationFile:
    """Of the emulated bench of a seed, with its devices."""
    bench = set_up(rig, None, seed)
    assert bench.emulated is not None
    with connect(bench) as hand:
        devices = devices_of(hand)
    return truth_calibration(rig, bench.emulated.bench.fingers, devices)


def _tactile(rig: RigFile, truth: FingerTruth, finger: EmulatedFinger) -> TactileCalibration:
    """What is true of an array that has no taxels that are dead."""
    emulation = rig.emulation
    assert emulation is not None
    assert isinstance(finger.array, EmulatedArray)
    gain = finger.array.taxels.gain
    return TactileCalibration(
        gain=gain.tolist(),
        gain_bound=(0.0 * gain + _GAIN_BOUND).tolist(),
        noise_counts=emulation.noise_counts,
        offset_counts=emulation.offset_counts,
        drift_counts_per_s=emulation.drift_counts_per_s,
        crosstalk=emulation.crosstalk,
        crosstalk_bound=0.004,
        stiffness_n_per_mm=truth.stiffness_n_per_mm,
        stiffness_bound=_STIFFNESS_BOUND,
        least_contact_force_n=0.05,
        phase_deg=math.degrees(truth.array_heading_rad),
        phase_sigma_deg=0.1,
        presses=24,
        residual_share=0.01,
    )


def _place(truth: FingerTruth, place: BasePose) -> PlaceCalibration:
    """Where a finger stands; in a touch the tip is pushed back as far as the slide's play goes."""
    zero = truth.zero_mm - truth.slide_play_mm
    return PlaceCalibration(
        base_mm=place.base_mm,
        base_sigma_mm=(_FIT_MM, _FIT_MM),
        heading_deg=math.degrees(place.heading_rad),
        heading_sigma_deg=0.002,
        tip_radius_mm=truth.tip_radius_mm,
        tip_radius_sigma_mm=_FIT_MM,
        array_heading_deg=math.degrees(truth.array_heading_rad),
        array_heading_sigma_deg=0.1,
        zero_mm=zero - math.pi * truth.mm_per_rad,
        mm_per_turn=2 * math.pi * truth.mm_per_rad,
        covariance=[[_FIT_MM**2 if k == j else 0.0 for k in range(5)] for j in range(5)],
    )


def _bounds(truth: FingerTruth) -> ContactBounds:
    """The sum of what a fit, scatter, steps, the aim's play and stopping leave."""
    position = PositionParts(
        fit=_PLANE * _FIT_MM,
        repeatability=_SIGMAS * _SCATTER_MM,
        quantisation=0.015,
        play=_FARTHEST_MM * truth.aim_play_rad,
        overshoot=0.07,
    )
    direction = DirectionParts(fit=0.4, repeatability=0.1, quantisation=0.01, play=0.02)
    return ContactBounds(
        position_mm=1.0001 * sum(position.model_dump().values()),
        direction_deg=1.0001 * sum(direction.model_dump().values()),
        parts_mm=position,
        normal_parts_deg=direction,
    )
