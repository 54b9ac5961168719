# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from conftest import CAMERA, HEIGHT, WIDTH

import ft

RAW = (350, 260)  # width and height of the images that come in
LEFT = [225.0, 224, 170, 131, -0.28, 0.07, 2e-4, -3e-4, 0.01, 0, 0, 0]
RIGHT = [223.0, 224, 172, 127, -0.25, 0.05, -1e-4, 2e-4, 0, 0.01, 0, 0]


def turned(x, y, z):
    """The rotation by small angles, radians."""
    R = np.eye(3)
    for axis, angle in enumerate((x, y, z)):
        i, k = (axis + 1) % 3, (axis + 2) % 3
        one = np.eye(3)
        one[i, i] = one[k, k] = np.cos(angle)
        one[k, i], one[i, k] = np.sin(angle), -np.sin(angle)
        R = one @ R
    return R


def pair():
    T = np.eye(4)
    T[:3, :3] = turned(0.02, -0.03, 0.01)
    T[:3, 3] = (-0.11, 0.002, -0.003)
    return ft.DistortedPair(ft.RadTan(LEFT), RIGHT, T, CAMERA, RAW)


def images(seed=2):
    random = np.random.default_rng(seed)
    return random.integers(0, 256, (2, RAW[1], RAW[0]), dtype=np.uint8)


