"""Campaign of a study: runs on all cores or a cluster, saved to a file as they finish, and resumed from it.

The file is JSON Lines: its first line says what decides the runs, each other one is a run. On a cluster
chunks of runs are tasks of a dask scheduler, on any number of machines. A worker may die at any time: the
scheduler gives its chunks to others, and a chunk that was on several workers when they died is asked for
again. Results are a function of the runs' numbers, so that it does not matter who did them, nor whether
somebody had begun.
"""

import hashlib
import json
import logging
import os
import pickle
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from palpate.base.array_cache import source_digest
from palpate.base.errors import InputError, OutputError
from palpate.base.file_io import RUNS_BYTES, read_bytes
from palpate.base.optional_imports import import_extra
from palpate.config.problems import excerpt
from palpate.config.study_result import StudyRunOut
from palpate.config.writers import file_text
from palpate.rig.study.simulation import Simulation
from palpate.rig.study.variations import UNVARIED
from palpate.rig.workers import in_processes

_DECIDING_CODE = (
    "palpate.recognizer",
    "palpate.base.geometry",
    "palpate.drivers",
    "palpate.config",
    "palpate.rig",
)
"""Packages on whose code it depends what becomes of a run."""

_FORMAT = "palpate/study-runs@1"


class RunsFile:
    """Runs of one study, read and added to. A last line that was cut off is done away with, and done again.

    `study`: the digest of all that decides them.
    """

    def __init__(self, path: Path, simulation: Simulation) -> None:
        """Read what is there. Raises InputError for a file that cannot be read, or is of another study."""
        self._path = path
        self._head = _deciding_inputs(simulation)
        self.study = _digest(json.dumps(self._head))
        self.runs: list[StudyRunOut] = []
        if path.exists():
            self.runs = list(self._read())
        else:
            self._write(_lines([self._head]), "xb")

    def add(self, runs: Sequence[StudyRunOut]) -> None:
        """Keep runs. Raises OutputError if they cannot be written."""
        self._write(_lines([run.model_dump(mode="json") for run in runs]), "ab")

    def _read(self) -> Iterator[StudyRunOut]:
        data, head = read_bytes(self._path, RUNS_BYTES, "study fewer runs"), _lines([self._head])
        if len(data) < len(head) and head.startswith(data):  # empty, or it ended while that was written
            self._write(head[len(data) :], "ab")
            return
        first, *lines = data[: data.rfind(b"\n") + 1].splitlines() or [data]
        self._check_head(first)
        for number, line in enumerate(lines, 2):
            try:
                yield StudyRunOut.model_validate_json(line)
            except ValidationError:
                raise InputError(
                    f"{self._path}: line {number} is damaged; delete that line, and its run is done again"
                ) from None
        if not data.endswith(b"\n"):
            self._cut_to(data.rfind(b"\n") + 1)

    def _check_head(self, line: bytes) -> None:
        try:
            found = json.loads(line)
        except ValueError:
            found = None
        if not isinstance(found, dict) or found.get("format") != _FORMAT:
            raise InputError(
                f"{self._path}: is not a file of runs: its first line is "
                f"{excerpt(line.decode(errors='replace'))}; choose another file"
            )
        if found != self._head:
            raise InputError(
                f"{self._path}: holds runs of another study ({_difference(found, self._head)}); "
                "choose another file"
            )

    def _write(self, data: bytes, mode: str) -> None:
        try:
            with self._path.open(mode) as file:
                file.write(data)
        except OSError as error:
            raise self._unwritten(error) from error

    def _cut_to(self, size: int) -> None:
        try:
            os.truncate(self._path, size)
        except OSError as error:
            raise self._unwritten(error) from error

    def _unwritten(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path} cannot be written: {error.strerror}")


def _lines(values: Sequence[object]) -> bytes:
    return "".join(json.dumps(value, separators=(",", ":")) + "\n" for value in values).encode()


