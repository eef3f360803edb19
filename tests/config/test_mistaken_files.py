"""Files given for others: said as that, and not as faults of their syntax."""

from pathlib import Path

import pytest

from palpate.base.errors import InputError
from palpate.config import load_objects, load_rig, shipped_objects


@pytest.mark.parametrize("name", ["part.dxf", "PART.STL", "a part.step"])
@pytest.mark.parametrize("content", [b"  0\nSECTION\n", b"\x00\xc0\xff", b""])
def test_a_cad_file_is_to_be_imported(name: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as refused:
        load_objects(path)
    advice = f"{path}: is a CAD file; `palpate objects import {path}` makes object models of it"
    assert str(refused.value) == advice
    if content:
        with pytest.raises(InputError, match=r'is a CAD file; needed here: "palpate/rig@1"$'):
            load_rig(path)


def test_objects_are_no_rig(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(shipped_objects().read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(InputError, match=r'format: is "palpate/objects@1"; needed here: "palpate/rig@1"$'):
        load_rig(path)
