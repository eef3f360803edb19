"""Alignment of fitted fingers with the hand frame, and their bounds and residuals.

Touches of references in unknown poses determine how fingers stand relative to one another, not where the rig
stands on its table (gauge freedom). So W is defined by the rig file: it is the frame in which bases and
headings fit the file's values best. The bound on a finger's contacts is a sum of parts that can be inspected
one by one: uncertainty of the fit, scatter of touches, encoder steps, the aim's backlash, overshoot
(docs/calibration-method.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, ndtri

from palpate.base.geometry import Bools, Floats
from palpate.calibration.finger_fit import FingerFit, TouchArrays, touch_loads
from palpate.calibration.finger_model import BASE, HEADING, RADIUS, FingerModel, SlowTouch
from palpate.calibration.measurements import ServoPath, TouchMeasurement
from palpate.config import FingerConfig
from palpate.config.calibration_file import Residuals, TouchResidual
from palpate.config.calibration_finger import (
    Actuators,
    ContactBounds,
    DirectionParts,
    FingerPlace,
    PositionParts,
)

HEADING_ARM_MM = 100.0
"""A heading counts like a point so far from its base; with several fingers it hardly matters."""


@dataclass(frozen=True)
class BasePose:
    """Place of a finger: its base (mm) and its heading (rad)."""

    base_mm: tuple[float, float]
    heading_rad: float


@dataclass(frozen=True)
class RigidMotion:
    """A turn about the origin, then a shift: point ↦ R(angle) · point + shift."""

    angle_rad: float
    shift_mm: tuple[float, float]

    def point_mm(self, point: tuple[float, float]) -> tuple[float, float]:
        """A point in the other frame."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        x, y = point
        return (c * x - s * y + self.shift_mm[0], s * x + c * y + self.shift_mm[1])

    def place(self, place: BasePose) -> BasePose:
        """A finger's place in the other frame."""
        return BasePose(self.point_mm(place.base_mm), place.heading_rad + self.angle_rad)


def align_to_nominal(nominal: Sequence[BasePose], found: Sequence[BasePose]) -> RigidMotion:
    """The motion that brings `found` places nearest to `nominal` ones: from any frame to the hand frame.

    Least squares over bases and, as points `HEADING_ARM_MM` away, headings (Horn's closed form in the plane;
    Umeyama 1991). One finger is enough, because it has a heading. ValueError for none.
    """
    if not nominal or len(nominal) != len(found):
        raise ValueError("a hand frame needs as many places found as described, and at least one")
    wanted = np.array([complex(*place.base_mm) for place in nominal])
    given = np.array([complex(*place.base_mm) for place in found])
    turns = np.array([n.heading_rad - f.heading_rad for n, f in zip(nominal, found, strict=True)])
    centred = (given - given.mean()).conj() * (wanted - wanted.mean())
    angle = float(np.angle(centred.sum() + HEADING_ARM_MM**2 * np.exp(1j * turns).sum()))
    shift = wanted.mean() - np.exp(1j * angle) * given.mean()
    return RigidMotion(angle, (float(shift.real), float(shift.imag)))


def nominal_poses(specs: Sequence[FingerConfig]) -> list[BasePose]:
    """Places of fingers by the rig file."""
    return [BasePose(spec.base_mm, math.radians(spec.heading_deg)) for spec in specs]


def poses_of(values: Floats) -> list[BasePose]:
    """Places of fingers by values (fingers, k) of a fit."""
    return [BasePose((x, y), heading) for x, y, heading in values[:, :3].tolist()]


_DIFFERENCE_STEP = 1e-5
_FACE_DIRECTIONS = 16
_SAMPLES_PER_APPROACH = 5


@dataclass(frozen=True, eq=False)
class AlignedFit:
    """Fingers' values (fingers, k) in the hand frame with their covariance; the way there from the fit's."""

    values: Floats
    covariance: Floats
    frame: RigidMotion

    def of(self, finger: int) -> Floats:
        """Covariance (k, k) of one finger's values."""
        columns = self.values.shape[1]
        at = slice(finger * columns, (finger + 1) * columns)
        return self.covariance[at, at]


