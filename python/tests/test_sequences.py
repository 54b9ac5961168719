# SPDX-License-Identifier: Apache-2.0
import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH, Walk, view

import ft


def write_png(file, image):
    """A grey PNG of 8 or 16 bits."""
    import struct
    import zlib

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    bits = 8 * image.dtype.itemsize
    rows = b"".join(b"\0" + row.astype(f">u{bits // 8}").tobytes() for row in image)
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", image.shape[1], image.shape[0], bits, 0, 0, 0, 0))
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


def test_folders_of_images_have_a_rate(folder, tmp_path):
    shutil.copytree(folder / "image_0", tmp_path / "left")
    shutil.copytree(folder / "image_1", tmp_path / "right")
    shutil.copy(folder / "calib.txt", tmp_path)
    with pytest.raises(RuntimeError, match="--fps"):
        ft.read_sequence(tmp_path)
    sequence = ft.read_sequence(tmp_path, fps=20)
    assert sequence.layout == "folders" and len(sequence) == 12
    assert [frame.time_ns for frame in sequence] == [50_000_000 * i for i in range(12)]
    lines = dict(sequence.describe())
    assert list(lines) == ["sequence", "cameras", "images", "imu", "truth"]
    assert "calibration calib.txt" in lines["sequence"] and "12 frames, 20 Hz" in lines["images"]
    (tmp_path / "times.txt").write_text("".join(f"{10 + i}.5\n" for i in range(12)))
    assert ft.read_sequence(tmp_path)[1].time_ns == 11_500_000_000
    assert ft.read_sequence(tmp_path, times=tmp_path / "times.txt")[0].time_ns == 10_500_000_000
    for rate in (-1, 0, float("nan"), 1e6):
        with pytest.raises(ValueError, match="fps"):
            ft.read_sequence(tmp_path, fps=rate)


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
    assert errors["scale"] == pytest.approx(1, abs=0.03)
    larger = [(t, T.copy()) for t, T in poses]
    for _, T in larger:
        T[:3, 3] *= 5
    assert ft.evaluate(larger, truth)["scale"] == pytest.approx(errors["scale"] / 5)
    assert ft.evaluate([(t, np.eye(4)) for t, _ in poses], truth)["scale"] is None


def test_a_ground_truth_of_positions_alone_has_no_rotation_errors(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "kitti")
    turned = np.eye(4)
    turned[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]  # east, north, up
    poses, rows = [], []
    for i in range(12):
        T = np.eye(4)
        T[:2, 3] = Walk().position(i)
        poses.append((50_000_000 * i, T))
        rows.append(f"{0.05 * i:.9f} " + " ".join(f"{v:.9f}" for v in (turned @ T)[:3, 3]) + " 0 0 0 1\n")
    (tmp_path / "kitti" / "groundtruth.txt").write_text("".join(rows))
    truth = ft.read_sequence(tmp_path / "kitti").ground_truth
    assert not truth.has_orientation and ft.Trajectory.of(poses).has_orientation
    errors = ft.evaluate(poses, truth)
    assert errors["ate_m"] < 1e-6 and errors["ate_deg"] is None and errors["rpe_deg"] is None
    assert ft.evaluate(poses, truth, orientation=True)["ate_deg"] is not None


def test_a_rotation_error_that_is_missing_has_its_reason():
    random = np.random.default_rng(2)

    def errors(bend, orientation=True):
        truth, guess = [], []
        for i in range(30):
            T, G = np.eye(4), np.eye(4)
            T[:3, 3] = np.add((0.1 * i, bend * i * i, 0), random.normal(0, 0.01, 3))
            G[:3, 3] = np.add((0.1 * i, bend * i * i, 0), random.normal(0, 0.01, 3))
            truth.append((10**8 * (i + 1), T))
            guess.append((10**8 * (i + 1), G))
        return ft.evaluate(guess, truth, orientation=orientation)

    bent, straight, unknown = errors(0.01), errors(0.0), errors(0.0, False)
    assert bent["ate_deg"] < 2 and bent["ate_rotation_missing"] is None
    assert straight["ate_deg"] is None and "not determined" in straight["ate_rotation_missing"]
    assert straight["ate_m"] < 0.05
    assert unknown["ate_deg"] is None and unknown["ate_rotation_missing"] is None


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


