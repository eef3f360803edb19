"""Recordings of arrays, and their page."""

import math
import re
import runpy
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.base.geometry import Counts
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Mounting, Shape
from palpate.drivers.tactile.frames import ArrayCounters, TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, Patches, PatchFlag, TipCalibration
from palpate.rig.diagnostics.array_examination import (
    UntouchedStatistics,
    analyse_untouched,
    count_lost_frames,
    frame_rate_hz,
    is_loss_too_high,
    is_rate_too_low,
)
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES, ROOT
from support.oracles.array_contacts import (
    TARE_FRAMES,
    Session,
    cylinder_session,
    describe,
    frames_of,
    pad_session,
    tared,
)

# ----------------------------------------------------------------------------------------------------
# Whole recordings in one call: they say what frames say one by one, wherever they are cut.

SESSIONS: dict[str, Session] = {
    "cylinder": cylinder_session(1, 12, rows=6, cols=14, coverage_deg=200, radius_mm=5.0, drift=0, dead=1),
    "pad": pad_session(1, 12, rows=6, cols=8, drift=0, dead=1),
}
TIPS = list(SESSIONS)


def recording(session: Session) -> tuple[np.ndarray, np.ndarray]:
    return session.counts[TARE_FRAMES:], session.time_s[TARE_FRAMES:]


def assert_same(one: Patches, two: Patches, *, but: frozenset[str] = frozenset()) -> None:
    for field in fields(Patches):
        if field.name not in but:
            np.testing.assert_allclose(
                getattr(one, field.name), getattr(two, field.name), rtol=1e-6, atol=1e-9, err_msg=field.name
            )


@pytest.fixture(scope="module", params=TIPS)
def whole(request: pytest.FixtureRequest) -> tuple[Session, ContactExtractor, Patches]:
    session = SESSIONS[request.param]
    extractor = tared(session)
    return session, extractor, extractor.process(*recording(session))


def test_every_contact_is_found_and_nothing_else(whole: tuple[Session, ContactExtractor, Patches]) -> None:
    session, _, patches = whole
    touched = np.flatnonzero(patches.touched) + TARE_FRAMES
    assert set(session.touched) <= set(touched)
    assert all(min(session.touched - t, key=abs) <= 5 for t in touched)
    assert (session.touched[np.searchsorted(session.touched, touched)] - touched <= 5).all()


def test_untouched_frames_are_nan(whole: tuple[Session, ContactExtractor, Patches]) -> None:
    _, _, patches = whole
    for field in fields(Patches):
        values = getattr(patches, field.name)
        if field.name == "flags":
            assert (values[~patches.touched] == 0).all()
        elif field.name != "touched":
            assert np.isnan(values[~patches.touched]).all()
    assert patches.patch(int(np.flatnonzero(~patches.touched)[0])) is None
    assert len(patches) == len(patches.touched)


@settings(max_examples=4)
@given(tip=st.sampled_from(TIPS), data=st.data())
def test_a_recording_may_be_cut_anywhere(tip: str, data: st.DataObject) -> None:
    session = SESSIONS[tip]
    extractor = tared(session)
    counts, time_s = recording(session)
    cuts = data.draw(st.lists(st.integers(1, len(counts) - 1), max_size=4, unique=True).map(sorted))
    edges = [0, *cuts, len(counts)]
    pieces = [extractor.process(counts[a:b], time_s[a:b]) for a, b in pairwise(edges)]
    together = extractor.process(counts, time_s)
    for field in fields(Patches):
        joined = np.concatenate([getattr(p, field.name) for p in pieces])
        np.testing.assert_allclose(joined, getattr(together, field.name), rtol=1e-6, atol=1e-9)


def test_a_recording_says_what_its_frames_say(whole: tuple[Session, ContactExtractor, Patches]) -> None:
    session, extractor, patches = whole
    for last in session.touched:
        (frame,) = frames_of(session, [last])
        one, two = extractor.extract(frame), patches.patch(int(last) - TARE_FRAMES)
        assert one is not None
        assert two is not None
        assert two.flags == one.flags
        for name in ("angle_rad", "angle_half_range_rad", "force_n", "force_bound_n", "centroid_rad"):
            assert getattr(two, name) == pytest.approx(getattr(one, name), nan_ok=True), name
        assert two.position_mm == pytest.approx(one.position_mm)
        assert two.position_bound_mm == pytest.approx(one.position_bound_mm)


