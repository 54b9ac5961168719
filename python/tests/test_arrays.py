# SPDX-License-Identifier: Apache-2.0
"""Arrays that are somewhere else, gone or used up."""

import ctypes

import numpy as np
import pytest
from conftest import HEIGHT, WIDTH, follow



KDL_CPU, KDL_CUDA, KDL_ROCM, KDL_CUDA_HOST = 1, 2, 10, 3


class DLTensor(ctypes.Structure):
    """As in dlpack.h, version 0."""

    _fields_ = [("data", ctypes.c_void_p), ("device_type", ctypes.c_int32), ("device_id", ctypes.c_int32),
                ("ndim", ctypes.c_int32), ("code", ctypes.c_uint8), ("bits", ctypes.c_uint8), ("lanes", ctypes.c_uint16),
                ("shape", ctypes.POINTER(ctypes.c_int64)), ("strides", ctypes.POINTER(ctypes.c_int64)),
                ("byte_offset", ctypes.c_uint64)]


class DLManagedTensor(ctypes.Structure):
    _fields_ = [("tensor", DLTensor), ("context", ctypes.c_void_p), ("deleter", ctypes.CFUNCTYPE(None, ctypes.c_void_p))]


class Foreign:
    """Numbers of an array, said to be on a device, or at an address there. Counts the exports that were not given back."""

    def __init__(self, array, device, address=None):
        self.array, self.device, self.out = array, device, 0
        self.address = array.ctypes.data if address is None else address
        self.kept = []

    def __dlpack_device__(self):
        return self.device, 0

    def __dlpack__(self, **_):
        def give_back(_pointer):
            self.out -= 1
        m = DLManagedTensor()
        a = self.array
        numbers = ctypes.c_int64 * a.ndim
        m.tensor = DLTensor(self.address, self.device, 0, a.ndim, "iuf".index(a.dtype.kind), 8 * a.itemsize, 1,
                            numbers(*a.shape), numbers(*(s // a.itemsize for s in a.strides)), 0)
        m.deleter = DLManagedTensor._fields_[2][1](give_back)
        self.kept.append(m)
        self.out += 1
        new = ctypes.pythonapi.PyCapsule_New
        new.restype, new.argtypes = ctypes.py_object, (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
        return new(ctypes.addressof(m), b"dltensor", None)


def test_arrays_of_anyone_are_read_and_given_back(walk):
    odometry, want = walk.odometry(), follow(walk.odometry(), walk, 3)
    for i in range(3):
        left, right, t = walk.frame(i)
        a, b = Foreign(left, KDL_CPU), Foreign(right, KDL_CPU)
        assert np.array_equal(odometry.track(a, b, t).T_world_camera, want[i].T_world_camera)
        assert len(a.kept) == 1 and a.out == b.out == 0


@pytest.mark.parametrize("device", [KDL_CUDA, KDL_ROCM])
def test_another_place_is_named_and_the_array_given_back(walk, device):
    odometry = walk.odometry()
    left, right, t = walk.frame(0)
    there = Foreign(right, device)
    with pytest.raises(ValueError, match="the right image is not in host memory"):
        odometry.track(left, there, t)
    assert there.out == 0 and odometry.track(left, right, t).keyframe  # nothing has changed


class Gone:
    """An array whose memory was freed."""

    def __dlpack_device__(self):
        return KDL_CPU, 0

    def __dlpack__(self, **_):
        raise BufferError("the buffer was freed")


def used_up(image):
    """A capsule that another library has taken."""
    capsule = image.__dlpack__()
    class Once:
        def __dlpack__(self, **_):
            return capsule
        def __dlpack_device__(self):
            return KDL_CPU, 0
    once = Once()
    np.from_dlpack(once)
    return once


def released(image):
    view = memoryview(image)
    view.release()
    return view


@pytest.mark.parametrize("make", [lambda _: Gone(), used_up, released, lambda _: object(), lambda _: b"pixels"],
                         ids=["freed", "used up", "released", "object", "bytes"])
def test_an_array_that_is_gone_is_named(walk, make):
    odometry = walk.odometry()
    left, right, t = walk.frame(0)
    with pytest.raises(ValueError, match="the left image"):
        odometry.track(make(left), right, t)
    assert odometry.track(left, right, t).keyframe


@pytest.mark.parametrize("change, word", [
    (lambda a: a[::-1], "overlap|next to each other"), (lambda a: a.T, "next to each other"),
    (lambda a: np.broadcast_to(a[0], (HEIGHT, WIDTH)), "overlap"), (lambda a: a[:, :-1], "shape"),
    (lambda a: a[None], "3 dimensions"), (lambda a: a.view(np.int8), "uint8"), (lambda a: a > 9, "uint8"),
    (lambda a: a.astype(">u2"), "left image"),
], ids=["upside down", "transposed", "broadcast", "narrow", "three dimensions", "int8", "bool", "big-endian"])
def test_strides_shapes_and_types_are_named(walk, change, word):
    odometry = walk.odometry()
    left, right, t = walk.frame(0)
    with pytest.raises(ValueError, match=word) as error:
        odometry.track(change(left), right, t)
    assert "the left image" in str(error.value)
    assert odometry.track(left, right, t).keyframe


@pytest.mark.parametrize("change, call", [
    (lambda a: np.repeat(a[:, :, None], 3, 2), "cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)"),
    (lambda a: np.repeat(a[:, :, None], 4, 2), "cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY)"),
    (lambda a: a[:, :, None], "image[:, :, 0]"),
    (lambda a: a.astype(np.float32) / 255, "numpy.uint8(image.clip(0, 1) * 255 + 0.5)"),
    (lambda a: a.astype(np.float64) / 255, "numpy.uint8(image.clip(0, 1) * 255 + 0.5)"),
    (lambda a: a.astype(np.uint16) << 8, "numpy.uint8(image >> 8)"),
], ids=["colour", "with alpha", "one channel", "float32", "float64", "16 bits"])
def test_the_call_that_mends_an_image_is_named(walk, change, call):
    left, right, t = walk.frame(0)
    with pytest.raises(ValueError, match="the left image") as error:
        walk.odometry().track(change(left), right, t)
    assert call in str(error.value)
    if "cv2" not in call:
        assert np.array_equal(eval(call, {"numpy": np, "image": change(left)}), left)  # it does


def test_results_outlive_what_made_them(walk):
    odometry = walk.odometry()
    pose = follow(odometry, walk, 3)[-1]
    T, covariance = pose.T_world_camera, pose.covariance
    points, keypoints = odometry.map().position, odometry.keypoints().x
    copies = [a.copy() for a in (T, covariance, points, keypoints)]
    del odometry, pose
    follow(walk.odometry(), walk, 3)  # takes memory anew
    assert all(np.array_equal(a, b) for a, b in zip((T, covariance, points, keypoints), copies))
