"""The program in docs/servo-bus.md runs as it stands, on emulated servos."""

import re
from pathlib import Path

import pytest

from palpate.drivers.emulators.chain import ServoChain
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.transport import clock as clocks
from palpate.drivers.transport import port as ports
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub

PAGE = Path(__file__).resolve().parents[2] / "docs" / "servo-bus.md"


def test_the_program_moves_servos_and_leaves_them_off(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from palpate.drivers import transport

    servos = [EmulatedServo(dxl_id, model="XL330-M288") for dxl_id in (1, 2, 3)]
    clock = VirtualClock()
    stepped = 0.0

    def advance(now: float) -> None:
        nonlocal stepped
        while stepped + 1e-3 <= now:
            stepped += 1e-3
            for servo in servos:
                servo.step(1e-3, 0.0)

    hub = MockHub(clock, "page")
    url = hub.attach("bus", ServoChain(servos, advance), 1_000_000)
    monkeypatch.setattr(transport, "MonotonicClock", lambda: clock)
    monkeypatch.setattr(transport, "open_port", lambda _, baudrate: ports.open_port(url, baudrate))
    assert clocks.MonotonicClock is not transport.MonotonicClock
    (program,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(program, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == "{1: 1.0, 2: 1.0, 3: 1.0}\n"
    for servo in servos:
        assert servo.shaft_rad == pytest.approx(1.0, abs=0.01)
        answer = servo.answer_block(64, 1)
        assert answer is not None
        assert answer.params == b"\0"
