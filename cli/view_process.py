"""The live view beside a run: a process of its own, so that nothing it does can slow the run."""

import os
import subprocess
import sys
from pathlib import Path

__all__ = ["start_view"]


def start_view(port: int, session: Path) -> None:
    """Start showing the session that this process records; the view says its address on stderr.

    It ends by itself after this process, once the page has the last frame and a stop is confirmed.
    """
    words = ["view", str(session), "--port", str(port), "--run", str(os.getpid())]
    subprocess.Popen(  # it is not waited for
        [sys.executable, "-m", "palpate", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the run
    )
