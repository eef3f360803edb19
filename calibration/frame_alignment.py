"""Frame alignment: a fit's fingers in the hand frame, with their bounds and residuals.

The bound on a finger's contacts is a sum of parts, so that it can be read and argued with: what the fit
leaves open, what touches differ by, encoder steps, the aim's play, what stopping adds (docs/calibration.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, ndtri

from palpate.calibration.finger_fit import (
    AIM_PLAY,
    BASE,
    COLUMNS,
    HEADING,
    RADIUS,
    SCALE,
    ZERO,
    FingerModel,
    Fit,
    Touches,
)
from palpate.calibration.finger_model import zero_in_file_mm
from palpate.calibration.gauge_freedom import (
    BasePose,
    RigidMotion,
    align_to_nominal,
    fitted_poses,
    nominal_poses,
)
from palpate.calibration.measurements import TouchMeasurement
from palpate.calibration.prober import SlideApproach
from palpate.calibration.touch_load import touch_loads
from palpate.config import SlideFingerConfig
from palpate.config.calibration_file import Residuals, TouchResidual
from palpate.config.calibration_finger import (
    ActuatorsCalibration,
    AimCalibration,
    ContactBounds,
    DirectionParts,
    PlaceCalibration,
    PositionParts,
    TactileCalibration,
)
from palpate.drivers.finger import TICK_RAD
from palpate.geometry import Bools, Floats

__all__ = [
    "AlignedFit",
    "align_fit",
    "bound_contacts",
    "calibrate_aim",
    "calibrate_place",
    "estimate_array_headings",
    "summarise_residuals",
]


_STEP = 1e-5
_DIRECTIONS = 16
_ALONG = 5
_PLACE = [0, 1, HEADING, RADIUS, ZERO]


@dataclass(frozen=True, eq=False)
class AlignedFit:
    """Fingers' values (fingers, 7) in the hand frame with their covariance; the way there from the fit's."""

    values: Floats
    covariance: Floats
    frame: RigidMotion

    def of(self, finger: int) -> Floats:
        """Covariance (7, 7) of one finger's values."""
        at = slice(finger * COLUMNS, (finger + 1) * COLUMNS)
        return self.covariance[at, at]


def align_fit(specs: Sequence[SlideFingerConfig], fit: Fit) -> AlignedFit:
    """Move a fit's fingers into the hand frame.

    Where the rig stands, which cannot be known, goes out of the covariance.
    """
    nominal = nominal_poses(specs)
    flat = fit.values.ravel()
    slopes = np.empty((len(flat), len(flat)))
    for k in range(len(flat)):
        step = np.zeros(len(flat))
        step[k] = _STEP
        slopes[:, k] = (_moved(nominal, flat + step)[0] - _moved(nominal, flat - step)[0]) / (2 * _STEP)
    values, frame = _moved(nominal, flat)
    own = fit.covariance[: len(flat), : len(flat)]
    return AlignedFit(values.reshape(fit.values.shape), slopes @ own @ slopes.T, frame)


def _moved(nominal: Sequence[BasePose], flat: Floats) -> tuple[Floats, RigidMotion]:
    values = flat.reshape(-1, COLUMNS).copy()
    places = fitted_poses(values)
    frame = align_to_nominal(nominal, places)
    for row, place in zip(values, places, strict=True):
        there = frame.place(place)
        row[BASE], row[HEADING] = there.base_mm, there.heading_rad
    return values.ravel(), frame


