"""References: consistency, agreement, placing by touch."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.calibration.consistency_checks import (
    FALSE_ALARM_RATE,
    ContactUncertainty,
    FittedTouches,
    SurfaceContacts,
    check_fit,
    check_still,
    compare_touches,
    contact_uncertainties,
    estimate_growth,
    touch_covariance,
)
from palpate.calibration.finger_fit import FingerFit, ReferencePlacement, TouchArrays, fit_fingers
from palpate.calibration.finger_step import plan_placements, touch_placing
from palpate.calibration.measurements import Probe, Reference, ReferenceDisc, ReferencePlate, TouchMeasurement
from palpate.calibration.rig_models import nominal_models
from palpate.config import RigFile, load_rig
from palpate.drivers.kinematics import TICK_RAD
from palpate.rig.emulated.devices import emulate
from support.benches.calibration_files import truth_calibration
from support.benches.rigs import firm_rig
from support.benches.simulated_rig import SimulatedProber, SimulatedRig
from support.benches.touched_references import (
    DISC,
    ENCODERS,
    FRESH,
    SIGMA_MM,
    SPECS,
    Laid,
    models,
    nearly,
    placings,
    some_places,
    touches,
)

# ----------------------------------------------------------------------------------------------------
# References that are not what they should be are refused, by name; the right ones pass.

PLATES = np.array([False, False, True, True])


def within_bounds(rng: np.random.Generator) -> Floats:
    """Fingers as the rig file allows them."""
    found = []
    for model in models():
        sigma = np.sqrt(np.diag(model.covariance))
        found.append(model.prior + sigma * np.append(rng.uniform(-1.0, 1.0, ENCODERS.start), np.zeros(8)))
    return np.array(found)


def touched(
    seed: int, grown_mm: tuple[float, float] = (0.0, 0.0), sigma_mm: float = SIGMA_MM
) -> tuple[list[Laid], TouchArrays]:
    rng = np.random.default_rng(seed)
    values, where = within_bounds(rng), some_places(rng, grown_mm)
    return where, touches(values, where, rng, sigma_mm=sigma_mm)


def fitted(where: list[Laid], given: TouchArrays) -> FingerFit:
    return fit_fingers(models(), placings(), given, nearly(where))


def with_fit(where: list[Laid], given: TouchArrays) -> FittedTouches:
    return FittedTouches(SPECS, models(), placings(), given, fitted(where, given))


def checked(where: list[Laid], given: TouchArrays) -> None:
    check_fit(with_fit(where, given))


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
    found, sigma = estimate_growth(with_fit(where, given), PLATES)
    assert abs(found - 0.05) < 4 * sigma
    assert sigma < 0.03
    # The same as seen from the other side.
    other, again = estimate_growth(with_fit(where, given), ~PLATES)
    assert abs(other + 0.05) < 4 * again


def test_what_was_never_touched_has_no_size() -> None:
    where, given = touched(0)
    found, sigma = estimate_growth(with_fit(where, given), np.zeros(4, dtype=bool))
    assert (found, sigma) == (0.0, np.inf)


def test_a_tolerance_is_granted() -> None:
    where, given = touched(2, (-0.07, 0.0))
    fit = fitted(where, given)
    with pytest.raises(InputError, match="too large all round beside the disc"):
        check_fit(FittedTouches(SPECS, models(), placings(), given, fit))
    loose = [
        replace(placing, reference=ReferenceDisc("disc", 25.0, 0.1))
        if placing.reference.name == "disc"
        else placing
        for placing in placings()
    ]
    check_fit(FittedTouches(SPECS, models(), loose, given, fit))


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


def first_touches() -> list[TouchMeasurement]:
    return [
        TouchMeasurement(spec.name, 0, (0.1, 4.0 + k), 1, 0.0, 0.1, 0.5, 0.1) for k, spec in enumerate(SPECS)
    ]


def once_more(first: list[TouchMeasurement], off_mm: float) -> list[TouchMeasurement]:
    per_rad = models()[0].mm_per_rad
    item = first[0]
    aim, slide = item.servos_rad
    return [replace(item, servos_rad=(aim, slide + off_mm / per_rad)), *first[1:]]


def test_the_same_touches_again_tell_whether_it_has_moved() -> None:
    first, placing = first_touches(), placings()[1]
    check_still(first, once_more(first, 0.04), models(), placing)
    with pytest.raises(InputError, match=r"disc near \(35, 20\) mm: finger f1 met it 0.30 mm from where"):
        check_still(first, once_more(first, -0.3), models(), placing)
    with pytest.raises(
        InputError, match=r"disc near \(35, 20\) mm: finger f2 touched it at first and missed"
    ):
        check_still(first, [first[0], first[2]], models(), placing)


def test_an_aim_that_came_from_the_other_side_explains_some_of_it() -> None:
    """It rests a few encoder steps elsewhere, and an oblique touch is met later or sooner."""
    first, placing = first_touches(), placings()[1]
    further = once_more(first, 0.25)
    with pytest.raises(InputError, match=r"finger f1 met it 0.25 mm from where"):
        check_still(first, further, models(), placing)
    aim, slide = further[0].servos_rad
    turned = [replace(further[0], servos_rad=(aim + 4 * TICK_RAD, slide)), *further[1:]]
    check_still(first, turned, models(), placing)
    with pytest.raises(InputError, match=r"finger f1 met it 1.00 mm from where"):
        check_still(first, once_more(turned, 0.75), models(), placing)


# ----------------------------------------------------------------------------------------------------
# Whether touches agree with a calibration: by chance as seldom as stated, and not when something moved.

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
    file = truth_calibration(RIG, emulate(RIG, (), 0).bench.fingers)
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
    file = truth_calibration(RIG, emulate(RIG, (), 0).bench.fingers)
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


# ----------------------------------------------------------------------------------------------------
# A placing from its first touch to its last: the grip that is made again is the first that met something.

LOOKS = 3  # grips that look for the first reference


class MissingOnce(SimulatedProber):
    """The first grip after those that look for the reference meets nothing."""

    def __init__(self, world: SimulatedRig, rig: RigFile) -> None:
        super().__init__(world, rig)
        self.grips: list[list[Probe]] = []

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        self.grips.append(list(grip))
        found = super().touch(grip, placing)
        return [None] * len(found) if len(self.grips) == LOOKS + 1 else found


def test_the_grip_that_is_made_again_met_something_at_first() -> None:
    rig = FRESH.model_copy(update={"fingers": FRESH.fingers[:1]})
    prober = MissingOnce(SimulatedRig(rig, 3), rig)
    placings = [ReferencePlacement(DISC, (0.0, 0.0))]
    touched = touch_placing(
        prober, rig.fingers, nominal_models(rig.fingers), placings, [], tell=lambda _: None
    )
    assert prober.grips[-1] == prober.grips[LOOKS + 1]
    assert len(touched) == len(prober.grips) - 1


# ----------------------------------------------------------------------------------------------------
# Distances from references against shapely, their normals and rooms, and what is refused as a plate.

FEW = settings(max_examples=40)
STEP_MM = 1e-5


@st.composite
def plates(draw: st.DrawFn) -> ReferencePlate:
    """Hulls of random points, with faces long enough to be touched; either way round."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    hull = shapely.MultiPoint(rng.uniform(-50, 50, (int(rng.integers(3, 12)), 2))).convex_hull
    assume(isinstance(hull, shapely.Polygon))
    corners = np.array(hull.exterior.coords)[:-1]
    assume(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).min() > 2.0)
    return ReferencePlate("plate", corners[:: draw(st.sampled_from([1, -1]))])


