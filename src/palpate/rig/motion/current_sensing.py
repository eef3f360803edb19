"""Sensing without arrays: forces on the tip of a finger on a slide, by its servos' Present Current.

A `CurrentSensor` stands where a finger's array would: its frames say what friction cannot explain (`SENSED`),
and the most that may press on the tip (`MOST`). Both are of the force's component along the slide, by the
slide's current, and of that across, by the aim's.

*Free space.* Going outwards or back, the slide needs between lo and hi (`friction_n`); at rest friction holds
either way, with hi at most; so does that of the aim, which rests. What accelerates a servo is not friction:
while it may still speed up, nothing is sensed. A contact is there from where either current is beyond its
bound, and what may have pressed before is `CurrentSensingConfig.hidden_n` at most. On its way back from the
part, and before a grip, a finger is in free space: there such a current is an error.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from palpate.base.errors import DeviceError
from palpate.config import CurrentSensingConfig, FingerConfig, RigFile, SlideFingerConfig
from palpate.drivers.dynamixel import Servo, ServoState, StateSampler
from palpate.drivers.kinematics import TICK_RAD
from palpate.drivers.tactile import (
    ArrayCounters,
    Baseline,
    ContactExtractor,
    ContactPatch,
    Description,
    Shape,
    TactileFrame,
    TipCalibration,
)
from palpate.rig.mechanisms.mechanism import ACCELERATION_RAD_S2

SENSED, MOST, _SAMPLE = range(3)  # columns of a frame; the last one counts samples: none repeats another
_COUNTS_PER_N = 1000.0
_MAX_COUNT = (1 << 16) - 1
_SETTLING_S = 0.1  # after a servo has sped up by its profile
_REST_S = 0.1  # without a step, after which a servo rests: the slowest touch takes a third of it for one
_STEPS_BACK = 2  # that a servo at rest is not read behind where it was


class CurrentSensor:
    """The sensor of one finger: an `ArrayDriver` whose frames `sampler` makes of its servos' states."""

    silence = "nothing"

    def __init__(
        self, rig: RigFile, spec: FingerConfig, servos: tuple[Servo, Servo], sampler: StateSampler
    ) -> None:
        """`servos`: aim and slide. `blind_mm`: the way on which a finger speeds up and senses nothing."""
        assert isinstance(spec.array, CurrentSensingConfig)
        assert isinstance(spec, SlideFingerConfig)
        self._contact_n = rig.closing.contact_force_n
        self.aim, self.slide = servos
        self._bounds, self._sampler = spec.array, sampler
        self._zero_mm = spec.slide.zero_mm + spec.slide.mm_per_rad * math.pi
        self._mm_per_rad, self._gear_ratio = spec.slide.mm_per_rad, spec.aim.gear_ratio
        closing = rig.closing
        speed_up_s = _SETTLING_S + max(closing.approach_speed_mm_s, closing.retract_mm_s) / (
            ACCELERATION_RAD_S2 * abs(self._mm_per_rad)
        )
        self.blind_mm = closing.approach_speed_mm_s * speed_up_s
        self._motion = _SlideMotion(self._mm_per_rad * TICK_RAD, speed_up_s)
        self._name, self._shown = spec.name, (0.0, 0.0)
        self._waiting: deque[TactileFrame] = deque()
        self._count = 0
        self.description = Description(
            unique_id=b"present-current"[:8] + bytes([self.aim.dxl_id, self.slide.dxl_id]) + bytes(6),
            firmware="",
            emulated=rig.emulated,
            shape=Shape.FREE,
            rows=1,
            cols=3,
            bit_depth=16,
            max_rate_hz=1000.0,
            full_scale_n=_MAX_COUNT / _COUNTS_PER_N,
            counts_per_n=_COUNTS_PER_N,
            tip_radius_mm=0.0,
            columns=(),
            row_heights_mm=(),
            geometry=(0.0, 0.0, 0.0, 1.0, 0.0, 0.0) * 3,
        )

    @property
    def counters(self) -> ArrayCounters:
        """Frames taken; none is lost."""
        return ArrayCounters(self._count, 0, 0, 0, 0)

    def connect(self) -> Description:
        """Return what it is; nothing is sent."""
        return self.description

    def start(self, rate_hz: float) -> None:
        """Sample from now on."""
        self._sampler.start((self.aim, self.slide), self.note, rate_hz)

    def stop(self) -> None:
        """Sample no more."""
        self._sampler.stop(self.note)
        self._waiting.clear()

    def frames(self) -> list[TactileFrame]:
        """Frames since the last call; servos are read if a sample is due."""
        self._sampler.sample_if_due()
        taken = list(self._waiting)
        self._waiting.clear()
        return taken

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """The oldest frame that was not taken."""
        while not self._waiting:
            if self._sampler.wait() > timeout_s:
                raise DeviceError("no frame of Present Current is due: sampling was not started")
            self._sampler.sample_if_due()
        return self._waiting.popleft()

    def note(self, states: Mapping[int, ServoState], asked_s: float, read_s: float) -> None:
        """Make a frame of states, by id, that were asked for and read at two instants."""
        aim, slide = states[self.aim.dxl_id], states[self.slide.dxl_id]
        at_mm = self._zero_mm + self._mm_per_rad * slide.position_rad
        self._motion.see(at_mm, aim.position_rad, read_s)
        sensed, most = self._forces_n(aim, slide, at_mm)
        self._count += 1
        counts = np.minimum(np.ceil(np.array([[sensed, most, 0.0]]) * _COUNTS_PER_N), _MAX_COUNT)
        counts[0, _SAMPLE] = self._count % _MAX_COUNT
        self._waiting.append(TactileFrame(self._count, asked_s, read_s, counts.astype(np.uint16)))

    def check_free(self) -> None:
        """Raise DeviceError if servos show more than is declared; nothing may touch."""
        self._check(*self._shown, "to hold")

    def _check(self, along_n: float, turning_nmm: float, doing: str) -> None:
        high, most = self._bounds.friction_n[1], self._bounds.aim_friction_nmm
        if along_n > high:
            seen, declared = f"its slide needs {along_n:.2f} N {doing}", f"friction_n = {high:g} N"
        elif turning_nmm > most:
            seen, declared = f"its aim needs {turning_nmm:.0f} N mm {doing}", f"aim_friction_nmm = {most:g}"
        else:
            return
        raise DeviceError(
            f"finger {self._name}: {seen} in free space, beyond the declared {declared}: such friction would "
            "pass for a contact; see what rubs, and if nothing does, declare more in its [fingers.array]"
        )

    def _forces_n(self, aim: ServoState, slide: ServoState, at_mm: float) -> tuple[float, float]:
        """The force that friction does not explain, at most, 0 if there is none; and the most at rest."""
        bounds, motion = self._bounds, self._motion
        low, high = bounds.friction_n
        along = 1e3 * slide.current_a * self.slide.model.known_torque.nm_per_a / self._mm_per_rad
        turning = 1e3 * abs(aim.current_a * self.aim.model.known_torque.nm_per_a * self._gear_ratio)
        across = (turning + bounds.aim_friction_nmm) / max(at_mm, 1.0)
        scale = 1 + bounds.gain_spread
        most = scale * math.hypot(max(along + high, 0.0), across)
        self._shown = along, turning
        if motion.is_steady_back:
            self._check(-along, turning, "on its way back")
        if motion.is_starting or not (along > high or turning > bounds.aim_friction_nmm):
            return 0.0, most
        sensed = scale * math.hypot(max(along - low, 0.0), across) if motion.is_outward else most
        return max(sensed, self._contact_n + 1 / _COUNTS_PER_N), most


