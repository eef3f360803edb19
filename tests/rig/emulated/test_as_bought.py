"""Adapters and mechanics as bought: runs end right or with their own message, and never with torque on."""

import pytest
from first_day import ROWS, rig_of, run_row

from palpate.base.errors import InputError
from palpate.rig.contact_peak import bus_latency_s, expected_peak_n

BY_NAME = {row.name: row for row in ROWS}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("latency timer of 16 ms everywhere", "right"),
        ("an array resets in a run", "right"),
        ("3 … 4 times the friction at rest", "message"),
    ],
)
def test_a_run_ends_as_its_row_says(name: str, kind: str) -> None:
    found = run_row(BY_NAME[name], 1)
    assert (found.kind, found.torque_on) == (kind, ()), found


def test_torque_is_off_after_the_bus_came_back_under_another_name_which_is_said() -> None:
    found = run_row(BY_NAME["bus's adapter comes back under another name"], 2)
    assert (found.kind, found.torque_on) == ("message", ())
    assert "has come back as" in found.text
    assert "/dev/serial/by-id" in found.text


def test_a_screw_that_slips_is_found_at_the_stops() -> None:
    found = run_row(BY_NAME["a screw that slips, with check_slips"], 4)
    assert (found.kind, found.torque_on) == ("message", ()), found
    assert "finger f2: its slide (servo 22) meets its back stop" in found.text


def test_slips_cannot_be_checked_without_stops() -> None:
    row = BY_NAME["a screw that slips, with check_slips"]
    with pytest.raises(ValueError, match=r"no slide\.stops_mm to meet"):
        rig_of(type(row)(row.name, row.emulation, bounds=row.bounds[:1]))


def test_latency_is_in_the_expected_peak() -> None:
    quick, slow = (rig_of(BY_NAME[name]) for name in ("as it should be", "latency timer of 16 ms everywhere"))
    assert bus_latency_s(slow) == pytest.approx(0.034)
    more_mm = quick.closing.search_mm_s * (0.034 - 0.001 + 0.016)
    stiffest = max(finger.tip.stiffness_n_per_mm for finger in quick.fingers)
    speed = quick.closing.search_mm_s
    assert expected_peak_n(slow, speed) - expected_peak_n(quick, speed) == pytest.approx(stiffest * more_mm)


def test_slides_that_give_way_more_than_declared_are_refused() -> None:
    row = BY_NAME["slides that give way under load"]
    with pytest.raises((InputError, ValueError), match="beyond the bound"):
        rig_of(type(row)(row.name, row.emulation))
