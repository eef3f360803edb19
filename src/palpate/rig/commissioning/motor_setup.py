"""Motor setup: ids, baud rates and limits of a rig's servos, connected one at a time by an operator.

Every write that was confirmed is in the result, also if the setup ends early.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from palpate.base.errors import DeviceError
from palpate.config import RigFile
from palpate.config.commissioning_results import FoundServoOut, SettingChangeOut, SetupOutcome, SetupServoOut
from palpate.drivers.dynamixel import (
    BAUD_RATES,
    Bus,
    FoundServo,
    ItemChange,
    Model,
    ServoPort,
    apply_changes,
    find_changes,
    only_servo,
    scan,
    setup_items,
)
from palpate.rig.fingers import servo_settings


class OperatorReply(Enum):
    """Answer of an operator who was asked to connect a servo."""

    GO = "go"
    SKIP = "skip"
    END = "end"


class Operator(Protocol):
    """The person at the bench."""

    def connect(self, motor: "MotorSetup") -> OperatorReply:
        """Ask to connect one servo alone."""
        ...

    def may_write(self, motor: "MotorSetup", found: FoundServo, changes: Sequence[ItemChange]) -> bool:
        """Show what was found and what would be written; ask whether to write it."""
        ...

    def problem(self, motor: "MotorSetup", problem: str) -> None:
        """Say what is wrong; the person is asked to connect the servo again."""
        ...

    def done(self, motor: "MotorSetup") -> None:
        """Say how it ended for a servo."""
        ...

    def doing(self, what: str) -> None:
        """Say what goes on."""
        ...


@dataclass(eq=False)
class MotorSetup:
    """A servo of the rig file, what it should hold, and how far its setting up has come.

    `among_others`: others may be connected, if it already has its id.
    """

    owner: str
    dxl_id: int
    model: Model
    wanted: Mapping[str, int]
    outcome: SetupOutcome = SetupOutcome.NOT_DONE
    found: FoundServo | None = None
    written: list[ItemChange] = field(default_factory=list)
    problem: str | None = None
    among_others: bool = False

    def out(self) -> SetupServoOut:
        """State of the set-up, for the result."""
        at = self.found
        firmware = None if at is None or at.ping is None else at.ping.firmware
        return SetupServoOut(
            id=self.dxl_id,
            owner=self.owner,
            model=self.model.name,
            outcome=self.outcome,
            found=None
            if at is None or firmware is None
            else FoundServoOut(id=at.dxl_id, baudrate_bps=at.baudrate, firmware=firmware),
            written=tuple(map(SettingChangeOut.of, self.written)),
            problem=self.problem,
        )


def list_motors(rig: RigFile, bus: Bus, dxl_ids: Sequence[int] = ()) -> list[MotorSetup]:
    """The servos to set up, with what each should hold: those of the ids, or all if there are none."""
    return [
        MotorSetup(
            item.owner,
            item.servo.dxl_id,
            item.servo.model,
            setup_items(item.servo, rig.bus.baudrate_bps, item.eeprom()),
            among_others=bool(dxl_ids),
        )
        for item in servo_settings(rig, bus)
        if not dxl_ids or item.servo.dxl_id in dxl_ids
    ]


def set_up_all(motors: Sequence[MotorSetup], wire: ServoPort, port: str, asking: Operator) -> None:
    """Set up one servo after another; each `MotorSetup` says how it ended. After a DeviceError asks again."""
    for motor in motors:
        while motor.outcome is SetupOutcome.NOT_DONE:
            ready = asking.connect(motor)
            if ready is OperatorReply.END:
                return
            if ready is OperatorReply.SKIP:
                motor.outcome = SetupOutcome.SKIPPED
                break
            try:
                motor.outcome = _set_up(motor, wire, port, asking)
                motor.problem = None
            except DeviceError as error:
                motor.problem = str(error)
                asking.problem(motor, str(error))
        asking.done(motor)


def _set_up(motor: MotorSetup, wire: ServoPort, port: str, asking: Operator) -> SetupOutcome:
    found = scan(
        wire.open_port,
        wire.clock,
        BAUD_RATES,
        latency_s=wire.latency_s,
        tell=lambda rate, _: asking.doing(f"looking at {rate} baud"),
    )
    at = only_servo(found, motor.model, port, motor.dxl_id if motor.among_others else None)
    motor.found = motor.found or at
    changes = find_changes(wire, at, motor.model, motor.wanted)
    if not changes:
        return SetupOutcome.WRITTEN if motor.written else SetupOutcome.RIGHT
    if not asking.may_write(motor, at, changes):
        return SetupOutcome.DECLINED
    asking.doing("writing")
    now_at = apply_changes(wire, at, motor.model, changes, motor.written.append)
    asking.doing("reading back")
    left = find_changes(wire, now_at, motor.model, motor.wanted)
    if left:
        items = ", ".join(f"{change.item} at {change.found} instead of {change.wanted}" for change in left)
        raise DeviceError(f"the servo on {port} keeps {items}; check its firmware")
    return SetupOutcome.WRITTEN
