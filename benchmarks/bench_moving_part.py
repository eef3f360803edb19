"""Identifications of parts that slide when touched, in MuJoCo, with everything about them hidden.

    python benchmarks/bench_moving_part.py --runs 100 --out FOLDER                 # the shipped parts
    python benchmarks/bench_moving_part.py --runs 200 --objects FILE --out FOLDER  # others
    … --declare none | true | double      # what [search] part_holds_n says; true: of the real one a share
    … --rig FILE                          # another emulated rig
    python benchmarks/judge_motion.py FOLDER/*                                     # the judge of it

Drawn per seed: mass 50 g to 1 kg (log-uniform), friction on the table 0.15 to 0.5, at the tips 0 to 0.6, on 3
to 12 feet. Declared are 0.5 to 1 of the force that makes it slide and of its support's radius. Prints how the
runs ended by slip force; parts that are too narrow to stand on feet are left out. A run whose folder exists
is not repeated, so that a campaign can be taken up.
"""

import argparse
import json
import math
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.base.vocabulary import Strategy
from palpate.config import ObjectsFile, RigFile, load_objects, load_rig, shipped_objects
from palpate.config.emulation import EmulatedPartConfig
from palpate.drivers.emulators.bench import Bench
from palpate.drivers.emulators.part import FrictionSupport
from palpate.recognizer import Catalogue
from palpate.rig.bench import BenchRig, choose_placements, connect, set_up
from palpate.rig.emulated.hidden_truth import draw_parts, support_of
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.events import Event, Observers, StageEvent
from palpate.rig.identification.identify import identify
from palpate.rig.identification.outcome import Identification
from palpate.rig.identification.result import IdentificationJob, IdentificationRun
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.views.recognition import contacts_json

_NOISE_N = 0.05
SHIPPED = Path(__file__).parent.parent / "src" / "palpate" / "config" / "rigs" / "bench.toml"

Engine = Literal["mujoco", "quasi-static"]


@dataclass(frozen=True)
class Job:
    """One run."""

    seed: int
    rig: Path
    objects: Path
    out: Path
    declare: str
    engine: Engine


class Hidden:
    """The truth at each measurement, taken as fingers begin to leave."""

    def __init__(self, bench: Bench, placement: Placement, names: list[str]) -> None:
        self._bench, self._placement, self._names = bench, placement, names
        self.poses: list[list[float]] = []
        self.peaks: dict[str, float] = {}

    def __call__(self, event: Event) -> None:
        if isinstance(event, StageEvent):
            if event.stage is GripPhase.CLOSING:
                for finger in self._bench.fingers:
                    finger.weighs_taxels, finger.hardest_on_taxels_n = True, 0.0
            if event.stage is GripPhase.RETRACTING:
                self.poses.append(self.pose())
                for name, finger in zip(self._names, self._bench.fingers, strict=True):
                    self.peaks[f"{event.grip} {name}"] = finger.hardest_on_taxels_n

    def pose(self) -> list[float]:
        """Where the part is now: x, y (mm), θ (rad)."""
        moved = self._bench.parts.displacements[0]
        x, y = moved.place(np.array([self._placement.x_mm, self._placement.y_mm])).tolist()
        return [x, y, self._placement.theta_rad + moved.turn_rad]


def drawn(job: Job, rig: RigFile) -> tuple[RigFile, np.random.Generator]:
    """The rig with a part as the seed draws it."""
    rng = np.random.default_rng([job.seed, 77])
    assert rig.emulation is not None
    part = EmulatedPartConfig(
        engine=job.engine,
        mass_kg=0.05 * 20 ** rng.uniform(),
        friction=rng.uniform(0.15, 0.5),
        tip_friction=rng.uniform(0.0, 0.6),
        feet=int(rng.integers(3, 13)),
    )
    return rig.model_copy(update={"emulation": rig.emulation.model_copy(update={"part": part})}), rng


def declared(job: Job, rig: RigFile, support: FrictionSupport, rng: np.random.Generator) -> RigFile:
    """The rig file with what its user would say of the part."""
    shares = rng.uniform(0.5, 1.0, 2)
    holds = support.slip_n * (2.0 if job.declare == "double" else shares[0])
    said = {"part_holds_n": holds, "part_support_mm": support.median_distance_mm * shares[1]}
    if job.declare == "none":
        said = dict.fromkeys(said)
    return rig.model_copy(update={"search": rig.search.model_copy(update=said)})


