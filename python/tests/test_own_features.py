# SPDX-License-Identifier: Apache-2.0
"""Keypoints of the caller."""

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH

import ft

FRAMES = 8


def odometry(rig=None, device="host", **options):
    return ft.Odometry(rig or ft.RectifiedPair(CAMERA, BASELINE), WIDTH, HEIGHT, features=400, device=device,
                       own_features=True, **options)


@pytest.fixture(scope="module")
def matches(walk):
    """Of each frame of the walk."""
    matcher = ft.StereoMatcher(walk.rig, WIDTH, HEIGHT, features=400, device="host")
    return [matcher.match(*walk.frame(i)[:2]) for i in range(FRAMES)]


def pair(m):
    return ft.ImageFeatures.of(m.left), ft.ImageFeatures.of(m.right)


def with_partners(m, **columns):
    features = ft.ImageFeatures.of(m.left)
    for name, values in columns.items():
        setattr(features, name, values)
    return features


def follow(odometry, features):
    return [odometry.track_features(*of_frame, 50_000_000 * i) for i, of_frame in enumerate(features)]


def assert_found(walk, poses, within=0.02):
    for i, p in enumerate(poses):
        assert p.tracked and np.allclose(p.T_world_camera[:2, 3], walk.position(i), atol=within)
    assert poses[0].keyframe and poses[-1].maps == 1 and not poses[-1].warnings


def test_partners_are_found_by_descriptors_or_given(walk, matches, device):
    assert_found(walk, follow(odometry(device=device), [pair(m) for m in matches]))
    assert (matches[0].right_x < 0).any()
    given = [(with_partners(m, right_x=np.where(m.right_x < 0, np.nan, m.right_x)),) for m in matches]
    assert_found(walk, follow(odometry(device=device), given))


def test_a_camera_with_depths_and_one_camera(walk, matches, device):
    depths = [(with_partners(m, depth=m.depth),) for m in matches]
    assert_found(walk, follow(odometry(ft.RgbdCamera(CAMERA), device), depths))
    alone = follow(odometry(ft.MonocularCamera(CAMERA), device), [(ft.ImageFeatures.of(m.left),) for m in matches])
    assert all(p.keypoints == len(m.left) and p.stereo_points == 0 for p, m in zip(alone, matches))


def test_host_and_gpu_agree_to_the_bit(matches, device):
    a, b = (follow(odometry(device=d), [pair(m) for m in matches]) for d in ("host", device))
    assert all(np.array_equal(p.T_world_camera, q.T_world_camera) for p, q in zip(a, b))


def test_a_batch_tracks_each_rig_as_alone(matches):
    features = [pair(m) for m in matches]
    both, alone = odometry(batch=2), odometry()
    for i in range(4):
        (left, right), (other_left, other_right) = features[i], features[7 - i]
        got = both.track_features([left, other_left], [right, other_right], [i, i])
        assert np.array_equal(got[0].T_world_camera, alone.track_features(left, right, i).T_world_camera)
        assert got[1].tracked


def test_images_and_features_mix(walk, matches):
    mixed = odometry()
    poses = [mixed.track(*walk.frame(i)) if i % 2 else mixed.track_features(*pair(matches[i]), 50_000_000 * i)
             for i in range(FRAMES)]
    assert_found(walk, poses)


def test_columns_may_be_lists_of_any_numbers_and_arrays_with_gaps(matches):
    m = matches[0]
    plain = ft.ImageFeatures.of(m.left)
    wide = np.zeros((len(m.left), 64), np.uint8)
    wide[:, ::2] = m.left.descriptors
    other = ft.ImageFeatures(plain.positions.astype(np.float64)[::-1][::-1], wide[:, ::2], octave=plain.octave.tolist(),
                             angle=plain.angle.tolist(), score=plain.score, level_positions=True)
    right = ft.ImageFeatures.of(m.right)
    a, b = (odometry().track_features(f, right, 1) for f in (plain, other))
    assert a.stereo_points == b.stereo_points > 0


@pytest.mark.parametrize("change, word", [
    ({"positions": np.zeros((3, 2))}, "positions"), ({"positions": np.zeros(2)}, "positions"),
    ({"positions": [[1, 2], [3, np.nan]]}, "position 1"), ({"positions": [[1, 2], [WIDTH, 3]]}, "position 1"),
    ({"positions": "here"}, "positions"), ({"descriptors": np.zeros((2, 64), np.uint8)}, "descriptors"),
    ({"descriptors": np.zeros((2, 32))}, "descriptors"), ({"descriptors": None}, "descriptors"),
    ({"octave": [0, 8]}, "octave 1 is 8"), ({"octave": [0.5, 1]}, "octave"), ({"octave": [1]}, "octave"),
    ({"angle": [0, -1]}, "angle 1"), ({"score": [1, np.inf]}, "score 1"), ({"deviation": [1, 0]}, "deviation 1"),
    ({"octave": [0, 0], "deviation": [1, 1]}, "octave and deviation"), ({"right_x": [1, 2, 3]}, "right_x"),
    ({"depth": [[1, 2]]}, "depth"),
], ids=str)
def test_what_is_refused(change, word):
    given = {"positions": [[1, 2], [3, 4]], "descriptors": np.zeros((2, 32), np.uint8)}
    of_pair = odometry()
    with pytest.raises(ValueError, match=word):
        of_pair.track_features(ft.ImageFeatures(**{**given, **change}), 1)
    of_pair.track_features(ft.ImageFeatures(**given), 1)  # nothing has changed


