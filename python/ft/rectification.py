# SPDX-License-Identifier: Apache-2.0
"""Rectified images of a distorted pair."""

from __future__ import annotations

from typing import Optional

import numpy as np
from numpy.typing import NDArray

from . import _ft
from .rigs import DistortedPair, RectifiedPair
from .streams import Array, StreamLike, handle_of


class Rectifier:
    """Rectifies the images of a DistortedPair through tables that it computes once, bilinear: the pixels of cv2.remap with
    the maps of cv2.initUndistortRectifyMap in fixed point.

    rig: DistortedPair. width, height: of the rectified images, pixels. border: grey level of what lies outside the given
    images. threads: of the host; 0 = all. device: auto (a GPU if there is one), host or cuda. Raises ValueError for a rig
    that cannot be rectified in rows and for values out of range.

    Not to be used by two threads at a time.
    """

    def __init__(self, rig: DistortedPair, width: int, height: int, *, border: int = 0, threads: int = 0,
                 device: str = "auto") -> None:
        if rig.readout_s > 0:
            raise ValueError("readout_s is above 0: rectified images have other rows; an Odometry takes the DistortedPair itself")
        self._pipeline = _ft.RectificationPipeline(rig, width, height, border, threads, str(device))
        self.rig = RectifiedPair(rig.wanted, self._pipeline.baseline)  # that of the rectified images

    def rectify(self, left: Array, right: Array, out: Optional[tuple[Array, Array]] = None,
                stream: Optional[StreamLike] = None) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Two rectified images (height, width) uint8, as a tuple, of two images (raw height, raw width) uint8, whose rows may
        be padded. Of images in host memory arrays of NumPy; on a GPU, of images on the device (__dlpack__) arrays there, which
        torch.from_dlpack and cupy.from_dlpack take. out: two arrays that are written in place of new ones, on the host or,
        on a GPU, on the device; they must not overlap the images. stream: the CUDA stream that writes the
        images, see ft.Stream. Returns when the pixels are there. Raises ValueError for another shape, type or place."""
        return self._pipeline.rectify(left, right, out, handle_of(stream))

    def map(self, camera: int) -> tuple[NDArray[np.int16], NDArray[np.uint16], NDArray[np.float64]]:
        """How camera 0 (left) or 1 (right) is rectified: source positions (height, width, 2) int16 and their fractions
        (height, width) uint16, as cv2.remap takes them; and the rotation (3, 3) of the camera's points into the
        rectified one."""
        return self._pipeline.map(camera)
