"""Study on a cluster: chunks of runs as tasks of a dask scheduler, on any number of machines.

A worker may die at any time: the scheduler gives its chunks to others, and a chunk that was on several
workers when they died is asked for again. Results are a function of the runs' numbers, so that it does not
matter who did them, nor whether somebody had begun before.
"""

import logging
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from palpate.base.errors import InputError
from palpate.base.optional_imports import needed
from palpate.config.study_result import StudyRunOut
from palpate.rig.study.campaign import Chunk, Executor, runs_of

__all__ = ["on_cluster"]

_ANSWERS_S = 10.0
_WORKERS_S = 30.0
_AHEAD = 4  # chunks under way for each thread: none waits for work, and few are in memory at once
_LEAST_AHEAD = 16
_MOST_KILLED = 5  # times that a chunk is asked for again: then it is the chunk that kills workers


@contextmanager
def on_cluster(address: str, kept: str | None = None) -> Iterator[Executor]:
    """An executor on the workers of the scheduler at an address, such as tcp://192.168.1.5:8786.

    `kept`: the file in which runs are kept, if there is one, to be said where the scheduler is lost.

    Raises InputError if `distributed` is not installed, if no scheduler answers there, or one without
    workers; what it carries out, for a chunk that every worker dies of, and for workers without palpate.
    """
    distributed = needed("distributed", "cluster", "a study on a cluster")
    with _own_words_only(), _client(distributed, address) as client:
        yield lambda chunks: _results(distributed, client, chunks, kept)


@contextmanager
def _own_words_only() -> Iterator[None]:
    """What dask logs of a connection that is lost, a traceback, is said here in a line."""
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
        socket.create_connection(at, timeout=_ANSWERS_S).close()
        client = distributed.Client(address, timeout=_ANSWERS_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no dask scheduler answers at {address}; start one with `dask scheduler`, and workers with "
            f"`dask worker {address}`"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
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
        future = client.submit(runs_of, chunk, key=chunk.name + again)
        chunk_of[future.key] = chunk
        return future

    threads = sum(client.nthreads().values())
    under_way = distributed.as_completed(loop=client.loop)
    for _ in range(min(len(left), max(_AHEAD * threads, _LEAST_AHEAD))):
        under_way.add(submit(left.pop()))
    for future in under_way:
        chunk = chunk_of.pop(future.key)
        try:
            runs = future.result()
        except distributed.scheduler.KilledWorker as error:
            killed[chunk] += 1
            if killed[chunk] > _MOST_KILLED:
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
