"""Calibration step for actuators: homing, direction, backlash, friction, latency, overshoot.

All of these are measured for slides and aims. For arms only direction and friction of the joints and the
stopping of tips are measured; their backlash stays as declared, and is refined by the fit of the fingers.
The table is cleared for homing; presses and stops need a disc. Results are fingers' tables `actuators`.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from palpate.base.errors import InputError
from palpate.calibration.actuator_estimators import StopStalls, fit_stops
from palpate.calibration.experiment_design import LocatedReference, locate_reference, probes_at_bearing
from palpate.calibration.finger_fit import ReferencePlacement
from palpate.calibration.finger_model import ActuatorMeasurements, FingerModel
from palpate.calibration.measurements import PressMeasurement, Prober, Reference, StopMeasurement
from palpate.calibration.rig_models import nominal_models
from palpate.config import FingerConfig
from palpate.config.calibration_finger import Actuators

_STALLS_PER_STOP = 2
_BEARINGS_DEG = (-20.0, 0.0, 20.0)
_STOPS_PER_SPEED = 2


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
    frictions = [0.0] * len(specs)
    models = nominal_models(specs)
    if any(model.slide is not None for model in models):
        tell("aims: friction")
        frictions = prober.swing()
    stalls = [_stall(prober, index, model, tell) for index, model in enumerate(models)]
    tell("disc in the middle: play, friction and stopping")
    prober.put(disc, (0.0, 0.0))
    found = locate_reference(prober, models, [ReferencePlacement(disc, (0.0, 0.0))], [], specs)
    presses = _presses(prober, models, found, tell)
    all_stops = _stops(prober, models, found, touch_speed_mm_s, approach_speed_mm_s, tell)
    stops = {spec.name: [stop for stop in all_stops if stop.finger == spec.name] for spec in specs}
    results: list[Actuators] = []
    for index, (spec, model) in enumerate(zip(specs, models, strict=True)):
        own = [press for press in presses if press.finger == spec.name]
        if not own:
            raise InputError(
                f"finger {spec.name}: no approach meets the disc head-on; put it nearer to the middle "
                "and begin again"
            )
        step_mm = max(press.step_mm for press in own)
        touched = [k for k, item in enumerate(found.touched) if item.finger == spec.name]
        measured = ActuatorMeasurements(
            own,
            fit_stops(stops[spec.name], step_mm, touch_speed_mm_s, coverage),
            stalls[index],
            frictions[index],
            [found.touched[k] for k in touched],
            found.fit.normal[touched],
        )
        results.append(model.describe_actuators(measured))
    return results


def _stall(prober: Prober, index: int, model: FingerModel, tell: Callable[[str], None]) -> StopStalls | None:
    """Stalls of a slide at both stops; None without a slide or without stops that are described."""
    if model.slide is None:
        return None
    stops = model.slide.stops_mm
    if stops is None:
        tell(f"{model.name}: no slide.stops_mm in the rig file, so travel and zero are taken as described")
        return None
    tell(f"{model.name}: homing against {stops[0]:g} and {stops[1]:g} mm")
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
