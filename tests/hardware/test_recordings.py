"""What is told from the frames of an array at rest."""

import numpy as np

from palpate.base.geometry import Counts
from palpate.drivers.tactile.description import Mounting, Shape
from palpate.drivers.tactile.frames import ArrayCounters, TactileFrame
from palpate.rig.diagnostics.array_examination import (
    frame_rate_hz,
    is_loss_too_high,
    is_rate_too_low,
    lost_frames,
)
from palpate.rig.diagnostics.taxel_steps import UntouchedStatistics, analyse_untouched
from palpate.testing.hardware.bench import ArrayRecording

DESCRIBED = Mounting(Shape.CYLINDER, 8.5, 1000.0).describe(
    (7, 5), (3.4, 3.4), unique_id=b"rest", firmware="1", emulated=True, bit_depth=12, max_rate_hz=100.0
)


def recording(counts: Counts) -> ArrayRecording:
    frames = tuple(TactileFrame(10 + k, 0.02 * k, 0.02 * k + 0.005, frame) for k, frame in enumerate(counts))
    return ArrayRecording(DESCRIBED, frames, 0)


def at_rest(noise_counts: float) -> Counts:
    rest = 50 + noise_counts * np.random.default_rng(5).standard_normal((250, 5, 7))
    return np.rint(rest).astype(np.uint16)


def bad(counts: Counts) -> list[list[int]]:
    shown = shown_of(counts)
    return np.argwhere(shown.dead | shown.hot | shown.unsteady).tolist()


def shown_of(counts: Counts) -> UntouchedStatistics:
    shown = analyse_untouched(recording(counts).frames, DESCRIBED.max_count, 0.0)
    assert shown is not None
    return shown


def test_bad_taxels_are_those_that_never_change_or_are_at_the_top() -> None:
    counts = at_rest(2.0)
    counts[:, 1, 2] = 0
    counts[:, 4, 6] = DESCRIBED.max_count
    assert bad(counts) == [[1, 2], [4, 6]]


def test_a_sound_array_has_none() -> None:
    assert bad(at_rest(2.0)) == []
    assert shown_of(at_rest(2.0)).tells_dead


def test_an_array_without_noise_does_not_tell_but_a_taxel_at_the_top_does() -> None:
    counts = at_rest(0.0)
    assert not shown_of(counts).tells_dead
    counts[:, 0, 3] = DESCRIBED.max_count
    assert bad(counts) == [[0, 3]]


def test_rate_and_noise() -> None:
    found = recording(at_rest(2.0))
    assert abs(frame_rate_hz(found.frames) - 50.0) < 1e-6
    assert 1.8 < found.noise_counts() < 2.2
    assert not is_rate_too_low(47.6, 50.0)
    assert is_rate_too_low(47.4, 50.0)
    assert frame_rate_hz(found.frames[:1]) == 0.0


def test_a_few_frames_may_get_lost() -> None:
    assert lost_frames(ArrayCounters(0, 0, 1, 0, 0), ArrayCounters(200, 1, 3, 3, 9)) == 6
    assert [is_loss_too_high(gone, came) for gone, came in ((1, 100), (2, 100), (5, 995), (6, 994))] == [
        False,
        True,
        False,
        True,
    ]
