"""Conformance suites for plug-ins: arrays and servo models on emulated devices, and rigs that carry them.

    class TestBraille(ArrayConformance):
        protocol = "braille"
        keys = {"counts_per_n": 1000.0}

    class TestMyServo(ServoConformance):
        model = "XZ330-M999"

Every array driver must behave alike on its emulated device; every servo model needs a control table that the
host can use and an emulated servo that it can move; a rig file with them has to lead to right answers.
`rig_with_arrays` is the shipped rig with other arrays, `served` one served by another process.
"""

import json
import math
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
import pytest
import tomlkit

import palpate
from palpate.base.errors import DeviceError, InputError
from palpate.config import ArrayConfig, shipped_rig
from palpate.drivers.dynamixel import (
    ITEMS,
    Access,
    Bus,
    OperatingMode,
    Servo,
    model_by_name,
    model_by_number,
    specification,
)
from palpate.drivers.emulators import (
    EmulatedServo,
    FaultRates,
    FaultyWire,
    ServoChain,
    Taxels,
    WireRates,
    serve_pty,
)
from palpate.drivers.tactile import Mounting, Port, Shape
from palpate.drivers.transport import Device, Emission, MockHub, MonotonicClock, VirtualClock, open_port
from palpate.rig.arrays import ArrayPlugin, array_plugin

_TIP_RADIUS_MM = 8.5
_COUNTS_PER_N = 1000.0


class ArrayBench:
    """An emulated array on a mock wire in virtual time, with its driver, as finger "f1".

    It has 5 x 7 taxels of 3.4 mm round a tip of radius 8.5 mm, 1000 counts per N, 12 bits, and reads 50
    counts at rest. `force_n` (5, 7) presses on it; tests may change it, `wire.rates` and `wire.unplugged`.
    """

    def __init__(
        self,
        protocol: str,
        keys: Mapping[str, Any],
        *,
        baudrate_bps: int = 1_000_000,
        plugin: ArrayPlugin[Any] | None = None,
    ) -> None:
        """`keys`: those of the rig file that only this protocol has.

        `plugin` takes the place of the registered one. Raises InputError or pydantic's ValidationError if
        there is no such protocol or its keys are wrong.
        """
        table = {"port": "mock://f1", "baudrate_bps": baudrate_bps, "protocol": protocol, "gain_spread": 0.0}
        self.config = ArrayConfig.model_validate(table | dict(keys))
        self.plugin = plugin or array_plugin(protocol)
        self.tip_radius_mm = _TIP_RADIUS_MM
        truth = Mounting(Shape.CYLINDER, _TIP_RADIUS_MM, _COUNTS_PER_N).describe(
            (7, 5),
            (3.4, 3.4),
            unique_id=b"conformance",
            firmware="conformance",
            emulated=True,
            bit_depth=12,
            max_rate_hz=100.0,
        )
        self.force_n = np.zeros((5, 7))
        self.force_n[3, 1] = 1.0
        taxels = Taxels(truth, seed=2, noise_counts=1.0, offset_counts=50)
        assert self.plugin.emulated is not None, f"arrays of protocol {protocol} cannot be emulated"
        self.device = self.plugin.emulated(taxels, self.advance, self.config, _TIP_RADIUS_MM)
        self.wire = FaultyWire(self.device, 7)
        self.clock = VirtualClock()
        self.hub = MockHub(self.clock, "any")
        self.port = open_port(self.hub.attach("f1", self.wire, baudrate_bps), baudrate_bps)
        self.array = self.plugin.driver(
            cast("Port", self.port), self.clock, "f1", self.config, _TIP_RADIUS_MM
        )

        self.sampled_s: list[float] = []
        """Instants of all its samples."""

    def advance(self, now: float) -> None:
        """Let the device sample what is due until `now`."""
        while (due := self.device.next_sample_s()) is not None and due <= now:
            self.sampled_s.append(due)
            self.device.sample(due, self.force_n)

    def read_by(self, program: str) -> tuple[Any, bytes]:
        """Let a Python program read the device, in real time, at the port that is its first argument.

        Returns what it prints last, which is JSON, and all that the device sent. Needs pseudo-terminals.
        """
        clock, tapped = MonotonicClock(), _Tapped(self.device)
        self.device.restart(clock.now())
        with serve_pty({"f1": (tapped, self.config.baudrate_bps)}, clock, threading.Event()) as service:
            done = subprocess.run(
                [sys.executable, "-c", program, service.paths["f1"]],
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1]), tapped.sent


