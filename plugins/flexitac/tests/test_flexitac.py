"""FlexiTac's frames: as its maker reads them, round trips, marks among the taxels, the suite."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.testing import ArrayBench, FreeRunningConformance, RigConformance, fuzz
from palpate_flexitac.codec import MatrixDecoder, encode_matrix

ROWS, COLS = 3, 4
KEYS = {
    "columns": 7,
    "column_step_deg": 22.918,
    "row_heights_mm": [1.7, 5.1, 8.5, 11.9, 15.3],
    "counts_per_n": 200.0,
    "rate_hz": 25.0,
    "delay_s": 0.09,  # a frame is complete with the next one's mark
}
CALM = st.lists(st.integers(0, 99), min_size=12, max_size=12)
ANY = st.lists(st.sampled_from([0xAA, 0x55, 0, 255]), min_size=12, max_size=12)


def matrix(cells: list[int]) -> np.ndarray:
    return np.array(cells, np.uint8).reshape(ROWS, COLS)


class TestFlexiTac(FreeRunningConformance):
    protocol = "flexitac"
    keys = KEYS


class TestBench(RigConformance):
    rig = Path(__file__).parents[1] / "examples" / "flexitac-bench.toml"


@given(
    st.lists(CALM, min_size=4, max_size=6),
    st.lists(ANY, max_size=6),
    st.lists(st.integers(1, 40), min_size=1),
)
def test_matrices_come_back_once_calm_ones_have_shown_where_they_begin(
    calm: list[list[int]], pressed: list[list[int]], cuts: list[int]
) -> None:
    sent = [matrix(each) for each in (*calm, *pressed)]
    data = b"\x07\x08" + b"".join(map(encode_matrix, sent)) + encode_matrix(sent[0])[:2]
    decoder, found = MatrixDecoder(ROWS, COLS), []
    while data:
        for cut in cuts:
            found += decoder.feed(data[:cut])
            data = data[cut:]
    assert len(found) == len(sent)
    assert all(np.array_equal(a, b) for a, b in zip(found, sent, strict=True))
    assert not decoder.faults


def test_a_mark_that_stays_among_the_taxels_is_not_taken_for_one() -> None:
    pressed = matrix([1, 2, 0xAA, 0x55, 5, 6, 7, 8, 9, 10, 11, 12])
    decoder = MatrixDecoder(ROWS, COLS)
    assert decoder.feed(20 * encode_matrix(pressed)) == []
    calm = matrix([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12])
    found = decoder.feed(6 * encode_matrix(calm))
    assert found
    assert all(np.array_equal(each, calm) or np.array_equal(each, pressed) for each in found)


def test_after_a_lost_byte_no_frame_is_wrong() -> None:
    rng = np.random.default_rng(3)
    sent = [rng.integers(0, 100, (ROWS, COLS)).astype(np.uint8) for _ in range(40)]
    coded = [encode_matrix(each) for each in sent]
    coded[7] = coded[7][:5] + coded[7][6:]
    decoder = MatrixDecoder(ROWS, COLS)
    found = decoder.feed(b"".join(coded))
    wanted = [each for number, each in enumerate(sent[:-1]) if number != 7]
    assert [each.tolist() for each in found] == [each.tolist() for each in wanted]
    assert decoder.faults.total() == 1


def test_garbage_gives_frames_or_counted_faults_in_bounded_memory() -> None:
    rng = np.random.default_rng(5)
    valid = b"".join(encode_matrix(rng.integers(0, 256, (ROWS, COLS))) for _ in range(30))
    tally = fuzz(lambda: MatrixDecoder(ROWS, COLS), valid, 300_000, 6)
    assert tally.most_waiting <= 4 * (2 + ROWS * COLS)
    assert tally.faults.total() > 0


READ = """
import json, sys
from flexitac import FlexiTacSensor
with FlexiTacSensor(sys.argv[1], rows=5, cols=7, baud=2000000, baseline=20.0) as sensor:
    print(json.dumps([sensor.read().raw.tolist() for _ in range(50)]))
"""


@pytest.mark.realtime
@pytest.mark.skipif(
    find_spec("flexitac") is None,
    reason="flexitac, its maker's reader, is not installed: pip install palpate-flexitac[judges]",
)
def test_its_makers_package_reads_the_emulated_matrix() -> None:
    read, sent = ArrayBench("flexitac", KEYS | {"rate_hz": 60.0}, baudrate_bps=2_000_000).read_by(READ)
    frames = np.frombuffer(sent, np.uint8).reshape(-1, 2 + 5 * 7)[:, 2:].reshape(-1, 5, 7).tolist()
    begin = frames.index(read[0])
    assert read == frames[begin : begin + 50]
