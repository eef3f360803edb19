"""An identification with its session: the main job, from a rig and a catalogue to an answer."""

import hashlib
import json
import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Self

import numpy as np

from palpate.base.errors import PalpateError
from palpate.base.file_io import write_text
from palpate.base.vocabulary import Strategy
from palpate.config import ObjectsFile, RigOnBench, Scene
from palpate.config.fields import to_json
from palpate.config.recognition_results import UnknownStateOut
from palpate.config.writers import file_text
from palpate.jobs.files import select_known
from palpate.jobs.recognition import Answer
from palpate.rig.bench import BenchRig, choose_placements, draw_table, environment, set_up
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.catalogue.reachability import finding_lines
from palpate.rig.contact_peak import bus_latency_s
from palpate.rig.conversion import contacts_json, finger_of
from palpate.rig.emulated.ground_truth import placements_in_hand_frame, scene_lines
from palpate.rig.emulated.scene import Placement
from palpate.rig.emulated.table import scene_of
from palpate.rig.identification.accuracy import check_accuracy
from palpate.rig.identification.events import Observer
from palpate.rig.identification.part_count import ONE_PART, PartCount, check_parts
from palpate.rig.identification.result import IdentificationJob, IdentificationRun, WiringProof
from palpate.rig.identification.rig_recognition import GripStrategy, name_strategy
from palpate.rig.session.archive import discard_session
from palpate.rig.session.log import SessionLog, session_folder
from palpate.rig.session.recorded_session import confirmed_of, keep_inputs
from palpate.rig.session.run import TRUTH_EVENT, run_identification
from palpate.rig.session.signals import HeldInterrupts


@dataclass(frozen=True)
class Callbacks:
    """Functions that a run calls; `Rig.identify` says when, and with what."""

    on_event: Observer | None
    on_session: Callable[[Path], None]
    notice: Callable[[str], None]
    warn: Callable[[str], None]
    progress: Callable[[str], None]

    @property
    def observers(self) -> list[Observer]:
        """Observers of the run's events."""
        return [] if self.on_event is None else [self.on_event]


@dataclass(frozen=True)
class IdentificationRequest:
    """Request for an identification; `name`: of the objects, in messages.

    `run`: number of the run on this rig, from 0; later ones draw other parts for an emulated table.
    `unconfirmed`: the wiring need not have been proven. `left_out`: states that `objects` had, and that are
    not known at the fingers' heights.
    """

    on_bench: RigOnBench
    objects: ObjectsFile
    name: str
    scene: Scene | None
    seed: int
    run: int
    strategy: Strategy | GripStrategy
    unconfirmed: bool
    parts: PartCount = ONE_PART
    left_out: tuple[UnknownStateOut, ...] = ()

    @property
    def proof(self) -> WiringProof | None:
        """Proof of the wiring that the run asks for."""
        path = self.on_bench.path
        if self.unconfirmed or self.on_bench.rig.emulated or not isinstance(path, Path):
            return None
        command = f"palpate check --press --move --rig {shlex.quote(str(path))}"
        return WiringProof(self.on_bench.described, confirmed_of(path), command)

    def session_name(self) -> str:
        """After everything that decides an emulated session, so that it is the same again; else the time."""
        if not self.on_bench.rig.emulated:
            return datetime.now(UTC).strftime("identify-%Y%m%d-%H%M%S")
        content = hashlib.sha256(version("palpate").encode())
        if self.on_bench.is_changed:
            content.update(file_text(self.on_bench.described).encode())
        for path in (self.on_bench.path, self.on_bench.calibration_path):
            content.update(b"" if path is None else path.read_bytes())
        content.update(file_text(self.objects).encode())
        content.update(b"" if self.scene is None else file_text(self.scene).encode())
        content.update(name_strategy(self.strategy).encode())
        content.update(b"" if self.parts.is_single else str(self.parts).encode())
        return f"identify-seed-{self.seed}-{content.hexdigest()[:8]}"

    def with_parts(self) -> tuple[Self, tuple[Placement, ...]]:
        """The request with the scene that a later run on an emulated table draws, and what lies there."""
        described = self.on_bench.described
        placements = choose_placements(described, self.objects, self.scene, self.seed, self.parts)
        if not self.run or self.scene is not None or described.emulation is None:
            return self, placements
        rng = np.random.default_rng([self.seed, 0, self.run])
        placements = draw_table(described, self.objects, rng, self.parts)
        return replace(self, scene=scene_of(placements)), placements


