"""Results of commands that set up a rig: find-port, scan, setup-motors, home, calibrate, stop."""

from enum import StrEnum
from typing import Literal

from palpate.config.fields import Out, Rounded


class ScannedServoOut(Out):
    """Device that answers to an id at a baud rate.

    `model` is null for a model number that nobody knows, `model_number` and `firmware` also where every
    answer came broken. `crowded`: two servos or more seem to share the id. `owner`: what the rig file calls
    the servo.
    """

    baudrate_bps: int
    id: int
    model: str | None
    model_number: int | None
    firmware: int | None
    crowded: bool
    owner: str | None


class ScanOut(Out):
    """Every servo that was found, and what is wrong."""

    format: Literal["palpate/scan@1"] = "palpate/scan@1"
    port: str
    emulated: bool
    baudrates_bps: tuple[int, ...]
    ids: tuple[int, ...]
    servos: tuple[ScannedServoOut, ...]
    warnings: tuple[str, ...]


class SerialPortOut(Out):
    """A serial port. `name` is what to write into a rig file; what the system does not tell is null."""

    name: str
    device: str
    by_id: str | None
    description: str | None
    usb_id: str | None
    serial_number: str | None
    latency_timer_ms: Rounded | None
    used_by: str | None
    permitted: bool


class SerialPortsOut(Out):
    """All serial ports. `found`: the one that was unplugged and plugged in again, null if nobody did."""

    format: Literal["palpate/serial-ports@1"] = "palpate/serial-ports@1"
    ports: tuple[SerialPortOut, ...]
    found: str | None


class SetupOutcome(StrEnum):
    """End of a servo's set-up."""

    RIGHT = "right already"
    WRITTEN = "written"
    DECLINED = "declined"
    SKIPPED = "skipped"
    NOT_DONE = "not done"


class FoundServoOut(Out):
    """Id and baud rate at which a servo answered, and its firmware."""

    id: int
    baudrate_bps: int
    firmware: int


class SettingChangeOut(Out):
    """An item that was written and confirmed: its values before and after."""

    item: str
    found: int
    wanted: int


class SetupServoOut(Out):
    """A servo of the rig file. `problem`: why it is not done, null if nobody got that far."""

    id: int
    owner: str
    model: str
    outcome: SetupOutcome
    found: FoundServoOut | None
    written: tuple[SettingChangeOut, ...]
    problem: str | None


class SetupOut(Out):
    """Every servo of the rig file, or those that were chosen."""

    format: Literal["palpate/setup@1"] = "palpate/setup@1"
    rig: str
    port: str
    emulated: bool
    baudrate_bps: int
    servos: tuple[SetupServoOut, ...]


class StoppedServoOut(Out):
    """A servo of the rig file, or one that answers. `off`: it has confirmed that torque is off."""

    id: int
    owner: str | None
    off: bool
    problem: str | None


class StopOut(Out):
    """Devices that were told to stop, and what confirmed it.

    `told`: how often everybody was told to switch torque off. `taken`: another program had the port all the
    time, so that nobody could be asked; `servos` is empty then.
    """

    format: Literal["palpate/stop@1"] = "palpate/stop@1"
    port: str
    emulated: bool
    baudrate_bps: int
    told: int
    taken: bool
    confirmed: bool
    servos: tuple[StoppedServoOut, ...]


class RebootedServoOut(Out):
    """A servo that was told to restart, and the hardware errors that it had latched, and has again.

    `problem`: why it is not known to be back with torque off, null if it is.
    """

    id: int
    owner: str
    latched: tuple[str, ...] = ()
    again: tuple[str, ...] = ()
    problem: str | None = None


class RebootOut(Out):
    """Servos that were restarted. `well`: all are back, with torque off and without hardware errors."""

    format: Literal["palpate/reboot@1"] = "palpate/reboot@1"
    port: str
    emulated: bool
    baudrate_bps: int
    well: bool
    servos: tuple[RebootedServoOut, ...]


class HomedSlideOut(Out):
    """A slide whose turn is known now: servo `dxl_id` counts `turns` ahead of the rig file's angles."""

    finger: str
    dxl_id: int
    turns: int


class HomeOut(Out):
    """Slides that were homed, in the order of the rig file's fingers."""

    format: Literal["palpate/home@1"] = "palpate/home@1"
    slides: tuple[HomedSlideOut, ...]


class CalibratedFingerOut(Out):
    """One finger, as far as it is calibrated; null where it is not.

    `position_mm`, `direction_deg`: bounds on its contacts. `moved_mm`, `turned_deg`: how far base and heading
    are from what the rig file says. `unusable`: taxels that are left out.
    """

    name: str
    position_mm: Rounded | None
    direction_deg: Rounded | None
    moved_mm: Rounded | None
    turned_deg: Rounded | None
    tip_radius_mm: Rounded | None
    backlash_mm: Rounded | None
    stiffness_n_per_mm: Rounded | None
    unusable: int | None


class CalibratedStageOut(Out):
    """The turning stage: its axis in W with the bound on that, and its play.

    `moved_mm`: how far the axis is from what the rig file says. `rms_mm`: residuals of touches at its angles.
    """

    centre_mm: tuple[Rounded, Rounded]
    centre_bound_mm: Rounded
    moved_mm: Rounded
    backlash_deg: Rounded
    touches: int
    rms_mm: Rounded


class CalibrateOut(Out):
    """A calibration that was carried out. `steps`: those that it was asked for; `file`, `report`: written.

    `rms_mm`, `held_out_rms_mm`: residuals of touches, fitted and predicted; null before fingers were placed.
    `stage`: null if there is none, or if it is not calibrated.
    `rig_seconds` is the rig's own time (virtual when emulated), `wall_seconds` what the user waited.
    """

    format: Literal["palpate/calibrate@1"] = "palpate/calibrate@1"
    rig: str
    emulated: bool
    steps: tuple[str, ...]
    file: str
    report: str
    coverage: Rounded
    fingers: tuple[CalibratedFingerOut, ...]
    touches: int | None
    outliers: int | None
    rms_mm: Rounded | None
    held_out_rms_mm: Rounded | None
    stage: CalibratedStageOut | None
    rig_seconds: Rounded
    wall_seconds: Rounded
