"""Calibration steps for the poses of fingers and for the axis of the turning stage.

Each placing begins with touches that locate the reference, continues with the most informative ones, and
ends by repeating the first of these, which reveals a reference that has moved.

*Stage.* The stage carries the fingers; the disc does not move. The stage goes through its range in both
directions, so that every angle between the ends is reached from both sides; the first angle is repeated at
the end.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtri

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats
from palpate.base.geometry.plane import rotate
from palpate.calibration.consistency_checks import FittedTouches, check_still
from palpate.calibration.experiment_design import (
    choose_touches,
    locate_reference,
    predict_touches,
    touch_arrays,
)
from palpate.calibration.finger_doubt import check_fit_of_all
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    fit_fingers,
    predict_residuals,
    touch_loads,
)
from palpate.calibration.finger_model import RADIUS, FingerModel
from palpate.calibration.idle_statistics import COVERAGE_SIGMAS
from palpate.calibration.measurements import Probe, Prober, Reference, ReferenceDisc, TouchMeasurement
from palpate.calibration.rig_models import KnownFingers, certain_models, nominal_model
from palpate.calibration.stage_fit import CENTRE, PLAY, StageFit, fit_stage, stage_touches
from palpate.config import FingerConfig, RigFile, StageConfig
from palpate.config.calibration_file import StageCalibration
from palpate.drivers.kinematics import TICK_RAD

_HELD_OUT_EVERY = (
    7  # one touch in so many shows whether the fit keeps its promises; not a multiple of fingers
)
_MIN_VARIANCE_SHARE = 0.04  # of the expected squares: some 0.002 mm; what gains do to forces repeats itself
_CREEP_BOUND_MM = 0.005  # a tip creeps 1 mm in a second, and its measured force is a few milliseconds old
_TYPICAL_SIGMA_MM = 0.012
_GRIPS_PER_PLACING = 6
_NEAR_SHARE, _PLATE_SHARE, _FAR_SHARE = 0.4, 0.45, 0.65
"""Of the workspace's radius: where references lie, far out, so that encoders are seen at many angles."""
_REACH_ROOM_MM = 5.0


def plan_placements(disc: Reference, plate: Reference, rig: RigFile) -> list[ReferencePlacement]:
    """Plan where references lie: the disc on three sides of the middle, then the plate between these."""
    radius_mm, found = rig.workspace.radius_mm, []
    far = _reached_share(rig, disc)
    for reference, first, share in ((disc, math.pi / 2, far), (plate, -math.pi / 2, min(far, _PLATE_SHARE))):
        # Arms reach no further than where there is room for either reference.
        widest = max(disc, plate, key=lambda item: item.radius_mm) if far == _NEAR_SHARE else reference
        away = min(share * radius_mm, radius_mm - widest.radius_mm - 10.0)
        for k in range(3):
            angle = first + 2 * math.pi / 3 * k
            found.append(ReferencePlacement(reference, (away * math.cos(angle), away * math.sin(angle))))
    return found


def _reached_share(rig: RigFile, disc: Reference) -> float:
    """Share of the radius at which every slide reaches a disc across the middle; arms do not reach so far."""
    slides = [(finger, nominal_model(finger).slide) for finger in rig.fingers]
    across = [
        -math.inf if slide is None else slide.range_mm[1] - math.hypot(*finger.base_mm)
        for finger, slide in slides
    ]
    share = (min(across) + disc.radius_mm - _REACH_ROOM_MM) / rig.workspace.radius_mm
    return min(max(share, _NEAR_SHARE), _FAR_SHARE)


def touch_placing(
    prober: Prober,
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    known: Sequence[TouchMeasurement],
    *,
    tell: Callable[[str], None],
) -> list[TouchMeasurement]:
    """Have the last of `placings` put, and touch it; `known`: touches of the earlier ones.

    Raises InputError for a reference that moves, is not found or is not what it is said to be.
    """
    number = len(placings) - 1
    placing = placings[number]
    prober.put(placing.reference, placing.about_mm)
    start = None
    if known:
        start = fit_fingers(models, placings[:number], touch_arrays(known, models, placings, specs))
    found = locate_reference(prober, models, placings, known, specs, start)
    touched = list(found.touched)
    grips = choose_touches(
        found.predicted,
        prober.approaches,
        models,
        found.fit.covariance,
        _TYPICAL_SIGMA_MM,
        _GRIPS_PER_PLACING,
    )

    def carried_out(grip: Sequence[Probe]) -> list[TouchMeasurement]:
        return [item for item in prober.touch(grip, number) if item is not None]

    first: list[TouchMeasurement] = []
    repeated: Sequence[Probe] = []
    for k, grip in enumerate(grips):
        tell(f"touch {k + 1} of {len(grips)}")
        got = carried_out(grip)
        if not first:
            first, repeated = got, grip
        touched += got
    if first:
        again = carried_out(repeated)
        check_still(first, again, models, placing)
        touched += again
    every = [*known, *touched]
    touches = touch_arrays(every, models, placings, specs)
    fit = fit_fingers(models, placings, touches, (found.fit.values, found.fit.poses[:number]))
    check_fit_of_all(FittedTouches(specs, models, placings, touches, fit))
    return touched


