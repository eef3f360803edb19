"""An identification with its session: the main job, from a rig and a catalogue to an answer."""

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from palpate.base.errors import PalpateError
from palpate.base.file_io import write_text
from palpate.base.vocabulary import Strategy
from palpate.config import ObjectsFile, Scene
from palpate.config.emulation import ConfigurationText
from palpate.config.result_model import to_json
from palpate.config.writers import file_text
from palpate.jobs.answers import Answer
from palpate.rig.bench import BenchRig, choose_placement, environment, set_up
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.catalogue.reachability import finding_lines
from palpate.rig.contact_peak import bus_latency_s
from palpate.rig.conversion import finger_of
from palpate.rig.emulated.ground_truth import placement_in_hand_frame, scene_lines
from palpate.rig.emulated.scene import Placement, draw_placement
from palpate.rig.identification.loop import check_accuracy
from palpate.rig.identification.observers import Observer
from palpate.rig.session.archive import discard_session
from palpate.rig.session.log import SessionLog, session_folder
from palpate.rig.session.recorded_session import keep_inputs
from palpate.rig.session.run import TRUTH_EVENT, IdentificationJob, IdentificationRun, run_identification
from palpate.rig.session.signals import HeldInterrupts
from palpate.views.recognition import contacts_json


@dataclass(frozen=True)
class _Inputs:
    """What an identification starts from."""

    on_bench: RigOnBench
    objects: ObjectsFile
    scene: Scene | None
    seed: int
    strategy: Strategy

    def session_name(self) -> str:
        """After everything that decides an emulated session, so that it is the same again; else the time."""
        if not self.on_bench.rig.emulated:
            return datetime.now(UTC).strftime("identify-%Y%m%d-%H%M%S")
        content = hashlib.sha256(version("palpate").encode())
        for path in (self.on_bench.path, self.on_bench.calibration_path):
            content.update(b"" if path is None else path.read_bytes())
        content.update(file_text(self.objects).encode())
        content.update(b"" if self.scene is None else file_text(self.scene).encode())
        content.update(self.strategy.value.encode())
        return f"identify-seed-{self.seed}-{content.hexdigest()[:8]}"


def identify_on(
    on_bench: RigOnBench,
    objects: ObjectsFile,
    *,
    name: str,
    scene: Scene | None,
    seed: int,
    run: int,
    strategy: Strategy,
    sessions: Path | None,
    on_event: Observer | None,
    on_session: Callable[[Path], None],
    notice: Callable[[str], None],
    warn: Callable[[str], None],
    progress: Callable[[str], None],
) -> Answer:
    """Identify, with a session log below `sessions`; arguments and errors as `Rig.identify`.

    `name`: of the objects, in messages. `run`: number of the run on this rig, from 0; later ones draw other
    parts for an emulated table.
    """
    begin = time.perf_counter()
    check_accuracy(on_bench.rig, str(on_bench.path))
    lies = choose_placement(on_bench.described, objects, scene, seed)
    if run and scene is None and lies is not None:
        lies = _draw_part(on_bench, objects, seed, run)
        at = ConfigurationText(x=lies.x_mm, y=lies.y_mm, theta=lies.theta_rad)
        scene = Scene(
            format="palpate/scene@1", object=lies.model.name, configuration=at, state=lies.state.name
        )
    for line in finding_lines(on_bench.rig, objects.objects, name):
        warn(line)
    for line in scene_lines(on_bench.described, lies) if scene is not None and lies is not None else ():
        warn(line)
    inputs = _Inputs(on_bench, objects, scene, seed, strategy)
    # Before there are ports, which processes that prepare it would inherit.
    catalogue = prepare_catalogue(objects.objects, map(finger_of, on_bench.rig.fingers), progress)
    bench = set_up(on_bench.described, lies, seed)
    placement_now = partial(placement_in_hand_frame, on_bench, lies, seed, bench.emulated)
    started = datetime.now(UTC).replace(microsecond=0)
    job = IdentificationJob(
        on_bench.rig,
        catalogue,
        placement_now(),
        strategy,
        seed,
        on_bench.calibration,
        started,
    )
    observers = [] if on_event is None else [on_event]
    if sessions is None:
        finished = run_identification(job, environment(bench), None, observers, notice, placement_now)
        out = finished.out(wall_seconds=time.perf_counter() - begin, session=None)
        return Answer(out, finished, objects, finished.late_failure)
    return _identify_with_log(
        inputs, job, bench, sessions, observers, on_session, notice, placement_now, begin
    )


def _identify_with_log(
    inputs: _Inputs,
    job: IdentificationJob,
    bench: BenchRig,
    sessions: Path,
    observers: Sequence[Observer],
    on_session: Callable[[Path], None],
    notice: Callable[[str], None],
    placement_now: Callable[[], Placement | None],
    begin: float,
) -> Answer:
    """Identify with a session log. An answer that could not be written down is still an answer."""
    folder = session_folder(sessions, inputs.session_name())
    latency_s = bus_latency_s(job.rig)
    answer: Answer | None = None
    log: SessionLog | None = None
    try:
        with SessionLog(folder, bench.clock, _header(inputs, job, latency_s)) as log:
            keep_inputs(folder, inputs.on_bench, inputs.objects, inputs.scene)
            on_session(folder)
            with HeldInterrupts() as held:
                finished = run_identification(
                    job,
                    environment(bench, log, latency_s, held.check),
                    log,
                    observers,
                    notice,
                    placement_now,
                )
            if finished.truth is not None:
                part = None if bench.emulated is None else bench.emulated.part
                log.event(TRUTH_EVENT, **finished.truth.values(part))
            out = finished.out(wall_seconds=time.perf_counter() - begin, session=str(folder))
            log.event("result", result=out.model_dump(mode="json"))
            answer = Answer(out, finished, inputs.objects, finished.late_failure)
        _write_results(answer, finished, folder)
    except PalpateError as error:
        if answer is None:
            raise
        answer = replace(answer, failure=error)
    finally:
        if log is None or not log.has_traffic:
            discard_session(folder, is_ours=log is not None)
    return answer


def _header(inputs: _Inputs, job: IdentificationJob, latency_s: float) -> dict[str, object]:
    assert job.started is not None, "set by identify_on"
    return {
        "palpate": version("palpate"),
        "rig": job.rig.name,
        "seed": inputs.seed,
        "strategy": inputs.strategy.value,
        "scene": inputs.scene is not None,
        "calibration": job.calibration is not None,
        "emulated": job.rig.emulation is not None,
        "started": job.started.isoformat(),
        "bus_latency_s": latency_s,
    }


def _draw_part(on_bench: RigOnBench, objects: ObjectsFile, seed: int, run: int) -> Placement:
    """What lies on an emulated table in a later run on one rig."""
    emulation = on_bench.described.emulation
    assert emulation is not None, "something lies on emulated tables only"
    rng = np.random.default_rng([seed, 0, run])
    return draw_placement(objects, emulation.placement_radius_mm, rng, on_bench.described.workspace.radius_mm)


def _write_results(answer: Answer, run: IdentificationRun, folder: Path) -> None:
    """Write picture, answer and contacts into the session's folder."""
    write_text(folder / "picture.svg", answer.picture())
    write_text(folder / "result.json", to_json(answer.result, indent=2) + "\n")
    contacts = contacts_json(
        [[contact for touch in grip for contact in touch.evidence] for grip in run.result.grips]
    )
    write_text(folder / "contacts.json", json.dumps(contacts, indent=1) + "\n")
