"""Host driver of arrays that speak palpate's own protocol, `docs/tactile-protocol.md`.

A CRC that holds says that a message is as the array sent it, not that the array is well: `FramePlausibility`
judges size, counts and time by the rules of section 4.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, printable_text
from palpate.drivers.tactile.codec import frame_bytes
from palpate.drivers.tactile.description import Corner, Description, Shape
from palpate.drivers.tactile.exchange import ArrayExchange
from palpate.drivers.tactile.frames import ArrayLost, ArraySilent, TactileFrame
from palpate.drivers.tactile.messages import (
    MAX_TARE_SAMPLES,
    Ack,
    Describe,
    Frame,
    FrameFlag,
    Geometry,
    Hello,
    Message,
    Nack,
    NackReason,
    Rate,
    Request,
    SelfTest,
    SelfTestReport,
    Start,
    Stop,
    Tare,
    TaxelPlaces,
)
from palpate.drivers.tactile.stream import Port, StreamedArray
from palpate.drivers.transport.clock import Clock

_MAX_TIME_US = 1 << 53  # 285 years: no array has run for so long
_MAX_TIME_LEAP_S = 2.0
_CLOCK_DRIFT_SHARE = 0.05  # of clocks against each other: RC oscillators are a few per cent off


class FramePlausibility:
    """Looks at every frame of one array."""

    def __init__(self, description: Description) -> None:
        d = description
        self._size = (d.rows, d.cols)
        self._max_count = d.max_count
        # A little-endian number whose set bits no taxel may have.
        self._beyond = int.from_bytes((0xFFFF ^ d.max_count).to_bytes(2, "little") * d.taxels, "little")
        self._first: tuple[int, float] | None = None  # time (µs), and when it was read (s)
        self._last = (0, 0.0)

    def problem(self, message: Message, frame: Frame, now: float) -> str | None:
        """Say what makes no sense in a frame that was read at `now` (s), or None if all does."""
        if (frame.rows, frame.cols) != self._size:
            rows, cols = self._size
            return f"{frame.rows} x {frame.cols} taxels (described: {rows} x {cols})"
        if self._beyond and int.from_bytes(frame.taxels, "little") & self._beyond:
            return self._count_problem(frame)
        time_us = message.time_us
        if self._first is not None:
            last_us, last_s = self._last
            if time_us <= last_us:
                return f"device time {time_us} µs after {last_us} µs (allowed: ascending)"
            # A host that was held up reads old frames late, and then a new one soon after them.
            if _leaps(self._last, time_us, now) and _leaps(self._first, time_us, now):
                return f"device time {time_us} µs after {last_us} µs, {now - last_s:.3g} s later"
        if time_us >= _MAX_TIME_US:
            return f"device time {time_us} µs (allowed: below {_MAX_TIME_US})"
        self._last = (time_us, now)
        if self._first is None:
            self._first = self._last
        return None

    def _count_problem(self, frame: Frame) -> str:
        row, col = map(int, np.unravel_index(int(frame.counts.argmax()), frame.counts.shape))
        return f"count {frame.counts[row, col]} at row {row}, column {col} (allowed: 0 to {self._max_count})"


def _leaps(since: tuple[int, float], time_us: int, now: float) -> bool:
    """True if the device's clock has run further since a frame than the host's can explain."""
    then_us, then_s = since
    return time_us - then_us > ((now - then_s) * (1 + _CLOCK_DRIFT_SHARE) + _MAX_TIME_LEAP_S) * 1e6


_ANSWER_TIMEOUT_S = 0.5
BOOT_ATTEMPTS = (
    10  # a board that resets as its port opens is deaf for up to 3 s, and its first answer may be lost
)
_COMMAND_TIMEOUT_S = 0.15  # short: servos whose Bus Watchdog is armed hear nothing meanwhile
_GEOMETRY_TIMEOUT_S = 1.0  # one answer may have 6 kB, which take 0.5 s at 115200 baud
_SELF_TEST_TIMEOUT_S = 2.5  # the array has 2 s, then comes the time on the wire
_ATTEMPTS = 3
_SELF_TEST_ATTEMPTS = 2
_TARED = int(FrameFlag.TARED)
_ADVICE = {
    NackReason.UNKNOWN_TYPE: "its firmware does not know how; update it or do without",
    NackReason.BAD_PAYLOAD: "check its firmware",
    NackReason.BAD_RATE: "check the rate and the firmware",
    NackReason.HARDWARE: "something in it is broken; repair or replace it",
    NackReason.BAD_STATE: "that needs a running stream; start it first",
    NackReason.BAD_VERSION: "check its firmware",
}

_Granted = TypeVar("_Granted", Ack, SelfTestReport, TaxelPlaces)


class TactileArray(StreamedArray):
    """A tactile array on a port, as an `ArrayDriver`. Call `connect` first.

    Has a verb for every request of the protocol, also for those that palpate itself does not make:
    `set_rate`, `untare` and `self_test` are library API, with which firmware is checked.

    Every verb raises DeviceError, which names the array and says what to do, if the array refuses, does not
    answer, speaks another version of the protocol, or is gone.
    """

    def __init__(
        self, port: SerialBase | Port, clock: Clock, name: str, first: Corner = Corner.LOWER_LEFT
    ) -> None:
        """`first`: the corner from which it counts its taxels, whatever it says."""
        self._first = first
        self._exchange = ArrayExchange(port, clock, name, self._take)
        super().__init__(self._exchange.stream, clock)
        self._check: FramePlausibility | None = None
        self._just_opened = True

    @property
    def _lost_and_faults(self) -> tuple[int, int]:
        decoder = self._exchange.decoder
        return decoder.lost, sum(decoder.faults.values())

    def connect(self) -> Description:
        """Ask the array what it is, and where its taxels are if its surface is free; a running stream stops.

        The array drops its tare. A port that was just opened is given 5 s,
        because many boards reset then.
        """
        self._description = self._check = None
        attempts = BOOT_ATTEMPTS if self._just_opened else _ATTEMPTS
        answer = self._exchange.ask(Hello, Describe, _ANSWER_TIMEOUT_S, attempts)
        if isinstance(answer, Nack):
            raise DeviceError(
                f"{self._stream.where} refuses to describe itself ({answer.reason.name}); "
                "power it off and on, then check its firmware"
            )
        if answer is None:
            raise self._silent()
        self._just_opened = False
        described = replace(answer.description, firmware=printable_text(answer.description.firmware))
        if described.shape is Shape.FREE:
            described = replace(described, geometry=self._geometry(described.taxels))
        self._description = described = described.counted_from(self._first)
        self._stream.clear()
        self._expect(0.0)
        return described

    def _silent(self) -> DeviceError:
        where, noise = self._stream.where, self._exchange.noise
        if noise:
            return ArraySilent(
                f"{where} does not answer, and what it sends is no message of the tactile protocol "
                f"({noise}); check protocol and baud rate in the rig file, and its firmware"
            )
        return ArraySilent(
            f"{where} does not answer; check its power, its cable and the port's name in the rig file"
        )

    def _expect(self, rate_hz: float) -> None:
        """A stream at this rate begins: its frames are compared with each other."""
        self._check = FramePlausibility(self.description)
        self._stream.expect(rate_hz, frame_bytes(self.description.taxels))

    def start(self, rate_hz: float) -> None:
        """Stream frames at `rate_hz`; a running stream begins anew."""
        rate_mhz = self._rate_mhz(rate_hz)
        self._command(lambda number: Start(number, rate_mhz), "start")
        self._expect(rate_hz)

    def set_rate(self, rate_hz: float) -> None:
        """Go on streaming at another rate: the next frame comes one new period after the last one."""
        rate_mhz = self._rate_mhz(rate_hz)
        self._command(lambda number: Rate(number, rate_mhz), "change the rate")
        self._expect(rate_hz)

    def stop(self) -> None:
        """Stop the stream; frames that were on their way stay readable."""
        self._command(Stop, "stop")

    def tare(self, samples: int, pedestal: int = 0) -> None:
        """Let the array take off the mean of its next `samples` frames (1..1024) and add `pedestal` counts.

        Frames come raw until it has them; then they are marked as tared. Touch nothing meanwhile. For
        pictures: the contact extractor wants raw counts.
        """
        most = self.description.max_count
        if not 1 <= samples <= MAX_TARE_SAMPLES or not 0 <= pedestal <= most:
            raise DeviceError(
                f"{self._stream.where} cannot tare with {samples} samples and a pedestal of {pedestal}; "
                f"choose 1 to {MAX_TARE_SAMPLES} samples and 0 to {most} counts"
            )
        self._command(lambda number: Tare(number, samples, pedestal), "tare")

    def untare(self) -> None:
        """Let the array send raw counts again."""
        self._command(lambda number: Tare(number, 0), "send raw counts")

    def self_test(self) -> SelfTestReport:
        """Let the array examine itself, which takes up to 2 s; it must not be streaming."""
        return self._require_report(self._test())

    def self_test_if_known(self) -> SelfTestReport | None:
        """The same; None if the array cannot examine anything."""
        answer = self._test()
        if isinstance(answer, Nack) and answer.reason is NackReason.UNKNOWN_TYPE:
            return None
        return self._require_report(answer)

    def _test(self) -> SelfTestReport | Nack | None:
        return self._exchange.ask(SelfTest, SelfTestReport, _SELF_TEST_TIMEOUT_S, _SELF_TEST_ATTEMPTS)

    def _require_report(self, answer: SelfTestReport | Nack | None) -> SelfTestReport:
        if isinstance(answer, Nack) and answer.reason is NackReason.BAD_STATE:
            raise DeviceError(f"{self._stream.where} cannot test itself while it streams; stop it first")
        return self._require_grant(answer, "test itself")

    def _rate_mhz(self, rate_hz: float) -> int:
        self._check_rate(rate_hz)
        return round(rate_hz * 1000)

    def _geometry(self, taxels: int) -> tuple[float, ...]:
        """Ask where the taxels are, as many at a time as the array likes."""
        places: tuple[float, ...] = ()
        known = 0
        while known < taxels:
            ask = partial(Geometry, first=known)
            answer = self._exchange.ask(ask, TaxelPlaces, _GEOMETRY_TIMEOUT_S, _ATTEMPTS)
            part = self._require_grant(answer, "say where its taxels are")
            if part.first != known or known + part.count > taxels:
                raise DeviceError(
                    f"{self._stream.where} was asked where its taxels are from number {known} on, and "
                    f"reported {part.count} from {part.first} on; it has {taxels}: check its firmware"
                )
            places += part.places
            known += part.count
        return places

    def _command(self, make: Callable[[int], Request], verb: str) -> None:
        self._require_grant(self._exchange.ask(make, Ack, _COMMAND_TIMEOUT_S, _ATTEMPTS), verb)

    def _require_grant(self, answer: _Granted | Nack | None, verb: str) -> _Granted:
        where = self._stream.where
        if isinstance(answer, Nack):
            raise DeviceError(f"{where} refuses to {verb} ({answer.reason.name}); {_ADVICE[answer.reason]}")
        if answer is None:
            name, what = self._stream.name, f"did not answer a request to {verb}"
            raise ArrayLost(name, f"{where} {what}; check its power and its cable")
        return answer

    def _take(self, message: Message, body: Frame) -> None:
        if self._check is None:
            return
        now = self._clock.now()
        problem = self._check.problem(message, body, now)
        if problem is not None:
            self._refuse(problem)
            return
        tared = bool(message.flags & _TARED)
        counts = body.counts if self._first is Corner.LOWER_LEFT else self._first.flip(body.counts)
        self._stream.push(TactileFrame(message.sequence, message.time_us * 1e-6, now, counts, tared))
