# SPDX-License-Identifier: Apache-2.0
"""Scenes of the tests: two textured planes, rendered with numpy."""

import os

import numpy as np
import pytest

import ft

WIDTH, HEIGHT = 320, 240
CAMERA = (220.0, 220.0, 160.0, 120.0)
BASELINE = 0.11
FAR, NEAR = 3.0, 1.2  # depths of the two planes, metres
EDGE = 0.1  # the near one begins this far below the axis, metres


def effort(most):
    """Repetitions: all with FT_TEST_EFFORT=100, by default a tenth."""
    return max(1, most * int(os.environ.get("FT_TEST_EFFORT", "10")) // 100)


def texture(seed=1, size=700):
    """Grey squares of several sizes, smoothed a little."""
    random = np.random.default_rng(seed)
    image = np.full((size, size), 90.0)
    for _ in range(1500):
        w, h = random.integers(4, 40, 2)
        x, y = random.integers(0, size, 2)
        image[y:y + h, x:x + w] = random.integers(0, 256)
    for axis in (0, 1):
        image = (np.roll(image, 1, axis) + 2 * image + np.roll(image, -1, axis)) / 4
    return image


def sampled(texels, x, y, depth):
    """A plane at a depth as a camera at (x, y, 0) sees it."""
    texel = FAR / CAMERA[0]  # metres
    columns = 100 + (x + (np.arange(WIDTH) - CAMERA[2]) * depth / CAMERA[0]) / texel + 200
    rows = 100 + (y + (np.arange(HEIGHT) - CAMERA[3]) * depth / CAMERA[0]) / texel + 200
    c0, r0 = np.floor(columns).astype(int), np.floor(rows).astype(int)
    fc, fr = columns - c0, (rows - r0)[:, None]
    top = texels[np.ix_(r0, c0)] * (1 - fc) + texels[np.ix_(r0, c0 + 1)] * fc
    low = texels[np.ix_(r0 + 1, c0)] * (1 - fc) + texels[np.ix_(r0 + 1, c0 + 1)] * fc
    return top * (1 - fr) + low * fr


def is_near(y):
    """Rows that show the near plane."""
    return y + (np.arange(HEIGHT) - CAMERA[3]) * NEAR / CAMERA[0] > EDGE


def view(planes, x, y):
    """Both planes as a camera at (x, y, 0) sees them."""
    near = is_near(y)[:, None]
    image = np.where(near, sampled(planes[1], x, y, NEAR), sampled(planes[0], x, y, FAR))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


class Walk:
    """Stereo frames of a camera that moves to the right and down."""

    def __init__(self, seed=1):
        self.planes = texture(seed), texture(seed + 100)
        self.rig = ft.RectifiedPair(CAMERA, BASELINE)

    def position(self, i):
        return 0.02 * i, 0.005 * i

    def frame(self, i):
        x, y = self.position(i)
        return view(self.planes, x, y), view(self.planes, x + BASELINE, y), 50_000_000 * i

    def images_at(self, i, offset, pair=True):
        """Images of a camera, or of the left one of a pair, that lies at an offset in x and y from the left camera."""
        x, y = np.add(self.position(i), offset)
        return [view(self.planes, x + right, y) for right in ((0, BASELINE) if pair else (0,))]

    def depth(self, i, below=0.0):
        """Millimetres, of a camera below the left one by some metres."""
        row = np.where(is_near(self.position(i)[1] + below), 1000 * NEAR, 1000 * FAR)
        return np.repeat(row.astype(np.uint16)[:, None], WIDTH, 1)

    def odometry(self, **options):
        options.setdefault("device", "host")
        return ft.Odometry(self.rig, WIDTH, HEIGHT, features=400, **options)


def follow(odometry, walk, frames):
    """What an odometry says of the first frames."""
    return [odometry.track(*walk.frame(i)) for i in range(frames)]


@pytest.fixture(scope="session")
def walk():
    return Walk()


@pytest.fixture(scope="session", params=["host", "cuda"])
def device(request):
    if request.param == "cuda" and len(ft.devices()) < 2:
        pytest.skip("no GPU, or built without CUDA")
    return request.param
