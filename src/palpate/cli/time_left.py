"""Time left of work that says how far it is: "touch 3 of 40" becomes "touch 3 of 40 (about 2 min left)"."""

import re
import time
from collections.abc import Callable

__all__ = ["TimeLeft", "duration_words"]

_COUNT = re.compile(r"(\d+) of (\d+)")
_FIRST_S = 2.0  # of counting, before anything is said of the rest


class TimeLeft:
    """Estimates from the pace so far; a count goes on while its words and its end stay the same."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._count: tuple[str, int] | None = None
        self._begun = 0, 0.0
        self._newest = 0

    def after(self, words: str) -> str:
        """The words, with the time left after the first count in them."""
        found = _COUNT.search(words)
        if found is None:
            return words
        done, total = int(found[1]), int(found[2])
        now, count = self._now_s(), (words[: found.start()], total)
        if count != self._count or done < self._newest:
            self._count, self._begun = count, (done, now)
        self._newest = done
        first, begun_s = self._begun
        if done == first or now - begun_s < _FIRST_S:
            return words
        left_s = (now - begun_s) / (done - first) * (total - done)
        return f"{words[: found.end()]} (about {duration_words(left_s)} left){words[found.end() :]}"


def duration_words(seconds: float) -> str:
    """A duration as people say it: 40 s, 3 min, 1 h 20 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
