"""Fields of a magnetometer skin: as its makers read them, round trips, garbage, the dipole."""

from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.testing import ArrayBench, fuzz
from palpate_reskin.codec import MARK, FieldDecoder, encode_fields
from palpate_reskin.emulated import MagneticSkin, SkinTruth

MAGNETOMETERS = 5
KEYS = {
    "columns": 7,
    "column_step_deg": 22.918,
    "row_heights_mm": [1.7, 5.1, 8.5, 11.9, 15.3],
    "microtesla_per_n": 100.0,
    "rate_hz": 25.0,
}
FIELD = st.floats(-9000, 9000, width=32).filter(lambda value: value == 0 or abs(value) > 1e-5)
FRAMES = st.lists(
    st.lists(FIELD, min_size=3 * MAGNETOMETERS, max_size=3 * MAGNETOMETERS), min_size=1, max_size=6
)


def fields_of(values: list[float]) -> np.ndarray:
    field = np.array(values, np.float32).reshape(MAGNETOMETERS, 3)
    return np.hstack([np.full((MAGNETOMETERS, 1), 25.5, np.float32), field])


@given(FRAMES, st.lists(st.integers(1, 90), min_size=1, max_size=20))
def test_fields_come_back_however_the_bytes_are_cut(frames: list[list[float]], cuts: list[int]) -> None:
    sent = [fields_of(values) for values in frames]
    data = MARK + b"".join(map(encode_fields, sent))
    decoder, found = FieldDecoder(MAGNETOMETERS), []
    while data:
        for cut in cuts:
            found += decoder.feed(data[:cut])
            data = data[cut:]
    assert len(found) == len(sent)
    assert all(np.array_equal(a, b) for a, b in zip(found, sent, strict=True))
    assert not decoder.faults


def test_a_frame_with_lost_bytes_costs_no_other_one() -> None:
    rng = np.random.default_rng(4)
    sent = [fields_of(rng.uniform(-900, 900, 15).tolist()) for _ in range(40)]
    coded = [encode_fields(each) for each in sent]
    coded[7] = coded[7][:30] + coded[7][33:]
    coded[20] = coded[20] + b"noise"
    decoder = FieldDecoder(MAGNETOMETERS)
    found = decoder.feed(MARK + b"".join(coded))
    kept = [each for number, each in enumerate(sent) if number not in (7, 20, 21)]
    assert len(found) >= len(kept)
    assert all(any(np.array_equal(each, other) for other in found) for each in kept)
    assert decoder.faults.total() == 2


def test_garbage_gives_frames_or_counted_faults_in_bounded_memory() -> None:
    rng = np.random.default_rng(5)
    valid = b"".join(encode_fields(fields_of(rng.uniform(-900, 900, 15).tolist())) for _ in range(30))
    tally = fuzz(lambda: FieldDecoder(MAGNETOMETERS), valid, 300_000, 6)
    assert tally.most_waiting <= 16 * MAGNETOMETERS + 4
    assert tally.faults.total() > 0


@pytest.mark.parametrize("u", [0.0, 0.5, 0.9, 1.5, 3.0])
def test_a_field_changes_as_a_dipole_that_is_pushed_in(u: float) -> None:
    bench = ArrayBench("reskin", KEYS)
    cells, depth = bench.device.description, 3.0
    chip = cells.positions_mm()[2, 3] - depth * cells.normals()[2, 3] + [0, 0, u * depth]
    truth = SkinTruth(depth, gain_spread=0, noise_ut=0, drift_ut_per_s=0, creep_share=0)
    skin = MagneticSkin(cells, chip[None], truth, 1)
    force = np.zeros((5, 7))
    rest = skin.fields(0.0, force)
    force[2, 3] = 1.0
    change = np.linalg.norm((skin.fields(0.0, force) - rest)[0, 1:])
    expected = truth.microtesla_per_n * 3 * np.sqrt(u**4 + 4) / (1 + u**2) ** 3 / 6
    assert change == pytest.approx(expected, rel=0.02, abs=0.01)


READERS = {
    "reskin_sensor": "from reskin_sensor import ReSkinBase as Base; sample = lambda s: s.get_sample()[2]",
    "anyskin": "from anyskin import AnySkinBase as Base; sample = lambda s: s.get_sample()[1]",
}
READ = """
import json, sys
{reader}
sensor = Base(num_mags=5, port=sys.argv[1], baudrate=115200, temp_filtered=False)
print()
print(json.dumps([sample(sensor).tolist() for _ in range(50)]))
"""


@pytest.mark.realtime
@pytest.mark.parametrize("package", READERS)
def test_its_makers_package_reads_the_emulated_skin(package: str) -> None:
    if find_spec(package) is None:
        pytest.skip(f"{package}, its maker's reader, is not installed: pip install palpate-reskin[judges]")
    keys = KEYS | {"columns": MAGNETOMETERS, "row_heights_mm": [8.5], "rate_hz": 100.0}
    read, sent = ArrayBench("reskin", keys, baudrate_bps=115_200).read_by(
        READ.format(reader=READERS[package])
    )
    size = 16 * MAGNETOMETERS
    rows = [sent[at : at + size] for at in range(0, len(sent), size + len(MARK))]
    frames = [np.frombuffer(each, "<f4").tolist() for each in rows]
    begin = frames.index(read[0])
    assert read == frames[begin : begin + 50]
