"""Control tables against the vendor's, and supply warnings."""

import math
import re
from importlib.resources import files

import pytest

from palpate.base.errors import InputError
from palpate.drivers.dynamixel.control_table import Access, Area, TableItem
from palpate.drivers.dynamixel.models import (
    SPECIFICATIONS,
    known_models,
    model_by_name,
    model_by_number,
    supply_warnings,
)
from palpate.drivers.dynamixel.x_series import EXTENDED_FIRMWARE, MODEL_NAMES, table_of
from support.commands.repository import ROOT

# ----------------------------------------------------------------------------------------------------
# Our control tables against the machine-readable ones that the vendor ships with its easy SDK.

VENDORS = files("dynamixel_easy_sdk") / "control_table"


def vendor_files() -> list[tuple[int, int, str]]:
    """(model number, firmware, the vendor's file) of every built-in model that the vendor has a table of."""
    there = {entry.name.removesuffix(".model") for entry in VENDORS.iterdir()}
    cases = []
    for number, name in MODEL_NAMES.items():
        plain = name.lower().replace("-", "_")
        newest = f"{plain}_fw52"
        if newest in there:
            cases += [(number, 51, plain), (number, 52, newest)]
        elif plain in there:
            cases += [(number, 45, plain), (number, 52, plain)]
    return cases


VENDOR_FILES = vendor_files()
# on the e-Manual's pages of these items, and not in the vendor's files
ONLY_MANUAL = {"Startup Configuration", "Backup Ready"}
# the easy SDK's own use of the indirect items, not items themselves
ONLY_VENDOR = {"Indirect Address Write", "Indirect Data Write", "Indirect Address Read", "Indirect Data Read"}


def vendor_table(model: str) -> dict[str, tuple[int, int]]:
    """(address, size) by item name."""
    text = (VENDORS / f"{model}.model").read_text()
    rows = text.split("[control table]")[1].strip().splitlines()[1:]
    table = {}
    for row in rows:
        address, size, name = row.split("\t")
        table[name.strip()] = int(address), int(size)
    return table


def table(model_number: int, firmware: int) -> dict[str, TableItem]:
    items = table_of(model_number, firmware)
    assert items is not None
    return {item.name: item for item in items}


def all_tables() -> list[tuple[int, int]]:
    return [(number, firmware) for number in MODEL_NAMES for firmware in (30, 41, 44, 45, 46, 51, 52)]


@pytest.mark.parametrize(("number", "firmware", "file"), VENDOR_FILES)
def test_the_manuals_table_is_the_vendors(number: int, firmware: int, file: str) -> None:
    theirs = vendor_table(file)
    ours = {name: (item.address, item.size) for name, item in table(number, firmware).items()}
    plain = {name: where for name, where in ours.items() if not name.startswith("Indirect")}
    assert {name: where for name, where in plain.items() if name not in ONLY_MANUAL} == {
        name: where for name, where in theirs.items() if not name.startswith("Indirect")
    }
    for name in theirs:
        if name.startswith("Indirect") and name not in ONLY_VENDOR:
            assert ours[name] == theirs[name], name


def test_every_model_but_one_has_a_table_of_the_vendor() -> None:
    assert MODEL_NAMES.keys() - {number for number, _, _ in VENDOR_FILES} == {1710}  # XM335-T323


def test_every_model_of_the_vendors_x_series_with_present_current_is_built_in() -> None:
    with_current = {
        name.removesuffix(".model")
        for name in (entry.name for entry in VENDORS.iterdir())
        if name.startswith("x") and "_fw52" not in name and "Present Current" in (VENDORS / name).read_text()
    }
    ours = {name.lower().replace("-", "_") for name in SPECIFICATIONS}
    assert with_current - ours == {"xw540_h260"}  # its stall torque is not known
    assert ours - with_current == {"xm335_t323"}


def test_the_vendors_numbers_are_ours() -> None:
    rows = (row.split("\t") for row in (VENDORS / "dynamixel.model").read_text().splitlines()[1:] if row)
    theirs = {int(row[0]): row[1].removesuffix(".model").upper().replace("_", "-") for row in rows}
    assert {number: theirs[number] for number in MODEL_NAMES if number in theirs} == {
        number: name for number, name in MODEL_NAMES.items() if number not in (1280, 1710)
    }


def test_torque_per_ampere_is_near_the_vendors_where_its_tables_give_one() -> None:
    """They do so for three models, less or more than stall torque over stall current (docs/rig-file.md)."""
    shares = {}
    for number, _, file in VENDOR_FILES:
        units = re.search(r"Present Current\t(\S+)\tN/m", (VENDORS / f"{file}.model").read_text())
        if units is not None:
            torque = model_by_number(number).known_torque
            shares[MODEL_NAMES[number]] = float(units[1]) / (torque.nm_per_a * torque.current_unit_a)
    known = {"XC330-T181": 0.706, "XC330-T288": 0.841, "XH540-W150": 1.155}
    assert shares == pytest.approx(known, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "nm_per_a"),
    [  # as newer pages of the manual print it
        ("XC330-M288", 0.517),
        ("XM540-W150", 1.659),
        ("XM540-W270", 2.409),
        ("XH540-V150", 2.667),
        ("XH540-V270", 3.833),
        ("XW540-T140", 1.408),
        ("XW540-T260", 1.939),
    ],
)
def test_torque_per_ampere_is_the_manuals(name: str, nm_per_a: float) -> None:
    assert model_by_name(name).known_torque.nm_per_a == pytest.approx(nm_per_a, abs=6e-4)


