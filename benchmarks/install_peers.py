"""Installs peers into an environment: `python install_peers.py REQUIREMENTS ENVIRONMENT`.

One after the other, so that one that does not install on this Python leaves the others; it is named, with the
last line of pip's complaint, and the benchmarks skip it by name.
"""

import subprocess
import sys
import venv
from pathlib import Path


def main() -> None:
    """Make the environment and install what the file lists."""
    requirements, folder = map(Path, sys.argv[1:])
    venv.create(folder, with_pip=True)
    for line in requirements.read_text().splitlines():
        wanted = line.partition("#")[0].split()
        if not wanted:
            continue
        command = [str(folder / "bin" / "python"), "-m", "pip", "install", "--disable-pip-version-check"]
        done = subprocess.run([*command, "--quiet", *wanted], capture_output=True, text=True, check=False)
        if done.returncode:
            complaint = done.stderr.strip().splitlines() or ["no reason given"]
            print(f"skipped {wanted[-1]}: {complaint[-1]}", flush=True)
    (folder / ".installed").touch()


if __name__ == "__main__":
    main()
