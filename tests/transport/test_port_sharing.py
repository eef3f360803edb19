"""One connection for several users: each gets all that comes, in order, and all are told when it is gone."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial.serialutil import SerialException

from palpate.drivers.emulators import SharedWire
from palpate.drivers.transport import Emission, MockHub, PortSharing, VirtualClock, open_port

BAUD = 1_000_000


class Talker:
    """A device that says `said`, piece by piece, a millisecond apart."""

    def __init__(self, said: list[bytes], begin_s: float = 0.0) -> None:
        self.queue: list[Emission] = [(begin_s + 1e-3 * (k + 1), piece) for k, piece in enumerate(said)]
        self.heard = b""

    def feed(self, data: bytes, now: float) -> list[Emission]:
        self.heard += data
        return self.poll(now)

    def poll(self, now: float) -> list[Emission]:
        due = [item for item in self.queue if item[0] <= now]
        self.queue = self.queue[len(due) :]
        return due

    def next_due(self) -> float | None:
        return self.queue[0][0] if self.queue else None


def sharing_of(device: object) -> tuple[PortSharing, VirtualClock, MockHub, str]:
    clock = VirtualClock()
    hub = MockHub(clock, "shared")
    url = hub.attach("board", device, BAUD)  # type: ignore[arg-type]
    return PortSharing(open_port), clock, hub, url


@given(
    said=st.lists(st.binary(min_size=1, max_size=9), max_size=20),
    reads=st.lists(st.tuples(st.integers(0, 2), st.integers(1, 12), st.booleans()), max_size=40),
)
def test_each_user_reads_all_that_was_said(said: list[bytes], reads: list[tuple[int, int, bool]]) -> None:
    sharing, clock, _hub, url = sharing_of(Talker(said))
    users = [sharing.open(f"{url}#{name}", BAUD) for name in ("a", "b", "c")]
    got = [b"", b"", b""]
    for user, size, waits in reads:
        users[user].timeout = 0.002 if waits else 0.0
        got[user] += users[user].read(size)
    clock.sleep(1.0)
    for number, user in enumerate(users):
        got[number] += user.read(1000)
    assert got == [b"".join(said)] * 3


def test_all_users_are_told_when_it_is_gone_and_may_open_it_again() -> None:
    opened = []

    def open_failing(url: str, baudrate: int) -> object:
        opened.append(open_port(url, baudrate))
        return opened[-1]

    _, clock, _hub, url = sharing_of(Talker([b"x"] * 50))
    sharing = PortSharing(open_failing)  # type: ignore[arg-type]
    users = [sharing.open(f"{url}#{name}", BAUD) for name in ("a", "b")]
    clock.sleep(0.01)
    opened[0].close()
    for user in users:
        with pytest.raises(SerialException):
            _ = user.in_waiting
    again = sharing.open(f"{url}#a", BAUD)
    assert len(opened) == 2
    clock.sleep(0.01)
    assert again.read(3) == b"xxx"
    for user in (*users, again):
        user.close()
        user.close()
    assert not opened[1].is_open


def test_devices_on_one_wire_speak_in_order_and_all_hear() -> None:
    talkers = [Talker([b"a", b"b"]), Talker([b"1", b"2"], 0.5e-3)]
    wire = SharedWire(talkers)
    assert wire.next_due() == pytest.approx(1e-3)
    assert [data for _, data in wire.feed(b"hello", 1.0)] == [b"a", b"1", b"b", b"2"]
    assert [talker.heard for talker in talkers] == [b"hello", b"hello"]
    assert wire.next_due() is None
