"""Calls on a port by their letters, as `recording` lists them: what a recorded and a replayed port share."""

from collections.abc import Callable
from typing import Any

from serial.serialutil import SerialBase

from palpate.drivers.transport.recording import PortOpened

__all__ = ["CalledPort"]


class CalledPort(SerialBase):
    """An open pyserial port that makes each of its operations a call; reading and writing are left out."""

    def __init__(
        self,
        opened: PortOpened,
        baudrate: int,
        timeout_s: float | None = 0.0,
        write_timeout_s: float | None = None,
    ) -> None:
        super().__init__()
        self._opened = opened
        self._port = opened.url
        self.name = self.portstr = opened.url
        self._baudrate = baudrate
        self._timeout = timeout_s
        self._write_timeout = write_timeout_s
        self.is_open = True

    def _call(self, letter: str, action: Callable[[Any], Any]) -> int:
        """Make a call, which on a port beneath is `action`; returns its count, 0 if it has none."""
        raise NotImplementedError

    def open(self) -> None:
        """Open again after it was closed."""
        self._call("p", lambda port: port.open())
        self.is_open = True

    def close(self) -> None:
        """Close; closing twice is harmless."""
        if self.is_open:
            self.is_open = False
            self._call("c", lambda port: port.close())

    @property
    def in_waiting(self) -> int:
        """Number of bytes that are ready."""
        return self._call("w", lambda port: port.in_waiting)

    @property
    def out_waiting(self) -> int:
        """Number of bytes that are still to be sent."""
        return self._call("q", lambda port: port.out_waiting)

    def flush(self) -> None:
        """Wait until everything is sent."""
        self._call("f", lambda port: port.flush())

    def reset_input_buffer(self) -> None:
        """Drop what is ready; bytes dropped unread are not recorded."""
        self._call("d", lambda port: port.reset_input_buffer())

    def reset_output_buffer(self) -> None:
        """Drop what is still to be sent."""
        self._call("o", lambda port: port.reset_output_buffer())

    def _reconfigure_port(self) -> None:
        self._call("s", lambda port: self._copy(port, "baudrate", "timeout", "write_timeout"))

    def _update_break_state(self) -> None:
        self._call("m", lambda port: self._copy(port, "break_condition"))

    def _update_rts_state(self) -> None:
        self._call("m", lambda port: self._copy(port, "rts"))

    def _update_dtr_state(self) -> None:
        self._call("m", lambda port: self._copy(port, "dtr"))

    def _copy(self, port: SerialBase, *settings: str) -> None:
        for name in settings:
            setattr(port, name, getattr(self, name))
