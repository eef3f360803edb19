"""Readings of a run's arrays compared with what is declared of them: what differs is noted, once an array.

A run goes on after all of them; what an array shows that no contact makes may have passed for one, and the
answer says so.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from palpate.base.errors import quantity
from palpate.drivers.tactile import Disturbances, TactileFrame, find_disturbances
from palpate.rig.fingers import HostFinger

_NOISE_RATIO = 1.5  # between two tares of a run; gains, or what disturbs them, have changed
_CALIBRATED_NOISE_RATIO = 2.0  # to the calibrated noise, which is of other taxels together
_MIN_NOISE_COUNTS = 0.5  # below it rounding decides what is read
_WATCHED_FRAMES = 512  # of a grip that are looked through for disturbances
_NOTES = 3  # beside an error
_MIN_MOVED_TAXELS = 3  # zeros that have moved; fewer are a taxel's own noise
_RESTED_S = 0.1  # at the end of a grip, when tips are back where they wait


class ReadingChecks:
    """Checks of one run's arrays. `noted`: what was said, in the order of time."""

    def __init__(self, notice: Callable[[str], None]) -> None:
        self._notice = notice
        self._said: set[tuple[str, str]] = set()
        self._noise: dict[str, float] = {}
        self._usable: dict[str, int] = {}
        self._changing: dict[str, str] = {}
        self.noted: list[str] = []

    def check_tare(self, finger: HostFinger, frames: Sequence[TactileFrame]) -> None:
        """Look at the frames that an array was tared with, torque on."""
        if self.note_disturbance(finger, frames) is None:
            self._compare_noise(finger)

    def check_grip(self, finger: HostFinger, frames: Sequence[TactileFrame]) -> None:
        """Look at all frames of a grip that has ended, its tips back where they wait."""
        slow = self._changing.pop(finger.name, None)
        if not frames:
            return
        # most of a pad's taxels may be pressed
        pressed = finger.spec.tip.kind.has_face
        if not pressed and self.note_disturbance(finger, frames[:_WATCHED_FRAMES]) is not None:
            return
        if not self._compare_zeros(finger, frames) and slow is not None:  # a drift changes readings, too
            self._note(finger, slow)

    def note_disturbance(self, finger: HostFinger, frames: Sequence[TactileFrame]) -> str | None:
        """Note what no contact makes, and return its words; None if there is nothing."""
        extractor, most = finger.extractor, finger.array.description.max_count
        counts = np.stack([frame.counts for frame in frames])
        found = find_disturbances(counts, extractor.baseline.usable, most)
        words = _disturbance_words(found) if found else None
        if words is not None:
            self._note(finger, words)
        return words

    def explain(self, error: Exception, seen: Mapping[HostFinger, Sequence[TactileFrame]]) -> None:
        """Add to what ends a run what its arrays showed; zeros that have fallen, too: then tips feel less."""
        for finger, frames in seen.items():
            taxels, counts = finger.extractor.zero_shift(_newest(frames)) if frames else (0, 0.0)
            if counts < 0 and 2 * taxels > finger.array.description.taxels:
                self._compare_zeros(finger, frames)
        for line in self.noted[:_NOTES]:
            if line not in str(error):
                error.add_note(line)

    def keep_lag(self, finger: HostFinger, seconds: float, *, steady: bool) -> None:
        """Keep that an array's readings went on changing after its finger stood; `check_grip` notes it."""
        lag_s = finger.spec.array.lag_s
        rest = "which this run waits for" if steady else "so that its contact's force is not relied on"
        self._changing[finger.name] = (
            f"goes on changing for {seconds:.2f} s after its finger stands, {rest}, and array.lag_s = "
            f"{lag_s:g} is declared: its firmware filters, or its skin creeps; write lag_s = "
            f"{math.ceil(10 * (lag_s + seconds)) / 10:g}"
        )

    def _compare_noise(self, finger: HostFinger) -> None:
        baseline, taxels, name = finger.extractor.baseline, finger.spec.array.taxels, finger.name
        noise = baseline.noise_counts
        first = self._noise.setdefault(name, noise)
        known, ratio, when = first, _NOISE_RATIO, "when the run began"
        if taxels is not None:
            known, ratio, when = taxels.noise_counts, _CALIBRATED_NOISE_RATIO, "when it was calibrated"
        low, high = sorted((max(noise, _MIN_NOISE_COUNTS), max(known, _MIN_NOISE_COUNTS)))
        usable = int(baseline.usable.sum())
        if usable < self._usable.setdefault(name, usable):
            lost = self._usable[name] - usable
            self._note(
                finger,
                f"has {quantity(lost, 'taxel', 'taxels')} fewer that can be used than when the run began: at "
                "full scale or without change they are left out; run palpate doctor",
            )
        elif high > ratio * low:
            cause = (
                "run palpate doctor with the servos' supply off: if the noise goes, join the grounds"
                if noise > known
                else "its gain has changed, or its supply has sagged: check its supply"
            )
            self._note(finger, f"has a noise of {noise:.2g} counts, and {known:.2g} {when}: {cause}")

    def _compare_zeros(self, finger: HostFinger, frames: Sequence[TactileFrame]) -> bool:
        """Note zeros that have moved; True if they have."""
        taxels, counts = finger.extractor.zero_shift(_newest(frames))
        if taxels < _MIN_MOVED_TAXELS:
            return False
        allowed = finger.spec.array.drift_counts_per_s
        self._note(
            finger,
            f"does not come back to its zero: {quantity(taxels, 'taxel reads', 'taxels read')} up to "
            f"{abs(counts):.0f} counts {'less' if counts < 0 else 'more'} than before the grip, and "
            f"drift_counts_per_s = {allowed:g} allows less; let it warm up, then run palpate doctor",
        )
        return True

    def _note(self, finger: HostFinger, words: str) -> None:
        kind = finger.name, " ".join(words.split()[:3])
        if kind not in self._said:
            self._said.add(kind)
            line = f"tactile array {finger.name} {words}"
            self.noted.append(line)
            self._notice(line)


def _newest(frames: Sequence[TactileFrame]) -> list[TactileFrame]:
    return [frame for frame in frames if frame.device_time_s >= frames[-1].device_time_s - _RESTED_S]


def _disturbance_words(found: Disturbances) -> str:
    if found.common:
        return (
            f"jumps with all taxels together, by up to {found.common_counts:.0f} counts in {found.common} of "
            f"{found.frames} frames: interference, which passes for contacts; part its cable from the "
            "motors' and join the grounds"
        )
    if found.rows:
        rows = ", ".join(map(str, found.rows))
        return (
            f"jumps in whole rows ({rows}) by up to {found.row_counts:.0f} counts in "
            f"{sum(found.rows.values())} of {found.frames} frames: a line or its multiplexer is loose; check "
            "the cable between skin and electronics"
        )
    (row, col), times = max(found.taxels.items(), key=lambda item: item[1])
    return (
        f"has a loose wire: the taxel in row {row}, column {col} jumps in {times} of {found.frames} frames; "
        "repair it, or list it in array.taxels.unusable"
    )
