"""Emulated tactile sensors of Weiss Robotics: forces on taxels in, bytes out. Where a real one's port ends.

Written from the sources that `codec` names. Masks, triggers, properties, sensitivity
and the DSA's CAN and USB ports are left out. Decided, because the sources leave it open: what a command with
wrong parameters is answered; that a damaged command is not answered, and one whose rest does not come is
given up after 0.1 s; that STOP at rest succeeds; that single frames are refused during a stream; that a scan
takes 4 ms, a DSA's 33 ms; and that gain is remembered without effect.
"""

import struct
from collections.abc import Callable, Sequence

import numpy as np

from palpate.plugins import Counts, Taxels
from palpate_weiss.codec import WeissDialect, WeissPacket
from palpate_weiss.commands import DsaCommand, DsaStatus, WtsCommand, WtsStatus
from palpate_weiss.emulated_weiss import EmulatedWeiss
from palpate_weiss.messages import (
    COMPRESSED,
    FRAME,
    MAX_TEXEL,
    ControllerInfo,
    MatrixInfo,
    SystemInfo,
)

__all__ = ["BOOT_NOISE", "EmulatedDsa", "EmulatedWts"]

BOOT_NOISE = b"\x1b[5n"
"""A DSA sends this three times while it boots: it asks whether a terminal is there (SDHLibrary)."""

_NOISE_S = (7.0, 7.41, 7.82)  # after power comes on
_LONG_AGO_S = -60.0
_MAX_TAG = 64

_Carry = tuple[int, Callable[[bytes, float], None]]
"""How many bytes of parameters a command has, at least, and what carries it out."""


def _as_it_is(texels: Counts) -> Counts:
    return texels


