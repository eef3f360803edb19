"""Whether touches agree with a calibration: by chance as seldom as stated, and not when something moved."""

import math

import numpy as np
import pytest
from firm_rig import firm_rig
from scipy.stats import chi2
from truth_calibration import truth_calibration

from palpate.base.geometry import Floats
from palpate.calibration.drift_test import (
    FALSE_ALARM_RATE,
    ContactUncertainty,
    SurfaceContacts,
    compare_touches,
    contact_uncertainties,
    touch_covariance,
)
from palpate.config import RigFile, load_rig
from palpate.rig.emulated.devices import emulate

RIG: RigFile = load_rig(firm_rig())
PROMISES = [ContactUncertainty(0.012, 0.02, 0.0, 0.03, 3.29)] * 3


def disc_touches(rng: np.random.Generator, each: int = 5) -> SurfaceContacts:
    """Touches round a disc by three fingers, up to 45° from head-on."""
    finger = np.repeat(np.arange(3), each)
    facing = 2 * math.pi / 3 * finger
    angle = facing + rng.uniform(-math.pi / 4, math.pi / 4, len(finger))
    return SurfaceContacts(
        finger=finger,
        normal=np.column_stack([np.cos(angle), np.sin(angle)]),
        travel=-np.column_stack([np.cos(facing), np.sin(facing)]),
        dent_mm=np.full(len(finger), 0.02),
        tolerance_mm=0.01,
    )


def slid(surface: SurfaceContacts) -> Floats:
    """Derivatives of touches' residuals by the disc's place."""
    return -surface.normal


def felt(surface: SurfaceContacts, rng: np.random.Generator) -> Floats:
    """Residuals as a rig makes them that is as promised, the disc anywhere near."""
    count = len(surface.finger)
    across = np.sqrt(1 - (surface.normal * surface.travel).sum(axis=1) ** 2)
    bases = rng.normal(0, 0.02, (3, 2))[surface.finger]
    own = rng.normal(0, 0.012, count) + across * 0.03 * rng.normal(0, 1, count)
    own += rng.normal(0, 0.02 / 3.29, count) + rng.uniform(-0.01, 0.01, count)
    return own + (bases * surface.normal).sum(axis=1) + slid(surface) @ rng.uniform(-3, 3, 2)


def test_alarms_are_false_as_seldom_as_stated() -> None:
    rng = np.random.default_rng(1)
    runs, alarms, squares = 2000, 0, 0.0
    for _ in range(runs):
        surface = disc_touches(rng)
        found = compare_touches(felt(surface, rng), slid(surface), touch_covariance(surface, PROMISES))
        assert found is not None
        assert found.freedom == 13
        alarms += found.drifted
        squares += found.chi_square
    assert squares / runs == pytest.approx(13, abs=4 * math.sqrt(26 / runs))
    assert alarms <= 3 * FALSE_ALARM_RATE * runs
    assert chi2.sf(34.53, 13) == pytest.approx(FALSE_ALARM_RATE, rel=0.01), "a table's value"


def test_a_finger_that_moved_is_noticed() -> None:
    rng = np.random.default_rng(2)
    noticed = 0
    for _ in range(100):
        surface = disc_touches(rng)
        moved = np.where(surface.finger == 1, surface.normal @ [0.0, 0.3], 0.0)
        found = compare_touches(
            felt(surface, rng) + moved, slid(surface), touch_covariance(surface, PROMISES)
        )
        assert found is not None
        assert found.rms_mm > 0
        noticed += found.drifted
    assert noticed >= 95


def test_what_is_expected_is_what_comes() -> None:
    rng = np.random.default_rng(3)
    surface = disc_touches(rng)
    covariance = touch_covariance(surface, PROMISES)
    found = [compare_touches(felt(surface, rng), slid(surface), covariance) for _ in range(600)]
    squares = [item.rms_mm**2 for item in found if item is not None]
    assert found[0] is not None
    assert math.sqrt(float(np.mean(squares))) == pytest.approx(found[0].expected_rms_mm, rel=0.08)


def test_what_cannot_be_told_is_not_told() -> None:
    """As many touches as unknowns fit anything; unknowns that no touch shows do not count."""
    surface = disc_touches(np.random.default_rng(4), each=1)
    covariance = touch_covariance(surface, PROMISES)
    assert compare_touches(np.ones(3), np.eye(3), covariance) is None
    blind = np.column_stack([slid(surface), np.zeros(3)])
    found = compare_touches(np.ones(3), blind, covariance)
    assert found is not None
    assert found.freedom == 1


def test_promises_are_the_deviations_behind_the_bounds() -> None:
    file = truth_calibration(RIG, emulate(RIG, None, 0).bench.fingers)
    promises = contact_uncertainties(file, at_rest=False)
    assert promises is not None
    assert [item.scatter_mm for item in promises] == pytest.approx([0.003 * math.sqrt(160 / 140)] * 3)
    assert [item.fit_mm for item in promises] == pytest.approx([0.006] * 3, rel=2e-3)
    assert promises[0].sigmas == pytest.approx(3.2905, abs=1e-4)
    assert contact_uncertainties(file.model_copy(update={"residuals": None}), at_rest=False) is None
    bare = [file.fingers[0].model_copy(update={"bounds": None}), *file.fingers[1:]]
    assert contact_uncertainties(file.model_copy(update={"fingers": bare}), at_rest=False) is None


def test_slides_at_rest_may_be_half_a_step_from_where_they_seem() -> None:
    """Touches of a session scatter by steps that touches of the calibration, on the move, do not show."""
    file = truth_calibration(RIG, emulate(RIG, None, 0).bench.fingers)
    moving, resting = contact_uncertainties(file, at_rest=False), contact_uncertainties(file, at_rest=True)
    assert moving is not None
    assert resting is not None
    for item, still, finger in zip(moving, resting, file.fingers, strict=True):
        assert finger.bounds is not None
        assert item.along_mm == 0
        assert still.along_mm == pytest.approx(100 / 4096 / 2, rel=0.01)
        parts = finger.bounds.parts_mm
        aim = still.across_mm**2 - parts.play**2 / 3
        assert math.sqrt(aim + still.along_mm**2) == pytest.approx(parts.quantisation)
        assert item.across_mm == pytest.approx(parts.play / math.sqrt(3))
