"""Result of `palpate check`: `palpate/check@1`."""

from typing import Literal

from palpate.config.results import Interval, Out, Rounded

__all__ = [
    "AdapterCheckOut",
    "ArrayCheckOut",
    "BusCountsOut",
    "CalibrationCheckOut",
    "CheckOut",
    "FingerHoldOut",
    "FingerTouchOut",
    "HoldCheckOut",
    "LoopOut",
    "ServoCheckOut",
    "SettingOut",
    "TouchCheckOut",
    "TouchForceOut",
]


class SettingOut(Out):
    """An item of a servo's EEPROM that is not as the rig wants it; runs and `setup-motors` write it."""

    item: str
    found: int
    wanted: int


class ServoCheckOut(Out):
    """A servo of the rig file. What could not be read is null."""

    id: int
    owner: str
    model: str
    answers: bool
    firmware: int | None = None
    voltage_v: Rounded | None = None
    voltage_limits_v: Interval | None = None
    temperature_c: int | None = None
    temperature_limit_c: int | None = None
    hardware_error: tuple[str, ...] = ()
    torque_on: bool | None = None
    return_delay_us: int | None = None
    settings: tuple[SettingOut, ...] = ()
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class ArrayCheckOut(Out):
    """A finger's tactile array. `rate_hz`: frames that reached the host.

    `bad_taxels`: how many its self-test found; null if it has none, or could not do it. `unique_id`: in
    hexadecimal.
    """

    finger: str
    port: str
    protocol: str
    answers: bool
    firmware: str | None = None
    unique_id: str | None = None
    emulated: bool | None = None
    rows: int | None = None
    columns: int | None = None
    shape: str | None = None
    bad_taxels: int | None = None
    wanted_hz: Rounded
    rate_hz: Rounded | None = None
    lost: int | None = None
    latency_timer_ms: Rounded | None = None
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class AdapterCheckOut(Out):
    """The bus's adapter; `latency_timer_ms` is null if it has none, or the system does not tell."""

    port: str
    baudrate_bps: int
    latency_timer_ms: Rounded | None


class LoopOut(Out):
    """Reading the state of all servos over and over. `wire_ms`: what the bytes alone take."""

    servos: int
    cycles: int
    fast: bool
    rate_hz: Rounded
    median_ms: Rounded
    p99_ms: Rounded
    wire_ms: Rounded


class BusCountsOut(Out):
    """What the bus has been through during the check."""

    instructions: int
    silent: int
    damaged: int
    retries: int
    alerts: int
    reconnects: int
    stale: int


class FingerTouchOut(Out):
    """A finger's part of a re-touch. `offset_mm`: its touches' mean along the normal, outward positive.

    One finger that is off shows in all fingers round a disc, because the disc's place gives way to it.
    `friction_a`: current that its slide needs to move freely; null if it was not measured.
    """

    finger: str
    touches: int
    offset_mm: Rounded
    friction_a: Rounded | None = None


class TouchCheckOut(Out):
    """A disc was touched again, its place fitted, and what is left compared with what is expected.

    `agrees`: it is no more than chance explains in 999 of 1000 re-touches.
    """

    agrees: bool
    touches: int
    residual_rms_mm: Rounded
    expected_rms_mm: Rounded
    fingers: tuple[FingerTouchOut, ...]


class CalibrationCheckOut(Out):
    """The calibration that lies beside the rig file and belongs to it, and what it promises.

    `made`: date and time in UTC. `coverage`: share of contacts that its bounds are to hold for.
    `position_mm`, `direction_deg`: the fingers' largest bounds; null if one has none. `devices_match`:
    whether these devices were calibrated; null if some did not answer. `touch` is null if nothing was
    touched.
    """

    file: str
    made: str
    age_days: int
    coverage: Rounded
    position_mm: Rounded | None
    direction_deg: Rounded | None
    devices_match: bool | None
    touch: TouchCheckOut | None = None


class TouchForceOut(Out):
    """Expected peak forces (N) of the quick touch, which finds a part, and of the slow one that measures.

    `unstopped_n`: of a finger at approach speed that nobody stops, as when the bus is unplugged.
    """

    quick_n: Rounded
    slow_n: Rounded
    unstopped_n: Rounded


class FingerHoldOut(Out):
    """A finger's push. `slid`: the part gave way under it; else it stood, or was met too obliquely to tell.

    `pressed_n`: force that the array measured while it slid, or in the end. `holds_n`: what of it is certain,
    with the spread of taxels' gains and their directions; null if nothing is. `moved_mm`: about how far this
    finger moved the part's touched place.
    """

    finger: str
    slid: bool
    pressed_n: Rounded
    holds_n: Rounded | None
    moved_mm: Rounded


class HoldCheckOut(Out):
    """What a part held when fingers pushed it, one at a time.

    `part_holds_n`: the greatest force that a finger certainly pressed with, in two digits, rounded down. A
    part that slides by friction which is the same in all directions bears it through its middle. `least_n`:
    the least of the fingers under which it slid, likewise: for a table where one direction is easier.
    `slid`: it gave way under some finger; else it may hold much more. `largest_n`: no push goes on above it.
    `moved_mm`: about how far the touched places went in all touches together.
    """

    part_holds_n: Rounded
    least_n: Rounded
    slid: bool
    largest_n: Rounded
    moved_mm: Rounded
    fingers: tuple[FingerHoldOut, ...]


class CheckOut(Out):
    """Everything that was looked at. `well`: nothing is wrong; there may be warnings.

    `calibration` is null if there is none. `touch_force`: of a part that does not give way. `hold` is null
    unless a part was pushed.
    """

    format: Literal["palpate/check@1"] = "palpate/check@1"
    rig: str
    emulated: bool
    well: bool
    adapter: AdapterCheckOut
    servos: tuple[ServoCheckOut, ...]
    arrays: tuple[ArrayCheckOut, ...]
    loop: LoopOut | None
    bus: BusCountsOut
    calibration: CalibrationCheckOut | None = None
    touch_force: TouchForceOut
    hold: HoldCheckOut | None = None
    problems: tuple[str, ...]
    warnings: tuple[str, ...]
