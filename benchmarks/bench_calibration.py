"""Calibrations of emulated rigs with hidden truth, and identifications before and after.

    python benchmarks/bench_calibration.py --seeds 50 --out calibrations.jsonl
    python benchmarks/bench_calibration.py --tell calibrations.jsonl

With `--records DIR`, what every rig measured is kept; another run with the same directory fits it again.
With `--simulated`, calibration measures geometry, tips and taxels of the same rigs without servos, ports and
time between: twenty times faster. Parts are identified on the emulated bench in either case.

With `--load`, tips stick (friction 0 to 0.6), aims give way to forces across the slide by up to 0.05 mm/N and
forces of 0 to 0.5 N take up their play, all drawn per seed and declared; `--simulated` has it, too. Joints
of arms give way to forces by up to 0.05 mm/N, likewise; their tips do not stick.

Every seed is a rig as `examples/fresh-rig.toml` describes it (with `--rig arms`, `examples/fresh-arms.toml`;
with `--rig stage`, `examples/fresh-stage.toml`), with other hidden errors. Each is calibrated as
`palpate calibrate` does it, and its values are compared with the truth; then parts of the shipped catalogue
are put on it and identified, with the rig file alone and with the calibration. A line of JSON a seed is
appended, so that a campaign can be stopped and taken up.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # rigs run side by side

import argparse
import json
import math
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2, kstest

from palpate.base.errors import PalpateError
from palpate.base.vocabulary import Strategy
from palpate.calibration.consistency_checks import contact_uncertainties
from palpate.calibration.frame_alignment import BasePose, align_to_nominal, nominal_poses
from palpate.calibration.measurements import RunRecord
from palpate.config import (
    ArmFingerConfig,
    CalibrationFile,
    RigFile,
    apply_calibration,
    load_objects,
    load_rig,
    shipped_objects,
)
from palpate.config.calibration_file import ReferencesFile, load_references
from palpate.config.calibration_finger import Actuators, ActuatorsCalibration, ArmPlaceCalibration
from palpate.drivers.emulators.mechanics import ArmTruth, FingerTruth
from palpate.recognizer import Catalogue
from palpate.rig.bench import BenchRig, emulated_table, environment, set_up
from palpate.rig.commissioning.calibration_run import (
    STEPS,
    CalibrationJob,
    RunRecordFile,
    build_references,
    calibrate,
    rig_connector,
)
from palpate.rig.diagnostics.calibration_check import retouch
from palpate.rig.emulated.ground_truth import built_pose, in_hand_frame
from palpate.rig.emulated.scene import draw_placement
from palpate.rig.identification.accuracy import check_accuracy
from palpate.rig.identification.result import IdentificationJob
from palpate.rig.session.run import run_identification

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.benches.simulated_rig import SimulatedRig

_ROOT = Path(__file__).parents[1]
_SHIPPED = _ROOT / "src" / "palpate" / "config" / "references"
RIGS = {
    "slides": (_ROOT / "examples" / "fresh-rig.toml", _SHIPPED / "standard.toml"),
    "arms": (_ROOT / "examples" / "fresh-arms.toml", _SHIPPED / "low.toml"),
    "stage": (_ROOT / "examples" / "fresh-stage.toml", _SHIPPED / "standard.toml"),
}
"""Rigs that nothing has been measured of, and the references that suit them."""
LOADED = 0.15  # taxels whose gain is known better than this have been pressed well


def rig_of(kind: str, load: bool) -> RigFile:
    """A fresh rig, with forces that act on fingers or without."""
    rig = load_rig(RIGS[kind][0])
    if not load:
        return rig
    if kind == "stage":
        raise SystemExit("--load is for slides and arms")
    data = rig.model_dump(mode="json", exclude_unset=True)
    if kind == "arms":
        data["emulation"]["deflection_mm_per_n"] = 0.05
        for finger in data["fingers"]:
            finger["bounds"] |= {"deflection_mm_per_n": 0.05, "deflection_deg_per_n": 0.02}
        return RigFile.model_validate(data)
    data["emulation"] |= {
        "deflection_mm_per_n": 0.05,
        "play_holds_n": [0.0, 0.5],
        "part": {"engine": "still", "tip_friction": [0.0, 0.6]},
    }
    for finger in data["fingers"]:
        finger["tip"]["max_friction"] = 0.6
        finger["aim"]["backlash_holds_n"] = 0.0
        finger["bounds"] |= {"deflection_mm_per_n": 0.05, "deflection_deg_per_n": 0.015}
    return RigFile.model_validate(data)


class Nothing:
    """Keeps no record."""

    def load(self) -> RunRecord | None:
        return None

    def save(self, record: RunRecord) -> None:
        del record


def one(
    seed: int, scenes: int, before: int, simulated: bool, records: Path | None, load: bool, kind: str
) -> dict[str, object]:
    """Calibrate one rig and identify parts on it; everything that is worth keeping."""
    rig, references = rig_of(kind, load), load_references(RIGS[kind][1])
    bench = set_up(rig, (), seed)
    table = emulated_table(bench, seed)
    assert table is not None
    job = CalibrationJob(rig, "0" * 64, references, STEPS, 0.999, datetime.now(UTC), None)
    begin = time.perf_counter()
    world = SimulatedRig(rig, seed)
    connect = world.connect if simulated else rig_connector(environment(bench), table, print)
    keeper = Nothing() if records is None else RunRecordFile(records / f"{seed}.json")
    try:
        file = calibrate(job, connect, keeper, lambda _: None)
    except PalpateError as error:
        return {"seed": seed, "failed": str(error)}
    row: dict[str, object] = {
        "seed": seed,
        "wall_s": time.perf_counter() - begin,
        "rig_s": bench.clock.now(),
        "fingers": compared(bench, file),
        "stage": compared_stage(bench, file),
    }
    assert file.residuals is not None
    row["residuals"] = file.residuals.model_dump(mode="json", exclude={"touches_seen"})
    row["after"] = [identified(rig, seed, k, file) for k in range(scenes)]
    row["retouched"] = retouched(rig, references, seed, file) if scenes else None
    row["before"] = [identified(rig, seed, k, None) for k in range(before)]
    return row


def identified(rig: RigFile, seed: int, scene: int, file: CalibrationFile | None) -> dict[str, object]:
    """Identify one part on the rig of a seed."""
    objects = load_objects(shipped_objects())
    assert rig.emulation is not None
    lying = draw_placement(
        objects, rig.emulation.placement_radius_mm, np.random.default_rng([seed, 0, scene])
    )
    bench = set_up(rig, [lying], seed)
    used, seen = rig, lying
    if file is not None:
        assert bench.mock is not None
        used = apply_calibration(rig, file)
        seen = in_hand_frame(lying, rig, [finger.truth for finger in bench.mock.rig.bench.fingers])
    begin = time.perf_counter()
    try:
        check_accuracy(used, rig.name)
        job = IdentificationJob(
            used, Catalogue(objects.objects), (seen,), Strategy.PLANNED, seed, file, datetime.now(UTC)
        )
        out = run_identification(job, environment(bench)).out(wall_seconds=0.0, session=None)
    except PalpateError as error:
        return {"part": lying.model.name, "verdict": "refused", "why": str(error)}
    truth = out.truth
    return {
        "part": lying.model.name,
        "verdict": out.verdict.value,
        "named": bool(truth and truth.named),
        "inside": bool(truth and truth.inside_bounds),
        "position_error_mm": None if truth is None else truth.position_error_mm,
        "grips": out.grips,
        "drifted": out.calibration.drifted if out.calibration else None,
        "rms_mm": out.calibration.residual_rms_mm if out.calibration else None,
        "expected_rms_mm": out.calibration.expected_rms_mm if out.calibration else None,
        "wall_s": time.perf_counter() - begin,
    }


def retouched(
    drawn: RigFile, references: ReferencesFile, seed: int, file: CalibrationFile
) -> dict[str, object]:
    """Whether a re-touch of the rig, which has not changed, agrees with its calibration."""
    rig, bench = apply_calibration(drawn, file), set_up(drawn, (), seed)
    table = emulated_table(bench, seed + 1)
    uncertainties = contact_uncertainties(file, at_rest=False)
    assert table is not None
    assert uncertainties is not None
    disc = build_references(references)[0]
    with rig_connector(environment(bench), table, print)(rig, moving=True) as there:
        found = retouch(rig, there.prober, disc, uncertainties).agreement
    return {
        "drifted": found.drifted,
        "rms_mm": found.rms_mm,
        "expected_rms_mm": found.expected_rms_mm,
    }


def compared(bench: BenchRig, file: CalibrationFile) -> list[dict[str, object]]:
    """What was found of each finger less the truth, with what it says of its own errors."""
    assert bench.mock is not None
    fingers = bench.mock.rig.bench.fingers
    drawn = [BasePose(spec.base_mm, math.radians(spec.heading_deg)) for spec in bench.rig.fingers]
    built = [built_pose(spec, item.truth) for spec, item in zip(bench.rig.fingers, fingers, strict=True)]
    frame = align_to_nominal(drawn, built)
    rows = []
    for spec, pose, item, found in zip(bench.rig.fingers, built, fingers, file.fingers, strict=True):
        truth, place, tactile = item.truth, found.place, found.tactile
        assert place is not None
        assert tactile is not None
        assert found.actuators is not None
        assert found.bounds is not None
        there = frame.place(pose)
        off = np.array(
            [
                place.base_mm[0] - there.base_mm[0],
                place.base_mm[1] - there.base_mm[1],
                math.remainder(math.radians(place.heading_deg) - there.heading_rad, 2 * math.pi),
                place.tip_radius_mm - truth.tip_radius_mm,
            ]
        )
        if isinstance(place, ArmPlaceCalibration):
            assert isinstance(spec, ArmFingerConfig)
            assert isinstance(truth, ArmTruth)
            zero_rad = math.radians(spec.elbow.zero_deg) - math.pi
            bent = (zero_rad - truth.elbow.zero_rad) / truth.elbow.gear_ratio
            links = [place.upper_mm - truth.upper_mm, place.fore_mm - truth.fore_mm]
            off = np.array([*off, *links, math.radians(place.elbow_zero_deg) - bent])
        covariance = np.array(place.covariance)[: len(off), : len(off)]
        gain, bound = np.array(tactile.gain), np.array(tactile.gain_bound)
        wrong = np.abs(item.array.taxels.gain / gain - 1)  # the bench's own truth
        dead = {tuple(place) for place in item.array.taxels.dead}
        for row, col in dead:
            wrong[row, col] = 0.0
        rows.append(
            {
                "off": off.tolist(),
                "square": float(off @ np.linalg.solve(covariance, off)),
                "sigma": np.sqrt(np.diag(covariance)).tolist(),
                "phase_deg": place.array_heading_deg - math.degrees(truth.array_heading_rad),
                "phase_sigma_deg": place.array_heading_sigma_deg,
                "gain_off": float(wrong[bound < LOADED].max()),
                "gain_loaded": int((bound < LOADED).sum()),
                "gain_broken": int((wrong > bound).sum()),
                "gain_off_5": float(wrong[bound < 0.05].max(initial=0.0)),
                "gain_count_5": int((bound < 0.05).sum()),
                "gain_over_5": int((wrong[bound < LOADED] > 0.05).sum()),
                "stiffness_off": tactile.stiffness_n_per_mm / truth.stiffness_n_per_mm - 1,
                "dead": dead == {(taxel.row, taxel.col) for taxel in tactile.unusable},
                **_mechanics(found.actuators, truth),
                "position_mm": found.bounds.position_mm,
                "direction_deg": found.bounds.direction_deg,
                "parts_mm": found.bounds.parts_mm.model_dump(),
                "hardest_n": item.hardest_n,
            }
        )
    return rows


def compared_stage(bench: BenchRig, file: CalibrationFile) -> dict[str, object] | None:
    """What was found of the stage less the truth, in the hand frame; None without one."""
    assert bench.mock is not None
    emulated, found = bench.mock.rig.bench, file.stage
    if emulated.stage is None or found is None:
        return None
    built = [
        built_pose(spec, item.truth) for spec, item in zip(bench.rig.fingers, emulated.fingers, strict=True)
    ]
    frame = align_to_nominal(nominal_poses(bench.rig.fingers), built)
    off = np.array(found.centre_mm) - frame.point_mm(emulated.stage.centre_mm)
    play_deg = math.degrees(emulated.stage.truth.play_rad)
    return {
        "off_mm": off.tolist(),
        "square": float(off @ np.linalg.solve(np.array(found.covariance), off)),
        "bound_mm": found.centre_bound_mm,
        "play_off_deg": found.backlash_deg - play_deg,
        "play_sigma_deg": found.backlash_sigma_deg,
        "play_deg": play_deg,
        "rms_mm": found.rms_mm,
        "outliers": found.outliers,
    }


def tell_stages(rows: list[dict[str, Any]]) -> None:
    """The figures of the stages of a campaign."""
    stages = [row["stage"] for row in rows if row.get("stage")]
    if not stages:
        return
    away = np.array([math.hypot(*item["off_mm"]) for item in stages])
    bound = np.array([item["bound_mm"] for item in stages])
    play = np.array([item["play_off_deg"] for item in stages])
    sigma = np.array([item["play_sigma_deg"] for item in stages])
    squares = np.array([item["square"] for item in stages]) + (play / sigma) ** 2
    print(
        f"stage's axis: off by {np.median(away):.4f} mm in the median, {away.max():.4f} at most; bounds "
        f"{np.median(bound):.4f} in the median, {bound.max():.4f} at most, {(away > bound).sum()} broken"
    )
    off = np.abs(play)
    print(
        f"stage's play: off by {np.median(off):.4f} deg in the median, {off.max():.4f} at most; "
        f"{(play < -3.3 * sigma).sum()} larger than the bound; {sum(item['outliers'] for item in stages)} "
        "outliers"
    )
    total, free = squares.sum(), 3 * len(stages)
    print(
        f"normalised errors of axis and play: mean square {total / free:.2f} ({total:.0f} for {free}: "
        f"p {chi2.sf(total, free):.3f} too large, {chi2.cdf(total, free):.3f} too small)"
    )


def _mechanics(found: Actuators, truth: FingerTruth | ArmTruth) -> dict[str, float]:
    """Play and travel of a slide, plays of an arm's joints, less the truth."""
    if isinstance(found, ActuatorsCalibration):
        assert isinstance(truth, FingerTruth)
        return {
            "play_off_mm": found.slide.backlash_mm - truth.slide_play_mm,
            "play_sigma_mm": found.slide.backlash_sigma_mm,
            "scale_off": found.slide.mm_per_turn / (truth.mm_per_rad * 2 * math.pi) - 1,
        }
    assert isinstance(truth, ArmTruth)
    pairs = ((found.shoulder, truth.shoulder), (found.elbow, truth.elbow))
    return {
        "play_off_deg": max(abs(own.backlash_deg - math.degrees(real.play_rad)) for own, real in pairs),
        "play_sigma_deg": max(own.backlash_sigma_deg for own, _ in pairs),
    }


