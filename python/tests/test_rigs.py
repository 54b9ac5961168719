# SPDX-License-Identifier: Apache-2.0
"""Rigs of several cameras, and one camera from nothing."""

import warnings

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, FAR, HEIGHT, NEAR, WIDTH, Walk
from test_sequences import write_png

import ft
from ft.unpacking import write_depth_png

ASIDE, ABOVE = (0.3, 0.1), (0.15, -0.05)  # where other cameras of the body are, metres


def mounted(offset, baseline=BASELINE):
    """A camera that looks as the body does, from an offset in x and y."""
    T = np.eye(4)
    T[:2, 3] = np.negative(offset)
    return ft.RigCamera(CAMERA, baseline, T)


def odometry_of(rig, device="host", features=400, **options):
    return ft.Odometry(rig, WIDTH, HEIGHT, features=features, device=device, **options)


def images_of(walk, i):
    return walk.images_at(i, (0, 0)) + walk.images_at(i, ASIDE)


def test_two_pairs_have_one_pose(walk, device):
    odometry = odometry_of(ft.MultiRig([mounted((0, 0)), mounted(ASIDE)]), device)
    for i in range(12):
        pose = odometry.track(*images_of(walk, i), 50_000_000 * i)
        assert pose.tracked and pose.metric and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)
    keypoints = odometry.keypoints()
    assert pose.keypoints == len(keypoints.x)
    for camera in (0, 1):
        of_camera = keypoints.camera == camera
        assert np.sum(keypoints.matched & of_camera) > 50
        assert np.sum(keypoints.depth[of_camera] > 0) > 50
    assert set(keypoints.camera) == {0, 1}


def test_a_second_pair_carries_on_alone(walk):
    odometry = odometry_of(ft.MultiRig([mounted((0, 0)), mounted(ASIDE)]))
    for i in range(8):
        images = images_of(walk, i)
        if i >= 4:
            images[0] = images[1] = np.zeros_like(images[0])
        pose = odometry.track(*images, 50_000_000 * i)
        assert pose.tracked and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)


def depth_camera(offset, camera=CAMERA):
    T = mounted(offset).T_camera_body
    return ft.RigCamera(camera, T_camera_body=T, has_depth=True)


@pytest.mark.parametrize("metres", [False, True])
def test_a_depth_camera_beside_a_single_one(walk, device, metres):
    """It makes the points, which both find."""
    rig = ft.MultiRig([mounted(ASIDE, baseline=0), depth_camera(ABOVE)], depth_scale=None if metres else 0.001)
    odometry = odometry_of(rig, device)
    for i in range(8):
        grey, = walk.images_at(i, ABOVE, pair=False)
        depth = walk.depth(i, ABOVE[1])
        depth = (depth / 1000).astype(np.float32) if metres else depth
        pose = odometry.track(*walk.images_at(i, ASIDE, pair=False), grey, depth, 50_000_000 * i)
        assert pose.tracked and pose.metric and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)
    assert np.sum(odometry.keypoints().matched & (odometry.keypoints().camera == 0)) > 50


def test_depth_images_of_a_rig_are_checked(walk):
    grey, = walk.images_at(0, ABOVE, pair=False)
    one, beside = depth_camera(ABOVE), mounted(ASIDE, baseline=0)
    odometry = odometry_of(ft.MultiRig([beside, one]))
    with pytest.raises(ValueError, match="depth image of camera 1 is uint16 and the rig has no depth_scale"):
        odometry.track(grey, grey, walk.depth(0), 0)
    with pytest.raises(ValueError, match="a frame of 2 images, must be 3"):
        odometry.track(grey, grey, 0)
    with pytest.raises(ValueError, match="the depth image of camera 1 has another type than uint16 and float32"):
        odometry.track(grey, grey, grey, 0)
    with pytest.raises(ValueError, match="right is 0 and has_depth"):
        odometry_of(ft.MultiRig([beside, ft.RigCamera(CAMERA, right=0, has_depth=True)]))
    with pytest.raises(ValueError, match="depth_scale is 0"):
        odometry_of(ft.MultiRig([beside, one], depth_scale=0.0))
    assert ft.check_calibration(ft.MultiRig([beside, one]), WIDTH, HEIGHT) == []


def test_a_rig_of_one_pair_has_the_answers_of_a_pair(walk):
    rig, pair = odometry_of(ft.MultiRig([mounted((0, 0))])), walk.odometry()
    for i in range(6):
        a, b = rig.track(*walk.frame(i)), pair.track(*walk.frame(i))
        assert a.keypoints == b.keypoints and a.inliers == b.inliers
        assert np.array_equal(a.T_world_camera, b.T_world_camera)


