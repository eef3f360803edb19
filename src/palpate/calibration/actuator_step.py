"""Calibration step for actuators: homing, direction, backlash, friction, latency, overshoot.

Slides and aims have all of these. Of arms' joints direction and friction are measured, and how tips stop;
their plays stay as described, for the fit of the fingers to narrow down. The table is cleared for homing;
presses and stops need a disc. Results are fingers' tables `actuators`.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from palpate.base.errors import InputError
from palpate.calibration.actuator_estimators import (
    Homing,
    StopLatency,
    StopStalls,
    combine_backlash,
    estimate_backlash,
    estimate_friction,
    fit_homing,
    fit_latency,
)
from palpate.calibration.experiment_design import LocatedReference, locate_reference, probes_at_bearing
from palpate.calibration.finger_fit import ReferencePlacement
from palpate.calibration.finger_model import FingerModel
from palpate.calibration.measurements import PressMeasurement, Prober, StopMeasurement
from palpate.calibration.reference import Reference
from palpate.calibration.rig_models import nominal_models
from palpate.calibration.slide_model import slide_in_contact, zero_in_file_mm
from palpate.config import (
    ActuatorsCalibration,
    ArmFingerConfig,
    FingerConfig,
    JointConfig,
    RotaryCalibration,
    SlideCalibration,
    SlideFingerConfig,
)
from palpate.config.calibration_finger import (
    Actuators,
    ArmActuatorsCalibration,
    StopsCalibration,
)

_STALLS_PER_STOP = 2
_BEARINGS_DEG = (-20.0, 0.0, 20.0)
_STOPS_PER_SPEED = 2
_BOUND_SIGMAS = 3.3  # that a bound is taken for, where nothing but a bound is known
_SETTLE_MARGIN = 1.5  # times the longest of a few
_FRAME_LAG_SAMPLES = (
    0.5  # samples by which frames, averaged since the last look, are older than the servo's state
)


def measure_actuators(
    prober: Prober,
    specs: Sequence[FingerConfig],
    disc: Reference,
    *,
    touch_speed_mm_s: float,
    approach_speed_mm_s: float,
    coverage: float,
    tell: Callable[[str], None],
) -> list[Actuators]:
    """Measure every finger's actuators. Raises InputError for what is not as described."""
    prober.clear()
    stalls: dict[str, StopStalls | None] = {}
    frictions = [0.0] * len(specs)
    if any(isinstance(spec, SlideFingerConfig) for spec in specs):
        tell("aims: friction")
        frictions = prober.swing()
    for index, spec in enumerate(specs):
        if isinstance(spec, SlideFingerConfig):
            stalls[spec.name] = _stall(prober, index, spec, tell)
    tell("disc in the middle: play, friction and stopping")
    prober.put(disc, (0.0, 0.0))
    models = nominal_models(specs)
    found = locate_reference(prober, models, [ReferencePlacement(disc, (0.0, 0.0))], [], specs)
    presses = _presses(prober, models, found, tell)
    measured = _stops(prober, models, found, touch_speed_mm_s, approach_speed_mm_s, tell)
    stops = {spec.name: [stop for stop in measured if stop.finger == spec.name] for spec in specs}
    results: list[Actuators] = []
    for index, spec in enumerate(specs):
        own = [press for press in presses if press.finger == spec.name]
        if not own:
            raise InputError(
                f"finger {spec.name}: no approach meets the disc head-on; put it nearer to the middle "
                "and begin again"
            )
        step_mm = max(press.step_mm for press in own)
        latency = fit_latency(stops[spec.name], step_mm, touch_speed_mm_s, coverage)
        settle_s = _settle_s(stops[spec.name], step_mm)
        if isinstance(spec, ArmFingerConfig):
            results.append(_arm_result(spec, own, latency, settle_s))
        else:
            results.append(
                _slide_result(
                    spec,
                    stalls[spec.name],
                    own,
                    latency,
                    settle_s=settle_s,
                    aim_turns=_aim_turns(spec, found),
                    aim_friction_a=frictions[index],
                )
            )
    return results


def _stall(
    prober: Prober, index: int, spec: SlideFingerConfig, tell: Callable[[str], None]
) -> StopStalls | None:
    stops = spec.slide.stops_mm
    if stops is None:
        tell(f"{spec.name}: no slide.stops_mm in the rig file, so travel and zero are taken as described")
        return None
    tell(f"{spec.name}: homing against {stops[0]:g} and {stops[1]:g} mm")
    back, front = (np.array([prober.home(index, stop) for _ in range(_STALLS_PER_STOP)]) for stop in stops)
    return StopStalls(stops, back, front)


def _presses(
    prober: Prober, models: Sequence[FingerModel], found: LocatedReference, tell: Callable[[str], None]
) -> list[PressMeasurement]:
    presses: list[PressMeasurement] = []
    for number, bearing in enumerate(_BEARINGS_DEG):
        tell(f"press {number + 1} of {len(_BEARINGS_DEG)}")
        contacts = [probe for probe, _ in probes_at_bearing(found, prober, models, math.radians(bearing))]
        presses += prober.press(contacts, 0)
    return presses


