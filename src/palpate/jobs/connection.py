"""A connection to a rig's fingers for grips that the caller chooses, with a session of what they do."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path

from palpate.base.errors import PalpateError
from palpate.base.file_io import write_text
from palpate.base.vocabulary import SessionKind
from palpate.config import ObjectsFile, RigOnBench, Scene
from palpate.jobs.ready_rig import ReadyRig
from palpate.rig.bench import BenchRig, environment, set_up
from palpate.rig.contact_peak import bus_latency_s
from palpate.rig.conversion import contacts_json
from palpate.rig.emulated.ground_truth import placements_in_hand_frame
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.result import WiringProof
from palpate.rig.session.archive import discard_session
from palpate.rig.session.carried_grips import GripRecorder
from palpate.rig.session.log import SessionLog, session_folder
from palpate.rig.session.recorded_session import keep_inputs
from palpate.rig.session.run import prepared_hand
from palpate.rig.session.signals import HeldInterrupts, unwind_on_signals
from palpate.rig.workers import BackgroundCall


@dataclass(frozen=True)
class SessionRequest:
    """Request for a session below a folder; `kind`: what the connection is for.

    `objects`, and what `scene` says of an emulated table, are kept in it.
    """

    root: Path
    kind: SessionKind
    objects: ObjectsFile
    scene: Scene | None

    def make_folder(self) -> Path:
        """Make a folder with the present time in its name."""
        name = datetime.now(UTC).strftime(f"{self.kind}-%Y%m%d-%H%M%S-%f")
        return session_folder(self.root, name[:-3])


@dataclass(frozen=True)
class ConnectionRequest:
    """Request for a connection. `placements`: of parts on an emulated table.

    `proof`: of the wiring, that is asked for. `session`: None for none.
    """

    on_bench: RigOnBench
    placements: tuple[Placement, ...]
    seed: int
    proof: WiringProof | None
    session: SessionRequest | None


@contextmanager
def connect_fingers(request: ConnectionRequest, notice: Callable[[str], None]) -> Iterator[ReadyRig]:
    """Connect, and disconnect when the block is left; errors as `Rig.connect`.

    Where only the session's contacts cannot be written then, OutputError or InputError says so.
    """
    on_bench = request.on_bench
    bench = set_up(on_bench.described, request.placements, request.seed)
    with unwind_on_signals(), BackgroundCall("the display", notice) as beside, ExitStack() as connection:
        grips, there, folder = GripRecorder(), environment(bench), None
        if request.session is not None:
            folder, latency_s = request.session.make_folder(), bus_latency_s(on_bench.rig)
            log = connection.enter_context(_session_log(request, bench, folder, latency_s))
            held = connection.enter_context(HeldInterrupts())
            there = environment(bench, log, latency_s, held.check)
            grips = connection.enter_context(_recorded_grips(request, bench, log, folder))
        hand = prepared_hand(there, on_bench.rig, on_bench.calibration, request.proof, beside)
        ready = ReadyRig(connection.enter_context(hand), connection, grips, bench.clock, folder)
        try:
            yield ready
        except BaseException as error:
            if ready.is_connected:
                grips.tell_left(type(error).__name__, str(error))
            raise


@contextmanager
def _session_log(
    request: ConnectionRequest, bench: BenchRig, folder: Path, latency_s: float
) -> Iterator[SessionLog]:
    """Log of a session in its folder, of which nothing is left if no port was used."""
    assert request.session is not None, "asked for"
    log: SessionLog | None = None
    try:
        with SessionLog(folder, bench.clock, _header(request, latency_s)) as log:
            keep_inputs(folder, request.on_bench, request.session.objects, request.session.scene)
            yield log
    finally:
        if log is None or not log.has_traffic:
            discard_session(folder, is_ours=log is not None)


@contextmanager
def _recorded_grips(
    request: ConnectionRequest, bench: BenchRig, log: SessionLog, folder: Path
) -> Iterator[GripRecorder]:
    """A recorder of grips; in the end it tells the truth of an emulated table, and contacts are written."""
    if bench.emulated is None or not request.placements:
        grips, parts = GripRecorder(log), []
    else:
        parts = list(bench.emulated.parts)
        lie = partial(
            placements_in_hand_frame, request.on_bench, request.placements, request.seed, bench.emulated
        )
        grips = GripRecorder(log, lie)
    try:
        yield grips
    except BaseException:
        grips.tell_truth(parts)
        with suppress(PalpateError):  # what ended the connection is what has to be said
            _write_contacts(grips, folder)
        raise
    grips.tell_truth(parts)
    _write_contacts(grips, folder)


def _write_contacts(grips: GripRecorder, folder: Path) -> None:
    contacts = [[item for touch in grip for item in touch.evidence] for grip in grips.grips]
    write_text(folder / "contacts.json", json.dumps(contacts_json(contacts), indent=1) + "\n")


def _header(request: ConnectionRequest, latency_s: float) -> dict[str, object]:
    assert request.session is not None, "asked for"
    rig = request.on_bench.rig
    return {
        "palpate": version("palpate"),
        "command": request.session.kind,
        "rig": rig.name,
        "seed": request.seed,
        "scene": request.session.scene is not None,
        "calibration": request.on_bench.calibration is not None,
        "emulated": rig.emulation is not None,
        "started": datetime.now(UTC).replace(microsecond=0).isoformat(),
        "bus_latency_s": latency_s,
        "proof": None if request.proof is None else request.proof.command,
    }
