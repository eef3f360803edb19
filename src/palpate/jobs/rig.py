"""A rig from Python: emulated or real, opened once, then identify, plan, check, calibrate, watch, serve.

Torque is on only while a method moves fingers, and off on every way out of it.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

from palpate.base.errors import InputError, OutputError, warn_operator
from palpate.base.vocabulary import SessionKind, Strategy
from palpate.config import ObjectsFile, RigFile, RigOnBench, load_calibrated
from palpate.config.calibration_file import ReferencesFile
from palpate.drivers.emulators import LOOPBACK, DeviceServer, serve_pty, serve_tcp
from palpate.drivers.transport import Clock, MonotonicClock
from palpate.jobs import recognition
from palpate.jobs.calibration import (
    SHIPPED_RIG,
    CalibrationAnswer,
    CalibrationRequest,
    HomedSlide,
    calibrate_rig,
    check_homable,
    home_rig,
    references_from,
)
from palpate.jobs.check import (
    CheckAnswer,
    DoctorAnswer,
    WiringCheck,
    check_rig,
    examine_rig,
    hold_check,
    touch_check,
)
from palpate.jobs.connection import ConnectionRequest, SessionRequest, connect_fingers
from palpate.jobs.files import (
    ObjectsLike,
    PathLike,
    SceneLike,
    check_arguments,
    name_of,
    objects_from,
    scene_from,
    select_known,
)
from palpate.jobs.identification import Callbacks, IdentificationRequest, identify_on
from palpate.jobs.learning import LearnedObject, LearningRequest, begin_learning, keep_result, learn
from palpate.jobs.monitor import Monitor, check_streaming, view_log
from palpate.jobs.ready_rig import ReadyRig
from palpate.jobs.recognition import Answer, Plan
from palpate.rig.array_monitor import find_array_ports, pace_clock, select_fingers, stream_arrays
from palpate.rig.bench import choose_placements
from palpate.rig.commissioning.calibration_run import STEPS
from palpate.rig.commissioning.hand_prober import TableOperator
from palpate.rig.diagnostics.wiring_check import Onlooker
from palpate.rig.emulated.devices import emulate
from palpate.rig.identification.events import Observer
from palpate.rig.identification.part_count import PartCount
from palpate.rig.identification.rig_recognition import GripStrategy
from palpate.rig.session.calibration_drift import check_arrays
from palpate.rig.session.signals import unwind_on_signals


@check_arguments
def open_rig(path: PathLike | None = None, *, seed: int = 0, calibration: bool = True) -> "Rig":
    """Open a rig: from its rig file with the calibration beside it, or None for the shipped emulated bench.

    `seed` draws an emulated rig's hidden errors and what lies on its table. `calibration`: False to leave the
    one beside the rig file alone. No port is opened yet. Raises InputError if a file is wrong.
    """
    if seed < 0:
        raise InputError(f"seed is {seed!r}; it must be a whole number from 0")
    file = None if path is None else Path(path)
    return Rig(load_calibrated(file, calibration=calibration), file, seed)


class Rig:
    """A rig: what its file and its calibration say, and what can be done with it. A context manager.

    Nothing is connected between two calls: torque is off then, and hands may reach in.
    """

    def __init__(self, on_bench: RigOnBench, path: Path | None, seed: int) -> None:
        """`open_rig` makes one."""
        self._on_bench = on_bench
        self._path = path
        self._seed = seed
        self._runs = 0
        self._open = ExitStack()

    @property
    def file(self) -> RigFile:
        """Description of the rig: its file, with the calibration laid over it."""
        return self._on_bench.rig

    @property
    def described(self) -> RigFile:
        """The rig as its file alone describes it."""
        return self._on_bench.described

    @property
    def path(self) -> Path | None:
        """Path of the rig file; None for the shipped one."""
        return self._path

    @property
    def emulated(self) -> bool:
        """True if its devices are emulated."""
        return self._on_bench.rig.emulated

    @property
    def is_calibrated(self) -> bool:
        """True if a calibration is in use."""
        return self._on_bench.calibration is not None

    def with_(self, **tables: object) -> "Rig":
        """Return this rig with other values in its file, which is checked as when it is read.

        `rig.with_(closing={"search_speed_mm_s": 6}, fingers={"f1": {"tip": {"radius_mm": 4.9}}})`: a table
        by its name, one of a list by the entry's; None takes a key away. The rig file stays as it is. Raises
        InputError that names the key, also if the calibration is not of the changed rig.
        """
        return Rig(self._on_bench.change(tables), self._path, self._seed)

    def __enter__(self) -> Self:
        self._open.enter_context(unwind_on_signals())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.__exit__(kind, error, trace)

    @check_arguments
    def identify(  # noqa: PLR0913  # the command's options, all optional
        self,
        objects: ObjectsLike | None = None,
        *,
        scene: SceneLike | None = None,
        strategy: Strategy | str | GripStrategy = Strategy.PLANNED,
        parts: int | str = 1,
        unconfirmed: bool = False,
        sessions: PathLike | None = None,
        on_event: Observer | None = None,
        on_session: Callable[[Path], None] = lambda _: None,
        notice: Callable[[str], None] = warn_operator,
        warn: Callable[[str], None] = warn_operator,
        progress: Callable[[str], None] = lambda _: None,
    ) -> Answer:
        """Identify what lies on the table: touch it until there is one answer, or none can be had.

        Args:
            objects: the catalogue; None for the six shipped objects.
            scene: what lies on an emulated table; else each call draws the next part by the rig's seed.
            strategy: how grips are chosen (memo §3.2): "planned", "random", "rotate", or a function of
                (recognition, planner): approaches of the next grip, or None to end.
            parts: how many lie on the table: a number, or "up-to-3" and the like; `answer.parts` holds them.
            unconfirmed: the wiring of a real rig need not have been proven, by `check` or `calibrate`.
            sessions: where a folder with log, answer, contacts and picture is made; None keeps none.
            on_event: called with every event of the run, beside the thread that drives the devices.
            on_session: called with the session's folder, if there is one, before anything moves.
            notice: called, beside the thread that drives the devices, with what the operator should do now.
            warn: called before anything moves with what limits the run, such as parts that fingers miss.
            progress: called before anything moves with how far a large catalogue is prepared.

        Raises:
            InputError: something about rig, objects or scene is wrong; nothing was moved.
            DeviceError: a device is missing, silent or faulty; torque is off.
            SafetyStop: a limit would have been exceeded; torque is off.
            OutputError: session log or observer failed during the run; torque is off.

        """
        if on_event is not None and not callable(on_event):
            raise TypeError("on_event is called with each event: give a function")
        models, given = objects_from(objects), scene_from(scene)
        run, self._runs = self._runs, self._runs + 1
        with unwind_on_signals():
            chosen = strategy if callable(strategy) else recognition.parse_strategy(strategy)
            request = IdentificationRequest(
                self._on_bench,
                models,
                name_of(objects),
                given,
                self._seed,
                run,
                chosen,
                unconfirmed,
                PartCount.parse(parts),
            )
            calls = Callbacks(on_event, on_session, notice, warn, progress)
            return identify_on(request, None if sessions is None else Path(sessions), calls)

    @check_arguments
    def learn(  # noqa: PLR0913  # the command's options, all but two optional
        self,
        name: str,
        *,
        height_mm: float,
        tolerance_mm: float = 2.0,
        max_seconds: float = 900.0,
        state: str = "learned",
        objects: ObjectsLike | None = None,
        contacts: recognition.Contacts = (),
        scene: SceneLike | None = None,
        unconfirmed: bool = False,
        sessions: PathLike | None = None,
        notice: Callable[[str], None] = warn_operator,
        progress: Callable[[str], None] = lambda _: None,
    ) -> LearnedObject:
        """Learn an object model of a part that is held on the table, by touches all round it.

        `height_mm`: how high it is; above that there is nothing of it. Until its `tolerance_mm` is what was
        asked for, or `max_seconds` of the rig's time have passed. The part's section at the fingers' heights
        is one piece, and inside the workspace. `objects`: what is known already (None: nothing). The part is
        recognised among them first, and learned only if it is *unknown*; if `name` is one of them, it gets a
        further `state`. `contacts`: made before, as by an `identify` that ended as unknown, while it lay as
        it lies now. On an emulated rig one of the shipped objects lies there, drawn by the rig's seed, or
        what `scene` says. `sessions`: where a folder with log, result, contacts and picture is made; None
        keeps none. `progress`: called after every grip. Raises InputError for a rig whose parts may
        slide or whose fingers have no arrays; `unconfirmed`, `notice` and other errors are as in `identify`.
        """
        known = tuple(map(tuple, recognition.contact_record(contacts).grips))
        before = ObjectsFile(()) if objects is None else objects_from(objects)
        request = LearningRequest(name, state, height_mm, tolerance_mm, max_seconds, known, before)
        search = begin_learning(self.file, request)
        there = objects_from(None) if self.emulated else before if before.objects else None
        connection = self._connection(there, scene, (SessionKind.LEARN, sessions), unconfirmed)
        learned: LearnedObject | None = None
        try:
            with connect_fingers(connection, notice) as ready:
                learned = learn(ready, search, request, progress)
            return learned if ready.session is None else keep_result(learned, ready.session)
        except (InputError, OutputError) as error:  # of what could not be written down
            if learned is None:
                raise
            notice(str(error))
            return learned

    @check_arguments
    def plan(
        self,
        objects: ObjectsLike | None,
        contacts: recognition.Contacts,
        *,
        strategy: Strategy | str = Strategy.PLANNED,
        progress: Callable[[str], None] = lambda _: None,
    ) -> Plan:
        """Plan the next grip for contacts, without touching anything. `progress` and errors as of `plan`."""
        return recognition.plan(
            self.file, objects, contacts, strategy=strategy, seed=self._seed, progress=progress
        )

    @check_arguments
    def check(  # noqa: PLR0913  # the command's options, all optional
        self,
        *,
        touch: bool = False,
        hold: bool = False,
        press: bool = False,
        move: bool = False,
        references: ReferencesFile | PathLike | None = None,
        table: TableOperator | None = None,
        onlooker: Onlooker | None = None,
        permit: Callable[[], None] = lambda: None,
        progress: Callable[[str], None] = lambda _: None,
        notice: Callable[[str], None] = warn_operator,
    ) -> CheckAnswer:
        """Check every device, with `touch` if touches of a disc agree with the calibration, or with `hold`
        what force the part on the table holds; with `press` and `move` whether arrays and servos are those
        of the rig file's fingers: `onlooker` presses tips and says which one moved; an emulated rig has one.

        Only `press` moves no fingers, others only if all devices are well, and after `permit`, which may
        raise, was called. `table` puts the disc there; an emulated rig has one, and for `hold` a part of the
        shipped objects, drawn by the rig's seed. `notice`: as in `identify`. Raises DeviceError if the bus's
        port is missing, InputError if nothing can be compared, no part is found, or both are asked for.
        """
        if touch and hold:
            raise InputError("touch and hold exclude each other: the disc that is touched must not slide")
        if (touch or hold) and (press or move):
            raise InputError("touch and hold go without press and move: prove the wiring first")
        with unwind_on_signals():
            moving = None
            if touch:
                moving = touch_check(self._on_bench, self._seed, references, table)
            if hold:
                moving = hold_check(self._on_bench, self._seed, notice)
            wiring = WiringCheck(press, move, onlooker, notice)
            return check_rig(
                self._on_bench, self._seed, moving=moving, wiring=wiring, permit=permit, progress=progress
            )

    @check_arguments
    def doctor(
        self,
        *,
        press: bool = False,
        move: bool = False,
        onlooker: Onlooker | None = None,
        permit: Callable[[], None] = lambda: None,
        progress: Callable[[str], None] = lambda _: None,
        notice: Callable[[str], None] = warn_operator,
    ) -> DoctorAnswer:
        """Examine the whole set-up step by step, in the order in which things go wrong, from ports to forces.

        Nothing moves but for `move`; `press`, `move`, `onlooker`, `permit` are as in `check`, `notice` as in
        `identify`. Devices that are missing or fail are findings. Raises InputError for `press` and `move` on
        a real rig without an onlooker, SafetyStop if a motion had to be stopped.
        """
        with unwind_on_signals():
            return examine_rig(
                self._on_bench,
                self._seed,
                wiring=WiringCheck(press, move, onlooker, notice),
                permit=permit,
                progress=progress,
            )

    @check_arguments
    def calibrate(
        self,
        steps: Sequence[str] = STEPS,
        *,
        references: ReferencesFile | PathLike | None = None,
        table: TableOperator | None = None,
        restart: bool = False,
        progress: Callable[[str], None] = lambda _: None,
        on_session: Callable[[Path], None] | None = None,
    ) -> CalibrationAnswer:
        """Calibrate: measure the rig, write what is found beside the rig file, with a report; fingers move.

        `steps`: of "actuators", "tactile", "fingers", "stage", of which a rig without a turning stage has no
        last one. `table` puts references where they are wanted; an emulated rig has one. An interrupted
        calibration is resumed unless `restart`. `on_session`: called with the folder of a log for a live
        view, removed at the end. From now on this rig uses the calibration. Raises InputError for the shipped
        rig, which has no file to lie beside.
        """
        if self.path is None:
            raise InputError(SHIPPED_RIG)
        if self._on_bench.is_changed:
            raise InputError("a calibration is of a rig file: change the file itself, and open it again")
        with unwind_on_signals():
            request = CalibrationRequest(
                self._on_bench, self.path, self._seed, steps, references_from(references), table, restart
            )
            answer = calibrate_rig(request, progress, on_session)
        self._on_bench = load_calibrated(self.path)
        return answer

    def check_homable(self) -> None:
        """Raise InputError if there is no slide to home: none has `stops_mm` in the rig file."""
        check_homable(self._on_bench)

    @check_arguments
    def home(self, *, notice: Callable[[str], None] = warn_operator) -> list[HomedSlide]:
        """Home every slide that has `stops_mm` in the rig file: back against its back stop; fingers move.

        From then on each slide's turn is known until its servo loses its power. `notice`: as in `identify`.
        Returns what was found, in the fingers' order. Raises InputError for a rig without such a slide,
        DeviceError for a slide that is held or meets no stop, SafetyStop as every motion.
        """
        with unwind_on_signals():
            return home_rig(self._on_bench, self._seed, notice)

    @check_arguments
    @contextmanager
    def watch(
        self,
        fingers: Sequence[str] = (),
        *,
        rate_hz: float | None = None,
        tare: bool = True,
        speed: float | None = 1.0,
        wall: Clock | None = None,
        on_session: Callable[[Path], None] | None = None,
    ) -> Iterator[Monitor]:
        """Watch tactile arrays; they stream until the block is left, and nothing moves.

        `fingers`: names of some; all without any. `rate_hz`: frames a second; None: the rig file's rate.
        `speed`: seconds of an emulated rig's time in one second of the `wall` clock, this computer's without
        it; None: as fast as it is computed. A real rig has its own time. `on_session`: called with the folder
        of a log for a live view, which is removed at the end.

        Raises InputError for a finger that is not there, DeviceError if an array is missing, taken or goes
        away.
        """
        names = [fingers] if isinstance(fingers, str) else fingers
        file, specs = self.file, select_fingers(self.file, names)
        rate = rate_hz or file.closing.sample_rate_hz
        where = find_array_ports(self._on_bench.described)
        with (
            view_log(self._on_bench, where.clock, "watch", on_session) as log,
            ExitStack() as streams,
        ):
            where = where if log is None else where.recorded(log)
            clock = pace_clock(where.clock, speed if file.emulated else None, wall)
            found = streams.enter_context(stream_arrays(file, specs, where, clock, rate))
            uids = {finger.name: finger.array.description.unique_id.hex() for finger in found}
            check_arrays(self._on_bench.calibration, uids)
            for finger in found if tare else ():
                finger.tare()

            def goes_on() -> bool:
                check_streaming(found, rate)
                return True

            emulated = (
                ("emulated: nothing touches; a recorded session shows touches",) if file.emulated else ()
            )
            notes = (_TARED if tare else _NOT_TARED, *emulated)
            yield Monitor(file, None, found, clock, goes_on, lambda: "", notes)

    @check_arguments
    @contextmanager
    def connect(
        self,
        objects: ObjectsLike | None = None,
        *,
        scene: SceneLike | None = None,
        unconfirmed: bool = False,
        sessions: PathLike | None = None,
        notice: Callable[[str], None] = warn_operator,
    ) -> Iterator[ReadyRig]:
        """Connect the fingers for single touches and grips, and a loop of one's own.

        Torque is on until the block is left, by whatever way: hands away from the rig. On an emulated rig
        the next part of `objects`, or what `scene` says, lies on the table; without either nothing.
        `sessions`: where a folder with log and contacts is made, `session` of what is yielded; a replay
        carries out the same grips. `unconfirmed`, `notice` and errors are as in `identify`.
        """
        request = self._connection(objects, scene, (SessionKind.CONNECT, sessions), unconfirmed)
        with connect_fingers(request, notice) as ready:
            yield ready

    def _connection(
        self,
        objects: ObjectsLike | None,
        scene: SceneLike | None,
        session: tuple[SessionKind, PathLike | None],
        unconfirmed: bool,
    ) -> ConnectionRequest:
        """Request for a connection, with the next part on an emulated table; `session`: its kind and root."""
        models, given, name = objects_from(objects), scene_from(scene), name_of(objects)
        self.file.require("identify")
        is_empty = objects is None and given is None
        if not is_empty:
            models, _ = select_known(models, self.file.fingers, name, lambda _: None)  # `recognise` warns
        run, self._runs = self._runs, self._runs + 1
        drawn = IdentificationRequest(
            self._on_bench, models, name, given, self._seed, run, Strategy.PLANNED, unconfirmed
        )
        placements = () if is_empty else drawn.with_parts()[1]
        kind, root = session
        kept = None if root is None else SessionRequest(Path(root), kind, models, given)
        return ConnectionRequest(self._on_bench, placements, self._seed, drawn.proof, kept)

    @check_arguments
    @contextmanager
    def serve(
        self,
        objects: ObjectsLike | None = None,
        *,
        scene: SceneLike | None = None,
        pty: bool = True,
        tcp_port: int = 0,
        host: str = LOOPBACK,
    ) -> Iterator[DeviceServer]:
        """Serve the emulated devices to other programs, in real time, until the block is left.

        On pseudo-terminals or, without `pty`, on TCP ports of this computer from `tcp_port` on (0: any), on
        its address `host`: another than the loopback's lets everybody on the network drive the devices.
        `service.paths` says where each port of the rig file is. Raises InputError for a real rig.
        """
        described = self._on_bench.described
        if described.emulation is None:
            raise InputError(f'rig "{described.name}" has no [emulation] table: there is nothing to emulate')
        placements = choose_placements(described, objects_from(objects), scene_from(scene), self._seed)
        devices, clock, done = (
            emulate(described, placements, self._seed).devices,
            MonotonicClock(),
            threading.Event(),
        )
        served = serve_pty(devices, clock, done) if pty else serve_tcp(devices, clock, done, tcp_port, host)
        with served as service:
            yield service

    def __repr__(self) -> str:
        kind = "emulated" if self.emulated else "real"
        calibrated = "calibrated" if self.is_calibrated else "not calibrated"
        return f"<Rig {self.file.name}: {len(self.file.fingers)} fingers, {kind}, {calibrated}>"


_TARED = "tared at the start: nothing may touch the tips then"
_NOT_TARED = "not tared: forces need it; tare with nothing touching the tips"
