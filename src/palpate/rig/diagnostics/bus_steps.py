"""Bus steps of a diagnosis: baud rates, ids and models that answer, compared with the rig file."""

from collections.abc import Mapping, Sequence
from contextlib import closing, suppress

from palpate.base.errors import quantity
from palpate.config import RigServo
from palpate.config.diagnosis_results import Cause, FindingOut
from palpate.drivers.dynamixel import (
    ALL_IDS,
    Bus,
    DamagedAnswer,
    FoundServo,
    NotAnswering,
    model_by_name,
    model_name,
    scan,
)
from palpate.rig.diagnostics.readings import AnsweringServos, Readings
from palpate.rig.diagnostics.servo_bus import baudrates_to_try, list_servos
from palpate.rig.diagnostics.steps import (
    DiagnosisCase,
    Judgement,
    NamedDevice,
    join_words,
    name_servo,
    name_together,
    port_failed,
    wrong,
)


def scan_rig_bus(case: DiagnosisCase) -> AnsweringServos:
    """Ping all servos; other baud rates are tried if some are missing. Raises DeviceError for the port."""
    place, rate = case.place, case.rig.bus.baudrate_bps
    owned = list_servos(case.rig)

    def tell(baudrate: int, dxl_id: int | None) -> None:
        case.tell(f"servos at {baudrate} baud" + ("" if dxl_id is None else f", id {dxl_id}"))

    def look(rates: Sequence[int]) -> tuple[FoundServo, ...]:
        return scan(place.open, place.clock, rates, ALL_IDS, latency_s=place.latency_s, tell=tell).found

    here = look([rate])
    unheard = [servo.dxl_id for servo in owned if servo.dxl_id not in {item.dxl_id for item in here}]
    here += _ping_again(case, unheard)
    missing = set(unheard) - {item.dxl_id for item in here}
    others = [other for other in baudrates_to_try(place) if other != rate] if missing else []
    return AnsweringServos(owned, here, look(others) if others else ())


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
    return wrong(
        Cause.BUS_SILENT,
        name_together(f"port {case.rig.bus.port}", map(_name, list_servos(case.rig))),
        f"the port opens, and no servo answers at {rates} baud",
        "nothing can be moved or read",
        "switch the servos' supply on and check the cable from the adapter to the first servo; if both "
        "are right, see with palpate find-port whether the port is the adapter's",
    )


