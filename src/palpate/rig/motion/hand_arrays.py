"""The arrays of a hand on their ports: one that was lost is looked for, and connected again."""

from collections.abc import Callable
from contextlib import suppress

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.config import FingerConfig
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.frames import ArrayDriver, ArrayLost
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.plugged_ports import renamed
from palpate.drivers.transport.reopened_port import ReopenedPort
from palpate.rig.arrays import array_of
from palpate.rig.host_finger import HostFinger

__all__ = ["HandArrays"]

_POLL_S = 0.25
_BACK_S = 4.0  # how long to wait for an array that was lost, with fingers stopped and torque on
_MOST_RECONNECTED = 3  # in a run; more often, something is wrong that needs a person


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
        if self._reconnected > _MOST_RECONNECTED:
            raise lost
        before, known = self._ports[finger.name].port, finger.array.description
        if self._found_again(finger, lost).unique_id != known.unique_id:
            raise DeviceError(f"{lost}; another array answers there now: plug the arrays as they were")
        now_at = self._ports[finger.name].port
        return renamed(before, now_at) if before and now_at and now_at != before else None

    def _found_again(self, finger: HostFinger, lost: ArrayLost) -> Description:
        """What an array says of itself that answers again; raises `lost` if it does not."""
        deadline = self._clock.now() + _BACK_S
        while self._clock.now() < deadline:
            try:
                return finger.array.connect()
            except ArrayLost:
                self._clock.sleep(_POLL_S)
            except DeviceError:
                continue
            with suppress(DeviceError):
                self._ports[finger.name].reopen()
        raise lost