def test_pykitti_agrees(tmp_path):
    """A raw drive: times, cameras, and the poses of oxts as those of each left camera."""
    pykitti = pytest.importorskip("pykitti")
    random = np.random.default_rng(4)
    drive = tmp_path / "2011_09_26/2011_09_26_drive_0001_sync"
    dates = [f"2011-09-26 13:02:{25 + 0.1 * i:012.9f}\n" for i in range(4)]
    for camera in range(4):
        (drive / f"image_0{camera}/data").mkdir(parents=True)
        (drive / f"image_0{camera}/timestamps.txt").write_text("".join(dates))
        for i in range(4):
            write_png(drive / f"image_0{camera}/data/{i:010d}.png", np.full((48, 64), 10 * camera + i, np.uint8))
    (drive / "oxts/data").mkdir(parents=True)
    (drive / "oxts/timestamps.txt").write_text("".join(dates))
    for i in range(4):
        numbers = [49.0 + 1e-5 * i, 8.4 + 2e-5 * i, 110 + 0.1 * i, *(0.1 * random.normal(size=3)), *random.normal(size=19)]
        (drive / f"oxts/data/{i:010d}.txt").write_text(" ".join(f"{v:.12f}" for v in numbers) + " 4 10 4 4 0\n")

    def rotation():
        q, _ = np.linalg.qr(random.normal(size=(3, 3)))
        return q * np.linalg.det(q)

    def line(values):
        return " ".join(f"{v:.15e}" for v in np.ravel(values)) + "\n"

    for name in ("velo_to_cam", "imu_to_velo"):
        (drive.parent / f"calib_{name}.txt").write_text(
            f"calib_time: 15-Mar-2012 11:37:16\nR: {line(rotation())}T: {line(random.normal(size=3))}")
    rectifying = rotation()
    (drive.parent / "calib_cam_to_cam.txt").write_text("calib_time: 09-Jan-2012 13:57:47\n" + "".join(
        f"S_rect_0{c}: 64 48\nR_rect_0{c}: {line(rectifying)}P_rect_0{c}: 40 0 32 {-15 * c} 0 40 24 0 0 0 1 0\n" for c in range(4)))
    theirs = pykitti.raw(str(tmp_path), "2011_09_26", "0001")
    for left, T_left_imu in ((0, theirs.calib.T_cam0_imu), (2, theirs.calib.T_cam2_imu)):
        ours = ft.read_sequence(drive)
        assert ours.layout == "kitti_raw" and len(ours) == 4 and ours.warnings == []
        assert ours[3].right[0, 0] == 10 * left + 13
        assert ours.baseline == pytest.approx(theirs.calib.b_gray if left == 0 else theirs.calib.b_rgb)
        for k, (time, packet) in enumerate(zip(theirs.timestamps, theirs.oxts)):
            since = (time - type(time)(1970, 1, 1)).total_seconds()
            assert abs(1e-9 * int(ours.ground_truth.time_ns[k]) - since) < 1e-5
            expected = packet.T_w_imu @ np.linalg.inv(T_left_imu)
            assert np.abs(ours.ground_truth.poses[k] - expected).max() < 1e-6
        for camera in (0, 1):
            shutil.rmtree(drive / f"image_0{camera}", ignore_errors=True)


