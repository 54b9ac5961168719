# SPDX-License-Identifier: Apache-2.0
"""ORB features and stereo matches."""

from dataclasses import dataclass

import numpy as np

from . import _ft
from .rigs import _two
from .streams import handle_of


@dataclass
class Keypoints:
    """Keypoints of an image, n of them. Columns: x, y (float32, pixels), angle (degrees), response, octave (int32),
    descriptors (n, 32) uint8."""

    x: np.ndarray
    y: np.ndarray
    angle: np.ndarray
    response: np.ndarray
    octave: np.ndarray
    descriptors: np.ndarray
    scale_factor: float = 1.2

    def __len__(self):
        return len(self.x)

    def to_numpy(self):
        """Positions (n, 2) float32 and descriptors (n, 32) uint8."""
        return np.stack([self.x, self.y], axis=1), self.descriptors

    def to_cv2(self):
        """A list of cv2.KeyPoint, and the descriptors as OpenCV takes them."""
        import cv2

        sizes = 31.0 * self.scale_factor ** self.octave
        points = [
            cv2.KeyPoint(float(x), float(y), float(s), float(a), float(r), int(o))
            for x, y, s, a, r, o in zip(self.x, self.y, sizes, self.angle, self.response, self.octave)
        ]
        return points, self.descriptors


@dataclass
class StereoMatches:
    """Keypoints of both images; per left keypoint the column in the right image, pixels, and the depth, metres; -1 = none."""

    left: Keypoints
    right: Keypoints
    right_x: np.ndarray
    depth: np.ndarray


def _options(width, height, features=1200, levels=8, scale_factor=1.2, ini_threshold=20, min_threshold=7,
             mask_size=(0, 0), std_sort=False, threads=0):
    mask_width, mask_height = _two(mask_size, "mask_size")
    return {
        "width": width, "height": height, "features": features, "levels": levels, "scale_factor": scale_factor,
        "ini_threshold": ini_threshold, "min_threshold": min_threshold, "mask_width": mask_width,
        "mask_height": mask_height, "std_sort": bool(std_sort), "threads": threads,
    }


def _frames(images):
    """Of a sequence of images for each camera, those of each frame."""
    numbers = [len(of_camera) for of_camera in images]
    if len(set(numbers)) > 1:
        raise ValueError(f"{' and '.join(map(str, numbers))} images of the cameras, must be equally many of each")
    return list(zip(*images))


class OrbExtractor:
    """Extracts ORB features of grey images of one size, as ORB-SLAM3 does, `batch` images a call.

    width, height: pixels. features: wanted per image. levels, scale_factor: of the pyramid. ini_threshold,
    min_threshold: of corners, grey levels. mask_size: width and height of masks, none by default. std_sort: the order of
    ORB-SLAM3 with libstdc++. threads: of the host; 0 = all. device: auto (a GPU if there is one), host or cuda.
    Raises ValueError for values out of range.
    """

    def __init__(self, width, height, *, batch=1, device="auto", **options):
        self._options = _options(width, height, **options)
        self._pipeline = _ft.FeaturePipeline(self._options, batch, None, device)
        self.batch = int(batch)

    def extract(self, images, stream=None):
        """Keypoints of an image, (height, width) uint8; with batch > 1, of a sequence of images, as a list. On a GPU images
        may lie on the device (__dlpack__); stream: the CUDA stream that writes them, see ft.Stream."""
        single = self.batch == 1 and not isinstance(images, (list, tuple))
        found = self._pipeline.extract([images] if single else images, handle_of(stream))
        all_keypoints = [Keypoints(**k, scale_factor=self._options["scale_factor"]) for k in found]
        return all_keypoints[0] if single else all_keypoints

    def set_mask(self, mask, i=0):
        """Keypoints of image i come from where the mask, (mask height, mask width) uint8 or bool, is not 0."""
        self._pipeline.set_mask(i, mask)


class StereoMatcher:
    """ORB features of stereo pairs and their depths. rig: RectifiedPair or FisheyePair. Other arguments as those of
    OrbExtractor; batch is the number of pairs."""

    def __init__(self, rig, width, height, *, batch=1, device="auto", **options):
        self._options = _options(width, height, **options)
        self._pipeline = _ft.FeaturePipeline(self._options, 2 * batch, rig, device)
        self.batch = int(batch)

    def match(self, left, right, stream=None):
        """StereoMatches of two images (height, width) uint8; with batch > 1, of two sequences of images, as a list. stream:
        see OrbExtractor.extract."""
        single = self.batch == 1 and not isinstance(left, (list, tuple))
        pairs = [(left, right)] if single else _frames((left, right))
        scale = self._options["scale_factor"]
        found = [
            StereoMatches(Keypoints(**l, scale_factor=scale), Keypoints(**r, scale_factor=scale), right_x, depth)
            for l, r, right_x, depth in self._pipeline.match([i for pair in pairs for i in pair], handle_of(stream))
        ]
        return found[0] if single else found
