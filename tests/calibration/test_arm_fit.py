"""Fit of arms, by touches that are worked backwards: from a place on the reference to the servos of an arm.

The arm's inverse kinematics here are closed forms of their own, with plays on the flanks from which joints
came.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from repository import EXAMPLES
from scipy.stats import chi2

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import rotation_matrix
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    fit_fingers,
    predict_residuals,
)
from palpate.calibration.finger_model import (
    ELBOW_PLAY,
    ELBOW_ZERO,
    FORE,
    HEADING,
    RADIUS,
    SHOULDER_PLAY,
    UPPER,
    ArmModel,
    nominal_models,
)
from palpate.calibration.frame_alignment import BasePose, align_fit, align_to_nominal, nominal_poses
from palpate.calibration.reference import ReferenceDisc, ReferencePlate
from palpate.config import load_rig

ARMS = load_rig(EXAMPLES / "fresh-arms.toml")
DISC = ReferenceDisc("disc", 25.0)
PLATE = ReferencePlate("plate", np.array([[-40.0, -40.0], [40.0, -40.0], [40.0, 40.0], [-40.0, 40.0]]))
PLACINGS = [
    ReferencePlacement(DISC, (0.0, 40.0)),
    ReferencePlacement(DISC, (-35.0, -20.0)),
    ReferencePlacement(DISC, (35.0, -20.0)),
    ReferencePlacement(PLATE, (0.0, -38.0)),
    ReferencePlacement(PLATE, (33.0, 19.0)),
    ReferencePlacement(PLATE, (-33.0, 19.0)),
]
SIGMA_MM = 0.02
TOUCHES = 8  # of each finger at each placing


def models() -> list[ArmModel]:
    found = nominal_models(ARMS.fingers)
    arms = [model for model in found if isinstance(model, ArmModel)]
    assert len(arms) == 3
    return arms


@dataclass(frozen=True, eq=False)
class Touched:
    """True values (3, 9), true poses (6, 3), and touches of them."""

    values: Floats
    poses: Floats
    touches: TouchArrays

    def fit(self) -> FingerFit:
        begin = self.poses + np.array([0.4, -0.3, 0.0])
        return fit_fingers(models(), PLACINGS, self.touches, (np.array([m.prior for m in models()]), begin))


def servos_of(model: ArmModel, own: Floats, centre: Floats, ways: Floats) -> Floats:
    """Servo angles (2,) that put the tip's true centre there (law of cosines; elbows bend to the left)."""
    x, y = centre - own[:2]
    bend = math.acos((x * x + y * y - own[UPPER] ** 2 - own[FORE] ** 2) / (2 * own[UPPER] * own[FORE]))
    first = math.atan2(y, x) - math.atan2(own[FORE] * math.sin(bend), own[UPPER] + own[FORE] * math.cos(bend))
    shoulder = math.remainder(first - own[HEADING], 2 * math.pi) + ways[0] * own[SHOULDER_PLAY]
    elbow = bend - own[ELBOW_ZERO] + ways[1] * own[ELBOW_PLAY]
    result: Floats = model.zero_rad + model.gear_ratio * np.array([shoulder, elbow])
    return result


def touched(seed: int) -> Touched:
    """Truth as likely as the priors say, touched on the side that faces each finger."""
    rng, known = np.random.default_rng(seed), models()
    values = np.array([rng.multivariate_normal(m.prior, m.covariance) for m in known])
    values[:, SHOULDER_PLAY:] = rng.uniform(0.3, 1.0, (3, 2)) * math.radians(0.02)
    poses = np.array([[*p.about_mm, 0.0] for p in PLACINGS]) + rng.uniform(-4, 4, (6, 3)) * [1, 1, 0.1]
    poses[:3, 2] = 0.0
    rows = []
    for number, placing in enumerate(PLACINGS):
        for finger, (model, own) in enumerate(zip(known, values, strict=True)):
            towards = math.atan2(*(own[:2] - poses[number, :2])[::-1])
            for turn in rng.uniform(-0.7, 0.7, TOUCHES):
                normal = np.array([math.cos(towards + turn), math.sin(towards + turn)])
                if placing.reference is PLATE:
                    normal, point = on_plate(poses[number], normal, float(rng.uniform(-25, 25)))
                else:
                    point = poses[number, :2] + DISC.radius_mm * normal
                dent = float(rng.uniform(0.1, 0.5))
                centre = point + (own[RADIUS] - dent + rng.normal(0, SIGMA_MM)) * normal
                ways = rng.choice([-1.0, 1.0], 2)
                rows.append((finger, number, *servos_of(model, own, centre, ways), *ways, dent))
    table = np.array(rows)
    whole, count = table[:, :2].astype(np.int64), len(table)
    given = TouchArrays(
        whole[:, 0],
        whole[:, 1],
        table[:, 2:4],
        table[:, 4:6],
        table[:, 6],
        np.full(count, SIGMA_MM),
        np.ones(count, dtype=bool),
    )
    return Touched(values, poses, given)


def on_plate(pose: Floats, wanted: Floats, along_mm: float) -> tuple[Floats, Floats]:
    """The normal of the face that looks that way most, and a point on it."""
    turn = rotation_matrix(float(pose[2]))
    faces = turn @ np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    normal = faces[:, int(np.argmax(wanted @ faces))]
    return normal, pose[:2] + 40.0 * normal + along_mm * np.array([-normal[1], normal[0]])


def test_derivatives_are_those_of_the_residuals() -> None:
    given = touched(1)
    own, there = given.values, given.poses
    _, _, _, rows = predict_residuals(models(), PLACINGS, given.touches, own, there)
    step = 1e-6
    for finger in range(3):
        for column in range(own.shape[1]):
            off = np.zeros_like(own)
            off[finger, column] = step
            ahead, behind = (
                predict_residuals(models(), PLACINGS, given.touches, own + side * off, there)[0]
                for side in (1.0, -1.0)
            )
            found = rows[:, finger * own.shape[1] + column]
            assert found == pytest.approx((ahead - behind) / (2 * step), abs=2e-5)


def test_true_values_leave_nothing_but_noise() -> None:
    given = touched(2)
    residual = predict_residuals(models(), PLACINGS, given.touches, given.values, given.poses)[0]
    assert residual.std() == pytest.approx(SIGMA_MM, rel=0.2)


def test_errors_are_those_that_deviations_state() -> None:
    """Base, heading, radius, links and elbow in the hand frame, over several rigs: a chi-square test."""
    squares, largest = [], 0.0
    for seed in range(6):
        given = touched(seed)
        hand = align_fit(ARMS.fingers, given.fit())
        drawn = nominal_poses(ARMS.fingers)
        frame = align_to_nominal(drawn, [BasePose((v[0], v[1]), v[HEADING]) for v in given.values.tolist()])
        for finger in range(3):
            truth = given.values[finger].copy()
            there = frame.place(BasePose((truth[0], truth[1]), truth[HEADING]))
            truth[:2], truth[HEADING] = there.base_mm, there.heading_rad
            off = (hand.values[finger] - truth)[: ELBOW_ZERO + 1]
            off[HEADING] = math.remainder(off[HEADING], 2 * math.pi)
            own = hand.of(finger)[: ELBOW_ZERO + 1, : ELBOW_ZERO + 1]
            squares.append(float(off @ np.linalg.solve(own, off)))
            largest = max(largest, math.hypot(off[0], off[1]))
    freedom = 7 * len(squares)
    assert 0.005 < chi2.sf(sum(squares), freedom) < 0.995
    assert largest < 0.2
