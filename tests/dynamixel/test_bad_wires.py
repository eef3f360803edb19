"""A million instructions are `benchmarks/bench_bad_wires.py`'s; these are few, of every kind of wire."""

import pytest
from bus_talk import KINDS, talk
from spoiling_wire import Kind

INSTRUCTIONS = 2500


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_whatever_the_wire_does_no_value_confirmation_or_refusal_is_wrong(kind: Kind) -> None:
    tally = talk(kind, 1, INSTRUCTIONS)
    assert tally.values > INSTRUCTIONS / 2
    assert tally.wrong == tally.unconfirmed == tally.misled == 0
    assert tally.failed < tally.calls / 100, "answers up to 120 ms late are waited for"
    assert tally.old == 0, "questions that differ are not answered by old measurements"