def points(seed: int) -> Floats:
    return np.random.default_rng(seed).uniform(-70, 70, (30, 2))


def regular(count: int, radius_mm: float = 30.0) -> Floats:
    angle = 2 * math.pi * np.arange(count) / count
    return radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])


@FEW
@given(plates(), st.integers(0, 2**32 - 1))
def test_distances_from_a_plate_are_shapely_s(plate: ReferencePlate, seed: int) -> None:
    shape, at = shapely.Polygon(plate.corners_mm), points(seed)
    distance, normal, room = plate.distance_mm(at)
    rim = shapely.distance(shape.exterior, shapely.points(at))
    inside = shapely.contains(shape, shapely.points(at))
    assert distance == pytest.approx(np.where(inside, -rim, rim), abs=1e-9)
    # Going back along the normal by the distance ends on the rim, at its nearest point.
    foot = at - distance[:, None] * normal
    assert shapely.distance(shape.exterior, shapely.points(foot)) == pytest.approx(0.0, abs=1e-9)
    ends = np.stack([plate.corners_mm, np.roll(plate.corners_mm, -1, axis=0)], axis=1)
    face = shapely.distance(shapely.linestrings(ends)[:, None], shapely.points(foot)).argmin(axis=0)
    to_ends = np.linalg.norm(ends[face] - foot[:, None, :], axis=2)
    assert room == pytest.approx(to_ends.min(axis=1), abs=1e-6)
    assert np.hypot(*normal.T) == pytest.approx(1.0)
    assert np.hypot(*plate.corners_mm.T).max() == pytest.approx(plate.radius_mm)
    assert (shape.centroid.x, shape.centroid.y) == pytest.approx((0.0, 0.0), abs=1e-9)