def _stops(
    prober: Prober,
    models: Sequence[FingerModel],
    found: LocatedReference,
    touch_mm_s: float,
    approach_mm_s: float,
    tell: Callable[[str], None],
) -> list[StopMeasurement]:
    """Stops at three speeds up to the fastest approach, head-on."""
    contacts = [probe for probe, _ in probes_at_bearing(found, prober, models, 0.0)]
    slow = min(2 * touch_mm_s, approach_mm_s)
    stops: list[StopMeasurement] = []
    for speed in dict.fromkeys((slow, (slow + approach_mm_s) / 2, approach_mm_s)):
        tell(f"stopping from {speed:g} mm/s")
        for _ in range(_STOPS_PER_SPEED):
            stops += prober.stop(contacts, speed)
    return stops


def _settle_s(stops: Sequence[StopMeasurement], step_mm: float) -> float:
    """The longest time from a stop that was sent to standing still, from the slowest speed, with some room.

    It is for touches, which are slower still; from higher speeds a slide takes longer to brake.
    """
    slowest = min((stop.speed_mm_s for stop in stops), default=0.0)
    stops = [stop for stop in stops if stop.speed_mm_s == slowest]
    ran_on = [(abs(stop.stood_mm - stop.felt_mm) + step_mm) / stop.speed_mm_s for stop in stops]
    return _SETTLE_MARGIN * max(ran_on, default=0.0)


def _aim_turns(spec: SlideFingerConfig, found: LocatedReference) -> bool:
    """Whether contacts wander round the tip the way they must if the aim turns as described."""
    own = [k for k, item in enumerate(found.touched) if item.finger == spec.name]
    fit = found.fit
    measured = np.unwrap([found.touched[k].angle_rad for k in own])
    towards = -fit.normal[own]
    aims = np.array([found.touched[k].servos_rad[0] for k in own]) / spec.aim.gear_ratio
    bearing = np.unwrap(np.arctan2(towards[:, 1], towards[:, 0]) - aims)
    return len(own) > 1 and float(np.dot(measured - measured.mean(), bearing - bearing.mean())) > 0


def _slide_result(
    spec: SlideFingerConfig,
    stalls: StopStalls | None,
    presses: Sequence[PressMeasurement],
    latency: StopLatency,
    *,
    settle_s: float,
    aim_turns: bool,
    aim_friction_a: float,
) -> ActuatorsCalibration:
    per_rad = spec.slide.mm_per_rad
    backlash = combine_backlash(
        [estimate_backlash(press, press.counts.sum(axis=(1, 2)), _FRAME_LAG_SAMPLES) for press in presses]
    )
    friction = estimate_friction(presses)
    if stalls is None:
        spread, bound = spec.slide.mm_per_turn_spread, spec.slide.zero_bound_mm
        home = Homing(
            per_rad,
            abs(per_rad) * spread / math.sqrt(3),
            spec.slide.zero_mm + per_rad * math.pi,
            bound / math.sqrt(3),
        )
    else:
        home = fit_homing(spec, stalls, backlash)
    seen = slide_in_contact(spec, backlash, stalls)
    slide = SlideCalibration(
        direction_confirmed=friction.direction > 0,
        mm_per_turn=2 * math.pi * home.mm_per_rad,
        mm_per_turn_sigma=2 * math.pi * home.mm_per_rad_sigma,
        zero_mm=zero_in_file_mm(home.zero_mm, home.mm_per_rad),
        zero_sigma_mm=math.hypot(home.zero_sigma_mm, home.mm_per_rad_sigma * math.pi),
        homed=stalls is not None,
        backlash_mm=backlash.half_mm,
        backlash_sigma_mm=backlash.sigma_mm,
        touch_zero_mm=seen.zero_mm,
        touch_covariance=seen.covariance.tolist(),
        friction_a=abs(friction.push_n) / abs(presses[0].newton_per_a[1]),
        latency_s=latency.latency_s,
        latency_bound_s=latency.latency_bound_s,
        settle_s=settle_s,
        overshoots=latency.overshoots,
    )
    half = spec.aim.backlash_deg / 2
    aim = RotaryCalibration(
        direction_confirmed=aim_turns,
        backlash_deg=half,
        backlash_sigma_deg=half / _BOUND_SIGMAS,
        friction_a=aim_friction_a,
    )
    return ActuatorsCalibration(slide=slide, aim=aim)


def _arm_result(
    spec: ArmFingerConfig, presses: Sequence[PressMeasurement], latency: StopLatency, settle_s: float
) -> ArmActuatorsCalibration:
    return ArmActuatorsCalibration(
        shoulder=_joint(spec.shoulder, presses, 0),
        elbow=_joint(spec.elbow, presses, 1),
        stops=StopsCalibration(
            latency_s=latency.latency_s,
            latency_bound_s=latency.latency_bound_s,
            settle_s=settle_s,
            overshoots=latency.overshoots,
        ),
    )


def _joint(spec: JointConfig, presses: Sequence[PressMeasurement], which: int) -> RotaryCalibration:
    """What the free ways of presses show of a joint; a joint that never moved on them is not confirmed."""
    current = np.array([press.free_a[which] for press in presses])
    moved = np.isfinite(current)
    middle = float(np.median(current[moved])) if moved.any() else 0.0
    half = spec.backlash_deg / 2
    return RotaryCalibration(
        direction_confirmed=bool(moved.any()) and bool((current[moved] > 0).all()),
        backlash_deg=half,
        backlash_sigma_deg=half / _BOUND_SIGMAS,
        friction_a=max(middle, 0.0),
    )
