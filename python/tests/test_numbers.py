# SPDX-License-Identifier: Apache-2.0
"""Numbers and arrays that people pass: what loses nothing is taken, what would is refused with words."""

import os
import time
import warnings

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH, follow

import ft

K = np.array([[CAMERA[0], 0, CAMERA[2]], [0, CAMERA[1], CAMERA[3]], [0, 0, 1]])
PAIR = ft.RectifiedPair(CAMERA, BASELINE)
POSES = [(1, np.eye(4)), (2, np.eye(4))]


def odometry(rig=PAIR, width=WIDTH, height=HEIGHT, **options):
    return ft.Odometry(rig, width, height, **{"features": 200, "device": "host", **options})


def with_imu():
    return odometry(imu=ft.Imu())


@pytest.mark.parametrize("when", [1403636579.76, np.float64(1.76), np.float32(2), 3.0, "5", None, np.datetime64(7, "ns"), [8]],
                         ids=repr)
@pytest.mark.parametrize("call", [
    lambda t: odometry().track(np.zeros((HEIGHT, WIDTH), np.uint8), np.zeros((HEIGHT, WIDTH), np.uint8), t),
    lambda t: odometry(batch=2).track([np.zeros((HEIGHT, WIDTH), np.uint8)] * 2, [np.zeros((HEIGHT, WIDTH), np.uint8)] * 2, [t, t]),
    lambda t: with_imu().add_imu(t, (0, 0, 0), (0, 0, 0)),
    lambda t: ft.Trajectory.of([(t, np.eye(4))]),
    lambda t: ft.Trajectory(np.array([t]), [np.eye(4)]),
    lambda t: ft.evaluate([(t, np.eye(4))], POSES),
    lambda t: ft.evaluate(POSES, [(t, np.eye(4))]),
], ids=["track", "batch", "add_imu", "of", "Trajectory", "evaluate", "truth"])
def test_a_time_that_is_no_int_is_refused(call, when):
    with pytest.raises(ValueError, match="nanoseconds|times have shape"):
        call(when)


@pytest.mark.parametrize("when", [2**63, -2**63 - 1, 10**30])
def test_a_time_beyond_64_bits_is_refused(walk, when):
    for call in (lambda: odometry().track(*walk.frame(0)[:2], when), lambda: with_imu().add_imu(when, (0, 0, 0), (0, 0, 0)),
                 lambda: ft.Trajectory.of([(when, np.eye(4))])):
        with pytest.raises(ValueError):
            call()


@pytest.mark.parametrize("kind", [int, np.int64, np.uint64, np.int32])
def test_times_of_any_int_are_taken(walk, kind):
    tracker, (left, right, _) = odometry(), walk.frame(0)
    assert tracker.track(left, right, kind(5)).keyframe
    with pytest.raises(ValueError, match="after"):
        tracker.track(left, right, time_ns=kind(5))
    assert tracker.track(left, right, time_ns=kind(6)).tracked
    assert ft.Trajectory.of([(kind(5), np.eye(4))]).time_ns.dtype == np.int64


def test_large_times_keep_each_nanosecond(tmp_path):
    times = [1403636579763555584 + i for i in range(3)]
    ft.Trajectory.of([(t, np.eye(4)) for t in times]).write_tum(tmp_path / "a.txt")
    assert ft.read_tum(tmp_path / "a.txt").time_ns.tolist() == times


def sizes(width, height):
    return [lambda: odometry(width=width, height=height), lambda: ft.OrbExtractor(width, height, device="host"),
            lambda: ft.StereoMatcher(PAIR, width, height, device="host")]


def test_sizes_of_opencv_are_taken(walk):
    for make in sizes(float(WIDTH), np.float64(HEIGHT)) + sizes(np.int32(WIDTH), np.uint16(HEIGHT)):
        make()
    want = follow(odometry(), walk, 3)[-1]
    got = follow(odometry(width=float(WIDTH), height=np.float64(HEIGHT), features=200.0, levels=np.float32(8)), walk, 3)[-1]
    assert np.array_equal(got.T_world_camera, want.T_world_camera)


@pytest.mark.parametrize("width", [640.5, np.float64(0.25), float("nan"), float("inf"), -WIDTH, 0, 2**31, -2**31, 2**32 + WIDTH, 1e300,
                                   "640", None, [640], 640j], ids=repr)
