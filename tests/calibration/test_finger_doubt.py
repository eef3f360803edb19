"""Refusal of touches that one finger's wrong table makes contradict the others'."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from palpate.base.errors import InputError
from palpate.calibration.consistency_checks import check_fit
from palpate.calibration.finger_doubt import check_fit_of_all, with_sign, with_travel
from palpate.calibration.finger_fit import fit_fingers
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
    fit = fit_fingers(fingers, placings(), given)
    try:
        check_fit_of_all(told, fingers, placings(), given, fit)
    except InputError as error:
        with pytest.raises(InputError):
            check_fit(told, fingers, placings(), given, fit)
        return str(error)
    return None


def test_true_tables_are_not_doubted() -> None:
    assert refusal(list(true_specs())) is None


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda spec: with_sign(spec, "aim"), "aim.gear_ratio"),
        pytest.param(lambda spec: with_travel(spec, 0.5), "mm_per_turn is 2 times", marks=pytest.mark.slow),
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
