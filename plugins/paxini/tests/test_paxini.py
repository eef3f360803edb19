"""Fingertips on a board: as its readers read them, messages, what the board answers, bounds, the suite."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.config import load_rig
from palpate.drivers.tactile import ContactExtractor, TactileFrame
from palpate.plugins import DeviceError
from palpate.rig.arrays import calibration_of
from palpate.rig.emulated.devices import description_of
from palpate.testing import ArrayBench, FreeRunningConformance, RigConformance, fuzz
from palpate_paxini import TaxelTruth, ThreeAxisSkin
from palpate_paxini.codec import (
    MODULES,
    Answer,
    BoardDecoder,
    Layout,
    Push,
    Request,
    encode,
    pack_resultant,
    pack_taxels,
)
from palpate_paxini.fingertip import FINGERTIPS, fingertip

RIG = Path(__file__).parents[1] / "examples" / "paxini-bench.toml"
KEYS = {"sensor": "PXSR-CMDDP18A", "module": "index-tip", "rate_hz": 25.0}
THUMB_TIP, INDEX_TIP = 2, 6

REGISTER = st.integers(0, 0xFFFF)
FROM_BOARD = st.one_of(
    st.builds(Answer, st.integers(0, 255), REGISTER, st.binary(max_size=64)),
    st.builds(Push, st.integers(0, 255), st.binary(max_size=600)),
)
TO_BOARD = st.one_of(
    st.builds(Request, st.just(3), REGISTER, wanted=st.integers(1, 512)),
    st.builds(Request, st.sampled_from([0x10, 0x17, 0x55]), REGISTER, st.binary(max_size=10)),
)


class TestPaxini(FreeRunningConformance):
    protocol = "paxini"
    keys = KEYS
    shape = (5, 9)
    pressed = (3, 2)


class TestBench(RigConformance):
    rig = RIG


@given(
    st.one_of(
        st.tuples(st.just(True), st.lists(FROM_BOARD, max_size=6)),
        st.tuples(st.just(False), st.lists(TO_BOARD, max_size=6)),
    ),
    st.lists(st.integers(1, 90), min_size=1, max_size=20),
)
def test_messages_come_back_however_the_bytes_are_cut(
    sent: tuple[bool, list[object]], cuts: list[int]
) -> None:
    data = b"".join(map(encode, sent[1]))
    decoder, found = BoardDecoder(from_board=sent[0]), []
    while data:
        for cut in cuts:
            found += decoder.feed(data[:cut])
            data = data[cut:]
    assert found == sent[1]
    assert not decoder.faults
    assert decoder.waiting == 0


def test_garbage_gives_messages_or_counted_faults_in_bounded_memory() -> None:
    rng = np.random.default_rng(5)
    valid = b"".join(encode(Push(0, rng.bytes(153))) + encode(Answer(3, 16, rng.bytes(4))) for _ in range(15))

    def decoder() -> BoardDecoder:
        made = BoardDecoder()
        made.push_size = 153
        return made

    tally = fuzz(decoder, valid, 300_000, 6)
    assert tally.most_waiting <= 160
    assert tally.faults.total() > 0


@given(
    st.sets(st.integers(0, 27), min_size=1, max_size=4),
    st.integers(2, 3),
    st.integers(0, 2**32 - 1),
)
def test_forces_of_each_module_come_back_from_what_is_pushed(active: set[int], kinds: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 60, len(MODULES))
    forces = {
        each: rng.integers((-128, -128, 0), (128, 128, 256), (counts[each], 3)) for each in sorted(active)
    }
    parts = [pack_resultant(each[:1]) * (kinds & 1) + pack_taxels(each) for each in forces.values()]
    bits = sum(1 << each for each in active).to_bytes(4, "little")
    layout = Layout.of(bits, kinds, counts.astype("<u2").tobytes())
    data = b"".join(parts)
    assert layout.size == len(data)
    assert all(np.array_equal(layout.forces(data, each), forces[each]) for each in active)


def asked(bench: ArrayBench, request: bytes) -> list[object]:
    """What the emulated board answers to some bytes, within 50 ms."""
    now = bench.clock.now()
    sent = bench.device.feed(request, now) + bench.device.poll(now + 0.05)
    return BoardDecoder().feed(b"".join(data for _, data in sent))


def test_the_board_refuses_what_it_does_not_know_and_ignores_damage() -> None:
    bench = ArrayBench("paxini", KEYS)
    assert asked(bench, encode(Request(0x55, 0x16, b"\1"))) == [Answer(0x83, 0x16, b"")]
    assert asked(bench, encode(Request(0x10, 0x30, b"\1"))) == [Answer(0x86, 0x30, b"")]
    assert asked(bench, encode(Request(0x10, 0x16, b"\4"))) == [Answer(0x86, 0x16, b"")]
    assert asked(bench, encode(Request(0x10, 0x16, b"\2"))[:-1] + b"\0") == []
    assert asked(bench, encode(Request(3, 0x10, wanted=4))) == [Answer(3, 0x10, bytes((1 << 6, 0, 0, 0)))]
    assert asked(bench, encode(Request(3, 0x4000, wanted=2))) == [Answer(3, 0x4000, bytes(2))]


def test_a_start_takes_the_zero_and_a_restart_of_the_board_ends_the_stream() -> None:
    bench = ArrayBench("paxini", KEYS)
    bench.force_n[:] = 0
    bench.array.connect()
    bench.array.start(25.0)
    assert np.mean([bench.array.wait_frame(0.2).counts.mean() for _ in range(10)]) < 1
    bench.device.restart(bench.clock.now())
    bench.clock.sleep(0.2)
    bench.array.frames()
    with pytest.raises(DeviceError, match="sent no frame"):
        bench.array.wait_frame(0.5)
    bench.array.connect()
    bench.array.start(25.0)
    bench.array.wait_frame(0.2)


@pytest.mark.parametrize("version", [b"", b"ORCA1.0-1234567"])
def test_orcas_board_is_not_told_to_take_a_zero(version: bytes) -> None:
    bench = ArrayBench("paxini", KEYS)
    bench.device.board.version = version
    bench.force_n[:] = 0
    bench.array.connect()
    bench.array.start(25.0)
    assert np.mean([bench.array.wait_frame(0.2).counts.mean() for _ in range(10)]) > 1


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"module": "ring-tip"}, "no sensor at ring-tip; there are: index-tip"),
        ({"sensor": "PXSR-CMDDP18C", "module": "ring-tip"}, "no sensor"),
    ],
)
def test_a_fingertip_that_is_not_there_is_named(keys: dict[str, str], said: str) -> None:
    there = ArrayBench("paxini", KEYS)
    wrong = ArrayBench("paxini", KEYS | keys)
    array = wrong.plugin.driver(there.port, there.clock, "f1", wrong.config, 8.5)
    with pytest.raises(DeviceError, match=said):
        array.connect()


def test_forces_and_normals_are_within_the_examples_bounds() -> None:
    """Of flat walls that press on the emulated tip with twice contact_force_n or more; that it must feel."""
    rig = load_rig(RIG)
    spec, rng = rig.fingers[0], np.random.default_rng(7)
    cells = description_of(spec, 1)
    described = ArrayBench("paxini", KEYS).array.connect()
    tip, columns = fingertip("PXSR-CMDDP18A", upside_down=False), np.array(cells.columns)
    for seed in range(60):
        skin = ThreeAxisSkin(cells, tip, TaxelTruth(), seed)
        extractor = ContactExtractor(described, calibration_of(rig, spec, described))

        def frames(force_n: np.ndarray, begin_s: float) -> list[TactileFrame]:
            times = begin_s + np.arange(64) / 80
            read = [tip.pressed(skin.read(now, force_n)) for now in times]  # noqa: B023
            return [
                TactileFrame(k, now, now, each) for k, (now, each) in enumerate(zip(times, read, strict=True))
            ]

        nothing = np.zeros((cells.rows, cells.cols))
        skin.read(0.0, nothing)
        skin.take_zero()
        extractor.tare(frames(nothing, 0.1))
        assert max(map(extractor.force_n, frames(nothing, 1.0))) < rig.closing.contact_force_n
        pressing, normal = rng.uniform(4.0, 8.0), rng.uniform(-1.0, 1.0)
        least_mm = cells.tip_radius_mm - pressing / spec.tip.stiffness_n_per_mm
        dent = np.maximum(cells.tip_radius_mm * np.cos(columns - normal) - least_mm, 0)
        pressed = frames(np.tile(dent / dent.sum() * pressing / cells.rows, (cells.rows, 1)), 2.0)
        patch = extractor.extract(pressed[32:])
        assert patch is not None
        assert min(map(extractor.force_n, pressed[32:])) > rig.closing.contact_force_n
        assert abs(patch.force_n - pressing) <= patch.force_bound_n
        assert abs(patch.angle_rad - normal) <= patch.angle_half_range_rad


def test_upside_down_a_fingertip_is_turned_by_half_a_turn_about_where_it_faces() -> None:
    for name in FINGERTIPS:
        up, down = fingertip(name, upside_down=False), fingertip(name, upside_down=True)
        assert np.array_equal(up.matrix, down.matrix[::-1, ::-1])
        turned = up.normal[::-1, ::-1] * (1, -1, -1)
        np.testing.assert_allclose(down.normal, turned, atol=1e-12)
        assert (np.diff(np.arctan2(up.normal[..., 1], up.normal[..., 0]), axis=1) > 0).all()
        assert (np.diff(up.place_mm[..., 2], axis=0) > 0).all()


READ = """
import json, sys
from paxini_sdk import HighSpeedHandBoard
with HighSpeedHandBoard(sys.argv[1]) as board:
    assert board.read_version() == "emulated 02.22"
    resultant = board.read_resultant_forces()
    frames = list(board.stream_auto_push(max_frames=30))
    board.calibrate()
