"""Campaign of a study: runs on all cores, kept in a file as they come, from which they are resumed."""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from palpate.config.study_result import StudyRunOut
from palpate.config.writers import file_text
from palpate.errors import InputError, OutputError
from palpate.files import read_bytes
from palpate.files.limits import LOG_BYTES
from palpate.rig.catalogue.processes import in_processes
from palpate.rig.study.simulation import Simulation

__all__ = ["RunsFile", "carry_out"]

_FORMAT = "palpate/study-runs@1"
_CHUNK = 25
"""Runs that a process does before it hands them over: so many are lost at most if it is killed."""


def carry_out(
    simulation: Simulation, runs: int, file: "RunsFile", progress: Callable[[str], None]
) -> list[StudyRunOut]:
    """All runs from 0 to `runs`, in order: those that the file has, and the others, which are added to it."""
    done = {run.number: run for run in file.runs if run.number < runs}
    missing = [number for number in range(runs) if number not in done]
    chunks = [tuple(missing[k : k + _CHUNK]) for k in range(0, len(missing), _CHUNK)]
    progress(f"{len(done)} of {runs} runs")
    for _, some in in_processes(_runs_of, [(simulation, chunk) for chunk in chunks]) if chunks else ():
        file.add(some)
        done |= {run.number: run for run in some}
        progress(f"{len(done)} of {runs} runs")
    return [done[number] for number in range(runs)]


def _runs_of(simulation: Simulation, numbers: Sequence[int]) -> list[StudyRunOut]:
    return [simulation.run(number) for number in numbers]


class RunsFile:
    """Runs of one study as JSON Lines. The first line says what decides them all.

    A last line that was cut off is ignored, and written anew.
    """

    def __init__(self, path: Path, simulation: Simulation, version: str) -> None:
        """Read what is there. Raises InputError for a file that cannot be read, or is of another study."""
        self._path = path
        self._head = {"format": _FORMAT, "palpate": version, "study": _digest(simulation)}
        self.runs: list[StudyRunOut] = []
        if path.exists():
            self.runs = list(self._read())
        else:
            self._append([self._head], anew=True)

    def add(self, runs: Sequence[StudyRunOut]) -> None:
        """Keep runs. Raises OutputError if they cannot be written."""
        self._append([run.model_dump(mode="json") for run in runs])

    def _read(self) -> Iterator[StudyRunOut]:
        data = read_bytes(self._path, LOG_BYTES, "study fewer runs")
        whole = data[: data.rfind(b"\n") + 1]
        head, *lines = whole.splitlines() or [b""]
        if _json(head) != self._head:
            raise InputError(
                f"{self._path}: holds runs of another study (rig, objects, strategy, seed or version of "
                "palpate); choose another file, or remove it"
            )
        for number, line in enumerate(lines, 2):
            try:
                yield StudyRunOut.model_validate_json(line)
            except ValidationError:
                raise InputError(f"{self._path}: line {number} is no run; remove the file") from None
        if len(whole) < len(data):
            self._write(whole, "wb")

    def _append(self, values: Sequence[object], *, anew: bool = False) -> None:
        text = "".join(json.dumps(value, separators=(",", ":")) + "\n" for value in values)
        self._write(text.encode(), "xb" if anew else "ab")

    def _write(self, data: bytes, mode: str) -> None:
        try:
            with self._path.open(mode) as file:
                file.write(data)
        except OSError as error:
            raise OutputError(f"{self._path} cannot be written: {error.strerror}") from error


def _digest(simulation: Simulation) -> str:
    """Of all that decides the runs."""
    rig = simulation.rig.model_dump_json()
    words = (rig, file_text(simulation.objects), simulation.strategy.value, str(simulation.seed))
    return hashlib.sha256("\0".join(words).encode()).hexdigest()


def _json(line: bytes) -> Any:
    try:
        return json.loads(line)
    except ValueError:
        return None