class EmulatedWts(EmulatedWeiss):
    """A WTS module with one matrix, as `matrix` says; `tag` is what its owner has named it."""

    _dialect = WeissDialect.WTS
    _boot_s = 0.5

    def __init__(  # noqa: PLR0913  # the module's settings, all optional
        self,
        taxels: Taxels,
        matrix: MatrixInfo,
        advance: Callable[[float], None] | None = None,
        *,
        scan_s: float = 0.004,
        baudrate: int = 115200,
        powered_s: float = _LONG_AGO_S,
        tick_s: float = 1e-3,
        to_device: Callable[[Counts], Counts] = _as_it_is,
        tag: str = "emulated",
    ) -> None:
        super().__init__(
            taxels,
            advance,
            scan_s=scan_s,
            baudrate=baudrate,
            powered_s=powered_s,
            tick_s=tick_s,
            to_device=to_device,
        )
        self.matrix = matrix
        self.system = SystemInfo(1, 0x10, 0x2140, 4711)
        self.threshold = 0
        self.gain = 0x80
        self.tag = tag.encode("latin-1")
        self.zero: Counts | None = None
        self._commands: dict[int, tuple[int | None, Callable[[bytes, float], None]]] = {
            WtsCommand.LOOP: (None, lambda data, now: self._done(WtsCommand.LOOP, now, data)),
            WtsCommand.READ_FRAME: (1, self._read_frame),
            WtsCommand.START: (3, self._start_stream),
            WtsCommand.STOP: (0, self._stop_stream),
            WtsCommand.TARE: (1, self._tare),
            WtsCommand.MATRIX_INFO: (0, self._telling(WtsCommand.MATRIX_INFO, self.matrix.pack_wts)),
            WtsCommand.SET_THRESHOLD: (2, self._set_threshold),
            WtsCommand.GET_THRESHOLD: (
                0,
                self._telling(WtsCommand.GET_THRESHOLD, lambda: struct.pack("<H", self.threshold)),
            ),
            WtsCommand.SET_GAIN: (1, self._set_gain),
            WtsCommand.GET_GAIN: (0, self._telling(WtsCommand.GET_GAIN, lambda: bytes((self.gain,)))),
            WtsCommand.SENSOR_TYPE: (0, self._telling(WtsCommand.SENSOR_TYPE, lambda: b"WTS")),
            WtsCommand.TEMPERATURE: (
                0,
                self._telling(WtsCommand.TEMPERATURE, lambda: struct.pack("<h", 231)),
            ),
            WtsCommand.SYSTEM_INFO: (0, self._telling(WtsCommand.SYSTEM_INFO, self.system.pack)),
            WtsCommand.SET_TAG: (None, self._set_tag),
            WtsCommand.GET_TAG: (0, self._telling(WtsCommand.GET_TAG, lambda: self.tag)),
        }

    def _obey(self, packet: WeissPacket, now: float) -> None:
        command, data = packet.command, packet.payload
        if command not in self._commands:
            known = any(command == item for item in WtsCommand)
            status = WtsStatus.FEATURE_NOT_SUPPORTED if known else WtsStatus.CMD_UNKNOWN
            self._answer(command, status, now)
            return
        size, carry_out = self._commands[command]
        if size is None or len(data) == size:
            carry_out(data, now)
        elif size == 0:
            self._answer(command, WtsStatus.NO_PARAM_EXPECTED, now)
        else:
            short = len(data) < size
            self._answer(command, WtsStatus.NOT_ENOUGH_PARAMS if short else WtsStatus.CMD_FORMAT_ERROR, now)

    def _read(self, texels: Counts) -> Counts:
        if self.zero is not None:
            texels = np.maximum(texels.astype(np.int32) - self.zero, 0).astype(np.uint16)
        return np.where(texels < self.threshold, 0, texels).astype(np.uint16)

    def _telling(self, command: WtsCommand, data: Callable[[], bytes]) -> Callable[[bytes, float], None]:
        return lambda _, now: self._done(command, now, data())

    def _done(self, command: WtsCommand, now: float, data: bytes = b"") -> None:
        self._answer(command, WtsStatus.SUCCESS, now, data)

    def _read_frame(self, data: bytes, now: float) -> None:
        if self.streaming:
            self._answer(WtsCommand.READ_FRAME, WtsStatus.ALREADY_RUNNING, now)
            return
        compressed = bool(data[0] & COMPRESSED)

        def send(texels: Counts, at: float) -> None:
            self._done(WtsCommand.READ_FRAME, at, self._frame(texels, at, compressed=compressed))

        self._scan(now, send)

    def _start_stream(self, data: bytes, now: float) -> None:
        if self.streaming:
            self._answer(WtsCommand.START, WtsStatus.ALREADY_RUNNING, now)
            return
        flags, period_ms = struct.unpack("<BH", data)
        self._done(WtsCommand.START, now)
        self._start(period_ms * 1e-3, now, compressed=bool(flags & COMPRESSED))

    def _stop_stream(self, _: bytes, now: float) -> None:
        self._stop()
        self._done(WtsCommand.STOP, now)

    def _tare(self, data: bytes, now: float) -> None:
        self.zero = None
        if data == b"\0":
            self._done(WtsCommand.TARE, now)
            return

        def keep(texels: Counts, at: float) -> None:
            self.zero = texels
            self._done(WtsCommand.TARE, at)

        self._scan(now, keep)

    def _set_threshold(self, data: bytes, now: float) -> None:
        wanted = int.from_bytes(data, "little")
        if wanted > MAX_TEXEL:
            self._answer(WtsCommand.SET_THRESHOLD, WtsStatus.RANGE_ERROR, now)
            return
        self.threshold = wanted
        self._done(WtsCommand.SET_THRESHOLD, now)

    def _set_gain(self, data: bytes, now: float) -> None:
        self.gain = data[0]
        self._done(WtsCommand.SET_GAIN, now)

    def _set_tag(self, data: bytes, now: float) -> None:
        if len(data) > _MAX_TAG:
            self._answer(WtsCommand.SET_TAG, WtsStatus.RANGE_ERROR, now)
            return
        self.tag = data
        self._done(WtsCommand.SET_TAG, now)


