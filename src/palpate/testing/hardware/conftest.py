"""Fixtures of the hardware tests. A device of the rig file that does not answer is an error in them."""

from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from typing import NoReturn

import pytest

from palpate.base.errors import DeviceError
from palpate.config import FingerConfig, RigFile, RigOnBench, RigServo
from palpate.rig.bench import connect, set_up
from palpate.rig.diagnostics.diagnosis import STEPS, Diagnosis, diagnose
from palpate.rig.diagnostics.host_ports import Computer
from palpate.rig.diagnostics.servo_bus import endpoint_of_rig, list_servos
from palpate.rig.diagnostics.steps import DiagnosisCase
from palpate.rig.motion.hand import Hand
from palpate.testing.hardware.bench import AirPaths, Note, air_paths
from palpate.testing.hardware.plugin import RIG, ask_to_move

LISTEN_S = 5.0
"""How long all arrays stream at once."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One test for each step and each device that it judges, and for the rig as a whole."""
    found = metafunc.config.stash.get(RIG, None)
    servos = () if found is None else list_servos(found.rig)
    arrays = () if found is None else found.rig.fingers
    if "wanted_servo" in metafunc.fixturenames:
        metafunc.parametrize("wanted_servo", servos or [None], ids=[*map(_name, servos)] or ["no rig"])
    if "step" in metafunc.fixturenames:
        devices = {"servo": servos, "array": arrays, None: ()}
        pairs = [(step, device) for step in STEPS for device in (None, *devices[step.about])]
        ids = ["-".join(filter(None, (step.name, _name(device)))).replace(" ", "-") for step, device in pairs]
        metafunc.parametrize(("step", "device"), pairs, ids=ids)


def _name(device: RigServo | FingerConfig | None) -> str:
    if isinstance(device, RigServo):
        return f"{device.dxl_id}-{device.owner.replace(' ', '-')}"
    return "" if device is None else device.name


@pytest.fixture
def note(request: pytest.FixtureRequest) -> Note:
    """Notes a figure: a property of the test in JUnit files of either family, and a line at the end."""

    def add(name: str, value: object) -> None:
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        request.node.user_properties.append((name, shown))

    return add


@pytest.fixture(scope="session")
def on_bench(
    pytestconfig: pytest.Config, record_testsuite_property: Callable[[str, object], None]
) -> RigOnBench:
    """The rig under test, with its calibration."""
    found = pytestconfig.stash[RIG]
    rig = found.rig
    record_testsuite_property("palpate", version("palpate"))
    record_testsuite_property("rig", rig.name)
    record_testsuite_property("bus", f"{rig.bus.port} at {rig.bus.baudrate_bps} baud")
    record_testsuite_property("sample_rate_hz", rig.closing.sample_rate_hz)
    record_testsuite_property("calibrated", found.calibration is not None)
    return found


@pytest.fixture(scope="session")
def rig(on_bench: RigOnBench) -> RigFile:
    """The rig under test as runs know it."""
    return on_bench.rig


@pytest.fixture(autouse=True)
def permission(request: pytest.FixtureRequest) -> None:
    """Say what moves and ask for it, before anything of the test happens."""
    marker = request.node.get_closest_marker("moves")
    if marker is not None:
        ask_to_move(request.config, request.node.name, marker.args[0])


@pytest.fixture(scope="session")
def diagnosis(on_bench: RigOnBench) -> Diagnosis:
    """A diagnosis of the rig, once."""
    place = endpoint_of_rig(on_bench.described)
    return diagnose(DiagnosisCase(on_bench, place, Computer(), listen_s=LISTEN_S), datetime.now(UTC))


@pytest.fixture
def servo(wanted_servo: RigServo, diagnosis: Diagnosis) -> RigServo:
    """A servo that answers as the rig file says; an error if it does not."""
    bus = diagnosis.readings.bus
    if bus is None or wanted_servo.dxl_id not in bus.sound:
        _missing(f"servo {wanted_servo.dxl_id} ({wanted_servo.owner}) does not answer as the rig file says")
    return wanted_servo


@pytest.fixture
def resting_hand(rig: RigFile) -> Iterator[Hand]:
    """The hand, connected, torque off; an error if a device is missing. Torque is off at the end."""
    try:
        connected = connect(set_up(rig, (), 0))
    except DeviceError as error:
        _missing(error)
    with connected:
        yield connected


@pytest.fixture
def hand(resting_hand: Hand) -> Hand:
    """The hand, torque on where everything stands; an error if fingers stand where they must not start."""
    try:
        resting_hand.prepare()
    except DeviceError as error:
        _missing(error)
    return resting_hand


@pytest.fixture(scope="session")
def ways(rig: RigFile) -> AirPaths:
    """Ways of all fingers in from where they wait."""
    return air_paths(rig)


def _missing(reason: object) -> NoReturn:
    """An error of the test's set-up, in one line."""
    pytest.fail(str(reason), pytrace=False)
