# SPDX-License-Identifier: Apache-2.0
"""Arrays that have a dimension of 0, at every entry that takes an array: an empty result, or ValueError with the argument's
name. What is wrong here ends the interpreter."""

import dataclasses
import inspect
import itertools

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH

import ft
from ft import view

SHAPES = [(0,), (0, 0), (0, 2), (0, 3), (0, 4), (3, 0), (0, 32), (0, WIDTH), (HEIGHT, 0), (0, 4, 4), (4, 4, 0), (2, 0, 4)]
TYPES = [np.uint8, np.uint16, np.float32, np.float64, bool]
IMAGE, DEPTH = np.zeros((HEIGHT, WIDTH), np.uint8), np.ones((HEIGHT, WIDTH), np.float32)
MODELS = {
    "Pinhole": CAMERA, "RadTan": CAMERA, "KannalaBrandt": (*CAMERA, 0, 0, 0, 0), "DoubleSphere": (*CAMERA, -0.2, 0.55),
    "Unified": (*CAMERA, 0.9, 0, 0, 0, 0), "ExtendedUnified": (*CAMERA, 0.6, 1.1), "FieldOfView": (*CAMERA, 0.9),
}
T = np.eye(4)
T[0, 3] = -BASELINE
FISHEYE = (*CAMERA, 0, 0, 0, 0)
FEATURES = {"positions": np.ones((2, 2)), "descriptors": np.zeros((2, 32), np.uint8)}
COLUMNS = ("octave", "angle", "score", "deviation", "right_x", "depth")


def odometry(rig=None, **options):
    return ft.Odometry(rig or ft.RectifiedPair(CAMERA, BASELINE), WIDTH, HEIGHT, features=200, device="host", **options)


def distorted(T_right_left=T, left=CAMERA, right=CAMERA, wanted=CAMERA):
    return ft.DistortedPair(left, right, T_right_left, wanted, (WIDTH, HEIGHT))


def test_a_rectifier_refuses_rolling_shutters():
    with pytest.raises(ValueError, match="readout_s"):
        ft.Rectifier(dataclasses.replace(distorted(), readout_s=0.02), WIDTH, HEIGHT, device="host")


def places(folder):
    words = folder / "words.txt"
    row = " ".join(["7"] * 32)
    words.write_text("2 1 0 0\n" + f"0 1 {row} 1\n0 1 {row} 2\n")
    return ft.PlaceRecognition(words, keyframes=2, features=10, device="host")


