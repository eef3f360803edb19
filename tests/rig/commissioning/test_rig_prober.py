"""The prober on the emulated rig, and a new rig."""

import math
import tomllib
from collections.abc import Iterator
from dataclasses import replace

import pytest

from palpate.base.errors import DeviceError, InputError, SafetyStop
from palpate.calibration.measurements import Probe, ServoPath
from palpate.config import RigFile, SlideFingerConfig
from palpate.config.commissioning_results import ScannedServoOut
from palpate.drivers.tactile.description import Shape
from palpate.rig.arrays import pad_problem
from palpate.rig.commissioning.hand_prober import approaches_of
from palpate.rig.commissioning.new_rig_file import DescribedArray, rig_text
from support.benches.presses import FRICTION_A, HARD_N, ProbedRig, probed_rig, travel_mm
from support.benches.touched_references import FRESH
from support.oracles.array_contacts import describe

# ----------------------------------------------------------------------------------------------------
# What a hand does for calibration with one finger, on the emulated bench, against what is really there.
#
# Stalls against hard stops, swings of the aim, touches, stops at contacts, idle arrays.

STOPS_MM = (43.0, 255.0)
SPEED_MM_S = 20.0
AIM, SLIDE = 11, 12


@pytest.fixture(scope="module")
def connected() -> Iterator[ProbedRig]:
    with probed_rig(1) as found:
        yield found


@pytest.fixture
def rig(connected: ProbedRig) -> ProbedRig:
    """With nothing on the table."""
    connected.prober.clear()
    connected.forget_forces()
    return connected


@pytest.mark.parametrize(("number", "side"), [(0, -1), (1, 1)])
def test_a_slide_stalls_where_its_stop_is(rig: ProbedRig, number: int, side: int) -> None:
    truth, allowed = rig.truth(0), rig.goal_current(SLIDE)
    at = rig.prober.home(0, STOPS_MM[number])
    # The carriage is at its stop, and the drive has gone on by the half play.
    drive = truth.zero_mm + truth.mm_per_rad * at
    assert drive == pytest.approx(STOPS_MM[number] + side * truth.slide_play_mm, abs=0.015), "half a step"
    assert rig.goal_current(SLIDE) == allowed
    assert rig.waits()


def test_where_there_is_no_stop_this_is_said(rig: ProbedRig) -> None:
    with pytest.raises(DeviceError, match=r"slide \(servo 12\) passed 90 mm and met no hard stop; check"):
        rig.prober.home(0, 90.0)


def test_swinging_an_aim_shows_its_friction(rig: ProbedRig) -> None:
    before = rig.session.servos[AIM].shaft_rad
    (friction,) = rig.prober.swing()
    assert 0.5 < friction / FRICTION_A < 1.5
    assert rig.session.servos[AIM].shaft_rad == pytest.approx(before, abs=0.02)


def test_idle_arrays_are_read_as_they_are(rig: ProbedRig) -> None:
    (idle,) = rig.prober.idle(0.2)
    assert idle.finger == "f1"
    assert idle.counts.shape == (50, 8, 20)
    assert idle.time_s[-1] - idle.time_s[0] == pytest.approx(49 / 250, rel=0.02)
    # Untouched: nothing but zeros of about 20 counts and noise of 2, and two dead taxels.
    assert 5 < idle.counts.mean() < 35
    assert (idle.counts.std(axis=0) == 0).sum() == 2


def test_a_touch_ends_at_the_reference_and_a_miss_with_nothing(rig: ProbedRig) -> None:
    rig.put_disc()
    truth, approaches = rig.truth(0), rig.prober.approaches
    (contact,) = rig.head_on()
    lower = contact.approach - 4
    assert aim_rad(approaches[lower]) < aim_rad(approaches[contact.approach]) - 0.1
    assert rig.prober.touch([Probe(lower, 10.0)], 7) == [None]
    (touched,) = rig.prober.touch([Probe(contact.approach, contact.end_mm + 8.0)], 7)
    assert rig.waits()
    assert touched is not None
    assert (touched.finger, touched.placing) == ("f1", 7)
    assert touched.aim_way == 1  # from below
    assert touched.servos_rad[0] == pytest.approx(aim_rad(approaches[contact.approach]), abs=0.01)
    dent = travel_mm(approaches[contact.approach], touched.servos_rad[1]) - contact.end_mm
    assert 0.0 < dent < 0.4
    really = dent * truth.stiffness_n_per_mm
    assert abs(touched.force_n - really) < touched.force_bound_n + 0.05
    off = math.remainder(touched.angle_rad + truth.array_heading_rad, 2 * math.pi)
    assert abs(off) < touched.angle_half_rad + 0.02


def test_stops_end_beyond_the_contact_and_soon(rig: ProbedRig) -> None:
    rig.put_disc()
    contacts = rig.head_on()
    (stop,) = rig.prober.stop(contacts, SPEED_MM_S)
    assert (stop.finger, stop.speed_mm_s) == ("f1", SPEED_MM_S)
    assert stop.samples_s == pytest.approx(1 / 250)
    assert stop.contact_mm == pytest.approx(contacts[0].end_mm)
    beyond = [place - stop.contact_mm for place in (stop.felt_mm, stop.stood_mm)]
    assert 0.0 < beyond[0] <= beyond[1] < SPEED_MM_S * 0.05
    assert 0.3 < rig.hardest_n() <= HARD_N
    assert rig.waits()


