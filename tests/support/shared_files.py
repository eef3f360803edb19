"""Files that some tests use and the repository does not hold: outlines of real parts, CAD files of others.

They are in a folder with `outlines/` and `cad/` in it, named by the environment variable PALPATE_SHARED_DATA;
without it, `../shared/data` beside the repository. Tests that need them are skipped where they are not.
"""

import os
from pathlib import Path

import pytest
from repository import ROOT

__all__ = ["SHARED_OUTLINES", "SHARED_OUTLINE_SETS", "cad_file", "needs_shared_outlines"]

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
