"""Tests of the plug-in: palpate's suite for arrays, the codec among garbage, and the array's own key."""

import numpy as np
import pytest
from line_array.codec import LONGEST, LineDecoder, encode
from pydantic import ValidationError

from palpate.testing import ArrayBench, ArrayConformance, fuzz

FRAMES = [f"f{k:08x}" + "0ff" * 35 for k in range(200)]


class TestLineArray(ArrayConformance):
    protocol = "lines"
    keys = {"counts_per_n": 1000.0, "oversampling": 4}


class TestLineArrayMountedUpsideDown(ArrayConformance):
    protocol = "lines"
    keys = {"counts_per_n": 1000.0, "first_texel": "upper-right", "first_row": "upright"}


def test_oversampling_is_one_of_four_values() -> None:
    with pytest.raises(ValidationError, match="oversampling"):
        ArrayBench("lines", {"counts_per_n": 1000.0, "oversampling": 3})


@pytest.mark.parametrize("step", [1, 7, 1000, 100_000])
def test_lines_among_garbage_all_come_out_however_the_bytes_are_cut(step: int) -> None:
    rng = np.random.default_rng(4)
    data = b"".join(rng.bytes(20).replace(b"\n", b" ") + b"\n" + encode(text) for text in FRAMES)
    decoder = LineDecoder()
    found = [text for at in range(0, len(data), step) for text in decoder.feed(data[at : at + step])]
    assert found == FRAMES
    assert decoder.faults == {"damaged line": len(FRAMES)}


def test_any_bytes_whatever_give_lines_or_faults() -> None:
    tally = fuzz(LineDecoder, b"".join(map(encode, FRAMES)), total_bytes=200_000, seed=1)
    assert tally.most_waiting <= LONGEST
    assert all(tally.undisturbed["str"] - found["str"] <= 1 for found in tally.recovered)
