"""Readers of all file formats, chosen by suffix, with the options that each of them accepts.

The entry point of `cad`: a file's suffix decides between solids (`mesh_files`, `threemf_files`, `step_files`)
and drawings (`dxf_files`, `svg_files`), whose readers are imported when they are needed.
"""

from collections.abc import Sequence
from pathlib import Path

from palpate.base.errors import InputError
from palpate.base.file_io import CAD_BYTES, MOST_FACETS, MOST_PARTS, check_file
from palpate.cad.mesh_files import MESH_SUFFIXES, read_mesh_file
from palpate.cad.parts import UNIT_MM, DrawingFile, SolidFile
from palpate.cad.step_files import STEP_SUFFIXES, read_step
from palpate.cad.threemf_files import read_3mf

_DRAWING_SUFFIXES = (".dxf", ".svg")
_3MF_SUFFIX = ".3mf"

CAD_SUFFIXES = (_3MF_SUFFIX, *MESH_SUFFIXES, *STEP_SUFFIXES, *_DRAWING_SUFFIXES)
"""Of all files that are read."""


def is_drawing(path: Path) -> bool:
    """Is a file a drawing (DXF, SVG), rather than a solid (STL, OBJ, PLY, 3MF, STEP)?

    Raises InputError for a suffix that is neither.
    """
    suffix = path.suffix.lower()
    if suffix not in CAD_SUFFIXES:
        raise InputError(f"{path}: unknown kind of file; allowed are {', '.join(sorted(CAD_SUFFIXES))}")
    return suffix in _DRAWING_SUFFIXES


def read_solids(path: Path, units: str | None, curve_mm: float) -> SolidFile:
    """All bodies of a mesh or STEP file, in mm and checked, named after the file or by it.

    `units`: "mm", "inch" or "m"; needed for STL, OBJ and PLY, which have none, and to be left out or right
    for 3MF and STEP, which have. Curves of STEP files are replaced by chords within `curve_mm`. Raises
    InputError with what is wrong and where.
    """
    if is_drawing(path):
        raise InputError(f"{path}: is a drawing, not a solid")
    _check(path, units)
    suffix = path.suffix.lower()
    if suffix == _3MF_SUFFIX:
        found = read_3mf(path, units)
    elif suffix in STEP_SUFFIXES:
        found = read_step(path, units, curve_mm)
    else:
        found = SolidFile(read_mesh_file(path, units))
    if not found.solids:
        raise InputError(f"{path}: {found.refused[0] if found.refused else 'holds no solid'}")
    _check_count(path, len(found.solids), "bodies")
    return found


def read_drawings(path: Path, units: str | None, curve_mm: float, layers: Sequence[str] = ()) -> DrawingFile:
    """All parts of a drawing, in mm; `units` and `layers` (of a DXF file) as its reader takes them."""
    if not is_drawing(path):
        raise InputError(f"{path}: is a solid, not a drawing")
    _check(path, units)
    if path.suffix.lower() == ".dxf":
        from palpate.cad.dxf_files import read_dxf  # noqa: PLC0415 - ezdxf is an extra

        found = read_dxf(path, units, curve_mm, layers)
    elif layers:
        raise InputError(f"{path}: has no layers; those of DXF files can be chosen")
    else:
        from palpate.cad.svg_files import read_svg  # noqa: PLC0415 - svgelements is an extra

        found = read_svg(path, units, curve_mm)
    _check_count(path, len(found.drawings), "parts")
    return found


def simpler_file_advice(path: Path) -> str:
    """Advice for a file that is too large for its limits."""
    if path.suffix.lower() in _DRAWING_SUFFIXES:
        return "draw the part with fewer lines and points, each part in a file of its own"
    return (
        f"export the part more coarsely, with fewer than {MOST_FACETS} facets, each part in a file of its own"
    )


def _check_count(path: Path, count: int, what: str) -> None:
    if count > MOST_PARTS:
        raise InputError(
            f"{path}: has {count} {what}; at most {MOST_PARTS} are read: {simpler_file_advice(path)}"
        )


def _check(path: Path, units: str | None) -> None:
    if units is not None and units not in UNIT_MM:
        raise InputError(f"units {units}: allowed are {', '.join(UNIT_MM)}")
    check_file(path, CAD_BYTES, simpler_file_advice(path))