def test_a_single_camera_finds_the_points_of_a_pair(walk):
    odometry = odometry_of(ft.MultiRig([mounted(ABOVE, baseline=0), mounted((0, 0))]))
    for i in range(8):
        images = walk.images_at(i, ABOVE, pair=False) + walk.images_at(i, (0, 0))
        pose = odometry.track(*images, 50_000_000 * i)
        assert pose.tracked and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)
    keypoints = odometry.keypoints()
    single = keypoints.camera == 0
    assert np.all(keypoints.depth[single] < 0) and np.sum(keypoints.matched & single) > 30


def test_a_pair_of_two_cameras_of_different_models(walk):
    T = np.eye(4)
    T[0, 3] = -BASELINE
    rig = ft.MultiRig([ft.RigCamera(CAMERA, right=1), ft.RigCamera(ft.RadTan(CAMERA), T_camera_body=T)])
    assert not ft.check_calibration(rig, WIDTH, HEIGHT)
    odometry = odometry_of(rig)
    for i in range(5):
        pose = odometry.track(*walk.frame(i))
        assert pose.tracked and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)
    for right, text in ((2, "right camera of camera 0 is 2, must be below 2"), (-1, "right is -1, must be in"), (0, "must be another camera")):
        rig.cameras[0].right = right
        with pytest.raises(ValueError, match=text):
            odometry_of(rig)
    with pytest.raises(ValueError, match="right is 1 and baseline is 0.1"):
        odometry_of(ft.MultiRig([ft.RigCamera(CAMERA, 0.1, right=1), ft.RigCamera(CAMERA)]))


def test_five_cameras_and_batches(walk):
    offsets = [(0, 0), ASIDE, ABOVE, (-0.1, 0.05), (0.1, 0.1)]
    rig = ft.MultiRig([mounted(o, BASELINE if k < 2 else 0) for k, o in enumerate(offsets)])
    both, alone = odometry_of(rig, batch=2), odometry_of(rig)
    images = lambda i: [image for k, o in enumerate(offsets) for image in walk.images_at(i, o, pair=k < 2)]
    for i in range(4):
        a, b = images(i), images(i + 2)
        t = 50_000_000 * i
        got = both.track(*zip(a, b), [t, t])
        want = alone.track(*a, t)
        assert got[0].inliers == want.inliers and np.array_equal(got[0].T_world_camera, want.T_world_camera)
        assert got[1].tracked and np.allclose(want.T_world_camera[:2, 3], walk.position(i), atol=0.01)
    assert max(alone.keypoints().camera) == 4


def scale_and_error(positions, truth):
    """The scale that fits positions, from the first one on, to true ones, and the largest distance, as a share of the
    path."""
    a, b = np.array(positions) - positions[0], np.array(truth) - truth[0]
    scale = np.sum(a * b) / np.sum(a * a)
    return scale, np.max(np.linalg.norm(scale * a - b, axis=1)) / np.linalg.norm(b[-1])


@pytest.mark.parametrize("camera", [CAMERA, ft.KannalaBrandt([*CAMERA, 1 / 3, 2 / 15, 0, 0])], ids=["pinhole", "fisheye"])
def test_one_camera_makes_a_map_from_its_motion(walk, device, camera):
    odometry = odometry_of(ft.MonocularCamera(camera), device, features=1000)
    positions, truth, before = [], [], 0
    for i in range(40):
        pose = odometry.track(walk.frame(i)[0], 50_000_000 * i)
        assert not pose.metric
        if pose.tracked:
            positions.append(pose.T_world_camera[:3, 3])
            truth.append([*walk.position(i), 0.0])
        else:
            assert pose.state == "initialising"
            before += 1
    assert 0 < before < 12 and pose.maps == 1 and pose.map_points > 200
    # A narrow image that moves sideways says little about turns, on which the share rests.
    scale, error = scale_and_error(positions, truth)
    assert error < 0.15
    depths = scale * odometry.map().position[:, 2]
    near, far = depths[depths < 2], depths[depths > 2]
    assert len(near) > 50 and len(far) > 50 and abs(np.median(far) / np.median(near) / (FAR / NEAR) - 1) < 0.05
    assert np.mean(abs(near / np.median(near) - 1) < 0.1) > 0.9 and np.mean(abs(far / np.median(far) - 1) < 0.1) > 0.9
    assert np.all(odometry.keypoints().depth < 0)


