"""What an arm's servos say of a press: force by virtual work, beside torques by levers; one on the bench."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
import shapely
from emulated_session import emulated_session
from probed_rig import probed_rig
from repository import EXAMPLES

from palpate.base.geometry import Floats
from palpate.calibration.measurements import LEG_FREE, LEG_IN, LEG_OUT, Probe, ServoPath
from palpate.config import load_rig
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.emulators.mechanics import ArmTruth
from palpate.drivers.kinematics import Turn
from palpate.rig.bench import connect
from palpate.rig.motion.press import _PressMechanics
from palpate.rig.motion.touch import ApproachState
from palpate.rig.reach.approaches import reach_of

ARMS = load_rig(EXAMPLES / "two-link-rig.toml")
ALONE = ARMS.model_copy(update={"fingers": ARMS.fingers[:1]})
NM_PER_A = 4.1 / 2.3  # e-Manual of the XM430-W350
GEAR = 3.0


def test_push_is_what_torques_at_both_joints_do() -> None:
    """A force that grows along the way, plus friction that is each joint's own: by levers, not by rates."""
    friction_a = np.array([0.03, 0.02])
    with connect(emulated_session(seed=1, rig=ALONE, empty=True).bench_rig) as hand:
        finger = hand.fingers[0]
        arm = finger.kinematics
        assert isinstance(arm, ArmKinematics)
        run = ApproachState.of(finger, reach_of(ALONE, aims=13).approaches[4], Turn())
        travel = np.linspace(40.0, 43.0, 120)
        servos = np.array([arm.servos_rad(run.line, float(at)) for at in travel])
        force_n = np.maximum(0.0, 3.0 * (travel - 42.0))
        leg = np.where(force_n == 0, LEG_FREE, LEG_IN)
        against = run.line.direction_rad + math.pi
        current = np.empty((len(travel), 2))
        for k, (near, far) in enumerate(servos.tolist()):
            tip = complex(*arm.centre_mm((near, far)))
            axes = (complex(*arm.base_mm), complex(*arm.elbow_mm((near, far))))
            pushed = force_n[k] * complex(math.cos(against), math.sin(against))
            torques = [((tip - axis).conjugate() * pushed).imag / 1000 / GEAR for axis in axes]
            current[k] = -np.array(torques) / NM_PER_A
        current += friction_a * np.sign(servos[-1] - servos[0])
        drive = _PressMechanics(run, servos, current, leg.astype(np.int64))
    assert drive.travel_mm == pytest.approx(travel, abs=1e-6)
    assert np.abs(drive.aside_mm).max() < 1e-6
    assert drive.free_a == pytest.approx(friction_a)
    free_n = drive.push_n[leg == LEG_FREE]
    assert np.ptp(free_n) < 0.02
    assert drive.push_n[leg == LEG_IN] - free_n[-1] == pytest.approx(force_n[leg == LEG_IN], abs=0.01)


@pytest.mark.slow
def test_an_arm_touches_and_presses_on_the_bench() -> None:
    """Where its true kinematics meet the disc, it feels it; its push grows as its array's counts do."""
    with probed_rig(1, seed=3, rig=ALONE) as rig:
        rig.put_disc()
        finger = rig.session.bench.fingers[0]
        truth, outline = finger.truth, finger.outline
        assert isinstance(truth, ArmTruth)
        assert outline is not None
        disc = shapely.Polygon(outline.start)
        number, contact_mm = nearest(truth, rig.prober.approaches, disc)
        (touched,) = rig.prober.touch([Probe(number, contact_mm + 8.0)], 2)
        (press,) = rig.prober.press([Probe(number, contact_mm)], 2)
    assert touched is not None
    assert (abs(touched.aim_way), abs(touched.elbow_way)) == (1, 1)
    flanks = (touched.aim_way * truth.shoulder.play_rad, touched.elbow_way * truth.elbow.play_rad)
    gap = disc.distance(shapely.Point(tip_of(truth, np.array(touched.servos_rad), flanks)))
    assert gap - truth.tip_radius_mm + touched.force_n / truth.stiffness_n_per_mm == pytest.approx(
        0, abs=0.06
    )
    assert set(press.leg) == {LEG_FREE, LEG_IN, LEG_OUT}
    assert press.free_a == pytest.approx((0.028, 0.028), abs=0.012), (
        "0.05 N·m of friction at 4.1 N·m for 2.3 A"
    )
    into = press.leg == LEG_IN
    counts_n = press.counts.sum(axis=(1, 2)) / finger.array.description.counts_per_n
    slope = np.polyfit(counts_n[into], press.push_n[into], 1)[0]
    assert slope == pytest.approx(1.0, abs=0.15)
    assert press.push_n[into].max() - press.push_n[press.leg == LEG_FREE].mean() > 2.0


def nearest(truth: ArmTruth, approaches: Sequence[ServoPath], disc: shapely.Polygon) -> tuple[int, float]:
    """The approach that meets the disc most head-on, and after how many mm."""
    found = []
    for number, item in enumerate(approaches):
        travels = np.linspace(0.0, item.length_mm, 400)
        places = [tip_of(truth, servos, (0.0, 0.0)) for servos in item.servos_at(travels)]
        gaps = np.array([disc.distance(shapely.Point(place)) for place in places]) - truth.tip_radius_mm
        if (gaps < 0).any():
            first = int(np.argmax(gaps < 0))
            way = np.subtract(places[first], places[first - 8])
            towards = np.subtract(disc.centroid.coords[0], places[first])
            cosine = float(way @ towards) / math.hypot(*way) / math.hypot(*towards)
            found.append((-cosine, number, float(travels[first])))
    _, number, contact_mm = min(found)
    return number, contact_mm


def tip_of(truth: ArmTruth, servos: Floats, flanks: tuple[float, float]) -> tuple[float, float]:
    """True tip centre for servo angles, joints behind by `flanks`."""
    first = truth.heading_rad + (servos[0] - truth.shoulder.zero_rad) / GEAR - flanks[0]
    second = first + (servos[1] - truth.elbow.zero_rad) / GEAR - flanks[1]
    x, y = truth.base_mm
    x += truth.upper_mm * math.cos(first) + truth.fore_mm * math.cos(second)
    y += truth.upper_mm * math.sin(first) + truth.fore_mm * math.sin(second)
    return float(x), float(y)
