# SPDX-License-Identifier: Apache-2.0
"""Images in, poses out."""

import warnings

import numpy as np

from . import _ft
from .features import _frames, _options
from .rigs import _matrix, _two, check_calibration
from .streams import handle_of


class Odometry:
    """Tracks the cameras of a rig in a map that it makes; with batch > 1 that many rigs of the same kind, each in its own
    map.

    rig: RectifiedPair, DistortedPair, FisheyePair, RgbdCamera, MonocularCamera or MultiRig. width, height: of all
    images, pixels; of a DistortedPair, of the rectified ones. imu: ft.Imu, or None.
    near_depth: points up to this many baselines away are near; keyframes are made where they are few. map_slots,
    keyframes, local_points, window_points: limits of the map, of the local map and of adjustments. window: keyframes of
    an adjustment, moving and fixed. vocabulary: a file; by its words a lost camera is also looked up among so many
    candidates of the keyframes of its map; not with an IMU, a MonocularCamera or a MultiRig. measure_stages: record stage_times(). features, levels ...: as those of OrbExtractor.
    device: auto (a GPU if there is one), host or cuda. Raises ValueError for values out of range; warns of what
    check_calibration() finds.

    Not to be used by two threads at a time; other threads run while a frame is tracked.
    """

    def __init__(self, rig, width, height, *, imu=None, batch=1, device="auto", near_depth=50.0, map_slots=1 << 14,
                 keyframes=128, local_points=1 << 13, window=(10, 5), window_points=1 << 12, vocabulary=None,
                 candidates=16, measure_stages=False, **options):
        all_options = _options(width, height, **options)
        if vocabulary is not None and not str(vocabulary):
            raise ValueError("vocabulary is empty, must be a file, or None")
        moving, fixed = _two(window, "window")
        all_options.update(batch=batch, near_depth=near_depth, map_slots=map_slots, keyframes=keyframes,
                           local_points=local_points, window_moving=moving, window_fixed=fixed, window_points=window_points,
                           vocabulary="" if vocabulary is None else str(vocabulary), candidates=candidates,
                           measure_stages=bool(measure_stages))
        self.rig, self.scale_factor = rig, all_options["scale_factor"]
        self._doubts_depth = True
        self._pipeline = _ft.OdometryPipeline(rig, all_options, imu, device)
        for found in check_calibration(rig, width, height):
            warnings.warn(f"{found.name}: {found.text}", stacklevel=2)

    def track(self, *images, time_ns=None, stream=None):
        """Tracks a frame, and returns ft.Tracking.

        track(left, right, time_ns) of a pair, track(grey, depth, time_ns) of an RgbdCamera, track(image, time_ns) of a
        MonocularCamera, track(image, image, ..., time_ns) of a MultiRig: of each of its cameras in turn, of a pair left and
        right. With batch > 1 each of these is a sequence with an item for each rig, and a list is returned.

        Images are (height, width) uint8, rows may be padded; a depth image is uint16 or float32. time_ns: when they were
        taken, an int, nanoseconds; later than the frame before. On a GPU images may lie on the device: anything with
        __dlpack__, such as arrays of CuPy and tensors of PyTorch, is read in place; its address, width and distance of
        rows are multiples of 16 bytes. stream: the CUDA stream that writes them, see ft.Stream. Raises
        ValueError for another number, shape, type, place or time; then nothing has changed. Warns once if most depths are
        beyond 1000 baselines, as those of a wrong unit are.
        """
        if time_ns is None:
            if not images:
                raise ValueError("track() has no arguments, needs images and time_ns")
            *images, time_ns = images
        single = self._pipeline.batch == 1 and not (images and isinstance(images[0], (list, tuple)))
        frames, times = ([images], [time_ns]) if single else (_frames(images), time_ns)
        tracked = self._pipeline.track(frames, times, handle_of(stream))
        if self._doubts_depth and any(t.tracked for t in tracked):
            self._doubts_depth = False
            for t in tracked:
                if t.reason == "depth_scale":
                    warnings.warn(t.explanation, stacklevel=2)
        return tracked[0] if single else tracked

    def add_imu(self, time_ns, accel, gyro, b=0):
        """A sample of the IMU: specific force, m/s^2, and angular rate, rad/s, three numbers each. Samples come in
        order; a frame uses those that came before its track(). One that is not after the one before, not finite or beyond
        the sensor's range is left out. Any thread may call this."""
        self._pipeline.add_imu(time_ns, accel, gyro, b)

    def predict(self, T_world_camera, b=0):
        """Where the camera is expected in the next frame, (4, 4) float64."""
        self._pipeline.predict(_matrix(T_world_camera, "T_world_camera"), b)

    def reset(self, b=0):
        """Begins anew with the next frame."""
        self._pipeline.reset(b)

    def set_mask(self, mask, camera=0, b=0):
        """Keypoints come from where the mask, uint8 or bool of the size mask_size, is not 0. camera: 0 left, 1 right; of camera c
        of a MultiRig 2 c and 2 c + 1."""
        self._pipeline.set_mask(mask, camera, b)

    def keypoints(self, b=0):
        """Keypoints of the last frame, those of the left images, columns of n: x, y (pixels), camera (0, or its number in a
        MultiRig), octave, depth (metres, -1 = none), point (slot of the map point held, -1 = none), matched (to a point
        from before this frame)."""
        return self._pipeline.keypoints(b)

    def map(self, b=0):
        """The map, n points and k keyframes: position (n, 3) in the world, metres if `Tracking.metric`, normal (n, 3), the
        mean viewing direction, number (n), keyframes_that_see_it (n); keyframe_time_ns (k), keyframe_T_world_camera
        (k, 4, 4)."""
        return self._pipeline.map(b)

    def stage_times(self):
        """Milliseconds that each stage added to the last frame, by name, in order. Raises ValueError without
        measure_stages."""
        return self._pipeline.stage_times()

    def save_map(self, b=0):
        """The map as bytes for load_map()."""
        return self._pipeline.save_map(b)

    def load_map(self, data, b=0):
        """Replaces the map; the camera is searched for in it. Raises RuntimeError for damaged bytes."""
        try:
            data = bytes(memoryview(data))
        except TypeError:
            raise ValueError(f"the map is {type(data).__name__}, must be bytes of save_map()") from None
        self._pipeline.load_map(data, b)

    @property
    def memory_bytes(self):
        """Memory that was taken, of the host or of the device."""
        return self._pipeline.memory_bytes
