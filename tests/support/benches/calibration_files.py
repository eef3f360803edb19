"""Calibration files of tests."""

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

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
    load_rig,
)
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.finger import EmulatedFinger
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.rig.bench import connect, set_up
from palpate.rig.session.calibration_drift import devices_of
from support.benches.rigs import firm_rig

# ----------------------------------------------------------------------------------------------------
# Calibration files for tests: of any rig with slides, plain ones and drawn ones.

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


# ----------------------------------------------------------------------------------------------------
# What a perfect calibration would find of an emulated rig, from its hidden truth; or one that is off.

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
    bench = set_up(rig, (), seed)
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


# ----------------------------------------------------------------------------------------------------
# A calibration file made up for tests: three fingers, touches round some placings, arrays with faults.

_BASES = ((0.0, 190.0), (-164.545, -95.0), (164.545, -95.0))
_PLACINGS = ((0.0, 0.0, 20.0), (45.0, 30.0, 15.0), (-50.0, 25.0, 15.0), (5.0, -55.0, 20.0))
_TIP_MM = 5.0


def calibration_example(
    seed: int = 1,
    rows: int = 8,
    cols: int = 20,
    off_mm: float = 0.02,
    names: tuple[str, str, str] = ("f1", "f2", "f3"),
) -> CalibrationFile:
    """A full calibration with touches round some placings, one an outlier, and arrays with faults.

    Residuals have the deviation `off_mm`.
    """
    rng = np.random.default_rng(seed)
    touches = [
        _touch(rng, name, base, number, disc, off_mm)
        for name, base in zip(names, _BASES, strict=True)
        for number, disc in enumerate(_PLACINGS)
        for _ in range(6)
    ]
    touches[7] |= {"residual_mm": 0.31, "outlier": True, "held_out": False}
    devices = [
        CalibrationDevice(
            port=f"mock://f{k}", kind="array", id=f"{k:016x}", model=f"{rows} x {cols}", firmware="1.4"
        )
        for k in range(len(names))
    ]
    gain, bound = rng.uniform(0.82, 1.2, (rows, cols)), np.full((rows, cols), 0.03)
    gain[:, :3], bound[:, :3] = 1.0, 0.2  # never pressed
    unusable = [UnusableTaxel(row=2, col=9, what="dead"), UnusableTaxel(row=rows - 1, col=5, what="hot")]
    array = tactile(rng, rows, cols).model_copy(
        update={"gain": gain.tolist(), "gain_bound": bound.tolist(), "unusable": unusable}
    )
    file = full_calibration(load_rig(firm_rig()), seed, devices)
    fingers = [
        finger.model_copy(update={"name": name, "tactile": array})
        for name, finger in zip(names, file.fingers, strict=True)
    ]
    residuals = Residuals(
        rms_mm=off_mm,
        largest_mm=3 * off_mm,
        touches=58,
        degrees_of_freedom=31,
        chi_square=29.5,
        outliers=1,
        held_out=13,
        held_out_rms_mm=1.2 * off_mm,
        held_out_largest_mm=2.5 * off_mm,
        touches_seen=[TouchResidual(**touch) for touch in touches],
    )
    return file.model_copy(update={"fingers": fingers, "residuals": residuals})


def _touch(
    rng: np.random.Generator,
    name: str,
    base: tuple[float, float],
    number: int,
    disc: tuple[float, float, float],
    off_mm: float,
) -> dict[str, Any]:
    """A touch of a disc (x, y, radius) from a base's side."""
    x, y, radius = disc
    normal = math.atan2(base[1] - y, base[0] - x) + rng.uniform(-0.9, 0.9)
    reach = radius + _TIP_MM
    return {
        "finger": name,
        "placing": number,
        "x_mm": x + reach * math.cos(normal),
        "y_mm": y + reach * math.sin(normal),
        "normal_deg": math.degrees(normal),
        "residual_mm": float(rng.normal(0, off_mm)),
        "held_out": bool(rng.uniform() < 0.2),
        "outlier": False,
    }