def test_what_else_is_refused(matches):
    left, right = pair(matches[0])
    with pytest.raises(ValueError, match="own_features"):
        ft.Odometry(ft.RectifiedPair(CAMERA, BASELINE), WIDTH, HEIGHT, device="host").track_features(left, right, 1)
    with pytest.raises(ValueError, match="own_features"):
        odometry(ft.MultiRig([ft.RigCamera(CAMERA, BASELINE)]))
    with pytest.raises(ValueError, match="depth"):
        odometry(ft.RgbdCamera(CAMERA)).track_features(left, 1)
    with pytest.raises(ValueError, match="right image"):
        odometry(ft.MonocularCamera(CAMERA)).track_features(left, right, 1)
    of_pair = odometry()
    for arguments, word in (((), "no arguments"), ((1,), "features"), ((left, left, left, 1), "3 images"),
                            ((left.positions, 1), "ImageFeatures"), ((left, right, 1.5), "time_ns")):
        with pytest.raises(ValueError, match=word):
            of_pair.track_features(*arguments)


# ---- other descriptors than ORB's, made of ORB's

def numbers(orb):
    """Two bits a number: of 64 bits that differ the squared distance is about 62 500."""
    bits = np.unpackbits(orb, axis=1)
    return (128 - 31 + 31 * (bits[:, ::2] + bits[:, 1::2])).astype(np.uint8)


OTHERS = {"bits_512": lambda orb: np.concatenate([orb, orb[:, :29]], axis=1), "int8_128": numbers}


def described(features, of):
    return tuple(ft.ImageFeatures(**{**vars(f), "descriptors": of(f.descriptors)}) for f in features)


@pytest.mark.parametrize("kind", OTHERS)
def test_other_descriptors(walk, matches, device, kind):
    of_pair = [described(pair(m), OTHERS[kind]) for m in matches]
    poses = follow(odometry(device=device, descriptors=kind), of_pair)
    assert_found(walk, poses)
    host = follow(odometry(descriptors=kind), of_pair)
    assert all(np.array_equal(p.T_world_camera, q.T_world_camera) for p, q in zip(poses, host))
    depths = [described((with_partners(m, depth=m.depth),), OTHERS[kind]) for m in matches]
    assert_found(walk, follow(odometry(ft.RgbdCamera(CAMERA), device, descriptors=kind), depths))


def test_numbers_of_each_type_are_the_same(matches):
    types = (numbers, lambda orb: numbers(orb).astype(np.float32),
             lambda orb: (numbers(orb).astype(np.int16) - 128).astype(np.int8))
    paths = [follow(odometry(descriptors="int8_128"), [described(pair(m), of) for m in matches]) for of in types]
    for other in paths[1:]:
        assert all(np.array_equal(p.T_world_camera, q.T_world_camera) for p, q in zip(paths[0], other))


@pytest.mark.parametrize("kind, rows, word", [
    ("bits_512", np.zeros((2, 32), np.uint8), "must be uint8"), ("bits_512", np.zeros((2, 61)), "must be uint8"),
    ("bits_512", np.zeros(64, np.uint8), "must be uint8"), ("int8_128", np.zeros((2, 64), np.uint8), "must be int8"),
    ("int8_128", np.zeros((2, 128)), "must be int8"), ("int8_128", np.full((2, 128), 0.5, np.float32), "whole numbers"),
    ("int8_128", np.full((2, 128), 256, np.float32), "whole numbers"),
    ("int8_128", np.full((2, 128), np.nan, np.float32), "whole numbers"), ("int8_128", None, "descriptors"),
], ids=str)
def test_other_descriptors_that_are_refused(kind, rows, word):
    with pytest.raises(ValueError, match=word):
        odometry(descriptors=kind).track_features(ft.ImageFeatures([[1, 2], [3, 4]], rows), 1)


@pytest.mark.parametrize("kind", ["bits_512", "int8_128"])
def test_tensors_of_other_descriptors_are_refused(kind):
    class Tensor:
        """Of uint8, as torch has: nobody would take 128 from the bytes of SIFT."""

        def __init__(self, array):
            self.__dlpack__, self.__dlpack_device__, self.shape = array.__dlpack__, array.__dlpack_device__, array.shape

    features = ft.ImageFeatures(np.zeros((2, 2), np.float32), Tensor(np.zeros((2, 128), np.uint8)))
    with pytest.raises(ValueError, match="must be a NumPy array"):
        features._rows(kind)


def test_what_other_descriptors_have_not(walk, matches, tmp_path):
    other = odometry(descriptors="bits_512")
    none = ft.ImageFeatures(np.zeros((0, 2)), np.zeros((0, 32), np.uint8))
    assert not other.track_features(none, none, 1).tracked  # images without keypoints
    with pytest.raises(ValueError, match="the caller's"):
        other.track(*walk.frame(1))
    for rig, options, word in ((ft.MonocularCamera(CAMERA), {}, "compiled for"), (None, {"imu": ft.Imu()}, "no IMU"),
                               (None, {"vocabulary": tmp_path / "words.txt"}, "no words"),
                               (None, {"descriptors": "sift"}, "must be")):
        with pytest.raises(ValueError, match=word):
            odometry(rig, **{"descriptors": "bits_512", **options})
    with pytest.raises(ValueError, match="own_features"):
        ft.Odometry(ft.RectifiedPair(CAMERA, BASELINE), WIDTH, HEIGHT, device="host", descriptors="int8_128")
    assert other.track_features(*described(pair(matches[0]), OTHERS["bits_512"]), 2).state
