"""The vendor's X series as data: every model that reports Present Current, by family, and its control table.

Sources: the ROBOTIS e-Manual's page of each model, sections "Specifications" and "Control Table"; where
Indirect Data lies before firmware 52 of the X330s is from the tables that the vendor ships with its easy
SDK. Where pages of different age differ, the newer one holds; exceptions are said where they stand.
XW540-H260, a special order, is left out: its stall torque is not published, so its current cannot be
converted to torque.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from palpate.drivers.dynamixel.control_table import COMMON_ITEMS, EXTERNAL_PORTS, TableItem, indirect_items

_Indirect = tuple[int, int, int, int, int]


@dataclass(frozen=True, slots=True)
class XFamily:
    """Properties that several models share: supply, unit of current, and how their tables differ from
    COMMON_ITEMS.

    `supply_v`: least, recommended and highest Input Voltage. `defaults` and `ranges` (low, high): by item, in
    its own units. `absent`, `more`: items that COMMON_ITEMS has and these models lack, and the other way.
    `indirect`: by the first firmware with that layout, rows of Indirect Address and Data (first number, how
    many, first address, first data, highest address to point to). `extended_firmware`: first one with fast
    reads, Control Table Backup, Startup Configuration and Torque On by Goal Update (pages Protocol 2.0,
    Startup Configuration, Drive Mode). `time_based_firmware`, `drive_mode_firmware`: first ones with the
    time-based profile, and with Drive Mode and Bus Watchdog; 0 for all.
    """

    supply_v: tuple[float, float, float]
    current_unit_a: float
    indirect: Mapping[int, tuple[_Indirect, ...]]
    extended_firmware: int
    defaults: Mapping[str, int]
    ranges: Mapping[str, tuple[int, int]]
    absent: frozenset[str] = frozenset()
    more: tuple[TableItem, ...] = ()
    time_based_firmware: int = 0
    drive_mode_firmware: int = 0


@dataclass(frozen=True, slots=True)
class XModel:
    """One model: Model Number (0), its motor at the recommended supply, and how its table differs.

    `current_limit`: default and highest Current Limit. `defaults`: by item. `older_velocity_limit`: the
    default before the time-based profile came; None where no page gives another one.
    """

    name: str
    number: int
    family: XFamily
    stall_torque_nm: float
    stall_current_a: float
    no_load_rpm: float
    current_limit: int
    defaults: Mapping[str, int] = field(default_factory=dict)
    older_velocity_limit: int | None = None


def _voltage_limits(low: int, high: int, least: int) -> tuple[dict[str, int], dict[str, tuple[int, int]]]:
    """Defaults and ranges of both limits of the supply, in 0.1 V."""
    names = "Max Voltage Limit", "Min Voltage Limit"
    return dict(zip(names, (high, low), strict=True)), dict.fromkeys(names, (least, high))


_SMALL_EARLY, _SMALL = (1, 20, 168, 224, 243), (1, 20, 168, 208, 227)
_SMALL_INDIRECT = {0: (_SMALL_EARLY,), 52: (_SMALL,)}
_LARGE_INDIRECT = {0: ((1, 28, 168, 224, 661), (29, 28, 578, 634, 661))}
_X335_INDIRECT = {0: ((1, 28, 168, 224, 251),)}

_5V_DEFAULTS, _5V_RANGES = _voltage_limits(35, 70, 31)
_11V_DEFAULTS, _11V_RANGES = _voltage_limits(55, 140, 55)
_12V_DEFAULTS, _12V_RANGES = _voltage_limits(95, 160, 95)
_24V_DEFAULTS, _24V_RANGES = _voltage_limits(110, 300, 110)

# pages of both XW430 give Protocol Type 1, Protocol 1.0, as the default: taken for a slip, all others give 2
_LARGE_DEFAULTS = {"Temperature Limit": 80, "Velocity I Gain": 1920}
_LARGE_RANGES = {
    "Baud Rate": (0, 7),
    "Protocol Type": (1, 2),
    "Velocity Limit": (0, 1023),
    "Goal Velocity": (-1023, 1023),
}
_ABSENT_PWM_SLOPE = frozenset({"PWM Slope"})

_X330_5V = XFamily((3.7, 5.0, 6.0), 1.0e-3, _SMALL_INDIRECT, 46, _5V_DEFAULTS, _5V_RANGES)
_X330_11V = XFamily(
    (6.5, 11.1, 12.0), 1.0e-3, _SMALL_INDIRECT, 46, {**_11V_DEFAULTS, "PWM Slope": 255}, _11V_RANGES
)
_X335 = replace(_X330_11V, indirect=_X335_INDIRECT, extended_firmware=45)
_X430 = XFamily(
    (10.0, 12.0, 14.8),
    2.69e-3,
    _LARGE_INDIRECT,
    45,
    {**_LARGE_DEFAULTS, **_12V_DEFAULTS},
    {**_LARGE_RANGES, **_12V_RANGES},
    absent=_ABSENT_PWM_SLOPE,
    time_based_firmware=42,
    drive_mode_firmware=38,
)
_X540 = replace(_X430, more=EXTERNAL_PORTS, drive_mode_firmware=0)
_XW = replace(_X430, absent=_ABSENT_PWM_SLOPE | {"LED"}, drive_mode_firmware=0)
_X430_24V = replace(
    _X430,
    supply_v=(24.0, 24.0, 24.0),
    current_unit_a=1.34e-3,
    defaults={**_LARGE_DEFAULTS, **_24V_DEFAULTS},
    ranges={**_LARGE_RANGES, **_24V_RANGES},
)
_X540_24V = replace(_X430_24V, current_unit_a=2.69e-3, more=EXTERNAL_PORTS, drive_mode_firmware=0)

_XL330_DEFAULTS = {"Shutdown": 53, "Position P Gain": 400}
_STIFF_DEFAULTS = {"Position P Gain": 900}
_XC330_T_DEFAULTS = {"Velocity I Gain": 1200, "Velocity P Gain": 40, "Position P Gain": 900}

_MODELS = (
    XModel("XL330-M077", 1190, _X330_5V, 0.215, 1.47, 383, 1750, {
        **_XL330_DEFAULTS, "Velocity Limit": 1620,
        "Velocity I Gain": 400, "Velocity P Gain": 40, "Position I Gain": 400,
    }),
    XModel("XL330-M288", 1200, _X330_5V, 0.52, 1.47, 103, 1750, {
        **_XL330_DEFAULTS, "Velocity Limit": 445, "Velocity P Gain": 180,
    }),
    XModel("XC330-M181", 1230, _X330_5V, 0.60, 1.80, 129, 2352, {
        "Velocity Limit": 545, "Velocity I Gain": 1400, "Position D Gain": 500, "Position P Gain": 1200,
    }),
    XModel("XC330-M288", 1240, _X330_5V, 0.93, 1.80, 81, 2352, {
        "Velocity P Gain": 50, "Position D Gain": 500, "Position P Gain": 1100,
    }),
    XModel("XC330-T181", 1210, _X330_11V, 0.76, 0.80, 104, 910, {**_XC330_T_DEFAULTS, "Velocity Limit": 510}),
    XModel("XC330-T288", 1220, _X330_11V, 0.92, 0.80, 65, 910, {**_XC330_T_DEFAULTS, "Velocity Limit": 320}),
    # its motor as catalogues repeat it from the manual; N·m per A is that of an XC330-T288 times the ratio of
    # their gears, 323.04 : 288.35
    XModel("XM335-T323", 1710, _X335, 1.03, 0.80, 53, 910, {
        "Baud Rate": 3, "Velocity Limit": 280, "Max Position Limit": 3072, "Min Position Limit": 1024,
        "Velocity I Gain": 1800, "Velocity P Gain": 50, "Position P Gain": 2000,
    }),
    XModel("XM430-W210", 1030, _X430, 3.0, 2.3, 77, 1193, {"Velocity Limit": 330}),
    XModel("XM430-W350", 1020, _X430, 4.1, 2.3, 46, 1193, {"Velocity Limit": 200}, 350),
    XModel("XH430-W210", 1010, _X430, 2.5, 1.3, 50, 648, {**_STIFF_DEFAULTS, "Velocity Limit": 210}, 360),
    XModel("XH430-W350", 1000, _X430, 3.4, 1.3, 30, 648, {**_STIFF_DEFAULTS, "Velocity Limit": 130}, 280),
    # Velocity Limit is the no-load speed, as on other pages; the newest page at hand has the older default
    XModel("XH430-V210", 1050, _X430_24V, 2.6, 0.7, 52, 689, {"Velocity Limit": 230}, 380),
    XModel("XH430-V350", 1040, _X430_24V, 3.3, 0.7, 31, 689, {"Velocity Limit": 135}, 285),
    XModel("XD430-T210", 1011, _X430, 2.5, 1.3, 50, 648, {**_STIFF_DEFAULTS, "Velocity Limit": 210}),
    XModel("XD430-T350", 1001, _X430, 3.4, 1.3, 30, 648, {**_STIFF_DEFAULTS, "Velocity Limit": 130}),
    XModel("XW430-T200", 1280, _XW, 2.3, 1.3, 53, 2047, {**_STIFF_DEFAULTS, "Velocity Limit": 235}),
    XModel("XW430-T333", 1270, _XW, 3.1, 1.3, 31, 2047, {**_STIFF_DEFAULTS, "Velocity Limit": 139}),
    XModel("XM540-W150", 1130, _X540, 7.3, 4.4, 53, 2047, {"Velocity Limit": 230}),
    XModel("XM540-W270", 1120, _X540, 10.6, 4.4, 30, 2047, {"Velocity Limit": 128}),
    XModel("XH540-W150", 1110, _X540, 7.1, 4.9, 70, 2047, {"Velocity Limit": 300}),
    XModel("XH540-W270", 1100, _X540, 9.9, 4.9, 39, 2047, {"Velocity Limit": 167}),
    XModel("XH540-V150", 1150, _X540_24V, 6.4, 2.4, 60, 2047, {"Velocity Limit": 230}),
    XModel("XH540-V270", 1140, _X540_24V, 9.2, 2.4, 34, 2047, {"Velocity Limit": 128}),
    XModel("XD540-T150", 1111, _X540, 7.1, 4.9, 70, 2047, {"Velocity Limit": 300}),
    XModel("XD540-T270", 1101, _X540, 9.9, 4.9, 39, 2047, {"Velocity Limit": 167}),
    XModel("XW540-T140", 1180, _XW, 6.9, 4.9, 72, 2047, {"Velocity Limit": 304}),
    XModel("XW540-T260", 1170, _XW, 9.5, 4.9, 40, 2047, {"Velocity Limit": 167}),
)  # fmt: skip

X_SERIES: Mapping[int, XModel] = MappingProxyType({model.number: model for model in _MODELS})
"""Every model by Model Number (0)."""

MODEL_NAMES: Mapping[int, str] = MappingProxyType({model.number: model.name for model in _MODELS})
"""Names of the models by Model Number (0)."""

EXTENDED_FIRMWARE: Mapping[int, int] = MappingProxyType(
    {model.number: model.family.extended_firmware for model in _MODELS}
)
"""By model, the first firmware with fast reads and what came with them (see XFamily)."""

_TORQUE_ON_BY_GOAL, _TIME_BASED, _REVERSE = 0x08, 0x04, 0x01


def table_of(model_number: int, firmware: int) -> tuple[TableItem, ...]:
    """Every item of a built-in model with that firmware, in order of address.

    Raises KeyError for a number that no built-in model has.
    """
    model = X_SERIES[model_number]
    family = model.family
    defaults = {**family.defaults, **model.defaults, **_model_defaults(model, firmware)}
    ranges = {
        **family.ranges,
        "Drive Mode": (0, _drive_mode_bits(family, firmware)),
        "Current Limit": (0, model.current_limit),
        "Goal Current": (-model.current_limit, model.current_limit),
    }
    absent = family.absent | _items_of_newer_firmware(family, firmware)
    items = [
        _override(item, defaults.get(item.name, item.default), ranges.get(item.name, (item.low, item.high)))
        for item in (*COMMON_ITEMS, *family.more)
        if item.name not in absent
    ]
    layout = max(first for first in family.indirect if first <= firmware)
    for row in family.indirect[layout]:
        items += indirect_items(*row)
    return tuple(sorted(items, key=lambda item: item.address))


def _override(item: TableItem, default: int, ends: tuple[int, int]) -> TableItem:
    low, high = ends
    return replace(item, default=default, low=low, high=high)


def _model_defaults(model: XModel, firmware: int) -> dict[str, int]:
    """Defaults that follow from the model itself and its firmware."""
    defaults = {
        "Model Number": model.number,
        "Firmware Version": firmware,
        "Current Limit": model.current_limit,
        "Goal Current": model.current_limit,
    }
    older = model.older_velocity_limit
    if older is not None and firmware < model.family.time_based_firmware:
        defaults["Velocity Limit"] = older
    return defaults


def _drive_mode_bits(family: XFamily, firmware: int) -> int:
    """All bits of Drive Mode together.

    Dual Mode of the X540s (0x02) is left out: a slave obeys a wire that palpate knows nothing of.
    """
    bits = _REVERSE
    if firmware >= family.time_based_firmware:
        bits |= _TIME_BASED
    if firmware >= family.extended_firmware:
        bits |= _TORQUE_ON_BY_GOAL
    return bits


def _items_of_newer_firmware(family: XFamily, firmware: int) -> set[str]:
    absent: set[str] = set()
    if firmware < family.extended_firmware:
        absent |= {"Startup Configuration", "Backup Ready"}
    if firmware < family.drive_mode_firmware:
        absent |= {"Drive Mode", "Bus Watchdog"}
    return absent