def test_single_cameras_in_a_batch_track_as_alone(walk):
    rig = ft.MonocularCamera(ft.Pinhole(CAMERA))
    both, alone = odometry_of(rig, batch=2, features=1000), odometry_of(rig, features=1000)
    other = Walk(7)
    for i in range(12):
        a, b, t = walk.frame(i)[0], other.frame(i)[0], 50_000_000 * i
        got, want = both.track([a, b], [t, t]), alone.track(a, t)
        assert got[0].state == want.state and np.array_equal(got[0].T_world_camera, want.T_world_camera)
    assert want.tracked and got[1].tracked
    both.reset(1)
    got = both.track([a, b], [t + 1, 0])
    assert got[0].tracked and got[1].state == "initialising"


def test_images_of_a_rig_are_counted_and_named(walk):
    left, right, t = walk.frame(0)
    rig = odometry_of(ft.MultiRig([mounted((0, 0)), mounted(ABOVE, baseline=0)]))
    with pytest.raises(ValueError, match="2 images, must be 3"):
        rig.track(left, right, t)
    with pytest.raises(ValueError, match="the image of camera 1 has shape"):
        rig.track(left, right, left[1:], t)
    with pytest.raises(ValueError, match="the right image of camera 0"):
        rig.track(left, right.astype(float), left, t)
    single = odometry_of(ft.MonocularCamera(CAMERA))
    with pytest.raises(ValueError, match="2 images, must be 1"):
        single.track(left, right, t)
    with pytest.raises(ValueError, match="0 images, must be 1"):
        single.track(t)
    assert single.track(left, time_ns=t).state == "initialising"
    both = odometry_of(ft.MonocularCamera(CAMERA), batch=2)
    with pytest.raises(ValueError, match="the image of camera pair 1"):
        both.track([left, left.astype(float)], [t, t])


@pytest.mark.parametrize("make, word", [
    (lambda: ft.MultiRig([]), "0 cameras"),
    (lambda: ft.MultiRig([mounted((0, 0))] * 17), "17 cameras, must have 1 to 16"),
    (lambda: ft.MultiRig([mounted((0, 0), baseline=0)]), "stereo pair"),
    (lambda: ft.MultiRig([mounted((0, 0), baseline=-1)]), "baseline"),
    (lambda: ft.MultiRig([ft.RigCamera(CAMERA, 0.1, 2 * np.eye(4))]), "T_camera_body"),
    (lambda: ft.MultiRig([ft.RigCamera(CAMERA, 0.1, np.diag([1.0, 1, -1, 1]))]), "reflection"),
    (lambda: ft.MonocularCamera(ft.RadTan([*CAMERA, 0.1, 0, 0, 0, 0, 0, 0, 0])), "Pinhole"),
    (lambda: ft.MonocularCamera((0, 1, 2, 3)), "fx"),
])
def test_rigs_that_cannot_be_are_refused(make, word):
    with pytest.raises(ValueError, match=word):
        odometry_of(make())


def test_an_imu_that_has_told_nothing_gives_one_camera_no_scale():
    walk = Walk()
    one = odometry_of(ft.MonocularCamera(CAMERA), imu=ft.Imu())
    for i in range(3):
        for k in range(10):
            one.add_imu(50_000_000 * i + 5_000_000 * k, (0, -9.81, 0), (0, 0, 0))
        pose = one.track(walk.frame(0)[0], time_ns=50_000_000 * (i + 1))
        assert pose.state == "initialising"
        assert not pose.metric
        assert not pose.imu_known


T_RIGHT_LEFT = np.eye(4)
T_RIGHT_LEFT[0, 3] = -BASELINE
LENS = (*CAMERA, 0, 0, 0, 0)


@pytest.mark.parametrize("rig", [
    ft.RectifiedPair(CAMERA, BASELINE), ft.DistortedPair(CAMERA, CAMERA, T_RIGHT_LEFT, CAMERA, (WIDTH, HEIGHT)),
    ft.FisheyePair(LENS, LENS, T_RIGHT_LEFT), ft.RgbdCamera(CAMERA), ft.RgbdCamera(ft.RadTan(CAMERA), depth_scale=0.001),
    ft.MonocularCamera(CAMERA), ft.MonocularCamera(ft.KannalaBrandt(LENS)), ft.MultiRig([mounted((0, 0)), mounted(ASIDE)]),
], ids=lambda rig: type(rig).__name__)
def test_an_ordinary_calibration_has_no_warnings(rig):
    assert ft.check_calibration(rig, WIDTH, HEIGHT) == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        odometry_of(rig)


