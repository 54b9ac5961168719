# SPDX-License-Identifier: Apache-2.0
"""ORB features and stereo matches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Optional, Sequence, TypeVar, Union, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _ft
from .rigs import FisheyePair, RectifiedPair, _two
from .streams import Array, StreamLike, handle_of

if TYPE_CHECKING:
    import cv2
    import cv2.typing


@dataclass
class Keypoints:
    """Keypoints of an image, n of them. Columns: x, y (float32, pixels), angle (degrees), response, octave (int32),
    descriptors (n, 32) uint8."""

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    angle: NDArray[np.float32]
    response: NDArray[np.float32]
    octave: NDArray[np.int32]
    descriptors: NDArray[np.uint8]
    scale_factor: float = 1.2

    def __len__(self) -> int:
        return len(self.x)

    def to_numpy(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Positions (n, 2) float32 and descriptors (n, 32) uint8."""
        return np.stack([self.x, self.y], axis=1), self.descriptors

    def to_cv2(self) -> tuple[list[cv2.KeyPoint], NDArray[np.uint8]]:
        """A list of cv2.KeyPoint, and the descriptors as OpenCV takes them."""
        import cv2

        sizes = 31.0 * self.scale_factor ** self.octave
        points = [
            cv2.KeyPoint(float(x), float(y), float(s), float(a), float(r), int(o))
            for x, y, s, a, r, o in zip(self.x, self.y, sizes, self.angle, self.response, self.octave)
        ]
        return points, self.descriptors


Column = Union[ArrayLike, Array]


def _is_on_device(values: object) -> bool:
    """Whether an array says that it lies elsewhere than on the host."""
    device = getattr(values, "__dlpack_device__", None)
    return device is not None and not isinstance(values, np.ndarray) and int(device()[0]) not in (1, 3)  # kDLCPU, kDLCUDAHost


def _on_host(values: object) -> object:
    """An array of NumPy of one that NumPy knows by __dlpack__ alone, else as it is."""
    by_protocol = hasattr(values, "__dlpack_device__") and not hasattr(values, "__array__")
    return np.from_dlpack(values) if by_protocol else values  # type: ignore[arg-type]