print(json.dumps([list(resultant), [[f.resultant_forces, f.distributed_forces] for f in frames]]))
"""


@pytest.mark.realtime
@pytest.mark.skipif(
    find_spec("paxini_sdk") is None,
    reason="paxini-sdk, a reader of these boards, is not installed: pip install palpate-paxini[judges]",
)
def test_a_reader_of_these_boards_reads_the_emulated_one() -> None:
    (modules, frames), sent = ArrayBench("paxini", KEYS | {"rate_hz": 80.0}, baudrate_bps=921_600).read_by(
        READ
    )
    assert [name.lower() for name in modules] == ["index-tip"]
    layout = Layout.of((1 << INDEX_TIP).to_bytes(4, "little"), 3, np.full(28, 51, "<u2").tobytes())
    pushed = [item.data for item in BoardDecoder().feed(sent) if isinstance(item, Push)]
    ours = iter([layout.forces(data, INDEX_TIP).tolist() for data in pushed])
    theirs = [taxels["Index-Tip"] for _, taxels in frames]
    assert len(theirs) == 30
    assert all(each in ours for each in theirs)  # in this order; of what comes at once it reads one
    assert np.array(theirs)[..., :2].min() < 0 < np.array(theirs)[..., :2].max()
    assert [sums["Index-Tip"][2] for sums, _ in frames] == np.array(theirs)[..., 2].sum(axis=1).tolist()


FOLDER = Path(os.environ.get("ORCA_CORE", Path(sys.prefix) / "other" / "orca_core"))
READ_BY_ORCA = """
import json, sys, time
sys.path.insert(0, FOLDER)
from orca_core.hardware.hand_serial_link import HandSerialLink
from orca_core.hardware.sensing.constants import FINGER_SENSOR_PART
from orca_core.hardware.sensing.taxel_geometry import load_taxel_geometry
from orca_core.hardware.tactile_client import TactileClient

