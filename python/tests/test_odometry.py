# SPDX-License-Identifier: Apache-2.0
import dataclasses
import gc
import inspect
import re
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, FAR, HEIGHT, NEAR, WIDTH, effort, follow

import ft
from ft import _ft


def test_the_walk_is_found(walk, device):
    poses = follow(walk.odometry(device=device), walk, 15)
    assert all(p.tracked for p in poses)
    for i, p in enumerate(poses):
        assert np.allclose(p.T_world_camera[:2, 3], walk.position(i), atol=0.01)
    assert poses[0].keyframe and poses[-1].map_points > 100 and poses[-1].maps == 1
    assert poses[-1].covariance.shape == (6, 6) and np.all(np.diag(poses[-1].covariance) > 0)


def test_host_and_gpu_agree_to_the_bit(walk, device):
    a = follow(walk.odometry(), walk, 8)
    b = follow(walk.odometry(device=device), walk, 8)
    assert all(np.array_equal(p.T_world_camera, q.T_world_camera) for p, q in zip(a, b))


def test_loops_are_plugged_in(walk, device):
    odometry = walk.odometry(device=device, loops=True)
    poses = follow(odometry, walk, 8)
    plain = follow(walk.odometry(device=device), walk, 8)
    placed = odometry.placed_keyframes()
    n = sum(p.keyframe for p in poses)
    assert n > 0 and placed.time_ns.tolist() == [50_000_000 * i for i, p in enumerate(poses) if p.keyframe]
    assert placed.T_odom_camera.shape == placed.T_world_camera.shape == (n, 4, 4)
    assert placed.map.tolist() == [1] * n and placed.scale.tolist() == [1.0] * n
    assert placed.loaded.tolist() == [False] * n
    closed = odometry.closed_loops()
    assert closed.T_from_to.shape == (0, 4, 4) and len(closed) == 0
    for p, q in zip(poses, plain):  # a straight line has no loop
        assert p.loops_closed == 0 and np.array_equal(p.T_world_odom, np.eye(4)) and p.odom_scale == 1
        assert np.array_equal(p.T_odom_camera, q.T_world_camera) and np.array_equal(p.T_world_camera, q.T_world_camera)
    assert len(walk.odometry().placed_keyframes()) == 0
    with pytest.raises(ValueError, match="batch"):
        walk.odometry(batch=2, loops=True)


def test_a_batch_tracks_each_camera_as_alone(walk):
    both = walk.odometry(batch=2)
    alone = walk.odometry()
    for i in range(6):
        a, b = walk.frame(i), walk.frame(i + 3)
        got = both.track([a[0], b[0]], [a[1], b[1]], [a[2], a[2]])
        assert np.array_equal(got[0].T_world_camera, alone.track(*a).T_world_camera)
        assert got[1].tracked


def test_depth_images_replace_the_right_one(walk):
    odometry = ft.Odometry(ft.RgbdCamera(CAMERA, depth_scale=0.001), WIDTH, HEIGHT, features=400, device="host")
    for i in range(8):
        left, _, t = walk.frame(i)
        depth = walk.depth(i)
        pose = odometry.track(left, depth, t)
        assert pose.tracked and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)
    assert odometry.track(left, depth.astype(np.float32), t + 1).tracked


def test_distorted_images_are_rectified(walk):
    T = np.eye(4)
    T[0, 3] = -BASELINE
    rig = ft.DistortedPair(CAMERA, CAMERA, T, CAMERA, (WIDTH, HEIGHT))
    odometry = ft.Odometry(rig, WIDTH, HEIGHT, features=400, device="host")
    for i in range(5):
        assert np.allclose(odometry.track(*walk.frame(i)).T_world_camera[:2, 3], walk.position(i), atol=0.01)


def test_fisheye_images_are_searched_as_they_are(walk):
    T = np.eye(4)
    T[0, 3] = -BASELINE
    lens = (*CAMERA, 1 / 3, 2 / 15, 0, 0)  # nearly a pinhole: tan
    odometry = ft.Odometry(ft.FisheyePair(lens, lens, T), WIDTH, HEIGHT, features=400, device="host")
    for i in range(6):
        pose = odometry.track(*walk.frame(i))
    assert pose.tracked and np.allclose(pose.T_world_camera[:2, 3], walk.position(5), atol=0.02)


