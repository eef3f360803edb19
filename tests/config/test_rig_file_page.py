"""docs/rig-file.md: its smallest file is one, and says which keys are required."""

import copy
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from palpate.base.errors import InputError
from palpate.config import load_rig

PAGE = Path(__file__).parents[2] / "docs" / "rig-file.md"


def smallest() -> dict[str, Any]:
    text = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    return tomlkit.parse(text).unwrap()


def places(value: Any, *way: str | int) -> Iterator[tuple[str | int, ...]]:
    """Ways to every key of tables in tables and lists."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in pairs:
        if isinstance(value, dict):
            yield (*way, key)
        yield from places(item, *way, key)


def written(tmp_path: Path, rig: dict[str, Any]) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(tomlkit.dumps(rig), encoding="utf-8")
    return path


def test_the_smallest_file_is_a_rig_file(tmp_path: Path) -> None:
    assert load_rig(written(tmp_path, smallest())).fingers[0].name == "right"


@pytest.mark.parametrize("way", list(places(smallest())), ids=lambda way: ".".join(map(str, way)))
def test_every_key_of_the_smallest_file_is_required(tmp_path: Path, way: tuple[str | int, ...]) -> None:
    rig = copy.deepcopy(smallest())
    table: Any = rig
    for key in way[:-1]:
        table = table[key]
    del table[way[-1]]
    with pytest.raises(InputError, match=re.escape(str(way[-1]))):
        load_rig(written(tmp_path, rig))