@dataclass(frozen=True)
class _PreparedRun:
    """A run that is about to begin, `begin_s` on the computer's clock; `lie`: the parts on the table now."""

    request: IdentificationRequest
    job: IdentificationJob
    bench: BenchRig
    lie: Callable[[], tuple[Placement, ...]]
    begin_s: float

    def answer(self, run: IdentificationRun, session: Path | None) -> Answer:
        """The answer of the run, which has ended now."""
        seconds = time.perf_counter() - self.begin_s
        out = run.out(wall_seconds=seconds, session=None if session is None else str(session))
        out = out.model_copy(update={"left_out": self.request.left_out})
        return Answer(out, run, self.request.objects, run.late_failure)


def identify_on(request: IdentificationRequest, sessions: Path | None, calls: Callbacks) -> Answer:
    """Identify, with a session log in a folder below `sessions`; errors as `Rig.identify`."""
    begin, on_bench = time.perf_counter(), request.on_bench
    on_bench.rig.require("identify")
    check_accuracy(on_bench.rig, str(on_bench.path))
    check_parts(on_bench.rig, request.parts, request.strategy)
    objects, left_out = select_known(request.objects, on_bench.rig.fingers, request.name, calls.warn)
    request, placements = replace(request, objects=objects, left_out=left_out).with_parts()
    for line in finding_lines(on_bench.rig, request.objects.objects, request.name):
        calls.warn(line)
    for line in () if request.scene is None else scene_lines(on_bench.described, placements):
        calls.warn(line)
    # Before there are ports, which processes that prepare it would inherit.
    catalogue = prepare_catalogue(
        request.objects.objects, map(finger_of, on_bench.rig.fingers), calls.progress
    )
    bench = set_up(on_bench.described, placements, request.seed)
    lie_now = partial(placements_in_hand_frame, on_bench, placements, request.seed, bench.emulated)
    job = IdentificationJob(
        on_bench.rig,
        catalogue,
        lie_now(),
        request.strategy,
        request.seed,
        on_bench.calibration,
        datetime.now(UTC).replace(microsecond=0),
        request.proof,
        request.parts,
    )
    prepared = _PreparedRun(request, job, bench, lie_now, begin)
    if sessions is not None:
        return _identify_with_log(prepared, sessions, calls)
    run = run_identification(job, environment(bench), None, calls.observers, calls.notice, lie_now)
    return prepared.answer(run, None)


def _identify_with_log(prepared: _PreparedRun, sessions: Path, calls: Callbacks) -> Answer:
    """Identify with a session log. An answer that could not be written down is still an answer."""
    request, job, bench = prepared.request, prepared.job, prepared.bench
    folder = session_folder(sessions, request.session_name())
    latency_s = bus_latency_s(job.rig)
    answer: Answer | None = None
    log: SessionLog | None = None
    try:
        with SessionLog(folder, bench.clock, _header(request, job, latency_s)) as log:
            keep_inputs(folder, request.on_bench, request.objects, request.scene)
            calls.on_session(folder)
            with HeldInterrupts() as held:
                there = environment(bench, log, latency_s, held.check)
                run = run_identification(job, there, log, calls.observers, calls.notice, prepared.lie)
            if run.truth is not None:
                parts = () if bench.emulated is None else bench.emulated.parts
                log.event(TRUTH_EVENT, **run.truth.values(parts))
            answer = prepared.answer(run, folder)
            log.event("result", result=answer.result.model_dump(mode="json"))
        _write_results(answer, folder)
    except PalpateError as error:
        if answer is None:
            raise
        answer = replace(answer, failure=error)
    finally:
        if log is None or not log.has_traffic:
            discard_session(folder, is_ours=log is not None)
    return answer


def _header(request: IdentificationRequest, job: IdentificationJob, latency_s: float) -> dict[str, object]:
    assert job.started is not None, "set by identify_on"
    return {
        "palpate": version("palpate"),
        "rig": job.rig.name,
        "seed": request.seed,
        "strategy": name_strategy(request.strategy),
        "scene": request.scene is not None,
        "calibration": job.calibration is not None,
        "emulated": job.rig.emulation is not None,
        "started": job.started.isoformat(),
        "bus_latency_s": latency_s,
        "proof": None if job.proof is None else job.proof.command,
    } | ({} if job.parts.is_single else {"parts": str(job.parts)})


def _write_results(answer: Answer, folder: Path) -> None:
    """Write picture, answer and contacts into the session's folder."""
    write_text(folder / "picture.svg", answer.picture())
    write_text(folder / "result.json", to_json(answer.result, indent=2) + "\n")
    contacts = contacts_json(
        [[contact for touch in grip for contact in touch.evidence] for grip in answer.run.result.grips]
    )
    write_text(folder / "contacts.json", json.dumps(contacts, indent=1) + "\n")