def test_models_and_their_names_agree_with_the_hosts() -> None:
    assert {number: model_by_number(number).name for number in MODEL_NAMES} == MODEL_NAMES


@pytest.mark.parametrize("number", MODEL_NAMES)
def test_host_and_manual_agree_on_sign_area_and_limits(number: int) -> None:
    items = table(number, 52)
    for name, item in model_by_number(number, 52).items.items():
        if name in items:
            assert item.signed == items[name].signed, name
            assert item.eeprom == (items[name].area is Area.EEPROM), name
    assert items["Current Limit"].high == model_by_number(number).known_torque.largest_current
    assert items["Model Number"].default == number


@pytest.mark.parametrize(("number", "firmware"), all_tables())
def test_items_do_not_overlap_and_defaults_are_in_range(number: int, firmware: int) -> None:
    items = table_of(number, firmware)
    assert items is not None
    end = 0
    for item in items:
        assert item.address >= end, item.name
        end = item.address + item.size
        if item.access is Access.RW and item.name != "Goal Position":
            assert item.low <= item.default <= item.high, item.name
        assert item.high < 1 << 8 * item.size


def test_indirect_data_lie_where_the_firmware_has_them() -> None:
    def first_and_last(number: int, firmware: int) -> tuple[tuple[int, int], tuple[int, int]]:
        items = table(number, firmware)
        count = sum(name.startswith("Indirect Data") for name in items)
        ends = [(items[f"Indirect Address {k}"], items[f"Indirect Data {k}"]) for k in (1, count)]
        assert all(pointer.default == data.address for pointer, data in ends)
        return (ends[0][0].address, ends[0][1].address), (ends[1][0].address, ends[1][1].address)

    assert first_and_last(1020, 44) == ((168, 224), (632, 661))
    assert first_and_last(1200, 51) == first_and_last(1240, 51) == ((168, 224), (206, 243))
    assert first_and_last(1200, 52) == first_and_last(1240, 52) == ((168, 208), (206, 227))


@pytest.mark.parametrize("number", MODEL_NAMES)
def test_items_come_with_their_firmware(number: int) -> None:
    new = EXTENDED_FIRMWARE[number]
    assert table(number, new)["Backup Ready"].address == 147
    assert table(number, new)["Startup Configuration"].address == 60
    assert table(number, new)["Drive Mode"].high & 8
    assert not ONLY_MANUAL & set(table(number, new - 1))
    assert not table(number, new - 1)["Drive Mode"].high & 8


def test_an_old_xm430() -> None:
    assert table(1020, 41)["Velocity Limit"].default == 350
    assert table(1020, 42)["Velocity Limit"].default == 200
    assert {"Drive Mode", "Bus Watchdog"} & set(table(1020, 37)) == set()


def test_every_model_of_the_vendor_is_known_by_name_and_number() -> None:
    for name in known_models():
        model = model_by_name(name)
        assert model_by_number(model.number) == model
        position = model.item("Goal Position" if "Goal Position" in model.items else "Present Position")
        assert position.size in (2, 4)
        assert 0 < model.rad_per_tick < 0.006
    with pytest.raises(InputError, match=r"'XM430-W351' is not known; known are .*XM430-W350"):
        model_by_name("XM430-W351")
    with pytest.raises(InputError, match="model number 7"):
        model_by_number(7)


def test_a_model_of_another_series_has_its_own_places_and_units() -> None:
    pro = model_by_name("PH54-200-S500")
    assert pro.item("Torque Enable").address == 512
    assert pro.zero_tick == 0
    assert pro.rad_per_tick == pytest.approx(math.pi / 501_923)
    assert not pro.answers_fast
    with pytest.raises(InputError, match="what a current of a PH54-200-S500 means is not known"):
        _ = pro.largest_current_a
    with pytest.raises(InputError, match="has no Homing Switch"):
        pro.item("Homing Switch")


@pytest.mark.parametrize(
    ("name", "firmware", "fast", "data"),
    [
        ("XM430-W350", 44, False, 224),
        ("XM430-W350", 45, True, 224),
        ("XL330-M288", 45, False, 224),
        ("XL330-M288", 46, True, 224),
        ("XC330-M288", 52, True, 208),
        ("2XL430-W250", 52, False, 224),
        ("XW430-T200", 44, False, 224),
        ("XW430-T200", 45, True, 224),
        ("XM335-T323", 45, True, 224),
        ("XC330-T288", 46, True, 224),
        ("XC330-T288", 52, True, 208),
    ],
)
def test_the_firmware_decides_on_layout_and_fast_reads(
    name: str, firmware: int, fast: bool, data: int
) -> None:
    model = model_by_name(name, firmware)
    assert model.answers_fast is fast
    assert model.indirect is not None
    assert (model.indirect.address, model.indirect.data, model.indirect.count) == (168, data, 20)


def test_what_the_manual_does_not_allow_is_refused_before_it_is_sent() -> None:
    model = model_by_name("XL330-M288")
    model.check("Current Limit", 1750)
    with pytest.raises(ValueError, match="1751 is outside 0 … 1750, what Current Limit of a XL330-M288"):
        model.check("Current Limit", 1751)
    with pytest.raises(ValueError, match="Present Position of a XL330-M288 is read only"):
        model.check("Present Position", 0)


# ----------------------------------------------------------------------------------------------------
# Servos of two voltages on one bus: cables pass the supply on, and the higher one destroys the others.


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
