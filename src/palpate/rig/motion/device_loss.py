"""Device loss: what is done when an adapter, a servo or an array is gone, or a run is interrupted.

Torque goes off on every servo, whatever interrupts it and wherever the bus's adapter is by then. An array
that was lost is looked for, and connected again. What is said beside an error (whose it is, what else it may
be due to) is here, too.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.config import FingerConfig, RigFile
from palpate.drivers.dynamixel import (
    Bus,
    DamagedAnswer,
    NotAnswering,
    PortFailed,
    Servo,
    ServoError,
    WatchdogTripped,
    disable_torque,
)
from palpate.drivers.tactile import ArrayDriver, ArrayLost, ArraySilent, Description
from palpate.drivers.transport import Clock, ReopenedPort, describe_renaming
from palpate.rig.arrays import array_of
from palpate.rig.fingers import HostFinger

_REPLUG_S = 20.0  # how long to wait for an adapter that was unplugged while torque was on
_REPLUG_POLL_S = 0.25
_MAX_SWITCH_OFF_TRIES = 3  # whatever interrupts switching off, it is done again


def despite_interruptions(switch_off: Callable[[], list[DeviceError]]) -> list[DeviceError]:
    """Switch off; what interrupts it, such as a signal or lack of memory, is raised once it is done."""
    interruption: BaseException | None = None
    for _ in range(_MAX_SWITCH_OFF_TRIES):
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
    owners = {servo.dxl_id: servo.owner for servo in rig.servos}
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


_RECONNECT_POLL_S = 0.25
_RECONNECT_TIMEOUT_S = 4.0  # how long to wait for an array that was lost, with fingers stopped and torque on
_MAX_RECONNECTS = 3  # in a run; more often, something is wrong that needs a person


class HandArrays:
    """Arrays that are open, by the names of their fingers."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ports: dict[str, ReopenedPort] = {}
        self._arrays: list[ArrayDriver] = []
        self._reconnected = 0

    def open(self, spec: FingerConfig, open_port: Callable[[str, int], SerialBase]) -> ArrayDriver:
        """The array of a finger on its port, which is opened; nothing is asked of it yet."""
        port = ReopenedPort(lambda: open_port(spec.array.port, spec.array.baudrate_bps))
        self._ports[spec.name] = port
        array = array_of(spec, port, self._clock)
        self._arrays.append(array)
        return array

    def stop(self) -> None:
        """Let all arrays rest that can be reached: one that is gone moves nothing."""
        for array in self._arrays:
            with suppress(Exception):
                array.stop()

    def close(self) -> None:
        """Close every port, as often as it is asked."""
        for port in self._ports.values():
            port.close()
        self._ports, self._arrays = {}, []

    def reconnect(self, finger: HostFinger, lost: ArrayLost) -> str | None:
        """Wait for an array that was lost; returns what to say if its port has another name now.

        Raises `lost` if it does not come back or was lost too often in this run, DeviceError if another
        array is there.
        """
        self._reconnected += 1
        if self._reconnected > _MAX_RECONNECTS:
            raise lost
        before, known = self._ports[finger.name].port, finger.array.description
        if self._found_again(finger, lost).unique_id != known.unique_id:
            raise DeviceError(f"{lost}; another array answers there now: plug the arrays as they were")
        now_at = self._ports[finger.name].port
        return describe_renaming(before, now_at) if before and now_at and now_at != before else None

    def _found_again(self, finger: HostFinger, lost: ArrayLost) -> Description:
        """Description of an array that answers again; raises `lost` if it does not."""
        deadline = self._clock.now() + _RECONNECT_TIMEOUT_S
        while self._clock.now() < deadline:
            try:
                return finger.array.connect()
            except ArrayLost:
                self._clock.sleep(_RECONNECT_POLL_S)
            except DeviceError:
                continue
            with suppress(DeviceError):
                self._ports[finger.name].reopen()
        raise lost
