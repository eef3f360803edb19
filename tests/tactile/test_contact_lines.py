"""Contact lines: what is read of them, whatever a wire does to them; and what is believed of readings."""

import json
import math
import zlib
from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.drivers.tactile import (
    MAX_LINE_BYTES,
    ContactLineDecoder,
    ContactReading,
    DecodedFrame,
    PatchFlag,
    SourceExtractor,
    TactileFrame,
    encode_line,
    source_description,
)
from support.commands.repository import ROOT

# ----------------------------------------------------------------------------------------------------
# The codec: bytes in, readings out.

PAGE = (
    b'{"finger": "left", "t_s": 12.345, "t_bound_s": 0.001, "force_n": 0.52, "force_bound_n": 0.05, '
    b'"angle_deg": -12.5, "angle_bound_deg": 6, "height_mm": 9.1, "height_bound_mm": 1.5}'
)
"""The line of docs/contact-lines.md, but for its checksum."""


def decode(*pieces: bytes, source: str | None = None, checksum: bool = False) -> list[DecodedFrame]:
    decoder = ContactLineDecoder(source, checksum=checksum)
    return [frame for piece in pieces for frame in decoder.feed(piece)]


def problem_of(**values: object) -> str:
    (frame,) = decode(json.dumps(values).encode() + b"\n")
    assert frame.problem is not None
    return frame.problem


def test_a_line_says_what_the_page_says() -> None:
    for line in (PAGE + b"\n", PAGE + b"\r\n", PAGE + b"*%08x\n" % zlib.crc32(PAGE)):
        (frame,) = decode(line, source="left")
        assert frame.problem is None
        assert frame.stamp == 12_345_000
        assert frame.counts.tolist() == [[520]]
        assert frame.contact == pytest.approx(
            (0.52, 0.05, math.radians(-12.5), math.radians(6), 9.1, 1.5, 12.345, 0.001)
        )


def test_the_line_of_the_page_has_the_right_checksum() -> None:
    lines = (ROOT / "docs" / "contact-lines.md").read_bytes().splitlines(keepends=True)
    (line,) = [line for line in lines if line.startswith(b'{"finger"')]
    assert line.startswith(PAGE)
    assert len(decode(line, source="left", checksum=True)) == 1


def test_what_a_line_leaves_out_is_not_known() -> None:
    (frame,) = decode(b'{"force_n": 0, "force_bound_n": 0.02}\n')
    assert frame.stamp is None
    assert frame.contact is not None
    assert math.isnan(frame.contact.angle_rad)
    assert math.isnan(frame.contact.height_mm)
    assert (frame.contact.angle_half_range_rad, frame.contact.height_bound_mm) == (math.pi, math.inf)


finite = st.floats(-100, 100)
bounds = st.floats(0, 100)
readings = st.builds(
    ContactReading,
    st.floats(0, 50),
    bounds,
    st.floats(-math.pi, math.pi) | st.just(math.nan),
    st.floats(0, math.pi),
    finite | st.just(math.nan),
    bounds,
    st.none(),
)


@given(st.lists(readings, max_size=5), st.lists(st.integers(0, 200), max_size=30), st.booleans())
def test_readings_come_back_however_bytes_are_cut(
    sent: list[ContactReading], cuts: list[int], checksum: bool
) -> None:
    stream = b"".join(encode_line(reading, "f", checksum=checksum) for reading in sent)
    decoder, found, rest = ContactLineDecoder("f", checksum=checksum), [], stream
    for cut in [*cuts, len(stream)]:
        found += decoder.feed(rest[:cut])
        rest = rest[cut:]
    assert not decoder.faults
    for reading, frame in zip(sent, found, strict=True):
        assert frame.contact is not None
        assert frame.contact[:2] == pytest.approx(reading[:2], abs=1e-6)
        known = not math.isnan(reading.angle_rad)
        assert math.isnan(frame.contact.angle_rad) is not known
        if known:
            assert frame.contact[2:4] == pytest.approx(reading[2:4], abs=1e-6)
        assert math.isnan(frame.contact.height_mm) is math.isnan(reading.height_mm)


@given(st.binary(max_size=2000), st.lists(st.integers(0, 500), max_size=20))
def test_any_bytes_give_readings_or_faults_and_little_is_kept(data: bytes, cuts: list[int]) -> None:
    whole, cut_up = (ContactLineDecoder(None, checksum=False) for _ in range(2))
    expected, found, rest = whole.feed(data), [], data
    for cut in [*cuts, len(data)]:
        found += cut_up.feed(rest[:cut])
        assert cut_up.waiting <= MAX_LINE_BYTES
        rest = rest[cut:]
    assert found == expected
    assert cut_up.faults == whole.faults


@given(st.binary(max_size=3000).filter(lambda data: b"\n" not in data))
def test_no_garbage_before_a_line_loses_it(garbage: bytes) -> None:
    frames = decode(garbage + PAGE + b"\n", source="left", checksum=False)
    assert [frame.stamp for frame in frames] == [12_345_000]


@given(st.integers(0, len(PAGE) - 1), st.integers(1, 255))
def test_with_a_checksum_no_damaged_byte_is_believed(at: int, change: int) -> None:
    damaged = bytearray(PAGE + b"*%08x\n" % zlib.crc32(PAGE))
    damaged[at] ^= change
    assert decode(bytes(damaged), source="left", checksum=True) == []
    assert decode(PAGE + b"\n", source="left", checksum=True) == []


