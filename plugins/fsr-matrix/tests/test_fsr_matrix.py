"""Frames and circuit of the resistive matrix: round trips, garbage, the sketch, bounds on force."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.plugins import Corner
from palpate.testing import ArrayBench, fuzz
from palpate_fsr_matrix import FsrTruth, ResistiveSkin
from palpate_fsr_matrix.circuit import COUNTS_PER_REFERENCE, conductances
from palpate_fsr_matrix.codec import Readings, ReadingsDecoder, encode_readings, frame_bytes

SKETCH = Path(__file__).parents[1] / "arduino" / "fsr_matrix" / "fsr_matrix.ino"
ROWS, COLS = 3, 4
KEYS = {
    "columns": 7,
    "column_step_deg": 22.918,
    "row_heights_mm": [1.7, 5.1, 8.5, 11.9, 15.3],
    "conductance_per_n": 0.9,
    "rate_hz": 25.0,
}
READINGS = st.builds(
    Readings,
    st.integers(0, 255),
    st.integers(0, 65535),
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(0, 1023), min_size=12, max_size=12).map(
        lambda cells: np.array(cells, np.uint16).reshape(ROWS, COLS)
    ),
)


def same(a: Readings, b: Readings) -> bool:
    return (a.matrix, a.number, a.time_us) == (b.matrix, b.number, b.time_us) and np.array_equal(a.adc, b.adc)


@given(
    st.lists(st.tuples(st.binary(max_size=9), READINGS), min_size=1, max_size=6),
    st.lists(st.integers(1, 60), min_size=1, max_size=20),
)
def test_readings_come_back_whatever_is_between_them(
    frames: list[tuple[bytes, Readings]], cuts: list[int]
) -> None:
    data = b"".join(junk + encode_readings(each) for junk, each in frames)
    decoder, found = ReadingsDecoder(ROWS, COLS), []
    while data:
        for cut in cuts:
            found += decoder.feed(data[:cut])
            data = data[cut:]
    found += decoder.feed(bytes(frame_bytes(ROWS, COLS)))  # what junk began to look like a frame at its end
    assert len(found) == len(frames)
    assert all(same(a, b) for a, (_, b) in zip(found, frames, strict=True))


def test_garbage_gives_frames_or_counted_faults_in_bounded_memory() -> None:
    rng = np.random.default_rng(5)
    frames = [
        Readings(0, k, 16667 * k, rng.integers(0, 1024, (ROWS, COLS)).astype(np.uint16)) for k in range(30)
    ]
    tally = fuzz(lambda: ReadingsDecoder(ROWS, COLS), b"".join(map(encode_readings, frames)), 300_000, 6)
    assert tally.most_waiting < frame_bytes(ROWS, COLS)
    assert tally.faults.total() > 0


@given(st.lists(st.floats(0, 2), min_size=12, max_size=12))
def test_conductances_are_solved_for_whatever_presses_beside(values: list[float]) -> None:
    true = np.array(values).reshape(ROWS, COLS)
    share = true / (1 + true.sum(axis=0))
    adc = np.rint(1023 * share).astype(np.uint16)
    found = conductances(adc) / COUNTS_PER_REFERENCE
    last_digit = (1 + ROWS * true.max()) * (1 + true.sum(axis=0)) / 1023
    assert (np.abs(found - true) <= last_digit + 1 / COUNTS_PER_REFERENCE).all()


def test_forces_of_emulated_cells_are_within_the_examples_bound() -> None:
    """Each cell by its gain, its soft beginning and its memory: what `gain_spread` = 0.6 has to cover."""
    cells = ArrayBench("fsr-matrix", KEYS).device.description
    rng, truth = np.random.default_rng(7), FsrTruth(noise_lsb=0.0, leak=0.0)
    skin = ResistiveSkin(cells, Corner.LOWER_LEFT, truth, 3)
    decoder, now = ReadingsDecoder(cells.rows, cells.cols), 0.0
    for _ in range(300):
        now += float(rng.uniform(0.3, 1.0))
        force = rng.uniform(0.05, 0.5) * (rng.random((cells.rows, cells.cols)) < 0.2)
        skin.frame(now, 0.5 * force)
        now += float(rng.uniform(0.02, 1.0))
        (readings,) = decoder.feed(skin.frame(now, force))
        read_n = conductances(readings.adc)[force > 0] / (COUNTS_PER_REFERENCE * 0.9)
        share = read_n / force[force > 0]
        assert (np.abs(share - 1) <= 0.6).all()


BOARD = """
#include <cstdint>
#include <cstdio>
enum { LOW, HIGH, OUTPUT, A0 = 14, A1, A2, A3, A4, A5 };
int levels[32]; uint8_t ADCSRA; uint32_t now_us;
void pinMode(int, int) {}
void digitalWrite(int pin, int level) { levels[pin] = level; }
void delayMicroseconds(int us) { now_us += us; }
uint32_t micros() { return now_us += 4; }
int analogRead(int pin) {
  int row = -1, high = 0, col = (pin - A0) % 2 * 16, matrix = (pin - A0) / 2;
  for (int k = 0; k < 8; k++) if (levels[2 + k]) { row = k; high++; }
  for (int k = 0; k < 4; k++) col += levels[10 + k] << k;
  now_us += 13;
  return high == 1 ? 100 * row + col + 50 * matrix : 1023;
}
struct { void begin(long) {} void write(uint8_t byte) { putchar(byte); } } Serial;
#include "SKETCH"
int main() { setup(); for (int k = 0; k < 5; k++) loop(); }
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++, which compiles the sketch for this computer")
def test_the_sketch_scans_every_cell_and_sends_frames(tmp_path: Path) -> None:
    source, program = tmp_path / "board.cpp", tmp_path / "board"
    source.write_text(BOARD.replace("SKETCH", str(SKETCH)))
    subprocess.run(["g++", "-Wall", "-o", program, source], check=True)
    sent = subprocess.run([program], check=True, capture_output=True).stdout
    found = ReadingsDecoder(8, 20).feed(sent)
    assert [(each.number, each.matrix) for each in found] == [(k, m) for k in range(5) for m in range(3)]
    row, col = np.indices((8, 20))
    assert all(np.array_equal(each.adc, 100 * row + col + 50 * each.matrix) for each in found)
    steps = np.diff([each.time_us for each in found if each.matrix == 1])
    assert abs(steps - 33333).max() < 10
