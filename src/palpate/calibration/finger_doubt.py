"""Doubt of one finger: rig files wrong in one thing of it, and whether touches of a calibration agree."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.calibration.consistency_checks import FittedTouches, check_fit
from palpate.calibration.finger_fit import FingerFit, fit_fingers
from palpate.calibration.finger_model import FingerModel
from palpate.calibration.measurements import TouchMeasurement
from palpate.config import FingerConfig
from palpate.config.rig_servos import RotaryConfig, SlideConfig

SIZE_FACTORS = 2.0, 0.5
"""Factors of a radius that was taken for the diameter, or the other way round."""

TRAVEL_FACTORS = *SIZE_FACTORS, math.pi, 1 / math.pi
"""Factors of a travel per turn, with the diameter taken for the circumference, too."""


def rotary_joints(spec: FingerConfig) -> list[str]:
    """Joints of a finger that turn something."""
    return [joint for joint, servo in spec.servos.items() if isinstance(servo, RotaryConfig)]


def with_offset(spec: FingerConfig, joint: str, off: float) -> FingerConfig:
    """The finger with a joint that stands `off` (mm or rad) further than its servo says."""
    servo = spec.servos[joint]
    if isinstance(servo, SlideConfig):
        return _with_servo(spec, joint, zero_mm=servo.zero_mm + off)
    assert isinstance(servo, RotaryConfig), "servos turn something or slide it"
    return _with_servo(spec, joint, zero_deg=servo.zero_deg - math.degrees(off) * servo.gear_ratio)


def with_sign(spec: FingerConfig, joint: str) -> FingerConfig:
    """The finger with a joint that turns the other way; the same without such a joint."""
    servo = spec.servos.get(joint)
    return _with_servo(spec, joint, gear_ratio=-servo.gear_ratio) if isinstance(servo, RotaryConfig) else spec


def with_travel(spec: FingerConfig, factor: float) -> FingerConfig:
    """The finger with a slide that goes `factor` times as far per turn; the same without a slide."""
    for joint, servo in spec.servos.items():
        if isinstance(servo, SlideConfig):
            spec = _with_servo(spec, joint, mm_per_turn=servo.mm_per_turn * factor)
    return spec


def with_tip(spec: FingerConfig, factor: float) -> FingerConfig:
    """The finger with a tip `factor` times as wide."""
    tip = spec.tip.model_copy(update={"radius_mm": spec.tip.radius_mm * factor})
    return spec.model_copy(update={"tip": tip})


def _with_servo(spec: FingerConfig, joint: str, **values: float) -> FingerConfig:
    return spec.model_copy(update={joint: spec.servos[joint].model_copy(update=values)})


def check_fit_of_all(given: FittedTouches) -> None:
    """Refuse a fit as `check_fit` does; InputError names a finger without which the others agree.

    And what is wrong with it, if touches agree with a rig file that is other in one thing only.
    """
    models, touches = given.models, given.touches
    try:
        check_fit(given)
    except InputError as error:
        alone = [
            k
            for k in range(len(models))
            if _agree(replace(given, touches=touches.with_used(touches.used & (touches.finger != k))))
        ]
        if len(alone) != 1:
            raise
        (k,) = alone
        wrong = "what the rig file says of it is wrong"
        for what, change in _alternatives(given.specs[k]):
            if _agree(_with_change(given, [k], change)):
                every = _agree(_with_change(given, range(len(models)), change))
                whose = ", of it or of every finger" if every else ""
                wrong = f"all agree if {what}{whose}: measure, correct it"
                break
        raise InputError(
            f"finger {models[k].name}: its touches contradict those of the others, which agree with the "
            f"references; {wrong}. With it: {error}"
        ) from None


_Change = Callable[[FingerConfig], FingerConfig]


def _with_change(given: FittedTouches, which: Sequence[int], change: _Change) -> FittedTouches:
    """The same touches of a rig file some of whose fingers are told otherwise."""
    specs, models = list(given.specs), list(given.models)
    for k in which:
        specs[k] = change(specs[k])
        models[k] = type(models[k]).nominal(specs[k]).widen(len(models[k].prior))
    return replace(given, specs=specs, models=models)


def _alternatives(spec: FingerConfig) -> Iterator[tuple[str, _Change]]:
    """Ways in which a finger's table may be wrong, and what it then is."""
    for joint in rotary_joints(spec):
        yield f"{joint}.gear_ratio has the other sign", partial(with_sign, joint=joint)
    for factor in SIZE_FACTORS:
        yield f"tip.radius_mm is {factor:g} times as large", partial(with_tip, factor=factor)
    for factor in TRAVEL_FACTORS:
        if with_travel(spec, factor) is not spec:
            yield f"slide.mm_per_turn is {factor:.3g} times as large", partial(with_travel, factor=factor)


def _agree(given: FittedTouches) -> bool:
    """Return whether all that is used agrees, once it is fitted anew."""
    try:
        check_fit(replace(given, fit=fit_fingers(given.models, given.placings, given.touches)))
    except InputError:
        return False
    return True


_MAX_ARRAY_OFF_RAD = math.radians(15.0)
"""In the mean of a finger's touches: what places, gains and friction make of a direction is less."""


def check_arrays(
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    touched: Sequence[TouchMeasurement],
    fit: FingerFit,
) -> None:
    """Refuse arrays that felt a disc elsewhere on their tips than these met it; InputError names the finger.

    `fit`: its last touches are `touched`. Only tips' places and the disc tell where they met.
    """
    normal = fit.normal[len(fit.normal) - len(touched) :]
    for k, (spec, model) in enumerate(zip(specs, models, strict=True)):
        own = [i for i, item in enumerate(touched) if item.finger == spec.name]
        if not own:
            continue
        servos = np.array([touched[i].servos_rad for i in own])
        facing = model.facing_rad(np.tile(fit.values[k], (len(own), 1)), servos, np.zeros_like(servos))
        heading = math.radians(spec.array.heading_deg)
        met = wrap_angle(np.arctan2(-normal[own, 1], -normal[own, 0]) - facing - heading)
        felt = wrap_angle(np.array([touched[i].angle_rad for i in own]))
        limit = _MAX_ARRAY_OFF_RAD + math.radians(spec.array.heading_bound_deg)
        if float(np.abs(wrap_angle(felt - met)).mean()) > limit:
            raise InputError(
                f"finger {spec.name}: its array felt the disc at {_degrees(felt)} from its middle, where its "
                f"tip met it at {_degrees(met)}: the array is turned or mirrored, or a joint goes the other "
                f"way; palpate check --press --move shows which"
            )


def _degrees(angles_rad: Floats) -> str:
    return ", ".join(f"{angle:+.0f}°" for angle in np.degrees(angles_rad))
