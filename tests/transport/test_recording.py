"""What a recorder writes, a replayer gives back: calls, readings to the last bit, bytes, errors."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial import SerialException
from serial.serialutil import SerialBase

from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.recording import (
    CALLS,
    ErrorRaised,
    Instants,
    RecordedEvent,
    RecordEntry,
    Recorder,
    RecordItem,
    SessionEvent,
    parse_calls,
)
from palpate.drivers.transport.replay import RecordEnded, ReplayDiffers, Replayer
from palpate.drivers.transport.wire import Emission

BAUD = 115_200


class Echo:
    """Echoes every byte 1 ms later; once unplugged it raises what an unplugged port raises."""

    def __init__(self) -> None:
        self.unplugged = False

    def feed(self, data: bytes, now: float) -> list[Emission]:
        return [(now + 1e-3, data)]

    def poll(self, now: float) -> list[Emission]:
        del now
        if self.unplugged:
            raise SerialException(5, "unplugged")
        return []

    def next_due(self) -> float | None:
        return None


class Tape:
    """A sink that keeps entries as a session log's reader would give them."""

    def __init__(self) -> None:
        self.entries: list[RecordEntry] = []
        self._calls: list[str] = []

    def note(self, what: RecordItem) -> None:
        if isinstance(what, str):
            self._calls.append(what)
        else:
            self.add(what)

    def check(self) -> None:
        """Nothing fails here."""

    def add(self, what: RecordedEvent) -> None:
        self.entries.append(RecordEntry(len(self.entries) + 1, 0.0, "".join(self._calls), what))
        self._calls.clear()


class Outside:
    """A clock and one port, recorded or replayed."""

    def __init__(self, clock: Any, opened: Callable[[], SerialBase]) -> None:
        self.clock = clock
        self.open = opened


def recorded(host: Callable[[Outside], object], echo: Echo | None = None) -> tuple[Tape, object]:
    """Let `host` use an echo; returns the tape and what the host gave back, or raised."""
    clock, tape = VirtualClock(), Tape()
    hub = MockHub(clock, "recording")
    url = hub.attach("echo", echo or Echo(), BAUD)
    recorder = Recorder(clock, tape)
    answer = outcome(
        host, Outside(recorder.clock, lambda: recorder.open("echo", lambda: open_port(url, BAUD)))
    )
    tape.add(SessionEvent("end", {}))
    return tape, answer


def outcome(host: Callable[[Outside], object], outside: Outside) -> object:
    try:
        return host(outside)
    except (SerialException, KeyboardInterrupt) as error:
        return type(error), str(error)


def replayer_of(tape: Tape) -> tuple[Replayer, Outside]:
    replayer = Replayer(tape.entries, lambda _, data: f"{len(data)} bytes")
    return replayer, Outside(replayer.clock, lambda: replayer.open("echo", BAUD))


def replayed(host: Callable[[Outside], object], tape: Tape) -> object:
    replayer, outside = replayer_of(tape)
    answer = outcome(host, outside)
    assert replayer.ends() == {}
    return answer


def uses_everything(outside: Outside) -> object:
    """Every verb of a port and of the clock once; what they answer."""
    with outside.open() as port:
        seen: list[object] = [port.port, port.baudrate, port.write(b"abc"), port.in_waiting]
        port.timeout = 0.01
        seen += [outside.clock.now(), port.read(2), outside.clock.now(), port.in_waiting, port.out_waiting]
        port.write(b"defg")
        outside.clock.sleep(0.1)
        port.reset_input_buffer()
        port.reset_output_buffer()
        port.rts = True
        port.flush()
        seen += [port.read(5), outside.clock.now(), outside.clock.now()]
        port.close()
        port.open()
    return seen


def test_every_call_is_given_back() -> None:
    tape, answer = recorded(uses_everything)
    assert replayed(uses_everything, tape) == answer
    texts = "".join(entry.calls for entry in tape.entries)
    assert {call.letter for call in parse_calls(texts)} == set("t.zwrqsfdomcp")


