"""The baud rate that a client has set on a pseudo-terminal, also one that termios has no name for."""

import fcntl
import struct
import termios

__all__ = ["baud_rate"]

# struct termios2 of <asm-generic/termbits.h>: four words of flags, c_line and c_cc, both speeds as numbers
_TCGETS2 = 0x802C542A
_TERMIOS2 = struct.Struct("4I20s2I")
_NAMED = {
    getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()
}


def baud_rate(fd: int) -> int | None:
    """Rate (baud) at which a terminal sends; None if the system cannot tell.

    Python's termios knows named rates only, and cannot tell if the client has set its rate as a number, as
    some do at any rate.
    """
    try:
        return int(_TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size)))[-1])
    except OSError:
        return _NAMED.get(termios.tcgetattr(fd)[5])
