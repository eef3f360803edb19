"""Every driver of a tactile array does what all have to: a new one is a line here and one in `devices`."""

from collections.abc import Callable
from functools import partial

import pytest
from array_contract import BAUD, CHECKS, MOUNTING, Held, MakeDevice

from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.weiss import EmulatedDsa, EmulatedWts
from palpate.drivers.tactile.devices import PROTOCOLS, open_array
from palpate.drivers.tactile.weiss_messages import MatrixInfo
from palpate.errors import InputError

MATRIX = MatrixInfo(7, 5, 3.4, 3.4, 4095.0)

DEVICES: dict[str, MakeDevice] = {
    "palpate": EmulatedArray,
    "weiss-wts": lambda taxels, advance: EmulatedWts(taxels, MATRIX, advance, baudrate=BAUD),
    "weiss-dsa": lambda taxels, advance: EmulatedDsa(taxels, [MATRIX], advance, baudrate=BAUD),
}


def held(protocol: str) -> Held:
    return Held(DEVICES[protocol], partial(open_array, protocol))


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_every_driver_does(protocol: str, check: Callable[[Held], None]) -> None:
    check(held(protocol))


def test_a_protocol_that_nothing_speaks_and_a_mounting_that_is_missing() -> None:
    some = held("palpate")
    with pytest.raises(InputError, match='array f2: no driver speaks "braille"; allowed: palpate, weiss-wts'):
        open_array("braille", some.port, some.clock, "f2", MOUNTING)
    with pytest.raises(InputError, match="does not tell how the array is mounted; give counts_per_n"):
        open_array("weiss-wts", some.port, some.clock, "f2", None)


def test_every_protocol_is_tried_here() -> None:
    assert tuple(DEVICES) == PROTOCOLS
