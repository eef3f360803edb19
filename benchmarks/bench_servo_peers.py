"""The servo bus beside the SDK, lerobot and rustypot: run with `python benchmarks/bench_servo_peers.py`.

A control loop reads all servos and writes all goals, over a pseudo-terminal whose emulated servos live in
another process: cycles per second and the loop's processor time. palpate and the SDK read the state of all
servos, 14 bytes, in one read of indirect addresses (see `bench_bus.py`); lerobot and rustypot read one item
at a time. `--write` puts the table into docs/performance.md.
"""

import argparse
import json
import multiprocessing
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from bench_bus import real, serve
from performance_page import markdown_table, update, versions_line

from support.oracles.bus_loop import LoopCase

CLIENT = Path(__file__).parent / "peers" / "servo_loop.py"
SERVOS = 6
HEAD = ("", "reads", "cycles/s", "processor time of a cycle", "times palpate's")


def beside(library: str, python: str, case: LoopCase, seconds: float) -> dict[str, Any]:
    """What another library's loop takes."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=serve, args=(case, there), daemon=True)
    process.start()
    try:
        command = [python, str(CLIENT), library, here.recv(), str(case.servos), str(seconds)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        here.send(None)
        process.join(5)
    finally:
        process.kill()
    if done.returncode:
        raise RuntimeError(f"{library} failed:\n{done.stderr}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def line(name: str, reads: str, hz: float, cpu_us: float, ours_us: float) -> list[str]:
    return [name, reads, f"{hz:,.0f}", f"{cpu_us:,.0f} µs", f"{cpu_us / ours_us:.1f}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", default=sys.executable, help="with rustypot")
    parser.add_argument("--torch-python", default=sys.executable, help="with lerobot")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each loop")
    parser.add_argument("--write", action="store_true", help="put the table into docs/performance.md")
    given = parser.parse_args()
    versions = {name: metadata.version(name) for name in ("palpate", "dynamixel-sdk", "pyserial")}
    rows, skipped = [], set()
    case = LoopCase(SERVOS, "XM430-W350", 45, 1_000_000)
    ours: Any = real(case, given.seconds)
    base = ours["palpate_pty_cpu_us"]
    for name, key in (("palpate", "palpate"), ("SDK", "sdk")):
        rows.append(line(name, "state", ours[f"{key}_pty_hz"], ours[f"{key}_pty_cpu_us"], base))
    for library, python in (("rustypot", given.python), ("lerobot", given.torch_python)):
        found = (
            beside(library, python, case, given.seconds) if Path(python).exists() else {"missing": library}
        )
        if "missing" in found:
            skipped.add(f"{library}: skipped, {found['missing']} is not installed.")
            continue
        versions[library] = found["version"]
        rows += [
            line(library, reads, found[reads]["hz"], found[reads]["cpu_us"], base)
            for reads in ("state", "positions")
        ]
    whole = "\n\n".join([versions_line(versions), markdown_table(HEAD, rows), *sorted(skipped)])
    print(whole)
    if given.write:
        update("servo bus", whole)


if __name__ == "__main__":
    main()
