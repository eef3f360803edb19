"""The emulated WTS and DSA by themselves: what their sources say they answer."""

import struct

import numpy as np
import pytest

from palpate_weiss.codec import WeissDecoder, WeissDialect, WeissPacket, encode
from palpate_weiss.commands import DsaCommand, DsaStatus, WtsCommand, WtsStatus
from palpate_weiss.emulated_arrays import BOOT_NOISE
from palpate_weiss.messages import parse_frame, status_of
from support.devices.weiss import MATRIX, OTHER, Bench


class Talk:
    """Says packets to a device and hears what it sends."""

    def __init__(self, protocol: str, **options: object) -> None:
        self.bench = Bench(protocol, **options)
        self.dialect = WeissDialect.WTS if protocol == "weiss-wts" else WeissDialect.DSA
        self.now = 0.0

    def say(self, command: int, payload: bytes = b"", wait_s: float = 0.01) -> list[WeissPacket]:
        sent = self.bench.device.feed(encode(self.dialect, WeissPacket(command, payload)), self.now)
        return self._heard(sent) + self.wait(wait_s)

    def wait(self, seconds: float) -> list[WeissPacket]:
        self.now += seconds
        return self._heard(self.bench.device.poll(self.now))

    def _heard(self, emissions: list[tuple[float, bytes]]) -> list[WeissPacket]:
        items = WeissDecoder(self.dialect).feed(b"".join(data for _, data in emissions))
        assert all(isinstance(item, WeissPacket) for item in items)
        return items


def status(packets: list[WeissPacket], kind: type) -> object:
    (packet,) = packets
    return kind(status_of(packet.payload))


def test_a_wts_answers_what_it_knows_and_names_what_it_does_not() -> None:
    talk = Talk("weiss-wts")
    assert talk.say(WtsCommand.LOOP, b"ping") == [WeissPacket(0x06, b"\0\0ping")]
    assert talk.say(WtsCommand.MATRIX_INFO) == [
        WeissPacket(0x30, struct.pack("<6H", 0, 8, 4, 340, 380, 4095))
    ]
    assert talk.say(WtsCommand.TEMPERATURE) == [WeissPacket(0x46, struct.pack("<Hh", 0, 231))]
    for command, payload, wanted in (
        (0x77, b"", WtsStatus.CMD_UNKNOWN),
        (WtsCommand.SET_MASK, b"", WtsStatus.FEATURE_NOT_SUPPORTED),
        (WtsCommand.START, b"\0", WtsStatus.NOT_ENOUGH_PARAMS),
        (WtsCommand.START, b"\0\0\0\0", WtsStatus.CMD_FORMAT_ERROR),
        (WtsCommand.STOP, b"\0", WtsStatus.NO_PARAM_EXPECTED),
        (WtsCommand.SET_THRESHOLD, b"\xff\xff", WtsStatus.RANGE_ERROR),
        (WtsCommand.SET_TAG, b"x" * 65, WtsStatus.RANGE_ERROR),
    ):
        assert status(talk.say(command, payload), WtsStatus) is wanted
    damaged = bytearray(encode(WeissDialect.WTS, WeissPacket(WtsCommand.LOOP)))
    damaged[-1] ^= 1
    assert talk.bench.device.feed(bytes(damaged), talk.now) == []


def test_what_a_wts_is_told_it_remembers() -> None:
    talk = Talk("weiss-wts")
    talk.say(WtsCommand.SET_TAG, b"thumb")
    talk.say(WtsCommand.SET_GAIN, b"\x40")
    talk.say(WtsCommand.SET_THRESHOLD, b"\x10\x00")
    assert talk.say(WtsCommand.GET_TAG)[0].payload == b"\0\0thumb"
    assert talk.say(WtsCommand.GET_GAIN)[0].payload == b"\0\0\x40"
    assert talk.say(WtsCommand.GET_THRESHOLD)[0].payload == b"\0\0\x10\x00"


@pytest.mark.parametrize("compressed", [False, True])
def test_single_frames_of_a_wts(compressed: bool) -> None:
    talk = Talk("weiss-wts")
    (answer,) = talk.say(WtsCommand.READ_FRAME, bytes((compressed,)))
    frame = parse_frame(answer.payload[2:], 32)
    assert (frame.texels == 20).all()
    assert len(answer.payload) == 2 + 5 + (2 * 3 if compressed else 2 * 32)
    assert frame.timestamp == 60_000 + 4, "ms since power came on, at the end of the scan"
    talk.say(WtsCommand.START, struct.pack("<BH", compressed, 10))
    packets = talk.say(WtsCommand.READ_FRAME, b"\0")
    assert WeissPacket(WtsCommand.READ_FRAME, struct.pack("<H", WtsStatus.ALREADY_RUNNING)) in packets
    assert status(talk.say(WtsCommand.START, b"\0\0\0", 0.0), WtsStatus) is WtsStatus.ALREADY_RUNNING
    flags = {packet.payload[4] for packet in talk.wait(0.1)}
    assert flags == {int(compressed)}


