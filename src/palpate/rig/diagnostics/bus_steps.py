"""Bus steps of a diagnosis: baud rates, ids and models that answer, beside the rig file."""

from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass

from palpate.base.errors import DeviceError, quantity
from palpate.config.diagnosis_results import Cause, DoctorStepOut, FindingOut
from palpate.drivers.dynamixel import ALL_IDS, Bus, DamagedAnswer, FoundServo, NotAnswering, model_name, scan
from palpate.rig.diagnostics.servo_bus import RigServo, baudrates_to_try, list_servos
from palpate.rig.diagnostics.steps import DiagnosisCase, error_finding, finish_step, join_words, skip_step

_BAUD, _IDS, _MODELS = "baud rate", "ids", "models"
_LOOKED_BAUD = "pinged all servos at the rig file's baud rate, and at others where some are missing"
_LOOKED_IDS = "compared the ids that answer with the rig file's"
_LOOKED_MODELS = "compared the models that answer with the rig file's"


@dataclass(frozen=True, eq=False)
class ExaminedBus:
    """Steps on who answers. `sound`: ids of the rig's servos that answer as the rig file says."""

    steps: tuple[DoctorStepOut, ...]
    sound: frozenset[int]


@dataclass(frozen=True, eq=False)
class _Servos:
    """Servos of the rig file, and what answers: at its baud rate, and elsewhere."""

    owned: tuple[RigServo, ...]
    here: tuple[FoundServo, ...]
    elsewhere: tuple[FoundServo, ...]

    def missing(self) -> list[RigServo]:
        there = {item.dxl_id for item in self.here}
        return [servo for servo in self.owned if servo.dxl_id not in there]

    def at_other_rate(self) -> list[tuple[RigServo, FoundServo]]:
        """Servos that are missing, and answer to their id at another rate."""
        by_id = {item.dxl_id: item for item in self.elsewhere}
        return [(servo, by_id[servo.dxl_id]) for servo in self.missing() if servo.dxl_id in by_id]

    def strangers(self) -> list[FoundServo]:
        """What answers to an id that the rig file does not have."""
        ids = {servo.dxl_id for servo in self.owned}
        return [item for item in (*self.here, *self.elsewhere) if item.dxl_id not in ids]


def examine_bus(case: DiagnosisCase, usable: frozenset[str]) -> ExaminedBus:
    """Scan the bus, if its port is usable. Nothing is written."""
    if case.rig.bus.port not in usable:
        return _unseen(f"the bus's port {case.rig.bus.port} cannot be used")
    try:
        seen = _scan_bus(case)
    except DeviceError as error:
        failed = error_finding(
            Cause.PORT_UNUSABLE,
            f"port {case.rig.bus.port}",
            str(error),
            "the adapter broke off while it was used",
            "plug the adapter in directly, without a hub, and run this again",
        )
        return ExaminedBus(
            (
                finish_step(_BAUD, _LOOKED_BAUD, "the port failed", [failed]),
                *_unseen("the port failed").steps[1:],
            ),
            frozenset(),
        )
    if not seen.here and not seen.elsewhere:
        silent = finish_step(_BAUD, _LOOKED_BAUD, "nothing answers at any baud rate", [_all_silent(case)])
        return ExaminedBus((silent, *_unseen("no servo answers").steps[1:]), frozenset())
    baud, ids, models = _baud_step(case, seen), _ids_step(case, seen), _models_step(seen)
    crowded = {item.dxl_id for item in seen.here if item.crowded}
    right = {item.dxl_id: model_name(item.ping) for item in seen.here}
    sound = {
        servo.dxl_id
        for servo in seen.owned
        if right.get(servo.dxl_id) == servo.model and servo.dxl_id not in crowded
    }
    return ExaminedBus((baud, ids, models), frozenset(sound))


def _unseen(because: str) -> ExaminedBus:
    looked = ((_BAUD, _LOOKED_BAUD), (_IDS, _LOOKED_IDS), (_MODELS, _LOOKED_MODELS))
    return ExaminedBus(tuple(skip_step(name, what, because) for name, what in looked), frozenset())


