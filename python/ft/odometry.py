# SPDX-License-Identifier: Apache-2.0
"""Images in, poses out."""

from __future__ import annotations

import os
import warnings
from typing import Any, Optional, Sequence, Union, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from . import _ft
from .features import ImageFeatures, _frames, _options
from .results import ClosedLoops, Map, PlacedKeyframes, TrackedKeypoints
from .rigs import Imu, MultiRig, Rig, _matrix, _two, check_calibration
from .streams import Array, StreamLike, handle_of


class Odometry:
    """Tracks the cameras of a rig in a map that it makes; with batch > 1 that many rigs of the same kind, each in its own
    map.

    rig: RectifiedPair, DistortedPair, FisheyePair, RgbdCamera, MonocularCamera or MultiRig. width, height: of all
    images, pixels; of a DistortedPair, of the rectified ones. imu: ft.Imu, or None.
    near_depth: points up to this many baselines away are near; keyframes are made where they are few. map_slots,
    keyframes, local_points, window_points: limits of the map, of the local map and of adjustments. window: keyframes of
    an adjustment, moving and fixed. vocabulary: a file; by its words a lost camera is also looked up among so many
    candidates of the keyframes of its map; not with an IMU, a MonocularCamera or a MultiRig. loops: places that were
    seen before are recognised and the path is corrected, see placed_keyframes(); not with batch > 1.
    localize_only: cameras are tracked in a map of load_map(), which is not changed; one that is not found stays lost.
    With loops they are found anywhere in it.
    own_features: track_features() takes keypoints of yours. descriptors: of these, "orb" (32 bytes),
    "bits_512" (61 to 64 bytes, as AKAZE's and BRISK's) or "int8_128" (OpenCV's SIFT, or int8, of two rows of one point up to
    250 apart); others than "orb" need own_features and a RectifiedPair or an RgbdCamera of a pinhole, without imu and
    vocabulary, and track no images. measure_stages: record stage_times_us(). features,
    levels ...: as those of OrbExtractor, but a corner_ratio of 0 is 1/16 where there are depths; 1e-6 keeps all corners.
    device: auto (a GPU if there is one), host or cuda. Raises ValueError for values out of range; warns of what
    check_calibration() finds.

    Not to be used by two threads at a time; other threads run while a frame is tracked.
    """

    def __init__(self, rig: Rig, width: int, height: int, *, imu: Optional[Imu] = None, batch: int = 1,
                 device: str = "auto", near_depth: float = 50.0, map_slots: int = 1 << 14, keyframes: int = 128,
                 local_points: int = 1 << 13, window: tuple[int, int] = (10, 5), window_points: int = 1 << 12,
                 vocabulary: Optional[Union[str, os.PathLike[str]]] = None, candidates: int = 16,
                 loops: bool = False, localize_only: bool = False, own_features: bool = False, descriptors: str = "orb",
                 measure_stages: bool = False, features: int = 1200, levels: int = 8, scale_factor: float = 1.2,
                 ini_threshold: int = 20, min_threshold: int = 7,
                 corner_ratio: float = 0.0, mask_size: tuple[int, int] = (0, 0), std_sort: bool = False, threads: int = 0) -> None:
        all_options = _options(width, height, features, levels, scale_factor, ini_threshold, min_threshold, corner_ratio,
                               mask_size, std_sort, threads)
        if vocabulary is not None and not str(vocabulary):
            raise ValueError("vocabulary is empty, must be a file, or None")
        if descriptors not in ("orb", "bits_512", "int8_128"):
            raise ValueError(f"descriptors is {descriptors!r}, must be 'orb', 'bits_512' or 'int8_128'")
        moving, fixed = _two(window, "window")
        all_options.update(batch=batch, near_depth=near_depth, map_slots=map_slots, keyframes=keyframes,
                           local_points=local_points, window_moving=moving, window_fixed=fixed, window_points=window_points,
                           vocabulary="" if vocabulary is None else str(vocabulary), candidates=candidates,
                           loops=bool(loops), localize_only=bool(localize_only), own_features=bool(own_features),
                           descriptors=descriptors, measure_stages=bool(measure_stages))
        self.rig, self.scale_factor = rig, scale_factor
        self._doubts_depth = True
        self._mask_size, self._masked = _two(mask_size, "mask_size"), set[tuple[int, int]]()
        self._descriptors = descriptors
        if not isinstance(imu, (Imu, type(None))):
            raise ValueError(f"imu is a {type(imu).__name__}, must be an ft.Imu, or None")
        self._pipeline = _ft.OdometryPipeline(rig, all_options, imu, str(device))
        for found in check_calibration(rig, width, height):
            warnings.warn(f"{found.name}: {found.text}", stacklevel=2)

    @overload
    def track(self, *images: Union[Array, int, None], time_ns: Optional[int] = None,
              stream: Optional[StreamLike] = None) -> _ft.Tracking: ...

    @overload
    def track(self, *images: Union[Sequence[Optional[Array]], Sequence[int]], time_ns: Optional[Sequence[int]] = None,
              stream: Optional[StreamLike] = None) -> list[_ft.Tracking]: ...

    @overload
    def track(self, *images: Union[ImageFeatures, int], time_ns: Optional[int] = None,
              stream: Optional[StreamLike] = None) -> _ft.Tracking: ...

    @overload
    def track(self, *images: Union[Sequence[ImageFeatures], Sequence[int]], time_ns: Optional[Sequence[int]] = None,
              stream: Optional[StreamLike] = None) -> list[_ft.Tracking]: ...

    def track(self, *images: object, time_ns: object = None,
              stream: Optional[StreamLike] = None) -> Union[_ft.Tracking, list[_ft.Tracking]]:
        """Tracks a frame, and returns ft.Tracking.

        track(left, right, time_ns) of a pair, track(grey, depth, time_ns) of an RgbdCamera, track(image, time_ns) of a
        MonocularCamera, track(image, image, ..., time_ns) of a MultiRig: of each of its cameras in turn, of a pair left and
        right, of a camera with depth images both; None where a camera has none in this frame, but not all. With batch > 1 each of these is a sequence with an item for each rig, and a list is returned.

        Images are (height, width) uint8, rows may be padded; a depth image is uint16 or float32. time_ns: when they were
        taken, an int, nanoseconds; later than the frame before. On a GPU images may lie on the device: anything with
        __dlpack__, such as arrays of CuPy and tensors of PyTorch, is read in place; its address, width and distance of
        rows are multiples of 16 bytes. stream: the CUDA stream that writes them, see ft.Stream. Raises
        ValueError for another number, shape, type, place or time; then nothing has changed. Warns once if most depths are
        beyond 1000 baselines, as those of a wrong unit are.

        track(features, time_ns) with ImageFeatures, or with sequences of them, is track_features().
        """
        first = images[0] if images else None
        if isinstance(first[0] if isinstance(first, (list, tuple)) and first else first, ImageFeatures):
            return self.track_features(*images, time_ns=time_ns, stream=stream)  # type: ignore[call-overload,no-any-return]
        if time_ns is None:
            if not images:
                raise ValueError("track() has no arguments, needs images and time_ns")
            time_ns, images = images[-1], images[:-1]
        single = self._pipeline.batch == 1 and not (images and isinstance(images[0], (list, tuple)))
        if isinstance(images[0] if images else None, (list, tuple)) and isinstance(time_ns, int):
            raise ValueError(f"time_ns is {time_ns}, must be a list as the images are; one image is a NumPy array, or has __dlpack__")
        frames = [list(images)] if single else _frames(cast(Sequence[Sequence[Optional[Array]]], images))
        times = [time_ns] if single else time_ns
        tracked = self._pipeline.track(frames, times, handle_of(stream))
        if self._doubts_depth and any(t.tracked for t in tracked):
            self._doubts_depth = False
            for t in tracked:
                if t.reason == "depth_scale":
                    warnings.warn(t.explanation, stacklevel=2)
        return tracked[0] if single else tracked

    @overload
    def track_features(self, *features: Union[ImageFeatures, int], time_ns: Optional[int] = None,
                       stream: Optional[StreamLike] = None) -> _ft.Tracking: ...

    @overload
    def track_features(self, *features: Union[Sequence[ImageFeatures], Sequence[int]],
                       time_ns: Optional[Sequence[int]] = None,
                       stream: Optional[StreamLike] = None) -> list[_ft.Tracking]: ...

    def track_features(self, *features: object, time_ns: object = None,
                       stream: Optional[StreamLike] = None) -> Union[_ft.Tracking, list[_ft.Tracking]]:
        """Tracks a frame by keypoints of any detector, and returns ft.Tracking. Needs own_features.

        track_features(left, right, time_ns) of a RectifiedPair: partners are found by descriptors, columns are those given.
        track_features(image, time_ns) with right_x or depth of a RectifiedPair, with depth of an RgbdCamera, or of a
        MonocularCamera; each is an ImageFeatures. With batch > 1 each is a sequence with an item for each rig, and a list is
        returned. Other rigs take none. Mixes with track(). stream: the CUDA stream that writes arrays on the GPU, see ft.Stream.
        Raises ValueError for arrays of other shapes and types, numbers
        out of range, or a time that is not later; then nothing has changed.
        """
        if time_ns is None:
            if not features:
                raise ValueError("track_features() has no arguments, needs features and time_ns")
            time_ns, features = features[-1], features[:-1]
        single = self._pipeline.batch == 1 and not (features and isinstance(features[0], (list, tuple)))
        of_cameras = cast("tuple[ImageFeatures, ...]", features)
        frames = [of_cameras] if single else _frames(cast(Sequence[Sequence[ImageFeatures]], features))
        for f in (f for frame in frames for f in frame):
            if not isinstance(f, ImageFeatures):
                raise ValueError(f"features are {type(f).__name__}, must be ft.ImageFeatures")
        tracked = self._pipeline.track_features([[f._arrays(self._descriptors) for f in frame] for frame in frames],
                                                [time_ns] if single else time_ns, handle_of(stream))
        return tracked[0] if single else tracked

    def add_imu(self, time_ns: int, accel: ArrayLike, gyro: ArrayLike, b: int = 0) -> None:
        """A sample of the IMU: specific force, m/s^2, and angular rate, rad/s, three numbers each. Samples come in
        order; a frame uses those that came before its track(). One that is not after the one before, not finite or beyond
        the sensor's range is left out. Any thread may call this."""
        self._pipeline.add_imu(time_ns, accel, gyro, b)

    def predict(self, T_world_camera: ArrayLike, b: int = 0) -> None:
        """Where the camera is expected in the next frame, (4, 4) float64: instead of the motion model and of an IMU's prediction
        (imu_predicted is False then). Where there is no map yet, before the first frame or after reset(), the prediction is
        forgotten: the map begins at the origin."""
        self._pipeline.predict(_matrix(T_world_camera, "T_world_camera"), b)

    def reset(self, b: int = 0) -> None:
        """Begins anew with the next frame."""
        self._pipeline.reset(b)

    def set_mask(self, mask: Array, camera: int = 0, b: int = 0) -> None:
        """Keypoints come from where the mask, uint8 or bool of the size mask_size, is not 0. camera: 0 left, 1 right; of camera c
        of a MultiRig 2 c and 2 c + 1."""
        self._pipeline.set_mask(mask, camera, b)

    def set_masks(self, masks: Sequence[Optional[Array]], b: int = 0) -> None:
        """Those of the cameras in turn, as set_mask: left and right of a pair, of a MultiRig one of each camera. None = all of the
        image is used. For masks of single frames call it before each track(). Needs mask_size."""
        if getattr(masks, "ndim", 1) == 2:
            raise ValueError("masks is one array, must be a list with a mask of each camera, or None")
        for camera, mask in enumerate(masks):
            place = (2 * camera if isinstance(self.rig, MultiRig) else camera, b)
            if mask is not None:
                self.set_mask(mask, *place)
                self._masked.add(place)
            elif place in self._masked:
                self.set_mask(np.full(self._mask_size[::-1], 255, np.uint8), *place)
                self._masked.discard(place)

    def keypoints(self, b: int = 0) -> TrackedKeypoints:
        """Those of the last frame."""
        return TrackedKeypoints(**cast("dict[str, Any]", self._pipeline.keypoints(b)))

    def map(self, b: int = 0) -> Map:
        """The points and the keyframes of the map."""
        return Map(**cast("dict[str, Any]", self._pipeline.map(b)))

    def placed_keyframes(self, b: int = 0) -> PlacedKeyframes:
        """The keyframes as loops have corrected them. Empty without loops."""
        return PlacedKeyframes(**cast("dict[str, Any]", self._pipeline.placed_keyframes(b)))

    def closed_loops(self, b: int = 0) -> ClosedLoops:
        """The loops between placed_keyframes(). Empty without loops."""
        return ClosedLoops(**cast("dict[str, Any]", self._pipeline.closed_loops(b)))

    def stage_times_us(self) -> dict[str, float]:
        """Microseconds that each stage added to the last frame, by name, in order. Raises ValueError without
        measure_stages."""
        return self._pipeline.stage_times_us()

    def save_map(self, b: int = 0) -> bytes:
        """The map as bytes for load_map()."""
        return self.snapshot_map(b).tobytes()

    def snapshot_map(self, b: int = 0) -> _ft.MapSnapshot:
        """A copy of the map, whose tobytes() may be called on a thread while tracking goes on. Takes a tenth of save_map()'s
        time, or less."""
        return self._pipeline.snapshot_map(b)

    def load_map(self, data: Union[bytes, bytearray, memoryview], b: int = 0) -> None:
        """Replaces the map; the camera is searched for in it. Raises RuntimeError for damaged bytes."""
        try:
            data = bytes(memoryview(data))
        except TypeError:
            raise ValueError(f"the map is {type(data).__name__}, must be bytes of save_map()") from None
        self._pipeline.load_map(data, b)

    @property
    def memory_bytes(self) -> int:
        """Memory that was taken, of the host or of the device."""
        return self._pipeline.memory_bytes
