"""Does what a session felt agree with the calibration? After an identification, beside the report.

The object that was identified is a thing of known shape: at its best pose its contacts must not be further
from its outline than the calibration explains (`calibration.agreement`).
"""

import math
from collections.abc import Sequence
from datetime import datetime

import numpy as np
from scipy.optimize import least_squares

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import rotate, rotation_matrix
from palpate.base.vocabulary import RecognitionVerdict
from palpate.calibration.agreement import (
    Agreement,
    ContactUncertainty,
    SurfaceContacts,
    compare_touches,
    contact_uncertainties,
    touch_covariance,
)
from palpate.config import CalibrationFile, RigFile, StageConfig
from palpate.config.identification_result import CalibrationUsedOut
from palpate.recognizer import Finger, Hypothesis
from palpate.rig.conversion import deflection_mm
from palpate.rig.identification.loop import Identification
from palpate.rig.motion.contact_from_touch import dent_range_mm, may_touch_two_edges
from palpate.rig.motion.guarded_approach import Touch
from palpate.rig.turning_stage import planned_turn

__all__ = ["calibration_used", "session_agreement"]

_STEP = 1e-6
_TURNED_RAD = math.radians(0.2)  # less is what the stage's servo stops beside its goal
_ARM_MM = 50.0  # a turn counts like a shift so far out: unknowns of one size


def session_agreement(
    result: Identification, rig: RigFile, calibration: CalibrationFile | None
) -> Agreement | None:
    """How the contacts of an identified object agree with the calibration that is laid over `rig`.

    None if there is no calibration with bounds, more than one hypothesis is left, or contacts are too few.
    """
    recognition = result.recognition
    uncertainties = None if calibration is None else contact_uncertainties(calibration, at_rest=True)
    if uncertainties is None or recognition is None or recognition.verdict is not RecognitionVerdict.UNIQUE:
        return None
    since = result.moved_before[-1] - 1 if result.moved_before else 0
    touches = [touch for grip in result.grips[since:] for touch in grip if _is_clear(touch)]
    found = recognition.hypotheses[0]
    outlines = [_edges_met(found, touch.contact.finger) for touch in touches]
    if not touches or any(not len(outline) for outline in outlines):
        return None
    return _agreement(touches, outlines, found, rig, uncertainties)


def calibration_used(
    result: Identification, rig: RigFile, calibration: CalibrationFile, started: datetime
) -> CalibrationUsedOut:
    """The calibration's part of a run's answer; `started`: when the run began."""
    found = session_agreement(result, rig, calibration)
    return CalibrationUsedOut(
        made=calibration.made.isoformat().replace("+00:00", "Z"),
        age_days=max((started - calibration.made).days, 0),
        residual_rms_mm=found and found.rms_mm,
        expected_rms_mm=found and found.expected_rms_mm,
        drifted=found and found.drifted,
    )


def _is_clear(touch: Touch) -> bool:
    """Whether it met one edge, so that it is known along which normal the tip was dented."""
    return touch.patch is not None and not may_touch_two_edges(touch.patch)


def _agreement(
    touches: Sequence[Touch],
    outlines: Sequence[Floats],
    found: Hypothesis,
    rig: RigFile,
    uncertainties: Sequence[ContactUncertainty],
) -> Agreement | None:
    centre = np.array([touch.contact.end_mm for touch in touches])
    radius = np.array([touch.contact.finger.tip_radius_mm for touch in touches])
    at = found.configuration
    middle = np.array([at.x_mm, at.y_mm])
    middle = middle + rotation_matrix(at.theta_rad) @ found.state.origin_mm

    def gaps(pose: Floats) -> tuple[Floats, Floats]:
        """Distances (n,) of centres from the outline less the radius, and outward normals (n, 2) in W."""
        turn = rotation_matrix(at.theta_rad + pose[2] / _ARM_MM)
        own = (centre - middle - pose[:2]) @ turn + found.state.origin_mm
        nearest = np.array([_nearest(outline, p) for outline, p in zip(outlines, own, strict=True)])
        away = own - nearest
        far = np.hypot(away[:, 0], away[:, 1])
        return far - radius, away @ turn.T / np.maximum(far, 1e-9)[:, None]

    def off(pose: Floats) -> Floats:
        return gaps(pose)[0]

    pose = least_squares(off, np.zeros(3)).x
    residual, normal = gaps(pose)
    slopes = np.column_stack(
        [(off(pose + step) - off(pose - step)) / (2 * _STEP) for step in _STEP * np.eye(3)]
    )
    travel = np.array([touch.contact.direction_rad for touch in touches])
    surface = SurfaceContacts(
        finger=np.array([touch.finger_index for touch in touches], dtype=np.int64),
        normal=normal,
        travel=np.column_stack([np.cos(travel), np.sin(travel)]),
        dent_mm=np.array([_dent_mm(touch, rig) for touch in touches]),
        tolerance_mm=found.state.tolerance_mm,
        shared_mm=None if rig.stage is None else _turned_mm(touches, centre, normal, rig.stage),
    )
    return compare_touches(residual, slopes, touch_covariance(surface, uncertainties))


def _dent_mm(touch: Touch, rig: RigFile) -> float:
    """By how much dent and deflection may be other than the contact takes them to be."""
    assert touch.patch is not None
    patch, finger = touch.patch, rig.fingers[touch.finger_index]
    least, most = dent_range_mm(patch.force_n, patch.force_bound_n, finger.tip, rig.closing.max_force_n)
    return (most - least) / 2 + deflection_mm(finger, patch.force_n)


def _turned_mm(touches: Sequence[Touch], centre: Floats, normal: Floats, stage: StageConfig) -> Floats:
    """What the turning stage puts contacts off by along their normals: deviations (n, m).

    Its axis is alike in all of them; its angle in those between which it did not turn, because where it
    turns its play may be taken up on the other side.
    """
    angle = np.array([touch.stage_rad for touch in touches])
    stop = np.concatenate([[0], np.cumsum(np.abs(np.diff(angle)) > _TURNED_RAD)])
    arm = centre - np.array(stage.centre_mm)
    across = normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]
    off_rad = planned_turn(stage, 0.0).angle_bound_rad / math.sqrt(3)
    turned = (stop[:, None] == np.unique(stop)) * (across * off_rad)[:, None]
    shifted = (normal - rotate(normal, -angle)) * stage.centre_bound_mm / 2
    return np.hstack([turned, shifted])


def _edges_met(found: Hypothesis, finger: Finger) -> Floats:
    """Edges (m, 2, 2) of the object beside a tip: start and end, in its own frame; none where nothing is.

    Nor where it is not by its own circle that a ball meets them.
    """
    sections = found.state.state.sections_within(finger.span_mm)
    if finger.is_ball and any(not z[0] <= finger.height_mm <= z[1] for z in (item.z_mm for item in sections)):
        return np.empty((0, 2, 2))
    rings = [ring for section in sections for ring in section.rings]
    edges = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings]
    return np.concatenate(edges) if edges else np.empty((0, 2, 2))


def _nearest(edges: Floats, point: Floats) -> Floats:
    """The point (2,) of the edges (m, 2, 2) that is nearest to a point (2,)."""
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    share = ((point - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
    places = start + np.clip(share, 0.0, 1.0)[:, None] * along
    result: Floats = places[np.hypot(*(places - point).T).argmin()]
    return result
