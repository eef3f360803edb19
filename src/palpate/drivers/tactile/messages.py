"""Messages of the tactile protocol as values: requests of the host, answers and frames of the array.

The byte layout is in `docs/tactile-protocol.md`. What an array says of itself is in `description`.
"""

import enum
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from palpate.base.geometry import Counts
from palpate.drivers.tactile.description import REALS_PER_TAXEL, Description

_U2 = np.dtype("<u2")
MAX_LISTED_TAXELS = 255  # taxels in one TAXELS or REPORT
MAX_TARE_SAMPLES = 1024


class MessageType(enum.IntEnum):
    """Second byte of the header. The high bit is set in what a device sends."""

    HELLO = 0x01
    START = 0x02
    STOP = 0x03
    RATE = 0x04
    TARE = 0x05
    SELF_TEST = 0x06
    GEOMETRY = 0x07
    DESCRIBE = 0x81
    ACK = 0x82
    NACK = 0x83
    REPORT = 0x84
    TAXELS = 0x85
    FRAME = 0x90

    @staticmethod
    def is_request(code: int) -> bool:
        """True if a type, known or not, is one that a host sends."""
        return code < 0x80


class NackReason(enum.IntEnum):
    """Why a device did not do what it was asked to."""

    UNKNOWN_TYPE = 1
    BAD_PAYLOAD = 2
    BAD_RATE = 3
    HARDWARE = 4
    BAD_STATE = 5
    BAD_VERSION = 6


class FrameFlag(enum.IntFlag):
    """Flags of the header of a FRAME."""

    TARED = 1


class SelfTestResult(enum.IntFlag):
    """Faults that a self-test found; 0 is none. Bits without a name are the maker's."""

    PROGRAM_MEMORY = 1
    WORKING_MEMORY = 2
    CONVERTER = 4
    SUPPLY = 8
    TAXELS = 16


class TaxelFault(enum.IntEnum):
    """Fault of a taxel."""

    STUCK_LOW = 1
    STUCK_HIGH = 2
    UNSTEADY = 3


@dataclass(frozen=True)
class Hello:
    """Host: stop streaming and say what you are."""

    request_id: int


@dataclass(frozen=True)
class Start:
    """Host: stream frames at `rate_mhz` thousandths of a frame per second."""

    request_id: int
    rate_mhz: int


@dataclass(frozen=True)
class Stop:
    """Host: stop streaming."""

    request_id: int


@dataclass(frozen=True)
class Rate:
    """Host: go on streaming, at `rate_mhz` thousandths of a frame per second."""

    request_id: int
    rate_mhz: int


@dataclass(frozen=True)
class Tare:
    """Host: take the mean of `samples` frames off, and add `pedestal` counts; 0 samples: raw counts again."""

    request_id: int
    samples: int
    pedestal: int = 0


@dataclass(frozen=True)
class SelfTest:
    """Host: examine yourself."""

    request_id: int


@dataclass(frozen=True)
class Geometry:
    """Host: say where your taxels are, from number `first` (row * columns + column) on."""

    request_id: int
    first: int


@dataclass(frozen=True)
class Describe:
    """Device: the answer to HELLO. `description.geometry` does not travel with it."""

    request_id: int
    description: Description


@dataclass(frozen=True)
class Ack:
    """Device: request carried out."""

    request_id: int


@dataclass(frozen=True)
class Nack:
    """Device: request not carried out."""

    request_id: int
    reason: NackReason


@dataclass(frozen=True)
class BadTaxel:
    """A taxel that a self-test found, and what is wrong with it."""

    row: int
    col: int
    fault: TaxelFault


@dataclass(frozen=True)
class SelfTestReport:
    """Device: what the self-test found. `bad` holds the first 255 of `bad_count` bad taxels."""

    request_id: int
    result: SelfTestResult
    bad_count: int
    bad: tuple[BadTaxel, ...]


@dataclass(frozen=True)
class TaxelPlaces:
    """Device: places of taxels from number `first` on.

    `places` holds six reals each: position x, y, z (mm) and outward unit normal x, y, z, in the tip frame.
    """

    request_id: int
    first: int
    places: tuple[float, ...]

    @property
    def count(self) -> int:
        """Number of taxels that it reports."""
        return len(self.places) // REALS_PER_TAXEL


class Frame(NamedTuple):
    """Device: one sample of every taxel; `taxels` is u16 little endian, lowest row first."""

    rows: int
    cols: int
    taxels: bytes

    @property
    def counts(self) -> Counts:
        """Read-only array, shape (rows, cols)."""
        return np.ndarray((self.rows, self.cols), _U2, self.taxels)


Request: TypeAlias = Hello | Start | Stop | Rate | Tare | SelfTest | Geometry
DeviceAnswer: TypeAlias = Describe | Ack | Nack | SelfTestReport | TaxelPlaces
MessageBody: TypeAlias = Request | DeviceAnswer | Frame


class Message(NamedTuple):
    """A body with the header's fields: the sender's running number and its own time in µs."""

    sequence: int
    time_us: int
    body: MessageBody
    flags: int = 0