def judge_baud_rate(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Servos that answer at another rate."""
    rate, seen = case.rig.bus.baudrate_bps, readings.bus
    if seen is None:
        return port_failed(case, str(readings.bus_error))
    if not seen.here and not seen.elsewhere:
        return "nothing answers at any baud rate", [_all_silent(case)]
    moved = seen.at_other_rate
    rates = sorted({item.baudrate for _, item in moved})
    here = len(seen.owned) - len(seen.missing)
    saw = f"{here} of {quantity(len(seen.owned), 'servo', 'servos')} at {rate} baud"
    saw += "".join(f", {sum(item.baudrate == other for _, item in moved)} at {other}" for other in rates)
    if moved and len(moved) == len(seen.owned) and len(rates) == 1:
        finding = wrong(
            Cause.BAUD_RATE,
            name_together("all servos", map(_name, seen.owned)),
            f"every servo answers at {rates[0]} baud, not at the rig file's {rate}",
            "servos and rig file agree in all but the rate",
            f"write baudrate_bps = {rates[0]} below [bus] in the rig file, or set up the servos anew",
        )
        return saw, [finding]
    return saw, [
        wrong(
            Cause.BAUD_RATE,
            _name(servo),
            f"it answers at {item.baudrate} baud, not at the rig file's {rate}",
            "it has not been set up for this rig, or was reset",
            f"palpate setup-motors --id {servo.dxl_id}",
        )
        for servo, item in moved
    ]


def judge_ids(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Servos that are missing, and ids that two share or that the rig file does not have."""
    seen = readings.bus
    assert seen is not None, "the step needs answers"
    at_other_rate = {servo.dxl_id for servo, _ in seen.at_other_rate}
    missing = [servo for servo in seen.missing if servo.dxl_id not in at_other_rate]
    crowded = [item for item in (*seen.here, *seen.elsewhere) if item.crowded]
    strangers = [item for item in seen.strangers if not item.crowded]
    findings = [_id_clash(item, seen.owned, missing) for item in crowded]
    if missing and not crowded:
        findings.append(_other_ids(missing, strangers) if strangers else _silent(missing))
    elif not missing:
        findings += [_stranger(case, item) for item in strangers]
    ids = sorted(item.dxl_id for item in seen.here)
    return f"ids {join_words([str(i) for i in ids], 16)} answer", findings


def _id_clash(item: FoundServo, owned: Sequence[RigServo], missing: Sequence[RigServo]) -> FindingOut:
    owner = next((servo for servo in owned if servo.dxl_id == item.dxl_id), None)
    also = f", and {_name_servos(missing).name} does not answer" if missing else ""
    target = missing[0] if missing else owner
    name = f"id {item.dxl_id}" if owner is None else _name(owner).name
    return wrong(
        Cause.DUPLICATE_ID,
        name_together(name, map(_name, missing if owner is None else (owner, *missing))),
        f"two servos or more answer to id {item.dxl_id} at once, and spoil each other's answers{also}",
        "one of them was never given an id of its own",
        "connect only the servo that has the wrong id, then: "
        + ("palpate setup-motors" if target is None else f"palpate setup-motors --id {target.dxl_id}"),
    )


def _other_ids(missing: Sequence[RigServo], strangers: Sequence[FoundServo]) -> FindingOut:
    there = [
        f"id {item.dxl_id} at {item.baudrate} baud ({model_name(item.ping) or 'unknown model'})"
        for item in strangers
    ]
    verb = "does" if len(missing) == 1 else "do"
    return wrong(
        Cause.WRONG_ID,
        _name_servos(missing),
        f"{'it' if len(missing) == 1 else 'they'} {verb} not answer, and {join_words(there)}, which the rig "
        f"file does not have, {'does' if len(there) == 1 else 'do'}",
        "a servo has another id than the rig file says; new ones have id 1 at 57600 baud",
        f"palpate setup-motors --id {missing[0].dxl_id}",
    )


def _stranger(case: DiagnosisCase, item: FoundServo) -> FindingOut:
    name = f"servo {item.dxl_id} ({model_name(item.ping) or 'unknown model'})"
    return wrong(
        Cause.FOREIGN_SERVO,
        NamedDevice(name, (item.dxl_id,)),
        f"it answers at {item.baudrate} baud, and the rig file does not have it",
        "no run limits or guards it; only its torque is switched off with that of all others",
        f"unplug it, or describe it in {case.on_bench.path.name}",
    )


def _silent(missing: Sequence[RigServo]) -> FindingOut:
    one, ids = len(missing) == 1, join_words([str(servo.dxl_id) for servo in missing])
    return wrong(
        Cause.SERVO_SILENT,
        _name_servos(missing),
        f"{'it does' if one else 'they do'} not answer at any baud rate, and other servos do",
        "nothing reaches it, or it is broken" if one else "nothing reaches them",
        f"check supply and plugs on both sides of {'servo' if one else 'servos'} {ids}",
    )


def judge_models(_case: DiagnosisCase, readings: Readings) -> Judgement:
    """Servos that are of another model."""
    seen = readings.bus
    assert seen is not None, "the step needs answers"
    of_rig = {model_by_name(servo.model).number: servo.model for servo in seen.owned}
    models = {dxl_id: _model(item, of_rig) for dxl_id, item in seen.clear.items()}
    owned = [servo for servo in seen.owned if servo.dxl_id in models]
    other = [servo for servo in owned if models[servo.dxl_id] != servo.model]
    findings = [
        wrong(
            Cause.WRONG_MODEL,
            _name(servo),
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
    return saw, findings


def _why_other_model(servo: RigServo, models: dict[int, str], other: Sequence[RigServo]) -> str:
    for twin in other:
        if twin is not servo and models[twin.dxl_id] == servo.model and models[servo.dxl_id] == twin.model:
            return f"servos {servo.dxl_id} and {twin.dxl_id} may have each other's id"
    return "its limits of current and position would be wrong by the ratio of the models' units"


def _model(item: FoundServo, of_rig: Mapping[int, str]) -> str:
    """The name of a model: only the rig file's may be plug-ins', as no other plug-ins are loaded."""
    assert item.ping is not None
    number = item.ping.model_number
    return of_rig.get(number) or model_name(item.ping) or f"model number {number}"


def _name(servo: RigServo) -> NamedDevice:
    return name_servo(servo.owner, servo.dxl_id)


def _name_servos(servos: Sequence[RigServo]) -> NamedDevice:
    devices = [_name(servo) for servo in servos]
    return name_together(join_words([item.name for item in devices]), devices)