@FEW
@given(
    st.one_of(plates(), st.builds(ReferenceDisc, st.just("disc"), st.floats(5.0, 60.0))),
    st.integers(0, 2**32 - 1),
)
def test_normals_are_the_slopes_of_distances(reference: Reference, seed: int) -> None:
    at = points(seed)
    at = at[np.abs(reference.distance_mm(at)[0]) > 1e-3]
    _, normal, _ = reference.distance_mm(at)
    slope = np.empty_like(at)
    for axis, step in enumerate(STEP_MM * np.eye(2)):
        ahead, behind = reference.distance_mm(at + step)[0], reference.distance_mm(at - step)[0]
        slope[:, axis] = (ahead - behind) / (2 * STEP_MM)
    smooth = np.abs(np.hypot(*slope.T) - 1) < 1e-3  # inside a plate distances have ridges
    assert smooth.mean() > 0.9
    assert normal[smooth] == pytest.approx(slope[smooth], abs=2e-3)


def test_a_disc_is_round() -> None:
    disc = ReferenceDisc("disc", 25.0)
    distance, normal, room = disc.distance_mm(np.array([[30.0, 40.0], [0.0, -10.0]]))
    assert distance == pytest.approx([25.0, -15.0])
    assert normal == pytest.approx(np.array([[0.6, 0.8], [0.0, -1.0]]))
    assert np.isinf(room).all()
    assert disc.curvature_per_mm() == pytest.approx(0.04)


@pytest.mark.parametrize("count", [3, 4, 5, 6, 8])
def test_regular_plates_look_the_same_so_often(count: int) -> None:
    assert ReferencePlate("plate", regular(count) + np.array([7.0, -3.0])).repeats == count


def test_other_plates_repeat_less() -> None:
    assert (
        ReferencePlate("plate", np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [0.0, 40.0]])).repeats == 2
    )
    assert ReferencePlate("plate", np.array([[0.0, 0.0], [60.0, 0.0], [0.0, 40.0]])).repeats == 1
    assert ReferencePlate("plate", regular(4) * [1.0, 0.9]).repeats == 2
    # A hexagon whose corners are cut in turns: three times a turn.
    radius = np.where(np.arange(6) % 2, 30.0, 27.0)[:, None]
    assert ReferencePlate("plate", regular(6, 1.0) * radius).repeats == 3


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0], [40, 0], [20, 10], [20, 40]],  # a notch
        [[0, 0], [20, 0], [40, 0], [40, 40], [0, 40]],  # a corner that is none
        [[0, 0], [40, 40], [40, 0], [0, 40]],  # a bow tie
        [[0, 0], [40, 0], [80, 0]],  # no area
    ],
)
def test_plates_that_are_not_convex_are_refused(corners: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="is not convex"):
        ReferencePlate("plate", np.array(corners))


def test_references_are_put_inside_the_workspace_and_apart() -> None:
    disc, plate = ReferenceDisc("disc", 25.0), ReferencePlate("plate", regular(4, 40 * math.sqrt(2)))
    placings = plan_placements(disc, plate, FRESH)
    assert [item.reference.name for item in placings] == ["disc"] * 3 + ["plate"] * 3
    for placing in placings:
        assert math.hypot(*placing.about_mm) + placing.reference.radius_mm <= 125.0
    bearings = [
        math.degrees(math.atan2(*placing.about_mm)) % 360 for placing in placings if any(placing.about_mm)
    ]
    assert np.diff(sorted(bearings)) == pytest.approx(60.0)