def align_fit(specs: Sequence[FingerConfig], fit: FingerFit) -> AlignedFit:
    """Move a fit's fingers into the hand frame.

    Where the rig stands, which cannot be known, goes out of the covariance.
    """
    nominal = nominal_poses(specs)
    flat = fit.values.ravel()
    slopes = np.empty((len(flat), len(flat)))
    for k in range(len(flat)):
        step = np.zeros(len(flat))
        step[k] = _DIFFERENCE_STEP
        slopes[:, k] = (
            _align_values(nominal, len(specs), flat + step)[0]
            - _align_values(nominal, len(specs), flat - step)[0]
        ) / (2 * _DIFFERENCE_STEP)
    values, frame = _align_values(nominal, len(specs), flat)
    own = fit.covariance[: len(flat), : len(flat)]
    return AlignedFit(values.reshape(fit.values.shape), slopes @ own @ slopes.T, frame)


def _align_values(nominal: Sequence[BasePose], fingers: int, flat: Floats) -> tuple[Floats, RigidMotion]:
    values = flat.reshape(fingers, -1).copy()
    places = poses_of(values)
    frame = align_to_nominal(nominal, places)
    for row, place in zip(values, places, strict=True):
        there = frame.place(place)
        row[BASE], row[HEADING] = there.base_mm, there.heading_rad
    return values.ravel(), frame


def estimate_array_headings(
    touched: Sequence[TouchMeasurement],
    touches: TouchArrays,
    models: Sequence[FingerModel],
    specs: Sequence[FingerConfig],
    fit: FingerFit,
) -> list[tuple[float, float]]:
    """Estimate each array's heading, from where its finger faces, by normals of touches.

    Friction carries what is felt towards the way: half of what it may is taken back, and the rest counts as
    far as touches on the left and on the right do not make up for it.
    """
    found, loads = [], touch_loads(touched, specs)
    felt = np.array([item.angle_rad for item in touched]) + loads.side * loads.sheared_rad
    unsure = loads.side * loads.sheared_sigma_rad
    for index, model in enumerate(models):
        own = np.flatnonzero((touches.finger == index) & ~fit.outlier)
        values = np.tile(fit.values[index], (len(own), 1))
        facing = model.facing_rad(values, touches.servos_rad[own], touches.ways[own])
        towards = np.arctan2(-fit.normal[own, 1], -fit.normal[own, 0])
        off = np.angle(np.exp(1j * (towards - facing - felt[own])))
        middle = float(np.median(off))
        spread = 1.4826 * float(np.median(np.abs(off - middle)))
        scatter = 1.2533 * spread / math.sqrt(max(len(own), 1))
        found.append((middle, math.hypot(scatter, float(unsure[own].sum()) / max(len(own), 1))))
    return found


def calibrate_place(
    model: FingerModel, hand: AlignedFit, index: int, heading: tuple[float, float]
) -> FingerPlace:
    """A finger's place; `heading`: of its array, with its deviation (rad)."""
    values, covariance = hand.values[index], hand.of(index)
    return model.describe_place(values, covariance, heading)


def calibrate_plays(model: FingerModel, before: Actuators, hand: AlignedFit, index: int) -> Actuators:
    """Calibrate the plays of an aim, or of an arm's joints, by touches from both sides."""
    return model.fit_plays(before, hand.values[index], np.sqrt(np.diag(hand.of(index))))


@dataclass(frozen=True)
class TouchErrors:
    """Errors of all fingers' touches, and the probability with which bounds hold.

    `tolerance_mm`: how far references may be from what is said of them, which no fit makes smaller.
    """

    residuals: Residuals
    tolerance_mm: float
    coverage: float