def _scan_bus(case: DiagnosisCase) -> _Servos:
    place, rate = case.place, case.rig.bus.baudrate_bps
    owned = list_servos(case.rig)

    def tell(baudrate: int, dxl_id: int | None) -> None:
        case.tell(f"servos at {baudrate} baud" + ("" if dxl_id is None else f", id {dxl_id}"))

    def look(rates: Sequence[int]) -> tuple[FoundServo, ...]:
        return scan(place.open, place.clock, rates, ALL_IDS, latency_s=place.latency_s, tell=tell).found

    here = look([rate])
    unheard = [servo.dxl_id for servo in owned if servo.dxl_id not in {item.dxl_id for item in here}]
    here += _ping_again(case, unheard) if here else ()
    missing = set(unheard) - {item.dxl_id for item in here}
    others = [other for other in baudrates_to_try(place) if other != rate] if missing else []
    return _Servos(owned, here, look(others) if others else ())


def _ping_again(case: DiagnosisCase, dxl_ids: Sequence[int]) -> tuple[FoundServo, ...]:
    """Servos that a ping to all has missed, as on a bad wire, and that answer when asked by themselves."""
    rate, found = case.rig.bus.baudrate_bps, []
    with closing(Bus(case.place.open(rate), case.place.clock, rate, latency_s=case.place.latency_s)) as bus:
        for dxl_id in dxl_ids:
            with suppress(NotAnswering, DamagedAnswer):
                found.append(FoundServo(rate, dxl_id, bus.ping(dxl_id)))
    return tuple(found)


def _all_silent(case: DiagnosisCase) -> FindingOut:
    rates = join_words([str(rate) for rate in baudrates_to_try(case.place)], 8)
    return error_finding(
        Cause.BUS_SILENT,
        f"port {case.rig.bus.port}",
        f"the port opens, and no servo answers at {rates} baud",
        "the servos have no supply, the first cable is not plugged in, or this is another device's port",
        "switch the servos' supply on and check the cable from the adapter to the first servo",
    )


def _baud_step(case: DiagnosisCase, seen: _Servos) -> DoctorStepOut:
    rate, moved = case.rig.bus.baudrate_bps, seen.at_other_rate()
    rates = {item.baudrate for _, item in moved}
    here = len(seen.owned) - len(seen.missing())
    saw = f"{here} of {quantity(len(seen.owned), 'servo', 'servos')} at {rate} baud"
    if moved and len(moved) == len(seen.owned) and len(rates) == 1:
        (other,) = rates
        finding = error_finding(
            Cause.BAUD_RATE,
            "all servos",
            f"every servo answers at {other} baud, not at the rig file's {rate}",
            "servos and rig file agree in all but the rate",
            f"write baudrate_bps = {other} below [bus] in the rig file, or set up the servos anew",
        )
        return finish_step(_BAUD, _LOOKED_BAUD, f"{saw}, {len(moved)} at {other}", [finding])
    findings = [
        error_finding(
            Cause.BAUD_RATE,
            _named(servo),
            f"it answers at {item.baudrate} baud, not at the rig file's {rate}",
            "it has not been set up for this rig, or was reset",
            case.command(f"palpate setup-motors --rig RIG --id {servo.dxl_id}"),
        )
        for servo, item in moved
    ]
    more = "".join(
        f", {sum(item.baudrate == other for _, item in moved)} at {other}" for other in sorted(rates)
    )
    return finish_step(_BAUD, _LOOKED_BAUD, saw + more, findings)


def _ids_step(case: DiagnosisCase, seen: _Servos) -> DoctorStepOut:
    at_other_rate = {servo.dxl_id for servo, _ in seen.at_other_rate()}
    missing = [servo for servo in seen.missing() if servo.dxl_id not in at_other_rate]
    crowded = [item for item in (*seen.here, *seen.elsewhere) if item.crowded]
    strangers = [item for item in seen.strangers() if not item.crowded]
    findings = [_crowded(case, item, seen.owned, missing) for item in crowded]
    if missing and not crowded:
        findings.append(_other_ids(case, missing, strangers) if strangers else _silent(missing))
    ids = sorted(item.dxl_id for item in seen.here)
    saw = f"ids {join_words([str(i) for i in ids], 16)} answer"
    return finish_step(_IDS, _LOOKED_IDS, saw, findings)


