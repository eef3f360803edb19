"""palpate beside its peers on the same contacts and question: run with `python benchmarks/bench_peers.py`.

The question is which of the objects of a catalogue was touched, and where it lies, all answers wanted. Each
peer (benchmarks/peers) answers in a process of its own, on one core, with the Python that is named for it;
preparing a catalogue is not counted. What a peer answers is judged by shapely (`peer_questions.Judge`):

- truth missed: no answer holds the true pose;
- missed: of all right answers that any of them gave, those that no answer of this one holds;
- wrong: answers that break the bounds of a contact, or could not have been reached by the finger.

`--write` puts the tables into docs/performance.md. `--record` records a few ratios, `--compare` fails when
one of them has fallen below half of what is recorded.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from peer_questions import Asked, Case, Judge, ask
from performance_page import markdown_table, milliseconds, update, versions_line
from question import Answer, write

__all__ = ["QUICK", "RECORD", "Run", "quick_ratios", "run"]

PEERS = Path(__file__).parent / "peers"
RECORD = PEERS / "recorded_ratios.json"

PALPATE = "palpate_recognition"
LIGHT = {
    "networkx_cliques": "networkx, cliques",
    "cliquematch_cliques": "cliquematch, cliques",
    "codac_paving": "codac, paving",
    "scipy_restarts": "scipy, 100 starts",
    "gtsam_restarts": "gtsam, 100 starts",
    "scaling_series": "Scaling Series",
    "manifold_particle_filter": "manifold particle filter",
}
HEAVY = {"chsel_search": "CHSEL"}
TITLES = {PALPATE: "palpate", **LIGHT, **HEAVY}

CASES = (
    Case("six shipped objects, three touches, normals ±10°", 3, math.radians(10), 20),
    Case("six shipped objects, four touches, no normals", 4, None, 8),
    Case("60 drawn outlines of 20 edges, three touches, normals ±10°", 3, math.radians(10), 8, drawn=60),
)
REPEATS = 5
HEAVY_QUESTIONS = 2

QUICK = ("networkx_cliques", "codac_paving", "scipy_restarts")
QUICK_OPTIONS = {"scipy_restarts": ("--cold", "--seconds", "0")}  # one question takes it seconds
QUICK_CASE = Case("six shipped objects", 3, math.radians(10), 3)
ROUNDS = 3


@dataclass(frozen=True)
class Run:
    """What a peer answered: versions, and per question the processor time (s) and the answers."""

    versions: dict[str, str]
    prepared_s: float
    seconds: tuple[float, ...]
    answers: tuple[tuple[Answer, ...], ...]


class SkippedError(Exception):
    """A peer that cannot be asked; says why."""


def run(peer: str, asked: Asked, python: str, *options: str) -> Run:
    """Let a peer answer. Raises SkippedError if it is not installed, RuntimeError if it fails."""
    if not Path(python).exists():
        raise SkippedError("its environment was not made (make bench-torch)")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "problem.json")
        write(asked.problem, path)
        one_core = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
        done = subprocess.run(
            [str(Path(python).absolute()), str(PEERS / "answer.py"), peer, str(path), *options],
            env={**os.environ, **one_core},
            capture_output=True,
            text=True,
            check=False,
            cwd=folder,
        )
    if done.returncode:
        raise RuntimeError(f"{peer} failed:\n{done.stderr}")
    found = json.loads(done.stdout.splitlines()[-1])
    if "missing" in found:
        raise SkippedError(f"{found['missing']} is not installed")
    return Run(
        found["versions"],
        found["prepared_s"],
        tuple(statistics.median(item["seconds"]) for item in found["questions"]),
        tuple(tuple(map(answer_of, item["answers"])) for item in found["questions"]),
    )


def answer_of(item: dict[str, Any]) -> Answer:
    box = item["box"] and tuple((low, high) for low, high in item["box"])
    return Answer(item["name"], tuple(item["pose"]), box)


@dataclass(frozen=True)
class Score:
    """How good a peer's answers are."""

    truths_missed: int
    missed: int
    known: int
    wrong: int
    answers: int


def right_answers(judge: Judge, asked: Asked, runs: dict[str, Run]) -> list[list[Answer]]:
    """Of each question: the truth, and every answer of any peer that is right beyond doubt."""
    found = []
    for number, (touches, truth) in enumerate(zip(asked.problem.questions, asked.truths, strict=True)):
        right = [truth]
        for each in runs.values():
            for answer in each.answers[number] if number < len(each.answers) else ():
                bare = Answer(answer.name, answer.pose)
                if judge.satisfied(answer, touches, -1) and not any(judge.covers(bare, x) for x in right):
                    right.append(bare)
        found.append(right)
    return found