class _SlideMotion:
    """Motion of a slide as its positions tell: outwards, back, or at rest.

    `speed_up_s`: time that it takes to speed up, and to come to rest from going back.
    """

    def __init__(self, step_mm: float, speed_up_s: float) -> None:
        self._step_mm, self._speed_up_s = abs(step_mm), speed_up_s
        self._at_mm, self._aim_rad = math.inf, math.nan
        self._now = self._begun_s = self._backed_s = -math.inf
        self._moved_s = {1: -math.inf, -1: -math.inf}

    def see(self, at_mm: float, aim_rad: float, now: float) -> None:
        """Note where slide and aim are."""
        self._now = now
        turned = not abs(aim_rad - self._aim_rad) <= _STEPS_BACK * TICK_RAD
        if turned and not self.is_outward:  # on its way out a contact may push the aim aside
            self._begun_s = now
        if turned or self.is_outward:
            self._aim_rad = aim_rad
        gone_mm = at_mm - self._at_mm
        if gone_mm < -(_STEPS_BACK + 0.5) * self._step_mm:
            self._go(-1, at_mm)
        elif gone_mm > self._step_mm / 2:
            self._go(1, at_mm)

    def _go(self, way: int, at_mm: float) -> None:
        self._at_mm = at_mm
        if not self._moves(way):
            self._begun_s = self._now
        self._moved_s = {way: self._now, -way: -math.inf}
        if way < 0:
            self._backed_s = self._now

    def _moves(self, way: int) -> bool:
        return self._now - self._moved_s[way] <= _REST_S

    @property
    def is_outward(self) -> bool:
        """True if it has just come further out."""
        return self._moves(1)

    @property
    def is_starting(self) -> bool:
        """True if a servo may still speed up, goes back, or has not come to rest from that."""
        return self._now - max(self._begun_s, self._backed_s) < self._speed_up_s

    @property
    def is_steady_back(self) -> bool:
        """True if it goes back, and has sped up."""
        return self._moves(-1) and self._now - self._begun_s >= self._speed_up_s


class CurrentExtractor(ContactExtractor):
    """Contacts of a `CurrentSensor`: somewhere on the tip, with the force that its frames say."""

    def __init__(self, description: Description) -> None:
        usable = np.zeros((1, 3), dtype=bool)
        usable[0, SENSED] = True
        gain = np.ones((1, 3))
        super().__init__(description, TipCalibration(gain, gain_spread=0.0, noise_counts=0.0, usable=usable))

    def tare(self, frames: Sequence[TactileFrame]) -> Baseline:  # noqa: ARG002
        """Keep the zero: friction's bound is declared, and at rest currents do not show it."""
        return self.baseline

    def is_changing(self, earlier: Sequence[TactileFrame], later: Sequence[TactileFrame]) -> bool:  # noqa: ARG002
        """Return False: how friction shares the load at rest does not matter."""
        return False

    def extract(self, frames: TactileFrame | Sequence[TactileFrame]) -> ContactPatch | None:
        """A contact anywhere on the tip; at rest nothing says that there is none."""
        every = [frames] if isinstance(frames, TactileFrame) else frames
        half_n = max(int(frame.counts[0, MOST]) for frame in every) / _COUNTS_PER_N / 2
        nowhere = (math.nan,) * 3
        return ContactPatch(
            angle_rad=0.0,
            angle_half_range_rad=math.pi,
            centroid_rad=math.nan,
            centroid_bound_rad=math.pi,
            position_mm=nowhere,
            position_bound_mm=(math.inf,) * 3,
            height_mm=math.nan,
            height_bound_mm=math.inf,
            force_n=half_n,
            force_bound_n=half_n,
            extent_rad=0.0,
            area_mm2=0.0,
        )
