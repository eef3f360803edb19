"""Campaign of a study: runs on all cores or a cluster, kept in a file as they come, and resumed from it."""

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version

from palpate.base.errors import InputError
from palpate.base.files.code_digest import source_digest
from palpate.config.study_result import StudyRunOut
from palpate.rig.catalogue.processes import in_processes
from palpate.rig.study.runs_file import DECIDING_CODE, RunsFile
from palpate.rig.study.simulation import Simulation
from palpate.rig.study.variations import AS_IT_IS

__all__ = ["Chunk", "Executor", "carry_out", "chunks_of", "runs_of", "simulate_here"]

_MOST_IN_CHUNK = 25
"""Runs that a process does before it hands them over: so many are lost at most if it is killed."""
_CHUNKS = 64  # at least, or one a run: so that many cores have work, and none waits long for the last
_LOADED = 8  # simulations that a process keeps ready


@dataclass(frozen=True)
class Chunk:
    """Some runs of a study, by `numbers`, as a process gets them.

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
    """On so many cores of this machine, or all."""
    for _, runs in in_processes(runs_of, [(chunk,) for chunk in chunks], workers) if chunks else ():
        yield runs


def carry_out(
    simulations: Mapping[str, tuple[Simulation, int]],
    file: RunsFile,
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
        for chunk in chunks_of(
            name, item, [k for k in range(count) if (name, k) not in done], file.study, size
        )
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


def chunks_of(
    name: str, simulation: Simulation, missing: Sequence[int], study: str, size: int
) -> list[Chunk]:
    """The runs of a variation whose numbers are missing, so many to a chunk; `study`: digest of the study."""
    pickled, code = pickle.dumps(simulation), _own_code()
    return [
        Chunk(pickled, name, tuple(missing[k : k + size]), study, version("palpate"), code)
        for k in range(0, len(missing), size)
    ]


def runs_of(chunk: Chunk) -> list[StudyRunOut]:
    """Carry out a chunk, in whatever process; InputError in one that has another palpate."""
    own = version("palpate")
    if own != chunk.palpate or _own_code() != chunk.code:
        other = "other code of " if own == chunk.palpate else ""
        raise InputError(
            f"a worker of the cluster has {other}palpate {own}, and this is palpate {chunk.palpate}: install "
            "the same on both"
        )
    simulation = _loaded(chunk.simulation)
    return [simulation.run(number, chunk.variation) for number in chunk.numbers]


def _own_code() -> str:
    """Of this process, without what a kernel was compiled to: that is another on other machines."""
    return source_digest(*DECIDING_CODE, compiled=False)


@lru_cache(maxsize=_LOADED)
def _loaded(pickled: bytes) -> Simulation:
    """Once a process, with the catalogue that it prepares: chunks come one by one."""
    simulation: Simulation = pickle.loads(pickled)
    return simulation