def test_a_reference_that_is_gone_ends_a_stop(rig: ProbedRig) -> None:
    rig.put_disc()
    contacts = rig.head_on()
    rig.prober.clear()
    with pytest.raises(DeviceError, match="finger f1 detected no contact where"):
        rig.prober.stop(contacts, SPEED_MM_S)
    assert rig.hardest_n() == 0.0


def test_a_reference_that_is_met_too_soon_ends_a_press(rig: ProbedRig) -> None:
    """It presses no harder than a touch: on the way to a contact fingers went on to max_force_n."""
    rig.put_disc()
    rig.forget_forces()
    contacts = [replace(item, end_mm=item.end_mm + 12.0) for item in rig.head_on()]
    with pytest.raises(SafetyStop, match="finger f1 met something after"):
        rig.prober.press(contacts, 0)
    rig.hand.pause(0.2)  # until it stands
    assert rig.hardest_n() < 0.75 * HARD_N


def test_approaches_stay_within_the_rig_file_s_ranges() -> None:
    found = approaches_of(FRESH)
    assert {item.finger for item in found} == {0, 1, 2}
    for item in found:
        # 100 mm a turn, and 40 mm at Goal Position 0, half a turn before 2048.
        start, end = (90.0 + 100.0 * angle / (2 * math.pi) for angle in item.servos_rad[:, 1])
        assert 45.0 <= start < end <= 250.0
        assert abs(aim_rad(item)) <= math.radians(35.0) * 5.0 + 1e-9


def test_aims_come_from_where_a_contact_finds_their_play_taken_up() -> None:
    """With play that a force may take up: the tip then stands on that flank already."""
    first = FRESH.fingers[0]
    assert isinstance(first, SlideFingerConfig)
    loose = first.model_copy(update={"aim": first.aim.model_copy(update={"backlash_holds_n": 0.0})})
    with probed_rig(1, rig=FRESH.model_copy(update={"fingers": [loose]})) as rig:
        rig.put_disc()
        (contact,) = rig.head_on()
        truth, tip = rig.truth(0), rig.session.bench.fingers[0]
        # To either approach the aim would by itself come from the other side.
        for side, other in ((-1, 4), (1, -4)):
            probe = Probe(contact.approach + other, contact.end_mm + 8.0, side)
            (touched,) = rig.prober.touch([probe], 0)
            assert touched is not None
            assert touched.aim_way == side
            shaft = rig.session.servos[AIM].shaft_rad
            lag = truth.heading_rad + (shaft - truth.aim_zero_rad) / truth.gear_ratio - tip.facing_rad
            assert math.remainder(lag, math.tau) == pytest.approx(side * truth.aim_play_rad)


def aim_rad(approach: ServoPath) -> float:
    return float(approach.servos_rad[0, 0])


# ----------------------------------------------------------------------------------------------------
# A new rig file: pads, and servos that it is not written for: nothing would bound what they press with.


def found(dxl_id: int, model: str | None, number: int) -> ScannedServoOut:
    return ScannedServoOut(
        baudrate_bps=1_000_000,
        id=dxl_id,
        model=model,
        model_number=number,
        firmware=46,
        crowded=False,
        owner=None,
    )


@pytest.mark.parametrize(
    ("model", "number", "words"),
    [
        ("XL430-W250", 1060, 'id 12 is "XL430-W250", which does not report its current'),
        ("2XC430-W250", 1160, "does not report its current"),
        (None, 9999, "id 12 is of a model that palpate does not know"),
    ],
)
def test_servos_that_cannot_be_used_are_named(model: str | None, number: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        rig_text("new", "/dev/ttyUSB0", [found(11, "XM430-W350", 1020), found(12, model, number)], [])


def test_any_other_pair_makes_a_finger() -> None:
    text = rig_text("new", "/dev/ttyUSB0", [found(11, "XM430-W350", 1020), found(12, "XH430-W210", 1010)], [])
    assert 'model = "XH430-W210"' in text


def test_tips_of_flat_arrays_are_pads() -> None:
    flat = DescribedArray("/dev/a", describe(Shape.FLAT, 4, 20, 0.5, 4.0, counts_per_n=2000.0))
    servos = [found(number, "XM430-W350", 1020) for number in (1, 2, 3, 4)]
    text = rig_text("mine", "/dev/b", servos, [flat, "/dev/c"])
    pad, other = RigFile.model_validate(tomllib.loads(text)).fingers
    assert (pad.tip.shape, pad.tip.width_mm, pad.array.pitch_mm) == ("pad", 10.0, 0.5)
    assert pad_problem(pad, flat.description) is None
    assert other.tip.shape == "cylinder"
    assert "answered: 4 × 20 taxels, flat" in text
    assert "palpate calibrate" not in text
    assert "--hold" not in text
    without = rig_text("mine", "/dev/b", servos, ["/dev/a"])
    assert "palpate calibrate" in without
    assert "--hold" in without
