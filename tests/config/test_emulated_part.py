import json
from pathlib import Path
from typing import Any

import pytest
from firm_rig import firm_rig

from palpate.base.errors import InputError
from palpate.config import load_rig, load_scene
from palpate.config.writers import file_text


def rig_file(folder: Path, *lines: str) -> Path:
    text = firm_rig().read_text(encoding="utf-8")
    table = "\n".join(("[emulation.part]", *lines, "", "[[fingers]]"))
    (folder / "rig.toml").write_text(text.replace("[[fingers]]", table, 1), encoding="utf-8")
    return folder / "rig.toml"


def test_numbers_and_ranges_come_through_and_can_be_written(tmp_path: Path) -> None:
    file = rig_file(tmp_path, 'engine = "mujoco"', "mass_kg = [0.05, 1]", "tip_friction = 0", "feet = 3")
    rig = load_rig(file)
    assert rig.emulation is not None
    part = rig.emulation.part
    assert part is not None
    assert (part.engine, part.mass_kg, part.friction) == ("mujoco", (0.05, 1.0), 0.3)
    assert (part.tip_friction, part.feet) == (0.0, 3)
    (tmp_path / "again.toml").write_text(file_text(rig), encoding="utf-8")
    assert load_rig(tmp_path / "again.toml") == rig


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", 'part: the key "engine" is missing'),
        ('engine = "magic"', '"magic"; allowed: "still", "quasi-static", "mujoco"'),
        ("mass_kg = 0", "mass_kg: is 0; it must be above 0"),
        ('mass_kg = "1"', 'mass_kg: is "1"; it must be a number'),
        ("mass_kg = [1.0, 0.5]", "mass_kg: is [1, 0.5]; the first value must be below the second"),
        ("mass_kg = [1.0]", "mass_kg: has 1 value, more are needed"),
        ("mass_kg = [0.1, nan]", "mass_kg[1]: is nan; it must be a finite number"),
        ("friction = 0.0", "friction: is 0.0; it must be above 0"),
        ("tip_friction = [0.1, 3.0]", "tip_friction[1]: is 3.0; it must be at most 2"),
        ("feet = 2", "feet: is 2; a part stands on 3 feet at least, or on its whole base (0)"),
        ("feets = 3", 'unknown key "feets"; did you mean "feet"?'),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, line: str, words: str) -> None:
    given = [] if line == "" else [line] if line.startswith("engine") else ['engine = "still"', line]
    with pytest.raises(InputError) as caught:
        load_rig(rig_file(tmp_path, *given))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def scene(folder: Path, **part: Any) -> Path:
    text = {
        "format": "palpate/scene@1",
        "object": "plate",
        "configuration": {"x": 1.0, "y": 2.0, "theta": 0.5},
        "part": part,
    }
    (folder / "scene.json").write_text(json.dumps(text), encoding="utf-8")
    return folder / "scene.json"


def test_a_scene_may_say_mass_and_friction(tmp_path: Path) -> None:
    found = load_scene(scene(tmp_path, mass_kg=0.3))
    assert (found.mass_kg, found.friction) == (0.3, None)
    (tmp_path / "again.json").write_text(file_text(found), encoding="utf-8")
    assert load_scene(tmp_path / "again.json") == found
    with pytest.raises(InputError, match=r"part\.friction: is -1; it must be above 0"):
        load_scene(scene(tmp_path, friction=-1))
