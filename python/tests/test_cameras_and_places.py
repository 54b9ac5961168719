# SPDX-License-Identifier: Apache-2.0
import copy
import pickle

import numpy as np
import pytest
from conftest import HEIGHT, WIDTH

import ft

CAMERAS = [
    ft.Pinhole([458, 457, 367, 248]),
    ft.RadTan([458, 457, 367, 248, -0.28, 0.07, 2e-4, 2e-5, 0, 0, 0, 0]),
    ft.KannalaBrandt([190, 190, 254, 256, 0.0035, 0.0007, -0.002, 0.0002]),
    ft.DoubleSphere([350, 350, 367, 248, -0.2, 0.55]),
    ft.Unified([460, 458, 366, 249, 0.9, -0.05, 0.01, 1e-4, 2e-4]),
    ft.ExtendedUnified([460, 458, 366, 249, 0.6, 1.1]),
    ft.FieldOfView([350, 350, 367, 248, 0.9]),
]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: type(c).__name__)
def test_pixels_and_rays_belong_together(camera):
    points = np.random.default_rng(1).uniform((-0.4, -0.3, 1), (0.4, 0.3, 3), (200, 3))
    pixels, valid = camera.project(points)
    assert pixels.shape == (200, 2) and valid.all()
    rays, valid = camera.unproject(pixels)
    assert valid.all()
    assert np.allclose(rays / rays[:, 2:], points / points[:, 2:], atol=1e-9)
    assert not camera.project(np.array([[0.1, 0.0, -1.0]]))[1][0] or type(camera) is not ft.Pinhole


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: type(c).__name__)
def test_rigs_go_to_other_processes(camera):
    rig = ft.MultiRig([ft.RigCamera(camera)])
    for same in (pickle.loads(pickle.dumps(rig)), copy.deepcopy(rig)):
        assert type(same.cameras[0].camera) is type(camera)
        assert same.cameras[0].camera.parameters == camera.parameters


def test_a_pinhole_is_a_pinhole():
    pixels, valid = CAMERAS[0].project(np.array([[1.0, -1.0, 4.0], [0, 0, -1]]))
    assert np.allclose(pixels[0], (458 / 4 + 367, -457 / 4 + 248)) and valid.tolist() == [True, False]


@pytest.mark.parametrize("bad", [np.zeros((3, 2)), np.zeros(3), np.zeros((2, 3), np.float32), "points"])
def test_what_are_no_points_is_refused(bad):
    with pytest.raises(ValueError, match="points"):
        CAMERAS[0].project(bad)


def test_parameters_that_cannot_be_are_refused():
    for values in ([], [1, 2, 3], [0, 457, 367, 248], [float("nan"), 457, 367, 248]):
        with pytest.raises(ValueError):
            ft.Pinhole(values)


@pytest.fixture(scope="session")
def vocabulary(tmp_path_factory):
    """A tree of two levels with eight branches, DBoW2's text form: random words."""
    random = np.random.default_rng(3)
    lines = ["8 2  0 0"]
    numbers = lambda: " ".join(str(v) for v in random.integers(0, 256, 32))
    for _ in range(8):
        lines.append(f"0 0 {numbers()} 0")
    for parent in range(1, 9):
        for _ in range(8):
            lines.append(f"{parent} 1 {numbers()} {random.uniform(0.5, 2)}")
    file = tmp_path_factory.mktemp("words") / "words.txt"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_places_are_found_again(walk, vocabulary, device):
    orb = ft.OrbExtractor(WIDTH, HEIGHT, features=300, device="host")
    places = ft.PlaceRecognition(str(vocabulary), keyframes=20, features=600, device=device)
    from conftest import Walk

    images = [Walk(seed).frame(0)[0] for seed in (1, 2, 3)]
    numbers = []
    for image in images:
        places.describe(orb.extract(image).descriptors)
        assert abs(sum(places.words().values()) - 1) < 1e-9
        numbers.append(places.add())
    assert len(places) == 3
    places.describe(orb.extract(images[1]).descriptors)
    found = dict(places.query())
    assert numbers[1] in found and found[numbers[1]] == max(found.values())
    places.erase(numbers[1])
    assert numbers[1] not in dict(places.query())
    with pytest.raises(ValueError):
        places.erase(numbers[1])
    with pytest.raises(ValueError, match="32"):
        places.describe(np.zeros((5, 31), np.uint8))


def test_a_vocabulary_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match="nothing.txt"):
        ft.PlaceRecognition(str(tmp_path / "nothing.txt"))
    (tmp_path / "bad.txt").write_text("10 6 0 0\n0 0 1 2 3\n")
    (tmp_path / "empty.txt").write_text("")
    (tmp_path / "large.txt").write_text("10 6 0 0\n" + "0 0 " + "9" * 400 + "\n")
    (tmp_path / "binary.bin").write_bytes(bytes(range(256)) * 8)
    for name in ("bad.txt", "empty.txt", "large.txt", "binary.bin"):
        with pytest.raises(RuntimeError, match=name):
            ft.PlaceRecognition(tmp_path / name)