COLMAP_CAMERAS = {
    "SIMPLE_PINHOLE": [400, 320, 240], "PINHOLE": [400, 401, 321, 239], "SIMPLE_RADIAL": [400, 320, 240, -0.1],
    "RADIAL": [400, 320, 240, -0.1, 0.02], "OPENCV": [400, 401, 321, 239, -0.1, 0.02, 0.0002, -0.0001],
    "FULL_OPENCV": [400, 401, 321, 239, -0.1, 0.02, 0.0002, -0.0001, 0.003, 0.01, 0.002, 0.0005],
    "SIMPLE_RADIAL_FISHEYE": [300, 320, 240, 0.01], "RADIAL_FISHEYE": [300, 320, 240, 0.01, 0.002],
    "OPENCV_FISHEYE": [300, 301, 321, 239, 0.01, 0.002, 0.003, 0.0004],
}


@pytest.mark.parametrize("model", COLMAP_CAMERAS)
def test_pycolmap_agrees(model, tmp_path):
    """A rig that it writes, of a camera of each model and a pinhole: pixels and places of the cameras are the same."""
    pycolmap = pytest.importorskip("pycolmap")
    if not hasattr(pycolmap, "Rig"):
        pytest.skip("a pycolmap without rigs")
    random = np.random.default_rng(7)
    cameras = [pycolmap.Camera(model=name, width=640, height=480, params=COLMAP_CAMERAS[name], camera_id=i)
               for i, name in enumerate((model, "PINHOLE"), 1)]
    left, right = (pycolmap.sensor_t(pycolmap.SensorType.CAMERA, i) for i in (1, 2))
    turn = np.array([0.02, -0.03, 0.01, 1.0])
    place = pycolmap.Rigid3d(pycolmap.Rotation3d(turn / np.linalg.norm(turn)), np.array([-0.1, 0.002, 0.01]))
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(left)
    rig.add_sensor(right, place)
    written = pycolmap.Reconstruction()
    for camera in cameras:
        written.add_camera(camera)
    written.add_rig(rig)
    (tmp_path / "sparse").mkdir()
    written.write_text(str(tmp_path / "sparse"))
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
        for i in range(2):
            write_png(tmp_path / name / f"{i}.5.png", np.full((480, 640), 90, np.uint8))
    with pytest.warns(UserWarning, match="unit of length"):
        sequence = ft.read_sequence(tmp_path, calibration=tmp_path / "sparse/cameras.txt", rig="mixed")
    points = np.column_stack([random.uniform(-0.7, 0.7, 200), random.uniform(-0.5, 0.5, 200), np.ones(200)])
    for ours, theirs in zip(sequence.rig.cameras, cameras):
        pixels, valid = ours.camera.project(points)
        assert valid.all()
        assert np.abs(pixels + 0.5 - theirs.img_from_cam(points)).max() < 1e-3  # floats
    T_right_left = sequence.rig.cameras[1].T_camera_body @ np.linalg.inv(sequence.rig.cameras[0].T_camera_body)
    assert np.abs(T_right_left[:3] - place.matrix()).max() < 1e-6


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


@pytest.fixture(scope="session")
def folder_with_truth(folder, tmp_path_factory):
    root = tmp_path_factory.mktemp("truth") / "kitti"
    shutil.copytree(folder, root)
    rows = []
    for i in range(12):
        T = np.eye(4)
        T[:2, 3] = Walk().position(i)
        rows.append(T[:3].ravel())
    np.savetxt(root / "poses.txt", rows)
    return root


@pytest.fixture(scope="session")
def folder_with_depth(tmp_path_factory):
    """The walk in the layout of TUM RGB-D, depths in millimetres."""
    root = tmp_path_factory.mktemp("tum")
    walk = Walk()
    lists = {"rgb": [], "depth": []}
    truth = []
    for i in range(12):
        at = f"{1 + 0.05 * i:.6f}"
        for name, image in (("rgb", walk.frame(i)[0]), ("depth", walk.depth(i))):
            (root / name).mkdir(exist_ok=True)
            write_png(root / name / f"{at}.png", image)
            lists[name].append(f"{at} {name}/{at}.png\n")
        truth.append(" ".join(map(str, [at, *walk.position(i), 0, 0, 0, 0, 1])) + "\n")
    for name, lines in lists.items():
        (root / f"{name}.txt").write_text("".join(lines))
    (root / "groundtruth.txt").write_text("".join(truth))
    (root / "camera.txt").write_text("# fx fy cx cy\n" + " ".join(map(str, CAMERA)) + "\n")
    return root


