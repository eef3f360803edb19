"""Emulated servos answer the e-Manual's requests with the e-Manual's answers, whole, byte by byte.

The page's servos are XM430-W210s with firmware 38, or XC330-T288s with firmware new enough for backup and
fast reads; the emulated one takes their model number and the values that the examples' conditions name.
"""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manual_examples import EXAMPLES, EXCHANGES, MISPRINTED_CRC, Exchange

from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    Parser,
    StatusErrorCode,
    StatusPacket,
    encode_instruction,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain

# Strike a section from here once the emulated servo knows its instruction.
EXCHANGE = {exchange.section: exchange for exchange in EXCHANGES}
FOREIGN = encode_instruction(InstructionPacket(99, Instruction.PING))
FLUSH = bytes(1100)  # longer than any packet that a servo may be waiting for


def emulated(
    dxl_id: int,
    position: int = 2048,
    firmware: int = 38,
    model: int = 1030,
    volts: float = 12.0,
    celsius: float = 25.0,
    present_pwm: int = 0,
) -> EmulatedServo:
    """A servo standing still at a Present Position (ticks), with what it measures."""
    servo = EmulatedServo(dxl_id, firmware=firmware, start_rad=(position - 2048) / 4096 * 2 * math.pi)
    servo._unit.table.set("Model Number", model)
    servo.set_supply(volts)
    servo.set_temperature(celsius)
    servo.answer_block(132, 4)  # brings the items that report the shaft up to date, once and for all
    servo._unit.drive.refresh = lambda: None
    servo._unit.table.set("Present PWM", present_pwm)
    return servo


def chain_for(section: str) -> ServoChain:
    """Servos as the conditions of the page's example in that section say."""
    if section.startswith("Fast"):
        modern = {"firmware": 46, "model": 1220}
        servos = [
            emulated(3, 166, **modern),
            emulated(7, 2079, **modern, present_pwm=421),
            emulated(4, 1023, **modern, celsius=31),
        ]
    elif section.startswith("Control Table Backup"):
        servos = [emulated(1, firmware=46, model=1220)]
    elif section in ("Ping, example 2", "Sync Read", "Sync Write", "Bulk Read", "Bulk Write"):
        servos = [
            emulated(1, 166, volts=11.9),
            emulated(2, 2079, celsius=36),
        ]
    else:
        servos = [emulated(1, 166)]
    return ServoChain(servos, lambda _: None)


def said(chain: ServoChain, data: bytes, now: float = 1.0) -> bytes:
    return b"".join(piece for _, piece in chain.feed(data, now))


def asked_before(section: str, chain: ServoChain) -> None:
    """What an example's condition says to have been sent before."""
    if section == "Action":
        said(chain, EXCHANGE["Reg Write"].instruction.wire)
    elif section == "Control Table Backup, example 2":
        said(chain, EXCHANGE["Control Table Backup, example 1"].instruction.wire)


def request(exchange: Exchange) -> bytes:
    """The instruction as printed, with the right CRC where the page has a misprint."""
    right = MISPRINTED_CRC.get(exchange.instruction.printed)
    wire = exchange.instruction.wire
    return wire if right is None else wire[:-2] + bytes.fromhex(right)


@pytest.mark.parametrize("exchange", EXCHANGES, ids=lambda e: e.section)
def test_answer_byte_by_byte(exchange: Exchange) -> None:
    chain = chain_for(exchange.section)
    asked_before(exchange.section, chain)
    assert said(chain, request(exchange)) == exchange.answer_wire


@pytest.mark.parametrize("exchange", EXCHANGES, ids=lambda e: e.section)
@given(before=st.binary(max_size=20), after=st.binary(max_size=20), cuts=st.lists(st.integers(0, 60)))
@settings(max_examples=15)
def test_answer_among_garbage_and_in_pieces(
    exchange: Exchange, before: bytes, after: bytes, cuts: list[int]
) -> None:
    chain = chain_for(exchange.section)
    asked_before(exchange.section, chain)
    stream = before + FOREIGN + request(exchange) + after + FLUSH
    edges = [0, *sorted(cuts), len(stream)]
    heard = b"".join(said(chain, stream[a:b]) for a, b in pairwise(edges))
    assert heard == exchange.answer_wire


@pytest.mark.parametrize("printed", MISPRINTED_CRC)
def test_a_misprinted_request_is_not_carried_out(printed: str) -> None:
    """A servo that is meant says so (CRC Error); one of a group, or nobody in particular, is silent."""
    (example,) = [example for example in EXAMPLES if example.printed == printed]
    answers = Parser().feed(said(chain_for(example.section), example.wire))
    meant = [] if example.wire[4] == BROADCAST_ID else [StatusPacket(1, StatusErrorCode.CRC_ERROR)]
    assert answers == meant


def item(chain: ServoChain, dxl_id: int, address: int, length: int) -> int:
    """Read an item as a host would."""
    params = address.to_bytes(2, "little") + length.to_bytes(2, "little")
    packet = InstructionPacket(dxl_id, Instruction.READ, params)
    (answer,) = Parser().feed(said(chain, encode_instruction(packet)))
    assert not isinstance(answer, InstructionPacket)
    assert answer.error == 0
    return int.from_bytes(answer.params, "little")


@pytest.mark.parametrize(
    ("sections", "kept"),
    [
        (["Write"], {(1, 116, 4): 512}),
        (["Reg Write"], {(1, 104, 4): 0, (1, 69, 1): 1}),
        (["Reg Write", "Action"], {(1, 104, 4): 200, (1, 69, 1): 0}),
        (["Sync Write"], {(1, 116, 4): 150, (2, 116, 4): 170}),
        (["Bulk Write"], {(1, 32, 2): 160, (2, 31, 1): 80}),
    ],
    ids=lambda value: " + ".join(value) if isinstance(value, list) else "",
)
def test_what_the_manual_writes_is_kept(sections: list[str], kept: dict[tuple[int, int, int], int]) -> None:
    chain = chain_for(sections[0])
    for dxl_id in {where[0] for where in kept}:  # other than what the examples write
        change = encode_instruction(InstructionPacket(dxl_id, Instruction.WRITE, b"\x1f\0\x4f\x9b\0"))
        assert said(chain, change)[8] == 0
    for section in sections:
        said(chain, EXCHANGE[section].instruction.wire)
    assert {where: item(chain, *where) for where in kept} == kept