def fit_touches(
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touched: Sequence[TouchMeasurement],
) -> tuple[TouchArrays, FingerFit, FingerFit]:
    """Touches, their fit, and the fit without those that are held out. Raises what `check_fit_of_all` raises.

    Once it is known that touches agree, the fit is made again with what they scatter by: servos that come to
    rest in the same part of a step again and again scatter by less than steps let expect. What repeats itself
    does not show in the scatter: the fit's poses take some of it in, the radii what is alike in all dents.
    """
    touches = touch_arrays(touched, models, placings, specs)
    fit = fit_fingers(models, placings, touches, _begin_of_fit(specs, models, placings, touched))
    check_fit_of_all(FittedTouches(specs, models, placings, touches, fit))
    share = max(_MIN_VARIANCE_SHARE, fit.chi_square / fit.freedom)
    touches = replace(touches, sigma_mm=touches.sigma_mm * math.sqrt(share))
    fit = fit_fingers(models, placings, touches, (fit.values, fit.poses))
    slopes = predict_residuals(models, placings, touches, fit.values, fit.poses)[3]
    give = touch_loads(touched, specs).give_sigma_mm
    fit = _with_dents_alike(specs, touches, _with_give_alike(slopes, give, touches, fit))
    without = fit_fingers(
        models, placings, touches.with_used(~hold_out(len(touched))), (fit.values, fit.poses)
    )
    return touches, fit, without


def _begin_of_fit(
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touched: Sequence[TouchMeasurement],
) -> tuple[Floats, Floats] | None:
    """Values and poses by one placing after the other: all at once, a plate may be found turned wrongly."""
    begin = None
    for count in range(1, len(placings)):
        some = [item for item in touched if item.placing < count]
        fit = fit_fingers(models, placings[:count], touch_arrays(some, models, placings, specs), begin)
        begin = fit.values, fit.poses
    return begin


def _with_dents_alike(specs: Sequence[FingerConfig], touches: TouchArrays, fit: FingerFit) -> FingerFit:
    """A fit whose radii are as uncertain as what all dents of a finger may be off by alike.

    Touches know a radius less a dent only, and one dent is nearly as deep as the other: what is wrong with
    all of them is in the radius. It comes from the stiffness and from how old the array's frames are.
    """
    covariance = fit.covariance.copy()
    for index, spec in enumerate(specs):
        dent_mm = float(touches.dent_mm[touches.finger == index].mean())
        soft_mm = dent_mm * spec.tip.stiffness_spread / COVERAGE_SIGMAS
        at = index * fit.values.shape[1] + RADIUS
        covariance[at, at] += soft_mm**2 + _CREEP_BOUND_MM**2 / 3
    return replace(fit, covariance=covariance)


def _with_give_alike(
    slopes: Floats, give_sigma_mm: Floats, touches: TouchArrays, fit: FingerFit
) -> FingerFit:
    """A fit that is more uncertain by what all touches of a finger may have given way by alike.

    `slopes` (n, unknowns): derivatives of residuals. What a shift of a finger's residuals by their deviations
    does to the least squares is one more deviation of all unknowns (Schmidt's consider covariance).
    """
    weight = (touches.used & ~fit.outlier) / touches.sigma_mm**2
    covariance = fit.covariance.copy()
    for finger in np.unique(touches.finger):
        shift = np.where(touches.finger == finger, give_sigma_mm, 0.0)
        off = fit.covariance @ (slopes.T @ (weight * shift))
        covariance += np.outer(off, off)
    return replace(fit, covariance=covariance)


def hold_out(count: int) -> Bools:
    """Choose those of `count` touches (count,) that are predicted rather than fitted."""
    result: Bools = np.arange(count) % _HELD_OUT_EVERY == _HELD_OUT_EVERY - 1
    return result


_STAGE_STOPS = 5  # angles over the stage's range
_DISC_RADIUS_SHARE = 0.4  # of the workspace's radius: how far from the axis the disc lies
_BEARINGS_TRIED = 36
_GRIPS_PER_STOP = 2  # at each stop
_PLACED_SIGMA_MM = 3.0  # the disc is where it is expected at a stage angle to within so much
_KNOWN_SIGMA_MM = 1e-3