@dataclass
class ImageFeatures:
    """Keypoints of an image from any detector, n of them, for Odometry.track_features().

    On the host anything that NumPy takes. Or all arrays lie on the GPU of the Odometry (__dlpack__, such as tensors of PyTorch):
    they are read there, on `stream`, without a copy, and are contiguous and float32; octave int32; descriptors uint8 (n, 32),
    of bits_512 uint8 (n, 64), of int8_128 int8 (n, 128). What is there cannot be told of before: keypoints with a number out of
    range raise nothing, they are left out. Arrays of another GPU raise ValueError.

    positions: (n, 2) column and row, pixels, in the image; 0 is the middle of the first pixel. descriptors: (n, 32) uint8,
    compared by their Hamming distance, or those of Odometry(descriptors=...). octave: (n) pyramid levels; positions have a
    standard deviation of scale_factor ** octave pixels. deviation: (n) pixels, instead of octave; the nearest one is taken. Without both the
    octave is 0. angle: (n) degrees, 0 to 360; without, matches are not compared by how they turned. score: (n); of more keypoints
    than there is room for those with the highest scores are taken, without scores the first ones.

    right_x: (n) columns of the partners in the right image, NaN = none. depth: (n) metres, NaN = none; an RgbdCamera needs
    it. With one of these no partners are searched. level_positions: positions and right_x are pixels of the octave's
    level times its scale, as those of OpenCV's ORB, OrbExtractor and Odometry.keypoints() are; no difference on octave 0.
    """

    positions: Column
    descriptors: Union[NDArray[np.uint8], NDArray[np.int8], NDArray[np.float32], Array]
    octave: Optional[Column] = None
    angle: Optional[Column] = None
    score: Optional[Column] = None
    deviation: Optional[Column] = None
    right_x: Optional[Column] = None
    depth: Optional[Column] = None
    level_positions: bool = False

    @staticmethod
    def of(keypoints: Keypoints) -> ImageFeatures:
        """Those of OrbExtractor or StereoMatcher."""
        positions, descriptors = keypoints.to_numpy()
        return ImageFeatures(positions, descriptors, keypoints.octave, keypoints.angle, keypoints.response,
                             level_positions=True)

    @staticmethod
    def from_cv2(keypoints: Sequence[cv2.KeyPoint], descriptors: Optional[cv2.typing.MatLike],
                 pixel_size: Optional[float] = None) -> ImageFeatures:
        """Those of cv2.ORB_create(scaleFactor=s), whose scale_factor the Odometry has, too. Octaves of other detectors of
        OpenCV mean something else. pixel_size: of these, the size of keypoints whose positions have a standard deviation of
        a pixel, 3.2 of SIFT, 4.8 of AKAZE; `deviation` follows from the sizes."""
        positions = np.array([k.pt for k in keypoints], np.float32).reshape(-1, 2)
        rows = cast("NDArray[np.uint8]", np.zeros((0, 32), np.uint8) if descriptors is None else descriptors)
        angle = np.array([k.angle for k in keypoints], np.float32)
        if pixel_size is not None:
            sizes = np.array([k.size for k in keypoints], np.float32)
            return ImageFeatures(positions, rows, angle=None if np.any(angle < 0) else angle, deviation=sizes / pixel_size,
                                 score=np.array([k.response for k in keypoints], np.float32))
        return ImageFeatures(positions, rows, np.array([k.octave for k in keypoints], np.int32),
                             None if np.any(angle < 0) else angle,
                             np.array([k.response for k in keypoints], np.float32), level_positions=True)

    def _rows(self, kind: str) -> object:
        """The descriptors as an odometry of that kind takes them."""
        rows = _on_host(self.descriptors)
        if kind == "orb":
            return np.ascontiguousarray(rows) if isinstance(rows, np.ndarray) else rows
        listed = isinstance(rows, (list, tuple))
        rows = np.asarray(rows)
        if listed and rows.dtype.kind in "iu" and rows.size > 0 and rows.min() >= 0 and rows.max() <= 255:
            rows = rows.astype(np.uint8)
        if rows.ndim == 2 and len(rows) == 0:
            return np.zeros((0, 64 if kind == "bits_512" else 128), np.uint8)
        if kind == "bits_512":
            if rows.dtype != np.uint8 or rows.ndim != 2 or not 61 <= rows.shape[1] <= 64:
                raise ValueError(f"descriptors of the features are {rows.dtype} of shape {rows.shape}, must be uint8, (n, 61) "
                                 "to (n, 64)")
            return np.pad(rows, ((0, 0), (0, 64 - rows.shape[1])))
        if rows.dtype not in (np.int8, np.uint8, np.float32) or rows.shape[1:] != (128,):
            raise ValueError(f"descriptors of the features are {rows.dtype} of shape {rows.shape}, must be int8, uint8 or "
                             "float32, (n, 128)")
        if rows.dtype == np.int8:
            return np.ascontiguousarray(rows).view(np.uint8)
        whole = rows.astype(np.uint8) if np.all((rows >= 0) & (rows <= 255)) else np.zeros_like(rows, np.uint8)
        if not np.array_equal(whole, rows):
            raise ValueError("descriptors of the features are not whole numbers from 0 to 255, as those of SIFT are")
        return np.ascontiguousarray(whole ^ np.uint8(128))  # the bytes of int8, 128 less

    def _arrays(self, kind: str = "orb") -> dict[str, object]:
        columns = ("positions", "angle", "score", "deviation", "right_x", "depth")
        given = {name: getattr(self, name) for name in (*columns, "octave", "descriptors")}
        there = [name for name, values in given.items() if _is_on_device(values)]
        if there:
            here = [name for name, values in given.items() if values is not None and name not in there]
            if here:
                raise ValueError(f"{there[0]} of the features is on a device, {here[0]} on the host: must be in one place")
            return {**given, "level_positions": bool(self.level_positions), "on_device": True, "is_signed": kind == "int8_128"}

        def floats(name: str) -> object:
            values = _on_host(given[name])
            try:
                return None if values is None else np.ascontiguousarray(values, np.float32)
            except (TypeError, ValueError):
                raise ValueError(f"{name} of the features is no array of numbers") from None

        octave = None if self.octave is None else np.asarray(_on_host(self.octave))
        if octave is not None and octave.size > 0 and octave.dtype.kind not in "iu":
            raise ValueError(f"octave of the features is {octave.dtype}, must be whole numbers")
        return {
            **{name: floats(name) for name in columns},
            "octave": None if octave is None else np.ascontiguousarray(octave.clip(-1, 127), np.int32),
            "descriptors": self._rows(kind),
            "level_positions": bool(self.level_positions), "on_device": False,
        }


@dataclass
class StereoMatches:
    """Keypoints of both images; per left keypoint the column in the right image, pixels, and the depth, metres; -1 = none."""

    left: Keypoints
    right: Keypoints
    right_x: NDArray[np.float32]
    depth: NDArray[np.float32]


def _options(width: int, height: int, features: int, levels: int, scale_factor: float, ini_threshold: int,
             min_threshold: int, corner_ratio: float, mask_size: tuple[int, int], std_sort: bool,
             threads: int) -> dict[str, object]:
    mask_width, mask_height = _two(mask_size, "mask_size")
    return {
        "width": width, "height": height, "features": features, "levels": levels, "scale_factor": scale_factor,
        "ini_threshold": ini_threshold, "min_threshold": min_threshold, "corner_ratio": corner_ratio,
        "mask_width": mask_width, "mask_height": mask_height, "std_sort": bool(std_sort), "threads": threads,
    }


_Item = TypeVar("_Item")