class _Tapped:
    """A device, and all that it has sent."""

    def __init__(self, device: Device) -> None:
        self._device, self.sent = device, b""
        self.next_due = device.next_due

    def feed(self, data: bytes, now: float) -> list[Emission]:
        return self._note(self._device.feed(data, now))

    def poll(self, now: float) -> list[Emission]:
        return self._note(self._device.poll(now))

    def _note(self, sent: list[Emission]) -> list[Emission]:
        self.sent += b"".join(data for _, data in sent)
        return sent


class ArrayConformance:
    """The suite: a subclass names `protocol` and the `keys` that a rig file has to give for it.

    `rate_hz`: a rate, at most 25, that the array can do at `baudrate_bps`. `keys` have to say 1000 counts
    per N where the array does not report it.
    """

    protocol: ClassVar[str]
    keys: ClassVar[Mapping[str, Any]] = {}
    baudrate_bps: ClassVar[int] = 1_000_000
    rate_hz: ClassVar[float] = 25.0

    @pytest.fixture
    def bench(self) -> ArrayBench:
        """A bench of its own for each test; not connected."""
        return ArrayBench(self.protocol, self.keys, baudrate_bps=self.baudrate_bps)

    @property
    def patience_s(self) -> float:
        """Time that a frame may take."""
        return 5 / self.rate_hz

    def test_describes_itself_as_often_as_it_is_asked(self, bench: ArrayBench) -> None:
        with pytest.raises(DeviceError, match=r"f1 on mock://\S+ .*call connect\(\)"):
            _ = bench.array.description
        described = bench.array.connect()
        assert described.problem() is None
        assert (described.rows, described.cols) == (5, 7)
        assert (described.shape, described.emulated, described.max_count) == (Shape.CYLINDER, True, 4095)
        np.testing.assert_allclose(np.diff(described.columns), 0.4, rtol=1e-6)
        assert math.isclose(described.counts_per_n, _COUNTS_PER_N)
        assert bench.array.connect() == described == bench.array.description

    def test_streams_frames_of_its_taxels_in_order(self, bench: ArrayBench) -> None:
        bench.array.connect()
        assert bench.array.frames() == []
        bench.array.start(self.rate_hz)
        frames = [bench.array.wait_frame(self.patience_s) for _ in range(30)]
        for frame in frames:
            assert frame.counts.shape == (5, 7)
            assert frame.counts.dtype == np.uint16
            assert abs(int(frame.counts[3, 1]) - 1050) < 10
            assert abs(np.delete(frame.counts.astype(int).ravel(), 3 * 7 + 1) - 50).max() < 10
        assert np.diff([frame.sequence for frame in frames]).tolist() == [1] * 29
        steps = np.diff([frame.device_time_s for frame in frames])
        host_steps = np.diff([frame.host_time_s for frame in frames])
        assert steps.mean() == pytest.approx(host_steps.mean(), rel=0.03)
        assert np.ptp(steps) < 0.003
        assert 1 / steps.mean() > 0.96 * self.rate_hz
        counters = bench.array.counters
        assert counters.frames == 30
        assert counters.lost == counters.faults == counters.misshapen == counters.dropped == 0

    def test_verbs_may_be_repeated_and_stopping_stops(self, bench: ArrayBench) -> None:
        bench.array.connect()
        bench.array.stop()
        for _ in range(2):
            bench.array.start(0.8 * self.rate_hz)
            bench.array.start(self.rate_hz)
            bench.array.wait_frame(self.patience_s)
            bench.array.stop()
            bench.array.stop()
        bench.clock.sleep(0.2)
        bench.array.frames()
        bench.clock.sleep(1.0)
        assert bench.array.frames() == []
        with pytest.raises(DeviceError, match=r"f1 on mock://\S+ sent no frame for 0\.1 s"):
            bench.array.wait_frame(0.1)

    @pytest.mark.parametrize("how", ["connect", "restart"])
    def test_connecting_and_a_restart_end_a_stream(self, bench: ArrayBench, how: str) -> None:
        bench.array.connect()
        bench.array.start(self.rate_hz)
        bench.clock.sleep(0.5)
        if how == "connect":
            bench.array.connect()
        else:
            bench.device.restart(bench.clock.now())
        bench.clock.sleep(0.2)
        bench.array.frames()
        bench.clock.sleep(0.5)
        assert bench.array.frames() == []

    def test_lost_frames_are_counted_and_show_in_the_numbers(self, bench: ArrayBench) -> None:
        bench.array.connect()
        bench.array.start(self.rate_hz)
        before = [bench.array.wait_frame(self.patience_s) for _ in range(10)]
        bench.wire.rates = WireRates(to_host=FaultRates(lost=1.0))
        bench.clock.sleep(5.25 / self.rate_hz)
        bench.array.frames()
        bench.wire.rates = WireRates()
        after = bench.array.wait_frame(self.patience_s)
        step_s = before[-1].device_time_s - before[-2].device_time_s
        missing = round((after.device_time_s - before[-1].device_time_s) / step_s) - 1
        assert missing >= 5
        assert bench.array.counters.lost == missing == after.sequence - before[-1].sequence - 1

    def test_rates_that_it_cannot_do_are_refused(self, bench: ArrayBench) -> None:
        limit = bench.array.connect().max_rate_hz
        for rate_hz in (0.0, -1.0, limit * 1.01):
            with pytest.raises(DeviceError, match=f"cannot sample at .* up to {limit:g} Hz"):
                bench.array.start(rate_hz)

    def test_silence_and_a_port_that_is_gone_are_named(self, bench: ArrayBench) -> None:
        bench.wire.rates = WireRates(to_host=FaultRates(lost=1.0))
        with pytest.raises(DeviceError, match=r"f1 on mock://\S+ does not answer; check"):
            bench.array.connect()
        assert bench.clock.now() < 12.0
        bench.wire.rates = WireRates()
        bench.array.connect()
        bench.array.start(self.rate_hz)
        bench.wire.unplugged = True
        array = bench.array
        for verb in (array.frames, array.stop, array.connect, lambda: array.wait_frame(0.1)):
            with pytest.raises(DeviceError, match=r"f1 on mock://\S+ is gone"):
                verb()


