"""What a hand does for calibration: touches on the emulated bench against where things really are."""

import math

import pytest
from probed_rig import probed_rig
from touched_references import FRESH

from palpate.calibration.prober import Probe
from palpate.config import load_rig, shipped_rig
from palpate.rig.rig_prober import approaches_of


def test_a_touch_ends_at_the_reference_and_a_miss_with_nothing() -> None:
    with probed_rig(1) as rig:
        rig.put_disc()
        truth, approaches = rig.truth(0), rig.prober.approaches
        (contact,) = rig.head_on()
        turned = approaches[contact.approach].aim_rad
        lowest = min(range(len(approaches)), key=lambda k: approaches[k].aim_rad)
        short = approaches[lowest].start_rad + 20.0 / truth.mm_per_rad
        missed = rig.prober.touch([Probe(lowest, short)], 7)
        (touched,) = rig.prober.touch([Probe(contact.approach, contact.end_rad + 0.5)], 7)
        waits = rig.waits()
    assert missed == [None]
    assert touched is not None
    assert (touched.finger, touched.placing) == ("f1", 7)
    assert touched.aim_way == 1  # from below
    assert touched.servos_rad[0] == pytest.approx(turned, abs=0.01)
    dent = (touched.servos_rad[1] - contact.end_rad) * truth.mm_per_rad
    assert 0.0 < dent < 0.4
    # Gains are only known to be within ± 40 %, stiffness within 20 %.
    assert touched.force_n - touched.force_bound_n <= dent * truth.stiffness_n_per_mm + 0.05
    assert touched.force_n + touched.force_bound_n >= dent * truth.stiffness_n_per_mm - 0.05
    off = math.remainder(touched.angle_rad + truth.array_heading_rad, 2 * math.pi)
    assert abs(off) < touched.angle_half_rad + 0.02
    assert waits


@pytest.mark.parametrize("rig", [FRESH, load_rig(shipped_rig())], ids=lambda rig: rig.name)
def test_approaches_stay_within_the_rig_file_s_ranges(rig: object) -> None:
    assert isinstance(rig, type(FRESH))
    found = approaches_of(rig)
    assert {item.finger for item in found} == {0, 1, 2}
    for item in found:
        spec = FRESH.fingers[item.finger]
        per_rad = 100.0 / (2 * math.pi)
        start, end = (90.0 + per_rad * angle for angle in (item.start_rad, item.end_rad))
        assert 45.0 <= start < end <= 250.0
        assert abs(item.aim_rad) <= math.radians(35.0) * 5.0 + 1e-9
        assert spec.name == f"f{item.finger + 1}"
