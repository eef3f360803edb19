"""The step of calibration that measures actuators: homing, direction, play, friction, latency, overshoot.

From a prober to a finger's table `actuators`. The table is cleared for homing; presses and stops need a disc.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.finger_fit import FingerModel, ReferencePlacement
from palpate.calibration.finger_model import Homed, finger_model, mm_per_rad_of, touching, zero_in_file_mm
from palpate.calibration.friction import friction_of
from palpate.calibration.homing import SlideDescription, homed
from palpate.calibration.measurements import PressMeasurement, StopMeasurement
from palpate.calibration.play import Backlash, backlash_of, combined
from palpate.calibration.prober import Prober
from palpate.calibration.reference import Reference
from palpate.calibration.reference_search import LocatedReference, at_bearing, find
from palpate.calibration.stopping import StopLatency, overshoot_of
from palpate.config import SlideFingerConfig
from palpate.config.calibration_finger import (
    ActuatorsCalibration,
    AimCalibration,
    Overshoot,
    SlideCalibration,
)
from palpate.drivers.finger import TICK_RAD
from palpate.errors import InputError

__all__ = ["measure_actuators"]

_STALLS = 2
_BEARINGS_DEG = (-20.0, 0.0, 20.0)
_REPEATS = 2
_SIGMAS = 3.3  # that a bound is taken for, where nothing but a bound is known
_WORST = 1.5  # times the longest of a few
_LAG = 0.5  # samples by which frames, averaged since the last look, are older than the servo's state


@dataclass(frozen=True)
class _Stalls:
    """Where a slide's servo (rad) stalled against its back and front stops, time and again."""

    back_rad: tuple[float, ...]
    front_rad: tuple[float, ...]


def measure_actuators(
    prober: Prober,
    specs: Sequence[SlideFingerConfig],
    disc: Reference,
    *,
    touch_speed_mm_s: float,
    approach_speed_mm_s: float,
    coverage: float,
    tell: Callable[[str], None],
) -> list[ActuatorsCalibration]:
    """Measure every finger's actuators. Raises InputError for what is not as described."""
    prober.clear()
    tell("aims: friction")
    frictions = prober.swing()
    stalls = [_stalled(prober, index, spec, tell) for index, spec in enumerate(specs)]
    tell("disc in the middle: play, friction and stopping")
    prober.put(disc, (0.0, 0.0))
    models = [finger_model(spec, touching(spec, None, None)) for spec in specs]
    found = find(
        prober,
        models,
        [ReferencePlacement(disc, (0.0, 0.0))],
        [],
        [spec.tip.stiffness_n_per_mm for spec in specs],
    )
    presses = _presses(prober, models, found, tell)
    stops = _stops(prober, models, found, touch_speed_mm_s, approach_speed_mm_s, tell)
    return [
        _result(
            spec,
            stalls[index],
            [press for press in presses if press.finger == spec.name],
            overshoot_of(
                [stop for stop in stops if stop.finger == spec.name],
                mm_per_rad_of(spec),
                touch_speed_mm_s,
                coverage,
            ),
            settle_s=_settle_s([stop for stop in stops if stop.finger == spec.name], mm_per_rad_of(spec)),
            aim_turns=_aim_turns(spec, found),
            aim_friction_a=frictions[index],
        )
        for index, spec in enumerate(specs)
    ]


def _homed(spec: SlideFingerConfig, stalls: _Stalls | None, play: Backlash) -> Homed | None:
    """What stalls say of a slide, for the prior of its place."""
    if stalls is None or spec.slide.stops_mm is None:
        return None
    back, front = np.array(stalls.back_rad), np.array(stalls.front_rad)
    off = np.concatenate([back - back.mean(), front - front.mean()])
    sigma = math.sqrt(float((off**2).sum()) / max(len(off) - 2, 1) / min(len(back), len(front)))
    return Homed(float(back.mean()), float(front.mean()), sigma, spec.slide.stops_mm, play)


def _stalled(
    prober: Prober, index: int, spec: SlideFingerConfig, tell: Callable[[str], None]
) -> _Stalls | None:
    stops = spec.slide.stops_mm
    if stops is None:
        tell(f"{spec.name}: no slide.stops_mm in the rig file, so travel and zero are taken as described")
        return None
    tell(f"{spec.name}: homing against {stops[0]:g} and {stops[1]:g} mm")
    back = [prober.home(index, stops[0]) for _ in range(_STALLS)]
    front = [prober.home(index, stops[1]) for _ in range(_STALLS)]
    return _Stalls(tuple(back), tuple(front))


