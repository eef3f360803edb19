"""What is in the packets: frames and run lengths, what the devices say of themselves, numbers and times."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from palpate.drivers.tactile.description import Corner, Mounting, Shape
from palpate.drivers.tactile.frames import FrameTime, FrameTimes
from palpate_weiss.messages import (
    ControllerInfo,
    MatrixInfo,
    SystemInfo,
    compress,
    expand,
    frame_payload,
    frame_size,
    parse_frame,
    status_of,
)

texel_rows = hnp.arrays(
    np.uint16, st.integers(0, 120), elements=st.sampled_from([0, 1, 7, 255, 4095]), fill=st.just(0)
)


@given(texel_rows)
def test_run_lengths_there_and_back(texels: np.ndarray) -> None:
    units = compress(texels)
    assert len(units) <= len(texels)
    np.testing.assert_array_equal(expand(units), texels)
    if len(units):
        assert (units >> 12).min() >= 1


def test_run_lengths_by_hand() -> None:
    texels = np.array([0] * 33 + [4095, 4095, 2], np.uint16)
    assert compress(texels).tolist() == [0xF000, 0xF000, 0x3000, 0x2FFF, 0x1002]
    assert expand(np.array([0x0123, 0x2FFF], np.uint16)).tolist() == [4095, 4095], "a unit of none"
    with pytest.raises(ValueError, match="more than 12 bits"):
        compress(np.array([4096], np.uint16))


@given(texel_rows, st.integers(0, 2**32 - 1), st.booleans())
def test_frames_there_and_back(texels: np.ndarray, stamp: int, compressed: bool) -> None:
    payload = frame_payload(stamp, texels, compressed=compressed)
    assert len(payload) <= frame_size(len(texels))
    frame = parse_frame(payload, len(texels))
    assert frame.timestamp == stamp
    np.testing.assert_array_equal(frame.texels, texels)
    with pytest.raises(ValueError, match="instead of"):
        parse_frame(payload, len(texels) + 1)


@given(st.binary(max_size=60), st.integers(0, 40))
def test_any_payload_is_a_frame_or_refused(payload: bytes, cells: int) -> None:
    with contextlib.suppress(ValueError):
        assert parse_frame(payload, cells).texels.shape == (cells,)


def test_layouts_of_the_sources() -> None:
    # ksatyaki/wts_driver: columns, rows, cell width and height in 1/100 mm, full scale
    wts = struct.pack("<5H", 4, 8, 340, 380, 4095)
    assert MatrixInfo.parse_wts(wts) == MatrixInfo(4, 8, 3.4, 3.8, 4095)
    assert MatrixInfo(4, 8, 3.4, 3.8, 4095).pack_wts() == wts
    system = SystemInfo.parse(struct.pack("<BBHI", 1, 2, 0x2140, 77) + b"more")
    assert (system.serial, system.hardware, system.version) == (77, 2, "2.1.4.0")
    # SDHLibrary's sMatrixInfo and sControllerInfo, packed, behind error_code
    dsa = struct.pack(
        "<ffHH6s2sB6ffB", 3.5, 4.5, 6, 14, b"uiduid", b"..", 16, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 4095.0, 0
    )
    assert len(dsa) == 52 - 2
    assert MatrixInfo.parse_dsa(dsa) == MatrixInfo(6, 14, 3.5, 4.5, 4095.0, b"uiduid")
    assert len(MatrixInfo(6, 14, 3.5, 4.5, 4095.0).pack_dsa()) == 52 - 2
    assert MatrixInfo.parse_dsa(MatrixInfo(6, 14, 3.5, 4.5, 4095.0, b"uidui\0").pack_dsa()).uid == b"uidui\0"
    controller = ControllerInfo(4711, 0x20, 268)
    assert len(controller.pack()) == 18 - 2, "SDHLibrary: 19 are documented, 18 come"
    assert ControllerInfo.parse(controller.pack()) == controller
    assert status_of(b"\x05\x00data") == 5
    assert status_of(b"\x05") is None


@pytest.mark.parametrize(
    "parse", [MatrixInfo.parse_wts, MatrixInfo.parse_dsa, SystemInfo.parse, ControllerInfo.parse]
)
def test_short_answers_are_refused(parse) -> None:
    with pytest.raises(ValueError, match="are needed"):
        parse(b"\0" * 5)


def test_times_unwrap_and_number_frames() -> None:
    times = FrameTimes(1e-3)
    stamps = [2**32 - 30 + 10 * k for k in range(10)]
    placed = [times.place(stamp % 2**32) for stamp in stamps]
    assert [p.sequence for p in placed if p] == list(range(10))
    np.testing.assert_allclose(np.diff([p.time_s for p in placed if p]), 0.01, atol=1e-6)
    assert times.lost == 0


def test_long_steps_are_frames_that_are_missing() -> None:
    times = FrameTimes(1e-3)
    for stamp in (0, 33, 67, 100, 133, 167):
        times.place(stamp)
    assert times.place(167 + 100) == FrameTime(8, pytest.approx(0.267))
    assert times.lost == 2
    times.restart()
    assert times.place(100_000) == FrameTime(9, pytest.approx(100.0)), "a pause between streams is no loss"
    assert times.lost == 2


def test_a_slower_stream_is_no_loss() -> None:
    times = FrameTimes(1e-3)
    stamps = [10 * k for k in range(10)]
    for stamp in stamps:
        times.place(stamp)
    times.restart()
    for k in range(10):
        times.place(1000 + 100 * k)
    assert times.lost == 0


def test_repeated_and_impossible_stamps_are_refused_and_forgotten() -> None:
    times = FrameTimes(1e-3)
    assert times.place(500) is not None
    assert times.place(500) is None
    assert times.place(510) is not None
    assert times.place(4_000_000_000) is None, "damaged"
    assert times.place(530) is None, "from there it is a jump, too"
    placed = times.place(540)
    assert placed is not None
    assert placed.sequence == 2
    assert times.lost == 0


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("first", Corner)
def test_mountings_there_and_back(first: Corner, upright: bool) -> None:
    mounting = Mounting(Shape.CYLINDER, 8.0, 100.0, first=first, upright=upright)
    cells = np.arange(6, dtype=np.uint16).reshape(2, 3)
    on_tip = mounting.to_tip(cells)
    assert on_tip.shape == ((3, 2) if upright else (2, 3))
    corner = {
        Corner.LOWER_LEFT: (0, 0),
        Corner.LOWER_RIGHT: (0, -1),
        Corner.UPPER_LEFT: (-1, 0),
        Corner.UPPER_RIGHT: (-1, -1),
    }[first]
    assert on_tip[corner] == 0, "where the device begins to count"
    row, col = corner
    step = 1 if (row if upright else col) == 0 else -1
    beside = (row + step, col) if upright else (row, col + step)
    assert on_tip[beside] == 1, "and the way on which it goes on"
    np.testing.assert_array_equal(mounting.to_device(on_tip), cells)


def test_a_matrix_bent_round_a_tip() -> None:
    say = {"unique_id": b"x", "firmware": "f", "emulated": False, "bit_depth": 12, "max_rate_hz": 30.0}
    bent = Mounting(Shape.CYLINDER, 8.5, 100.0, upright=True).describe((4, 8), (3.0, 3.4), **say)
    assert (bent.rows, bent.cols) == (4, 8)
    np.testing.assert_allclose(bent.columns, 0.4 * (np.arange(8) - 3.5))
    np.testing.assert_allclose(bent.row_heights_mm, [1.5, 4.5, 7.5, 10.5])
    assert bent.full_scale_n == 40.95
    flat = Mounting(Shape.FLAT, 8.5, 100.0).describe((3, 2), (3.0, 3.4), **say)
    assert (flat.columns, flat.tip_radius_mm) == ((-3.0, 0.0, 3.0), 0.0)
    with pytest.raises(ValueError, match=r"20 columns of 3\.40 mm do not fit round a tip of radius 8\.5 mm"):
        Mounting(Shape.CYLINDER, 8.5, 100.0).describe((20, 8), (3.4, 3.4), **say)
    with pytest.raises(ValueError, match=r"columns 0 \(allowed: 1 to 255\)"):
        Mounting(Shape.CYLINDER, 8.5, 100.0).describe((0, 8), (3.4, 3.4), **say)
