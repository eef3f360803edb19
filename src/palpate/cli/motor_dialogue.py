"""Dialogue of `setup-motors`: a person connects one servo after another, and confirms each change."""

from collections.abc import Sequence
from contextlib import closing

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.cli.terminal import StatusLine, Terminal
from palpate.config import RigFile
from palpate.config.commissioning_results import SetupOut, SetupOutcome
from palpate.config.fields import to_json
from palpate.drivers.dynamixel import BAUD_RATE, BAUD_RATES, Bus, FoundServo, ItemChange, ServoPort
from palpate.rig.commissioning.motor_setup import MotorSetup, OperatorReply, list_motors, set_up_all
from palpate.rig.diagnostics.servo_bus import BusEndpoint
from palpate.views.tables import table

_ENDINGS = {
    SetupOutcome.RIGHT: "is right already, nothing was written",
    SetupOutcome.WRITTEN: "is set up: written and read back",
    SetupOutcome.DECLINED: "is left as it was",
    SetupOutcome.SKIPPED: "was skipped",
    SetupOutcome.NOT_DONE: "is not done",
}


def set_up_motors(rig: RigFile, place: BusEndpoint, dxl_ids: Sequence[int], *, yes: bool, json: bool) -> int:
    """Set up and tell; returns the exit code: 1 if something was skipped or declined, 3 if not done."""
    baudrate = rig.bus.baudrate_bps
    with closing(Bus(place.open(baudrate), place.clock, baudrate, latency_s=place.latency_s)) as bus:
        motors = list_motors(rig, bus, dxl_ids)
    console = Terminal(stderr=True, soft_wrap=True)
    person = _ConsoleOperator(console, len(motors), yes=yes)
    wire = ServoPort(place.open, place.clock, place.latency_s)
    try:
        set_up_all(motors, wire, place.port, person)
    except BaseException as error:
        for motor in motors:
            if motor.written and motor.outcome is SetupOutcome.NOT_DONE:
                error.add_note(_partial_setup_words(motor))
        raise
    finally:
        person.quiet()
        if json:
            typer.echo(to_json(_setup_out(rig, place, motors)))
    _summary(console, motors)
    outcomes = {motor.outcome for motor in motors}
    if SetupOutcome.NOT_DONE in outcomes:
        return 3
    return 1 if outcomes & {SetupOutcome.SKIPPED, SetupOutcome.DECLINED} else 0


class _ConsoleOperator:
    """Asks on standard input; everything goes to stderr."""

    def __init__(self, console: Console, count: int, *, yes: bool) -> None:
        self._console = console
        self._count = count
        self._yes = yes
        self._number = 0
        self._last: MotorSetup | None = None
        self._doing: StatusLine | None = None

    def connect(self, motor: MotorSetup) -> OperatorReply:
        if motor is not self._last:
            self._last, self._number = motor, self._number + 1
            title = f"servo {motor.dxl_id}: {motor.owner}, {motor.model.name}"
            self._say(f"\n[bold]{escape(title)}[/]  ({self._number} of {self._count})")
        try:
            text = typer.prompt(
                f"connect {'' if motor.among_others else 'only '}this servo, then press Enter "
                "(s skips it, q ends)",
                default="",
                show_default=False,
                err=True,
            )
        except typer.Abort:
            return OperatorReply.END
        return {"s": OperatorReply.SKIP, "q": OperatorReply.END}.get(
            str(text).strip().lower()[:1], OperatorReply.GO
        )

    def may_write(self, motor: MotorSetup, found: FoundServo, changes: Sequence[ItemChange]) -> bool:
        self.quiet()
        firmware = "" if found.ping is None else f", firmware {found.ping.firmware}"
        self._say(f"found {motor.model.name}{firmware}, id {found.dxl_id}, {found.baudrate} baud")
        self._console.print(_change_table(changes))
        if self._yes:
            return True
        try:
            return typer.confirm("write this to its EEPROM?", default=False, err=True)
        except typer.Abort:
            return False

    def problem(self, motor: MotorSetup, problem: str) -> None:
        del motor
        self.quiet()
        self._say(f"[red]{escape(problem)}[/]")

    def done(self, motor: MotorSetup) -> None:
        self.quiet()
        self._say(f"servo {motor.dxl_id} {_ENDINGS[motor.outcome]}")

    def doing(self, what: str) -> None:
        if self._doing is None:
            self._doing = StatusLine(self._console, what)
            self._doing.__enter__()
        self._doing.now(what)

    def quiet(self) -> None:
        """End the moving line, before something is asked or printed."""
        if self._doing is not None:
            self._doing.__exit__(None, None, None)
            self._doing = None

    def _say(self, text: str) -> None:
        self._console.print(text, highlight=False)


def _change_table(changes: Sequence[ItemChange]) -> Table:
    rows = table("item", "now", "will be", numbers=("now", "will be"))
    for change in changes:
        rows.add_row(
            change.item, _value_text(change.item, change.found), _value_text(change.item, change.wanted)
        )
    return rows


def _value_text(item: str, value: int) -> str:
    """A value as people know it: baud rates are written as codes."""
    if item == BAUD_RATE.name and 0 <= value < len(BAUD_RATES):
        return f"{BAUD_RATES[value]} baud"
    return str(value)


def _partial_setup_words(motor: MotorSetup) -> str:
    written = ", ".join(
        f"{change.item} {_value_text(change.item, change.found)} → {_value_text(change.item, change.wanted)}"
        for change in motor.written
    )
    return (
        f"servo {motor.dxl_id} ({motor.owner}) is set up in part, torque off: {written}; "
        "`palpate setup-motors` goes on from there"
    )


def _summary(console: Console, motors: Sequence[MotorSetup]) -> None:
    console.print()
    for motor in motors:
        if motor.outcome is SetupOutcome.NOT_DONE:
            reason = "" if motor.problem is None else f": {motor.problem}"
            console.print(
                f"servo {motor.dxl_id} ({motor.owner}) is not done{reason}", highlight=False, markup=False
            )
            if motor.written:
                console.print(_partial_setup_words(motor), highlight=False, markup=False)
    good = sum(motor.outcome in (SetupOutcome.RIGHT, SetupOutcome.WRITTEN) for motor in motors)
    console.print(f"as the rig file wants them: {good} of {len(motors)}", highlight=False)
    if good == len(motors):
        console.print("connect all servos, then run: palpate check --rig FILE", highlight=False)


def _setup_out(rig: RigFile, place: BusEndpoint, motors: Sequence[MotorSetup]) -> SetupOut:
    return SetupOut.of(
        place,
        rig=rig.name,
        baudrate_bps=rig.bus.baudrate_bps,
        servos=tuple(motor.out() for motor in motors),
    )