def run(job: Job) -> None:
    """Carry out one run and write what came of it, and the truth beside it."""
    folder = job.out / f"seed-{job.seed}"
    if (folder / "hidden.json").exists() or (folder / "skipped.txt").exists():
        return
    begin = time.perf_counter()
    objects = load_objects(job.objects)
    rig, rng = drawn(job, load_rig(job.rig))
    (placement,) = choose_placements(rig, objects, None, job.seed)
    assert rig.emulation is not None
    (truth,) = draw_parts(rig.emulation.part, [placement], job.seed)
    try:
        support = support_of(truth, placement)
    except InputError as error:  # too narrow to stand on feet: no run
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "skipped.txt").write_text(str(error))
        return
    bench = set_up(rig, [placement], job.seed)
    assert bench.emulated is not None
    hidden = Hidden(bench.emulated.bench, placement, [finger.name for finger in rig.fingers])
    said = declared(job, rig, support, rng)
    result, error = _identified(replace(bench, rig=said), objects, job, hidden)
    folder.mkdir(parents=True, exist_ok=True)
    state = next(s for s in Catalogue([placement.model]).states if s.state.name == placement.state.name)
    facts = {
        "object": placement.model.name,
        "state": placement.state.name,
        "symmetry_order": state.symmetry_order,
        "centroid": state.origin_mm.tolist(),
        "centre_of_friction": _in_object(placement, support.centre_mm),
        "at_measurement": hidden.poses,
        "final": hidden.pose(),
        "peaks_n": hidden.peaks,
        "gain_spread": rig.emulation.gain_spread,
        "noise_n": _NOISE_N,
        "slip_n": support.slip_n,
        "declared_n": said.search.part_holds_n,
        "mass_kg": support.mass_kg,
        "friction": support.friction,
        "error": error,
        "seconds": time.perf_counter() - begin,
        "rig_s": bench.clock.now(),
    }
    if result is not None:
        begun = IdentificationJob(said, Catalogue(objects.objects), (placement,), Strategy.PLANNED, job.seed)
        ended = IdentificationRun(begun, result, True, bench.clock.now(), None, None, None)
        out = ended.out(wall_seconds=time.perf_counter() - begin, session=None)
        (folder / "result.json").write_text(out.model_dump_json())
        contacts = contacts_json([[touch.contact for touch in grip] for grip in result.grips])
        (folder / "contacts.json").write_text(json.dumps(contacts))
    heights = {finger.height_mm for finger in rig.fingers}
    rings = {
        f"{height:g}": [ring.tolist() for part in placement.state.sections_at(height) for ring in part.rings]
        for height in heights
    }
    (folder / "outline.json").write_text(json.dumps(rings))
    (folder / "hidden.json").write_text(json.dumps(facts))


def _identified(
    bench: BenchRig, objects: ObjectsFile, job: Job, hidden: Hidden
) -> tuple[Identification | None, str | None]:
    try:
        with connect(bench) as hand:
            hand.prepare()
            observers = Observers(record=hidden)
            return identify(hand, Catalogue(objects.objects), observers, seed=job.seed), None
    except Exception as error:  # counted as a run that failed
        return None, f"{type(error).__name__}: {error}"


def _in_object(placement: Placement, point_mm: Floats) -> list[float]:
    """A point (2,) of W, as the part was put, in the object frame."""
    x, y = point_mm - [placement.x_mm, placement.y_mm]
    c, s = math.cos(placement.theta_rad), math.sin(placement.theta_rad)
    return [c * x + s * y, c * y - s * x]


def table(folders: list[Path]) -> None:
    """How runs ended, by slip force."""
    rows = []
    for folder in folders:
        if (folder / "skipped.txt").exists():
            continue
        hidden = json.loads((folder / "hidden.json").read_text())
        path = folder / "result.json"
        rows.append((hidden, json.loads(path.read_text()) if path.exists() else None))
    print("slip force   runs identified indist. moving unknown unresolved failed  touches  rig s  wall s")
    for lo, hi in ((0.0, 0.15), (0.15, 0.3), (0.3, 0.6), (0.6, 1.5), (1.5, 99.0)):
        some = [(h, r) for h, r in rows if lo <= h["slip_n"] < hi]
        if not some:
            continue
        ended = [r["verdict"] if r else "failed" for _, r in some]
        count = [
            ended.count(word)
            for word in ("identified", "indistinguishable", "moving", "unknown", "unresolved", "failed")
        ]
        touches = [r["touches"] for _, r in some if r]
        print(
            f"{lo:4.2f}-{hi:5.2f} N {len(some):5} "
            + " ".join(f"{n:8}" for n in count)
            + f" {np.median(touches or [0]):8.1f} {np.median([h['rig_s'] for h, _ in some]):6.0f}"
            + f" {np.median([h['seconds'] for h, _ in some]):6.0f}"
        )


def main() -> int:
    """Run the campaign and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--objects", type=Path, default=Path(shipped_objects()))
    parser.add_argument("--rig", type=Path, default=SHIPPED)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--declare", choices=["none", "true", "double"], default="true")
    parser.add_argument("--engine", choices=["mujoco", "quasi-static"], default="mujoco")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    jobs = [
        Job(seed, asked.rig, asked.objects, asked.out, asked.declare, asked.engine)
        for seed in range(asked.first, asked.first + asked.runs)
    ]
    with ProcessPoolExecutor(asked.processes) as pool:
        list(pool.map(run, jobs))
    table([asked.out / f"seed-{job.seed}" for job in jobs])
    return 0


if __name__ == "__main__":
    sys.exit(main())