def bound_contacts(
    model: FingerModel,
    hand: AlignedFit,
    index: int,
    approaches: Sequence[ServoPath],
    heading: tuple[float, float],
    slow: SlowTouch,
    errors: TouchErrors,
) -> ContactBounds:
    """Bounds of this finger's contacts; parts are added up. `heading`: of its array, with its deviation."""
    sigmas = float(ndtri((1 + errors.coverage) / 2))
    plane = math.sqrt(float(chdtri(2, 1 - errors.coverage)))
    residuals = errors.residuals
    servos = np.concatenate(
        [
            a.servos_at(np.linspace(0.0, a.length_mm, _SAMPLES_PER_APPROACH))
            for a in approaches
            if a.finger == index
        ]
    )
    values, covariance = hand.values[index], hand.of(index)
    rows = np.tile(values, (len(servos), 1))
    levers = np.linalg.norm(model.travel_per_turn(rows, servos), axis=2).max(axis=0)
    parts = model.joint_bounds(values, covariance, levers, sigmas, slow)
    scatter = residuals.rms_mm * math.sqrt(residuals.touches / residuals.degrees_of_freedom)
    position = PositionParts(
        fit=plane * _fit_mm(model, rows, covariance, servos) + errors.tolerance_mm,
        repeatability=sigmas * max(scatter, residuals.held_out_rms_mm),
        quantisation=parts.quantisation_mm,
        play=parts.play_mm,
        overshoot=parts.overshoot_mm,
    )
    turned = math.hypot(_facing_sigma_rad(model, rows, covariance, servos), heading[1])
    apart = abs(math.remainder(heading[0] - math.radians(slow.phase_deg), 2 * math.pi))
    direction = DirectionParts(
        fit=math.degrees(sigmas * turned),
        repeatability=math.degrees(apart),
        quantisation=math.degrees(parts.quantisation_rad),
        play=math.degrees(parts.play_rad),
    )
    return ContactBounds(
        position_mm=_sum(position.model_dump()),
        direction_deg=_sum(direction.model_dump()),
        parts_mm=position,
        normal_parts_deg=direction,
    )


def _sum(parts: dict[str, float]) -> float:
    return math.fsum(parts.values()) * (1 + 1e-9)


def _facing_sigma_rad(model: FingerModel, values: Floats, covariance: Floats, servos_rad: Floats) -> float:
    """The largest deviation of where a finger faces that the fit leaves; it is linear in all values."""
    still = np.zeros_like(servos_rad)
    here = model.facing_rad(values, servos_rad, still)
    steps = np.eye(values.shape[1])
    rows = np.stack([model.facing_rad(values + step, servos_rad, still) - here for step in steps], axis=1)
    variance = np.einsum("pi,ij,pj->p", rows, covariance, rows)
    return math.sqrt(max(float(variance.max()), 0.0))


def _fit_mm(model: FingerModel, values: Floats, covariance: Floats, servos_rad: Floats) -> float:
    """The largest deviation of a contact that the fit leaves, with servos at (n, 2).

    What counts is how far off centre and radius together put a surface, in whatever direction it faces.
    """
    faces = np.arange(_FACE_DIRECTIONS) * 2 * math.pi / _FACE_DIRECTIONS
    normal = np.column_stack([np.cos(faces), np.sin(faces)])
    slopes = model.slopes(values, servos_rad, np.zeros_like(servos_rad))
    rows = np.einsum("dx,pxk->pdk", normal, slopes)
    rows[:, :, RADIUS] = -1.0
    variance = np.einsum("pdi,ij,pdj->pd", rows, covariance, rows)
    return math.sqrt(max(float(variance.max()), 0.0))


def summarise_residuals(
    touches: TouchArrays,
    fit: FingerFit,
    without: FingerFit,
    held_out: Bools,
    names: list[str],
    frame: RigidMotion,
) -> Residuals:
    """Summarise how well touches agree; `without`: the fit that does not know those `held_out` (n,)."""
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
