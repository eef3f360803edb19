"""Objects files that were read once: taken from the cache they are what was read, or they are read anew."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from prepared_bits import drawn_catalogue, round_objects

from palpate.base.array_cache import CACHE_PLACE, map_arrays
from palpate.base.errors import InputError
from palpate.base.geometry import Circle, ObjectModel
from palpate.config.objects_file import ObjectsFile, arrays_of_objects, load_objects, objects_of_arrays
from palpate.config.writers import file_text


def _written(path: Path, objects: list[ObjectModel]) -> Path:
    path.write_text(file_text(ObjectsFile(tuple(objects))))
    return path


def _large() -> list[ObjectModel]:
    known = drawn_catalogue(5, least_vertices=3500)
    first = known[0]
    state = replace(
        first.states[0],
        probability=0.25,
        tipping_angle_rad=0.3,
        normal_bound_rad=0.1,
        side_mm=(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 9.0]]),),
    )
    return [replace(first, states=(state,), holds_n=0.5, support_mm=3.0, normal_bound_rad=0.2), *known[1:]]


def _same(one: object, two: object) -> bool:
    """Every field, every bit."""
    if isinstance(one, np.ndarray):
        return isinstance(two, np.ndarray) and (one.shape, one.tobytes()) == (two.shape, two.tobytes())
    if isinstance(one, tuple):
        return isinstance(two, tuple) and len(one) == len(two) and all(map(_same, one, two))
    if isinstance(one, Circle) or not hasattr(one, "__dataclass_fields__"):
        return one == two
    names = [item.name for item in fields(one) if item.name != "notices"]  # type: ignore[arg-type]
    return type(one) is type(two) and all(_same(getattr(one, name), getattr(two, name)) for name in names)


def test_arrays_and_back() -> None:
    objects = (*_large(), *round_objects())
    back, notices = objects_of_arrays(arrays_of_objects(objects, ("one point left out",)))
    assert _same(objects, back)
    assert notices == ("one point left out",)


def test_a_large_file_is_taken_from_the_cache_under_any_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _written(tmp_path / "first.json", _large())
    text = json.loads(path.read_text())
    text["objects"][1]["states"][0]["sections"][0]["polygons"][0]["outer"].insert(
        1, text["objects"][1]["states"][0]["sections"][0]["polygons"][0]["outer"][0]
    )
    path.write_text(json.dumps(text))
    read = load_objects(path)  # tests have no cache
    assert read.notices
    cache = tmp_path / "cache"
    monkeypatch.setenv(CACHE_PLACE, str(cache))
    again = load_objects(path)
    (kept,) = cache.iterdir()
    stamp = kept.stat().st_mtime_ns
    other = path.rename(tmp_path / "second.json")
    taken = load_objects(other)
    assert kept.stat().st_mtime_ns >= stamp
    for found in (again, taken):
        assert _same(read, found)
        assert not found.objects[0].states[0].sections[0].polygons[0].outer.flags.writeable
    assert [line.replace("first", "second") for line in read.notices] == list(taken.notices)
    damaged = bytearray(kept.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    kept.write_bytes(damaged)
    assert _same(read, load_objects(other))
    assert map_arrays(kept)


def test_a_wrong_file_stays_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_PLACE, str(tmp_path / "cache"))
    objects = _large()
    path = _written(tmp_path / "objects.json", objects)
    load_objects(path)
    text = path.read_text().replace(f'"{objects[1].name}"', f'"{objects[0].name}"', 1)
    path.write_text(text)
    for _ in range(2):
        with pytest.raises(InputError, match=r"objects\.json.*name is taken"):
            load_objects(path)


@pytest.mark.parametrize(
    "spoilt",
    [
        {"text": np.frombuffer(b"[[], [[1]]]", np.uint8)},
        {"text": np.frombuffer(b"[[], 3]", np.uint8)},
        {"text": np.frombuffer(b"[" * 100_000, np.uint8)},
        {"text": np.frombuffer(b"\xff\xfe\x00", np.uint8)},
        {"text": np.frombuffer(b"[[], []]", np.uint8)},
        {"sizes": np.array([3, -1])},
        {"sizes": np.array([3.0])},
        {"points": np.zeros((2, 2))},
        {"points": np.zeros(3, np.float32)},
    ],
)
def test_arrays_that_are_no_objects_are_refused(spoilt: dict[str, np.ndarray]) -> None:
    arrays = arrays_of_objects(tuple(drawn_catalogue(5)[:2]), ())
    with pytest.raises(ValueError, match=r"."):
        objects_of_arrays(arrays | spoilt)
    for name in spoilt:
        with pytest.raises(ValueError, match=r"."):
            objects_of_arrays({key: value for key, value in arrays.items() if key != name})