link, frames = HandSerialLink(sys.argv[1], baudrate=921600), {}
link.connect()
with TactileClient(link) as client:
    client.start_stream(resultant=True, taxels=True)
    while len(frames) < 30:
        if (reading := client.get_latest()) is not None:
            frames[reading.seq] = reading.taxels["thumb"]
        time.sleep(0.002)
    seen = client.get_stats().frames_bad_payload_size
link.disconnect()
tips = {part: load_taxel_geometry(finger) for finger, part in FINGER_SENSOR_PART.items()}
places = {part: [tip.positions.tolist(), tip.normals.tolist()] for part, tip in tips.items()}
print(json.dumps([seen, list(frames.values()), places]))
"""


@pytest.mark.realtime
@pytest.mark.skipif(
    not (FOLDER / "orca_core").is_dir(),
    reason="orca_core cannot be installed beside palpate; make test puts it into a folder of its own",
)
def test_orcas_package_reads_the_emulated_board_and_has_the_same_places() -> None:
    bench = ArrayBench("paxini", KEYS | {"module": "thumb-tip", "rate_hz": 80.0}, baudrate_bps=921_600)
    (bad, theirs, places), sent = bench.read_by(READ_BY_ORCA.replace("FOLDER", repr(str(FOLDER))))
    layout = Layout.of((1 << THUMB_TIP).to_bytes(4, "little"), 3, np.full(28, 51, "<u2").tobytes())
    pushed = [item.data for item in BoardDecoder().feed(sent) if isinstance(item, Push)]
    ours = iter([(layout.forces(data, THUMB_TIP) / 10).tolist() for data in pushed])
    assert bad == 0
    assert len(theirs) == 30
    assert all(each in ours for each in theirs)
    for name in FINGERTIPS:
        tip, (place, normal) = fingertip(name, upside_down=False), map(np.array, places[name])
        assert tip.taxels == len(place)
        off_mm = tip.place_mm - 1e3 * place[tip.matrix][..., [2, 0, 1]]
        assert np.ptp(off_mm, axis=(0, 1)).max() < 0.02
        assert np.abs(tip.normal - normal[tip.matrix][..., [2, 0, 1]]).max() < 2e-3