class EmulatedDsa(EmulatedWeiss):
    """A DSACON32 controller with several matrices; number `touched` has the taxels, others rest at 0.

    Quirks of the firmware, as SDHLibrary knows them: it streams at its own rate whatever rate is asked for; a
    single frame turns into a stream up to release 288 (269 excepted); a threshold that is to be kept is not
    answered; before release 268 there are no thresholds.
    """

    _dialect = WeissDialect.DSA
    _boot_s = 8.0

    def __init__(  # noqa: PLR0913  # the module's settings, all optional
        self,
        taxels: Taxels,
        matrices: Sequence[MatrixInfo],
        advance: Callable[[float], None] | None = None,
        *,
        touched: int = 0,
        release: int = 290,
        scan_s: float = 1 / 30,
        baudrate: int = 115200,
        powered_s: float = _LONG_AGO_S,
        to_device: Callable[[Counts], Counts] = _as_it_is,
        descriptor: str = "emulated",
    ) -> None:
        super().__init__(
            taxels,
            advance,
            scan_s=scan_s,
            baudrate=baudrate,
            powered_s=powered_s,
            tick_s=1e-3,
            to_device=to_device,
        )
        text = descriptor.encode("latin-1")
        self.matrices = tuple(matrices)
        self.thresholds = [0] * len(self.matrices)
        self.release = release
        self._touched = touched
        self._commands: dict[int, _Carry] = {
            DsaCommand.CONTROLLER_INFO: (0, self._tell_controller),
            DsaCommand.SENSOR_INFO: (0, self._tell_sensor),
            DsaCommand.ACQUIRE: (3, self._acquire),
            DsaCommand.DESCRIPTOR: (2, lambda _, now: self._done(DsaCommand.DESCRIPTOR, now, text)),
            DsaCommand.LOOP: (0, lambda data, now: self._done(DsaCommand.LOOP, now, data)),
            DsaCommand.STATE: (0, self._tell_state),
            DsaCommand.MATRIX_INFO: (1, self._tell_matrix),
        }
        if release >= 268:
            self._commands[DsaCommand.SET_THRESHOLD] = (4, self._set_threshold)
            self._commands[DsaCommand.GET_THRESHOLD] = (1, self._tell_threshold)
        self._queue.extend((powered_s + after, BOOT_NOISE) for after in _NOISE_S if powered_s + after >= 0)

    def _obey(self, packet: WeissPacket, now: float) -> None:
        command, data = packet.command, packet.payload
        if command not in self._commands:
            self._answer(command, DsaStatus.CMD_UNKNOWN, now)
            return
        size, carry_out = self._commands[command]
        if len(data) < size:
            self._answer(command, DsaStatus.NOT_ENOUGH_PARAMS, now)
        else:
            carry_out(data, now)

    def _read(self, texels: Counts) -> Counts:
        parts = [
            texels if number == self._touched else np.zeros(matrix.cells, np.uint16)
            for number, matrix in enumerate(self.matrices)
        ]
        limits = np.repeat(self.thresholds, [matrix.cells for matrix in self.matrices])
        every = np.concatenate(parts)
        return np.where(every < limits, 0, every).astype(np.uint16)

    def _done(self, command: int, now: float, data: bytes = b"") -> None:
        self._answer(command, DsaStatus.SUCCESS, now, data)

    def _tell_controller(self, _: bytes, now: float) -> None:
        self._done(DsaCommand.CONTROLLER_INFO, now, ControllerInfo(815, 0x20, self.release).pack())

    def _tell_sensor(self, _: bytes, now: float) -> None:
        self._done(DsaCommand.SENSOR_INFO, now, struct.pack("<HHBIB", len(self.matrices), 1, 0x10, 4712, 0))

    def _tell_state(self, _: bytes, now: float) -> None:
        self._done(DsaCommand.STATE, now, bytes((0x80 | 0x40 * self.streaming,)))

    def _tell_matrix(self, data: bytes, now: float) -> None:
        if data[0] < len(self.matrices):
            self._done(DsaCommand.MATRIX_INFO, now, self.matrices[data[0]].pack_dsa())
        else:
            self._answer(DsaCommand.MATRIX_INFO, DsaStatus.INDEX_OUT_OF_BOUNDS, now)

    def _tell_threshold(self, data: bytes, now: float) -> None:
        if data[0] < len(self.matrices):
            self._done(DsaCommand.GET_THRESHOLD, now, struct.pack("<H", self.thresholds[data[0]]))
        else:
            self._answer(DsaCommand.GET_THRESHOLD, DsaStatus.INDEX_OUT_OF_BOUNDS, now)

    def _acquire(self, data: bytes, now: float) -> None:
        flags, rate = struct.unpack_from("<BH", data)
        compressed = bool(flags & COMPRESSED)
        self._stop()
        self._once = None
        self._done(DsaCommand.ACQUIRE, now)
        if not flags & 0x80:
            return
        if rate or (self.release <= 288 and self.release != 269):
            self._start(0.0, now, compressed=compressed)
        else:
            self._scan(now, lambda texels, at: self._single(texels, at, compressed=compressed))

    def _single(self, texels: Counts, now: float, *, compressed: bool) -> None:
        self._send(WeissPacket(FRAME, self._frame(texels, now, compressed=compressed)), now)

    def _set_threshold(self, data: bytes, now: float) -> None:
        flags, number, wanted = struct.unpack_from("<BBH", data)
        numbers = range(len(self.matrices)) if flags & 0x02 else [number]
        if wanted > MAX_TEXEL or not all(k < len(self.matrices) for k in numbers):
            self._answer(DsaCommand.SET_THRESHOLD, DsaStatus.INVALID_PARAMETER, now)
            return
        for k in numbers:
            self.thresholds[k] = 0 if flags & 0x01 else wanted
        if not flags & 0x80:
            self._done(DsaCommand.SET_THRESHOLD, now)
