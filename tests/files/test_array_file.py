"""Array files and the cache of them: what was put in comes out, or nothing; nothing else happens."""

import json
import os
import resource
import struct
import subprocess
import sys
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from palpate.base.array_cache import CACHE_PLACE, ArrayFileError, Cache, map_arrays, user_cache, write_arrays

SOME = {
    "points": np.arange(20.0).reshape(10, 2),
    "flags": np.array([True, False, True]),
    "none": np.empty((0, 2)),
}

_anything = st.sampled_from(["<f8", "<f4", "<i8", "|b1", "|u1"]).flatmap(
    lambda kind: arrays(kind, array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=7))
)


@given(given_arrays=st.dictionaries(st.text(max_size=20), _anything, max_size=6))
def test_arrays_come_back_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, given_arrays: dict[str, np.ndarray]
) -> None:
    path = tmp_path_factory.mktemp("arrays") / "some"
    write_arrays(path, given_arrays)
    found = map_arrays(path)
    assert found.keys() == given_arrays.keys()
    for name, value in given_arrays.items():
        assert (found[name].dtype, found[name].shape) == (value.dtype, value.shape)
        assert found[name].tobytes() == value.tobytes()
        assert not found[name].flags.writeable
        assert found[name].ctypes.data % 64 == 0 or not found[name].size
    assert [item.name for item in path.parent.iterdir()] == ["some"]


def test_objects_are_not_kept(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="object"):
        write_arrays(tmp_path / "some", {"value": np.array([object()])})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("cases", [60, pytest.param(2000, marks=pytest.mark.campaign)])
def test_every_damage_is_noticed(tmp_path: Path, cases: int) -> None:
    """Bytes changed, cut off, added or moved, anywhere."""
    rng, cache = np.random.default_rng(5), Cache(tmp_path)
    cache.keep("kind", "key", SOME)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    for case in range(cases):
        data = bytearray(whole)
        at = int(rng.integers(len(data)))
        if case % 4 == 0:
            data = data[:at]
        elif case % 4 == 1:
            data[at] ^= 1 << int(rng.integers(8))
        elif case % 4 == 2:
            data += rng.bytes(at + 1)
        else:
            size = min(int(rng.integers(1, 200)), len(data) - at)
            data[at : at + size] = rng.bytes(size)
        if bytes(data) == whole:
            continue
        path.write_bytes(data)
        assert cache.fetch("kind", "key") is None
    path.write_bytes(whole)
    assert cache.fetch("kind", "key") is not None


_HUGE = 1 << 62
_TABLES: list[object] = [
    [["a", "<f8", [_HUGE, _HUGE], 0]],
    [["a", "<f8", [10**30], 0]],
    [["a", "<f8", [-1], 0]],
    [["a", "<f8", [2], 1]],
    [["a", "<f8", [2], -64]],
    [["a", "<f8", [2], 1 << 40]],
    [["a", "<f8", [9], 0]],
    [["a", "|O", [1], 0]],
    [["a", "<f8", [True], 0]],
    [["a", "<f8", 3, 0]],
    [[1, "<f8", [1], 0]],
    [["a"]],
    [["a", "|u1", [0], 0]] * 1001,
    {"a": 1},
    None,
    3,
]


_TITLED = [json.dumps(["forged", table]) for table in _TABLES]


@pytest.mark.parametrize("table", [*_TITLED, '["other", []]', '["forged"]', "3", "[" * 5000, "{", "\x00"])
def test_a_table_that_was_forged_with_its_digest_is_refused(tmp_path: Path, table: str) -> None:
    text = table.encode()
    text += b" " * (-len(text) % 64)
    rest = struct.pack("<QQ", len(text), 64 + len(text) + 64) + text + bytes(64)
    path = tmp_path / "forged"
    path.write_bytes(b"palpate/arrays@2" + sha256(rest).digest() + rest)
    path.chmod(0o600)
    with pytest.raises(ArrayFileError):
        map_arrays(path)