def _deciding_inputs(simulation: Simulation) -> dict[str, Any]:
    """All that decides the runs, each by itself, so that it can be said what is another."""
    return {
        "format": _FORMAT,
        "palpate": version("palpate"),
        "code": source_digest(*_DECIDING_CODE, compiled=True),
        "rig": _digest(simulation.rig.model_dump_json()),
        "objects": _digest(file_text(simulation.objects)),
        "strategy": simulation.strategy.value,
        "seed": simulation.seed,
        "placed_within_mm": simulation.within_mm,
    }


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _difference(found: Mapping[str, Any], own: Mapping[str, Any]) -> str:
    """Entry of a file's first line that is not this study's; the code only if nothing else is."""
    other = [key for key in own if found.get(key) != own[key]]
    if found.keys() != own.keys() or other == ["code"]:
        return "by code of palpate that has been upgraded or changed since"
    words = {
        "palpate": f"by palpate {excerpt(found['palpate'])[1:-1]}",
        "rig": "another rig",
        "objects": "other objects",
        "strategy": f"strategy {excerpt(found['strategy'])[1:-1]}",
        "seed": f"seed {excerpt(found['seed'])}",
        "placed_within_mm": f"parts placed within {excerpt(found['placed_within_mm'])} mm",
    }
    return ", ".join(words[key] for key in other if key in words)


_MAX_RUNS_PER_CHUNK = 25
"""Runs that a process does before it hands them over: so many are lost at most if it is killed."""
_MIN_CHUNKS = 64  # at least, or one a run: so that many cores have work, and none waits long for the last
_MAX_LOADED_SIMULATIONS = 8  # simulations that a process keeps ready


@dataclass(frozen=True)
class Chunk:
    """Chunk of a study: runs by `numbers`, as a process gets them.

    `simulation` is pickled, `study` the digest of what decides it, `palpate` and `code`: the version that has
    to do it, and the digest of its code.
    """

    simulation: bytes
    variation: str
    numbers: tuple[int, ...]
    study: str
    palpate: str
    code: str

    @property
    def name(self) -> str:
        """The same for the same runs of the same study."""
        what = f"{self.study[:12]}-{self.variation.replace(' ', '-') or 'as-it-is'}"
        return f"palpate-study-{what}-{self.numbers[0]}-{self.numbers[-1]}-{len(self.numbers)}"


Executor = Callable[[Sequence[Chunk]], Iterator[Sequence[StudyRunOut]]]
"""Carries out chunks, in any order; each chunk's runs come once."""


def simulate_here(chunks: Sequence[Chunk], workers: int | None = None) -> Iterator[Sequence[StudyRunOut]]:
    """Simulate on so many cores of this machine, or all."""
    for _, runs in in_processes(_carry_out_chunk, [(chunk,) for chunk in chunks], workers) if chunks else ():
        yield runs