class FreeRunningConformance(ArrayConformance):
    """The suite of arrays that send by themselves; `keys` say `rate_hz` like the class.

    They have to make 5 x 7 cells where the bench has them, in columns 22.918° apart; or the class says how
    many there are (`shape`) and which one is nearest to the bench's cell (3, 1), `pressed`.
    """

    shape: ClassVar[tuple[int, int]] = (5, 7)
    pressed: ClassVar[tuple[int, int]] = (3, 1)

    def test_describes_itself_as_often_as_it_is_asked(self, bench: ArrayBench) -> None:
        described = bench.array.connect()
        assert described.problem() is None
        assert (described.rows, described.cols, described.emulated) == (*self.shape, True)
        assert bench.array.connect() == described == bench.array.description

    def test_streams_frames_of_its_taxels_in_order(self, bench: ArrayBench) -> None:
        bench.force_n[:] = 0
        bench.array.connect()
        assert bench.array.frames() == []
        bench.array.start(self.rate_hz)
        rest = [bench.array.wait_frame(self.patience_s) for _ in range(10)]
        bench.force_n[3, 1] = 0.5
        bench.clock.sleep(self.patience_s)
        bench.array.frames()
        frames = [bench.array.wait_frame(self.patience_s) for _ in range(30)]
        assert all(frame.counts.shape == self.shape and frame.counts.dtype == np.uint16 for frame in frames)
        grown = np.mean([f.counts for f in frames], axis=0) - np.mean([f.counts for f in rest], axis=0)
        assert np.unravel_index(grown.argmax(), grown.shape) == self.pressed
        assert np.diff([frame.sequence for frame in frames]).tolist() == [1] * 29
        counters = bench.array.counters
        assert counters.lost == counters.faults == counters.misshapen == counters.dropped == 0

    def test_a_frame_was_sampled_within_its_age(self, bench: ArrayBench) -> None:
        bench.array.connect()
        bench.array.start(self.rate_hz)
        frames = []
        for wait_s in np.random.default_rng(3).uniform(0.0, 0.2, 60):
            bench.clock.sleep(float(wait_s))
            frames += bench.array.frames()
        if frames[0].age_s is None:
            return  # its stamps say when
        host = np.array([frame.host_time_s for frame in frames])
        age, sampled = np.array([frame.age_s for frame in frames]), np.array(bench.sampled_s)
        on_wire = [sampled[len(sampled) - k - len(frames) : len(sampled) - k] for k in range(4)]
        assert any(((host - age <= each) & (each <= host)).all() for each in on_wire)

    @pytest.mark.parametrize("how", ["connect"])
    def test_connecting_and_a_restart_end_a_stream(self, bench: ArrayBench, how: str) -> None:
        super().test_connecting_and_a_restart_end_a_stream(bench, how)

    def test_lost_frames_are_counted_and_show_in_the_numbers(self, bench: ArrayBench) -> None:
        bench.array.connect()
        bench.array.start(self.rate_hz)
        if bench.array.wait_frame(self.patience_s).age_s is None:
            super().test_lost_frames_are_counted_and_show_in_the_numbers(bench)


