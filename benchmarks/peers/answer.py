"""One peer answers one problem, in a process of its own: `python answer.py PEER PROBLEM.json`.

Prints JSON: versions, processor time of preparing, and for every question the processor times of its repeats
and the answers of the last. Once `--seconds` of processor time are spent no question is begun.
"""

import argparse
import importlib
import importlib.metadata
import json
import platform
import sys
import time
from dataclasses import asdict
from pathlib import Path

from question import read


def main() -> None:
    """Answer the problem."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("peer")
    parser.add_argument("problem", type=Path)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--cold", action="store_true", help="no question beforehand")
    given = parser.parse_args()
    try:
        peer = importlib.import_module(given.peer).PEER
    except ModuleNotFoundError as error:
        json.dump({"missing": error.name}, sys.stdout)
        return
    problem = read(given.problem)
    begin = time.process_time()
    solve = peer.prepare(problem.models)
    if not given.cold:
        solve(problem.questions[0])  # what is made when a tip is first seen is preparing, too
    prepared = time.process_time() - begin
    found = []
    for touches in problem.questions:
        if found and time.process_time() - begin > given.seconds:
            break
        times = []
        for _ in range(given.repeats):
            before = time.process_time()
            answers = solve(touches)
            times.append(time.process_time() - before)
        found.append({"seconds": times, "answers": [asdict(item) for item in answers]})
    versions = {name: importlib.metadata.version(name) for name in peer.distributions}
    versions["Python"] = platform.python_version()
    json.dump({"versions": versions, "prepared_s": prepared, "questions": found}, sys.stdout)


if __name__ == "__main__":
    main()