def carry_out_runs(
    simulations: Mapping[str, tuple[Simulation, int]],
    file: RunsFile,
    progress: Callable[[str], None],
    execute: Executor = simulate_here,
) -> dict[str, list[StudyRunOut]]:
    """Yield the runs of each variation from 0 to as many as are wanted, in order.

    Those that the file has are taken from it, and the others are added to it.
    """
    wanted = {(name, number) for name, (_, count) in simulations.items() for number in range(count)}
    done = {key: run for run in file.runs if (key := _key(run)) in wanted}
    size = min(max((len(wanted) - len(done)) // _MIN_CHUNKS, 1), _MAX_RUNS_PER_CHUNK)
    chunks = [
        chunk
        for name, (item, count) in simulations.items()
        for chunk in split_into_chunks(
            name, item, [k for k in range(count) if (name, k) not in done], file.study, size
        )
    ]
    asked = simulations[UNVARIED][1]
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


def split_into_chunks(
    name: str, simulation: Simulation, missing: Sequence[int], study: str, size: int
) -> list[Chunk]:
    """The runs of a variation whose numbers are missing, so many to a chunk; `study`: digest of the study."""
    pickled, code = pickle.dumps(simulation), _code_digest()
    return [
        Chunk(pickled, name, tuple(missing[k : k + size]), study, version("palpate"), code)
        for k in range(0, len(missing), size)
    ]


def _carry_out_chunk(chunk: Chunk) -> list[StudyRunOut]:
    """Carry out a chunk, in whatever process; InputError in one that has another palpate."""
    own = version("palpate")
    if own != chunk.palpate or _code_digest() != chunk.code:
        other = "other code of " if own == chunk.palpate else ""
        raise InputError(
            f"a worker of the cluster has {other}palpate {own}, and this is palpate {chunk.palpate}: install "
            "the same on both"
        )
    simulation = _load_simulation(chunk.simulation)
    return [simulation.run(number, chunk.variation) for number in chunk.numbers]


def _code_digest() -> str:
    """Digest of this process's code, without a compiled kernel, which differs between machines."""
    return source_digest(*_DECIDING_CODE, compiled=False)


@lru_cache(maxsize=_MAX_LOADED_SIMULATIONS)
def _load_simulation(pickled: bytes) -> Simulation:
    """Once a process, with the catalogue that it prepares: chunks come one by one."""
    simulation: Simulation = pickle.loads(pickled)
    return simulation


_SCHEDULER_TIMEOUT_S = 10.0
_WORKERS_TIMEOUT_S = 30.0
_CHUNKS_AHEAD_PER_THREAD = (
    4  # chunks under way for each thread: none waits for work, and few are in memory at once
)
_MIN_CHUNKS_AHEAD = 16
_MAX_KILLS_PER_CHUNK = 5  # times that a chunk is asked for again: then it is the chunk that kills workers


@contextmanager
def cluster_executor(address: str, kept: str | None = None) -> Iterator[Executor]:
    """An executor on the workers of the scheduler at an address, such as tcp://192.168.1.5:8786.

    `kept`: the file in which runs are kept, if there is one, to be said where the scheduler is lost.

    Raises InputError if `distributed` is not installed, if no scheduler answers there, or one without
    workers; what it carries out, for a chunk that every worker dies of, and for workers without palpate.
    """
    distributed = import_extra("distributed", "cluster", "a study on a cluster")
    with _quiet_client_log(), _client(distributed, address) as client:
        yield lambda chunks: _results(distributed, client, chunks, kept)


@contextmanager
def _quiet_client_log() -> Iterator[None]:
    """Silence dask's log of a lost connection, a traceback, which is said here in a line."""
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(level)


def _client(distributed: Any, address: str) -> Any:
    try:
        # An address that is none would leave a client behind that takes 20 s to end.
        at = distributed.comm.get_address_host_port(address, strict=True)
    except (ValueError, NotImplementedError):
        raise InputError(
            f'"{address}" is no address of a dask scheduler, such as tcp://192.168.1.5:8786'
        ) from None
    try:
        # A client tries again for all of the time, also where a computer says at once that nobody listens.
        socket.create_connection(at, timeout=_SCHEDULER_TIMEOUT_S).close()
        client = distributed.Client(address, timeout=_SCHEDULER_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no dask scheduler answers at {address}; start one with `dask scheduler`, and workers with "
            f"`dask worker {address}`"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_WORKERS_TIMEOUT_S)
    except TimeoutError:
        client.close()
        raise InputError(
            f"the dask scheduler at {address} has no workers; start some with `dask worker {address}`"
        ) from None
    return client


def _results(
    distributed: Any, client: Any, chunks: Sequence[Chunk], kept: str | None
) -> Iterator[Sequence[StudyRunOut]]:
    if not chunks:
        return
    left, killed, chunk_of = list(reversed(chunks)), dict.fromkeys(chunks, 0), {}

    def submit(chunk: Chunk) -> Any:
        again = f"-again-{killed[chunk]}" if killed[chunk] else ""
        future = client.submit(_carry_out_chunk, chunk, key=chunk.name + again)
        chunk_of[future.key] = chunk
        return future

    threads = sum(client.nthreads().values())
    under_way = distributed.as_completed(loop=client.loop)
    for _ in range(min(len(left), max(_CHUNKS_AHEAD_PER_THREAD * threads, _MIN_CHUNKS_AHEAD))):
        under_way.add(submit(left.pop()))
    for future in under_way:
        chunk = chunk_of.pop(future.key)
        try:
            runs = future.result()
        except distributed.scheduler.KilledWorker as error:
            killed[chunk] += 1
            if killed[chunk] > _MAX_KILLS_PER_CHUNK:
                raise InputError(
                    f"runs {chunk.numbers[0]} to {chunk.numbers[-1]}: each worker that had them died, as it "
                    "does without memory enough; give workers more, or look at their logs"
                ) from error
            under_way.add(submit(chunk))
            continue
        except ImportError as error:
            raise InputError(
                f"a worker of the cluster cannot load palpate ({error}); install palpate "
                f"{chunk.palpate} where its workers run"
            ) from error
        except distributed.client.FutureCancelledError as error:
            rest = (
                "and with it the runs that were done: no file was named in which to keep them"
                if kept is None
                else f"runs that were done are in {kept}; the same command goes on from there"
            )
            raise InputError(f"the scheduler was lost; {rest}") from error
        yield runs
        future.release()
        if left:
            under_way.add(submit(left.pop()))
