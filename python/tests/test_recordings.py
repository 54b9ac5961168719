# SPDX-License-Identifier: Apache-2.0
"""What is said of videos and bags that are cut off, do not belong together, or lack something."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest
from conftest import CAMERA, HEIGHT, WIDTH

import ft

F, _, CX, CY = CAMERA
FRAMES = 20


@pytest.fixture
def record(walk, tmp_path):
    """Writes a video of the walk: its images joined by `picture`, a function of left and right."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: no videos are decoded")
    (tmp_path / "camera.txt").write_text(f"{F} {F} {CX} {CY}\n")

    def write(name, picture=lambda left, right: left, frames=FRAMES, rate=20.0):
        file = tmp_path / name
        writer = None
        for i in range(frames):
            image = picture(*walk.frame(i)[:2])
            if writer is None:
                writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"MJPG"), rate, image.shape[::-1])
            if not writer.isOpened():
                pytest.skip("this OpenCV writes no videos")
            writer.write(np.repeat(image[:, :, None], 3, 2))
        writer.release()
        return file

    return write


def said_of(recording, **options):
    """The warnings of a recording."""
    with pytest.warns(UserWarning):
        return ft.read_sequence(recording, **options).warnings


def test_a_video_that_is_cut_off_ends_early(record, tmp_path):
    video = record("run.avi")
    assert ft.read_sequence(video).warnings == []
    assert ft.read_sequence(video, max_frames=5).warnings == []
    cut = tmp_path / "cut.avi"
    cut.write_bytes(video.read_bytes()[:video.stat().st_size // 2])
    said = said_of(cut, calibration=tmp_path / "camera.txt")
    assert len(said) == 1 and re.search(r"cut.avi: the video ends early: \d+ images could be decoded of the 20", said[0])
    run = subprocess.run([sys.executable, "-m", "ft", "track", str(cut), "--calibration", str(tmp_path / "camera.txt"), "--backend",
                          "host", "--quiet", "--out", str(tmp_path / "out")], capture_output=True, text=True, check=False)
    assert "the video ends early" in run.stderr
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"][0] == said[0]


def test_times_of_a_video_are_those_that_were_asked_for(record):
    video = record("run.avi")
    assert dict(ft.read_sequence(video).describe())["images"].endswith("times: those of the video")
    sequence = ft.read_sequence(video, fps=10)
    assert dict(sequence.describe())["images"].endswith("times: 10 images a second, as asked for")
    assert sequence[1].time_ns - sequence[0].time_ns == 100_000_000


@pytest.mark.parametrize("frames, rate, words", [(FRAMES, 19.0, "different rates, 20 and 19 images a second"),
                                                 (FRAMES - 5, 20.0, "different lengths, 20 and 15 images"),
                                                 (FRAMES - 1, 20.0, "")])
def test_videos_of_a_pair_have_one_rate_and_length(frames, rate, words, record, tmp_path):
    left, right = record("left.avi"), record("right.avi", lambda left, right: right, frames, rate)
    matrix = f"[[{F}, 0, {CX}], [0, {F}, {CY}], [0, 0, 1]]"
    (tmp_path / "stereo.json").write_text(f'{{"M1": {matrix}, "D1": [0, 0, 0, 0, 0], "M2": {matrix}, "D2": [0, 0, 0, 0, 0], '
                                          '"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [-0.11, 0, 0], '
                                          f'"image_width": {WIDTH}, "image_height": {HEIGHT}}}')
    options = {"calibration": tmp_path / "stereo.json"}
    said = said_of([left, right], **options) if words else ft.read_sequence([left, right], **options).warnings
    assert [words in text for text in said] == ([True] if words else [])


def test_both_images_of_a_pair_in_one_video(record):
    said = said_of(record("both.avi", lambda left, right: np.hstack([left, right])))
    assert len(said) == 1 and "both.avi -vf crop=iw/2:ih:0:0 left.mp4" in said[0]
    # A wide image of one camera is none.
    assert ft.read_sequence(record("wide.avi", lambda left, right: left[:120])).warnings == []


def test_errors_name_the_video_and_the_time(record, tmp_path):
    video = record("run.avi")
    chain = tmp_path / "chain.yaml"
    chain.write_text("cam0:\n  camera_model: pinhole\n  distortion_model: none\n  distortion_coeffs: []\n"
                     f"  intrinsics: [{F}, {F}, {CX}, {CY}]\n  resolution: [{WIDTH}, {HEIGHT - 2}]\n")
    with pytest.raises(RuntimeError) as refused:
        ft.read_sequence(video, calibration=chain)
    assert str(refused.value).startswith(f"{video}, image of 0.000000000 s: image is {WIDTH} x {HEIGHT} pixels")


def bag_of(folder):
    pytest.importorskip("rosbags", reason="rosbags is not installed: no bags are read")
    from test_bags import Bag

    return Bag(folder, "bag")


def test_a_bag_without_camera_info_says_what_to_give(walk, tmp_path):
    bag = bag_of(tmp_path)
    bag.image("/front/image", walk.frame(0)[0], 10**18)
    path = bag.close()
    with pytest.raises(RuntimeError) as refused:
        ft.read_sequence(path)
    assert str(refused.value).startswith(f"{path}: holds no calibration; ")
    assert "the bag has no sensor_msgs/msg/CameraInfo beside /front/image: --calibration" in str(refused.value)


def test_a_depth_bag_without_camera_info_holds_no_calibration(walk, tmp_path):
    bag = bag_of(tmp_path)
    bag.image("/color/image", walk.frame(0)[0], 10**18)
    bag.image("/depth/image", np.full((HEIGHT, WIDTH), 2000, np.uint16), 10**18, "16UC1")
    path = bag.close()
    with pytest.raises(RuntimeError) as refused:
        ft.read_sequence(path)
    assert str(refused.value).startswith(f"{path}: holds no calibration; ")
    assert "beside /color/image: --calibration" in str(refused.value)


def test_messages_of_a_bag_name_its_topics(walk, tmp_path):
    bag = bag_of(tmp_path)
    for i in range(3):
        bag.info("/front/camera_info", time_ns=10**18 + i)
        bag.image("/front/image", walk.frame(i)[0], 10**18 + 50_000_000 * i)
        bag.imu("/imu", 10**18 + 50_000_000 * i)
    path = bag.close()
    said = said_of(path, imu=True)
    assert said == [f"{path}: /imu: the samples of the IMU are not used: the calibration does not say where the IMU is"]
    assert ft.read_sequence(path).warnings == [], "it was not asked for"


def test_halves_of_an_imu_are_not_used(walk, tmp_path):
    bag = bag_of(tmp_path)
    bag.info("/front/camera_info")
    bag.image("/front/image", walk.frame(0)[0], 10**18)
    for half in ("accel", "gyro"):
        bag.imu(f"/camera/{half}/sample", 10**18)
    path = bag.close()
    assert "/camera/accel/sample and /camera/gyro/sample are halves of one" in said_of(path, imu=True)[0]


def test_a_message_may_quote_what_is_no_utf_8(tmp_path):
    file = tmp_path / "poses.txt"
    file.write_bytes(b"1.5\xb5s 0 0 0 0 0 0 1\n")
    with pytest.raises(RuntimeError, match=r"poses.txt:1: '1\.5.xb5s' is not a time in seconds"):
        ft.read_tum(file)
