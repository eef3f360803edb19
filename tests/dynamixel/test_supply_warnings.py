"""Servos of two voltages on one bus: cables pass the supply on, and the higher one destroys the others."""

import pytest

from palpate.drivers.dynamixel.specifications import supply_warnings


@pytest.mark.parametrize("models", [[], ["XM430-W350"] * 3, ["XL330-M288", "XC330-M288"], ["AX-12A"]])
def test_one_voltage_is_fine(models: list[str]) -> None:
    assert supply_warnings(models) == []


def test_two_voltages_are_named_with_their_models() -> None:
    (line,) = supply_warnings(["XM430-W350", "XL330-M288", "XC330-M288", "XM430-W350", "AX-12A"])
    assert "5 V for XC330-M288 and XL330-M288, 12 V for XM430-W350" in line
