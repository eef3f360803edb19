"""Free-running arrays: they send frames from the moment they have power.

Nothing can be asked of such a sensor: what it is comes from the rig file. Most stamp no time. Then a frame
was sampled no later than it arrived, and earlier by no more than what sensor, wire and adapter take
(`delay_s`, stated) and what passed since the port was last seen to be empty (measured).
"""

import math
from typing import ClassVar

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.frames import FrameDecoder, FrameTime, FrameTimes, TactileFrame
from palpate.drivers.tactile.stream import FrameStream, Port, StreamedArray
from palpate.drivers.transport.clock import Clock

_CONNECT_S = 3.0  # boards that restart when their port is opened take up to two
_COUNTED_S = 0.5
_LEAST_RATE_SHARE = 0.9
_MAX_RATE_RATIO = 1.2


class FreeRunningArray(StreamedArray):
    """The driver of such an array, as `description` has it, which comes from the rig file.

    `frame_bytes`: of a frame on the wire. `max_rate_hz` of the description is the rate at which it sends.
    """

    tick_s: ClassVar[float] = 1e-6
    """Unit of stamps."""

    def __init__(
        self,
        port: Port,
        clock: Clock,
        finger: str,
        description: Description,
        decoder: FrameDecoder,
        frame_bytes: int,
        delay_s: float,
    ) -> None:
        super().__init__(FrameStream(port, clock, finger, self._take), clock)
        self._stated, self._decoder = description, decoder
        self._frame_bytes, self._delay_s = frame_bytes, delay_s
        self._seen = 0
        self._sequence = -1
        self._times = FrameTimes(self.tick_s)
        self._since_s: float | None = None

    @property
    def _lost_and_faults(self) -> tuple[int, int]:
        """Number of frames that never came, 0 without stamps, and of stretches that were no frame."""
        return self._times.lost, sum(self._decoder.faults.values())

    def connect(self) -> Description:
        """Wait for frames, and see that they come as fast as is stated."""
        self._description, self._since_s = None, None
        stated, where = self._stated, self._stream.where
        if (problem := stated.problem()) is not None:
            raise DeviceError(f"{where} cannot be used: it has {problem}; check the rig file")
        self._stream.expect(_MAX_RATE_RATIO * stated.max_rate_hz, self._frame_bytes)
        before = self._seen
        if not self._stream.wait_until(lambda: self._seen > before, _CONNECT_S):
            self._stream.frames()  # raises what is wrong with frames that make no sense
            raise DeviceError(
                f"{where} does not answer; check its power, its cable, its port and the baud rate: it came "
                f"{self._stream.silence}, and frames of up to {self._frame_bytes} bytes are expected"
            )
        first, begun_s = self._seen, self._clock.now()
        self._stream.wait_until(lambda: False, max(_COUNTED_S, 8 / stated.max_rate_hz))
        rate = (self._seen - first) / (self._clock.now() - begun_s)
        if rate < _LEAST_RATE_SHARE * stated.max_rate_hz - 2 / _COUNTED_S:
            raise DeviceError(
                f"{where} sends {rate:.0f} frames/s, and the rig file says rate_hz = {stated.max_rate_hz:g}; "
                "correct that, and sample_rate_hz"
            )
        self._stream.clear()
        self._times.restart()
        self._description = stated
        return stated

    def listen(self) -> None:
        """Take the description for granted, and all frames from now on: of a recording."""
        self._description, self._since_s = self._stated, -math.inf
        self._stream.expect(_MAX_RATE_RATIO * self._stated.max_rate_hz, self._frame_bytes)

    def start(self, rate_hz: float) -> None:
        """Take frames from now on: all of them, whatever rate is asked for."""
        self._check_rate(rate_hz)
        self._stream.drain()
        if self._since_s is None:
            self._since_s = self._clock.now()
        self._stream.expect(_MAX_RATE_RATIO * self.description.max_rate_hz, self._frame_bytes)

    def stop(self) -> None:
        """Take no more frames; those that have come stay readable."""
        self._stream.drain()
        self._since_s = None

    def _take(self, data: bytes) -> None:
        for counts, stamp, contact, problem, is_other in self._decoder.feed(data):
            if is_other:
                self._stream.note_answer()  # the wire is sound
                continue
            if problem is not None:
                self._refuse(problem)
                continue
            self._seen += 1
            now, age_s = self._clock.now(), self._delay_s + self._stream.read_within_s
            if self._since_s is None or now - age_s < self._since_s:
                self._stream.note_answer()
                self._times.restart()
                continue  # it was sampled before the stream was asked for, or may have been
            place = FrameTime(self._sequence + 1, now) if stamp is None else self._times.place(stamp)
            if place is None:
                self._refuse(f"a time that cannot be: {stamp}")
                continue
            self._sequence = place.sequence
            within_s = age_s if stamp is None else None
            self._stream.push(
                TactileFrame(place.sequence, place.time_s, now, counts, age_s=within_s, contact=contact)
            )
