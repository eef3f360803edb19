"""What is told from the frames of an array at rest."""

import numpy as np

from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import ArrayCounters, TactileFrame
from palpate.drivers.tactile.mounting import Mounting
from palpate.geometry import Counts
from palpate.testing.hardware.bench import Recording

DESCRIBED = Mounting(Shape.CYLINDER, 8.5, 1000.0).describe(
    (7, 5), (3.4, 3.4), unique_id=b"rest", firmware="1", emulated=True, bit_depth=12, max_rate_hz=100.0
)


def recording(counts: Counts) -> Recording:
    frames = tuple(TactileFrame(10 + k, 0.02 * k, 0.02 * k + 0.005, frame) for k, frame in enumerate(counts))
    return Recording(DESCRIBED, frames, ArrayCounters(len(frames), 0, 0, 0, 0))


def at_rest(noise_counts: float) -> Counts:
    rest = 50 + noise_counts * np.random.default_rng(5).standard_normal((250, 5, 7))
    return np.rint(rest).astype(np.uint16)


def test_stuck_taxels_are_those_that_never_change_or_are_at_the_top() -> None:
    counts = at_rest(2.0)
    counts[:, 1, 2] = 0
    counts[:, 4, 6] = DESCRIBED.max_count
    found = recording(counts).stuck()
    assert found is not None
    assert np.argwhere(found).tolist() == [[1, 2], [4, 6]]


def test_a_sound_array_has_none() -> None:
    found = recording(at_rest(2.0)).stuck()
    assert found is not None
    assert not found.any()


def test_an_array_without_noise_does_not_tell_but_a_taxel_at_the_top_does() -> None:
    counts = at_rest(0.0)
    assert recording(counts).stuck() is None
    counts[:, 0, 3] = DESCRIBED.max_count
    found = recording(counts).stuck()
    assert found is not None
    assert np.argwhere(found).tolist() == [[0, 3]]


def test_rate_and_noise() -> None:
    found = recording(at_rest(2.0))
    assert abs(found.rate_hz - 50.0) < 1e-6
    assert 1.8 < found.noise_counts() < 2.2


def test_lost_frames_do_not_slow_the_rate() -> None:
    whole = recording(at_rest(2.0))
    holed = Recording(DESCRIBED, (*whole.frames[:100], *whole.frames[150:]), whole.counters)
    assert abs(holed.rate_hz - 50.0) < 1e-6
