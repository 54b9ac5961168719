# SPDX-License-Identifier: Apache-2.0
import json
import subprocess
import sys

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH, Walk

import ft


def write_png(file, image):
    """An 8-bit grey PNG."""
    import struct
    import zlib

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    rows = b"".join(b"\0" + row.tobytes() for row in image)
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 8, 0, 0, 0, 0))
                     + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """The walk in KITTI's layout."""
    root = tmp_path_factory.mktemp("kitti")
    walk = Walk()
    for camera in (0, 1):
        (root / f"image_{camera}").mkdir()
    times = []
    for i in range(12):
        left, right, t = walk.frame(i)
        write_png(root / "image_0" / f"{i:06d}.png", left)
        write_png(root / "image_1" / f"{i:06d}.png", right)
        times.append(f"{1e-9 * t:.9f}\n")
    (root / "times.txt").write_text("".join(times))
    f, _, cx, cy = CAMERA
    rows = [f"P{c}: {f} 0 {cx} {-f * BASELINE * c} 0 {f} {cy} 0 0 0 1 0\n" for c in (0, 1)]
    (root / "calib.txt").write_text("".join(rows))
    return root


def test_a_sequence_is_tracked(folder):
    sequence = ft.read_sequence(folder)
    assert len(sequence) == 12 and (sequence.width, sequence.height) == (WIDTH, HEIGHT)
    assert abs(sequence.rig.baseline - BASELINE) < 1e-6
    odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, features=400, device="host")
    poses = [(f.time_ns, odometry.track(f.left, f.right, f.time_ns).T_world_camera) for f in sequence]
    truth = []
    for i in range(12):
        T = np.eye(4)
        T[:2, 3] = Walk().position(i)
        truth.append((50_000_000 * i, T))
    errors = ft.evaluate(poses, truth)
    assert errors["pairs"] == 12 and errors["ate_m"] < 0.005
    moved = np.eye(4)
    moved[:3, 3] = (1, 2, 3)
    again = ft.evaluate([(t, moved @ T) for t, T in poses], truth)
    assert abs(again["ate_m"] - errors["ate_m"]) < 1e-9


def test_trajectories_are_written_and_read(tmp_path):
    poses = []
    for i in range(5):
        T = np.eye(4)
        T[:3, 3] = (i, 2 * i, -i)
        poses.append((10**9 * (i + 1), T))
    trajectory = ft.Trajectory.of(poses)
    trajectory.write_tum(tmp_path / "a.txt")
    back = ft.read_tum(tmp_path / "a.txt")
    assert np.array_equal(back.time_ns, trajectory.time_ns) and np.allclose(back.poses, trajectory.poses)
    trajectory.write_kitti(tmp_path / "b.txt")
    assert np.allclose(np.loadtxt(tmp_path / "b.txt").reshape(-1, 3, 4), trajectory.poses[:, :3])
    trajectory.poses[:, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # a quarter turn about z
    trajectory.write_euroc(tmp_path / "d.csv")
    rows = np.loadtxt(tmp_path / "d.csv", delimiter=",")
    assert np.array_equal(rows[:, 0], trajectory.time_ns)
    assert np.allclose(rows[:, 1:4], trajectory.poses[:, :3, 3])
    assert np.allclose(rows[:, 4:], [0.5**0.5, 0, 0, 0.5**0.5])
    with pytest.raises(ValueError, match="ascend"):
        ft.Trajectory.of(poses[::-1]).write_tum(tmp_path / "c.txt")


def test_evo_agrees(tmp_path):
    evo = pytest.importorskip("evo.core.metrics")
    from evo.core import trajectory as t

    random = np.random.default_rng(5)
    truth, guess = [], []
    for i in range(60):
        T = np.eye(4)
        T[:3, 3] = (0.1 * i, np.sin(0.1 * i), 0.02 * i * i)
        G = T.copy()
        G[:3, 3] += random.normal(0, 0.02, 3)
        truth.append((10**8 * (i + 1), T))
        guess.append((10**8 * (i + 1), G))
    a, b = (t.PosePath3D(poses_se3=[T for _, T in p]) for p in (truth, guess))
    b.align(a)
    ape = evo.APE(evo.PoseRelation.translation_part)
    ape.process_data((a, b))
    errors = ft.evaluate(guess, truth)
    assert abs(ape.get_statistic(evo.StatisticsType.rmse) - errors["ate_m"]) < 1e-9
    rpe = evo.RPE(evo.PoseRelation.translation_part, delta=10, delta_unit=evo.Unit.frames, all_pairs=True)
    rpe.process_data((a, b))
    assert abs(rpe.get_statistic(evo.StatisticsType.rmse) - errors["rpe_m"]) < 1e-9


def test_what_is_no_sequence_is_named(tmp_path):
    with pytest.raises(RuntimeError, match=str(tmp_path)):
        ft.read_sequence(tmp_path)


def test_the_program_tracks_a_folder(folder, tmp_path):
    done = subprocess.run([sys.executable, "-m", "ft", "track", str(folder), "--out", str(tmp_path), "--device", "host",
                           "--features", "400"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["tracked"] == summary["frames"] == 12 and summary["stopped_at"] is None
    assert len(ft.read_tum(tmp_path / "trajectory.txt")) == 12
