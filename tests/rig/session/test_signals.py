"""Signals are held back until the host asks the outside, or has not asked for a while."""

import signal
import time
from collections.abc import Iterator

import pytest

from palpate.rig.session.signals import HeldInterrupts


class Told(Exception):
    """What the handler of these tests raises."""


def tell(number: int, frame: object) -> None:
    del frame
    raise Told(signal.Signals(number).name)


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    before = {number: signal.signal(number, tell) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_the_next_look(number: signal.Signals) -> None:
    with HeldInterrupts() as held:
        held.check()
        signal.raise_signal(number)
        signal.raise_signal(number)
        with pytest.raises(Told, match=number.name):
            held.check()
        held.check()
    assert signal.getsignal(number) is tell


def test_a_signal_that_nobody_looked_for_comes_at_the_end() -> None:
    reached: list[bool] = []

    def work() -> None:
        with HeldInterrupts():
            signal.raise_signal(signal.SIGINT)
            reached.append(True)

    with pytest.raises(Told):
        work()
    assert reached
    assert signal.getsignal(signal.SIGINT) is tell


def test_a_long_computation_is_interrupted_all_the_same() -> None:
    def compute() -> None:
        end = time.monotonic() + 30
        signal.raise_signal(signal.SIGTERM)
        while time.monotonic() < end:
            pass

    with pytest.raises(Told, match="SIGTERM"), HeldInterrupts():
        compute()


def test_a_handler_that_was_replaced_meanwhile_stays() -> None:
    with HeldInterrupts():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
