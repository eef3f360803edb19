"""Servo models: control table, units, motor and supply of each.

Addresses and sizes are those of the tables that ship with the vendor's SDK, for every model in them. What
these leave out is added from the e-Manual for the models that rigs are built of (`x_series`): access,
defaults, ranges, the layout of older and newer firmware, models that the vendor's list lacks.

Stall torque, stall current and no-load speed are those of section "Specifications" of each model's page, at
the recommended supply. Inertia, friction and heating are not published; estimates for emulated servos are
marked as such. Plug-ins add models of their own (`base.extensions`).
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from importlib.resources.abc import Traversable
from types import MappingProxyType

from palpate.base.errors import InputError
from palpate.base.extensions import SERVO_MODELS, broken_plugin_error, load_extension, registered_names
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.control_table import Access, Area, Item, TableItem
from palpate.drivers.dynamixel.x_series import MODEL_NAMES, X_SERIES, XModel, table_of

_RAD_S_PER_RPM = 2 * math.pi / 60  # rad/s


@dataclass(frozen=True, slots=True)
class MotorConstants:
    """A servo as seen at its output shaft. Defaults: XM430-W350 at 12 V."""

    stall_torque_nm: float = 4.1  # e-Manual
    stall_current_a: float = 2.3  # e-Manual
    no_load_rad_s: float = 46 * 2 * math.pi / 60  # e-Manual
    inertia_kg_m2: float = 0.01  # guess: a 80 g·mm² rotor behind 353.5 : 1
    friction_nm: float = 0.05  # guess: gear friction, the same at rest and in motion


@dataclass(frozen=True)
class ServoSpecification:
    """A servo model of the X series, for host and emulator; entry points of `palpate.servo_models` name one.

    `name`: as in rig files. `number`: Model Number (0). `items`: the e-Manual's control table of a firmware.
    `firmware`: what an emulated one has unless asked otherwise. `extended_firmware`: first one with fast
    reads, Control Table Backup and Startup Configuration. `nominal_v`: recommended supply. `brown_out_v`:
    below it the controller is off; a guess, the manual gives operating ranges only. `current_unit_a`: of
    Goal and Present Current. `protocol_types`: values of Protocol Type that it works with. `supply_v`: least
    and highest supply; None: `nominal_v` alone.

    Its positions have 4096 steps a turn, 2048 at 0 rad, and its velocities units of 0.229 rpm.
    """

    name: str
    number: int
    items: Callable[[int], Sequence[TableItem]]
    firmware: int
    extended_firmware: int
    nominal_v: float
    brown_out_v: float
    current_unit_a: float
    motor: MotorConstants
    protocol_types: tuple[int, ...] = (2,)
    supply_v: tuple[float, float] | None = None


_XM430 = MotorConstants()
_X330_PROTOCOL_TYPES = (2, 20, 21, 22)


def _guess_motor(model: XModel) -> MotorConstants:
    """A model's motor. Guessed: it gathers speed in an XM430-W350's 12 ms and loses its share to friction."""
    strength = model.stall_torque_nm / _XM430.stall_torque_nm
    no_load_rad_s = model.no_load_rpm * _RAD_S_PER_RPM
    return MotorConstants(
        model.stall_torque_nm,
        model.stall_current_a,
        no_load_rad_s,
        inertia_kg_m2=_XM430.inertia_kg_m2 * strength * _XM430.no_load_rad_s / no_load_rad_s,
        friction_nm=_XM430.friction_nm * strength,
    )


def _built_in_specification(model: XModel) -> ServoSpecification:
    family = model.family
    low, nominal, high = family.supply_v
    # on an X330 the other types are radio control, which falls back to Protocol 2.0 where it hears none at
    # boot; others with type 1 would speak Protocol 1.0, which is not emulated
    small = "Protocol Type" not in family.ranges
    return ServoSpecification(
        model.name,
        model.number,
        partial(table_of, model.number),
        max(family.extended_firmware, *family.indirect),
        family.extended_firmware,
        nominal,
        nominal / 2,
        family.current_unit_a,
        _guess_motor(model),
        _X330_PROTOCOL_TYPES if small else (2,),
        (low, high),
    )


SPECIFICATIONS: Mapping[str, ServoSpecification] = MappingProxyType(
    {model.name: _built_in_specification(model) for model in X_SERIES.values()}
)
"""Built-in models by name."""


def specification(name: str) -> ServoSpecification:
    """Find a model by name, built in or from a plug-in. Raises InputError if there is none."""
    if name in SPECIFICATIONS:
        return SPECIFICATIONS[name]
    found = load_extension(SERVO_MODELS, name, SPECIFICATIONS)
    if not isinstance(found, ServoSpecification):
        raise broken_plugin_error(
            SERVO_MODELS, name, f"it is a {type(found).__name__}, not a ServoSpecification"
        )
    return found


def _shared_supply_v(names: Iterable[str]) -> tuple[float, float]:
    ranges = [_supply_range(SPECIFICATIONS[name]) for name in set(names) & SPECIFICATIONS.keys()]
    return max((low for low, _ in ranges), default=0.0), min((high for _, high in ranges), default=math.inf)


def share_supply(models: Iterable[str]) -> bool:
    """Return whether there is a voltage that all of them take."""
    low, high = _shared_supply_v(models)
    return low <= high


def supply_warnings(models: Iterable[str]) -> list[str]:
    """Warnings about the supply of servos on one bus, whose cables pass it on; none if all need the same.

    Models that are not built in are left out.
    """
    by_volts: dict[float, set[str]] = {}
    for name in set(models) & SPECIFICATIONS.keys():
        by_volts.setdefault(SPECIFICATIONS[name].nominal_v, set()).add(name)
    if len(by_volts) < 2:
        return []
    listed = ", ".join(
        f"{volts:g} V for {' and '.join(sorted(by_volts[volts]))}" for volts in sorted(by_volts)
    )
    low, high = _shared_supply_v(name for names in by_volts.values() for name in names)
    if low <= high:
        return [
            f"servos on one bus are made for different supplies ({listed}), and cables pass the supply on: "
            f"all take {low:g} to {high:g} V; set the supply within that, and measure it first"
        ]
    return [
        f"servos on one bus need different supplies ({listed}), and cables pass the supply on: the highest "
        "destroys the others; use servos of one voltage, or feed them apart, with only ground and data joined"
    ]


def _supply_range(found: ServoSpecification) -> tuple[float, float]:
    return (found.nominal_v, found.nominal_v) if found.supply_v is None else found.supply_v


_NEWEST_FIRMWARE = 255
_NEW_LAYOUT_FIRMWARE = 52  # firmware from which the X330s have the vendor's "_fw52" table
_SIGNED_ITEMS = {name for name, item in ct.ITEMS.items() if item.signed}
_EEPROM_END = 64  # of the X series; elsewhere it is not used


@dataclass(frozen=True, slots=True)
class IndirectAddresses:
    """Indirect addresses that lie in a row: the first one's address, the first one's data, how many."""

    address: int
    data: int
    count: int


@dataclass(frozen=True, slots=True)
class CurrentUnits:
    """Meaning of a current: its unit (A), the largest Current Limit (units), N·m per A at the shaft.

    The last is stall torque over stall current of the e-Manual's specifications at the recommended voltage;
    friction makes what reaches the shaft less.
    """

    current_unit_a: float
    largest_current: int
    nm_per_a: float


# e-Manual: firmware from which a series answers fast reads; two-axis models never do
_FAST_READ_FIRMWARE = {"430": 45, "540": 45, "330": 46}


@dataclass(frozen=True, slots=True)
class Model:
    """A model with a firmware; None until the servo was asked for it.

    `zero_tick`: Present Position at 0 rad. `fast_from`: first firmware that answers fast reads, None if
    none does. `items`: the vendor's, by name. `indirect`: the first row of
    indirect addresses, None if there is none. `table`: the e-Manual's items with access, default and
    range; None for models of which only the vendor's tables are known.
    """

    name: str
    number: int
    firmware: int | None
    zero_tick: int
    rad_per_tick: float
    velocity_unit_rad_s: float
    fast_from: int | None
    items: dict[str, Item]
    indirect: IndirectAddresses | None
    table: dict[str, TableItem] | None
    torque: CurrentUnits | None

    def item(self, name: str) -> Item:
        """Item of this model's table. Raises InputError if it has none of that name."""
        found = self.items.get(name)
        if found is None:
            raise InputError(f"a {self.name} has no {name} in its control table")
        return found

    def check(self, name: str, value: int) -> None:
        """Refuse (ValueError) to write what the e-Manual says this model does not take."""
        known = None if self.table is None else self.table.get(name)
        if known is None:
            return
        if known.access is not Access.RW:
            raise ValueError(f"{name} of a {self.name} is read only")
        if not known.low <= value <= known.high:
            raise ValueError(
                f"{value} is outside {known.low} … {known.high}, what {name} of a {self.name} takes"
            )

    @property
    def answers_fast(self) -> bool:
        """True if Fast Sync Read and Fast Bulk Read are known to this firmware (e-Manual, Protocol 2.0)."""
        least = self.fast_from
        return self.firmware is not None and least is not None and self.firmware >= least

    @property
    def known_torque(self) -> CurrentUnits:
        """Units of current. Raises InputError for a model of which they are not known."""
        if self.torque is None:
            raise InputError(
                f"what a current of a {self.name} means is not known; known are " + ", ".join(SPECIFICATIONS)
            )
        return self.torque

    @property
    def largest_current_a(self) -> float:
        """Largest Current Limit in A."""
        return self.known_torque.largest_current * self.known_torque.current_unit_a