def test_an_error_of_the_port_is_raised_again_in_the_same_call() -> None:
    def host_with(echo: Echo | None) -> Callable[[Outside], object]:
        def host(outside: Outside) -> object:
            port = outside.open()
            port.write(b"abc")
            if echo is not None:
                echo.unplugged = True
            try:
                return port.in_waiting
            except SerialException as error:
                return str(error), port.port

        return host

    echo = Echo()
    tape, answer = recorded(host_with(echo), echo)
    assert answer == ("[Errno 5] unplugged", "mock://recording/echo")
    assert replayed(host_with(None), tape) == answer


def test_an_interrupt_between_two_calls_is_raised_before_the_next_one() -> None:
    class Host:
        def __init__(self, *, interrupted: bool) -> None:
            self.interrupted = interrupted

        def __call__(self, outside: Outside) -> object:
            port = outside.open()
            try:
                port.write(b"go")
                if self.interrupted:
                    raise KeyboardInterrupt("Ctrl-C")
                port.write(b"on")
            finally:
                port.write(b"stop")
            return None

    tape, answer = recorded(Host(interrupted=True))
    assert answer == (KeyboardInterrupt, "Ctrl-C")
    assert [entry.what.during for entry in tape.entries if isinstance(entry.what, ErrorRaised)] == [None]
    assert replayed(Host(interrupted=False), tape) == answer


def sends(*packets: bytes) -> Callable[[Outside], object]:
    def host(outside: Outside) -> object:
        with outside.open() as port:
            return [port.write(packet) for packet in packets]

    return host


@pytest.mark.parametrize(
    ("host", "said"),
    [
        (
            sends(b"abc", b"dXf"),
            "port echo: byte 1 of what is sent differs: sent 64 58 66 (3 bytes), recorded",
        ),
        (sends(b"abc", b"de"), "port echo: byte 2 of what is sent differs: sent 64 65 (2 bytes), recorded"),
        (sends(b"abc"), "the host ends; in the recording it sends 64 65 66 (3 bytes) to port echo"),
        (sends(b"abc", b"def", b"g"), "the host sends 67 (1 bytes) to port echo; in the recording it closes"),
    ],
)
def test_the_first_difference_is_named_and_then_nothing_goes_on(
    host: Callable[[Outside], object], said: str
) -> None:
    tape, _ = recorded(sends(b"abc", b"def"))
    replayer, outside = replayer_of(tape)

    def whole() -> None:
        host(outside)
        replayer.ends()

    with pytest.raises(ReplayDiffers) as differs:
        whole()
    assert said in str(differs.value)
    with pytest.raises(ReplayDiffers) as again:
        outside.clock.now()
    assert again.value is differs.value is replayer.failure


def test_a_host_that_asks_the_clock_once_more_is_noticed() -> None:
    tape, _ = recorded(lambda outside: outside.clock.now())
    _, outside = replayer_of(tape)
    outside.clock.now()
    with pytest.raises(ReplayDiffers, match='reads the clock; in the recording it comes to "end"'):
        outside.clock.now()


def test_a_recording_without_an_end_says_that_it_goes_no_further() -> None:
    tape, _ = recorded(sends(b"abc", b"def"))
    del tape.entries[2:]
    replayer, outside = replayer_of(tape)
    with pytest.raises(RecordEnded, match="ends after line 2; the host goes on"):
        sends(b"abc", b"def")(outside)
    assert replayer.sent_bytes == 3


@given(
    st.lists(
        st.floats(0.0, 1e7)
        | st.integers(0, 10**14).map(lambda ns: ns / 1e9)
        | st.integers(0, 10**6).map(lambda k: math.fsum([0.1] * 3) * k)
    )
)
def test_clock_readings_come_back_to_the_last_bit(instants: list[float]) -> None:
    there, back = Instants(), Instants()
    text = "".join(there.text(instant) for instant in instants)
    assert CALLS.fullmatch(text)
    found = [back.instant(call) for call in parse_calls(text)]
    assert [value.hex() for value in found] == [(value + 0.0).hex() for value in instants]


@given(st.from_regex(CALLS, fullmatch=True))
def test_any_row_of_calls_can_be_taken_apart(text: str) -> None:
    instants = Instants()
    for call in parse_calls(text):
        if call.letter in "t.":
            try:
                instants.instant(call)
            except (ValueError, OverflowError):
                instants = Instants()
    assert "".join(call.letter for call in parse_calls(text)) == "".join(
        c for c in text if c in "t.z" or c.isalpha()
    )
