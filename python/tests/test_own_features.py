# SPDX-License-Identifier: Apache-2.0
"""Keypoints of the caller."""

import ctypes
import importlib.util
from pathlib import Path

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH
from test_arrays import KDL_CPU, KDL_CUDA, KDL_ROCM, Foreign

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


# ---- arrays of others, by DLPack

COLUMNS = ("positions", "angle", "score", "right_x", "depth", "octave", "descriptors")


def moved(features, move):
    """With all arrays where move() brings them."""
    types = {"octave": np.int32, "descriptors": features.descriptors.dtype}
    return ft.ImageFeatures(level_positions=features.level_positions, **{
        name: move(np.ascontiguousarray(getattr(features, name), types.get(name, np.float32)))
        for name in COLUMNS if getattr(features, name) is not None})


def assert_same_path(a, b):
    assert all(np.array_equal(p.T_world_camera, q.T_world_camera) and p.keypoints == q.keypoints for p, q in zip(a, b))


@pytest.mark.parametrize("kind", ["orb", "int8_128"])
def test_tensors_on_the_host_are_read(matches, device, kind):
    of_pair = [described(pair(m), OTHERS.get(kind, lambda orb: orb)) for m in matches[:3]]
    kept = []

    def foreign(array):
        kept.append(Foreign(array, KDL_CPU))
        return kept[-1]
    there = [tuple(moved(f, foreign) for f in fs) for fs in of_pair]
    options = {"device": device, "descriptors": kind}
    assert_same_path(follow(odometry(**options), there), follow(odometry(**options), of_pair))
    assert all(f.kept for f in kept) and not any(f.out for f in kept)


def test_tensors_elsewhere_are_refused(matches):
    of_pair, features = odometry(), pair(matches[0])
    for where, word in ((KDL_CUDA, "not in host memory"), (KDL_ROCM, "not in host memory")):
        with pytest.raises(ValueError, match=word):
            of_pair.track(*(moved(f, lambda a: Foreign(a, where)) for f in features), 1)
    mixed = moved(features[0], lambda a: Foreign(a, KDL_CUDA))
    mixed.angle = features[0].angle
    with pytest.raises(ValueError, match="positions of the features is on a device, angle on the host"):
        of_pair.track(mixed, features[1], 1)
    assert of_pair.track(*features, 1).keyframe  # nothing has changed


class Driver:
    """Memory of a GPU by CUDA's driver alone."""

    def __init__(self):
        self.cuda = ctypes.CDLL("libcuda.so.1")
        self.context, self.used = ctypes.c_void_p(), []
        self.call("cuInit", 0)
        self.call("cuDevicePrimaryCtxRetain", ctypes.byref(self.context), 0)
        self.call("cuCtxSetCurrent", self.context)

    def call(self, name, *arguments):
        assert getattr(self.cuda, name)(*arguments) == 0, name

    def __call__(self, array):
        address = ctypes.c_uint64()
        self.call("cuMemAlloc_v2", ctypes.byref(address), ctypes.c_size_t(max(array.nbytes, 1)))
        self.call("cuMemcpyHtoD_v2", address, ctypes.c_void_p(array.ctypes.data), ctypes.c_size_t(array.nbytes))
        self.used.append(address)
        return Foreign(array, KDL_CUDA, address.value)

    def close(self):
        for address in self.used:
            self.call("cuMemFree_v2", address)


@pytest.fixture(params=["driver", "cupy", "torch"])
def to_gpu(request):
    """What moves an array to the GPU, and the stream that it does so on."""
    if request.param != "driver":
        library = pytest.importorskip(request.param)
    if len(ft.devices()) < 2:
        pytest.skip("no GPU, or built without CUDA")
    if request.param == "driver":
        driver = Driver()
        yield driver, None
        driver.close()
    elif request.param == "cupy":
        stream = library.cuda.Stream(non_blocking=True)
        with stream:
            yield library.asarray, stream
    else:
        if not library.cuda.is_available():
            pytest.skip("torch sees no GPU")
        stream = library.cuda.Stream()
        with library.cuda.stream(stream):
            yield lambda array: library.from_numpy(array).cuda(non_blocking=True), stream


