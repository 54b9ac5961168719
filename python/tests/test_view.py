# SPDX-License-Identifier: Apache-2.0
"""Runs in the viewer rerun: recordings that can be read back, and what is said where the package is missing."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH, Walk

import ft
from ft import view
from test_sequences import write_png

FRAMES = 5


@pytest.fixture(scope="module")
def walk_folder(tmp_path_factory):
    """A walk in KITTI's layout, with its true poses."""
    root = tmp_path_factory.mktemp("kitti")
    walk = Walk()
    for camera in (0, 1):
        (root / f"image_{camera}").mkdir()
        for i in range(FRAMES):
            write_png(root / f"image_{camera}" / f"{i:06d}.png", walk.frame(i)[camera])
    (root / "times.txt").write_text("".join(f"{0.05 * i:.9f}\n" for i in range(FRAMES)))
    f, _, cx, cy = CAMERA
    (root / "calib.txt").write_text("".join(
        f"P{c}: {f} 0 {cx} {-f * BASELINE * c} 0 {f} {cy} 0 0 0 1 0\n" for c in (0, 1)))
    poses = np.tile(np.eye(4)[:3], (FRAMES, 1, 1))
    poses[:, :2, 3] = [walk.position(i) for i in range(FRAMES)]
    np.savetxt(root / "poses.txt", poses.reshape(FRAMES, 12))
    return root


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recording as track_sequence writes it: three frames, of which the last is not tracked."""
    root = tmp_path_factory.mktemp("recording")
    (root / "left").mkdir()
    pose = [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0]
    header = {"ft_recording": 1, "sequence": "made by hand", "width": WIDTH, "height": HEIGHT, "camera": CAMERA,
              "stages": ["search last frame", "total"],
              "truth": {"time_ns": [0, 50, 100], "T_world_camera": [pose] * 3, "orientation": True}}
    lines = [header]
    for i in range(3):
        write_png(root / "left" / f"{i:06d}.png", Walk().frame(i)[0])
        lines.append({"frame": i, "time_ns": 50_000_000 * i, "image": f"left/{i:06d}.png", "tracked": i < 2,
                      "keyframe": i == 0, "T_world_camera": pose, "counts": {"inliers": 7}, "stage_ms": [1.5, 2.5],
                      "x": [160, 10.5], "y": [120, 20], "depth": [2, -1], "point": [3, -1], "matched": [int(i > 0), 0]})
    (root / "recording.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return root


def entities(file):
    """Rows by entity path, of an .rrd file, as rerun 0.41 prints them."""
    said = subprocess.run([sys.executable, "-m", "rerun", "rrd", "print", str(file)], capture_output=True, text=True,
                          check=True).stdout
    rows = {}
    for count, path in re.findall(r"with (\d+) rows .*? - (/\S+) - ", said):
        rows[path] = rows.get(path, 0) + int(count)
    return rows


def run(*arguments, **options):
    return subprocess.run([sys.executable, "-m", "ft", *map(str, arguments)], capture_output=True, text=True, check=False,
                          **options)


# ---- with rerun

def test_a_run_is_recorded(walk_folder, tmp_path):
    pytest.importorskip("rerun")
    file = tmp_path / "run.rrd"
    done = run("track", walk_folder, "--out", tmp_path, "--device", "host", "--features", 400, "--record", file)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "summary.json").read_text())["tracked"] == FRAMES
    rows = entities(file)
    for path in ("/world/camera", "/world/camera/left/keypoints", "/world/camera/left/matches",
                 "/world/camera/left/depth", "/world/camera/depths", "/counts/inliers", "/milliseconds/total",
                 "/milliseconds/stereo", "/milliseconds/search_last_frame"):
        assert rows.get(path) == FRAMES, path
    assert rows["/world/camera/left"] == FRAMES + 1  # and the camera
    assert rows["/world/truth"] == 2  # the path and, as it has no rotations, how it is aligned at the end
    assert rows["/world/map"] == rows["/world/keyframes"] >= 1
    assert rows["/world/trajectory"] >= 2


def test_a_recording_of_track_sequence_is_converted(recording, tmp_path):
    pytest.importorskip("rerun")
    file = tmp_path / "run.rrd"
    done = run("view", recording, "--record", file)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "3 frames\n"
    rows = entities(file)
    assert rows["/world/camera/left"] == 4 and rows["/world/camera"] == 3
    assert rows["/milliseconds/search_last_frame"] == rows["/milliseconds/total"] == rows["/counts/inliers"] == 3
    assert rows["/world/map"] == 1


def test_the_program_track_sequence_writes_such_a_recording(walk_folder, tmp_path):
    named = os.environ.get("FT_TRACK_SEQUENCE")
    built = Path(__file__).resolve().parents[2] / "build/bin/track_sequence"
    program = named or shutil.which("track_sequence") or (str(built) if built.exists() else None)
    if program is None or "--record" not in subprocess.run([program, "--help"], capture_output=True, text=True,
                                                           check=True).stdout:
        pytest.skip("no track_sequence is built")
    subprocess.run([program, str(walk_folder), "--out", str(tmp_path / "out"), "--record", str(tmp_path / "record"),
                    "--backend", "host", "--timing", "--quiet", "--features", "400"], check=True, capture_output=True)
    read = view.Recording(tmp_path / "record")
    frames = list(read)
    assert [f.index for f in frames] == list(range(FRAMES)) and all(f.tracked for f in frames)
    assert len(read.truth) == FRAMES and read.header["camera"] == list(CAMERA)
    poses = ft.read_tum(tmp_path / "out/trajectory.txt").poses
    assert np.allclose([f.T_world_camera for f in frames], poses, atol=1e-6)
    assert frames[0].keyframe and not frames[0].keypoints.matched.any()
    assert frames[-1].keypoints.matched.sum() > 50 and frames[-1].milliseconds["stereo"] > 0


# ---- what a run and a recording say

def test_stage_times(walk, device):
    odometry = walk.odometry(measure_stages=True, device=device)
    for i in range(3):
        frame = walk.frame(i)
        begin = time.perf_counter()
        odometry.track(*frame)
        took_us = 1e6 * (time.perf_counter() - begin)
    times = odometry.stage_times_us()
    assert 0.02 * took_us < sum(times.values()) <= took_us
    assert list(times)[-2:] == ["result", "keyframe"] and {"pyramid", "corners", "stereo", "pose local map"} <= set(times)
    assert all(t >= 0 for t in times.values()) and sum(times.values()) > 0
    with pytest.raises(ValueError, match="measure_stages"):
        walk.odometry(device=device).stage_times_us()


class Log:
    """Stands in for rerun: keeps what is logged."""

    def __init__(self):
        self.logged = {}

    def log(self, path, what, static=False):
        self.logged.setdefault(path, []).append(what)

    def __getattr__(self, name):
        return lambda *given, **named: (name, given, named)


class Viewer(view.Viewer):
    def _layout(self):
        return None


def test_points_of_keyframes_are_where_the_camera_saw_them(recording):
    read, log = view.Recording(recording), Log()
    log.ViewCoordinates = type("ViewCoordinates", (), {"RDF": "RDF"})
    viewer = Viewer(log, read.header["camera"], WIDTH, HEIGHT, read.truth)
    for seen in read:
        viewer.show(seen)
    viewer.finish()
    (_, (points,), _), = log.logged["world/map"]
    assert np.allclose(points, [[0.5, 0, 2]])  # on the axis of a camera at x = 0.5, 2 m away
    matches = [given[0] for _, given, _ in log.logged["world/camera/left/matches"]]
    assert [len(m) for m in matches] == [0, 1, 1]
    assert len(log.logged["milliseconds/total"]) == 3


def test_the_path_and_the_loops_of_a_correction_are_shown(recording, tmp_path):
    shutil.copytree(recording, tmp_path / "loops")
    file = tmp_path / "loops/recording.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    lines[2]["corrected"] = {"path": [[[0, 0, 0], [1, 0, 0]], [[5, 0, 0]]], "loops": [[[0, 0, 0], [5, 0, 0]]]}
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    read, log = view.Recording(tmp_path / "loops"), Log()
    log.ViewCoordinates = type("ViewCoordinates", (), {"RDF": "RDF"})
    viewer = Viewer(log, read.header["camera"], WIDTH, HEIGHT, read.truth)
    for seen in read:
        viewer.show(seen)
    (_, (path,), _), = log.logged["world/corrected"]
    assert [piece.tolist() for piece in path] == [[[0, 0, 0], [1, 0, 0]], [[5, 0, 0]]]
    (_, (loops,), _), = log.logged["world/loops"]
    assert loops.tolist() == [[[0, 0, 0], [5, 0, 0]]]
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, 0, 3] = range(4)
    placed = ft.PlacedKeyframes(np.arange(4), np.array([1, 1, 1, 2]), T, T, np.ones(4), np.array([True, False, False, False]))
    one = np.zeros(1, np.int64)
    made = view.Corrected.of(placed, ft.ClosedLoops(np.array([0]), np.array([2]), one, one, T[:1], np.ones(1), one))
    assert [piece[:, 0].tolist() for piece in made.path] == [[0], [1, 2], [3]]
    assert made.loops[0, :, 0].tolist() == [0, 2]


def test_colours_of_depths():
    colours = view.depth_colours(np.array([1.0, 1e6, -1]))
    assert colours[0][0] > colours[0][2] and colours[1][2] > colours[1][0] and len(set(colours[2])) == 1


def test_a_recording_that_goes_on_is_read_to_the_last_whole_line(recording, tmp_path):
    shutil.copytree(recording, tmp_path / "cut")
    file = tmp_path / "cut/recording.jsonl"
    file.write_text(file.read_text()[:-40])
    assert len(list(view.Recording(tmp_path / "cut"))) == 2


def test_a_distorted_camera_keeps_its_model(recording, tmp_path):
    """Those of a mixed rig are tracked as they are."""
    first, *rest = (recording / "recording.jsonl").read_text().splitlines()
    for model, numbers, kind in (("RadTan", [400, 400, 160, 120, -0.1, 0.02, 0, 0], ft.RadTan),
                                 ("DoubleSphere", [200, 200, 160, 120, -0.2, 0.6], ft.DoubleSphere)):
        header = {**json.loads(first), "model": model, "camera": numbers}
        (tmp_path / "recording.jsonl").write_text("\n".join([json.dumps(header), *rest, ""]))
        assert isinstance(view.Recording(tmp_path).camera, kind)
    header["camera"] = [1, 2]
    (tmp_path / "recording.jsonl").write_text(json.dumps(header) + "\n")
    with pytest.raises(RuntimeError, match="recording.jsonl:1: camera"):
        view.Recording(tmp_path).camera


@pytest.mark.parametrize("text", ["", "[]\n", '{"ft_recording": 2}\n', "no JSON\n"])
def test_what_is_no_recording_is_named(tmp_path, text):
    (tmp_path / "recording.jsonl").write_text(text)
    with pytest.raises(RuntimeError, match="recording.jsonl"):
        view.Recording(tmp_path)
    with pytest.raises(RuntimeError, match="nowhere"):
        view.Recording(tmp_path / "nowhere")


@pytest.mark.parametrize("change", [{"truth": {"time_ns": [0.5], "T_world_camera": [[0] * 12], "orientation": True}},
                                    {"truth": {"time_ns": [1, 2], "T_world_camera": [[0] * 12], "orientation": True}}, {"truth": [1]}])
def test_a_broken_head_is_named(recording, tmp_path, change):
    import json

    head = json.loads((recording / "recording.jsonl").read_text().splitlines()[0])
    (tmp_path / "recording.jsonl").write_text(json.dumps({**head, **change}) + "\n")
    with pytest.raises(RuntimeError, match="recording.jsonl:1"):
        view.Recording(tmp_path)


def test_a_broken_line_is_named(recording, tmp_path):
    shutil.copytree(recording, tmp_path / "broken")
    file = tmp_path / "broken/recording.jsonl"
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join([*lines[:2], '{"frame": 1}\n']))
    with pytest.raises(RuntimeError, match="recording.jsonl:3"):
        list(view.Recording(tmp_path / "broken"))


# ---- without rerun

@pytest.mark.parametrize("arguments", [["track", "--record", "a.rrd"], ["track", "--view"], ["view"]])
def test_the_program_says_which_package_is_missing(walk_folder, recording, tmp_path, arguments):
    (tmp_path / "rerun.py").write_text("raise ImportError('not here')\n")
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    folder = recording if arguments[0] == "view" else walk_folder
    done = run(arguments[0], folder, *arguments[1:], cwd=tmp_path, env={**os.environ, "PYTHONPATH": path})
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and "rerun-sdk" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "track_sequence_out").exists()


def test_a_file_of_the_viewer_is_handed_to_it(tmp_path):
    (tmp_path / "rerun.py").write_text("import sys\n"
                                       "if __name__ == '__main__':\n    print('viewer', *sys.argv[1:])\n    sys.exit(7)\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])}
    file = tmp_path / "x.rrd"
    file.write_bytes(b"RRF2")
    done = run("view", file, cwd=tmp_path, env=environment)
    assert done.returncode == 7 and done.stdout == f"viewer {file}\n"
    done = run("view", file, "--record", tmp_path / "y.rrd", cwd=tmp_path, env=environment)
    assert done.returncode == 1 and "--record takes a folder" in done.stderr
    done = run("view", tmp_path / "gone.rrd", cwd=tmp_path, env=environment)
    assert done.returncode == 1 and "no such file" in done.stderr and "Traceback" not in done.stderr
    other = tmp_path / "recording.jsonl"
    other.write_text("{}")
    done = run("view", other, cwd=tmp_path, env=environment)
    assert done.returncode == 1 and "accepted are a folder" in done.stderr
    (tmp_path / "rerun.py").write_text("raise ImportError('not here')\n")
    done = run("view", file, cwd=tmp_path, env=environment)
    assert done.returncode == 1 and "rerun-sdk" in done.stderr and "Traceback" not in done.stderr
    assert ".rrd" in run("view", "--help").stdout


def test_a_run_is_shown_or_recorded_not_both(walk_folder, tmp_path):
    done = run("track", walk_folder, "--view", "--record", tmp_path / "a.rrd")
    assert done.returncode == 2 and "--record" in done.stderr
