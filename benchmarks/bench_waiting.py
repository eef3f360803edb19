"""How long the rig waits between grips over a large catalogue: `python benchmarks/bench_waiting.py`.

Emulated runs over outlines of real parts (PALPATE_SHARED_DATA, or the objects files that are named; without
either, drawn ones), each in several sizes until there are as many as `--objects`. The wait is the processor
time of the whole process from the end of a grip to the begin of the next, or to the answer, with what the log
writes meanwhile. One row for each rig: median, 90th percentile, maximum. With `--write` the table goes into
docs/performance.md.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from peer_questions import drawn_models
from performance_page import markdown_table, milliseconds, update, versions_line

import palpate
from palpate.rig.identification import identify
from palpate.rig.session import run
from support.commands.repository import SHARED_OUTLINE_SETS

R = TypeVar("R")
# Of drawn outlines: as many as there are of parts, and scaled to about the size of parts.
DRAWN, EDGES, SCALE, HEIGHT_MM = 129, 20, 0.6, 20.0
RIGS = ("src/palpate/config/rigs/bench.toml", "examples/firm-rig.toml")


def outlines_in(files: Sequence[Path]) -> list[dict[str, Any]]:
    """All objects of objects files; without any file, `DRAWN` drawn ones."""
    if files:
        return [item for path in files for item in json.loads(path.read_text(encoding="utf-8"))["objects"]]
    found = []
    for model in drawn_models(DRAWN, EDGES):
        ((ring,),) = (section.rings for section in model.states[0].sections)
        found.append({"name": model.name, "outline": (SCALE * ring).tolist(), "height": HEIGHT_MM})
    return found


def joined(objects: Sequence[dict[str, Any]], most: int) -> dict[str, Any]:
    """An objects file of so many objects: these, then the same in other sizes."""
    sizes = np.random.default_rng(1).uniform(0.75, 1.0, most)
    found = []
    for k in range(most):
        item, size = objects[k % len(objects)], 1.0 if k < len(objects) else float(sizes[k])
        outline = [[round(size * x, 4), round(size * y, 4), *rest] for x, y, *rest in item["outline"]]
        found.append({**item, "name": f"{item['name']}-{k}", "outline": outline})
    return {"format": "palpate/objects@1", "units": "mm", "objects": found}


class Waits:
    """Processor times (s) from each grip's end to what follows."""

    def __init__(self) -> None:
        self.found: list[float] = []
        self._since: float | None = None

    def between_grips(self, carry_out: Callable[..., R]) -> Callable[..., R]:
        """As `carry_out`; the rig waits from its end on, and no longer when it is called."""

        def timed(*args: Any, **kwargs: Any) -> R:
            self.end()
            try:
                return carry_out(*args, **kwargs)
            finally:
                self._since = time.process_time()

        return timed

    def until_answer(self, identify: Callable[..., R]) -> Callable[..., R]:
        """As `identify`; the last wait ends with it."""

        def timed(*args: Any, **kwargs: Any) -> R:
            try:
                return identify(*args, **kwargs)
            finally:
                self.end()

        return timed

    def end(self) -> None:
        """The wait is over."""
        if self._since is not None:
            self.found.append(time.process_time() - self._since)
        self._since = None


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, help="objects files")
    parser.add_argument("--objects", type=int, default=500)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--write", action="store_true", help="into docs/performance.md")
    given = parser.parse_args()
    files = given.files or SHARED_OUTLINE_SETS
    kind = "outlines of parts" if files else f"drawn outlines of {EDGES} edges"
    with tempfile.TemporaryDirectory() as folder:
        objects = Path(folder, "objects.json")
        objects.write_text(json.dumps(joined(outlines_in(files), given.objects)), encoding="utf-8")
        rows = [row_of(rig, objects, given.runs, Path(folder, "sessions")) for rig in RIGS]
    table = markdown_table(("rig", "waits", "median", "90 %", "longest", "identified"), rows)
    told = versions_line({"palpate": version("palpate"), "numpy": np.__version__})
    text = f"{told} {given.objects} {kind}, {given.runs} runs.\n\n{table}"
    print(text)
    if given.write:
        update("waits", text)


def row_of(rig: str, objects: Path, runs: int, sessions: Path) -> tuple[str, ...]:
    """Runs on a rig."""
    waits, identified = Waits(), 0
    for seed in range(runs):
        with (
            mock.patch.object(identify, "carry_out_grip", waits.between_grips(identify.carry_out_grip)),
            mock.patch.object(run, "identify", waits.until_answer(run.identify)),
            palpate.open_rig(Path(__file__).parents[1] / rig, seed=seed) as opened,
        ):
            answer = opened.identify(objects, sessions=sessions)
        identified += answer.verdict.value == "identified"
    times = np.array(waits.found)
    told = (milliseconds(float(item)) for item in (np.median(times), np.percentile(times, 90), times.max()))
    return f"`{rig}`", f"{len(times)}", *told, f"{identified} of {runs}"


if __name__ == "__main__":
    main()
