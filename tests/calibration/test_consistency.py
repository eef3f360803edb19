"""References that are not what they should be are refused, by name; the right ones pass."""

from dataclasses import replace

import numpy as np
import pytest
from touched_references import (
    SIGMA_MM,
    SPECS,
    Laid,
    models,
    nearly,
    placings,
    some_places,
    touches,
)

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.calibration.consistency_checks import check_fit, check_still, estimate_growth
from palpate.calibration.finger_fit import FingerFit, TouchArrays, fit_fingers
from palpate.calibration.measurements import TouchMeasurement
from palpate.calibration.reference import ReferenceDisc
from palpate.drivers.kinematics import TICK_RAD

PLATES = np.array([False, False, True, True])


def within_bounds(rng: np.random.Generator) -> Floats:
    """Fingers as the rig file allows them."""
    found = []
    for model in models():
        sigma = np.sqrt(np.diag(model.covariance))
        found.append(model.prior + sigma * rng.uniform(-1.0, 1.0, len(sigma)))
    return np.array(found)


def touched(
    seed: int, grown_mm: tuple[float, float] = (0.0, 0.0), sigma_mm: float = SIGMA_MM
) -> tuple[list[Laid], TouchArrays]:
    rng = np.random.default_rng(seed)
    values, where = within_bounds(rng), some_places(rng, grown_mm)
    return where, touches(values, where, rng, sigma_mm=sigma_mm)


def fitted(where: list[Laid], given: TouchArrays) -> FingerFit:
    return fit_fingers(models(), placings(), given, nearly(where))


def checked(where: list[Laid], given: TouchArrays) -> None:
    check_fit(SPECS, models(), placings(), given, fitted(where, given))


@pytest.mark.parametrize("seed", range(5))
def test_references_as_given_pass(seed: int) -> None:
    where, given = touched(seed)
    checked(where, given)


@pytest.mark.parametrize("grown_mm", [(0.0, 0.3), (-0.3, 0.0), (0.3, 0.0)])
@pytest.mark.parametrize("seed", range(2))
def test_one_of_another_size_is_refused(seed: int, grown_mm: tuple[float, float]) -> None:
    where, given = touched(seed, grown_mm)
    size = "large" if grown_mm[1] > grown_mm[0] else "small"
    words = f"the plate seems 0.* mm too {size} all round beside the disc"
    # Now and then so many touches of one placing are left out that this is said first.
    with pytest.raises(InputError, match=f"{words}|(disc|plate) near .* do not agree with its shape"):
        checked(where, given)


@pytest.mark.parametrize("seed", range(3))
def test_how_much_larger_one_is_comes_out(seed: int) -> None:
    where, given = touched(seed, (0.0, 0.05))
    found, sigma = estimate_growth(models(), placings(), given, fitted(where, given), PLATES)
    assert abs(found - 0.05) < 4 * sigma
    assert sigma < 0.03
    # The same as seen from the other side.
    other, again = estimate_growth(models(), placings(), given, fitted(where, given), ~PLATES)
    assert abs(other + 0.05) < 4 * again


def test_what_was_never_touched_has_no_size() -> None:
    where, given = touched(0)
    found, sigma = estimate_growth(models(), placings(), given, fitted(where, given), np.zeros(4, dtype=bool))
    assert (found, sigma) == (0.0, np.inf)


def test_a_tolerance_is_granted() -> None:
    where, given = touched(2, (-0.07, 0.0))
    fit = fitted(where, given)
    with pytest.raises(InputError, match="too large all round beside the disc"):
        check_fit(SPECS, models(), placings(), given, fit)
    loose = [
        replace(placing, reference=ReferenceDisc("disc", 25.0, 0.1))
        if placing.reference.name == "disc"
        else placing
        for placing in placings()
    ]
    check_fit(SPECS, models(), loose, given, fit)


@pytest.mark.parametrize("number", range(4))
def test_one_that_moved_between_touches_is_refused(number: int) -> None:
    """Half of a placing's touches were made when it lay 0.3 mm further on."""
    rng = np.random.default_rng(20 + number)
    values, where = within_bounds(rng), some_places(rng)
    before = touches(values, where, rng)
    shift = 0.3 * np.array([np.cos(number), np.sin(number)])
    place = where[number]
    corners = None if place.corners_mm is None else place.corners_mm + shift
    later = list(where)
    later[number] = replace(place, centre_mm=place.centre_mm + shift, corners_mm=corners)
    after = touches(values, later, rng)
    first = np.flatnonzero((before.placing != number) | (np.arange(len(before.placing)) % 2 == 0))
    second = np.flatnonzero((after.placing == number) & (np.arange(len(after.placing)) % 2 == 1))
    given = joined(before, first, after, second)
    with pytest.raises(InputError, match=f"{placings()[number].reference.name} near .*(moved|stand still)"):
        checked(where, given)


def joined(one: TouchArrays, first: Ints, other: TouchArrays, second: Ints) -> TouchArrays:
    """Some touches of both."""
    names = ("finger", "placing", "servos_rad", "ways", "dent_mm", "sigma_mm", "used")
    return TouchArrays(*(np.concatenate([getattr(one, k)[first], getattr(other, k)[second]]) for k in names))


def test_references_that_are_all_too_large_make_a_tip_too_large() -> None:
    """Nothing else can be seen of it: tips would be smaller or larger by as much."""
    where, given = touched(3, (1.0, 1.0), sigma_mm=0.004)
    with pytest.raises(InputError, match=r"finger f\d: its tip would have a radius of .* says 5 ± 0.3"):
        checked(where, given)


def once_more(first: list[TouchMeasurement], off_mm: float) -> list[TouchMeasurement]:
    per_rad = models()[0].mm_per_rad
    item = first[0]
    aim, slide = item.servos_rad
    return [replace(item, servos_rad=(aim, slide + off_mm / per_rad)), *first[1:]]


def test_the_same_touches_again_tell_whether_it_has_moved() -> None:
    first = [
        TouchMeasurement(spec.name, 0, (0.1, 4.0 + k), 1, 0.0, 0.1, 0.5, 0.1) for k, spec in enumerate(SPECS)
    ]
    placing = placings()[1]
    check_still(first, once_more(first, 0.04), models(), placing)
    with pytest.raises(InputError, match=r"disc near \(35, 20\) mm: finger f1 met it 0.30 mm from where"):
        check_still(first, once_more(first, -0.3), models(), placing)
    with pytest.raises(
        InputError, match=r"disc near \(35, 20\) mm: finger f2 touched it at first and missed"
    ):
        check_still(first, [first[0], first[2]], models(), placing)


def test_an_aim_that_came_from_the_other_side_explains_some_of_it() -> None:
    """It rests a few encoder steps elsewhere, and an oblique touch is met later or sooner."""
    first = [
        TouchMeasurement(spec.name, 0, (0.1, 4.0 + k), 1, 0.0, 0.1, 0.5, 0.1) for k, spec in enumerate(SPECS)
    ]
    placing = placings()[1]
    further = once_more(first, 0.25)
    with pytest.raises(InputError, match=r"finger f1 met it 0.25 mm from where"):
        check_still(first, further, models(), placing)
    aim, slide = further[0].servos_rad
    turned = [replace(further[0], servos_rad=(aim + 4 * TICK_RAD, slide)), *further[1:]]
    check_still(first, turned, models(), placing)
    with pytest.raises(InputError, match=r"finger f1 met it 1.00 mm from where"):
        check_still(first, once_more(turned, 0.75), models(), placing)
