"""A control loop's time on the bus: what the formulas for the wire say, and little more. In virtual time."""

import pytest
from answer_tape import PlayingClock, PlayingPort, TapingClock, TapingPort
from bus_loop import CASES, BusLoop, LoopCase, SdkLoop

from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port

CYCLES = 20


def wired(case: LoopCase) -> tuple[MockHub, VirtualClock, str]:
    clock = VirtualClock()
    hub = MockHub(clock, "loop")
    return hub, clock, hub.attach("bus", case.chain(), case.baudrate)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_reading_and_writing_all_takes_what_the_wire_takes(case: LoopCase) -> None:
    _hub, clock, url = wired(case)
    loop = BusLoop(case, open_port(url, case.baudrate), clock)
    assert loop.reader.is_fast == (case.firmware >= 45)
    begin = clock.now()
    for number in range(CYCLES):
        loop.cycle(number)
    spent = (clock.now() - begin) / CYCLES
    assert loop.wire_s <= spent + 1e-9
    assert spent <= 1.3 * loop.wire_s
    assert loop.bus.counts.retries == loop.bus.counts.silent == loop.bus.counts.damaged == 0


@pytest.mark.parametrize("case", CASES[3::4], ids=str)
def test_a_tape_gives_both_loops_the_same_again(case: LoopCase) -> None:
    """What the benchmark takes the host's time of is all of it: same bytes, every answer used."""
    _hub, clock, url = wired(case)
    setup = BusLoop(case, open_port(url, case.baudrate), clock)
    place = setup.servos[0].model.indirect
    assert place is not None
    fast = setup.reader.is_fast
    for make in (
        lambda port, clock: BusLoop(case, port, clock),
        lambda port, clock: SdkLoop(case, place.data, fast, port, clock),
    ):
        tape: list[object] = []
        loop = make(TapingPort(open_port(url, case.baudrate), tape), TapingClock(clock, tape))
        for number in range(CYCLES):
            loop.cycle(number)
        answers = iter(tape)
        again = make(PlayingPort(url, answers), PlayingClock(answers))
        for number in range(CYCLES):
            again.cycle(number)
        assert next(answers, None) is None
        if isinstance(again, SdkLoop):
            assert again.lost == 0
