"""Servos of two voltages on one bus: cables pass the supply on, and the higher one destroys the others."""

import re

import pytest
from repository import ROOT

from palpate.drivers.dynamixel.models import SPECIFICATIONS, supply_warnings


@pytest.mark.parametrize("models", [[], ["XM430-W350"] * 3, ["XL330-M288", "XC330-M288"], ["AX-12A"]])
def test_one_voltage_is_fine(models: list[str]) -> None:
    assert supply_warnings(models) == []


def test_two_voltages_are_named_with_their_models() -> None:
    (line,) = supply_warnings(["XM430-W350", "XL330-M288", "XC330-M288", "XM430-W350", "AX-12A"])
    assert "5 V for XC330-M288 and XL330-M288, 12 V for XM430-W350" in line
    assert "the highest destroys the others" in line


def test_supplies_that_overlap_are_named_with_what_all_take() -> None:
    (line,) = supply_warnings(["XM540-W270", "XC330-T288"])
    assert "11.1 V for XC330-T288, 12 V for XM540-W270" in line
    assert "all take 10 to 12 V" in line
    assert "destroys" not in line


@pytest.mark.parametrize("other", ["XM430-W350", "XC330-T288", "XL330-M288"])
def test_24_v_go_with_no_other_supply(other: str) -> None:
    (line,) = supply_warnings(["XH430-V350", other])
    assert "24 V for XH430-V350" in line
    assert "the highest destroys the others" in line


def test_the_page_of_rig_files_lists_every_model_with_its_supply() -> None:
    page = (ROOT / "docs" / "rig-file.md").read_text(encoding="utf-8")
    section = page.split("#### Servo models\n")[1].split("\n### ")[0]
    listed = {}
    for line in section.splitlines():
        if line.startswith("| ") and " V" in line:
            supply, models = line.strip("| ").split(" | ")
            low, *rest = (float(volts) for volts in re.findall(r"\d+\.\d", supply))
            high, nominal = rest or (low, low)
            listed |= dict.fromkeys(re.findall(r"`([^`]+)`", models), (low, nominal, high))
    assert listed == {
        name: (found.supply_v[0], found.nominal_v, found.supply_v[1])
        for name, found in SPECIFICATIONS.items()
        if found.supply_v is not None
    }
