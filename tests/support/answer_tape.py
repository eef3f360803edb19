"""What a port and a clock answered, kept and given again from a list, so that nothing but host code runs.

For measuring what the host's own code costs: first with taping ones, in front of a mock port with emulated
servos, then with playing ones. The host must ask the same again in the same order. Shorter and quicker than
the session log's replay, which compares everything; here only writes are compared.
"""

from collections.abc import Iterator

from serial.serialutil import SerialBase

from palpate.drivers.transport.clock import Clock

__all__ = ["PlayingClock", "PlayingPort", "TapingClock", "TapingPort"]

Tape = list[object]


class TapingClock:
    """A clock whose readings go to a tape."""

    def __init__(self, clock: Clock, tape: Tape) -> None:
        self._clock = clock
        self._tape = tape

    def now(self) -> float:
        instant = self._clock.now()
        self._tape.append(instant)
        return instant

    def sleep(self, seconds: float) -> None:
        self._clock.sleep(seconds)


class TapingPort:
    """An open port whose answers go to a tape; it has what the host uses of pyserial's."""

    def __init__(self, port: SerialBase, tape: Tape) -> None:
        self._inner = port
        self._tape = tape
        self.port = port.port
        self.is_open = True

    def read(self, size: int = 1) -> bytes:
        return self._kept(self._inner.read(size))

    def write(self, data: bytes) -> int:
        self._tape.append(bytes(data))
        return self._kept(self._inner.write(bytes(data)))

    @property
    def in_waiting(self) -> int:
        return self._kept(self._inner.in_waiting)

    def reset_input_buffer(self) -> None:
        self._inner.reset_input_buffer()

    def close(self) -> None:
        self._inner.close()

    def __setattr__(self, name: str, value: object) -> None:
        if name in ("baudrate", "timeout"):
            setattr(self._inner, name, value)
        object.__setattr__(self, name, value)

    def _kept(self, answer):
        self._tape.append(answer)
        return answer


class PlayingClock:
    """Gives the readings from a tape again."""

    def __init__(self, answers: Iterator[object]) -> None:
        self.now = answers.__next__

    def sleep(self, seconds: float) -> None:
        """Nothing to wait for."""


class PlayingPort:
    """Gives a port's answers from a tape again. AssertionError if other bytes are written than then."""

    def __init__(self, port: str, answers: Iterator[object]) -> None:
        self.port = port
        self.is_open = True
        self._next = answers.__next__

    def read(self, size: int = 1) -> bytes:  # noqa: ARG002
        return self._next()

    def write(self, data: bytes) -> int:
        then = self._next()
        now = bytes(data)
        assert now == then, f"writes {now!r}, when the tape was made {then!r}"
        return self._next()

    @property
    def in_waiting(self) -> int:
        return self._next()

    def reset_input_buffer(self) -> None:
        """Nothing to drop."""

    def close(self) -> None:
        """Nothing to close."""
