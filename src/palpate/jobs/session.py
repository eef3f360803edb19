"""Sessions: a recorded run, to be replayed without devices or watched again."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from palpate.base.errors import InputError
from palpate.base.vocabulary import OWN_STRATEGY, SessionKind, Strategy
from palpate.config import RigOnBench
from palpate.drivers.transport import Clock
from palpate.jobs.files import PathLike, check_arguments
from palpate.jobs.monitor import Monitor
from palpate.rig.array_monitor import open_recorded_arrays, pace_clock
from palpate.rig.bench import choose_placements
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.conversion import finger_of
from palpate.rig.emulated.ground_truth import placements_in_hand_frame
from palpate.rig.identification.part_count import PartCount
from palpate.rig.identification.result import IdentificationJob, WiringProof
from palpate.rig.session.carried_grips import replay_grips
from palpate.rig.session.log_file import session_of
from palpate.rig.session.log_reader import SessionFile, read_session
from palpate.rig.session.recorded_session import confirmed_of, load_kept_inputs, used_calibration
from palpate.rig.session.run import Replayed, replay


@check_arguments
def open_session(path: PathLike) -> "Session":
    """Open a recorded session: its folder, or the log in it. Raises InputError if there is none."""
    folder = Path(path)
    folder = session_of(folder)
    return Session(folder, read_session(folder))


@dataclass(frozen=True, eq=False, repr=False)
class Session:
    """A recorded session: its folder and what its log holds (docs/session-log.md)."""

    folder: Path
    log: SessionFile

    @property
    def header(self) -> Mapping[str, Any]:
        """First line of the log: rig, seed, strategy, version."""
        return self.log.header

    @property
    def recorded_by(self) -> str:
        """Version of palpate that recorded it."""
        return str(self.log.header.get("palpate"))

    def replay(self) -> Replayed:
        """Replay: run the same code against what was recorded; no device is needed, nothing moves.

        Of a connection the recorded grips are carried out: what chose them is not in the log.
        Raises InputError for a session that cannot be replayed, and for a log that was changed after it was
        written although the replay met no difference.
        """
        replayed = self._replay()
        if self.changed is not None and replayed.difference is None:
            raise InputError(f"{self.changed}; replaying it made no difference")
        return replayed

    def _replay(self) -> Replayed:
        kind = self.header.get("command", SessionKind.IDENTIFY)
        if kind == SessionKind.IDENTIFY:
            return replay(self.log, self._job(), self._latency_s())
        if kind not in list(SessionKind):
            raise InputError(f'{self.log.path}: line 1: "command" must be one of {", ".join(SessionKind)}')
        calibrated = used_calibration(self.log)
        on_bench = load_kept_inputs(self.folder, scene=False, calibration=calibrated)[0]
        proof = self._proof(on_bench)
        return replay_grips(self.log, on_bench.rig, on_bench.calibration, proof, self._latency_s())

    @property
    def changed(self) -> str | None:
        """Place where the log is not as it was written; None if all its check sums are right."""
        if self.log.changed_line is None:
            return None
        where = f"{self.log.path}: line {self.log.changed_line}"
        return f"{where}: is not as it was written: its check sum is wrong"

    @check_arguments
    @contextmanager
    def watch(
        self, fingers: Sequence[str] = (), *, speed: float | None = 1.0, wall: Clock | None = None
    ) -> Iterator[Monitor]:
        """Watch the tactile arrays of the recorded run; `speed` and `wall` pace it as for `Rig.watch`.

        Raises InputError for a finger that is not there, or a speed that is not above 0.
        """
        found = open_recorded_arrays(self.folder, fingers)

        def goes_on() -> bool:
            found.tare_when_started()
            return not found.ended

        notes = [f"recorded, {found.end_s:.1f} s; tared at each start of the arrays, as the run did"]
        if found.changed_line is not None:
            line = found.changed_line
            notes.append(f"line {line} of the log is not as it was written: its check sum is wrong")
        clock = pace_clock(found.clock, speed, wall)
        yield Monitor(
            found.rig, self.folder, found.fingers, clock, goes_on, lambda: found.doing, tuple(notes)
        )

    def _job(self) -> IdentificationJob:
        path, header = self.log.path, self.log.header
        seed, strategy, scene = header.get("seed"), header.get("strategy"), header.get("scene", False)
        if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
            raise InputError(f'{path}: line 1: "seed" must be a whole number from 0')
        names = [item.value for item in Strategy]
        if strategy == OWN_STRATEGY:
            raise InputError(f"{path}: a strategy of its own chose the grips; such a session is not replayed")
        if strategy not in names:
            raise InputError(f'{path}: line 1: "strategy" must be one of {", ".join(names)}')
        if not isinstance(scene, bool):
            raise InputError(f'{path}: line 1: "scene" must be true or false')
        on_bench, objects, given = load_kept_inputs(
            self.folder, scene=scene, calibration=used_calibration(self.log)
        )
        parts = PartCount.parse(str(header.get("parts", 1)))
        placements = choose_placements(on_bench.described, objects, given, seed, parts)
        seen = placements_in_hand_frame(on_bench, placements, seed)
        started = None if on_bench.calibration is None else self._started()
        models = prepare_catalogue(objects.objects, map(finger_of, on_bench.rig.fingers))
        return IdentificationJob(
            on_bench.rig,
            models,
            seen,
            Strategy(strategy),
            seed,
            on_bench.calibration,
            started,
            self._proof(on_bench),
            parts,
        )

    def _proof(self, on_bench: RigOnBench) -> WiringProof | None:
        """Proof of the wiring that the run asked for."""
        command = self.header.get("proof")
        if not isinstance(command, str):
            return None
        return WiringProof(on_bench.described, confirmed_of(on_bench.path), command)

    def _started(self) -> datetime:
        """Time when the session began, from which its calibration's age was counted."""
        try:
            started = datetime.fromisoformat(str(self.log.header.get("started")))
        except ValueError:
            started = datetime.min
        if started.tzinfo is None:
            raise InputError(f'{self.log.path}: line 1: "started" must be a date and time in UTC')
        return started

    def _latency_s(self) -> float:
        value = self.log.header.get("bus_latency_s")
        if not isinstance(value, int | float) or isinstance(value, bool) or not 0 <= value < math.inf:
            raise InputError(f'{self.log.path}: line 1: "bus_latency_s" must be a time in s, from 0')
        return float(value)

    def __repr__(self) -> str:
        by = "" if self.recorded_by == version("palpate") else f", recorded by palpate {self.recorded_by}"
        return f"<Session {self.folder}: rig {self.header.get('rig')}, {len(self.log.entries)} events{by}>"