@pytest.mark.parametrize("rig, name", [
    (ft.RectifiedPair(CAMERA, 110.0), "baseline_long"), (ft.RectifiedPair(CAMERA, 0.00011), "baseline_short"),
    (ft.RectifiedPair((*CAMERA[:2], 10.0, 120.0), BASELINE), "principal_point"),
    (ft.RectifiedPair((*CAMERA[:2], 320.0, 240.0), BASELINE), "principal_point"),
    (ft.MonocularCamera((22.0, 22.0, *CAMERA[2:])), "focal_length"), (ft.RgbdCamera(CAMERA, depth_scale=1000.0), "depth_scale"),
    (ft.FisheyePair(LENS, LENS, np.linalg.inv(T_RIGHT_LEFT)), "baseline_direction"),
    (ft.MultiRig([mounted((0, 0), baseline=110.0)]), "baseline_long"),
])
def test_a_wrong_calibration_is_a_warning(rig, name):
    found = ft.check_calibration(rig, WIDTH, HEIGHT)
    assert [f.name for f in found] == [name] and found[0].text
    with pytest.warns(UserWarning, match=name):
        odometry_of(rig)


def test_what_is_refused_is_found_too():
    found = ft.check_calibration(ft.RectifiedPair((-1.0, *CAMERA[1:]), BASELINE), WIDTH, HEIGHT)
    assert [f.name for f in found] == ["refused"] and "fx" in found[0].text
    for bad in ((0, HEIGHT), (WIDTH, -1), (640.5, HEIGHT), (WIDTH, 2**31)):
        with pytest.raises(ValueError):
            ft.check_calibration(ft.RectifiedPair(CAMERA, BASELINE), *bad)
    with pytest.raises(ValueError, match="rig"):
        ft.check_calibration(None, WIDTH, HEIGHT)


def test_a_recording_of_a_mixed_rig_is_tracked(walk, tmp_path):
    """A pair, and a camera above it of another model, which misses an image."""
    frames, missing = 8, 5
    place = "[[1, 0, 0, {}], [0, 1, 0, {}], [0, 0, 1, 0], [0, 0, 0, 1]]"
    chain = ""
    for c, (model, numbers, before) in enumerate((("none", "[]", None), ("none", "[]", (-BASELINE, 0)),
                                                  ("radtan", "[0, 0, 0, 0]", np.subtract((BASELINE, 0), ABOVE)))):
        fx, fy, cx, cy = CAMERA
        chain += (f"cam{c}:\n  camera_model: pinhole\n  intrinsics: [{fx}, {fy}, {cx}, {cy}]\n  distortion_model: {model}\n"
                  f"  distortion_coeffs: {numbers}\n  resolution: [{WIDTH}, {HEIGHT}]\n")
        chain += "" if before is None else f"  T_cn_cnm1: {place.format(*before)}\n"
        (tmp_path / f"cam{c}").mkdir()
    (tmp_path / "camchain.yaml").write_text(chain)
    for i in range(frames):
        for c, image in enumerate([*walk.images_at(i, (0, 0)), *walk.images_at(i, ABOVE, pair=False)]):
            if (c, i) != (2, missing):
                write_png(tmp_path / f"cam{c}" / f"{1_000_000_000 + 50_000_000 * i}.png", image)
    with pytest.warns(UserWarning, match="1 of 8 frames have no image of cam2"):
        sequence = ft.read_sequence(tmp_path, rig="mixed")
    assert isinstance(sequence.rig, ft.MultiRig) and len(sequence.rig.cameras) == 3 and len(sequence) == frames
    odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, features=400, device="host")
    for i, frame in enumerate(sequence):
        assert len(frame.images) == 3 and (frame.images[2] is None) == (i == missing)
        pose = odometry.track(*frame.images, frame.time_ns)
        assert pose.tracked and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)
        assert not pose.warnings and pose.missing_images == ([4] if i == missing else [])
    with pytest.raises(ValueError, match="all images of the frame are null"):
        odometry.track(None, None, None, frame.time_ns + 1)
    with pytest.raises(ValueError, match="must be"):  # a pair has both
        odometry_of(ft.RectifiedPair(CAMERA, BASELINE)).track(frame.images[0], None, 1)
    assert {0, 2} <= set(odometry.keypoints().camera)


