# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from conftest import BASELINE, CAMERA, FAR, HEIGHT, NEAR, WIDTH, effort

import ft


def same(a, b):
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in ("x", "y", "angle", "response", "octave", "descriptors"))


def test_a_batch_gives_what_single_images_give(walk, device):
    single = ft.OrbExtractor(WIDTH, HEIGHT, features=300, device=device)
    batch = ft.OrbExtractor(WIDTH, HEIGHT, features=300, batch=3, device=device)
    images = [walk.frame(i)[0] for i in (0, 5, 9)]
    together = batch.extract(images)
    assert all(len(k) > 200 for k in together)
    assert all(same(single.extract(image), k) for image, k in zip(images, together))


def test_host_and_gpu_agree(walk, device):
    host = ft.OrbExtractor(WIDTH, HEIGHT, device="host")
    other = ft.OrbExtractor(WIDTH, HEIGHT, device=device)
    assert same(host.extract(walk.frame(3)[0]), other.extract(walk.frame(3)[0]))


def test_padded_rows_are_read_as_they_are(walk):
    image = walk.frame(0)[0]
    wide = np.zeros((HEIGHT, WIDTH + 40), np.uint8)
    wide[:, :WIDTH] = image
    orb = ft.OrbExtractor(WIDTH, HEIGHT)
    assert same(orb.extract(image), orb.extract(wide[:, :WIDTH]))


def test_keypoints_move_with_the_image(walk):
    orb = ft.OrbExtractor(WIDTH, HEIGHT, levels=1, features=1000)
    image = walk.frame(0)[0]
    moved = np.roll(image, (3, 5), (0, 1))
    places = {(x, y) for x, y in zip(*orb.extract(image).to_numpy()[0].T)}
    others = {(x - 5, y - 3) for x, y in zip(*orb.extract(moved).to_numpy()[0].T)}
    assert len(places & others) > 0.5 * len(places)


def test_a_mask_keeps_keypoints_away(walk):
    orb = ft.OrbExtractor(WIDTH, HEIGHT, mask_size=(WIDTH, HEIGHT))
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, WIDTH // 2:] = 255
    orb.set_mask(mask)
    k = orb.extract(walk.frame(0)[0])
    assert len(k) > 50 and k.x.min() >= WIDTH // 2 - 4


def test_depths_of_the_planes(walk, device):
    matches = ft.StereoMatcher(walk.rig, WIDTH, HEIGHT, device=device).match(*walk.frame(0)[:2])
    found = matches.depth[matches.depth > 0]
    assert len(found) > 100
    assert np.mean((abs(found - NEAR) < 0.05) | (abs(found - FAR) < 0.2)) > 0.9
    with_depth = matches.depth > 0
    disparity = matches.left.x[with_depth] - matches.right_x[with_depth]
    assert np.allclose(CAMERA[0] * BASELINE / disparity, found, rtol=1e-3)


def test_opencv_takes_the_keypoints(walk):
    pytest.importorskip("cv2")
    k = ft.OrbExtractor(WIDTH, HEIGHT).extract(walk.frame(0)[0])
    points, descriptors = k.to_cv2()
    assert len(points) == len(k) == len(descriptors)
    assert points[7].pt == (k.x[7], k.y[7]) and points[7].octave == k.octave[7]


@pytest.mark.parametrize("bad, word", [
    (None, "image 0"), (5, "image 0"), (np.zeros((HEIGHT, WIDTH, 3), np.uint8), "dimensions"),
    (np.zeros((HEIGHT, WIDTH)), "uint8"), (np.zeros((HEIGHT, WIDTH - 1), np.uint8), "shape"),
    (np.zeros((HEIGHT, 2 * WIDTH), np.uint8)[:, ::2], "next to each other"), (np.zeros((0, WIDTH), np.uint8), "empty"),
])
def test_what_is_no_image_is_named(bad, word):
    with pytest.raises(ValueError, match=word):
        ft.OrbExtractor(WIDTH, HEIGHT).extract(bad)


@pytest.mark.parametrize("options", [{"levels": 0}, {"scale_factor": 0.5}, {"features": -1}, {"ini_threshold": 256}, {"device": "tpu"}])
def test_options_out_of_range_are_refused(options):
    with pytest.raises(ValueError):
        ft.OrbExtractor(WIDTH, HEIGHT, **options)


def test_the_number_of_images_must_fit(walk):
    with pytest.raises(ValueError, match="2 images, must be 1"):
        ft.OrbExtractor(WIDTH, HEIGHT).extract([walk.frame(0)[0]] * 2)


def test_memory_does_not_grow(walk):
    resource = pytest.importorskip("resource")
    orb = ft.OrbExtractor(WIDTH, HEIGHT, features=100, threads=1)
    image = walk.frame(0)[0]
    for _ in range(20):
        orb.extract(image)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(effort(2000)):
        orb.extract(image)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 8 * 1024