@pytest.mark.parametrize("tip", TIPS)
def test_an_empty_recording_gives_no_patches(tip: str) -> None:
    session = SESSIONS[tip]
    counts, time_s = recording(session)
    assert len(tared(session).process(counts[:0], time_s[:0])) == 0


@pytest.mark.parametrize("tip", TIPS)
def test_an_untouched_recording_gives_no_contact(tip: str) -> None:
    session = SESSIONS[tip]
    quiet = session.counts[:TARE_FRAMES]
    assert not tared(session).process(quiet, session.time_s[:TARE_FRAMES]).touched.any()


@pytest.mark.parametrize("tip", TIPS)
def test_frames_of_another_array_are_refused(tip: str) -> None:
    session = SESSIONS[tip]
    extractor = tared(session)
    counts, time_s = recording(session)
    for wrong, when in (
        (counts[:, :-1], time_s),
        (counts[:, :, :-1], time_s),
        (counts[0], time_s),
        (counts, time_s[:-1]),
        (counts, time_s[:, None]),
    ):
        with pytest.raises(InputError, match=r"tactile recording: counts of shape .* array of 6 x "):
            extractor.process(wrong, when)


@pytest.mark.parametrize("shape", sample([Shape.CYLINDER, Shape.FLAT], [Shape.CYLINDER]))
@pytest.mark.parametrize("minutes", sample([5, 20], [5]))
def test_a_long_quiet_session_with_drift_shows_no_contact(shape: Shape, minutes: int) -> None:
    """Minutes in which zeros wander by more than a contact bears."""
    description = describe(shape, 6, 8, 0.3, 2.0, counts_per_n=1000.0, radius_mm=5.0)
    taxels = Taxels(description, seed=5, noise_counts=2.0, offset_counts=400.0, drift_counts_per_s=1.5)
    time_s = np.arange(20 * 60 * minutes) / 20.0
    counts = taxels.counts(np.zeros((len(time_s), 6, 8)), time_s)
    assert np.ptp(counts.astype(float), axis=0).max() > 60
    calibration = TipCalibration(gain=np.ones((6, 8)), drift_counts_per_s=1.5, contact_force_n=0.05)
    extractor = ContactExtractor(description, calibration)
    extractor.tare(frames_of(_session(description, calibration, counts, time_s), range(TARE_FRAMES)))
    # One touch, so that it is not blind for all that.
    force = np.zeros((1, 6, 8))
    force[0, 2:4, 3:5] = 0.25
    counts[-1] = taxels.counts(force, time_s[-1:])[0]
    patches = extractor.process(counts[TARE_FRAMES:], time_s[TARE_FRAMES:])
    assert np.flatnonzero(patches.touched).tolist() == [len(patches) - 1]


def _session(
    description: object, calibration: TipCalibration, counts: np.ndarray, time_s: np.ndarray
) -> Session:
    tare, touched = slice(0, TARE_FRAMES), np.zeros(0, int)
    return Session(description, calibration, counts, time_s, tare, touched, [], calibration.gain)


def test_flags_of_frames_are_those_of_their_patches(whole: tuple[Session, ContactExtractor, Patches]) -> None:
    _, _, patches = whole
    for i in np.flatnonzero(patches.touched):
        patch = patches.patch(int(i))
        assert patch is not None
        assert sum(flag.bit for flag in patch.flags) == int(patches.flags[i])
    assert len({flag.bit for flag in PatchFlag}) == len(PatchFlag)
    assert max(flag.bit for flag in PatchFlag) < 256


@pytest.mark.parametrize(("col", "flag"), [(0, True), (7, True), (3, False)])
def test_what_the_edge_cuts_is_flagged_on_a_cylinder(col: int, flag: bool) -> None:
    description = describe(Shape.CYLINDER, 6, 8, 0.3, 2.0, counts_per_n=1000.0, radius_mm=5.0)
    extractor = ContactExtractor(description, TipCalibration(gain=np.ones((6, 8))))
    counts = np.zeros((1, 6, 8), np.uint16)
    counts[0, 1:4, col] = 300
    counts[0, 1:4, max(col - 1, 0)] += 60
    counts[0, 1:4, min(col + 1, 7)] += 60
    patch = extractor.process(counts, np.zeros(1)).patch(0)
    assert patch is not None
    assert (PatchFlag.TRUNCATED in patch.flags) == flag
    truth = description.columns[col]
    assert abs(patch.angle_rad - truth) <= patch.angle_half_range_rad