def test_a_recording_with_a_depth_camera_is_tracked(walk, tmp_path):
    """Two cameras that do not see the same, one of them with depth images."""
    frames = 6
    fx, fy, cx, cy = CAMERA
    turned = "[[-1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]"
    for c in range(2):
        (tmp_path / f"cam{c}").mkdir()
        with open(tmp_path / "camchain.yaml", "a") as chain:
            chain.write(f"cam{c}:\n  camera_model: pinhole\n  intrinsics: [{fx}, {fy}, {cx}, {cy}]\n  distortion_model: none\n"
                        f"  distortion_coeffs: []\n  resolution: [{WIDTH}, {HEIGHT}]\n"
                        + (f"  T_cn_cnm1: {turned}\n" if c else ""))
    (tmp_path / "depth0").mkdir()
    for i in range(frames):
        stamp = f"{1_000_000_000 + 50_000_000 * i}.png"
        write_png(tmp_path / "cam0" / stamp, walk.frame(i)[0])
        write_png(tmp_path / "cam1" / stamp, np.full((HEIGHT, WIDTH), 90, np.uint8))
        write_depth_png(tmp_path / "depth0" / stamp, walk.depth(i))
    with pytest.warns(UserWarning, match="nothing says the unit of the depth images"):
        ft.read_sequence(tmp_path, rig="mixed")
    sequence = ft.read_sequence(tmp_path, rig="mixed", depth_unit=0.001)
    assert [c.has_depth for c in sequence.rig.cameras] == [True, False] and sequence.depth_unit == 0.001
    assert [a.dtype.name for a in sequence[0].images if a is not None] == ["uint8", "uint16", "uint8"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the other camera sees nothing
        odometry = odometry_of(sequence.rig)
        for i, frame in enumerate(sequence):
            pose = odometry.track(*frame.images, frame.time_ns)
            assert pose.tracked and np.allclose(pose.T_world_camera[:2, 3], walk.position(i), atol=0.01)
            assert pose.missing_depths == []
        grey, _, _ = sequence[0].images
        lacking = odometry_of(sequence.rig).track(grey, None, grey, 0)
        assert lacking.missing_depths == [0] and lacking.missing_images == [] and lacking.reason == "images_missing"
        assert "depth image of camera 0" in lacking.explanation
        assert odometry.keypoints().depth.max() == pytest.approx(FAR, rel=0.01)
        near = ft.read_sequence(tmp_path, rig="mixed", depth_unit=0.001, max_depth=2.5)
        odometry = odometry_of(near.rig)
        odometry.track(*near[0].images, 0)
    assert near.rig.max_depth == 2.5 and odometry.keypoints().depth.max() == pytest.approx(NEAR, rel=0.01)


def test_masks_of_a_recording_hold_for_their_frames(walk, tmp_path):
    """An image for the left camera, and a folder with one for some frames of the right one."""
    frames = 4
    for c, name in enumerate(("left", "right")):
        (tmp_path / name).mkdir()
        for i in range(frames):
            write_png(tmp_path / name / f"{1_000_000_000 + 50_000_000 * i}.png", walk.frame(i)[c])
    fx, fy, cx, cy = CAMERA
    (tmp_path / "camchain.yaml").write_text("".join(
        f"cam{c}:\n  camera_model: pinhole\n  intrinsics: [{fx}, {fy}, {cx}, {cy}]\n  distortion_model: none\n"
        f"  distortion_coeffs: []\n  resolution: [{WIDTH}, {HEIGHT}]\n" for c in range(2))
        + f"  T_cn_cnm1: [[1, 0, 0, {-BASELINE}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n")
    half = np.zeros((HEIGHT, WIDTH), np.uint8)
    half[:, :WIDTH // 2] = 255
    write_png(tmp_path / "half.png", half)
    (tmp_path / "masks").mkdir()
    write_png(tmp_path / "masks" / "1050000000.png", half)
    assert ft.read_sequence(tmp_path)[0].masks == ()
    with pytest.warns(UserWarning, match="3 of 4 frames have no mask"):
        sequence = ft.read_sequence(tmp_path, masks=[tmp_path / "half.png", tmp_path / "masks"])
    assert sequence.masked and all(np.array_equal(frame.masks[0], half) for frame in sequence)
    assert [frame.masks[1] is not None for frame in sequence] == [False, True, False, False]
    odometry = ft.Odometry(sequence.rig, WIDTH, HEIGHT, features=400, device="host", mask_size=(WIDTH, HEIGHT))
    for i, frame in enumerate(sequence):
        odometry.set_masks(frame.masks if i < 3 else (None, None))
        assert odometry.track(*frame.images, frame.time_ns).tracked
        seen = odometry.keypoints()
        assert (seen.x.max() < WIDTH / 2 + 6) == (i < 3)
    with pytest.raises(RuntimeError, match="3 masks, for 2 cameras"):
        ft.read_sequence(tmp_path, masks=[tmp_path / "half.png"] * 3)
