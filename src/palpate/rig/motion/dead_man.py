"""A dead-man switch: a process of its own that switches torque off once the program that drives is gone.

No handler of that program runs after SIGKILL, a crash, or a signal that reaches it while another thread
drives. Then the servos' Bus Watchdog stops them, and torque stays on; this process switches it off. Nothing
of the program is changed for it, neither its signal handlers nor its threads. This file is what the process
runs, and needs nothing but pyserial.
"""

import os
import select
import signal
import subprocess
import sys
import time
from contextlib import closing, suppress
from pathlib import Path

import serial

_RELEASE = b"."
_POLL_S = 0.1  # between two looks at the parent: a fork of the program may hold the pipe open
_BROADCASTS, _PAUSE_S = 5, 0.02  # the first one may meet what the program sent last
_MAX_TRY_S = 5.0  # to open a port that the system still closes, or that stands elsewhere on a hub
_CLOSE_TIMEOUT_S = 2.0


class DeadManSwitch:
    """Writes `packet` to a port if this program ends, in whatever way, before `release`."""

    def __init__(self, url: str, baudrate: int, packet: bytes) -> None:
        """Raises OSError if no process can be started."""
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__, url, str(baudrate), packet.hex()],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": str(Path(serial.__file__).parents[1])},
            start_new_session=True,  # a Ctrl-C at the terminal is not for it
            creationflags=getattr(subprocess, "DETACHED_PROCESS", 0),  # the same on Windows
        )

    def release(self) -> None:
        """Let the process end, as often as it is asked: torque is off."""
        pipe = self._process.stdin
        if pipe is None or pipe.closed:
            return
        with suppress(OSError), pipe:
            pipe.write(_RELEASE)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_CLOSE_TIMEOUT_S)


def _is_released() -> bool:
    """Wait until the program has released this process, or is gone."""
    parent = os.getppid()
    while os.getppid() == parent:
        if os.name == "nt" or select.select([0], [], [], _POLL_S)[0]:  # nothing forks on Windows: read waits
            return os.read(0, 1) == _RELEASE
    return False


def _write(url: str, baudrate: int, packet: bytes) -> None:
    begin, sent = time.monotonic(), 0
    while sent < _BROADCASTS and time.monotonic() - begin < _MAX_TRY_S:
        with suppress(OSError), closing(serial.serial_for_url(url, baudrate)) as port:
            for _ in range(_BROADCASTS):
                port.write(packet)
                port.flush()
                sent += 1
                time.sleep(_PAUSE_S)
        time.sleep(_PAUSE_S)
    seen = "torque off was sent to all servos" if sent else f"{url} could not be opened, torque may be on"
    with suppress(OSError):
        os.write(2, f"palpate: the program ended while it drove the rig; {seen}; palpate stop\n".encode())


if __name__ == "__main__":
    for _name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, _name):  # Windows has no SIGHUP
            signal.signal(getattr(signal, _name), signal.SIG_IGN)
    if not _is_released():
        _write(sys.argv[1], int(sys.argv[2]), bytes.fromhex(sys.argv[3]))