def test_sizes_that_are_no_whole_numbers_are_refused(width):
    for make in sizes(width, HEIGHT):
        with pytest.raises(ValueError, match="width"):
            make()


@pytest.mark.parametrize("name, make", [
    ("batch", lambda v: odometry(batch=v)), ("features", lambda v: odometry(features=v)),
    ("levels", lambda v: odometry(levels=v)), ("ini_threshold", lambda v: odometry(ini_threshold=v)),
    ("min_threshold", lambda v: odometry(min_threshold=v)), ("threads", lambda v: odometry(threads=v)),
    ("map_slots", lambda v: odometry(map_slots=v)), ("keyframes", lambda v: odometry(keyframes=v)),
    ("local_points", lambda v: odometry(local_points=v)), ("window_points", lambda v: odometry(window_points=v)),
    ("window", lambda v: odometry(window=(v, 5))), ("window", lambda v: odometry(window=(10, v))),
    ("mask", lambda v: odometry(mask_size=(v, HEIGHT))), ("mask", lambda v: odometry(mask_size=(WIDTH, v))),
    ("batch", lambda v: ft.OrbExtractor(WIDTH, HEIGHT, batch=v, device="host")),
    ("size", lambda v: odometry(ft.DistortedPair(CAMERA, CAMERA, T_RL, CAMERA, (v, HEIGHT)))),
    ("border", lambda v: ft.Rectifier(distorted(), WIDTH, HEIGHT, border=v, device="host")),
    ("threads", lambda v: ft.Rectifier(distorted(), WIDTH, HEIGHT, threads=v, device="host")),
    ("candidates", lambda v: odometry(vocabulary="words.txt", candidates=v)),
    ("max_frames", lambda v: ft.read_sequence("folder", max_frames=v)),
    ("keyframes", lambda v: ft.PlaceRecognition("words.txt", keyframes=v)),
    ("features", lambda v: ft.PlaceRecognition("words.txt", features=v)),
    ("levels_up", lambda v: ft.PlaceRecognition("words.txt", levels_up=v)),
])
@pytest.mark.parametrize("value", [2.5, float("nan"), 2**31, 2**32 + 1, "7", None], ids=repr)
def test_counts_that_an_int_cannot_hold_are_refused(name, make, value):
    with pytest.raises(ValueError, match=name):
        make(value)


@pytest.mark.parametrize("value", [-0.1, 1.5, float("nan"), float("inf"), "0.5", None], ids=repr)
@pytest.mark.parametrize("make", [odometry, lambda **o: ft.OrbExtractor(WIDTH, HEIGHT, device="host", **o)], ids=["odometry", "extractor"])
def test_corner_ratios_that_are_none_are_refused(make, value):
    with pytest.raises(ValueError, match="corner_ratio"):
        make(corner_ratio=value)


def test_a_corner_ratio_leaves_out_edges(walk):
    image = walk.frame(0)[0]
    counts = [len(ft.OrbExtractor(WIDTH, HEIGHT, device="host", features=200, corner_ratio=r).extract(image)) for r in (0, 1e-6, 0.5)]
    assert counts[0] == counts[1] > counts[2] > 0
    def found(**options):
        return follow(odometry(**options), walk, 3)[-1].keypoints

    assert found(corner_ratio=1e-6) >= found() > found(corner_ratio=0.5) > 0
    assert found() == found(corner_ratio=1 / 16), "the default"


@pytest.mark.parametrize("b", [-1, 1, 2**31 - 1])
def test_cameras_that_are_not_there_are_refused(walk, b):
    tracker, orb = odometry(mask_size=(WIDTH, HEIGHT), imu=ft.Imu()), ft.OrbExtractor(WIDTH, HEIGHT, device="host", mask_size=(8, 8))
    follow(tracker, walk, 1)
    mask = np.ones((HEIGHT, WIDTH), np.uint8)
    for call in (lambda: tracker.keypoints(b), lambda: tracker.map(b), lambda: tracker.save_map(b), lambda: tracker.snapshot_map(b), lambda: tracker.reset(b),
                 lambda: tracker.load_map(b"", b), lambda: tracker.predict(np.eye(4), b), lambda: tracker.set_mask(mask, 0, b),
                 lambda: tracker.set_mask(mask, 2 if b == 1 else b), lambda: tracker.add_imu(10**9, (0, 0, 0), (0, 0, 0), b),
                 lambda: orb.set_mask(np.ones((8, 8), np.uint8), b)):
        with pytest.raises(ValueError):
            call()