@pytest.fixture(scope="session")
def folder_of_one(folder_with_truth, tmp_path_factory):
    """The left camera alone."""
    root = tmp_path_factory.mktemp("one") / "kitti"
    shutil.copytree(folder_with_truth, root)
    shutil.rmtree(root / "image_1")
    return root


def test_depth_images_are_read(folder_with_depth):
    sequence = ft.read_sequence(folder_with_depth, depth_unit=0.001, min_depth=0.5, max_depth=10.0)
    assert sequence.kind == "rgbd" and len(sequence) == 12
    assert isinstance(sequence.rig, ft.RgbdCamera) and sequence.rig.depth_scale == 0.001
    assert (sequence.rig.min_depth, sequence.rig.max_depth) == (0.5, 10.0)
    assert np.array_equal(sequence[3].images[0], Walk().frame(3)[0]) and np.array_equal(sequence[3].images[1], Walk().depth(3))
    odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, features=400, device="host")
    poses = [(f.time_ns, odometry.track(*f.images, f.time_ns).T_world_camera) for f in sequence]
    errors = ft.evaluate(poses, sequence.ground_truth)
    assert errors["pairs"] == 12 and errors["ate_m"] < 0.005
    with pytest.warns(UserWarning, match="--depth-unit 0.001"):
        assert abs(ft.read_sequence(folder_with_depth).rig.depth_scale - 1 / 5000) < 1e-12
    single = ft.read_sequence(folder_with_depth, rig="mono")
    assert single.kind == "mono" and len(single[0].images) == 1
    for bad in ({"depth_unit": 0}, {"depth_unit": float("nan")}, {"rig": "odd"}, {"max_time_difference_ns": 0.5}, {"max_time_difference_ns": -1}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            ft.read_sequence(folder_with_depth, **bad)
    with pytest.raises(RuntimeError, match=str(folder_with_depth)):
        ft.read_sequence(folder_with_depth, rig="stereo")


def test_one_camera_is_read(folder_of_one, folder_with_truth):
    with pytest.warns(UserWarning, match="no images of the second one"):
        alone = ft.read_sequence(folder_of_one)
    for sequence in (alone, ft.read_sequence(folder_with_truth, rig="mono")):
        assert sequence.kind == "mono" and len(sequence) == 12 and isinstance(sequence.rig, ft.MonocularCamera)
        odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, features=1000, device="host")
        tracked = [odometry.track(*f.images, f.time_ns).tracked for f in sequence]
        assert tracked[-1] and len(sequence.ground_truth) == 12


def test_what_a_recording_lacks_is_a_warning(folder_with_depth, tmp_path):
    root = tmp_path / "tum"
    shutil.copytree(folder_with_depth, root)
    lines = (root / "rgb.txt").read_text().splitlines(keepends=True)
    (root / "rgb.txt").write_text("".join([*lines[:5], lines[4], *lines[5:]]))
    with pytest.warns(UserWarning, match="rgb.txt"):
        sequence = ft.read_sequence(root, depth_unit=0.0002)
    assert len(sequence) == 12 and len(sequence.warnings) == 1


def program_of_the_readme():
    text = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
    return text.split("\n## Python\n", 1)[1].split("```python\n", 1)[1].split("```", 1)[0]