def model_by_name(name: str, firmware: int | None = None) -> Model:
    """Find a model by its name; raises InputError listing known ones.

    A plug-in's model goes before the vendor's table of the same name, which knows less.
    """
    if name in SPECIFICATIONS:
        return model_by_number(SPECIFICATIONS[name].number, firmware)
    if name in registered_names(SERVO_MODELS):
        return _specified_model(specification(name), firmware)
    for number, found in _numbers().items():
        if _name_of(found) == name:
            return model_by_number(number, firmware)
    raise InputError(f"servo model {name!r} is not known; known are {', '.join(known_models())}")


def _specified_model(found: ServoSpecification, firmware: int | None) -> Model:
    table = _table(found, firmware)
    items = {item.name: _item(item.name, item.address, item.size, table) for item in table.values()}
    return Model(
        name=found.name,
        number=found.number,
        firmware=firmware,
        zero_tick=ct.ZERO_TICK,
        rad_per_tick=ct.RAD_PER_TICK,
        velocity_unit_rad_s=ct.VELOCITY_UNIT_RAD_S,
        fast_from=found.extended_firmware,
        items=items,
        indirect=_indirect(items),
        table=table,
        torque=_torque(found, table),
    )


def _table(found: ServoSpecification, firmware: int | None) -> dict[str, TableItem]:
    return {item.name: item for item in found.items(_NEWEST_FIRMWARE if firmware is None else firmware)}