def entries(folder):
    """Name of an entry and of its argument: a call with an array there."""
    pair, rgbd, mono = odometry(mask_size=(WIDTH, HEIGHT)), odometry(ft.RgbdCamera(CAMERA)), odometry(ft.MonocularCamera(CAMERA))
    inertial = odometry(imu=ft.Imu())
    own, times = odometry(own_features=True), itertools.count(1)
    orb = ft.OrbExtractor(WIDTH, HEIGHT, device="host", mask_size=(WIDTH, HEIGHT))
    matcher = ft.StereoMatcher(ft.RectifiedPair(CAMERA, BASELINE), WIDTH, HEIGHT, device="host")
    rectifier = ft.Rectifier(distorted(), WIDTH, HEIGHT, device="host")
    recognition = places(folder)
    two = [(1, np.eye(4)), (2, np.eye(4))]
    calls = {
        "OrbExtractor.extract image": orb.extract,
        "OrbExtractor.set_mask mask": orb.set_mask,
        "StereoMatcher.match image 0": lambda a: matcher.match(a, IMAGE),
        "StereoMatcher.match image 1": lambda a: matcher.match(IMAGE, a),
        "Rectifier.rectify left": lambda a: rectifier.rectify(a, IMAGE),
        "Rectifier.rectify right": lambda a: rectifier.rectify(IMAGE, a),
        "Rectifier.rectify out": lambda a: rectifier.rectify(IMAGE, IMAGE, out=(a, a)),
        "Rectifier.rectify out ": lambda a: rectifier.rectify(IMAGE, IMAGE, out=a),
        "Odometry.track left": lambda a: pair.track(a, IMAGE, 1),
        "Odometry.track right": lambda a: pair.track(IMAGE, a, 1),
        "Odometry.track time": lambda a: pair.track(IMAGE, IMAGE, a),
        "Odometry.track frame": lambda a: pair.track([a], [IMAGE], [1]),
        "Odometry.track grey": lambda a: rgbd.track(a, DEPTH, 1),
        "Odometry.track depth": lambda a: rgbd.track(IMAGE, a, 1),
        "Odometry.track image": lambda a: mono.track(a, 1),
        **{f"Odometry.track_features {name}": lambda a, name=name: own.track_features(
            ft.ImageFeatures(**{**FEATURES, name: a}), next(times)) for name in (*FEATURES, *COLUMNS)},
        "Odometry.track_features time": lambda a: own.track_features(ft.ImageFeatures(**FEATURES), a),
        "Odometry.set_mask mask": pair.set_mask,
        "Odometry.set_masks mask": lambda a: pair.set_masks([None, a]),
        "Odometry.predict T_world_camera": pair.predict,
        "Odometry.add_imu accel": lambda a: inertial.add_imu(1, a, (0, 0, 0)),
        "Odometry.add_imu gyro": lambda a: inertial.add_imu(1, (0, 0, 0), a),
        "Odometry.add_imu time": lambda a: inertial.add_imu(a, (0, 0, 0), (0, 0, 0)),
        "Odometry.load_map map": pair.load_map,
        "PlaceRecognition.describe descriptors": recognition.describe,
        "Trajectory poses": lambda a: ft.Trajectory([1, 2], a),
        "Trajectory times": lambda a: ft.Trajectory(a, np.stack([np.eye(4)] * 2)),
        "Trajectory.of trajectory": ft.Trajectory.of,
        "Trajectory.of poses": lambda a: ft.Trajectory.of([(1, a)]),
        "evaluate trajectory": lambda a: ft.evaluate(a, two),
        "evaluate truth": lambda a: ft.evaluate(two, a),
        "RectifiedPair camera": lambda a: odometry(ft.RectifiedPair(a, BASELINE)),
        "DistortedPair left": lambda a: odometry(distorted(left=a)),
        "DistortedPair wanted": lambda a: odometry(distorted(wanted=a)),
        "DistortedPair T_right_left": lambda a: odometry(distorted(T_right_left=a)),
        "FisheyePair right": lambda a: odometry(ft.FisheyePair(FISHEYE, a, T)),
        "FisheyePair T_right_left": lambda a: odometry(ft.FisheyePair(FISHEYE, FISHEYE, a)),
        "RgbdCamera camera": lambda a: odometry(ft.RgbdCamera(a)),
        "MonocularCamera camera": lambda a: odometry(ft.MonocularCamera(a)),
        "RigCamera camera": lambda a: odometry(ft.MultiRig([ft.RigCamera(a, BASELINE)])),
        "RigCamera T_camera_body": lambda a: odometry(ft.MultiRig([ft.RigCamera(CAMERA, BASELINE, a)])),
        "MultiRig cameras": lambda a: odometry(ft.MultiRig(a)),
        "Imu T_imu_camera": lambda a: odometry(imu=ft.Imu(a)),
    }
    for name, parameters in MODELS.items():
        model = getattr(ft, name)
        calls[f"{name} parameters"] = model
        calls[f"{name} distortion"] = lambda a, model=model: model(CAMERA, a)
        calls[f"{name}.project points"] = model(parameters).project
        calls[f"{name}.unproject pixels"] = model(parameters).unproject
    return calls


@pytest.fixture(scope="module")
def calls(tmp_path_factory):
    return entries(tmp_path_factory.mktemp("words"))


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("kind", TYPES, ids=lambda t: np.dtype(t).name)
def test_an_empty_array_has_an_empty_result_or_is_named(calls, shape, kind):
    words = {"time": "time_ns|times", "truth": "ground truth|trajectory", "times": "times|poses", "cameras": "cameras",
             "left": "left", "distortion": "parameters", "frame": "left image", "trajectory": "trajectory|estimate",
             "mask": "mask", "poses": "poses", "descriptors": "descriptors"}
    for name, call in calls.items():
        argument = name.split(" ", 1)[1].strip()
        try:
            call(np.empty(shape, kind))
        except ValueError as e:
            wanted = words.get(argument, argument)
            assert any(word in str(e) for word in wanted.split("|")), f"{name}: {e}"
        except RuntimeError as e:
            assert "load_map" in name, f"{name}: {e!r}"  # damaged bytes