def test_a_map_goes_out_and_in(walk):
    first = walk.odometry()
    follow(first, walk, 6)
    saved = first.save_map()
    points = first.map()
    assert points.position.shape == (len(points.number), 3)
    z = points.position[:, 2]
    assert np.mean((abs(z - NEAR) < 0.1) | (abs(z - FAR) < 0.3)) > 0.9
    second = walk.odometry()
    second.load_map(saved)
    assert second.track(*walk.frame(6)).tracked
    with pytest.raises(RuntimeError):
        second.load_map(saved[:-10])


def test_a_snapshot_is_written_while_tracking_goes_on(walk):
    odometry, other = walk.odometry(), walk.odometry()
    follow(odometry, walk, 6)
    saved, snapshot = odometry.save_map(), odometry.snapshot_map()
    written = []
    thread = threading.Thread(target=lambda: written.extend(snapshot.tobytes() for _ in range(20)))
    thread.start()
    later = [odometry.track(*walk.frame(i)) for i in range(6, 12)]
    thread.join()
    assert all(w == saved for w in written) and len(written) == 20
    want = follow(other, walk, 12)[6:]
    assert all(np.array_equal(a.T_world_camera, b.T_world_camera) for a, b in zip(later, want))
    assert odometry.save_map() != saved
    del odometry
    assert snapshot.tobytes() == saved


def test_columns_are_those_of_the_docstrings(walk):
    """Each field with its type, as "name: (n) int32" and "a, b: (n) float32"; none can be set."""
    odometry = walk.odometry(loops=True)
    follow(odometry, walk, 6)
    for found in (odometry.keypoints(), odometry.map(), odometry.placed_keyframes(), odometry.closed_loops()):
        told = " ".join(type(found).__doc__.split())
        for field in dataclasses.fields(found):
            column = getattr(found, field.name)
            kind = "bool" if column.dtype == bool else column.dtype.name
            assert re.search(rf"\b{field.name}\b[^.]*: \([^)]*\) {kind}\b", told), (field.name, kind)
            assert kind in str(field.type).replace("bool_", "bool"), (field.name, kind, field.type)
            with pytest.raises(dataclasses.FrozenInstanceError):
                setattr(found, field.name, column)
    k = odometry.keypoints()
    assert len(k.of_camera(0)) == len(k) and len(k.of_camera(1)) == 0