@pytest.mark.parametrize("name", ["batch", "map_slots", "keyframes", "local_points", "window_points", "threads", "features", "levels"])
def test_negative_counts_are_refused(name):
    with pytest.raises(ValueError):
        odometry(**{name: -1})


T_RL = np.eye(4)
T_RL[0, 3] = -BASELINE


def distorted(left=CAMERA, right=CAMERA, wanted=CAMERA):
    return ft.DistortedPair(left, right, T_RL, wanted, (WIDTH, HEIGHT))


@pytest.mark.parametrize("camera", [K, K.tolist(), K.astype(np.float32), ft.Pinhole(CAMERA), ft.Pinhole(K), np.array(CAMERA)],
                         ids=["array", "list", "float32", "model", "model of K", "numbers"])
def test_a_matrix_is_a_camera(walk, camera):
    want = follow(odometry(), walk, 3)[-1]
    got = follow(odometry(ft.RectifiedPair(camera, BASELINE)), walk, 3)[-1]
    assert np.array_equal(got.T_world_camera, want.T_world_camera)
    odometry(ft.RgbdCamera(camera)), odometry(ft.MonocularCamera(camera)), odometry(distorted(wanted=camera))
    odometry(ft.MultiRig([ft.RigCamera(camera, BASELINE)]))


@pytest.mark.parametrize("bad", [K.T, K + np.diag([0, 0, 1]), K[:2], np.hstack([K, np.zeros((3, 1))]), K[:, :2], K[None], np.eye(3) * np.nan,
                                 K + [[0, 1, 0], [0, 0, 0], [0, 0, 0]]],
                         ids=["transposed", "2", "2x3", "3x4", "3x2", "1x3x3", "nan", "skewed"])
def test_what_is_no_camera_matrix_is_refused(bad):
    with pytest.raises(ValueError, match="camera"):
        odometry(ft.RectifiedPair(bad, BASELINE))
    with pytest.raises(ValueError, match="parameters"):
        ft.Pinhole(bad)


@pytest.mark.parametrize("n", [0, 4, 5, 8])
def test_coefficients_of_opencv_are_taken(n):
    k = np.array([-0.28, 0.07, 2e-4, 2e-5, 0.01, 0.02, 0.003, 0.001])[:n]
    whole = ft.RadTan([*CAMERA, *k, *[0] * (8 - n)])
    pixels = np.random.default_rng(1).uniform(0, 200, (50, 2))
    for camera in (ft.RadTan([*CAMERA, *k]), ft.RadTan(K, k), ft.RadTan(K, k[None]), ft.RadTan(K, k[:, None].tolist())):
        assert camera.parameters == whole.parameters
        assert np.array_equal(camera.unproject(pixels)[0], whole.unproject(pixels)[0])
    odometry(ft.RgbdCamera([*CAMERA, *k])), odometry(distorted([*CAMERA, *k], ft.RadTan(K, k)))


@pytest.mark.parametrize("n", [1, 2, 3, 6, 7, 9, 12])
def test_other_numbers_of_coefficients_are_refused(n):
    for make in (lambda c: ft.RadTan(c), lambda c: odometry(distorted(left=c)), lambda c: odometry(ft.RgbdCamera(c))):
        with pytest.raises(ValueError, match="4, 8, 9 or 12"):
            make([*CAMERA, *[0.0] * n])


def test_cameras_of_another_model_are_refused():
    """Their parameters would be taken for others."""
    fisheye = ft.KannalaBrandt([*CAMERA, 0, 0, 0, 0])
    for make, camera in [(lambda c: distorted(left=c), fisheye),
                         (lambda c: distorted(right=c), ft.Unified([*CAMERA, 0.9, 0, 0, 0, 0])),
                         (ft.RgbdCamera, fisheye), (lambda c: ft.FisheyePair(c, fisheye, T_RL), ft.RadTan(CAMERA)),
                         (ft.MonocularCamera, ft.DoubleSphere([*CAMERA, 0, 0.5])), (lambda c: ft.RectifiedPair(c, 0.1), fisheye)]:
        with pytest.raises(ValueError, match=type(camera).__name__):
            odometry(make(camera))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e300, None], ids=repr)
