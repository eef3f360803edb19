"""Valid files of each format, cut and changed at random: each is read or refused, and nothing else."""

import random
import shutil
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import trimesh
from firm_rig import firm_rig
from hostile_cad_files import SQUARE, SVG, dxf
from hostile_files import FIRST
from repository import EXAMPLES
from solids import ELL, prism

from palpate.base.errors import InputError
from palpate.cad.readers import read_drawings, read_solids
from palpate.config import load_contacts, load_objects, load_rig, load_scene, shipped_objects
from palpate.config.calibration_file import load_calibration
from palpate.rig.session.log_reader import read_session

LINE = '{"t_s":0.1,"event":"bytes","port":"a","direction":"sent","base64":"AA==","calls":"t1~2.z"}\n'
CIRCLE = "0\nCIRCLE\n8\n0\n10\n50\n20\n50\n40\n9\n"
PATH = '<path d="M1 1 H9 V9 A3 4 5 0 1 2 7 Z" transform="scale(2)"/>'
BYTES = (0, 9, 10, 34, 45, 46, 48, 57, 91, 128, 255)
TRIALS = 60


def solid(path: Path) -> object:
    return read_solids(path, None if path.suffix == ".3mf" else "mm", 0.1)


def drawing(path: Path) -> object:
    return read_drawings(path, None, 0.1)


def session(path: Path) -> object:
    shutil.copy(path, path.with_name("session.jsonl"))
    return read_session(path.parent)


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
    "e.log": (session, (FIRST + LINE * 20).encode),
    "f.stl": (solid, mesh("stl")),
    "g.stl": (solid, mesh("stl_ascii")),
    "h.obj": (solid, mesh("obj")),
    "i.ply": (solid, mesh("ply")),
    "j.3mf": (solid, mesh("3mf")),
    "k.svg": (
        drawing,
        SVG.format(PATH).encode,
    ),
    "l.dxf": (drawing, dxf(CIRCLE + SQUARE).encode),
    "m.toml": (load_calibration, lambda: b'format = "palpate/calibration@1"\n[[fingers]]\nname = "f1"\n'),
}


def damaged(whole: bytes, draw: random.Random) -> Iterator[bytes]:
    """Cut, with some bytes changed, with a part repeated, left out or replaced by another."""
    for _ in range(TRIALS // 4):
        data = bytearray(whole)
        for _ in range(draw.randint(1, 4)):
            data[draw.randrange(len(data))] = draw.choice(
                (0, 9, 10, 34, 45, 46, 48, 57, 255, draw.randrange(256))
            )
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
        if name in {"m.toml"}:
            continue
        (tmp_path / name).write_bytes(whole())
        if name == "l.dxf":
            (tmp_path / name).write_text(dxf(CIRCLE))
        read(tmp_path / name)
    assert trimesh.load(tmp_path / "f.stl").is_watertight