def test_a_line_that_never_ends_is_bounded_and_the_next_one_is_read() -> None:
    decoder = ContactLineDecoder("left", checksum=False)
    for _ in range(1000):
        assert decoder.feed(b"[" * 1000) == []
        assert decoder.waiting <= MAX_LINE_BYTES
    assert decoder.feed(b"\n") == []
    assert decoder.faults.total() == 1
    assert len(decoder.feed(PAGE + b"\n")) == 1
    assert decode(b'{"force_n":' + b"[" * 490 + b"}\n") == []


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -0.1, 1e300, "0.1", True, None, []])
@pytest.mark.parametrize("key", ["force_bound_n", "angle_bound_deg", "height_bound_mm", "t_bound_s"])
def test_bounds_that_are_none_are_named(key: str, bad: object) -> None:
    values: dict[str, object] = json.loads(PAGE)
    del values["finger"]
    assert key in problem_of(**values | {key: bad})


def test_values_without_sense_are_named() -> None:
    good = {"force_n": 0.5, "force_bound_n": 0.05}
    assert "force_n" in problem_of(t_s=1, t_bound_s=0)
    assert "force_n" in problem_of(force_n=-0.2, force_bound_n=0.05)
    assert "angle_bound_deg" in problem_of(**good, angle_deg=3)
    assert "array.source" in problem_of(**good, finger="left")
    (nameless,) = decode(json.dumps(good).encode() + b"\n", source="left")
    assert nameless.problem is not None
    (other,) = decode(json.dumps(good | {"finger": "right"}).encode() + b"\n", source="left")
    assert other.is_other


def test_time_that_does_not_go_on_is_a_problem_until_it_does() -> None:
    def at(time_s: float | None) -> bytes:
        return encode_line(ContactReading(0.0, 0.1, time_s=time_s))

    frames = decode(*map(at, (5.0, 5.1, 5.1, 2.0, 2.1, None, 5.2)))
    assert [frame.problem is None for frame in frames] == [True, True, False, False, False, False, True]
    restarted = decode(at(5.0), *(at(k / 100) for k in range(40)))
    assert restarted[1].problem is not None
    assert restarted[-1].problem is None


# ----------------------------------------------------------------------------------------------------
# The extractor: what is believed of readings.

DESCRIPTION = source_description("test", 50.0, emulated=True)
_NUMBER = count()


def extractor(angle_bound_rad: float = 0.0, force_bound_n: float = 0.0) -> SourceExtractor:
    return SourceExtractor(DESCRIPTION, angle_bound_rad, force_bound_n)


def frame_of(reading: ContactReading) -> TactileFrame:
    (decoded,) = decode(encode_line(reading))
    assert decoded.problem is None
    return TactileFrame(next(_NUMBER), 0.0, 0.0, decoded.counts, contact=reading)


errors = st.lists(st.tuples(st.floats(-1, 1), st.floats(0.001, 3.0)), min_size=1, max_size=8)


@given(st.floats(-math.pi, math.pi), errors, st.floats(0, 1.5))
def test_the_truth_is_in_what_readings_say_together(
    true_rad: float, off: list[tuple[float, float]], floor_rad: float
) -> None:
    frames = [
        frame_of(ContactReading(1.0 + 0.1 * share, 0.1, true_rad + share * half, half)) for share, half in off
    ]
    patch = extractor(floor_rad).extract(frames)
    assert patch is not None
    assert abs(math.remainder(patch.angle_rad - true_rad, 2 * math.pi)) <= patch.angle_half_range_rad + 1e-9
    assert patch.angle_half_range_rad >= min(floor_rad, math.pi) - 1e-9
    assert abs(patch.force_n - 1.0) <= patch.force_bound_n + 1e-9
    assert patch.flags == {PatchFlag.EDGES_UNKNOWN}


def test_a_normal_that_no_reading_knows_is_any() -> None:
    patch = extractor().extract([frame_of(ContactReading(1.0, 0.1))])
    assert patch is not None
    assert patch.angle_half_range_rad == math.pi
    assert math.isnan(patch.height_mm)


def test_a_force_within_its_bound_is_no_contact() -> None:
    light = frame_of(ContactReading(0.09, 0.1, 0.0, 0.1))
    assert extractor().extract([light]) is None
    assert extractor().force_n(light) == 0.0
    firm = frame_of(ContactReading(0.3, 0.1, 0.0, 0.1))
    assert extractor().force_n(firm) == 0.3
    assert extractor(force_bound_n=0.4).force_n(firm) == 0.0
    assert extractor(force_bound_n=0.4).extract([firm]) is None


def test_what_is_reported_at_rest_must_leave_room_for_contacts() -> None:
    def problem(force_n: float, bound_n: float, contact_n: float, floor_n: float = 0.0) -> str | None:
        found = extractor(force_bound_n=floor_n)
        found.tare([frame_of(ContactReading(force_n, bound_n))] * 8)
        return found.threshold_problem(contact_n)

    assert problem(0.0, 0.1, 0.3) is None
    assert problem(0.09, 0.1, 0.3) is None
    assert problem(0.8, 0.1, 0.3) is not None
    assert problem(0.0, 0.1, 0.09) is not None
    assert problem(0.0, 0.1, 0.3, floor_n=0.4) is not None
