"""Reading from several servos at once so that one silent servo hides nobody. Between `bus` and `exchange`.

In a sync or bulk read servos answer one after another. Where one is missing, those behind it may wait for
it for ever (the e-Manual leaves it open), so they are asked again without it: nobody counts as silent who
was only hidden.
"""

from collections.abc import Mapping

from palpate.drivers.dynamixel.counts import BusCounts
from palpate.drivers.dynamixel.exchange import Block, Exchange, Lost
from palpate.drivers.dynamixel.packet import StatusPacket

__all__ = ["read_group"]

_Answers = dict[int, StatusPacket | Lost]


def read_group(
    exchange: Exchange,
    blocks: Mapping[int, Block],
    silent: set[int],
    retries: int,
    counts: BusCounts,
    *,
    fast: bool,
) -> _Answers:
    """Read a block of each servo; an answer or what was lost for each.

    `silent`: those that did not answer at all the last time; they are asked once, and last. It is brought
    up to date. All others are asked up to `retries` times more. `fast`: with one fast read first; what is
    missing in it is read plainly.
    """
    found: _Answers = _read_fast(exchange, blocks, silent) if fast else {}
    left = {dxl_id: block for dxl_id, block in blocks.items() if dxl_id not in found}
    counts.retries += bool(fast and left.keys() - silent)
    found.update(_read_plain(exchange, left, silent, retries, counts))
    gone = {dxl_id for dxl_id, answer in found.items() if answer is Lost.SILENT}
    silent -= found.keys() - gone
    silent |= gone
    return found


def _read_fast(exchange: Exchange, blocks: Mapping[int, Block], silent: set[int]) -> _Answers:
    some = {dxl_id: block for dxl_id, block in blocks.items() if dxl_id not in silent}
    answers = exchange.ask_group_fast(some) if some else {}
    return {dxl_id: answer for dxl_id, answer in answers.items() if isinstance(answer, StatusPacket)}


def _read_plain(
    exchange: Exchange, blocks: Mapping[int, Block], silent: set[int], retries: int, counts: BusCounts
) -> _Answers:
    found: _Answers = {}
    tries = dict.fromkeys(blocks, 0)
    waiting = sorted(blocks, key=silent.__contains__)
    while waiting:
        answers = exchange.ask_group({dxl_id: blocks[dxl_id] for dxl_id in waiting})
        hiding = next((dxl_id for dxl_id in waiting if answers[dxl_id] is Lost.SILENT), None)
        for dxl_id, answer in answers.items():
            if answer is Lost.SILENT and dxl_id != hiding:
                continue  # perhaps only hidden
            found[dxl_id] = answer
            tries[dxl_id] += 1
            if isinstance(answer, Lost):
                counts.lost(silent=answer is Lost.SILENT)
        left = [
            dxl_id
            for dxl_id in waiting
            if isinstance(answers[dxl_id], Lost) and tries[dxl_id] <= (0 if dxl_id in silent else retries)
        ]
        waiting = sorted(left, key=tries.__getitem__)
        counts.retries += bool(waiting)
    return found