def score(judge: Judge, asked: Asked, right: list[list[Answer]], answered: Run) -> Score:
    """How good answers are, over the questions that were answered."""
    truths = missed = known = wrong = 0
    for number, answers in enumerate(answered.answers):
        held = [any(judge.covers(mine, other) for mine in answers) for other in right[number]]
        truths += not held[0]
        missed += held.count(False)
        known += len(held)
        touches = asked.problem.questions[number]
        wrong += sum(not judge.satisfied(mine, touches, 1) for mine in answers)
    return Score(truths, missed, known, wrong, sum(map(len, answered.answers)))


def ratio_to(peer: Run, ours: Run) -> float:
    """Times palpate's time, over the questions that both answered."""
    both = min(len(peer.seconds), len(ours.seconds))
    return sum(peer.seconds[:both]) / sum(ours.seconds[:both])


HEAD = (
    "",
    "questions",
    "time of one",
    "times palpate's",
    "truths missed",
    "right answers missed",
    "wrong answers",
)


def row(name: str, each: Run, ours: Run, found: Score) -> list[str]:
    """A line of the table."""
    ratio = ratio_to(each, ours)
    return [
        TITLES[name],
        str(len(each.seconds)),
        milliseconds(statistics.median(each.seconds)),
        f"{ratio:.1f}" if ratio < 100 else f"{ratio:,.0f}",
        str(found.truths_missed),
        f"{found.missed} of {found.known}",
        f"{found.wrong} of {found.answers}",
    ]


def asked_of(case: Case, pythons: dict[str, str], seconds: float) -> tuple[str, dict[str, str]]:
    """The table of a case, and versions."""
    asked = ask(case)
    judge = Judge(asked.problem)
    runs: dict[str, Run] = {PALPATE: run(PALPATE, asked, sys.executable, "--repeats", str(REPEATS))}
    skipped = []
    for name in [*LIGHT, *(HEAVY if case is CASES[0] else ())]:
        print(f"  {name}", file=sys.stderr, flush=True)
        few = Asked(
            type(asked.problem)(asked.problem.models, asked.problem.questions[:HEAVY_QUESTIONS]),
            asked.truths[:HEAVY_QUESTIONS],
        )
        try:
            if name in HEAVY:
                runs[name] = run(name, few, pythons[name], "--cold")
            else:
                runs[name] = run(name, asked, pythons[name], "--seconds", str(seconds))
        except SkippedError as error:
            skipped.append(f"{TITLES[name]}: skipped, {error}.")
    right = right_answers(judge, asked, runs)
    rows = [row(name, each, runs[PALPATE], score(judge, asked, right, each)) for name, each in runs.items()]
    text = f"**{case.name[0].upper()}{case.name[1:]}**\n\n{markdown_table(HEAD, rows)}\n\n" + "\n".join(
        skipped
    )
    versions = {name: number for each in runs.values() for name, number in each.versions.items()}
    return text.strip(), versions


def quick_ratios(python: str = sys.executable, peers: Sequence[str] = QUICK) -> dict[str, float]:
    """Ratios of a few questions: the median of interleaved rounds."""
    asked = ask(QUICK_CASE)
    found: dict[str, list[float]] = {name: [] for name in peers}
    for _ in range(ROUNDS):
        ours = run(PALPATE, asked, sys.executable, "--repeats", "9")
        for name in peers:
            each = run(name, asked, python, *QUICK_OPTIONS.get(name, ("--repeats", "3")))
            found[name].append(ratio_to(each, ours))
    return {name: statistics.median(values) for name, values in found.items()}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", default=sys.executable, help="with the peers, but for those on PyTorch")
    parser.add_argument("--torch-python", default=sys.executable, help="with CHSEL")
    parser.add_argument("--seconds", type=float, default=45.0, help="of each peer and table, about")
    parser.add_argument("--compare", action="store_true", help="only a few ratios, with those recorded")
    parser.add_argument("--record", action="store_true", help="record these")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/performance.md")
    given = parser.parse_args()
    if given.compare or given.record:
        ratios = quick_ratios()
        print(json.dumps(ratios, indent=1))
        if given.record:
            RECORD.write_text(json.dumps(ratios, indent=1) + "\n")
        recorded = json.loads(RECORD.read_text())
        halved = [name for name, was in recorded.items() if ratios[name] < was / 2]
        if halved:
            sys.exit(f"{', '.join(halved)}: palpate's lead is less than half of what is recorded, {recorded}")
        return
    pythons = {**dict.fromkeys(LIGHT, given.python), **dict.fromkeys(HEAVY, given.torch_python)}
    texts, versions = [], {}
    for case in CASES:
        print(case.name, file=sys.stderr, flush=True)
        text, found = asked_of(case, pythons, given.seconds)
        versions |= found
        texts.append(text)
    whole = "\n\n".join([versions_line(versions), *texts])
    print(whole)
    if given.write:
        update("peers", whole)


if __name__ == "__main__":
    main()
