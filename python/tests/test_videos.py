# SPDX-License-Identifier: Apache-2.0
"""Videos that OpenCV has written, and images by a pattern."""

import subprocess
import sys

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH
from test_sequences import write_png

import ft

FRAMES = 10
F, _, CX, CY = CAMERA


@pytest.fixture(scope="module")
def videos(walk, tmp_path_factory):
    """A folder with left.avi, right.avi and stereo.yml."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: no videos are decoded")
    folder = tmp_path_factory.mktemp("videos")
    writers = [cv2.VideoWriter(str(folder / f"{side}.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (WIDTH, HEIGHT))
               for side in ("left", "right")]
    if not all(writer.isOpened() for writer in writers):
        pytest.skip("this OpenCV writes no videos")
    for i in range(FRAMES):
        for writer, image in zip(writers, walk.frame(i)):
            writer.write(np.repeat(image[:, :, None], 3, 2))
    for writer in writers:
        writer.release()
    matrix = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1]])
    file = cv2.FileStorage(str(folder / "stereo.yml"), cv2.FILE_STORAGE_WRITE)
    for name, value in (("M1", matrix), ("D1", np.zeros((1, 5))), ("M2", matrix), ("D2", np.zeros((1, 5))), ("R", np.eye(3)),
                        ("T", np.array([[-BASELINE], [0], [0]]))):
        file.write(name, value)
    file.release()
    return folder


def test_two_videos_are_tracked(videos, walk):
    sequence = ft.read_sequence([videos / "left.avi", videos / "right.avi"], calibration=videos / "stereo.yml")
    assert (sequence.layout, len(sequence), sequence.kind) == ("video", FRAMES, "stereo")
    lines = dict(sequence.describe())
    assert lines["sequence"] == "left.avi and right.avi, videos; calibration stereo.yml"
    assert lines["images"] == "10 frames, 20 Hz, 0.5 s; times: those of the video"
    odometry = walk.odometry()
    poses = [odometry.track(*frame.images, frame.time_ns) for frame in sequence]
    assert all(pose.tracked for pose in poses)
    assert poses[-1].T_world_camera[0, 3] == pytest.approx(walk.position(FRAMES - 1)[0], abs=0.02)
    assert np.diff([frame.time_ns for frame in sequence]).tolist() == [50_000_000] * (FRAMES - 1)
    assert np.abs(sequence[4].left.astype(int) - walk.frame(4)[0]).mean() < 4  # JPEG


def test_one_video_is_one_camera(videos, tmp_path):
    (tmp_path / "camera.txt").write_text(f"{F} {F} {CX} {CY}\n")
    sequence = ft.read_sequence(videos / "left.avi", calibration=tmp_path / "camera.txt", max_frames=4)
    assert isinstance(sequence.rig, ft.MonocularCamera) and len(sequence) == 4
    lone = tmp_path / "lone" / "left.avi"
    lone.parent.mkdir()
    lone.write_bytes((videos / "left.avi").read_bytes())
    decoded = []
    with pytest.raises(RuntimeError, match=r"left.avi: holds no calibration; accepted are .*X \* 8.889, cx = 160, cy = 120"):
        ft.read_sequence(lone, progress=decoded.append)
    assert decoded == [1]  # what will be refused is not decoded to its end
    (lone.parent / "stereo.yml").write_bytes((videos / "stereo.yml").read_bytes())  # of a pair
    with pytest.raises(RuntimeError, match="left.avi: holds no calibration; accepted are"):
        ft.read_sequence(lone)
    (lone.parent / "camera.txt").write_text(f"{F} {F} {CX} {CY}\n")  # found beside the video
    assert isinstance(ft.read_sequence(lone, max_frames=2).rig, ft.MonocularCamera)
    assert ft.read_sequence(videos, max_frames=2).kind == "stereo"
    with pytest.raises(RuntimeError, match="a pair is two videos"):
        ft.read_sequence(videos / "left.avi", rig="stereo")
    (tmp_path / "damaged.mp4").write_bytes(b"no video")
    with pytest.raises(RuntimeError, match="damaged.mp4: no image can be decoded"):
        ft.read_sequence(tmp_path / "damaged.mp4")
    with pytest.raises(RuntimeError, match="none.mp4: no such file"):
        ft.read_sequence(tmp_path / "none.mp4")


def test_the_program_takes_two_videos(videos, tmp_path):
    files = [str(videos / name) for name in ("left.avi", "right.avi", "stereo.yml")]
    run = subprocess.run([sys.executable, "-m", "ft", "track", *files[:2], "--calibration", files[2], "--backend", "host",
                          "--quiet", "--out", str(tmp_path / "out")], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "left.avi and right.avi, videos" in run.stdout
    assert len(ft.read_tum(tmp_path / "out" / "trajectory.txt")) == FRAMES


def test_images_by_a_pattern(walk, tmp_path):
    for i in range(6):
        write_png(tmp_path / f"frame_{i:04d}.png", walk.frame(i)[0])
        write_png(tmp_path / f"other_{i:04d}.png", walk.frame(i)[1])
    (tmp_path / "camera.txt").write_text(f"{F} {F} {CX} {CY}\n")
    pattern = tmp_path / "frame_*.png"
    sequence = ft.read_sequence(pattern, fps=20)
    assert (sequence.layout, len(sequence), sequence.kind) == ("images", 6, "mono")
    assert np.array_equal(sequence[5].left, walk.frame(5)[0])
    same = ft.read_sequence(sorted(tmp_path.glob("other_*.png")), fps=20)
    assert np.array_equal(same[5].left, walk.frame(5)[1])
    assert dict(sequence.describe())["sequence"] == f"{pattern}, images of one camera; calibration camera.txt"
    with pytest.raises(RuntimeError, match="no file has such a name; accepted are"):
        ft.read_sequence(tmp_path / "none_*.png", fps=20)
    with pytest.raises(RuntimeError, match="--fps"):
        ft.read_sequence(pattern)
