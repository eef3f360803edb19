"""Campaign of a study: runs on all cores or a cluster, kept in a file as they come, and resumed from it."""

import hashlib
import json
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
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
from palpate.rig.study.variations import AS_IT_IS

__all__ = ["Chunk", "Executor", "RunsFile", "carry_out", "runs_of", "simulate_here"]

_FORMAT = "palpate/study-runs@1"
_MOST_IN_CHUNK = 25
"""Runs that a process does before it hands them over: so many are lost at most if it is killed."""
_CHUNKS = 64  # at least, or one a run: so that many cores have work, and none waits long for the last
_LOADED = 8  # simulations that a process keeps ready


@dataclass(frozen=True)
class Chunk:
    """Some runs of a study, by `numbers`, as a process gets them.

    `simulation` is pickled, `study` the digest of what decides it, `palpate`: the version that has to do it.
    """

    simulation: bytes
    variation: str
    numbers: tuple[int, ...]
    study: str
    palpate: str

    @property
    def name(self) -> str:
        """The same for the same runs of the same study."""
        what = f"{self.study[:12]}-{self.variation.replace(' ', '-') or 'as-it-is'}"
        return f"palpate-study-{what}-{self.numbers[0]}-{self.numbers[-1]}-{len(self.numbers)}"


Executor = Callable[[Sequence[Chunk]], Iterator[Sequence[StudyRunOut]]]
"""Carries out chunks, in any order; each chunk's runs come once."""


def simulate_here(chunks: Sequence[Chunk]) -> Iterator[Sequence[StudyRunOut]]:
    """On all cores of this machine."""
    for _, runs in in_processes(runs_of, [(chunk,) for chunk in chunks]) if chunks else ():
        yield runs


def carry_out(
    simulations: Mapping[str, tuple[Simulation, int]],
    file: "RunsFile",
    progress: Callable[[str], None],
    execute: Executor = simulate_here,
) -> dict[str, list[StudyRunOut]]:
    """Of each variation the runs from 0 to as many as are wanted, in order.

    Those that the file has are taken from it, and the others are added to it.
    """
    wanted = {(name, number) for name, (_, count) in simulations.items() for number in range(count)}
    done = {key: run for run in file.runs if (key := _key(run)) in wanted}
    size = min(max((len(wanted) - len(done)) // _CHUNKS, 1), _MOST_IN_CHUNK)
    chunks = [
        chunk
        for name, (item, count) in simulations.items()
        for chunk in _chunks(name, item, [k for k in range(count) if (name, k) not in done], file.study, size)
    ]
    asked = simulations[AS_IT_IS][1]
    repeated = f" ({asked}, and {len(wanted) - asked} again with one thing changed)" * (len(wanted) > asked)
    progress(f"runs: {len(done)} of {len(wanted)}{repeated}")
    for some in execute(chunks):
        new = [run for run in some if _key(run) not in done]
        file.add(new)
        done |= {_key(run): run for run in new}
        progress(f"runs: {len(done)} of {len(wanted)}{repeated}")
    return {name: [done[name, number] for number in range(count)] for name, (_, count) in simulations.items()}


def _key(run: StudyRunOut) -> tuple[str, int]:
    return run.variation, run.number


def _chunks(name: str, simulation: Simulation, missing: Sequence[int], study: str, size: int) -> list[Chunk]:
    pickled = pickle.dumps(simulation)
    return [
        Chunk(pickled, name, tuple(missing[k : k + size]), study, version("palpate"))
        for k in range(0, len(missing), size)
    ]


def runs_of(chunk: Chunk) -> list[StudyRunOut]:
    """Carry out a chunk, in whatever process; InputError in one that has another version of palpate."""
    own = version("palpate")
    if own != chunk.palpate:
        raise InputError(
            f"a worker of the cluster has palpate {own}, and this is palpate {chunk.palpate}: install the "
            "same on both"
        )
    simulation = _loaded(chunk.simulation)
    return [simulation.run(number, chunk.variation) for number in chunk.numbers]


@lru_cache(maxsize=_LOADED)
def _loaded(pickled: bytes) -> Simulation:
    """Once a process, with the catalogue that it prepares: chunks come one by one."""
    simulation: Simulation = pickle.loads(pickled)
    return simulation


class RunsFile:
    """Runs of one study as JSON Lines. The first line says what decides them all.

    A last line that was cut off is ignored, and written anew.
    """

    def __init__(self, path: Path, simulation: Simulation, version: str) -> None:
        """Read what is there. Raises InputError for a file that cannot be read, or is of another study."""
        self._path = path
        self.study = _digest(simulation)
        self._head = {"format": _FORMAT, "palpate": version, "study": self.study}
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
    placed = f"{simulation.within_mm:g}"
    words = (rig, file_text(simulation.objects), simulation.strategy.value, str(simulation.seed), placed)
    return hashlib.sha256("\0".join(words).encode()).hexdigest()


def _json(line: bytes) -> Any:
    try:
        return json.loads(line)
    except ValueError:
        return None