def test_every_public_entry_is_called_here(calls):
    """A method that is new needs a line above, or one here: it takes no array."""
    without_arrays = {
        "CalibrationWarning", "CalibrationWarning.count", "CalibrationWarning.index",
        "Frame", "ImageFeatures", "ImageFeatures.from_cv2", "ImageFeatures.of", "Keypoints", "Sequence", "Sequence.describe", "StereoMatches", "Stream", "Tracking", "devices", "read_sequence", "read_tum",
        "Keypoints.to_cv2", "Keypoints.to_numpy", "MapSnapshot", "MapSnapshot.tobytes", "Odometry", "Odometry.keypoints", "Odometry.map",
        "Odometry.closed_loops", "Odometry.placed_keyframes", "Odometry.reset", "Odometry.save_map", "Odometry.snapshot_map", "Odometry.stage_times_us", "ClosedLoops", "Map", "PlacedKeyframes", "TrackedKeypoints", "TrackedKeypoints.of_camera", "OrbExtractor", "PlaceRecognition",
        "PlaceRecognition.add", "PlaceRecognition.erase", "PlaceRecognition.query", "PlaceRecognition.words", "Rectifier",
        "Rectifier.map", "StereoMatcher", "Trajectory.write_euroc", "Trajectory.write_kitti", "Trajectory.write_tum",
        "check_calibration",
    }
    known = {name.split(" ", 1)[0] for name in calls} | without_arrays
    for name in ft.__all__:
        of = getattr(ft, name)
        if not callable(of):
            continue
        assert name in known, name
        for method, _ in inspect.getmembers(of, callable) if inspect.isclass(of) else []:
            assert method.startswith("_") or f"{name}.{method}" in known, f"{name}.{method}"


@pytest.mark.parametrize("name", MODELS)
def test_no_points_have_no_pixels(name):
    camera = getattr(ft, name)(MODELS[name])
    pixels, valid = camera.project(np.zeros((0, 3)))
    assert pixels.shape == (0, 2) and valid.shape == (0,) and valid.dtype == bool
    rays, valid = camera.unproject(np.zeros((0, 2)))
    assert rays.shape == (0, 3) and valid.shape == (0,)


def test_no_poses_are_written_and_read(tmp_path):
    nothing = ft.Trajectory.of([])
    assert len(nothing) == 0 and nothing.time_ns.dtype == np.int64 and nothing.poses.shape == (0, 4, 4)
    nothing.write_tum(tmp_path / "a.txt")
    assert len(ft.read_tum(tmp_path / "a.txt")) == 0
    nothing.write_kitti(tmp_path / "b.txt")
    assert (tmp_path / "b.txt").read_text() == ""
    nothing.write_euroc(tmp_path / "c.csv")
    assert (tmp_path / "c.csv").read_text().count("\n") == 1  # the heading


def test_errors_need_a_truth_and_say_so():
    two = [(1, np.eye(4)), (2, np.eye(4))]
    for missing in ([], None, ft.Trajectory.of([])):
        with pytest.raises(ValueError, match="ground truth"):
            ft.evaluate(two, missing)
    errors = ft.evaluate([], two)
    assert errors["pairs"] == 0 and errors["ate_m"] is None and errors["rpe_m"] is None


def test_an_image_without_keypoints(tmp_path):
    keypoints = ft.OrbExtractor(WIDTH, HEIGHT, device="host").extract(IMAGE)
    assert len(keypoints) == 0 and keypoints.descriptors.shape == (0, 32) and keypoints.to_numpy()[0].shape == (0, 2)
    matches = ft.StereoMatcher(ft.RectifiedPair(CAMERA, BASELINE), WIDTH, HEIGHT, device="host").match(IMAGE, IMAGE)
    assert len(matches.left) == len(matches.depth) == 0
    recognition = places(tmp_path)
    recognition.describe(keypoints.descriptors)
    assert recognition.words() == {} and recognition.query() == []
    pair = odometry()
    assert not pair.track(IMAGE, IMAGE, 1).tracked
    assert len(pair.keypoints()) == len(pair.keypoints().matched) == 0
    assert pair.map().position.shape == (0, 3) and pair.map().keyframe_T_world_camera.shape[1:] == (4, 4)


def test_colours_of_no_depths():
    assert view.depth_colours(np.zeros(0)).shape == (0, 3)
