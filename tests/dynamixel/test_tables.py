"""Our control tables against the machine-readable ones that the vendor ships with its easy SDK."""

from importlib.resources import files

import pytest

from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.emulators.servo_table import XM430_W350, Access, Area

RENAMED = {"Protocol Type": "Protocol Version"}  # the e-Manual's word on the right
# in the e-Manual's XM430-W350 table, not in the vendor's file
ONLY_MANUAL = {"Acceleration Limit"}


def vendor_table(model: str) -> dict[str, tuple[int, int]]:
    """(address, size) by item name."""
    text = (files("dynamixel_easy_sdk") / "control_table" / f"{model}.model").read_text()
    rows = text.split("[control table]")[1].strip().splitlines()[1:]
    table = {}
    for row in rows:
        address, size, name = row.split("\t")
        table[RENAMED.get(name.strip(), name.strip())] = int(address), int(size)
    return table


@pytest.mark.parametrize("model", [model.name for model in ct.MODELS])
def test_host_items_are_where_the_vendor_has_them(model: str) -> None:
    theirs = vendor_table(model.lower().replace("-", "_"))
    for item in ct.ITEMS:
        assert theirs[item.name] == (item.address, item.size), item.name


def test_emulated_table_is_the_vendors() -> None:
    theirs = vendor_table("xm430_w350")
    ours = {item.name: (item.address, item.size) for item in XM430_W350}
    assert {name: where for name, where in ours.items() if name not in ONLY_MANUAL} == {
        name: where for name, where in theirs.items() if not name.startswith("Indirect")
    }


def test_host_and_emulator_agree_on_sign_and_area() -> None:
    emulated = {item.name: item for item in XM430_W350}
    for item in ct.ITEMS:
        assert item.signed == emulated[item.name].signed, item.name
        assert item.eeprom == (emulated[item.name].area is Area.EEPROM), item.name


def test_emulated_items_do_not_overlap_and_defaults_are_in_range() -> None:
    end = 0
    for item in XM430_W350:
        assert item.address >= end
        end = item.address + item.size
        if item.access is Access.RW:
            assert item.low <= item.default <= item.high