_BAUD = 1_000_000
_STEP_S = 1e-3
_SOME_MODELS_LACK = {"PWM Slope", "LED"}


@dataclass
class ServoBench:
    """One emulated servo with ID 1 on a mock bus in virtual time, and its driver."""

    model: str
    load_nm: float = 0.0

    def __post_init__(self) -> None:
        self.emulated = EmulatedServo(1, model=self.model)
        self.clock = VirtualClock()
        self._stepped_s = 0.0
        self.hub = MockHub(self.clock, "servo")
        url = self.hub.attach("bus", ServoChain([self.emulated], self._advance), _BAUD)
        self.bus = Bus(open_port(url, _BAUD), self.clock, _BAUD, latency_s=1e-3)
        self.servo = Servo(self.bus, 1, self.model)

    def _advance(self, now: float) -> None:
        while self._stepped_s + _STEP_S <= now:
            self.emulated.step(_STEP_S, self.load_nm)
            self._stepped_s += _STEP_S


class ServoConformance:
    """The suite: a subclass names `model` as a rig file does."""

    model: ClassVar[str]

    @pytest.fixture
    def bench(self) -> Iterator[ServoBench]:
        """A bench of its own for each test."""
        bench = ServoBench(self.model)
        yield bench
        bench.bus.close()

    def test_is_registered_under_its_own_name(self) -> None:
        assert specification(self.model).name == self.model

    def test_items_do_not_overlap_and_can_hold_their_values(self) -> None:
        described = specification(self.model)
        for firmware in (described.firmware, described.extended_firmware, 255):
            items = sorted(described.items(firmware), key=lambda item: item.address)
            assert len({item.name for item in items}) == len(items)
            for item, following in zip(items, [*items[1:], None], strict=True):
                assert item.size in (1, 2, 4), item
                assert following is None or item.address + item.size <= following.address, item
                lowest = -(1 << 8 * item.size - 1) if item.signed else 0
                highest = (1 << 8 * item.size - item.signed) - 1
                assert lowest <= item.low <= item.high <= highest, item
                if item.access is Access.RW:
                    assert item.low <= item.default <= item.high, item

    def test_has_what_the_host_reads_and_writes_where_the_x_series_has_it(self) -> None:
        described = specification(self.model)
        items = {item.name: item for item in described.items(255)}
        missing = ITEMS.keys() - items.keys() - _SOME_MODELS_LACK
        assert not missing
        for name in ITEMS.keys() & items.keys():
            assert (items[name].address, items[name].size) == (ITEMS[name].address, ITEMS[name].size), name
        assert items["Model Number"].default == described.number

    def test_agrees_with_the_table_of_the_vendors_sdk_if_that_has_the_model(self) -> None:
        described = specification(self.model)
        try:
            vendor = model_by_number(described.number, described.firmware).items
        except InputError:
            return
        for item in described.items(described.firmware):
            if item.name in vendor:
                assert (item.address, item.size) == (vendor[item.name].address, vendor[item.name].size), item

    def test_answers_as_its_model_and_reports_its_firmware(self, bench: ServoBench) -> None:
        answer = bench.servo.check()
        described = specification(self.model)
        assert (answer.model_number, answer.firmware) == (described.number, described.firmware)
        assert bench.servo.model == model_by_name(self.model, described.firmware)

    def test_moves_to_a_goal_and_holds_it_against_a_load(self, bench: ServoBench) -> None:
        bench.servo.check()
        largest_a = bench.servo.model.largest_current_a
        bench.servo.prepare(OperatingMode.POSITION, largest_a)
        bench.servo.set_profile(2.0, 20.0)
        bench.servo.enable_torque()
        bench.servo.write("Goal Position", bench.servo.model.zero_tick + 1024)
        bench.clock.sleep(2.0)
        bench.load_nm = 0.1 * specification(self.model).motor.stall_torque_nm
        bench.clock.sleep(1.0)
        bench.servo.read("Present Position")
        assert bench.emulated.shaft_rad == pytest.approx(math.pi / 2, abs=0.1)

    def test_values_that_it_does_not_take_are_refused_before_they_are_sent(self, bench: ServoBench) -> None:
        limit = specification(self.model).items(255)
        highest = next(item.high for item in limit if item.name == "Current Limit")
        with pytest.raises(ValueError, match="Current Limit"):
            bench.servo.write("Current Limit", highest + 1)