def tell(path: Path) -> None:
    """The figures of a campaign."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    failed = [row for row in rows if "failed" in row]
    rows = [row for row in rows if "failed" not in row]
    for row in failed:
        print(f"seed {row['seed']} failed: {row['failed']}")
    fingers = [finger for row in rows for finger in row["fingers"]]
    off = np.abs(np.array([finger["off"] for finger in fingers]))
    print(f"{len(rows)} rigs, {len(fingers)} fingers, {np.mean([row['wall_s'] for row in rows]):.0f} s each")
    base = np.hypot(off[:, 0], off[:, 1])
    for name, values, unit in (
        ("base", base, "mm"),
        ("heading", np.degrees(off[:, 2]), "deg"),
        ("tip radius", off[:, 3], "mm"),
        ("array heading", np.abs([finger["phase_deg"] for finger in fingers]), "deg"),
        ("gain (loaded)", np.array([finger["gain_off"] for finger in fingers]), ""),
        ("stiffness", np.abs([finger["stiffness_off"] for finger in fingers]), ""),
        ("links", off[:, 4:6].ravel(), "mm"),
        ("elbow's zero", np.degrees(off[:, 6:]).ravel(), "deg"),
        *(
            (name, np.abs([finger[key] for finger in fingers if key in finger]), unit)
            for name, key, unit in (
                ("play", "play_off_mm", "mm"),
                ("play of joints", "play_off_deg", "deg"),
                ("mm per turn", "scale_off", ""),
            )
        ),
    ):
        if not len(values):
            continue
        print(f"{name:14s} median {np.median(values):.4f}  largest {np.max(values):.4f} {unit}")
    squares, free = np.array([finger["square"] for finger in fingers]), off.shape[1]
    print(
        f"normalised errors: mean square {squares.mean() / free:.2f}, sum {squares.sum():.0f} for "
        f"{free * len(squares)}, p {chi2.sf(squares.sum(), free * len(squares)):.3f} (too large), "
        f"{chi2.cdf(squares.sum(), free * len(squares)):.3f} (too small); "
        f"Kolmogorov-Smirnov p {kstest(squares, chi2(free).cdf).pvalue:.3f}; largest {squares.max():.1f}"
    )
    print(f"dead taxels found: {sum(finger['dead'] for finger in fingers)} of {len(fingers)} fingers")
    tell_stages(rows)
    print(f"gain bounds broken: {sum(finger['gain_broken'] for finger in fingers)}")
    print(
        f"position bounds: median {np.median([finger['position_mm'] for finger in fingers]):.3f} mm, largest "
        f"{max(finger['position_mm'] for finger in fingers):.3f}; hardest press "
        f"{max(finger['hardest_n'] for finger in fingers):.2f} N"
    )
    for when in ("before", "after"):
        runs = [run for row in rows for run in row[when]]
        if not runs:
            continue
        right = [run for run in runs if run["verdict"] == "identified" and run["named"] and run["inside"]]
        wrong = [
            run for run in runs if run["verdict"] == "identified" and not (run["named"] and run["inside"])
        ]
        verdicts = {
            key: sum(run["verdict"] == key for run in runs) for key in {run["verdict"] for run in runs}
        }
        print(
            f"{when}: {len(right)} of {len(runs)} identified rightly inside bounds, {len(wrong)} wrongly; "
            f"{verdicts}; said to have changed: {sum(bool(run.get('drifted')) for run in runs)}"
        )
    touched = [row["retouched"] for row in rows if row.get("retouched")]
    if touched:
        rms = [found["rms_mm"] / found["expected_rms_mm"] for found in touched]
        print(
            f"touched again: {sum(found['drifted'] for found in touched)} of {len(touched)} said to have "
            f"changed; residuals in the median {np.median(rms):.2f} of what is expected"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=2, help="identifications after calibration")
    parser.add_argument("--before", type=int, default=1, help="and before")
    parser.add_argument("--simulated", action="store_true")
    parser.add_argument("--rig", choices=RIGS, default="slides")
    parser.add_argument("--load", action="store_true", help="forces bend, shear and take up play")
    parser.add_argument("--records", type=Path, help="directory for what rigs measured")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("calibrations.jsonl"))
    parser.add_argument("--tell", type=Path)
    args = parser.parse_args()
    if args.tell:
        tell(args.tell)
        return
    if args.records:
        args.records.mkdir(exist_ok=True)
    done = set()
    if args.out.exists():
        done = {json.loads(line)["seed"] for line in args.out.read_text().splitlines()}
    rest = args.records, args.load, args.rig
    with ProcessPoolExecutor(args.jobs) as pool, args.out.open("a") as out:
        wanted = [seed for seed in range(args.first, args.first + args.seeds) if seed not in done]
        for future in as_completed(
            [pool.submit(one, seed, args.scenes, args.before, args.simulated, *rest) for seed in wanted]
        ):
            out.write(json.dumps(future.result()) + "\n")
            out.flush()
    tell(args.out)


if __name__ == "__main__":
    main()
