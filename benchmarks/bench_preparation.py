"""What preparing a catalogue costs, and the next time: run with `python benchmarks/bench_preparation.py`.

Outlines of 66 edges, no two alike, for one kind of finger. Each row is a process of its own that loads the
objects file and prepares the catalogue, as `palpate recognize` does before it recognises: processor time,
that of its children too; time on the clock; the most memory of the process itself (its imports take 105 MB).
First start: the cache is empty. Second: it has everything. "+1": one outline of the file is another one.
"kept" are the files in the cache.

Xeon, two cores that others used as well (so the clock tells more than there was):

TABLE
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from bench_recognizer import jagged

import palpate
from palpate.config import ObjectsFile
from palpate.recognizer import Finger
from palpate.rig.catalogue.preparation import prepare_catalogue

_HEIGHT_MM = 10.0


def measured(path: str, radius_mm: str) -> None:
    """Print what one start costs, as JSON."""
    before, begin = _processor_s(), time.perf_counter()
    finger = Finger(float(radius_mm), _HEIGHT_MM)
    prepare_catalogue(palpate.load_objects(path).objects, [finger])
    found = {"cpu_s": _processor_s() - before, "wall_s": time.perf_counter() - begin, "mb": _most_mb()}
    print(json.dumps(found))


def _processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(item.ru_utime + item.ru_stime for item in used)


def _most_mb() -> float:
    """Of this process since it was started; what getrusage tells begins with the parent's."""
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line)
    return int(line.split()[1]) / 1024


def start(path: Path, radius_mm: float, cache: Path) -> dict[str, float]:
    """A process that prepares."""
    done = subprocess.run(
        [sys.executable, __file__, "--start", str(path), str(radius_mm)],
        stdout=subprocess.PIPE,
        check=True,
        env=os.environ | {"PALPATE_CACHE": str(cache), "OPENBLAS_NUM_THREADS": "1"},
    )
    found: dict[str, float] = json.loads(done.stdout)
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="What preparing a catalogue costs.")
    parser.add_argument("--start", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--most", type=int, default=2000, help="outlines in the largest catalogue")
    given = parser.parse_args()
    if given.start:
        measured(*given.start)
        return
    rng = np.random.default_rng(1)
    models = [jagged(rng, f"outline {number}") for number in range(given.most + 1)]
    print(
        "outlines   r   first start             second start            +1 outline     kept\n"
        "          mm    cpu s  clock s    MB     cpu s  clock s    MB    cpu s  clock s    MB"
    )
    with TemporaryDirectory() as folder:
        for radius_mm in (0.0, 5.0):
            for count in (125, 250, 500, 1000, 2000):
                if count > given.most:
                    continue
                cache = Path(folder, f"cache-{count}-{radius_mm:g}")
                path, other = Path(folder, f"{count}.json"), Path(folder, f"{count}-other.json")
                palpate.save(ObjectsFile(tuple(models[:count])), path)
                palpate.save(ObjectsFile((*models[: count - 1], models[-1])), other)
                first, second = start(path, radius_mm, cache), start(path, radius_mm, cache)
                kept_mb = sum(item.stat().st_size for item in cache.iterdir()) / 1e6
                changed = start(other, radius_mm, cache)
                text = f"{count:>8} {radius_mm:>3g} "
                for row in (first, second):
                    text += f"  {row['cpu_s']:>6.2f} {row['wall_s']:>8.2f} {row['mb']:>5.0f} "
                text += f" {changed['cpu_s']:>6.2f} {changed['wall_s']:>8.2f} {kept_mb:>5.0f}"
                print(text, flush=True)


if __name__ == "__main__":
    main()