def test_the_readmes_program_runs_with_and_without_truth(folder, folder_with_truth, folder_of_one):
    program = program_of_the_readme()
    assert program.count('"FOLDER"') == 1
    for root in (folder, folder_with_truth, folder_of_one):
        done = subprocess.run([sys.executable, "-c", program.replace('"FOLDER"', repr(str(root)))], capture_output=True, text=True,
                              check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("<ft.Tracking ") == 12
        assert root == folder_of_one or done.stdout.count("<ft.Tracking tracking") == 12
        assert ("ate_m" in done.stdout) == (root != folder)
        if root == folder_with_truth:
            assert "'pairs': 12" in done.stdout


def test_a_sequence_without_truth_is_false_about_it(folder, folder_with_truth):
    assert not ft.read_sequence(folder).ground_truth
    sequence = ft.read_sequence(folder_with_truth)
    assert sequence.ground_truth and len(sequence.ground_truth) == 12
    with pytest.raises(ValueError, match="ground truth"):
        ft.evaluate([(1, np.eye(4))], ft.read_sequence(folder).ground_truth)


def track(*arguments, **options):
    return subprocess.run([sys.executable, "-m", "ft", "track", *map(str, arguments)], capture_output=True, text=True, check=False,
                          **options)


def test_the_program_tracks_a_folder(folder, folder_with_truth, tmp_path):
    for root, truth in ((folder, False), (folder_with_truth, True)):
        out = tmp_path / str(truth)
        done = track(root, "--out", out, "--backend", "host", "--features", "400")
        assert done.returncode == 0, done.stderr
        summary = json.loads((out / "summary.json").read_text())
        assert summary["tracked"] == summary["frames"] == 12 and summary["stopped_at"] is None
        assert len(ft.read_tum(out / "trajectory.txt")) == 12
        assert (out / "groundtruth.txt").exists() == truth
        assert summary["ate_rmse_m"] < 0.005 if truth else summary["ate_rmse_m"] is None
        rows = list(csv.DictReader((out / "times.csv").open()))
        assert len(rows) == 12 and all(r["map_id"] == "1" and r["warnings"] == "" for r in rows)
        assert sum(name.startswith("cov") for name in rows[0]) == 21
        assert (out / "map.ply").read_bytes().startswith(b"ply\n") and "<svg" in (out / "report.html").read_text()
        assert "track  12/12  100 %" in done.stdout and "ATE RMSE" in done.stdout


def test_options_of_the_program(folder_with_truth, tmp_path):
    done = track("--sequence", folder_with_truth, "--out", tmp_path, "--device", "host", "--features", "400", "--frames", "6", "--timing",
                 "--poses", "kitti", "--imu", "off", "--threads", "1", "--near", "40", "--rig", "rectified", "--loops", "--quiet")
    assert done.returncode == 0, done.stderr
    assert "track  " not in done.stdout
    assert np.loadtxt(tmp_path / "poses.txt").shape == (6, 12)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["loops"] == {"closed": 0, "corrections": 0, "edges": [], "online_ate_rmse_m": pytest.approx(summary["ate_rmse_m"])}
    online, corrected = (ft.read_tum(tmp_path / name) for name in ("trajectory_online.txt", "trajectory.txt"))
    assert np.allclose(online.poses, corrected.poses, atol=1e-8)
    assert len(summary["stages"]) > 5 and summary["options"]["near points, baselines"].startswith("40")
    for bad in (["--frames", "-1"], ["--near", "nan"], ["--near", "0"], ["--threads", "9999"], ["--rig", "odd"], [folder_with_truth]):
        done = track("--sequence", folder_with_truth, "--out", tmp_path / "none", *bad)
        assert done.returncode == 2, done.stderr
    for bad, word in ((["--rig", "fisheye"], "--rig fisheye"), (["--frame", "body"], "--frame body")):
        done = track(folder_with_truth, "--out", tmp_path / "none", *bad)
        assert done.returncode == 1 and word in done.stderr
    assert not (tmp_path / "none").exists()


def test_one_camera_and_depth_images_by_the_program(folder_with_truth, folder_of_one, folder_with_depth, tmp_path):
    for root, rig in ((folder_with_truth, "mono"), (folder_with_truth, "monocular"), (folder_of_one, "auto")):
        done = track(root, "--out", tmp_path / rig, "--backend", "host", "--features", "1000", "--rig", rig)
        assert done.returncode == 0, done.stderr
        summary = json.loads((tmp_path / rig / "summary.json").read_text())
        assert 0 < summary["tracked"] < 12 and summary["scale"] is not None
    done = track(folder_with_depth, "--out", tmp_path / "d", "--backend", "host", "--features", "400", "--depth-unit", "0.001", "--max-depth", "9")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "d/summary.json").read_text())
    assert summary["tracked"] == 12 and summary["ate_rmse_m"] < 0.005 and "0.001 m a unit" in done.stdout
    for bad in (["--min-depth", "3", "--max-depth", "2"], ["--depth-unit", "0"], ["--max-time-difference", "-1"]):
        assert track(folder_with_depth, "--out", tmp_path / "e", *bad).returncode == 2
    done = track(folder_with_truth, "--out", tmp_path / "e", "--max-depth", "2")
    assert done.returncode == 1 and "--max-depth" in done.stderr