def test_full_counts_are_flagged_in_a_recording() -> None:
    description = describe(Shape.CYLINDER, 6, 8, 0.3, 2.0, counts_per_n=1000.0, radius_mm=5.0)
    extractor = ContactExtractor(description, TipCalibration(gain=np.ones((6, 8))))
    counts = np.zeros((2, 6, 8), np.uint16)
    counts[:, 1:4, 3] = 300
    counts[:, 1:4, 4] = 200
    counts[1, 2, 3] = description.max_count
    patches = extractor.process(counts, np.zeros(2))
    saturated = (patches.flags & PatchFlag.SATURATED.bit) > 0
    assert saturated.tolist() == [False, True]
    assert [math.isinf(v) for v in patches.force_bound_n] == [False, True]


# ----------------------------------------------------------------------------------------------------
# examples/extract_contact.py runs, and says what docs/contacts.md says; what the page shows of it is of it.

PAGE = (ROOT / "docs" / "contacts.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def test_the_program_says_what_the_page_says(capsys: pytest.CaptureFixture[str]) -> None:
    (excerpt,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert excerpt in (EXAMPLES / "extract_contact.py").read_text(encoding="utf-8")
    runpy.run_path(str(EXAMPLES / "extract_contact.py"))
    said = capsys.readouterr().out
    shown = PAGE[PAGE.index(excerpt) :].split("```text\n")[1].split("```")[0]
    assert NUMBER.sub("#", said) == NUMBER.sub("#", shown)
    assert numbers(said) == pytest.approx(numbers(shown), rel=0.15)
    # The truths that the page names are inside.
    _, direction, height, force, _ = said.splitlines()
    for line, truth in ((direction, 20.0), (height, 5.0), (force, 1.2)):
        value, bound = numbers(line)
        assert abs(value - truth) <= bound


def test_every_field_and_flag_has_its_row() -> None:
    for flag in PatchFlag:
        assert f"| `{flag.name}` |" in PAGE
    table = PAGE[PAGE.index("## Fields") : PAGE.index("## Flags")]
    for name in ContactPatch.__dataclass_fields__:
        assert f"`{name}`" in table


# ----------------------------------------------------------------------------------------------------
# What is told from the frames of an array at rest.

DESCRIBED = Mounting(Shape.CYLINDER, 8.5, 1000.0).describe(
    (7, 5), (3.4, 3.4), unique_id=b"rest", firmware="1", emulated=True, bit_depth=12, max_rate_hz=100.0
)


def frames_at_rest(counts: Counts) -> list[TactileFrame]:
    return [TactileFrame(10 + k, 0.02 * k, 0.02 * k + 0.005, frame) for k, frame in enumerate(counts)]


def at_rest(noise_counts: float) -> Counts:
    rest = 50 + noise_counts * np.random.default_rng(5).standard_normal((250, 5, 7))
    return np.rint(rest).astype(np.uint16)


def bad(counts: Counts) -> list[list[int]]:
    shown = shown_of(counts)
    return np.argwhere(shown.dead | shown.hot | shown.unsteady).tolist()


def shown_of(counts: Counts) -> UntouchedStatistics:
    shown = analyse_untouched(frames_at_rest(counts), DESCRIBED.max_count, 0.0)
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
    frames = frames_at_rest(at_rest(2.0))
    assert abs(frame_rate_hz(frames) - 50.0) < 1e-6
    assert 1.8 < shown_of(at_rest(2.0)).noise_counts < 2.2
    assert not is_rate_too_low(47.6, 50.0)
    assert is_rate_too_low(47.4, 50.0)
    assert frame_rate_hz(frames[:1]) == 0.0


def test_a_few_frames_may_get_lost() -> None:
    before, after = ArrayCounters(0, 0, 1, 0, 0), ArrayCounters(200, 1, 3, 3, 9)
    assert count_lost_frames(after) - count_lost_frames(before) == 6
    assert [is_loss_too_high(gone, came) for gone, came in ((1, 100), (2, 100), (5, 995), (6, 994))] == [
        False,
        True,
        False,
        True,
    ]