def _frames(images: Sequence[Sequence[_Item]]) -> list[tuple[_Item, ...]]:
    """Of a sequence of images for each camera, those of each frame."""
    numbers = [len(of_camera) for of_camera in images]
    if len(set(numbers)) > 1:
        raise ValueError(f"{' and '.join(map(str, numbers))} images of the cameras, must be equally many of each")
    return list(zip(*images))


def _keypoints(columns: dict[str, object], scale_factor: float) -> Keypoints:
    return Keypoints(**columns, scale_factor=scale_factor)  # type: ignore[arg-type]


class OrbExtractor:
    """Extracts ORB features of grey images of one size, as ORB-SLAM3 does, `batch` images a call.

    width, height: pixels. features: wanted per image. levels, scale_factor: of the pyramid. ini_threshold,
    min_threshold: of corners, grey levels. corner_ratio: corners that are more like an edge are left out, in [0, 1], 0 keeps
    all. mask_size: width and height of masks, none by default. std_sort: the order of ORB-SLAM3 with libstdc++. threads:
    of the host; 0 = all. device: auto (a GPU if there is one), host or cuda. Raises ValueError for values out of range.
    """

    def __init__(self, width: int, height: int, *, batch: int = 1, device: str = "auto", features: int = 1200, levels: int = 8,
                 scale_factor: float = 1.2, ini_threshold: int = 20, min_threshold: int = 7, corner_ratio: float = 0.0,
                 mask_size: tuple[int, int] = (0, 0), std_sort: bool = False, threads: int = 0) -> None:
        self._scale_factor = scale_factor
        options = _options(width, height, features, levels, scale_factor, ini_threshold, min_threshold, corner_ratio, mask_size,
                           std_sort, threads)
        self._pipeline = _ft.FeaturePipeline(options, batch, None, str(device))
        self.batch = int(batch)

    @overload
    def extract(self, images: Array, stream: Optional[StreamLike] = None) -> Keypoints: ...

    @overload
    def extract(self, images: Sequence[Array], stream: Optional[StreamLike] = None) -> list[Keypoints]: ...

    def extract(self, images: Union[Array, Sequence[Array]],
                stream: Optional[StreamLike] = None) -> Union[Keypoints, list[Keypoints]]:
        """Keypoints of an image, (height, width) uint8; with batch > 1, of a sequence of images, as a list. On a GPU images
        may lie on the device (__dlpack__); stream: the CUDA stream that writes them, see ft.Stream."""
        single = self.batch == 1 and not isinstance(images, (list, tuple))
        found = self._pipeline.extract([images] if single else cast(Sequence[Array], images), handle_of(stream))
        all_keypoints = [_keypoints(k, self._scale_factor) for k in found]
        return all_keypoints[0] if single else all_keypoints

    def set_mask(self, mask: Array, i: int = 0) -> None:
        """Keypoints of image i come from where the mask, (mask height, mask width) uint8 or bool, is not 0."""
        self._pipeline.set_mask(i, mask)


class StereoMatcher:
    """ORB features of stereo pairs and their depths. rig: RectifiedPair or FisheyePair. Other arguments as those of
    OrbExtractor; batch is the number of pairs."""

    def __init__(self, rig: Union[RectifiedPair, FisheyePair], width: int, height: int, *, batch: int = 1,
                 device: str = "auto", features: int = 1200, levels: int = 8,
                 scale_factor: float = 1.2, ini_threshold: int = 20, min_threshold: int = 7, corner_ratio: float = 0.0,
                 mask_size: tuple[int, int] = (0, 0), std_sort: bool = False, threads: int = 0) -> None:
        self._scale_factor = scale_factor
        options = _options(width, height, features, levels, scale_factor, ini_threshold, min_threshold, corner_ratio, mask_size,
                           std_sort, threads)
        self._pipeline = _ft.FeaturePipeline(options, 2 * batch, rig, str(device))
        self.batch = int(batch)

    @overload
    def match(self, left: Array, right: Array, stream: Optional[StreamLike] = None) -> StereoMatches: ...

    @overload
    def match(self, left: Sequence[Array], right: Sequence[Array],
              stream: Optional[StreamLike] = None) -> list[StereoMatches]: ...

    def match(self, left: Union[Array, Sequence[Array]], right: Union[Array, Sequence[Array]],
              stream: Optional[StreamLike] = None) -> Union[StereoMatches, list[StereoMatches]]:
        """StereoMatches of two images (height, width) uint8; with batch > 1, of two sequences of images, as a list. stream:
        see OrbExtractor.extract."""
        single = self.batch == 1 and not isinstance(left, (list, tuple))
        pairs = [(left, right)] if single else _frames(cast(Sequence[Sequence[Array]], (left, right)))
        scale = self._scale_factor
        found = [
            StereoMatches(_keypoints(l, scale), _keypoints(r, scale), right_x, depth)
            for l, r, right_x, depth in self._pipeline.match([i for pair in pairs for i in pair], handle_of(stream))
        ]
        return found[0] if single else found