def source_positions(camera, R):
    """Where a rectified pixel comes from, by the formula of the radial-tangential model."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 = camera
    x, y = np.meshgrid((np.arange(WIDTH) - CAMERA[2]) / CAMERA[0], (np.arange(HEIGHT) - CAMERA[3]) / CAMERA[1])
    rays = np.stack([x, y, np.ones_like(x)], axis=2) @ R  # its transpose, applied to each
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return fx * u + cx, fy * v + cy


def looked_up(image, position, fraction, border):
    """Bilinear interpolation in 32nds of a pixel."""
    height, width = image.shape
    def at(dx, dy):
        x, y = position[..., 0].astype(int) + dx, position[..., 1].astype(int) + dy
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        return np.where(inside, image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)], border).astype(int)
    fx, fy = fraction.astype(int) & 31, fraction.astype(int) >> 5
    upper = at(0, 0) * (32 - fx) + at(1, 0) * fx
    lower = at(0, 1) * (32 - fx) + at(1, 1) * fx
    return ((upper * (32 - fy) + lower * fy + 512) >> 10).astype(np.uint8)


def test_the_table_is_that_of_the_calibration():
    rectifier = ft.Rectifier(pair(), WIDTH, HEIGHT, device="host")
    Rs = []
    for i, camera in enumerate((LEFT, RIGHT)):
        position, fraction, R = rectifier.map(i)
        assert position.shape == (HEIGHT, WIDTH, 2) and fraction.shape == (HEIGHT, WIDTH)
        assert position.dtype == np.int16 and fraction.dtype == np.uint16
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
        want = np.stack(source_positions(camera, R), axis=2)
        got = position + np.stack([fraction & 31, fraction >> 5], axis=2) / 32
        assert np.max(np.abs(got - want)) < 1 / 64 + 1e-4
        Rs.append(R)
    # Both rectified cameras are turned alike, and the baseline is their x axis.
    T = pair().T_right_left
    assert np.allclose(Rs[1] @ T[:3, :3], Rs[0], atol=1e-6)
    across = Rs[1] @ T[:3, 3]
    assert np.allclose(across, (-rectifier.rig.baseline, 0, 0), atol=1e-7)
    assert np.allclose(rectifier.rig.camera, CAMERA)
    with pytest.raises(ValueError, match="camera"):
        rectifier.map(2)


@pytest.mark.parametrize("border", [0, 99])
def test_pixels_are_those_of_the_table(device, border):
    rectifier = ft.Rectifier(pair(), WIDTH, HEIGHT, border=border, device=device)
    given = images()
    for image, done, i in zip(given, rectifier.rectify(*given), (0, 1)):
        position, fraction, _ = rectifier.map(i)
        assert done.shape == (HEIGHT, WIDTH) and done.dtype == np.uint8
        assert np.array_equal(done, looked_up(image, position, fraction, border))


def test_opencv_has_the_same_pixels():
    cv2 = pytest.importorskip("cv2")
    rectifier = ft.Rectifier(pair(), WIDTH, HEIGHT, device="host")
    given = images()
    K = lambda c: np.array([[c[0], 0, c[2]], [0, c[1], c[3]], [0, 0, 1.0]])
    for image, done, camera, i in zip(given, rectifier.rectify(*given), (LEFT, RIGHT), (0, 1)):
        position, fraction, R = rectifier.map(i)
        assert np.array_equal(done, cv2.remap(image, position, fraction, cv2.INTER_LINEAR))
        theirs = cv2.initUndistortRectifyMap(K(camera), np.array(camera[4:]), R, K(CAMERA), (WIDTH, HEIGHT), cv2.CV_16SC2)
        steps = lambda p, f: 32 * p.astype(int) + np.stack([f & 31, f >> 5], axis=2)
        apart = np.abs(steps(*theirs) - steps(position, fraction))
        assert apart.max() <= 1 and np.mean(apart > 0) < 0.01  # rounding of halves


def test_an_odometry_rectifies_alike(walk):
    T = np.eye(4)
    T[0, 3] = -0.11
    rig = ft.DistortedPair([*CAMERA, -0.1, 0.02, 0, 0], [*CAMERA, -0.1, 0.02, 0, 0], T, CAMERA, (WIDTH, HEIGHT))
    rectifier = ft.Rectifier(rig, WIDTH, HEIGHT, device="host")
    whole = ft.Odometry(rig, WIDTH, HEIGHT, features=400, device="host")
    steps = ft.Odometry(rectifier.rig, WIDTH, HEIGHT, features=400, device="host")
    for i in range(5):
        left, right, t = walk.frame(i)
        a = whole.track(left, right, t)
        b = steps.track(*rectifier.rectify(left, right), t)
        assert a.tracked and np.array_equal(a.T_world_camera, b.T_world_camera)


def test_arrays_of_the_caller_are_written(device):
    rectifier = ft.Rectifier(pair(), WIDTH, HEIGHT, device=device)
    given = images()
    wide = np.full((2, HEIGHT, WIDTH + 24), 7, np.uint8)
    out = wide[0, :, :WIDTH], wide[1, :, :WIDTH]
    back = rectifier.rectify(*given, out=out)
    assert back[0] is out[0] and back[1] is out[1]
    assert all(np.array_equal(a, b) for a, b in zip(out, rectifier.rectify(*given)))
    assert np.all(wide[:, :, WIDTH:] == 7)
    still = np.zeros((HEIGHT, WIDTH), np.uint8)
    still.setflags(write=False)
    for bad, word in ((still, "written"), (np.zeros((HEIGHT, WIDTH - 1), np.uint8), "shape"), (np.zeros((HEIGHT, WIDTH)), "uint8")):
        with pytest.raises(ValueError, match=word):
            rectifier.rectify(*given, out=(out[0], bad))


def test_images_on_the_device_stay_there():
    cupy = pytest.importorskip("cupy")
    if len(ft.devices()) < 2:
        pytest.skip("no GPU, or built without CUDA")
    rectifier = ft.Rectifier(pair(), WIDTH, HEIGHT, device="cuda")
    given = images()
    want = rectifier.rectify(*given)
    stream = cupy.cuda.Stream(non_blocking=True)
    with stream:
        there = [cupy.asarray(image) for image in given]
    done = [cupy.from_dlpack(a) for a in rectifier.rectify(*there, stream=stream.ptr)]
    assert all(np.array_equal(cupy.asnumpy(a), b) for a, b in zip(done, want))
    out = [cupy.zeros((HEIGHT, WIDTH), cupy.uint8) for _ in done]
    rectifier.rectify(*there, out=out)
    assert all(np.array_equal(cupy.asnumpy(a), b) for a, b in zip(out, want))


def test_what_cannot_be_rectified_is_named():
    given = images()
    rectifier = ft.Rectifier(pair(), WIDTH, HEIGHT, device="host")
    with pytest.raises(ValueError, match="the right image has shape"):
        rectifier.rectify(given[0], given[1][1:])
    with pytest.raises(ValueError, match="DistortedPair"):
        ft.Rectifier(ft.RectifiedPair(CAMERA, 0.1), WIDTH, HEIGHT)
    with pytest.raises(ValueError, match="border"):
        ft.Rectifier(pair(), WIDTH, HEIGHT, border=256)
    with pytest.raises(ValueError, match="width"):
        ft.Rectifier(pair(), 0, HEIGHT)
    upward = pair()
    upward.T_right_left[:3, 3] = (0, 0.1, 0)
    with pytest.raises(ValueError, match="to the right"):
        ft.Rectifier(upward, WIDTH, HEIGHT)