def _crowded(
    case: DiagnosisCase, item: FoundServo, owned: Sequence[RigServo], missing: Sequence[RigServo]
) -> FindingOut:
    owner = next((servo for servo in owned if servo.dxl_id == item.dxl_id), None)
    also = f", and {join_words([_named(servo) for servo in missing])} does not answer" if missing else ""
    target = missing[0] if missing else owner
    return error_finding(
        Cause.DUPLICATE_ID,
        f"id {item.dxl_id}" if owner is None else _named(owner),
        f"two servos or more answer to id {item.dxl_id} at once, and spoil each other's answers{also}",
        "one of them was never given an id of its own",
        "connect only the servo that has the wrong id, then: "
        + case.command(
            "palpate setup-motors --rig RIG"
            if target is None
            else f"palpate setup-motors --rig RIG --id {target.dxl_id}"
        ),
    )


def _other_ids(
    case: DiagnosisCase, missing: Sequence[RigServo], strangers: Sequence[FoundServo]
) -> FindingOut:
    there = [
        f"id {item.dxl_id} at {item.baudrate} baud ({model_name(item.ping) or 'unknown model'})"
        for item in strangers
    ]
    verb = "does" if len(missing) == 1 else "do"
    return error_finding(
        Cause.WRONG_ID,
        join_words([_named(servo) for servo in missing]),
        f"{'it' if len(missing) == 1 else 'they'} {verb} not answer, and {join_words(there)}, which the rig "
        f"file does not have, {'does' if len(there) == 1 else 'do'}",
        "a servo has another id than the rig file says; new ones have id 1 at 57600 baud",
        case.command(f"palpate setup-motors --rig RIG --id {missing[0].dxl_id}"),
    )


def _silent(missing: Sequence[RigServo]) -> FindingOut:
    one, ids = len(missing) == 1, join_words([str(servo.dxl_id) for servo in missing])
    return error_finding(
        Cause.SERVO_SILENT,
        join_words([_named(servo) for servo in missing]),
        f"{'it does' if one else 'they do'} not answer at any baud rate, and other servos do",
        "its cable or plug is loose, or it is broken"
        if one
        else "a cable or plug before them is loose, or they have no supply",
        f"check the plugs on both sides of {'servo' if one else 'servos'} {ids}",
    )


def _models_step(seen: _Servos) -> DoctorStepOut:
    there = {item.dxl_id: item for item in seen.here if item.ping is not None and not item.crowded}
    models = {dxl_id: _model(item) for dxl_id, item in there.items()}
    owned = [servo for servo in seen.owned if servo.dxl_id in there]
    if not owned:
        return skip_step(_MODELS, _LOOKED_MODELS, "no servo of the rig file answers as it should")
    other = [servo for servo in owned if models[servo.dxl_id] != servo.model]
    findings = [
        error_finding(
            Cause.WRONG_MODEL,
            _named(servo),
            f"it answers as {models[servo.dxl_id]}, not as the rig file's {servo.model}",
            _why_other_model(servo, models, other),
            f'write model = "{models[servo.dxl_id]}" for it in the rig file, or mount one of the other model',
        )
        for servo in other
    ]
    names = {models[servo.dxl_id] for servo in owned}
    saw = join_words(
        [f"{sum(models[servo.dxl_id] == name for servo in owned)} × {name}" for name in sorted(names)]
    )
    return finish_step(_MODELS, _LOOKED_MODELS, saw, findings)


def _why_other_model(servo: RigServo, models: dict[int, str], other: Sequence[RigServo]) -> str:
    for twin in other:
        if twin is not servo and models[twin.dxl_id] == servo.model and models[servo.dxl_id] == twin.model:
            return f"servos {servo.dxl_id} and {twin.dxl_id} may have each other's id"
    return "its limits of current and position would be wrong by the ratio of the models' units"


def _model(item: FoundServo) -> str:
    assert item.ping is not None
    return model_name(item.ping) or f"model number {item.ping.model_number}"


def _named(servo: RigServo) -> str:
    return f"servo {servo.dxl_id} ({servo.owner})"