def test_numbers_that_a_float_cannot_hold_are_refused(value):
    def imu(name):
        return lambda v: odometry(imu=ft.Imu(**{name: v}))

    def matrix(make):
        def call(v):
            M = np.eye(4, dtype=object)
            M[0, 3] = v
            return make(M)
        return call

    for make in [lambda v: odometry(ft.RectifiedPair((v, *CAMERA[1:]), BASELINE)), lambda v: odometry(ft.RectifiedPair((*CAMERA[:3], v), BASELINE)),
                 lambda v: odometry(ft.RectifiedPair(CAMERA, v)), lambda v: odometry(ft.RgbdCamera(CAMERA, v)),
                 lambda v: odometry(ft.RgbdCamera(CAMERA, min_depth=v)), lambda v: odometry(near_depth=v),
                 lambda v: odometry(scale_factor=v), lambda v: ft.RadTan([*CAMERA, 0, 0, 0, v]),
                 lambda v: odometry(ft.FisheyePair((*CAMERA, 0, 0, 0, v), (*CAMERA, 0, 0, 0, 0), T_RL)),
                 lambda v: odometry(ft.MultiRig([ft.RigCamera(CAMERA, v)])),
                 *map(imu, ["gyro_noise", "accel_noise", "gyro_walk", "accel_walk", "rate_hz"]),
                 matrix(lambda M: odometry(ft.FisheyePair((*CAMERA, 0, 0, 0, 0), (*CAMERA, 0, 0, 0, 0), M))),
                 matrix(lambda M: odometry(ft.MultiRig([ft.RigCamera(CAMERA, 0.1, M)]))), matrix(lambda M: odometry(imu=ft.Imu(M))),
                 matrix(lambda M: odometry().predict(M)), lambda v: ft.evaluate(POSES, POSES, interval_s=v)]:
        with pytest.raises(ValueError):
            make(value)


def test_a_sample_of_an_imu_has_three_numbers():
    for bad in ((0, None, 0), (0, "1", 0), (0, 0), (0, 0, 0, 0), 1.0, None):
        for call in (lambda: with_imu().add_imu(1, bad, (0, 0, 0)), lambda: with_imu().add_imu(1, (0, 0, 0), bad)):
            with pytest.raises(ValueError, match="accel|gyro"):
                call()


def test_poses_that_are_no_motions_are_refused(tmp_path):
    for bad in (np.zeros((4, 4)), 2 * np.eye(4), np.diag([1.0, 1, -1, 1]), np.full((4, 4), np.nan), np.eye(4) + np.diag([0, 0, 0, 1.0])):
        for call in (lambda: ft.evaluate([(1, bad)], POSES), lambda: ft.evaluate(POSES, [(1, bad)]),
                     lambda: ft.Trajectory.of([(1, bad)]).write_tum(tmp_path / "a"),
                     lambda: ft.Trajectory.of([(1, bad)]).write_kitti(tmp_path / "a")):
            with pytest.raises(ValueError, match="pose 0"):
                call()
    for shape in ((3, 3), (3, 4), (16,)):
        with pytest.raises(ValueError, match="poses"):
            ft.Trajectory.of([(1, np.zeros(shape))])


def test_masks_may_be_bool(walk):
    left = walk.frame(0)[0]
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:, WIDTH // 2:] = True
    by_type = []
    for given in (mask, mask.astype(np.uint8), 255 * mask.astype(np.uint8)):
        orb = ft.OrbExtractor(WIDTH, HEIGHT, mask_size=(WIDTH, HEIGHT), device="host")
        orb.set_mask(given)
        by_type.append(orb.extract(left))
        tracker = odometry(mask_size=(WIDTH, HEIGHT))
        tracker.set_mask(given)
        tracker.set_mask(given, camera=1)
        by_type.append(tracker.track(*walk.frame(0)) and tracker.keypoints())
    assert len(by_type[0]) > 20 and by_type[0].x.min() >= WIDTH // 2 - 4
    assert all(np.array_equal(k.x, by_type[0].x) for k in by_type[2::2])
    assert all(np.array_equal(k.x, by_type[1].x) for k in by_type[3::2])
    with pytest.raises(ValueError, match="uint8 and bool"):
        orb.set_mask(mask.astype(float))
    with pytest.raises(ValueError, match="mask"):
        odometry().set_mask(mask)  # without mask_size


