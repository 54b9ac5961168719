# SPDX-License-Identifier: Apache-2.0
"""Bags with three cameras and more: a rig from camera_info and transforms, or from a calibration."""

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH

import ft

pytest.importorskip("rosbags", reason="rosbags is not installed: no bags are read")
from test_bags import FIRST_NS, FRAMES, Bag, motion  # noqa: E402

UP = (0.05, -0.1)  # where the third camera is, from the left one, metres
T_LEFT_UP = motion(*UP, 0)
BODY = (("body", "left", motion(0.2, 0, 0, True)), ("body", "mast", motion(0.2, 0, 0, True)), ("mast", "up", T_LEFT_UP))


def three_cameras(folder, walk, kind="mcap", transforms=BODY, topic="/tf_static", frames=FRAMES, **info):
    """A pair whose two cameras name one frame, as ROS has it, and a camera above it."""
    bag = Bag(folder, kind)
    for i in range(frames):
        left, right, t = walk.frame(i)
        for name, image, baseline in (("stereo/left", left, 0), ("stereo/right", right, BASELINE),
                                      ("above", walk.images_at(i, UP, False)[0], 0)):
            bag.info(f"/{name}/camera_info", baseline, time_ns=FIRST_NS + t, **(info if name == "above" else {}))
            bag.image(f"/{name}/image_raw", image, FIRST_NS + t, frame="up" if name == "above" else "left")
        if transforms and (i == 0 or topic == "/tf"):
            bag.static(*transforms, topic=topic, time_ns=FIRST_NS + t)
    return bag.close()


def check_rig(sequence):
    cameras = sequence.rig.cameras
    assert [c.right for c in cameras] == [1, None, None]
    for camera, place in zip(cameras, (motion(0, 0, 0), motion(BASELINE, 0, 0), T_LEFT_UP)):
        assert np.allclose(np.linalg.inv(camera.T_camera_body), place, atol=1e-7)


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_three_cameras_are_a_rig_and_tracked(kind, walk, tmp_path):
    sequence = ft.read_sequence(three_cameras(tmp_path, walk, kind), rig="mixed")
    assert isinstance(sequence.rig, ft.MultiRig) and len(sequence) == FRAMES
    check_rig(sequence)
    lines = dict(sequence.describe())
    assert "cam0 /stereo/left/image_raw (mono8), cam1 /stereo/right/image_raw (mono8), cam2 /above" in lines["sequence"]
    assert lines["cameras"].startswith("3 cameras, 320x240; cam0 pinhole and cam1 pinhole, 0.11 m apart; cam2 pinhole")
    odometry = ft.Odometry(sequence.rig, WIDTH, HEIGHT, features=500, device="host")
    for i, frame in enumerate(sequence):
        assert len(frame.images) == 3 and np.array_equal(frame.images[2], walk.images_at(i, UP, False)[0])
        pose = odometry.track(*frame.images, frame.time_ns)
        assert pose.tracked
    assert pose.T_world_camera[0, 3] == pytest.approx(walk.position(FRAMES - 1)[0], abs=0.01)


def test_without_being_asked_the_pair_is_taken(walk, tmp_path):
    sequence = ft.read_sequence(three_cameras(tmp_path, walk))
    assert isinstance(sequence.rig, ft.RectifiedPair)
    assert "/above/image_raw (mono8); --rig mixed takes other cameras, too" in dict(sequence.describe())["left out"]


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_transforms_of_tf_that_do_not_change_are_taken(kind, walk, tmp_path):
    sequence = ft.read_sequence(three_cameras(tmp_path, walk, kind, topic="/tf"), rig="mixed")
    check_rig(sequence)


ACCEPTED = "accepted are transforms .*/tf_static.* the baseline in P .*--calibration.*/stereo/left/image_raw, /stereo/right"


def test_what_has_no_place_is_refused_with_what_is_accepted(walk, tmp_path):
    with pytest.raises(RuntimeError, match=r"run.mcap: nothing says where /above/image_raw \(frame 'up'\) is.*" + ACCEPTED):
        ft.read_sequence(three_cameras(tmp_path, walk, transforms=()), rig="mixed")


def test_transforms_that_move_join_nothing(walk, tmp_path):
    bag = Bag(tmp_path, "mcap")
    for i in range(2):
        for name, x in (("left", 0), ("right", BASELINE)):
            bag.info(f"/{name}/camera_info", time_ns=FIRST_NS + i)
            bag.image(f"/{name}/image_raw", walk.frame(i)[x > 0], FIRST_NS + 50_000_000 * i, frame=name)
        bag.static(("left", "right", motion(BASELINE + 0.01 * i, 0, 0)), topic="/tf", time_ns=FIRST_NS + i)
    with pytest.raises(RuntimeError, match="nothing says where /right/image_raw"):
        ft.read_sequence(bag.close(), rig="mixed")