class RigConformance:
    """Runs of a rig file whose devices are emulated: a subclass names the file, and `seeds` of runs.

    What stands on the bench, where, and all that the file bounds is drawn by the seed and hidden.
    """

    rig: ClassVar[Path]
    seeds: ClassVar[tuple[int, ...]] = (11,)

    @pytest.mark.campaign
    def test_parts_are_identified_within_their_bounds(self, tmp_path: Path) -> None:
        for seed in self.seeds:
            with palpate.open_rig(self.rig, seed=seed) as rig:
                answer = rig.identify(sessions=tmp_path)
            truth = json.loads(answer.to_json())["truth"]
            found = answer.verdict, truth["named"], truth["inside_bounds"]
            assert found == ("identified", True, True), f"seed {seed}"


_PALPATE = Path(sys.executable).with_name("palpate")


def rig_with_arrays(folder: Path, protocol: str, keys: Mapping[str, Any], rate_hz: float = 250.0) -> Path:
    """Write the shipped emulated rig with arrays of `protocol` on all fingers; returns the new file.

    `keys`: what each array's table has to say beside the protocol. `rate_hz`: frames a second of an array.
    """
    rig = tomlkit.parse(shipped_rig().read_text(encoding="utf-8")).unwrap()
    rig["closing"]["sample_rate_hz"] = rate_hz
    for finger in rig["fingers"]:
        finger["array"] |= {"protocol": protocol, **keys}
    file = folder / f"{protocol}.toml"
    file.write_text(tomlkit.dumps(rig), encoding="utf-8")
    return file


@contextmanager
def served(folder: Path, *args: object) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """Run `palpate emulate` with `args` in `folder`: its process, and the JSON object that it prints.

    With `--pty`, commands in other processes can take the emulated rig for a real one. Ended as by Ctrl-C.
    """
    process = subprocess.Popen(
        [str(_PALPATE), "emulate", *map(str, args)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        printed = json.loads(process.stdout.readline())
        assert isinstance(printed, dict)
        yield process, printed
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=10)
        finally:
            process.kill()