def test_a_folder_that_cannot_be_written_is_refused_before_the_run(folder, folder_with_truth, tmp_path):
    (tmp_path / "file").write_text("")
    places = [tmp_path / "file", tmp_path / "file/under", folder_with_truth]
    if os.geteuid() != 0:
        (tmp_path / "closed").mkdir(mode=0o555)
        places.append(tmp_path / "closed")
    for out in places:
        done = track(folder, "--out", out, "--backend", "host")
        assert done.returncode == 1 and f"--out {out}" in done.stderr, done.stderr
        assert "track  " not in done.stdout
    assert (tmp_path / "file").read_text() == ""
    assert len((folder_with_truth / "poses.txt").read_text().splitlines()) == 12
    plain = tmp_path / "plain"
    shutil.copytree(folder, plain)
    (plain / "image_0").rename(plain / "left")
    (plain / "image_1").rename(plain / "right")
    (plain / "groundtruth.txt").write_text("0 1 2 3 0 0 0 1\n")
    done = track(plain, "--fps", "20", "--out", plain)
    assert done.returncode == 1 and "is the folder of a sequence" in done.stderr, done.stderr
    assert (plain / "groundtruth.txt").read_text() == "0 1 2 3 0 0 0 1\n"


def test_an_image_that_cannot_be_read_ends_the_run(folder, tmp_path):
    root = tmp_path / "kitti"
    shutil.copytree(folder, root)
    (root / "image_0/000007.png").write_bytes(b"no image")
    done = track(root, "--out", tmp_path / "out", "--backend", "host", "--features", "400")
    assert done.returncode == 3 and "stopped at frame 7" in done.stderr
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["stopped_at"] == 7 and summary["frames"] == 7


def test_black_images_are_told(folder, tmp_path):
    root = tmp_path / "kitti"
    shutil.copytree(folder, root)
    for file in root.glob("image_*/*.png"):
        write_png(file, np.zeros((HEIGHT, WIDTH), np.uint8))
    done = track(root, "--out", tmp_path / "out", "--backend", "host")
    assert done.returncode == 1 and "no frame could be tracked" in done.stderr and "nearly black" in done.stderr
    assert json.loads((tmp_path / "out/summary.json").read_text())["reasons"] == {"dark": 12}


def test_options_are_those_of_track_sequence():
    """What the C++ program offers, but for what has no meaning here."""
    root = Path(__file__).resolve().parents[2]
    source = (root / "examples/track_sequence/options.cpp").read_text(encoding="utf-8")
    import re

    theirs = set(re.findall(r'add_(?:option|flag)\(\s*"(--[a-z-]+)"', source))
    assert "--features" in theirs and len(theirs) > 10
    shown = track("--help").stdout
    without = {"--read-ahead", "--realtime"}  # Python has no threads that read ahead
    assert not {option for option in theirs - without if option not in shown}


# ---- maps and loops

