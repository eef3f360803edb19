"""Results of `check` (`palpate/check@1`) and `doctor` (`palpate/doctor@1`), with causes of faults."""

from enum import StrEnum
from typing import Any, Literal

from pydantic import Field

from palpate.config.fields import Interval, Out, Rounded


class SettingOut(Out):
    """An item of a servo's EEPROM that is not as the rig wants it; `setup-motors` writes it, some runs do."""

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


class BusLoopOut(Out):
    """Reading the state of all servos over and over. `wire_ms`: what the bytes alone take."""

    servos: int
    cycles: int
    fast: bool
    rate_hz: Rounded
    median_ms: Rounded
    p99_ms: Rounded
    wire_ms: Rounded


class BusCountsOut(Out):
    """Faults of the bus during the check, counted."""

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
    """Forces that a part held when fingers pushed it, one at a time.

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


class Cause(StrEnum):
    """Cause of a fault in a set-up. Values stay as they are: programs may compare them."""

    PORT_MISSING = "port-missing"
    PORT_FORBIDDEN = "port-forbidden"
    PORT_BUSY = "port-busy"
    PORT_UNUSABLE = "port-unusable"
    MODEM_MANAGER = "modem-manager"
    BRLTTY = "brltty"
    LATENCY_TIMER = "latency-timer"
    BUS_SILENT = "bus-silent"
    BAUD_RATE = "baud-rate"
    WRONG_ID = "wrong-id"
    DUPLICATE_ID = "duplicate-id"
    SERVO_SILENT = "servo-silent"
    WRONG_MODEL = "wrong-model"
    SERVO_FIRMWARE = "servo-firmware"
    SUPPLY_LOW = "supply-low"
    SUPPLY_HIGH = "supply-high"
    SUPPLY_DROP = "supply-drop"
    SUPPLY_MIXED = "supply-mixed"
    HARDWARE_ERROR = "hardware-error"
    TOO_HOT = "too-hot"
    WARM = "warm"
    TORQUE_ON = "torque-on"
    LIMITS_IMPOSSIBLE = "limits-impossible"
    LIMITS_NOT_SET = "limits-not-set"
    DRIVE_REVERSED = "drive-reversed"
    HOMING_OFFSET = "homing-offset"
    SHADOW_ID = "shadow-id"
    PROTECTION_OFF = "protection-off"
    FOREIGN_SETTING = "foreign-setting"
    FOREIGN_SERVO = "foreign-servo"
    BUS_LOSSY = "bus-lossy"
    BUS_SLOW = "bus-slow"
    COMPUTER_BUSY = "computer-busy"
    ZERO_OFF = "zero-off"
    DIRECTION_WRONG = "direction-wrong"
    SERVOS_SWAPPED = "servos-swapped"
    PLACES_SWAPPED = "places-swapped"
    FRAME_MIRRORED = "frame-mirrored"
    ARRAY_MOUNTING = "array-mounting"
    WIRING_UNCLEAR = "wiring-unclear"
    MOTION_FAILED = "motion-failed"
    ARRAY_SILENT = "array-silent"
    ARRAY_BAUD_RATE = "array-baud-rate"
    ARRAY_PROTOCOL = "array-protocol"
    ARRAY_FIRMWARE = "array-firmware"
    ARRAY_HARDWARE = "array-hardware"
    ARRAY_GEOMETRY = "array-geometry"
    FLAT_ARRAY = "flat-array"
    DEAD_COLUMN = "dead-column"
    DEAD_ROW = "dead-row"
    DEAD_TAXEL = "dead-taxel"
    HOT_TAXEL = "hot-taxel"
    UNSTEADY_TAXEL = "unsteady-taxel"
    NO_FRAMES = "no-frames"
    FRAMES_LOST = "frames-lost"
    FRAMES_SLOW = "frames-slow"
    FRAMES_REPEATED = "frames-repeated"
    ARRAY_HUNG = "array-hung"
    INTERFERENCE = "interference"
    UNSTEADY_ROW = "unsteady-row"
    NOISE = "noise"
    DRIFT = "drift"
    HIDDEN_PUSH = "hidden-push"
    FORCE_SCALE = "force-scale"
    TOUCH_TOO_HARD = "touch-too-hard"
    ARRAYS_SWAPPED = "arrays-swapped"
    OTHER_DEVICES = "other-devices"
    CALIBRATION_OLD = "calibration-old"
    BOUNDS_MISSING = "bounds-missing"
    OTHER_REFERENCES = "other-references"
    TOUCH_DISAGREES = "touch-disagrees"
    FRICTION = "friction"
    PART_SLIDES = "part-slides"


DEVICE_CAUSES = frozenset(
    {
        Cause.PORT_MISSING,
        Cause.PORT_FORBIDDEN,
        Cause.PORT_BUSY,
        Cause.PORT_UNUSABLE,
        Cause.BRLTTY,
        Cause.BUS_SILENT,
        Cause.SERVO_SILENT,
        Cause.ARRAY_SILENT,
        Cause.NO_FRAMES,
    }
)
"""Causes for which a device counts as missing or not answering."""


class Severity(StrEnum):
    """Severity of a finding: with a warning a rig can be worked with."""

    WRONG = "wrong"
    WARNING = "warning"


class Outcome(StrEnum):
    """Outcome of a step: that of its worst finding, or it was not carried out."""

    WELL = "well"
    WARNING = "warning"
    WRONG = "wrong"
    SKIPPED = "skipped"


class FindingOut(Out):
    """One thing that is not as it should be: what was seen, what that means, and the next thing to do.

    `servos`, `arrays`: ids and fingers of the devices that it is about, as far as it is about some.
    """

    cause: Cause
    severity: Severity
    device: str
    saw: str
    means: str
    next: str
    servos: tuple[int, ...] = ()
    arrays: tuple[str, ...] = ()


class DoctorStepOut(Out):
    """A step. `saw` is empty and `skipped_because` says why, if it was skipped."""

    step: str
    outcome: Outcome
    looked_at: str
    saw: str
    findings: tuple[FindingOut, ...] = ()
    skipped_because: str | None = None


class WiringChangeOut(Out):
    """A change of a value in the rig file: where (`fingers[0].array.port`), from what to what, and why.

    `finger`: whose it is, empty if nobody's.
    """

    file_key: str
    finger: str = ""
    from_: Any = Field(alias="from")
    to: Any
    why: str


class WiringOut(Out):
    """Wiring as people saw it when tips were pressed and moved.

    `confirmed`: every tip was pressed, every joint moved, and all is as the rig file says; then that is
    written down beside it. `changes`: to the rig file, which explain what was seen.
    """

    format: Literal["palpate/wiring@1"] = "palpate/wiring@1"
    rig: str
    emulated: bool
    confirmed: bool
    changes: tuple[WiringChangeOut, ...] = ()
    problems: tuple[str, ...] = ()


class CheckOut(Out):
    """Everything that was looked at. `well`: nothing is wrong; there may be warnings.

    `calibration` is null if there is none. `touch_force`: of a part that does not give way. `hold` is null
    unless a part was pushed, `wiring` unless tips were to be pressed or joints moved. `problems`, `warnings`:
    the steps' findings in words, those of a device beside it, too. `next`: what to do first; null if there is
    nothing to do.
    """

    format: Literal["palpate/check@1"] = "palpate/check@1"
    rig: str
    emulated: bool
    well: bool
    adapter: AdapterCheckOut
    servos: tuple[ServoCheckOut, ...]
    arrays: tuple[ArrayCheckOut, ...]
    loop: BusLoopOut | None
    bus: BusCountsOut
    calibration: CalibrationCheckOut | None = None
    touch_force: TouchForceOut
    hold: HoldCheckOut | None = None
    wiring: WiringOut | None = None
    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    steps: tuple[DoctorStepOut, ...]
    next: str | None

    @property
    def findings(self) -> tuple[FindingOut, ...]:
        """All findings, in the steps' order."""
        return _findings(self.steps)


class DoctorOut(Out):
    """All steps, in the order in which things go wrong. `well`: nothing is wrong; there may be warnings.

    `device_missing`: something is missing or does not answer. `moved`: fingers were moved to see their
    directions. `next`: what to do first; null if there is nothing to do.
    """

    format: Literal["palpate/doctor@1"] = "palpate/doctor@1"
    rig: str
    emulated: bool
    well: bool
    device_missing: bool
    moved: bool
    wiring: WiringOut | None = None
    steps: tuple[DoctorStepOut, ...]
    next: str | None

    @property
    def findings(self) -> tuple[FindingOut, ...]:
        """All findings, in the steps' order."""
        return _findings(self.steps)


def _findings(steps: tuple[DoctorStepOut, ...]) -> tuple[FindingOut, ...]:
    return tuple(item for step in steps for item in step.findings)
