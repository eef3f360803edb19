"""The worst of the hostile files, each against its command: one line, exit code 2, little time and memory."""

import os
import resource
from collections.abc import Callable
from pathlib import Path

import pytest
from command import run
from hostile_files import CASES, Case

WORST = (
    "part.3mf: ZIP bomb, 4 GB",
    "part.3mf: a directory that lies",
    "part.svg: copies of copies",
    "part.svg: 20,000 groups, nested",
    "part.svg: a million vertices",
    "part.dxf: blocks of blocks",
    "part.ply: announces vertices that it lacks",
    "rig.toml: a quoted key of 100,000 parts",
)


@pytest.fixture
def processor_s() -> Callable[[], float]:
    """Processor time of the processes that have been started and have ended since."""

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = spent()
    return lambda: spent() - before


@pytest.mark.parametrize("case", [case for case in CASES if case.title in WORST], ids=lambda case: case.title)
def test_one_line_soon_and_nothing_written(
    case: Case, tmp_path: Path, processor_s: Callable[[], float]
) -> None:
    case.write(tmp_path / case.name)
    ended = run(*(case.name if part == "FILE" else part for part in case.command), cwd=tmp_path)
    assert (ended.code, ended.out) == (2, ""), ended
    assert ended.err.startswith("error: ")
    assert ended.err.count("\n") == 1
    assert case.name in ended.err
    assert "Traceback" not in ended.err
    assert processor_s() < 10
    assert os.listdir(tmp_path) == [case.name]


def test_all_of_the_worst_are_in_the_corpus() -> None:
    assert set(WORST) <= {case.title for case in CASES}
    assert len({case.title for case in CASES}) == len(CASES) >= 60