def _torque(found: ServoSpecification | None, table: dict[str, TableItem] | None) -> CurrentUnits | None:
    if found is None or table is None:
        return None
    motor = found.motor
    return CurrentUnits(
        found.current_unit_a, table["Current Limit"].high, motor.stall_torque_nm / motor.stall_current_a
    )


@cache
def model_by_number(number: int, firmware: int | None = None) -> Model:
    """Find a model by what a ping answers; raises InputError if neither tables nor manual have it.

    While the firmware is not known, the newest layout is taken.
    """
    file = _numbers().get(number)
    if file is None:
        if number in MODEL_NAMES:
            return _specified_model(SPECIFICATIONS[MODEL_NAMES[number]], firmware)
        raise InputError(f"model number {number} is not in the vendor's tables")
    name = _name_of(file)
    newer = file.replace(".model", "_fw52.model")
    if (firmware is None or firmware >= _NEW_LAYOUT_FIRMWARE) and _vendor(newer).is_file():
        file = newer
    sections = _sections(_vendor(file).read_text(encoding="utf-8"))
    kind = {row[0]: float(row[1]) for row in sections["type info"]}
    units = {row[0]: float(row[1]) for row in sections["unit info"]}
    full_turn = kind["value_of_max_radian_position"] - kind["value_of_min_radian_position"]
    radians = kind["max_radian"] - kind["min_radian"]
    known = SPECIFICATIONS.get(name)
    table = None if known is None else _table(known, firmware)
    items = {row[2]: _item(row[2], int(row[0]), int(row[1]), table) for row in sections["control table"]}
    for item in (table or {}).values():  # the vendor's tables lack some, such as Startup Configuration
        items.setdefault(item.name, _item(item.name, item.address, item.size, table))
    return Model(
        name=name,
        number=number,
        firmware=firmware,
        zero_tick=round(kind["value_of_zero_radian_position"]),
        # the X series' tables give ±3.14159265 for 4095 steps; a turn has 4096 (e-Manual)
        rad_per_tick=ct.RAD_PER_TICK if full_turn == 4095 else radians / full_turn,
        velocity_unit_rad_s=units.get("Present Velocity", ct.VELOCITY_UNIT_RAD_S),
        fast_from=_FAST_READ_FIRMWARE.get(name[2:5]) if name[0] == "X" else None,
        items=items,
        indirect=_indirect(items),
        table=table,
        torque=_torque(known, table),
    )


def _item(name: str, address: int, size: int, table: dict[str, TableItem] | None) -> Item:
    known = None if table is None else table.get(name)
    eeprom = address < _EEPROM_END if known is None else known.area is Area.EEPROM
    return Item(name, address, size, name in _SIGNED_ITEMS, eeprom)


def _indirect(items: dict[str, Item]) -> IndirectAddresses | None:
    first, data = items.get("Indirect Address 1"), items.get("Indirect Data 1")
    if first is None or data is None:
        return None
    return IndirectAddresses(first.address, data.address, min(20, (data.address - first.address) // 2))


def known_models() -> list[str]:
    """Names of all models in the vendor's tables, and of built-in ones that these lack."""
    return sorted({_name_of(file) for file in _numbers().values()} | SPECIFICATIONS.keys())


def _name_of(file: str) -> str:
    return file.removesuffix(".model").upper().replace("_", "-")


@cache
def _numbers() -> dict[int, str]:
    """Files of the vendor's tables by model number."""
    rows = _vendor("dynamixel.model").read_text(encoding="utf-8").splitlines()[1:]
    return {int(number): file for number, file in (row.split("\t")[:2] for row in rows if row.strip())}


def _vendor(file: str) -> Traversable:
    return files("dynamixel_easy_sdk").joinpath("control_table", file)


def _sections(text: str) -> dict[str, list[list[str]]]:
    """Rows of each section of a vendor's table, without the sections' headings of columns."""
    sections: dict[str, list[list[str]]] = {}
    for line in text.splitlines():
        if line.startswith("["):
            rows = sections.setdefault(line.strip("[] \t"), [])
        elif line.strip():
            rows.append([cell.strip() for cell in line.split("\t")])
    return {name: rows[1:] for name, rows in sections.items()}
