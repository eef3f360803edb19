"""Places in the repository and in a shared folder."""

import os
from pathlib import Path

import pytest

# ----------------------------------------------------------------------------------------------------
# Folders of the repository that holds the tests.

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = ROOT / "examples"
PACKAGE = ROOT / "src" / "palpate"


# ----------------------------------------------------------------------------------------------------
# Files that some tests use and the repository does not hold: outlines of real parts, CAD files of others.
#
# They are in a folder with `outlines/` and `cad/` in it, named by the environment variable
# PALPATE_SHARED_DATA;
# without it, `../shared/data` beside the repository. Tests that need them are skipped where they are not.

_VARIABLE = "PALPATE_SHARED_DATA"
_FOLDER = Path(os.environ.get(_VARIABLE) or ROOT.parent / "shared" / "data")

SHARED_OUTLINES = _FOLDER / "outlines" / "classic.json"
"""Outlines of cut parts as an objects file."""

SHARED_OUTLINE_SETS = tuple(sorted(SHARED_OUTLINES.parent.glob("*.json")))
"""All sets of outlines that there are, that one among them."""

needs_shared_outlines = pytest.mark.skipif(
    not SHARED_OUTLINES.is_file(), reason=f"no file {SHARED_OUTLINES}: set {_VARIABLE}"
)


def cad_file(name: str) -> Path:
    """A solid or a drawing as another program wrote it; skips the test if it is not there."""
    file = _FOLDER / "cad" / name
    if not file.is_file():
        pytest.skip(f"no file {file}: set {_VARIABLE}")
    return file


# ----------------------------------------------------------------------------------------------------
# A folder that looks like installed distributions with entry points, for the front of `sys.path`.


def install(folder: Path, name: str, group: str, entries: dict[str, str]) -> None:
    """Write the metadata of distribution `name`, version 1.0, that registers `entries` in `group`."""
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    lines = [f"[{group}]", *(f"{key} = {value}" for key, value in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