def test_files_that_were_exchanged_are_nobodys(tmp_path: Path) -> None:
    """As when somebody renames them: each is whole, and is not what its name says."""
    cache = Cache(tmp_path)
    cache.keep("kind", "one", SOME)
    cache.keep("kind", "two", {"other": np.arange(3)})
    one, two = sorted(tmp_path.iterdir())
    both = one.read_bytes(), two.read_bytes()
    for path, data in ((one, both[1]), (two, both[0])):
        path.write_bytes(data)
    assert cache.fetch("kind", "one") is None
    assert cache.fetch("kind", "two") is None
    assert list(cache.newest("kind", 9)) == []
    cache.keep("kind", "one", SOME)
    assert cache.fetch("kind", "one") is not None


def test_a_folder_that_others_may_write_to_is_not_used(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache")
    cache.keep("kind", "one", SOME)
    assert cache.fetch("kind", "one") is not None
    for mode in (0o770, 0o707):
        (tmp_path / "cache").chmod(mode)
        assert cache.fetch("kind", "one") is None
        assert list(cache.newest("kind", 9)) == []
        cache.keep("kind", "two", SOME)
        assert len(list((tmp_path / "cache").iterdir())) == 1
    (tmp_path / "cache").chmod(0o700)
    assert cache.fetch("kind", "one") is not None


def _group_may_write(path: Path) -> None:
    path.chmod(0o620)


def _link(path: Path) -> None:
    path.rename(path.with_suffix(".other"))
    path.symlink_to(path.with_suffix(".other"))


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path, 0o600)


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _someone_elses(path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give files away")
    os.chown(path, 12345, 12345)


@pytest.mark.parametrize("change", [_group_may_write, _link, _pipe, _folder, _someone_elses])
def test_only_a_file_of_ones_own_is_taken(tmp_path: Path, change: Callable[[Path], None]) -> None:
    cache = Cache(tmp_path)
    cache.keep("kind", "key", SOME)
    (path,) = tmp_path.iterdir()
    change(path)
    assert cache.fetch("kind", "key") is None
    cache.keep("kind", "key", SOME)  # which fails where a folder is in the way


def test_places_where_nothing_can_be_kept_are_no_errors(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for cache in (Cache(None), Cache(tmp_path / "file" / "below"), Cache(Path("/proc/palpate"))):
        cache.keep("kind", "key", SOME)
        assert cache.fetch("kind", "key") is None
        assert list(cache.newest("kind", 3)) == []


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path) -> None:
    """The system ends writing in the middle of the file."""
    code = (
        "import numpy as np, sys; from pathlib import Path; from palpate.base.array_cache import Cache;"
        "cache = Cache(Path(sys.argv[1])); cache.keep('kind', 'key', {'a': np.zeros(100_000)});"
        "sys.exit(cache.fetch('kind', 'key') is not None)"
    )
    limit = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))  # noqa: E731
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], preexec_fn=limit, check=False)
    assert done.returncode == 0
    assert not list(tmp_path.iterdir())


def test_what_was_not_used_for_longest_makes_room(tmp_path: Path) -> None:
    cache = Cache(tmp_path, most_bytes=4000)
    for number in range(8):
        cache.keep("kind", f"key{number}", {"a": np.full(100, number, np.float64)})
        for age, path in enumerate(sorted(tmp_path.iterdir(), key=lambda item: item.stat().st_mtime)[::-1]):
            os.utime(path, (1000 - age, 1000 - age))
        assert cache.fetch("kind", "key0") is not None or number > 6
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 4000
    assert cache.fetch("kind", "key1") is None
    assert cache.fetch("kind", "key7") is not None
    cache.keep("kind", "large", {"a": np.zeros(300)})
    assert cache.fetch("kind", "large") is None  # it would leave room for nothing else


def test_what_a_killed_process_left_goes(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    old, new = tmp_path / ".kind-a.arrays.00.part", tmp_path / ".kind-b.arrays.00.part"
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (1, 1))
    cache.keep("kind", "key", SOME)
    assert not old.exists()
    assert new.exists()  # someone may be writing it


def test_where_the_users_cache_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(CACHE_PLACE, str(tmp_path))
    assert user_cache().folder == tmp_path
    monkeypatch.setenv(CACHE_PLACE, "off")
    assert user_cache().folder is None
    monkeypatch.delenv(CACHE_PLACE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache().folder == tmp_path / "palpate"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative, which the specification says to ignore")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert user_cache().folder == tmp_path / ".cache" / "palpate"