def chain(cameras):
    """Kalibr's, of (topic, T_cam0_camera)."""
    text, before = "", np.eye(4)
    for i, (topic, T) in enumerate(cameras):
        step = (np.linalg.inv(T) @ before).tolist()
        text += (f"cam{i}:\n  camera_model: pinhole\n  intrinsics: [{', '.join(map(str, CAMERA))}]\n  distortion_model: radtan\n"
                 f"  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  resolution: [{WIDTH}, {HEIGHT}]\n"
                 + (f"  rostopic: {topic}\n" if topic else "") + (f"  T_cn_cnm1: {step}\n" if i else ""))
        before = T
    return text


def test_kalibrs_chain_says_where_the_cameras_are(walk, tmp_path):
    path = three_cameras(tmp_path, walk, transforms=())
    T_up_left = np.linalg.inv(T_LEFT_UP)
    (tmp_path / "chain.yaml").write_text(chain([
        ("/above/image_raw", np.eye(4)), ("/stereo/left/image_raw", T_up_left),
        ("/stereo/right/image_raw", T_up_left @ motion(BASELINE, 0, 0))]))
    sequence = ft.read_sequence(path, rig="mixed", calibration=tmp_path / "chain.yaml")
    assert np.array_equal(sequence[1].images[0], walk.images_at(1, UP, False)[0])  # in the order of its topics
    (tmp_path / "chain.yaml").write_text(chain([("", np.eye(4)), ("", motion(BASELINE, 0, 0)), ("", T_LEFT_UP)]))
    sequence = ft.read_sequence(path, rig="mixed", calibration=tmp_path / "chain.yaml")
    assert np.array_equal(sequence[1].images[2], walk.images_at(1, UP, False)[0])
    check_rig(sequence)
    two = ft.read_sequence(path, rig="mixed", topics=["/stereo/left/image_raw", "/stereo/right/image_raw"])
    assert len(two.rig.cameras) == 2


def test_other_sizes_and_missing_camera_infos(walk, tmp_path):
    with pytest.raises(RuntimeError, match=r"must have one size.*/above/image_raw of 320x200; topics"):
        ft.read_sequence(three_cameras(tmp_path, walk, frames=1, height=200), rig="mixed")
    (tmp_path / "b").mkdir()
    bag = Bag(tmp_path / "b", "bag")
    for name in ("front", "rear"):
        bag.image(f"/{name}/image", walk.frame(0)[0], FIRST_NS)
    path = bag.close()
    with pytest.raises(RuntimeError, match="no sensor_msgs/msg/CameraInfo is beside /front/image and /rear/image: a calibration"):
        ft.read_sequence(path, rig="mixed")
    with pytest.raises(RuntimeError, match=r"two cameras or more, there are /front/image"):
        (tmp_path / "c").mkdir()
        bag = Bag(tmp_path / "c", "bag")
        bag.image("/front/image", walk.frame(0)[0], FIRST_NS)
        ft.read_sequence(bag.close(), rig="mixed")


def test_depth_images_belong_to_the_camera_of_their_frame(walk, tmp_path):
    bag = Bag(tmp_path, "mcap")
    bag.static(*BODY)
    for i in range(FRAMES):
        left, _, t = walk.frame(i)
        for name, image, frame in (("rear", left, "left"), ("color", walk.images_at(i, UP, False)[0], "up")):
            bag.info(f"/{name}/camera_info", time_ns=FIRST_NS + t)
            bag.image(f"/{name}/image_raw", image, FIRST_NS + t, frame=frame)
        bag.image("/aligned_depth_to_color/image_raw", walk.depth(i, UP[1]), FIRST_NS + t, "16UC1", frame="up")
    path = bag.close()
    sequence = ft.read_sequence(path, rig="mixed")
    assert [c.has_depth for c in sequence.rig.cameras] == [True, False] and sequence.depth_unit == 0.001
    lines = dict(sequence.describe())
    assert "cam0 /color/image_raw (mono8), cam1 /rear/image_raw (mono8), depth0 /aligned_depth" in lines["sequence"]
    assert "depth 0.001 m a unit, as bags have it" in lines["cameras"]
    odometry = ft.Odometry(sequence.rig, WIDTH, HEIGHT, features=500, device="host")
    for i, frame in enumerate(sequence):
        pose = odometry.track(*frame.images, frame.time_ns)
        assert pose.tracked and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)
    with pytest.raises(RuntimeError, match="in the frame 'up', that of no camera: /rear/image_raw 'left'.*registered"):
        ft.read_sequence(path, rig="mixed", topics=["/rear/image_raw", "/aligned_depth_to_color/image_raw"])
