"""Frames of a WTS module that make no sense: five in a row are an error that says why."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.transport.wire import Emission
from palpate.testing import ArrayBench
from palpate_weiss import WTS, WtsConfig
from palpate_weiss.codec import WeissDecoder, WeissDialect, WeissPacket, encode
from palpate_weiss.emulated_arrays import EmulatedWts
from palpate_weiss.messages import FRAME, MatrixInfo

SENSELESS: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "texel": (lambda payload: payload[:4] + b"\0" + b"\0\x10" * 35, "texel 4096 (allowed: 0 to 4095)"),
    "size": (lambda payload: payload[:4] + b"\0" + bytes(68), "a frame of 34 texels instead of 35"),
    "stamp": (lambda payload: bytes(4) + payload[4:], "its stamp 0 stands still"),
}


@pytest.mark.parametrize("name", SENSELESS)
def test_senseless_frames_of_a_weiss_array_are_told(name: str) -> None:
    spoil, text = SENSELESS[name]
    spoils = False

    class Wrong(EmulatedWts):
        def poll(self, now: float) -> list[Emission]:
            ears, out = WeissDecoder(WeissDialect.WTS), []
            for at, data in super().poll(now):
                for packet in ears.feed(data):
                    assert isinstance(packet, WeissPacket)
                    wrong = spoils and packet.command == FRAME
                    payload = spoil(packet.payload) if wrong else packet.payload
                    out.append((at, encode(WeissDialect.WTS, WeissPacket(packet.command, payload))))
            return out

    def emulated(
        taxels: Taxels, advance: Callable[[float], None], _config: WtsConfig, _radius: float
    ) -> EmulatedWts:
        return Wrong(taxels, MatrixInfo(7, 5, 3.4, 3.4, 4095.0), advance, baudrate=1_000_000)

    bench = ArrayBench("weiss-wts", {"counts_per_n": 1000.0}, plugin=replace(WTS, emulated=emulated))
    bench.array.connect()
    bench.array.start(25.0)
    bench.array.wait_frame(0.2)
    spoils = True

    def look_on() -> None:
        for _ in range(20):
            bench.clock.sleep(0.04)
            bench.array.frames()

    with pytest.raises(DeviceError) as caught:
        look_on()
    assert "tactile array f1 on mock://any" in str(caught.value)
    assert "sent 5 frames in a row that make no sense" in str(caught.value)
    assert text in str(caught.value)