def place_disc(rig: RigFile, disc: ReferenceDisc) -> tuple[float, float]:
    """Place the disc, in W: beside the axis, where fingers see it well inside at all angles."""
    stage = _stage_of(rig)
    radius = rig.workspace.radius_mm
    away = max(min(_DISC_RADIUS_SHARE * radius, radius - disc.radius_mm - 10.0), 1.0)
    bearing = np.linspace(0, 2 * math.pi, _BEARINGS_TRIED, endpoint=False) + math.pi / 2
    arm = away * np.column_stack([np.cos(bearing), np.sin(bearing)])
    turns = -np.radians(np.linspace(*stage.range_deg, _STAGE_STOPS))
    seen = np.array(stage.centre_mm) + np.stack([rotate(arm, np.full(len(arm), turn)) for turn in turns])
    furthest = np.hypot(seen[..., 0], seen[..., 1]).max(axis=0)
    x, y = (np.array(stage.centre_mm) + arm[int(furthest.argmin())]).tolist()
    return x, y


def measure_stage(
    prober: Prober, rig: RigFile, disc: ReferenceDisc, *, tell: Callable[[str], None]
) -> list[TouchMeasurement]:
    """Have the disc put beside the axis and touch it at all stops; `rig`: with calibrated fingers.

    Raises InputError for a disc that is not found or moves, and for a stage that hardly turns.
    """
    about = place_disc(rig, disc)
    prober.put(disc, about)
    tell(f"{disc.name} near ({about[0]:.0f}, {about[1]:.0f}) mm, the stage at 0°")
    models, placing = certain_models(rig.fingers), ReferencePlacement(disc, about)
    found = locate_reference(prober, models, [placing], [], rig.fingers)
    # Touches that look for it are made with aims and a stage of which no side is known: they do not count.
    return _Tour(prober.turned, _stage_of(rig), models, placing, found.fit, tell).touched()


def calibrate_stage(
    rig: RigFile,
    known: KnownFingers,
    specs: Sequence[FingerConfig],
    touched: Sequence[TouchMeasurement],
    disc: ReferenceDisc,
    offset_bound_mm: float,
    coverage: float,
) -> StageCalibration:
    """The stage by its touches, compared with the rig file.

    `rig`: as described; `specs`: its fingers with what is known of them. `offset_bound_mm`: how far the axis
    may be from the drawing's because the hand frame may be. Raises InputError.
    """
    stage = _stage_of(rig)
    given = stage_touches(touched, stage, known.models, specs, disc)
    start = np.array([*stage.centre_mm, *place_disc(rig, disc), math.radians(stage.backlash_deg) / 2])
    fit = fit_stage(known, given, disc, start)
    _check_bounds(stage, fit, offset_bound_mm)
    own = fit.covariance[CENTRE, CENTRE]
    sigma = np.sqrt(np.diag(fit.covariance))
    widest = math.sqrt(float(np.linalg.eigvalsh(own)[-1]) * float(chdtri(2, 1 - coverage)))
    residual = fit.residual_mm[~fit.outlier]
    x, y = fit.values[CENTRE].tolist()
    return StageCalibration(
        centre_mm=(x, y),
        centre_sigma_mm=(float(sigma[0]), float(sigma[1])),
        covariance=own.tolist(),
        centre_bound_mm=widest + disc.tolerance_mm,
        backlash_deg=math.degrees(max(float(fit.values[PLAY]), 0.0)),
        backlash_sigma_deg=math.degrees(float(sigma[PLAY])),
        stops=len(given.angle_rad),
        touches=len(residual),
        degrees_of_freedom=fit.freedom,
        chi_square=fit.chi_square,
        outliers=int(fit.outlier.sum()),
        rms_mm=float(np.sqrt((residual**2).mean())),
    )


