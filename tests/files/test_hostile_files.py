"""Files that mean harm, damaged files, confined reading."""

import os
import random
import resource
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from palpate.base.confined_reading import UnfinishedReadingError, read_confined
from palpate.base.errors import InputError, MissingPackageError
from palpate.base.file_io import READING_BYTES, READING_S, read_bytes
from palpate.base.optional_imports import import_extra
from palpate.cad.readers import read_drawings, read_solids
from palpate.config import load_contacts, load_objects, load_rig, load_scene, shipped_objects
from palpate.config.calibration_file import load_calibration
from support.benches.parts import ELL, prism
from support.benches.rigs import firm_rig
from support.campaign.hostile_files import CASES, SQUARE, SVG, Case, dxf
from support.campaign.sampling import sample
from support.commands.command import run
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# The worst of the hostile files, each against its command: one line, exit code 2, little time and memory.

WORST = (
    "part.3mf: ZIP bomb, 4 GB",
    "part.3mf: a directory that lies",
    "part.svg: copies of copies",
    "part.svg: 20,000 groups, nested",
    "part.svg: a million vertices",
    "part.dxf: blocks of blocks",
    "part.ply: announces vertices that it lacks",
    "rig.toml: a quoted key of 100,000 parts",
)


@pytest.fixture
def processor_s() -> Callable[[], float]:
    """Processor time of the processes that have been started and have ended since."""

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = spent()
    return lambda: spent() - before


WORST_CASES = [case for case in CASES if case.title in WORST]
DEAR = ("part.3mf: ZIP bomb, 4 GB", "part.svg: a million vertices", "part.svg: 20,000 groups, nested")


@pytest.mark.parametrize(
    "case",
    sample(WORST_CASES, [case for case in WORST_CASES if case.title not in DEAR]),
    ids=lambda case: case.title,
)
def test_one_line_soon_and_nothing_written(
    case: Case, tmp_path: Path, processor_s: Callable[[], float]
) -> None:
    case.write(tmp_path / case.name)
    ended = run(*(case.name if part == "FILE" else part for part in case.command), cwd=tmp_path)
    assert (ended.code, ended.out) == (2, ""), ended
    assert ended.err.startswith("error: ")
    assert ended.err.count("\n") == 1
    assert case.name in ended.err
    assert "Traceback" not in ended.err
    assert processor_s() < 10
    assert os.listdir(tmp_path) == [case.name]


def test_all_of_the_worst_are_in_the_corpus() -> None:
    assert set(WORST) <= {case.title for case in CASES}
    assert len({case.title for case in CASES}) == len(CASES) >= 60


# ----------------------------------------------------------------------------------------------------
# Valid files of each format, cut and changed at random: each is read or refused, and nothing else.

CIRCLE = "0\nCIRCLE\n8\n0\n10\n50\n20\n50\n40\n9\n"
PATH = '<path d="M1 1 H9 V9 A3 4 5 0 1 2 7 Z" transform="scale(2)"/>'
BYTES = (0, 9, 10, 34, 45, 46, 48, 57, 91, 128, 255)
TRIALS = 60


def solid(path: Path) -> object:
    return read_solids(path, None if path.suffix == ".3mf" else "mm", 0.1).solids


def drawing(path: Path) -> object:
    return read_drawings(path, None, 0.1)


def mesh(kind: str) -> Callable[[], bytes]:
    def made() -> bytes:
        data = prism(ELL, 20).export(file_type=kind)
        return data.encode() if isinstance(data, str) else data

    return made


READERS: dict[str, tuple[Callable[[Path], object], Callable[[], bytes]]] = {
    "a.toml": (load_rig, firm_rig().read_bytes),
    "b.json": (load_objects, shipped_objects().read_bytes),
    "c.json": (load_contacts, (EXAMPLES / "contacts.json").read_bytes),
    "d.json": (load_scene, (EXAMPLES / "scene.json").read_bytes),
    "f.stl": (solid, mesh("stl")),
    "g.stl": (solid, mesh("stl_ascii")),
    "h.obj": (solid, mesh("obj")),
    "i.ply": (solid, mesh("ply")),
    "j.3mf": (solid, mesh("3mf")),
    "k.svg": (drawing, SVG.format(PATH).encode),
    "l.dxf": (drawing, dxf(CIRCLE + SQUARE).encode),
    "m.toml": (load_calibration, lambda: b'format = "palpate/calibration@1"\n[[fingers]]\nname = "f1"\n'),
}