@pytest.mark.parametrize("kind", ["orb", "bits_512", "int8_128"])
def test_tensors_on_the_gpu_are_read_in_place(matches, to_gpu, kind):
    move, stream = to_gpu
    of = {"orb": lambda orb: orb, "bits_512": lambda orb: np.concatenate([orb, orb], axis=1),
          "int8_128": lambda orb: (numbers(orb).astype(np.int16) - 128).astype(np.int8)}[kind]
    of_pair = [described(pair(m), of) for m in matches]
    on_gpu = odometry(device="cuda", descriptors=kind)
    got = [on_gpu.track(*(moved(f, move) for f in fs), 50_000_000 * i, stream=stream) for i, fs in enumerate(of_pair)]
    assert_same_path(got, follow(odometry(descriptors=kind), of_pair))


def test_tensors_on_the_gpu_that_are_refused(matches, to_gpu):
    move, stream = to_gpu
    left, right = (moved(f, move) for f in pair(matches[0]))
    n, rows = len(matches[0].left), matches[0].left.descriptors
    on_gpu = odometry(device="cuda")
    for change, word in (({"positions": move(np.zeros((n, 3), np.float32))}, "positions.*float32.*on the GPU"),
                         ({"positions": move(np.zeros((n, 2)))}, "positions.*float32"),
                         ({"octave": move(np.zeros(n, np.int64))}, "octave.*int32"),
                         ({"score": move(np.zeros(n + 1, np.float32))}, "score"),
                         ({"descriptors": move(rows.view(np.int8))}, "uint8 array"),
                         ({"descriptors": move(np.zeros((n, 64), np.uint8))}, r"\(n, 32\)"),
                         ({"angle": matches[0].left.angle}, "angle on the host")):
        with pytest.raises(ValueError, match=word):
            on_gpu.track(ft.ImageFeatures(**{**vars(left), **change}), right, 1, stream=stream)
    assert on_gpu.track(left, right, 1, stream=stream).keyframe
    far = moved(pair(matches[0])[0], move)
    far.positions = move(np.where(np.arange(n)[:, None] % 2, np.float32(np.nan), matches[0].left.to_numpy()[0]))
    assert on_gpu.track(far, right, 2, stream=stream).keypoints == (n + 1) // 2  # no number is known before


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


NETWORK = '''
import torch
from torch.nn import functional


class Network:
    """What XFeat's is to its callers; one layer of random weights."""

    def __init__(self):
        self.weights = torch.randn(64, 1, 17, 17, generator=torch.Generator().manual_seed(3))

    def detectAndCompute(self, x, top_k):
        mean = functional.avg_pool2d(x, 9, 1, 4)
        spread = functional.avg_pool2d(x * x, 9, 1, 4) - mean * mean
        peaks = (spread == functional.max_pool2d(spread, 7, 1, 3))[0, 0]
        peaks[:16], peaks[-16:], peaks[:, :16], peaks[:, -16:] = False, False, False, False
        y, x_ = peaks.nonzero().T
        scores, order = spread[0, 0, y, x_].sort(descending=True)
        order = order[:top_k]
        rows = functional.conv2d(x - mean, self.weights, padding=8)[0, :, y[order], x_[order]].T
        return [{"keypoints": torch.stack((x_[order], y[order]), 1).float(), "scores": scores[:top_k],
                 "descriptors": functional.normalize(rows, dim=1)}]


def XFeat(pretrained, top_k):
    assert not pretrained
    return Network()
'''


def test_a_network_with_random_weights(walk, tmp_path, capsys):
    pytest.importorskip("cv2")
    pytest.importorskip("torch")
    path = Path(__file__).parents[2] / "examples/own_features/main.py"
    spec = importlib.util.spec_from_file_location("own_features_example", path)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    (tmp_path / "hubconf.py").write_text(NETWORK)
    found = example.xfeat(str(tmp_path), 400)
    assert "weights are random" in capsys.readouterr().out
    frames = [[found(image) for image in walk.frame(i)[:2]] for i in range(FRAMES)]
    assert frames[0][0].descriptors.shape == (len(frames[0][0].positions), 128) and not frames[0][0].descriptors[:, 64:].any()
    poses = follow(odometry(descriptors="int8_128"), frames)
    for i, p in enumerate(poses):  # whole pixels, whose errors neighbours share, so that there may be warnings
        assert p.tracked and p.maps == 1 and np.allclose(p.T_world_camera[:2, 3], walk.position(i), atol=0.05)
