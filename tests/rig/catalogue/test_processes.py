"""Parallel processes: none outlives what began it, and no more are started than are wanted."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
import waiting_work

from palpate.base.errors import InputError
from palpate.rig.workers import in_processes


def test_processes_end_with_one_that_is_killed(tmp_path: Path) -> None:
    script = waiting_work.__file__
    with subprocess.Popen([sys.executable, script, tmp_path], stdout=subprocess.PIPE) as process:
        # Begun, not processes: the one with short work may take the next before the third is awake.
        while len(list(tmp_path.iterdir())) < 3:
            assert process.poll() is None
            time.sleep(0.05)
        process.kill()
        # Ends when the last process that holds it does: one with work, and one that waits for some.
        assert process.communicate(timeout=20)[0] == b""


def test_no_more_processes_than_workers(tmp_path: Path) -> None:
    found = in_processes(waiting_work.wait, [(str(tmp_path), 0.0)] * 5, workers=1)
    assert sorted(index for index, _ in found) == list(range(5))
    assert len({path.name.split()[0] for path in tmp_path.iterdir()}) == 1


def test_a_process_that_the_system_ends_is_said() -> None:
    with pytest.raises(InputError, match="was ended from outside, as it is without memory enough"):
        list(in_processes(waiting_work.killed, [()], workers=1))