def _presses(
    prober: Prober, models: Sequence[FingerModel], found: LocatedReference, tell: Callable[[str], None]
) -> list[PressMeasurement]:
    presses: list[PressMeasurement] = []
    for number, bearing in enumerate(_BEARINGS_DEG):
        tell(f"press {number + 1} of {len(_BEARINGS_DEG)}")
        contacts = [probe for probe, _ in at_bearing(found, prober, models, math.radians(bearing))]
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
    contacts = [probe for probe, _ in at_bearing(found, prober, models, 0.0)]
    slow = min(2 * touch_mm_s, approach_mm_s)
    stops: list[StopMeasurement] = []
    for speed in dict.fromkeys((slow, (slow + approach_mm_s) / 2, approach_mm_s)):
        tell(f"stopping from {speed:g} mm/s")
        for _ in range(_REPEATS):
            stops += prober.stop(contacts, speed)
    return stops


def _settle_s(stops: Sequence[StopMeasurement], mm_per_rad: float) -> float:
    """The longest time from a stop that was sent to standing still, from the slowest speed, with some room.

    It is for touches, which are slower still; from higher speeds a slide takes longer to brake.
    """
    step = TICK_RAD * abs(mm_per_rad)
    slowest = min((stop.speed_mm_s for stop in stops), default=0.0)
    stops = [stop for stop in stops if stop.speed_mm_s == slowest]
    ran_on = [
        (abs(stop.stood_rad - stop.felt_rad) * abs(mm_per_rad) + step) / stop.speed_mm_s for stop in stops
    ]
    return _WORST * max(ran_on, default=0.0)


def _aim_turns(spec: SlideFingerConfig, found: LocatedReference) -> bool:
    """Whether contacts wander round the tip the way they must if the aim turns as described."""
    own = [k for k, item in enumerate(found.touched) if item.finger == spec.name]
    fit = found.fit
    felt = np.unwrap([found.touched[k].angle_rad for k in own])
    towards = -fit.normal[own]
    aims = np.array([found.touched[k].servos_rad[0] for k in own]) / spec.aim.gear_ratio
    bearing = np.unwrap(np.arctan2(towards[:, 1], towards[:, 0]) - aims)
    return len(own) > 1 and float(np.dot(felt - felt.mean(), bearing - bearing.mean())) > 0


def _result(
    spec: SlideFingerConfig,
    stalls: _Stalls | None,
    presses: Sequence[PressMeasurement],
    overshoot: StopLatency,
    *,
    settle_s: float,
    aim_turns: bool,
    aim_friction_a: float,
) -> ActuatorsCalibration:
    if not presses:
        raise InputError(
            f"finger {spec.name}: no approach meets the disc head-on; put it nearer to the middle "
            "and begin again"
        )
    per_rad = mm_per_rad_of(spec)
    play = combined([backlash_of(press, press.counts.sum(axis=(1, 2)), per_rad, _LAG) for press in presses])
    friction = friction_of(presses, per_rad)
    scale, scale_sigma = per_rad, abs(per_rad) * spec.slide.mm_per_turn_spread / math.sqrt(3)
    zero, zero_sigma = spec.slide.zero_mm + per_rad * math.pi, spec.slide.zero_bound_mm / math.sqrt(3)
    if stalls is not None and spec.slide.stops_mm is not None:
        name = f"finger {spec.name}, slide (ID {spec.slide.dxl_id})"
        described = SlideDescription(name, per_rad, spec.slide.mm_per_turn_spread, spec.slide.stops_mm)
        home = homed(described, np.array(stalls.back_rad), np.array(stalls.front_rad), play)
        scale, scale_sigma, zero, zero_sigma = (
            home.mm_per_rad, home.mm_per_rad_sigma, home.zero_mm, home.zero_sigma_mm,
        )  # fmt: skip
    seen = touching(spec, play, _homed(spec, stalls, play))
    slide = SlideCalibration(
        direction_confirmed=friction.way > 0,
        mm_per_turn=2 * math.pi * scale,
        mm_per_turn_sigma=2 * math.pi * scale_sigma,
        zero_mm=zero_in_file_mm(zero, scale),
        zero_sigma_mm=math.hypot(zero_sigma, scale_sigma * math.pi),
        homed=stalls is not None,
        backlash_mm=play.half_mm,
        backlash_sigma_mm=play.sigma_mm,
        touch_zero_mm=seen.zero_mm,
        touch_covariance=seen.covariance.tolist(),
        friction_a=abs(friction.current_a),
        latency_s=overshoot.latency_s,
        latency_bound_s=overshoot.latency_bound_s,
        settle_s=settle_s,
        overshoots=[
            Overshoot(speed_mm_s=row.speed_mm_s, largest_mm=max(row.largest_mm, 0.0), bound_mm=row.bound_mm)
            for row in overshoot.table
        ],
    )
    half = spec.aim.backlash_deg / 2
    aim = AimCalibration(
        direction_confirmed=aim_turns,
        backlash_deg=half,
        backlash_sigma_deg=half / _SIGMAS,
        friction_a=aim_friction_a,
    )
    return ActuatorsCalibration(slide=slide, aim=aim)