@dataclass(frozen=True, eq=False)
class _Tour:
    """All stops of the stage. `fit`: of the disc as it is seen with the stage at 0."""

    turned: Prober
    stage: StageConfig
    models: Sequence[FingerModel]
    placing: ReferencePlacement
    fit: FingerFit
    tell: Callable[[str], None]

    def touched(self) -> list[TouchMeasurement]:
        """Touches of all stops, each with the number of its stop; the last is the first one again."""
        angles = _angles(self.turned)
        stops = [*angles, *angles[-2::-1]]
        grips = {angle: self._grips(angle) for angle in angles}
        found = [
            self._stop(number, len(stops), grips[angle], angle, angle - before)
            for number, (before, angle) in enumerate(pairwise([0.0, *stops]), start=1)
        ]
        for model in self.models:
            first, again = (
                [item for item in found[k] if item.finger == model.name] for k in (0, len(found) - 1)
            )
            for k, item in enumerate(first):
                check_still([item], again[k : k + 1], self.models, self.placing)
        return [item for touched in found for item in touched]

    def _stop(
        self, number: int, count: int, grips: Sequence[Sequence[Probe]], angle_rad: float, turn_rad: float
    ) -> list[TouchMeasurement]:
        """Touches of all grips at one stop, to which the stage turns by an angle."""
        at, name = f"the stage at {math.degrees(angle_rad):.1f}°", self.placing.reference.name
        self.tell(f"stop {number} of {count}: {at}")
        way, found = _approach_side(self.stage, turn_rad), list[TouchMeasurement]()
        for k, grip in enumerate(grips, start=1):
            self.tell(f"touch {k} of {len(grips)}")
            met = [item for item in self.turned.touch(grip, number) if item is not None]
            found += [replace(item, stage_way=way) for item in met]
        if grips and not found:
            raise InputError(
                f"with {at} fingers met nothing where the {name} should be: check stage.gear_ratio with its "
                "sign, and stage.centre_mm, and that it has not moved"
            )
        return found

    def _grips(self, angle_rad: float) -> list[list[Probe]]:
        """The most informative touches at a stage angle, as the disc is seen from there."""
        numbers = [k for k, item in enumerate(self.turned.approaches) if item.stage_rad == angle_rad]
        paths = [self.turned.approaches[k] for k in numbers]
        centre, pose = np.array(self.stage.centre_mm), self.fit.poses[:1].copy()
        pose[:, :2] = centre + rotate(pose[:, :2] - centre, np.array([-angle_rad]))
        predicted = predict_touches(self.models, [self.placing], replace(self.fit, poses=pose), 0, paths)
        unsure = block_diag(
            _KNOWN_SIGMA_MM**2 * np.eye(self.fit.values.size), _PLACED_SIGMA_MM**2 * np.eye(3)
        )
        grips = choose_touches(predicted, paths, self.models, unsure, _TYPICAL_SIGMA_MM, _GRIPS_PER_STOP)
        return [[replace(probe, approach=numbers[probe.approach]) for probe in grip] for grip in grips]


def _stage_of(rig: RigFile) -> StageConfig:
    if rig.stage is None:
        raise InputError(f'rig "{rig.name}" has no turning stage to calibrate')
    return rig.stage


def _angles(turned: Prober) -> list[float]:
    """Stage angles to stop at, ascending: evenly spaced as nearly as paths are offered."""
    offered = np.unique([item.stage_rad for item in turned.approaches])
    wanted = np.linspace(offered[0], offered[-1], _STAGE_STOPS)
    chosen = {float(offered[np.abs(offered - angle).argmin()]) for angle in wanted}
    return sorted(chosen)


def _approach_side(stage: StageConfig, turned_rad: float) -> int:
    """Side from which the stage has come, if it turned by more than all of its play."""
    least = 2 * math.radians(stage.backlash_deg) + 2 * TICK_RAD / abs(stage.gear_ratio)
    return int(math.copysign(1, turned_rad)) if abs(turned_rad) > least else 0


def _check_bounds(stage: StageConfig, fit: StageFit, offset_bound_mm: float) -> None:
    """Refuse values that the rig file rules out."""
    sigma = np.sqrt(np.diag(fit.covariance))
    away = math.dist(fit.values[CENTRE], stage.centre_mm)
    unsure = 4 * float(sigma[CENTRE].max())
    if away > stage.centre_bound_mm + offset_bound_mm + unsure:
        raise InputError(
            f"the stage's axis would be {away:.2f} mm from centre_mm, and the rig file says within "
            f"{stage.centre_bound_mm:g}, {offset_bound_mm:.2g} more as bases and headings are known: correct "
            "stage.centre_mm or widen stage.centre_bound_mm"
        )
    play, own = math.degrees(float(fit.values[PLAY])), math.degrees(float(sigma[PLAY]))
    if play > stage.backlash_deg + 4 * own:
        raise InputError(
            f"the stage's play would be {play:.3f} ± {own:.3f}° either way, and the rig file says "
            f"{stage.backlash_deg:g}° at most: tighten it, or widen stage.backlash_deg"
        )
    if play < -4 * own:
        raise InputError(
            f"the stage goes {-play:.3f}° further than its servo, from either side: something pushes it "
            "where it stops; free it, and begin this step again"
        )
