"""Refusal of touches that one finger's wrong table makes contradict the others'."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from palpate.base.errors import InputError
from palpate.base.geometry.plane import wrap_angle
from palpate.calibration.consistency_checks import FittedTouches, check_fit
from palpate.calibration.finger_doubt import check_arrays, check_fit_of_all, with_sign, with_travel
from palpate.calibration.finger_fit import FingerFit, TouchArrays, fit_fingers
from palpate.calibration.measurements import TouchMeasurement
from palpate.calibration.slide_model import SlideModel
from palpate.config import FingerConfig, SlideFingerConfig
from support.benches.touched_references import (
    AIM_ZEROS_RAD,
    GEARS,
    MM_PER_RAD,
    SPECS,
    models,
    placings,
    some_places,
    touches,
)


def true_specs() -> list[SlideFingerConfig]:
    """The rig file of the fingers that touch."""
    found = []
    for spec, gear, zero, per_rad in zip(SPECS, GEARS, AIM_ZEROS_RAD, MM_PER_RAD, strict=True):
        aim = spec.aim.model_copy(update={"gear_ratio": gear, "zero_deg": 180 + math.degrees(zero)})
        per_turn = {"mm_per_turn": 2 * math.pi * per_rad, "zero_mm": 90.0 - math.pi * per_rad}
        slide = spec.slide.model_copy(update=per_turn)
        found.append(spec.model_copy(update={"aim": aim, "slide": slide}))
    return found


def refusal(told: list[FingerConfig]) -> str | None:
    """What is refused of touches by fingers that are as `true_specs` says, and were told otherwise."""
    values = np.array([model.prior for model in models()])
    rng = np.random.default_rng(5)
    given = touches(values, some_places(rng), rng)
    fingers = [SlideModel.nominal(spec) for spec in told]
    fitted = FittedTouches(told, fingers, placings(), given, fit_fingers(fingers, placings(), given))
    try:
        check_fit_of_all(fitted)
    except InputError as error:
        with pytest.raises(InputError):
            check_fit(fitted)
        return str(error)
    return None


def test_true_tables_are_not_doubted() -> None:
    assert refusal(list(true_specs())) is None


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda spec: with_sign(spec, "aim"), "aim.gear_ratio"),
        pytest.param(
            lambda spec: with_travel(spec, 0.5), "mm_per_turn is 2 times", marks=pytest.mark.campaign
        ),
    ],
)
def test_the_wrong_finger_and_its_key_are_named(
    change: Callable[[FingerConfig], FingerConfig], key: str
) -> None:
    told: list[FingerConfig] = list(true_specs())
    told[1] = change(told[1])
    said = refusal(told)
    assert said is not None
    assert said.startswith(f"finger {told[1].name}: ")
    assert key in said


def felt_by(given: TouchArrays, fit: FingerFit, seen: Callable[[float], float]) -> list[TouchMeasurement]:
    """Touches of arrays that felt at `seen` (rad) what their tips met at another angle; the first is true."""
    towards = np.arctan2(-fit.normal[:, 1], -fit.normal[:, 0])
    found = []
    for k, finger in enumerate(given.finger.tolist()):
        servos = given.servos_rad[k : k + 1]
        facing = models()[finger].facing_rad(fit.values[finger : finger + 1], servos, np.zeros((1, 2)))
        spec = SPECS[finger]
        met = float(wrap_angle(towards[k] - facing[0] - math.radians(spec.array.heading_deg)))
        at, aim, slide = met if finger == 0 else seen(met), *servos[0].tolist()
        found.append(TouchMeasurement(spec.name, 0, (aim, slide), 1, at, 0.1, 0.4, 0.1))
    return found


@pytest.mark.parametrize(
    ("seen", "refused"),
    [
        (lambda met: met + math.radians(8), False),  # a mounting that calibration finds
        (lambda met: met + math.radians(54), True),  # turned by four columns
        (lambda met: met - math.radians(108), True),
        (lambda met: -met, True),  # mirrored, or upside down
    ],
)
def test_an_array_that_feels_the_disc_elsewhere_is_refused_with_its_finger(
    seen: Callable[[float], float], refused: bool
) -> None:
    values = np.array([model.prior for model in models()])
    rng = np.random.default_rng(6)
    given = touches(values, some_places(rng)[:1], rng)
    fit = fit_fingers(models(), placings()[:1], given)
    felt = felt_by(given, fit, seen)
    if not refused:
        check_arrays(SPECS, models(), felt, fit)
        return
    with pytest.raises(InputError, match=f"finger {SPECS[1].name}: its array felt the disc at "):
        check_arrays(SPECS, models(), felt, fit)
