"""The robot in LeRobot's own record loop; LeRobot, with PyTorch, is not among palpate's dependencies."""

from pathlib import Path
from typing import Any

import pytest

from support.benches.rigs import quick_bench

pytest.importorskip("lerobot.robots", reason="lerobot is not installed: pip install lerobot")
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture
def robot(tmp_path: Path) -> Any:
    """What LeRobot makes of the words `--robot.type=palpate`, once it has looked for plug-ins."""
    from lerobot.robots import RobotConfig, make_robot_from_config

    import lerobot_robot_palpate  # noqa: F401  # as register_third_party_plugins does where it is installed

    rig, objects = quick_bench(tmp_path)
    make = RobotConfig.get_choice_class("palpate")
    config = make(id="bench", calibration_dir=tmp_path, rig=str(rig), objects=str(objects), seed=7)
    return make_robot_from_config(config)


def test_features_are_what_is_observed(robot: Any) -> None:
    from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

    assert not robot.is_connected
    for call in (robot.get_observation, robot.disconnect, lambda: robot.send_action({})):
        with pytest.raises(DeviceNotConnectedError):
            call()
    with robot:
        with pytest.raises(DeviceAlreadyConnectedError):
            robot.connect()
        before = robot.get_observation()
        sent = robot.send_action({"finger": 1.2, "direction_rad": 0.5})
        after = robot.get_observation()
    assert not robot.is_connected
    assert (sent.keys(), sent["finger"]) == (robot.action_features.keys(), 1.0)
    assert before.keys() == after.keys() == robot.observation_features.keys()
    assert (before["f2.x_mm"], before["part.object"]) == (0, -1)
    assert after["f2.x_mm"] != 0
    assert {type(value) for value in after.values()} == {float}


def test_a_recorded_episode_ends_with_the_part_known(robot: Any, tmp_path: Path) -> None:
    """LeRobot's record loop, a teleoperator that does what palpate plans, and LeRobot's data set of it."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.datasets.pipeline_features import (
        aggregate_pipeline_dataset_features,
        create_initial_features,
    )
    from lerobot.datasets.utils import combine_feature_dicts
    from lerobot.processor import make_default_processors
    from lerobot.scripts.lerobot_record import record_loop
    from lerobot.teleoperators import Teleoperator

    events = {"exit_early": False, "rerecord_episode": False, "stop_recording": False}

    class Planner(Teleoperator):
        name = "planner"
        action_features, feedback_features = robot.action_features, {}
        is_connected = is_calibrated = True
        connect = disconnect = calibrate = configure = send_feedback = lambda *_: None

        def __init__(self) -> None:
            pass

        def get_action(self) -> Any:
            action = robot.planned_action()
            events["exit_early"] = robot.get_observation()["part.left"] == 1
            return action

    on_action, to_robot, on_observation = make_default_processors()
    features = combine_feature_dicts(
        aggregate_pipeline_dataset_features(on_action, create_initial_features(action=robot.action_features)),
        aggregate_pipeline_dataset_features(
            on_observation, create_initial_features(observation=robot.observation_features)
        ),
    )
    folder = tmp_path / "data"
    data = LeRobotDataset.create(
        "local/touches", 1000, features, root=folder, robot_type=robot.name, use_videos=False
    )
    with robot:
        loop = (robot, events, 1000, on_action, to_robot, on_observation)
        record_loop(
            *loop, dataset=data, teleop=Planner(), control_time_s=60, single_task="find out what lies there"
        )
        known = robot.get_observation()
    data.save_episode()
    data.finalize()
    kept = LeRobotDataset("local/touches", root=folder)
    assert len(kept) >= 3
    last = dict(
        zip(
            kept.features["observation.state"]["names"], kept[len(kept) - 1]["observation.state"], strict=True
        )
    )
    assert last["part.left"] == known["part.left"] == 1
    assert last["part.object"] == known["part.object"] >= 0
    assert kept.features["action"]["names"] == ["finger", "direction_rad"]