def test_maps_that_do_not_fit_change_nothing(walk):
    """Of other rigs, sizes and settings, cut off, or with a byte that is another one."""
    made = walk.odometry()
    follow(made, walk, 5)
    saved = made.save_map()
    other = {
        "baseline": ft.Odometry(ft.RectifiedPair(CAMERA, 0.5), WIDTH, HEIGHT, features=400, device="host"),
        "fx": ft.Odometry(ft.RectifiedPair((300.0, *CAMERA[1:]), BASELINE), WIDTH, HEIGHT, features=400, device="host"),
        "size": ft.Odometry(walk.rig, WIDTH + 16, HEIGHT, features=400, device="host"),
        "rig": ft.Odometry(ft.MultiRig([ft.RigCamera(CAMERA, BASELINE)]), WIDTH, HEIGHT, features=400, device="host"),
    }
    for name, odometry in other.items():
        with pytest.raises(RuntimeError, match=name):
            odometry.load_map(saved)
    random = np.random.default_rng(7)
    tracker = walk.odometry()
    want = follow(walk.odometry(), walk, 3)
    assert np.array_equal(tracker.track(*walk.frame(0)).T_world_camera, want[0].T_world_camera)
    damaged = [b"", b"no map", saved[:8], saved[:100], saved[:len(saved) // 2], saved[:-1], saved + b"\0", memoryview(saved)[:-9]]
    for at in random.integers(0, len(saved), 40):
        changed = bytearray(saved)
        changed[at] ^= int(random.integers(1, 256))
        damaged.append(changed)
    for data in damaged[:6] + damaged[7:]:
        with pytest.raises(RuntimeError, match="map"):
            tracker.load_map(data)
    for no_bytes in (None, "text", 5, [1, 2]):
        with pytest.raises(ValueError, match="save_map"):
            tracker.load_map(no_bytes)
    for i in (1, 2):
        assert np.array_equal(tracker.track(*walk.frame(i)).T_world_camera, want[i].T_world_camera)
    tracker.load_map(bytearray(saved))
    assert tracker.track(*walk.frame(5)).tracked


def test_keypoints_hold_points(walk):
    odometry = walk.odometry()
    follow(odometry, walk, 3)
    k = odometry.keypoints()
    assert len(k) == len(k.matched) and k.matched.sum() > 50
    assert np.all(k.point[k.matched] >= 0)
    with pytest.raises(ValueError):
        odometry.keypoints(1)


def test_predict_and_reset(walk):
    odometry = walk.odometry()
    follow(odometry, walk, 3)
    odometry.predict(odometry.track(*walk.frame(3)).T_world_camera)
    assert odometry.track(*walk.frame(4)).tracked
    odometry.reset()
    again = odometry.track(*walk.frame(0))
    assert again.maps == 1 and np.array_equal(again.T_world_camera, np.eye(4))
    with pytest.raises(ValueError):
        odometry.predict(np.diag([2.0, 1, 1, 1]))
    with pytest.raises(ValueError):
        odometry.predict(np.eye(3))


def test_why_a_frame_is_not_tracked(walk):
    left, right, t = walk.frame(0)
    one = lambda a, b: walk.odometry().track(a, b, 1)
    fine = one(left, right)
    assert fine.tracked and fine.reason == fine.explanation == ""
    noise = np.random.default_rng(1)
    grey = noise.integers(126, 129, left.shape).astype(np.uint8)
    for images, reason, words in [((left // 40, right // 40), "dark", "mean grey value"), ((255 - left // 40, 255 - right // 40), "bright", "white"),
                                  ((grey, grey), "low_texture", "uniform"), ((right, left), "stereo_inconsistent", "exchanged")]:
        pose = one(*images)
        assert not pose.tracked and pose.reason == reason and words in pose.explanation, pose.explanation
        assert f"({reason})" in repr(pose)
    depth = np.zeros(left.shape, np.uint16)
    pose = ft.Odometry(ft.RgbdCamera(CAMERA, depth_scale=0.001), WIDTH, HEIGHT, features=400, device="host").track(left, depth, t)
    assert not pose.tracked and pose.reason == "no_depth"
    single = ft.Odometry(ft.MonocularCamera(CAMERA), WIDTH, HEIGHT, features=400, device="host")
    assert single.track(left, 1).reason == "awaits_motion"
    tracker = walk.odometry()
    follow(tracker, walk, 3)
    black = np.zeros_like(left)
    assert tracker.track(black, black, t + 10**9).reason == "dark"


def test_samples_of_an_imu_are_taken(walk):
    odometry = walk.odometry(imu=ft.Imu())
    for i in range(6):
        for k in range(10):
            odometry.add_imu(50_000_000 * i - 49_000_000 + 5_000_000 * k, (0, -9.81, 0), (0, 0, 0))
        assert odometry.track(*walk.frame(i)).tracked
    odometry.add_imu(0, (0, -9.81, 0), (0, 0, 0))  # left out: its time is not after the last one's
    odometry.add_imu(10**12, (0, float("nan"), 0), (0, 0, 0))  # likewise, and counted
    with pytest.raises(ValueError):
        walk.odometry().add_imu(0, (0, 0, 0), (0, 0, 0))


def test_what_is_wrong_with_samples_of_an_imu_is_said(walk):
    def after(step_ns, strange=0.0, ahead_ns=0):
        odometry = walk.odometry(imu=ft.Imu(rate_hz=200))
        for k in range(1, 50):
            odometry.add_imu(10**9 + (k - 49) * step_ns + ahead_ns, (strange if k == 20 else 0.0, -9.81, 0), (0, 0, 0))
        return odometry.track(*walk.frame(0)[:2], 10**9)

    good = after(5_000_000)
    assert good.imu_warnings == [] and abs(good.imu_rate_hz - 200) < 0.01 and good.imu_newest_s == 0
    none_left_out = dict.fromkeys(("disordered", "out_of_range", "crowded_out", "frozen", "spikes"), 0)
    assert good.imu_left_out == none_left_out and not good.imu_predicted
    slow = after(20_000_000)
    assert slow.imu_warnings == ["samples of the IMU come at 50 Hz, rate_hz says 200"] and abs(slow.imu_rate_hz - 50) < 0.01
    for strange in (1e7, -1e7, 1e300, float("nan"), float("inf")):
        spike = after(5_000_000, strange)
        assert spike.imu_left_out == {**none_left_out, "out_of_range": 1}
        assert [text[:30] for text in spike.imu_warnings] == ["samples of the IMU left out: 1"]
    early = after(5_000_000, 0.0, 10 * 10**9)
    assert abs(early.imu_newest_s - 10) < 1e-6 and "10 s after its image" in early.imu_warnings[-1]
    none = walk.odometry().track(*walk.frame(0))
    assert none.imu_warnings == [] and none.imu_rate_hz == 0


def test_the_state_of_an_imu_has_a_reason(walk):
    odometry = walk.odometry(imu=ft.Imu())
    first = odometry.track(*walk.frame(0))
    assert first.map_begun and first.maps == 1
    assert (first.imu_state, first.imu_reason, first.imu_samples) == ("initialising", "no_samples", "no_samples")
    assert first.imu_explanation == "there are no samples since the frame before"
    for i in range(1, 3):
        for k in range(10):
            odometry.add_imu(50_000_000 * i - 45_000_000 + 5_000_000 * k, (0, -9.81, 0), (0, 0, 0))
        pose = odometry.track(*walk.frame(i))
    assert not pose.map_begun
    assert (pose.imu_state, pose.imu_reason, pose.imu_samples) == ("initialising", "few_keyframes", "integrated")
    assert pose.imu_estimate == "few_keyframes" and "keyframes in a row" in pose.imu_explanation
    assert 0 <= pose.imu_unused_s <= 0.1 + 1e-9
    assert pose.imu_turn_in_use.shape == (3,) and not pose.imu_turn_in_use.any() and pose.imu_misalignment is None
    none = walk.odometry().track(*walk.frame(0))
    assert (none.imu_state, none.imu_reason, none.imu_explanation, none.imu_unused_s) == ("", "", "", 0)
    assert not none.imu_turn_in_use.any()


def test_mistakes_are_named_and_change_nothing(walk):
    odometry = walk.odometry()
    left, right, t = walk.frame(0)
    odometry.track(left, right, t)
    for bad, word in ((left[:, ::2], "left image"), (left.astype(np.int32), "uint8"), (left[:-1], "shape"), (None, "left image")):
        with pytest.raises(ValueError, match=word):
            odometry.track(bad, right, t + 1)
    with pytest.raises(ValueError, match="after"):
        odometry.track(left, right, t)
    assert odometry.track(*walk.frame(1)).tracked


@pytest.mark.parametrize("do, message", [
    (lambda rig: ft.Odometry(rig, WIDTH, HEIGHT, imu=True), "imu is a bool, must be an ft.Imu, or None"),
    (lambda rig: ft.Odometry(rig, WIDTH, HEIGHT, device=None), "device is 'None', must be auto, host or cuda"),
    (lambda rig: ft.OrbExtractor(WIDTH, HEIGHT, device=0), "device is '0', must be auto, host or cuda"),
    (lambda rig: ft.Odometry(rig, WIDTH, HEIGHT, device="host").track([[1, 2]], [[1, 2]], 5), "time_ns is 5, must be a list"),
    (lambda rig: ft.Odometry(rig, WIDTH, HEIGHT, device="host", mask_size=(WIDTH, HEIGHT)).set_masks(np.zeros((HEIGHT, WIDTH), np.uint8)),
     "masks is one array, must be a list"),
])
def test_arguments_of_another_kind_are_named_with_what_is_taken(do, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        do(ft.RectifiedPair(CAMERA, BASELINE))


@pytest.mark.parametrize("make", [
    lambda: ft.Odometry(ft.RectifiedPair(CAMERA, -1.0), WIDTH, HEIGHT),
    lambda: ft.Odometry(ft.RectifiedPair((0, 1, 2, 3), 0.1), WIDTH, HEIGHT),
    lambda: ft.Odometry(ft.RectifiedPair((1, 2, 3), 0.1), WIDTH, HEIGHT),
    lambda: ft.Odometry("a rig", WIDTH, HEIGHT),
    lambda: ft.Odometry(ft.RectifiedPair(CAMERA, 0.1), 0, HEIGHT),
    lambda: ft.Odometry(ft.RectifiedPair(CAMERA, 0.1), WIDTH, HEIGHT, batch=0),
    lambda: ft.Odometry(ft.FisheyePair(CAMERA, CAMERA, 2 * np.eye(4)), WIDTH, HEIGHT),
    lambda: ft.Odometry(ft.RgbdCamera(CAMERA, depth_scale=float("nan")), WIDTH, HEIGHT),
    lambda: ft.Odometry(ft.RectifiedPair(CAMERA, 0.1, readout_s=-0.01), WIDTH, HEIGHT),
    lambda: ft.Odometry(ft.MonocularCamera(CAMERA, readout_s=0.2), WIDTH, HEIGHT),
    lambda: ft.Odometry(ft.MultiRig([ft.RigCamera(CAMERA, 0.1, readout_s=float("nan"))]), WIDTH, HEIGHT),
    lambda: ft.Odometry(ft.RgbdCamera(CAMERA, readout_s="20 ms"), WIDTH, HEIGHT),
])
def test_rigs_that_cannot_be_are_refused(make):
    with pytest.raises(ValueError):
        make()


def rolling(walk, i, readout_s):
    """Both images of a walk of 0.4 m/s to the right and 0.1 m/s down whose rows are read one after the other. A few rows have
    one time."""
    images = np.zeros((2, HEIGHT, WIDTH), np.uint8)
    for first in range(0, HEIGHT, 4):
        late = readout_s * ((first + 1.5) / (HEIGHT - 1) - 0.5) / 0.05  # frames
        images[:, first:first + 4] = np.stack(walk.images_at(i + late, (0, 0)))[:, first:first + 4]
    return (*images, 50_000_000 * i)


def test_rows_that_are_read_one_after_the_other(walk):
    def followed(readout_s):
        odometry = ft.Odometry(ft.RectifiedPair(CAMERA, BASELINE, readout_s), WIDTH, HEIGHT, features=400, device="host")
        poses = [odometry.track(*rolling(walk, i, 0.04)) for i in range(12)]
        assert all(pose.tracked for pose in poses)
        return odometry.keypoints()

    treated, plain = followed(0.04), followed(0.0)
    # Rows of the lower half are read up to 15 ms late, and show what is 1.2 m away up to a pixel too far left.
    assert len(treated) == len(plain)
    near = (plain.depth > 0) & (plain.depth < 2) & (plain.y > 0.6 * HEIGHT)
    late = 0.04 * (plain.y[near] / (HEIGHT - 1) - 0.5)
    assert near.sum() > 10
    assert np.allclose((treated.x - plain.x)[near], late * 0.4 * CAMERA[0] / NEAR, atol=0.25)


def test_two_threads_have_a_tracker_each(walk):
    want = follow(walk.odometry(threads=1), walk, 8)
    got = [None, None]

    def run(k):
        got[k] = follow(walk.odometry(threads=1), walk, 8)

    threads = [threading.Thread(target=run, args=(k,)) for k in (0, 1)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    for poses in got:
        assert all(np.array_equal(a.T_world_camera, b.T_world_camera) for a, b in zip(want, poses))


def test_images_may_go_before_the_next_frame(walk):
    odometry = walk.odometry()
    want = follow(walk.odometry(), walk, 4)
    for i in range(4):
        left, right, t = (np.array(v) for v in walk.frame(i))
        pose = odometry.track(left, right, int(t))
        left[:] = 0
        del left, right
        gc.collect()
        assert np.array_equal(pose.T_world_camera, want[i].T_world_camera)


def test_memory_does_not_grow(walk):
    resource = pytest.importorskip("resource")
    odometry = walk.odometry(threads=1, keyframes=16)
    frames = [walk.frame(i) for i in range(10)]
    order = frames + frames[::-1]
    for n in range(40):
        odometry.track(*order[n % 20][:2], n + 1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for n in range(40, 40 + effort(10_000)):
        odometry.track(*order[n % 20][:2], n + 1)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 8 * 1024


def test_ctrl_c_ends_a_loop():
    # Shells start what runs in the background with SIGINT ignored, and Python leaves that so.
    program = """
import signal, sys; sys.path.insert(0, %r)
signal.signal(signal.SIGINT, signal.default_int_handler)
from conftest import Walk
walk = Walk(); odometry = walk.odometry(); n = 0
left, right, _ = walk.frame(0)
try:
    while True:
        odometry.track(left, right, n); n += 1
        if n == 3: print('ready', flush=True)
except KeyboardInterrupt:
    print('stopped', n > 2)
""" % __file__.rsplit("/", 1)[0]
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as p:
        try:
            assert p.stdout.readline() == "ready\n"
            p.send_signal(signal.SIGINT)
            assert p.communicate(timeout=60)[0] == "stopped True\n"
        finally:
            p.kill()


def test_images_on_the_device_are_read_in_place(walk):
    cupy = pytest.importorskip("cupy")
    if len(ft.devices()) < 2:
        pytest.skip("no GPU, or built without CUDA")
    odometry = walk.odometry(device="cuda")
    want = follow(walk.odometry(), walk, 6)
    stream = cupy.cuda.Stream(non_blocking=True)
    for i in range(6):
        left, right, t = walk.frame(i)
        with stream:
            a, b = cupy.asarray(left), cupy.asarray(right)
        pose = odometry.track(a, b, t, stream=stream.ptr)
        assert np.array_equal(pose.T_world_camera, want[i].T_world_camera)
    with pytest.raises(ValueError, match="multiples of 16"):
        odometry.track(cupy.zeros((HEIGHT, WIDTH + 1), cupy.uint8)[:, 1:], b, t + 1)
    with pytest.raises(ValueError, match="host memory"):
        walk.odometry().track(a, b, t)


def test_tensors_of_torch_are_read_in_place(walk):
    torch = pytest.importorskip("torch")
    if len(ft.devices()) < 2 or not torch.cuda.is_available():
        pytest.skip("no GPU, or built without CUDA")
    batch = 64
    odometry = walk.odometry(device="cuda", batch=batch)
    want = follow(walk.odometry(), walk, 4)
    for i in range(4):
        left, right, t = walk.frame(i)
        lefts = torch.from_numpy(left).cuda().expand(batch, HEIGHT, WIDTH).contiguous()
        rights = torch.from_numpy(right).cuda().expand(batch, HEIGHT, WIDTH).contiguous()
        poses = odometry.track(list(lefts), list(rights), [t] * batch)
        assert all(np.array_equal(p.T_world_camera, want[i].T_world_camera) for p in poses)


def test_defaults_are_those_of_cpp():
    arguments = dict(inspect.signature(ft.Odometry.__init__).parameters)
    of_python = {"self", "rig", "width", "height", "imu", "batch", "device", "vocabulary", "descriptors", "threads"}
    assert set(arguments) - of_python == set(_ft.defaults())
    for name, default in _ft.defaults().items():
        given = arguments[name].default
        assert given == (pytest.approx(default) if isinstance(default, float) else default), name