@pytest.fixture(scope="session")
def revisited(tmp_path_factory):
    """A camera that is covered, carried to a place that it has not seen, and comes back to its first way from there."""
    root = tmp_path_factory.mktemp("revisited")
    walk = Walk()
    covered = range(20, 23)
    places = [(-1.6 + 0.2 * i, 0) for i in range(23)] + [(-0.6 + 0.1 * i, 2.4) for i in range(8)]
    places += [(0.2, 2.4 - 0.15 * i) for i in range(17)] + [(0.2 + 0.15 * i, 0) for i in range(12)]
    for camera in (0, 1):
        (root / f"image_{camera}").mkdir()
        for i, (x, y) in enumerate(places):
            seen = view(walk.planes, x + BASELINE * camera, y)
            write_png(root / f"image_{camera}" / f"{i:06d}.png", 0 * seen if i in covered else seen)
    (root / "times.txt").write_text("".join(f"{0.05 * i:.9f}\n" for i in range(len(places))))
    f, _, cx, cy = CAMERA
    (root / "calib.txt").write_text("".join(
        f"P{c}: {f} 0 {cx} {-f * BASELINE * c} 0 {f} {cy} 0 0 0 1 0\n" for c in (0, 1)))
    poses = np.tile(np.eye(4)[:3], (len(places), 1, 1))
    poses[:, :2, 3] = places
    np.savetxt(root / "poses.txt", poses.reshape(-1, 12))
    return root


def test_the_program_closes_loops_and_is_found_in_a_map_of_another_process(revisited, tmp_path):
    room = tmp_path / "room.map"
    common = ("--backend", "host", "--features", "400", "--loops", "--quiet")
    done = track(revisited, "--out", tmp_path / "a", *common, "--save-map", room)
    assert done.returncode == 0, done.stderr
    assert f"map       saved to {room}, " in done.stdout and not (tmp_path / "room.map.partial").exists()
    summary = json.loads((tmp_path / "a/summary.json").read_text())
    loops = summary["loops"]
    assert loops["closed"] > 0 and loops["corrections"] > 0 and len(loops["edges"]) == loops["closed"]
    for edge in loops["edges"]:
        assert edge["from_time_ns"] < edge["to_time_ns"] and edge["inliers"] >= 40
    assert summary["ate_rmse_m"] < 0.02 and 'class="loop"' in (tmp_path / "a/report.html").read_text()

    done = track(revisited, "--out", tmp_path / "b", *common, "--load-map", room, "--frames", "10")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "b/summary.json").read_text())
    after = summary["loaded_map"]["found_after"]
    assert 1 < after <= 4 and f"found after {after} frames\n" in done.stdout and summary["loaded_map"]["file"] == str(room)
    first, second = (ft.read_tum(tmp_path / name / "trajectory.txt") for name in "ab")
    same = first.poses[np.isin(first.time_ns, second.time_ns)]
    assert len(same) >= 8 and np.abs(same[:, :3, 3] - second.poses[:, :3, 3]).max() < 0.02  # in one world

    bad = tmp_path / "bad.map"
    bad.write_bytes(room.read_bytes()[:1000])
    for file, word in ((tmp_path / "none.map", "No such file"), (bad, "truncated"), (tmp_path, "Is a directory")):
        done = track(revisited, "--out", tmp_path / "c", *common, "--load-map", file)
        assert done.returncode == 1 and f"--load-map {file}: " in done.stderr and word in done.stderr
    done = track(revisited, "--out", tmp_path / "c", *common, "--save-map", tmp_path / "none/room.map")
    assert done.returncode == 1 and "--save-map" in done.stderr and "cannot be written: No such file" in done.stderr
    os.mkfifo(tmp_path / "pipe")
    done = track(revisited, "--out", tmp_path / "c", *common, "--save-map", tmp_path / "pipe")
    assert done.returncode == 1 and "not a plain file" in done.stderr and (tmp_path / "pipe").is_fifo()
    done = track(revisited, "--out", tmp_path / "c", *common, "--localize-only")
    assert done.returncode == 2 and "--load-map" in done.stderr
