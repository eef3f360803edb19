"""A process with limits: values and refusals come back from it, and none of what a reader may do to it."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from palpate.base.confined_reading import read_confined
from palpate.base.errors import InputError
from palpate.base.file_io import READING_BYTES, READING_S, read_bytes

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


@pytest.mark.slow
def test_without_end() -> None:
    begin = time.process_time()
    assert f"more than {READING_S:g} s" in failure(pow, 7, 10**9)
    assert time.process_time() - begin < 2


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
