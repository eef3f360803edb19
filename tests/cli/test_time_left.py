"""Time left of long work, estimated from the counts that it tells."""

from hypothesis import given
from hypothesis import strategies as st

from palpate.cli.terminal import TimeLeft, duration_words


class Watch:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@given(st.integers(2, 500), st.integers(1, 120))
def test_an_even_pace_is_predicted_exactly(total: int, quarters: int) -> None:
    watch = Watch()
    left, pace_s = TimeLeft(watch), quarters / 4
    for done in range(1, total + 1):
        words = left.after(f"placing, touch {done} of {total} by f1")
        expected = duration_words(pace_s * (total - done))
        if done > 1 and pace_s * (done - 1) >= 2.0 + 1e-6:
            assert words == f"placing, touch {done} of {total} (about {expected} left) by f1"
        elif pace_s * (done - 1) < 2.0 - 1e-6:
            assert words == f"placing, touch {done} of {total} by f1"
        watch.now_s += pace_s


def test_each_count_has_its_own_pace() -> None:
    watch = Watch()
    left = TimeLeft(watch)
    said = []
    for words in (
        "press 1 of 3",
        "press 2 of 3",
        "press 3 of 3",
        "press 1 of 3",
        "touch 2 of 3",
        "touch 3 of 3",
    ):
        said.append(left.after(words))
        watch.now_s += 5.0
    assert said == [
        "press 1 of 3",
        "press 2 of 3 (about 5 s left)",
        "press 3 of 3 (about 0 s left)",
        "press 1 of 3",
        "touch 2 of 3",
        "touch 3 of 3 (about 0 s left)",
    ]
    assert left.after("12 of them, 7 taxels of 8") == "12 of them, 7 taxels of 8"


def test_durations_are_said_as_people_do() -> None:
    assert [duration_words(value) for value in (0.4, 89.4, 90, 5399, 5400)] == [
        "0 s",
        "89 s",
        "2 min",
        "1 h 30 min",
        "1 h 30 min",
    ]
