"""Reading from several servos at once so that one silent servo hides no other.

In a sync or bulk read servos answer one after another. Where one is missing, those behind it may wait for
it for ever (the e-Manual leaves it open), so they are asked again without it: none counts as silent that
was only hidden.
"""

from collections.abc import Mapping, Sequence

from palpate.drivers.dynamixel.counts import BusCounts
from palpate.drivers.dynamixel.packet import StatusPacket
from palpate.drivers.dynamixel.pending import Block, part
from palpate.drivers.dynamixel.transceiver import Loss, Lost, Transceiver, combine_losses

__all__ = ["read_group"]

_Answers = dict[int, StatusPacket | Loss]
_UNHEARD = (Lost.SILENT, Lost.LATE)


def read_group(
    transceiver: Transceiver,
    blocks: Mapping[int, Block],
    silent: set[int],
    tries: Sequence[bool],
    counts: BusCounts,
    *,
    fast: bool,
) -> _Answers:
    """Read a block of each servo; an answer or what was lost for each.

    `silent`: those that did not answer at all the last time; they are asked once, and last. It is brought
    up to date. All others are asked as often as there are `tries`, patiently where that is True. `fast`:
    the first try is a fast read, and what is missing in it is read plainly, at least once: a servo that has
    fallen silent is noticed no later than by servos that know no fast reads.
    """
    found: _Answers = _read_fast(transceiver, blocks, silent) if fast else {}
    left = {dxl_id: block for dxl_id, block in blocks.items() if dxl_id not in found}
    counts.retries += bool(fast and left.keys() - silent)
    plain = tries[1:] if fast and len(tries) > 1 else tries
    heard = {dxl_id: blocks[dxl_id] for dxl_id in list(found)[:1]}
    found.update(_read_plain(transceiver, left, silent, plain, counts, heard))
    gone = {dxl_id for dxl_id, answer in found.items() if answer is Lost.SILENT}
    silent -= found.keys() - gone
    silent |= gone
    return found


def _read_fast(transceiver: Transceiver, blocks: Mapping[int, Block], silent: set[int]) -> _Answers:
    some = {dxl_id: block for dxl_id, block in blocks.items() if dxl_id not in silent}
    wide = transceiver.wider(some, fast=True) if some else {}
    answers = transceiver.read_group_fast(wide) if some else {}
    return {
        dxl_id: _cut(answer, wide[dxl_id], some[dxl_id])
        for dxl_id, answer in answers.items()
        if isinstance(answer, StatusPacket)
    }


def _read_plain(
    transceiver: Transceiver,
    blocks: Mapping[int, Block],
    silent: set[int],
    tries: Sequence[bool],
    counts: BusCounts,
    heard: Mapping[int, Block],
) -> _Answers:
    """`heard`: one that has answered a fast read, with its block; nothing if none has."""
    found: _Answers = {}
    tried = dict.fromkeys(blocks, 0)
    waiting = sorted(blocks, key=silent.__contains__)
    wide = transceiver.wider({**heard, **blocks}) if blocks else {}
    while waiting:
        patient = tries[max(tried[dxl_id] for dxl_id in waiting)]
        # one that has answered is asked along, and first: if it is prompt, silence is the others' own
        answered = [dxl_id for dxl_id, answer in found.items() if isinstance(answer, StatusPacket)]
        witness = [*heard, *answered][:1]
        asked = [*witness, *waiting] if patient else waiting
        answers = transceiver.read_group({dxl_id: wide[dxl_id] for dxl_id in asked}, patient=patient)
        hiding = next((dxl_id for dxl_id in waiting if answers[dxl_id] in _UNHEARD), None)
        for dxl_id in waiting:
            answer = answers[dxl_id]
            if answer in _UNHEARD and dxl_id != hiding:
                continue  # perhaps only hidden
            before = found.get(dxl_id)
            if not isinstance(answer, StatusPacket) and not isinstance(before, StatusPacket):
                answer = combine_losses(before, answer)
            found[dxl_id] = _cut(answer, wide[dxl_id], blocks[dxl_id])
            tried[dxl_id] += 1
            if not isinstance(answer, StatusPacket):
                counts.lost(silent=answer in _UNHEARD)
        left = [
            dxl_id
            for dxl_id in waiting
            if not isinstance(answers[dxl_id], StatusPacket)
            and tried[dxl_id] < (1 if dxl_id in silent else len(tries))
        ]
        waiting = sorted(left, key=tried.__getitem__)
        counts.retries += bool(waiting)
    return found


def _cut(answer: StatusPacket | Loss, wide: Block, block: Block) -> StatusPacket | Loss:
    """An answer without what was read besides the block."""
    if isinstance(answer, StatusPacket) and wide != block:
        return StatusPacket(answer.dxl_id, answer.error, part(answer.params, wide, block))
    return answer
