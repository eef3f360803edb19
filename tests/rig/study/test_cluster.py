"""Studies on a cluster: killed workers cost nothing but time; what is amiss is one line."""

import json
import random
import subprocess
import time
from pathlib import Path

import pytest
from command import PALPATE, run
from dask_cluster import Cluster, cluster
from quick_rig import small, small_parts
from repository import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

RUNS = 24
WORDS = ("study", "--rig", "rig.toml", "--objects", "small-parts.json", "--runs", RUNS, "--seed", 3)


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A folder with a small rig and its parts."""
    (tmp_path / "rig.toml").write_text(small(ROOT / "src/palpate/config/rigs/bench.toml"), encoding="utf-8")
    small_parts(tmp_path)
    return tmp_path


def started(bench: Path, on: Cluster) -> subprocess.Popen[str]:
    """A study on the cluster."""
    words = (*WORDS, "--json", "--scheduler", on.address, "--keep", "runs.jsonl")
    return subprocess.Popen(
        [PALPATE, *map(str, words)], cwd=bench, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def without_progress(err: str) -> str:
    """What a study says beside how far it is; on a slow computer it says that now and then."""
    return "".join(line for line in err.splitlines(keepends=True) if not line.startswith("runs: "))


def wait_for_runs(process: subprocess.Popen[str], keep: Path, count: int) -> None:
    """Until so many are kept, or it has ended."""
    while process.poll() is None and not (keep.exists() and keep.read_bytes().count(b"\n") > count):
        time.sleep(0.1)


def killed_while_it_runs(process: subprocess.Popen[str], on: Cluster, rng: random.Random) -> int:
    """Kill a worker now and then until the study ends; how many."""
    killed = 0
    while process.poll() is None:
        time.sleep(rng.uniform(0.5, 4.0))
        # Not for ever: a worker takes seconds to start, and all of them at once would get nothing done.
        killed += killed < 4 and on.kill_one(rng)
    return killed


def test_workers_that_are_killed_lose_nothing_and_nothing_counts_twice(bench: Path) -> None:
    with cluster(bench, workers=2) as on:
        process = started(bench, on)
        wait_for_runs(process, bench / "runs.jsonl", 3)
        killed = killed_while_it_runs(process, on, random.Random(1))
        out, err = process.communicate()
    assert (process.returncode, without_progress(err)) == (0, "")
    assert killed >= 2
    here = run(*WORDS, "--json", "--keep", "here.jsonl", cwd=bench)
    assert json.loads(out) | {"seconds": 0.0} == here.json | {"seconds": 0.0}
    kept, kept_here = (
        sorted((bench / name).read_text().splitlines()) for name in ("runs.jsonl", "here.jsonl")
    )
    assert kept == kept_here
    assert len(kept) > RUNS + 1, "runs with halved errors are among them"


def test_a_study_that_was_begun_here_goes_on_on_a_cluster(bench: Path) -> None:
    words = (*WORDS[:-4], "--budget", 0, "--seed", 3, "--keep", "runs.jsonl", "--json")
    run(*words, "--runs", 3, cwd=bench)
    with cluster(bench, workers=1) as on:
        told = run(*words, "--runs", 6, "--scheduler", on.address, cwd=bench)
    assert (told.code, without_progress(told.err), told.json["runs"]) == (0, "", 6)
    assert told.json | {"seconds": 0.0} == run(*words, "--runs", 6, cwd=bench).json | {"seconds": 0.0}


def test_a_scheduler_that_is_lost_is_one_line_and_what_was_done_is_kept(bench: Path) -> None:
    with cluster(bench, workers=1) as on:
        process = started(bench, on)
        keep = bench / "runs.jsonl"
        wait_for_runs(process, keep, 3)
        on.scheduler.kill()
        _, err = process.communicate(timeout=120)
    assert process.returncode == 2
    words = (
        "the scheduler was lost; runs that were done are in runs.jsonl; the same command goes on from there"
    )
    assert without_progress(err) == f"error: {words}\n"
    assert 3 < keep.read_text().count("\n") < RUNS


@pytest.mark.parametrize(
    ("address", "words"),
    [
        (
            "tcp://127.0.0.1:9",
            "no dask scheduler answers at tcp://127.0.0.1:9; start one with `dask scheduler`",
        ),
        ("workshop", '"workshop" is no address of a dask scheduler, such as tcp://192.168.1.5:8786'),
    ],
)
def test_no_scheduler_is_one_line(address: str, words: str, tmp_path: Path) -> None:
    told = run("study", "--runs", 2, "--scheduler", address, cwd=tmp_path)
    assert (told.code, told.out) == (2, "")
    assert told.err.startswith(f"error: {words}")
    assert told.err.count("\n") == 1


@pytest.mark.campaign
def test_a_scheduler_without_workers_is_one_line(tmp_path: Path) -> None:
    with cluster(tmp_path, workers=0) as on:
        told = run("study", "--runs", 2, "--scheduler", on.address, cwd=tmp_path)
    assert (told.code, told.err.count("\n")) == (2, 1)
    assert f"has no workers; start some with `dask worker {on.address}`" in told.err