def estimate_array_headings(
    touched: Sequence[TouchMeasurement],
    touches: Touches,
    models: Sequence[FingerModel],
    specs: Sequence[SlideFingerConfig],
    fit: Fit,
) -> list[tuple[float, float]]:
    """Where each finger's array looks from the direction of travel, by normals of touches.

    Friction carries what is felt towards the way: half of what it may is taken back, and the rest counts as
    far as touches on the left and on the right do not make up for it.
    """
    found, loads = [], touch_loads(touched, specs)
    felt = np.array([item.angle_rad for item in touched]) + loads.side * loads.sheared_rad
    unsure = loads.side * loads.sheared_sigma_rad
    for index, model in enumerate(models):
        own = np.flatnonzero((touches.finger == index) & ~fit.outlier)
        aim = (touches.aim_rad[own] - model.aim_zero_rad) / model.gear_ratio
        travel = fit.values[index, HEADING] + aim - touches.way[own] * fit.values[index, AIM_PLAY]
        towards = np.arctan2(-fit.normal[own, 1], -fit.normal[own, 0])
        off = np.angle(np.exp(1j * (towards - travel - felt[own])))
        middle = float(np.median(off))
        spread = 1.4826 * float(np.median(np.abs(off - middle)))
        scatter = 1.2533 * spread / math.sqrt(max(len(own), 1))
        found.append((middle, math.hypot(scatter, float(unsure[own].sum()) / max(len(own), 1))))
    return found


def calibrate_place(
    model: FingerModel, hand: AlignedFit, index: int, heading: tuple[float, float]
) -> PlaceCalibration:
    """A finger's place; `heading`: of its array, with its deviation (rad)."""
    values, covariance = hand.values[index], hand.of(index)
    sigma = np.sqrt(np.diag(covariance))
    per_rad = model.mm_per_rad * (1 + float(values[SCALE]))
    return PlaceCalibration(
        base_mm=(float(values[0]), float(values[1])),
        base_sigma_mm=(float(sigma[0]), float(sigma[1])),
        heading_deg=math.degrees(values[HEADING]),
        heading_sigma_deg=math.degrees(sigma[HEADING]),
        tip_radius_mm=float(values[RADIUS]),
        tip_radius_sigma_mm=float(sigma[RADIUS]),
        array_heading_deg=math.degrees(heading[0]),
        array_heading_sigma_deg=math.degrees(heading[1]),
        zero_mm=zero_in_file_mm(float(values[ZERO]), per_rad),
        mm_per_turn=2 * math.pi * per_rad,
        covariance=covariance[np.ix_(_PLACE, _PLACE)].tolist(),
    )


def calibrate_aim(before: AimCalibration, hand: AlignedFit, index: int) -> AimCalibration:
    """What touches from both sides have shown of an aim's play."""
    play, sigma = hand.values[index, AIM_PLAY], math.sqrt(hand.of(index)[AIM_PLAY, AIM_PLAY])
    return AimCalibration(
        direction_confirmed=before.direction_confirmed,
        backlash_deg=math.degrees(max(float(play), 0.0)),
        backlash_sigma_deg=math.degrees(sigma),
        friction_a=before.friction_a,
    )


def bound_contacts(
    model: FingerModel,
    hand: AlignedFit,
    index: int,
    approaches: Sequence[SlideApproach],
    residuals: Residuals,
    actuators: ActuatorsCalibration,
    tactile: TactileCalibration,
    heading: tuple[float, float],
    touch_speed_mm_s: float,
    tolerance_mm: float,
    coverage: float,
) -> ContactBounds:
    """How far off this finger's contacts may be, with probability `coverage`; parts are added up.

    `tolerance_mm`: how far references may be from what is said of them, which no fit makes smaller.
    """
    sigmas = float(ndtri((1 + coverage) / 2))
    plane = math.sqrt(float(chdtri(2, 1 - coverage)))
    values, covariance = hand.values[index], hand.of(index)
    farthest, fit = _fit_mm(model, values, covariance, [a for a in approaches if a.finger == index])
    aim_play = abs(float(values[AIM_PLAY])) + sigmas * math.sqrt(covariance[AIM_PLAY, AIM_PLAY])
    aim_step = TICK_RAD / 2 / abs(model.gear_ratio)
    scatter = residuals.rms_mm * math.sqrt(residuals.touches / residuals.degrees_of_freedom)
    position = PositionParts(
        fit=plane * fit + tolerance_mm,
        repeatability=sigmas * max(scatter, residuals.held_out_rms_mm),
        quantisation=math.hypot(abs(model.mm_per_rad) * TICK_RAD / 2, farthest * aim_step),
        play=farthest * aim_play,
        # A slide that has run on comes back to where it was to stop; in its play the tip need not follow.
        overshoot=min(2 * actuators.slide.backlash_mm, touch_speed_mm_s * actuators.slide.settle_s),
    )
    turned = math.hypot(math.sqrt(covariance[HEADING, HEADING]), heading[1])
    apart = abs(math.remainder(heading[0] - math.radians(tactile.phase_deg), 2 * math.pi))
    direction = DirectionParts(
        fit=math.degrees(sigmas * turned),
        repeatability=math.degrees(apart),
        quantisation=math.degrees(aim_step),
        play=math.degrees(aim_play),
    )
    return ContactBounds(
        position_mm=_sum(position.model_dump()),
        direction_deg=_sum(direction.model_dump()),
        parts_mm=position,
        normal_parts_deg=direction,
    )


