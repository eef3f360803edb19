"""The emulated rig in a process of its own, on pseudo-terminals, for commands that take it for a real one."""

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from command import PALPATE

__all__ = ["served"]


@contextmanager
def served(folder: Path, *args: object) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """The emulator's process and the object that it prints; it is ended as Ctrl-C would."""
    process = subprocess.Popen(
        [str(PALPATE), "emulate", *map(str, args)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        told = json.loads(process.stdout.readline())
        assert isinstance(told, dict)
        yield process, told
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=10)
        finally:
            process.kill()