def test_rows_too_far_apart_are_refused():
    """Their distance would be cut to 32 bits. Nothing reads the rows."""
    one = np.zeros(WIDTH, np.uint8)
    far = np.lib.stride_tricks.as_strided(one, (HEIGHT, WIDTH), (2**32 + WIDTH, 1))
    with pytest.raises(ValueError, match="left image has a distance of rows of 4294967616, must be at most 2147483647"):
        odometry().track(far, far, 1)
    with pytest.raises(ValueError, match="image 0"):
        ft.OrbExtractor(WIDTH, HEIGHT, device="host").extract(far)
    packed = np.zeros((HEIGHT, WIDTH), [("grey", "u1"), ("depth", "<u2")])["depth"]  # 3 bytes a pixel
    with pytest.raises(ValueError, match="depth image"):
        odometry(ft.RgbdCamera(CAMERA, depth_scale=0.001)).track(np.zeros((HEIGHT, WIDTH), np.uint8), packed, 1)


def test_images_of_a_batch_are_counted(walk):
    """The shorter list would hide the longer one's rest."""
    left, right, t = walk.frame(0)
    with pytest.raises(ValueError, match="3 and 2 images"):
        odometry(batch=2).track([left] * 3, [right] * 2, [t, t])
    with pytest.raises(ValueError, match="2 and 1 images"):
        ft.StereoMatcher(PAIR, WIDTH, HEIGHT, batch=1, device="host").match([left] * 2, [right])
    with pytest.raises(ValueError, match="time_ns"):
        odometry(batch=2).track([left] * 2, [right] * 2, t)
    with pytest.raises(ValueError, match="track"):
        odometry().track()


def test_keyframes_beyond_32_bits_are_not_erased(tmp_path):
    from test_empty_arrays import places
    recognition = places(tmp_path)
    recognition.describe(np.zeros((3, 32), np.uint8))
    number = recognition.add()
    for other in (number + 2**32, number - 2**32, -1):
        with pytest.raises(ValueError, match=str(other)):
            recognition.erase(other)
    assert len(recognition) == 1
    recognition.erase(number)


def test_the_unit_of_depths(walk):
    left, _, t = walk.frame(0)
    depth = walk.depth(0)
    tracker = odometry(ft.RgbdCamera(CAMERA))
    with pytest.raises(ValueError, match="depth_scale"):
        tracker.track(left, depth, t)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tracker.track(left, (0.001 * depth).astype(np.float32), t).keyframe  # metres
        assert odometry(ft.RgbdCamera(CAMERA, depth_scale=0.001)).track(left, depth, t).keyframe
    for scale in (1.0, 1000.0):
        with pytest.warns(UserWarning) as told:
            pose = odometry(ft.RgbdCamera(CAMERA, depth_scale=scale)).track(left, depth, t)
        assert sum("unit of depths" in str(warning.message) for warning in told) == 1
        assert pose.tracked and pose.reason == "depth_scale"


def test_limits_of_depths(walk):
    def depths(**limits):
        tracker = odometry(ft.RgbdCamera(CAMERA, depth_scale=0.001, **limits))
        tracker.track(walk.frame(0)[0], walk.depth(0), 1)
        found = tracker.keypoints().depth
        return found[found > 0]
    every = depths()
    assert every.min() < 1.3 and every.max() > 2.9
    assert depths(min_depth=2).min() > 2.9 and depths(max_depth=2.0).max() < 1.3
    assert len(depths(min_depth=2)) + len(depths(max_depth=2)) == len(every)
    for limits, name in (({"min_depth": -1}, "min_depth"), ({"min_depth": 2, "max_depth": 1}, "max_depth"),
                         ({"max_depth": float("nan")}, "max_depth")):
        with pytest.raises(ValueError, match=name):
            depths(**limits)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_child_ends(walk, tmp_path):
    """Threads are not forked: there the parent's objects are refused, and deleted without waiting for any."""
    trackers = [odometry(), odometry(threads=2), ft.OrbExtractor(WIDTH, HEIGHT, device="host", threads=2)]
    follow(trackers[0], walk, 3), follow(trackers[1], walk, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of fork beside threads
        child = os.fork()
    if child == 0:
        status = 1
        try:
            try:
                trackers[0].track(*walk.frame(3))
            except RuntimeError as e:
                status = 0 if "fork" in str(e) else 2
            trackers.clear()
        finally:
            os._exit(status)
    for _ in range(300):
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            break
        time.sleep(0.1)
    else:
        os.kill(child, 9)
        os.waitpid(child, 0)
        pytest.fail("the child hangs")
    assert status == 0
    assert trackers[0].track(*walk.frame(3)).tracked