def damaged(whole: bytes, draw: random.Random) -> Iterator[bytes]:
    """Cut, with some bytes changed, with a part repeated, left out or replaced by another."""
    for _ in range(TRIALS // 4):
        data = bytearray(whole)
        for _ in range(draw.randint(1, 4)):
            data[draw.randrange(len(data))] = draw.choice((*BYTES, draw.randrange(256)))
        start, end = sorted(draw.sample(range(len(whole)), 2))
        other = draw.randrange(len(whole))
        yield whole[:start]
        yield bytes(data)
        yield whole[:start] + whole[end:]
        yield whole[:end] + whole[other : other + 50] + whole[end:]


def outcome(read: Callable[[Path], object], path: Path) -> str:
    """ "read", or the refusal."""
    try:
        read(path)
    except InputError as error:
        return str(error)
    return "read"


@pytest.mark.parametrize("name", READERS)
def test_read_or_refused(name: str, tmp_path: Path) -> None:
    read, whole = READERS[name]
    path = tmp_path / name
    seen: set[str] = set()
    for data in damaged(whole(), random.Random(name)):
        path.write_bytes(data)
        with warnings.catch_warnings(record=True) as noise:
            warnings.simplefilter("always")
            seen.add(outcome(read, path))
        assert [str(item.message) for item in noise if "palpate" in item.filename] == []
    refusals = seen - {"read"}
    assert len(refusals) > 3
    assert all(line.count("\n") == 0 and str(tmp_path) in line for line in refusals)


def test_what_is_damaged_here_is_read_otherwise(tmp_path: Path) -> None:
    for name, (read, whole) in READERS.items():
        if name == "m.toml":
            continue
        (tmp_path / name).write_bytes(whole())
        if name == "l.dxf":
            (tmp_path / name).write_text(dxf(CIRCLE))
        read(tmp_path / name)
    assert trimesh.load(tmp_path / "f.stl").is_watertight


# ----------------------------------------------------------------------------------------------------
# A process with limits: values and refusals come back from it, and none of what a reader may do to it.

FILE = Path("a.svg")


def failure(read: object, *arguments: object) -> str:
    with pytest.raises(InputError) as refused:
        read_confined(FILE, "try another", read, *arguments)  # type: ignore[arg-type]
    message = str(refused.value)
    assert message.startswith("a.svg: ")
    assert message.endswith("; try another")
    assert len(message.splitlines()) == 1
    return message


def test_values_come_back() -> None:
    rows = read_confined(FILE, "", np.arange, 12.0)
    assert rows.tolist() == list(range(12))


def test_a_refusal_comes_back_as_it_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"b\.svg: there is no such file$"):
        read_confined(FILE, "try another", read_bytes, tmp_path / "b.svg", 10, "")


def test_a_package_that_is_missing_says_nothing_of_the_file() -> None:
    with pytest.raises(MissingPackageError, match="reading STEP files needs no_such_module"):
        read_confined(FILE, "", import_extra, "no_such_module", "step", "reading STEP files")


@pytest.mark.slow
def test_without_end() -> None:
    begin = time.process_time()
    assert f"more than {READING_S:g} s" in failure(pow, 7, 10**9)
    assert time.process_time() - begin < 2


def test_a_busy_computer_says_nothing_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.base.confined_reading.READING_WALL_S", 0.01)
    with pytest.raises(UnfinishedReadingError, match=r"was not read within 0\.01 s"):
        read_confined(FILE, "try another", pow, 7, 3)


def test_more_memory_than_there_is() -> None:
    assert "768 MB of memory" in failure(bytes, READING_BYTES)
    assert "768 MB of memory" in failure(np.ones, READING_BYTES // 8)


def test_a_crash() -> None:
    assert "crashed" in failure(signal.raise_signal, signal.SIGSEGV)


def test_what_nobody_thought_of() -> None:
    assert "cannot be read (ZeroDivisionError: " in failure(divmod, 1, 0)


def test_what_is_written_elsewhere_does_not_disturb() -> None:
    assert read_confined(FILE, "", os.system, "echo noise; echo noise >&2") == 0


def test_temporary_files_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    failure(os.system, "mktemp; kill -SEGV $PPID")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [0, 9, 10])
def test_a_file_up_to_its_limit(tmp_path: Path, size: int) -> None:
    (tmp_path / "a").write_bytes(bytes(size))
    assert len(read_bytes(tmp_path / "a", 10, "")) == size


def test_a_file_beyond_its_limit(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(3_000_011))
    with pytest.raises(InputError, match=r"a: has 3 MB; at most 2 MB are read: take another$"):
        read_bytes(tmp_path / "a", 2_000_000, "take another")


def test_a_file_that_says_nothing_of_its_size() -> None:
    with pytest.raises(InputError, match=r"/proc/cpuinfo: has more; at most 1e-05 MB are read"):
        read_bytes("/proc/cpuinfo", 10, "")
