"""Codec of contact lines: a JSON object a line, each a contact reading of a finger; without port or clock.

    {"finger": "left", "t_s": 12.345, "t_bound_s": 0.001, "force_n": 0.52, "force_bound_n": 0.05,
     "angle_deg": -12.5, "angle_bound_deg": 6, "height_mm": 9.1, "height_bound_mm": 1.5}*11d06f52

in one line, which ends with a line feed. Only the force is needed. A value never comes without its bound;
what is not known is left out, and other keys are not looked at. The eight digits are the CRC-32 of all from {
to }. A line begins at its last {, so that garbage before it does not matter.
"""

import json
import math
import zlib
from collections import Counter
from collections.abc import Mapping

from palpate.base.errors import printable_text
from palpate.drivers.tactile.contact_source import source_frame
from palpate.drivers.tactile.frames import ContactReading, DecodedFrame

MAX_LINE_BYTES = 512

_MAX_TIME_S = 1e9
_MAX_FORCE_N = 1e3
_MAX_ANGLE_DEG = 360.0
_MAX_HEIGHT_MM = 1e3
_SUM_DIGITS = 8
_MAX_OLD_LINES = 16  # after which an earlier time is taken for a new beginning

_NO_COUNTS = source_frame(ContactReading(0.0, 0.0)).counts


def encode_line(reading: ContactReading, finger: str | None = None, *, checksum: bool = True) -> bytes:
    """The line of a reading; of a finger that is named where several share a connection."""
    values: dict[str, object] = {} if finger is None else {"finger": finger}
    if reading.time_s is not None:
        values |= {"t_s": reading.time_s, "t_bound_s": reading.time_bound_s}
    values |= {"force_n": reading.force_n, "force_bound_n": reading.force_bound_n}
    if not math.isnan(reading.angle_rad):
        values["angle_deg"] = math.degrees(reading.angle_rad)
        values["angle_bound_deg"] = math.degrees(reading.angle_half_range_rad)
    if not math.isnan(reading.height_mm):
        values |= {"height_mm": reading.height_mm, "height_bound_mm": reading.height_bound_mm}
    rounded = {key: round(value, 6) if isinstance(value, float) else value for key, value in values.items()}
    text = json.dumps(rounded, ensure_ascii=True, separators=(",", ":")).encode()
    return text + (b"*%08x\n" % zlib.crc32(text) if checksum else b"\n")


class ContactLineDecoder:
    """Bytes in, readings of one finger out, however the bytes are cut.

    `source`: the name that its lines carry, None if they carry none. `checksum`: lines without one are
    faults. `faults` counts lines that are damaged, by kind. A line of JSON that makes no sense is a frame
    with a `problem`.
    """

    def __init__(self, source: str | None, *, checksum: bool) -> None:
        self.faults: Counter[str] = Counter()
        self._source, self._checksum = source, checksum
        self._rest = b""
        self._stamped: bool | None = None
        self._newest_s = -math.inf
        self._old_lines = 0

    @property
    def waiting(self) -> int:
        """Bytes that are kept, at most those of the longest line."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[DecodedFrame]:
        """Take bytes as they came; return the readings whose lines they end."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-MAX_LINE_BYTES:]
        found = (self._decode(line[-MAX_LINE_BYTES:]) for line in lines)
        return [frame for frame in found if frame is not None]

    def _decode(self, line: bytes) -> DecodedFrame | None:
        """The reading of a line; None if it is damaged or empty."""
        if not line.strip():
            return None
        values = self._values_of(line.strip())
        if isinstance(values, str):
            self.faults[values] += 1
            return None
        name = values.get("finger")
        if self._source is not None and name is not None and name != self._source:
            return DecodedFrame(_NO_COUNTS, is_other=True)
        try:
            reading = self._check(_reading_of(values), name)
        except ValueError as error:
            return DecodedFrame(_NO_COUNTS, problem=str(error))
        return source_frame(reading)

    def _values_of(self, line: bytes) -> dict[str, object] | str:
        """Values of a line, or the kind of damage."""
        begin, end = line.rfind(b"{"), line.rfind(b"}") + 1
        if not 0 <= begin < end:
            return "no object"
        text, tail = line[begin:end], line[end:]
        if tail and (tail[:1] != b"*" or len(tail) != 1 + _SUM_DIGITS):
            return "more after the object"
        if tail and tail[1:].lower() != b"%08x" % zlib.crc32(text):
            return "wrong checksum"
        if self._checksum and not tail:
            return "no checksum"
        try:
            values: dict[str, object] = json.loads(text.decode())
        except ValueError:
            return "no JSON"
        return values

    def _check(self, reading: ContactReading, name: object) -> ContactReading:
        """The reading, if its finger and its time can be; raises ValueError."""
        if name is None and self._source is not None:
            raise ValueError(f'no "finger", and the rig file has array.source = "{self._source}"')
        if name is not None and self._source is None:
            raise ValueError(f'"finger" is {_show(name)}, and the rig file has no array.source')
        if self._stamped is None:
            self._stamped = reading.time_s is not None
        if self._stamped != (reading.time_s is not None):
            raise ValueError("t_s in some lines and not in others")
        if reading.time_s is not None:
            if reading.time_s <= self._newest_s and self._old_lines < _MAX_OLD_LINES:
                self._old_lines += 1
                raise ValueError(f"t_s = {reading.time_s:.6g} after {self._newest_s:.6g}: time must go on")
            self._newest_s, self._old_lines = reading.time_s, 0
        return reading


def _reading_of(values: Mapping[str, object]) -> ContactReading:
    """The reading of a line. Raises ValueError for values that make no sense."""
    force_n, force_bound_n = _pair(values, "force_n", "force_bound_n", _MAX_FORCE_N)
    if force_n is None or force_bound_n is None:
        raise ValueError("no force_n")
    if force_n + force_bound_n < 0:
        raise ValueError(f"a force that pulls: force_n = {force_n:g} within {force_bound_n:g}")
    angle, angle_bound = _pair(values, "angle_deg", "angle_bound_deg", _MAX_ANGLE_DEG)
    height, height_bound = _pair(values, "height_mm", "height_bound_mm", _MAX_HEIGHT_MM)
    time_s, time_bound_s = _pair(values, "t_s", "t_bound_s", _MAX_TIME_S)
    return ContactReading(
        force_n,
        force_bound_n,
        math.nan if angle is None else math.radians(angle),
        math.pi if angle_bound is None else min(math.radians(angle_bound), math.pi),
        math.nan if height is None else height,
        math.inf if height_bound is None else height_bound,
        time_s,
        time_bound_s or 0.0,
    )


def _pair(
    values: Mapping[str, object], name: str, bound_name: str, most: float
) -> tuple[float, float] | tuple[None, None]:
    """A value and its bound, both None where the line has neither. Raises ValueError."""
    if values.get(name) is None and values.get(bound_name) is None:
        return None, None
    found = []
    for key, least in ((name, -most), (bound_name, 0.0)):
        value = values.get(key)
        if value is None:
            raise ValueError(f"a line without {key}, and with {name if key == bound_name else bound_name}")
        if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
            raise ValueError(f"{key} = {_show(value)}; it is a number from {least:g} to {most:g}")
        found.append(float(value))
    return found[0], found[1]


def _show(value: object) -> str:
    """A value from a line, for a message."""
    return printable_text(json.dumps(value))[:40]
