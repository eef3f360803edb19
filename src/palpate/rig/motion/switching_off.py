"""Switching off: torque off on every servo, whatever interrupts it and wherever the bus's adapter is by then.

What is said beside an error, whose it is, because of it or of what else it may be due to, is here, too.
"""

from collections.abc import Callable, Sequence

from palpate.base.errors import DeviceError
from palpate.config import RigFile
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.errors import (
    DamagedAnswer,
    NotAnswering,
    PortFailed,
    ServoError,
    WatchdogTripped,
)
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.torque import disable_torque
from palpate.drivers.tactile.frames import ArrayLost, ArraySilent
from palpate.drivers.transport.clock import Clock

__all__ = ["despite_interruptions", "name_owners", "note_other_causes", "note_what_is_on", "switch_off"]

_REPLUG_S = 20.0  # how long to wait for an adapter that was unplugged while torque was on
_REPLUG_POLL_S = 0.25
_TRIES = 3  # whatever interrupts switching off, it is done again


def despite_interruptions(switch_off: Callable[[], list[DeviceError]]) -> list[DeviceError]:
    """Switch off; what interrupts it, such as a signal or lack of memory, is raised once it is done."""
    interruption: BaseException | None = None
    for _ in range(_TRIES):
        try:
            failed = switch_off()
        except BaseException as error:
            interruption = interruption or error
            continue
        if interruption is None:
            return failed
        note_what_is_on(interruption, failed)
        break
    else:
        assert interruption is not None
        interruption.add_note("warning: torque may be on; cut the power before you reach in")
    raise interruption


def switch_off(
    bus: Bus, servos: Sequence[Servo], clock: Clock, notice: Callable[[str], None]
) -> list[DeviceError]:
    """Switch torque off, also if the bus's adapter has to be plugged in again for that.

    Returns what could not be switched off. `bus` may be on a port of another name afterwards.
    """
    failed = disable_torque(bus, servos)
    if not any(isinstance(error, PortFailed) for error in failed):
        return failed
    notice(
        f"{bus.port_name} is gone and torque may be on: plug it in again within {_REPLUG_S:g} s, "
        "or cut the servos' power"
    )
    deadline = clock.now() + _REPLUG_S
    while clock.now() < deadline:
        clock.sleep(_REPLUG_POLL_S)
        try:
            bus.reconnect()
        except DeviceError:
            continue
        failed = disable_torque(bus, servos)
        if not any(isinstance(error, PortFailed) for error in failed):
            break
    return failed


def note_what_is_on(error: BaseException, failed: Sequence[DeviceError]) -> None:
    """Add to what ends the run that some torque may still be on."""
    if failed:
        servos = "one servo" if len(failed) == 1 else f"{len(failed)} servos"
        error.add_note(
            f"warning: {servos} did not confirm that torque is off ({failed[0]}); "
            "cut the power before you reach in"
        )


def name_owners(error: BaseException, rig: RigFile) -> None:
    """Put before a servo's error whose joint it is, as "f1 slide: servo 12 on …"."""
    if not isinstance(error, ServoError | WatchdogTripped):
        return
    owners = {} if rig.stage is None else {rig.stage.dxl_id: "stage"}
    owners |= {
        servo.dxl_id: f"{finger.name} {joint}"
        for finger in rig.fingers
        for joint, servo in finger.servos.items()
    }
    named = [owners[dxl_id] for dxl_id in error.dxl_ids if dxl_id in owners]
    if named:
        error.args = (f"{', '.join(named)}: {error}",)


def note_other_causes(error: BaseException) -> None:
    """Add to a device's silence what else it may be due to."""
    if isinstance(error, NotAnswering | DamagedAnswer | ArraySilent | ArrayLost):
        error.add_note(
            "another program, such as ModemManager after plugging in, may have the port, too: "
            "palpate doctor names it"
        )
