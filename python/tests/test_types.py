# SPDX-License-Identifier: Apache-2.0
"""The types that the package tells mypy --strict: it passes on the package and on a user's program, and finds mistakes."""

import subprocess
import sys
from pathlib import Path

import pytest

import ft

PROGRAM = '''
import numpy as np
import ft

sequence = ft.read_sequence("folder", imu=True)
odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, imu=sequence.imu, **sequence.settings)
poses = []
for frame in sequence:
    tracking = odometry.track(*frame.images, time_ns=frame.time_ns)
    if tracking.tracked:
        poses.append((frame.time_ns, tracking.T_world_camera))
depth = odometry.keypoints().depth
print(float(depth.max()), tracking.warnings.get("two_motions", "").upper(), ft.evaluate(poses, sequence.ground_truth)["pairs"])
grey = np.zeros((480, 640), np.uint8)
found = ft.OrbExtractor(640, 480).extract(grey)
pixels, valid = ft.Pinhole([500, 500, 320, 240]).project(np.ones((1, 3)))
print(len(found), found.descriptors.shape, pixels[valid])
rig = ft.MultiRig([ft.RigCamera([500, 500, 320, 240], 0.1)])
several = ft.Odometry(rig, 640, 480, batch=2).track([grey, grey], [grey, grey], time_ns=[0, 0])
print(several[0].state)
mine = ft.ImageFeatures(np.zeros((5, 2)), np.zeros((5, 32), np.uint8), depth=[1.0] * 5)
own = ft.Odometry(ft.RgbdCamera([500, 500, 320, 240]), 640, 480, own_features=True)
print(own.track_features(mine, time_ns=1).state)
'''

MISTAKES = [  # in place of what, and what mypy says
    ("tracking.T_world_camera", "tracking.T_camera_world", "attr-defined"),
    ("imu=sequence.imu,", "imu=True,", "arg-type"),
    ("640, 480).extract(grey)", '640, "480").extract(grey)', "arg-type"),
    ("keypoints().depth", "keypoints().depths", "attr-defined"),
    ("sequence.ground_truth)[\"pairs\"]", "sequence.ground_truth).pairs", "attr-defined"),
    ("track_features(mine, time_ns=1).state", "track_features(mine, time_ns=1)[0].state", "index"),
    ("640, 480, batch=2", "640, 480, batches=2", "call-arg"),
    ("several[0].state", "several.state", "attr-defined"),
    ("ft.RigCamera([500, 500, 320, 240], 0.1)", "ft.Pinhole([500, 500, 320, 240])", "list-item"),
]


def mypy(folder, *what):
    pytest.importorskip("mypy", reason="mypy is not installed (python -m pip install mypy)")
    installed = Path(ft.__file__).parent
    assert (installed / "py.typed").exists() and (installed / "_ft.pyi").exists()
    return subprocess.run([sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(folder / "cache"), *what],
                          capture_output=True, text=True, check=False, cwd=folder)


def test_the_package_passes(tmp_path):
    for optional in ("cv2", "rosbags", "rerun"):
        pytest.importorskip(optional, reason=f"{optional}, whose types the package uses, is not installed")
    done = mypy(tmp_path, "-p", "ft")
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_program_passes_and_mistakes_are_found(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    done = mypy(tmp_path, "program.py")
    assert done.returncode == 0, done.stdout + done.stderr
    for right, wrong, code in MISTAKES:
        assert PROGRAM.count(right) == 1, right
        (tmp_path / "program.py").write_text(PROGRAM.replace(right, wrong))
        done = mypy(tmp_path, "program.py")
        assert done.returncode == 1 and f"[{code}]" in done.stdout, wrong + "\n" + done.stdout + done.stderr


def test_the_examples_pass(tmp_path):
    pytest.importorskip("cv2", reason="opencv-python, which an example uses, is not installed")
    examples = sorted((Path(__file__).resolve().parents[2] / "examples").glob("*/*.py"))
    assert "main.py" in {file.name for file in examples}
    for file in examples:
        done = mypy(tmp_path, file)
        assert done.returncode == 0, done.stdout + done.stderr
