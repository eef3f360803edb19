"""Host drivers of Weiss Robotics' tactile sensors, as `ArrayDriver`s: WTS modules and the DSA.

Sources as in `codec`. What the devices cannot report, counts per N and how the matrix sits on the tip, comes
with a `Mounting`.
"""

import math

from palpate.plugins import Description, DeviceError
from palpate_weiss.codec import WeissDialect, WeissPacket
from palpate_weiss.commands import DsaCommand, DsaStatus, WtsCommand, WtsStatus
from palpate_weiss.messages import ControllerInfo, MatrixInfo, SystemInfo, parse_frame
from palpate_weiss.weiss_array import BOOT_ATTEMPTS, WeissArray, text_of

__all__ = ["DsaArray", "WtsArray"]

_BOOT_TIMEOUT_S = 1.0
_FIRST_FRAME_S = 0.3  # a frame at 115,200 baud takes up to 0.1 s
_ATTEMPTS = 3
_BOOT_ATTEMPTS = 10  # a DSA takes 8 s to boot, and does not hear what is said meanwhile
_EMULATED = "emulated"  # how the tag or the descriptor of an emulated device begins


class WtsArray(WeissArray):
    """A WTS tactile sensor module on a port, as an `ArrayDriver`. Call `connect` first.

    Its manual was not at hand where it gives the unit of the stamps. `connect` measures it: two frames,
    a tenth of a second apart, distinguish milliseconds from what is ten, a hundred or a thousand times
    finer.
    """

    _dialect = WeissDialect.WTS
    _statuses = WtsStatus
    _MAX_RATE_HZ = 1000.0  # periods are whole ms; what module and wire can do is less

    def stop(self) -> None:
        """Stop the stream; frames that were on their way stay readable."""
        self._command(WtsCommand.STOP, fine=tuple(WtsStatus))  # one that rests may say so

    def _begin(self, rate_hz: float) -> None:
        self.stop()  # a second START is refused
        self._new_stream()
        period_ms = max(1, round(1000 / rate_hz))
        fine = (WtsStatus.SUCCESS, WtsStatus.ALREADY_RUNNING)  # an answer was lost, and it was asked again
        self._command(WtsCommand.START, b"\0" + period_ms.to_bytes(2, "little"), fine=fine)

    def _introduce(self) -> tuple[Description, float]:
        if self._ask(WeissPacket(WtsCommand.STOP), BOOT_ATTEMPTS) is None:
            raise self._silent()
        self._matrices = (MatrixInfo.parse_wts(self._request(WtsCommand.MATRIX_INFO)),)
        system = SystemInfo.parse(self._request(WtsCommand.SYSTEM_INFO))
        kind = text_of(self._inquire(WtsCommand.SENSOR_TYPE))
        tag = text_of(self._inquire(WtsCommand.GET_TAG))
        self._inquire(WtsCommand.TARE, b"\0")
        self._inquire(WtsCommand.SET_THRESHOLD, b"\0\0")
        tick_s = self._tick_s()
        name = f"{kind or 'WTS'} {system.version}"
        uid = b"WTS" + system.serial.to_bytes(4, "little") + bytes((system.hardware,))
        described = self._describe(uid, name, emulated=tag.startswith(_EMULATED), limit_hz=self._MAX_RATE_HZ)
        return described, tick_s

    def _tick_s(self) -> float:
        """Unit of the frames' stamps in s."""
        begin, first = self._stamp()
        self._stream.wait_until(lambda: False, 0.1)
        end, second = self._stamp()
        ticks = (second - first) % (1 << 32)
        if not ticks:
            raise ValueError("its clock stands still")
        power = round(math.log10((end - begin) / ticks))
        return float(10.0 ** min(max(power, -6), -3))

    def _stamp(self) -> tuple[float, int]:
        """Host's clock (s) and the module's, at one frame."""
        payload = self._request(WtsCommand.READ_FRAME, b"\0")
        return self._clock.now(), parse_frame(payload, self._cells).timestamp


class DsaArray(WeissArray):
    """One matrix of a DSA tactile sensor on a port, as an `ArrayDriver`. Call `connect` first.

    The controller sends all its matrices in each frame; all but `matrix` are read past. A port has one owner,
    so that two fingers cannot share a controller yet. While it boots, for 8 s after power comes on,
    `connect` waits for it. It streams as fast as it can, about 30 frames a second, at any rate asked for.
    """

    _dialect = WeissDialect.DSA
    _statuses = DsaStatus
    _MAX_RATE_HZ = 30.0
    _TICK_S = 1e-3
    _ACQUIRE = 0x80
    _COMPRESS = 0x01
    _ALL_MATRICES = 0x02
    _DESCRIPTOR_OF_SENSOR = b"\0\0"
    _RELEASE_WITH_THRESHOLDS = 268

    def stop(self) -> None:
        """Stop the stream; frames that were on their way stay readable."""
        self._command(DsaCommand.ACQUIRE, bytes(3))

    def _begin(self, rate_hz: float) -> None:
        """Ask until frames come: answers to starting and to stopping look the same."""
        self._new_stream()
        flags = bytes((self._ACQUIRE | self._COMPRESS,))
        before = self._stream.received
        for _ in range(_ATTEMPTS):
            self._command(DsaCommand.ACQUIRE, flags + max(1, round(rate_hz)).to_bytes(2, "little"))
            if self._stream.wait_until(lambda: self._stream.received > before, _FIRST_FRAME_S):
                return
        raise DeviceError(
            f"{self._stream.where} was started and sends no frames; power it off and on, check its firmware"
        )

    def _arriving_hz(self, rate_hz: float) -> float:
        """It sends as fast as it can, whatever is asked for."""
        return max(rate_hz, self._MAX_RATE_HZ)

    def _introduce(self) -> tuple[Description, float]:
        if self._ask(WeissPacket(DsaCommand.ACQUIRE, bytes(3)), _BOOT_ATTEMPTS, _BOOT_TIMEOUT_S) is None:
            raise self._silent()
        controller = ControllerInfo.parse(self._request(DsaCommand.CONTROLLER_INFO))
        count = ControllerInfo.matrices(self._request(DsaCommand.SENSOR_INFO))
        number = self._matrix
        if number >= count:
            raise ValueError(f"it has {count} matrices, counted from 0, and no matrix {number}")
        self._matrices = tuple(
            MatrixInfo.parse_dsa(self._request(DsaCommand.MATRIX_INFO, bytes((k,))))
            for k in range(min(count, 256))
        )
        kind = text_of(self._inquire(DsaCommand.DESCRIPTOR, self._DESCRIPTOR_OF_SENSOR))
        if controller.release >= self._RELEASE_WITH_THRESHOLDS:
            self._inquire(DsaCommand.SET_THRESHOLD, bytes((self._ALL_MATRICES, 0, 0, 0)))
        described = self._describe(
            b"DSA" + controller.serial.to_bytes(4, "little") + bytes((number,)) + self._matrices[number].uid,
            f"DSACON32 R{controller.release}",
            emulated=kind.startswith(_EMULATED),
            limit_hz=self._MAX_RATE_HZ,
        )
        return described, self._TICK_S