def _sum(parts: dict[str, float]) -> float:
    return math.fsum(parts.values()) * (1 + 1e-9)


def _fit_mm(
    model: FingerModel, values: Floats, covariance: Floats, approaches: Sequence[SlideApproach]
) -> tuple[float, float]:
    """Largest distance from the base (mm), and the largest deviation of a contact that the fit leaves.

    What counts is how far off centre and radius together put a surface, in whatever direction it faces.
    """
    share = np.linspace(0.0, 1.0, _ALONG)
    aim = np.repeat([item.aim_rad for item in approaches], _ALONG)
    slide = np.concatenate([item.start_rad + share * (item.end_rad - item.start_rad) for item in approaches])
    angle = values[HEADING] + (aim - model.aim_zero_rad) / model.gear_ratio
    distance = values[ZERO] + model.mm_per_rad * (1 + values[SCALE]) * slide
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    across = np.column_stack([-along[:, 1], along[:, 0]])
    faces = np.arange(_DIRECTIONS) * 2 * math.pi / _DIRECTIONS
    normal = np.column_stack([np.cos(faces), np.sin(faces)])
    rows = np.zeros((len(aim), _DIRECTIONS, COLUMNS))
    rows[:, :, 0], rows[:, :, 1] = normal[:, 0], normal[:, 1]
    rows[:, :, HEADING] = distance[:, None] * (across @ normal.T)
    rows[:, :, RADIUS] = -1.0
    rows[:, :, ZERO] = along @ normal.T
    rows[:, :, SCALE] = (along @ normal.T) * (model.mm_per_rad * slide)[:, None]
    variance = np.einsum("pdi,ij,pdj->pd", rows, covariance, rows)
    return float(np.abs(distance).max()), math.sqrt(max(float(variance.max()), 0.0))


def summarise_residuals(
    touches: Touches, fit: Fit, without: Fit, held_out: Bools, names: list[str], frame: RigidMotion
) -> Residuals:
    """How well touches agree; `without`: the fit that does not know those `held_out` (n,)."""
    used = ~fit.outlier
    predicted = without.residual_mm[held_out & used]
    own = fit.residual_mm[used]
    seen = []
    for k in range(len(touches.finger)):
        x, y = frame.point_mm((float(fit.centre_mm[k, 0]), float(fit.centre_mm[k, 1])))
        normal = math.atan2(fit.normal[k, 1], fit.normal[k, 0]) + frame.angle_rad
        seen.append(
            TouchResidual(
                finger=names[int(touches.finger[k])],
                placing=int(touches.placing[k]),
                x_mm=x,
                y_mm=y,
                normal_deg=math.degrees(normal),
                residual_mm=float((without if held_out[k] else fit).residual_mm[k]),
                held_out=bool(held_out[k]),
                outlier=bool(fit.outlier[k]),
            )
        )
    return Residuals(
        rms_mm=float(np.sqrt((own**2).mean())),
        largest_mm=float(np.abs(own).max()),
        touches=len(own),
        degrees_of_freedom=fit.freedom,
        chi_square=fit.chi_square,
        outliers=int(fit.outlier.sum()),
        held_out=len(predicted),
        held_out_rms_mm=float(np.sqrt((predicted**2).mean())) if len(predicted) else 0.0,
        held_out_largest_mm=float(np.abs(predicted).max()) if len(predicted) else 0.0,
        touches_seen=seen,
    )