def test_tare_and_threshold_of_a_wts() -> None:
    talk = Talk("weiss-wts")
    assert status(talk.say(WtsCommand.TARE, b"\x01"), WtsStatus) is WtsStatus.SUCCESS
    talk.bench.world.force_n[0, :3] = 0.005, 0.02, 0.05
    talk.say(WtsCommand.SET_THRESHOLD, b"\x0a\x00")
    texels = parse_frame(talk.say(WtsCommand.READ_FRAME, b"\0")[0].payload[2:], 32).texels
    assert texels[:4].tolist() == [0, 20, 50, 0]
    talk.say(WtsCommand.TARE, b"\x00")
    texels = parse_frame(talk.say(WtsCommand.READ_FRAME, b"\0")[0].payload[2:], 32).texels
    assert texels[:4].tolist() == [25, 40, 70, 20]


def test_a_dsa_boots_noisily_and_hears_nothing_meanwhile() -> None:
    talk = Talk("weiss-dsa", powered_s=0.0)
    device = talk.bench.device
    assert device.feed(encode(WeissDialect.DSA, WeissPacket(DsaCommand.CONTROLLER_INFO)), 7.9) == [
        (7.0, BOOT_NOISE),
        (7.41, BOOT_NOISE),
        (7.82, BOOT_NOISE),
    ]
    assert device.poll(9.0) == []
    assert len(device.feed(encode(WeissDialect.DSA, WeissPacket(DsaCommand.CONTROLLER_INFO)), 9.0)) == 1


def test_a_dsa_describes_itself_and_names_what_it_does_not_know() -> None:
    talk = Talk("weiss-dsa")
    assert len(talk.say(DsaCommand.CONTROLLER_INFO)[0].payload) == 18
    assert struct.unpack_from("<HH", talk.say(DsaCommand.SENSOR_INFO)[0].payload) == (0, 2)
    for number, matrix in enumerate((MATRIX, OTHER)):
        (packet,) = talk.say(DsaCommand.MATRIX_INFO, bytes((number,)))
        assert len(packet.payload) == 52
        assert struct.unpack_from("<HffHH", packet.payload)[3:] == (matrix.cells_x, matrix.cells_y)
    assert talk.say(DsaCommand.STATE)[0].payload == b"\0\0\x80"
    for command, payload, wanted in (
        (0x77, b"", DsaStatus.CMD_UNKNOWN),
        (DsaCommand.MATRIX_INFO, b"", DsaStatus.NOT_ENOUGH_PARAMS),
        (DsaCommand.MATRIX_INFO, b"\x02", DsaStatus.INDEX_OUT_OF_BOUNDS),
        (DsaCommand.SET_THRESHOLD, b"\0\x05\0\0", DsaStatus.INVALID_PARAMETER),
        (DsaCommand.SET_THRESHOLD, b"\0\0\xff\xff", DsaStatus.INVALID_PARAMETER),
    ):
        assert status(talk.say(command, payload), DsaStatus) is wanted


def test_thresholds_of_a_dsa() -> None:
    talk = Talk("weiss-dsa")
    assert talk.say(DsaCommand.SET_THRESHOLD, b"\x80\x00\x1e\x00") == [], "kept ones are not answered"
    assert talk.say(DsaCommand.GET_THRESHOLD, b"\0")[0].payload == b"\0\0\x1e\x00"
    assert talk.say(DsaCommand.GET_THRESHOLD, b"\1")[0].payload == b"\0\0\x00\x00"
    talk.bench.world.force_n[2, 2] = 0.02
    _, packet = talk.say(DsaCommand.ACQUIRE, b"\x81\0\0", 0.1)
    texels = parse_frame(packet.payload, 32 + 84).texels
    assert np.flatnonzero(texels).tolist() == [2 * 8 + 2]
    old = Talk("weiss-dsa", release=267)
    assert status(old.say(DsaCommand.GET_THRESHOLD, b"\0"), DsaStatus) is DsaStatus.CMD_UNKNOWN


@pytest.mark.parametrize(("release", "frames"), [(290, 1), (288, 6), (269, 1), (268, 6)])
def test_a_single_frame_of_a_dsa_is_a_stream_in_old_firmware(release: int, frames: int) -> None:
    talk = Talk("weiss-dsa", release=release)
    answer, *got = talk.say(DsaCommand.ACQUIRE, b"\x80\0\0", 0.21)
    assert answer == WeissPacket(DsaCommand.ACQUIRE, b"\0\0")
    assert len(got) == frames
    assert [packet.command for packet in got] == [0] * frames
    talk.say(DsaCommand.ACQUIRE, b"\0\0\0")
    assert talk.wait(1.0) == []
