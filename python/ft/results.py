# SPDX-License-Identifier: Apache-2.0
"""What an Odometry knows: keypoints, map, keyframes and loops. Columns are arrays of NumPy, of one length unless said."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class TrackedKeypoints:
    """Keypoints of a frame, n of them, those of the left images.

    x, y: (n) float32, pixels. camera: (n) int32, 0, or the number in a MultiRig. octave: (n) int32, level of the pyramid. depth:
    (n) float32, metres if `Tracking.metric`, -1 = none. point: (n) int32, slot of the map point that it holds, -1 = none. matched: (n) bool,
    to a point from before this frame.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    camera: NDArray[np.int32]
    octave: NDArray[np.int32]
    depth: NDArray[np.float32]
    point: NDArray[np.int32]
    matched: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.x)

    def of_camera(self, number: int) -> TrackedKeypoints:
        """Those of one camera."""
        chosen = self.camera == number
        return replace(self, **{f.name: getattr(self, f.name)[chosen] for f in fields(self)})


@dataclass(frozen=True, eq=False)
class Map:
    """Points of a map, n of them, and its k keyframes, in the world, with loops in the frame of the odometry.

    position: (n, 3) float32, metres if `Tracking.metric`. normal: (n, 3) float32, the mean viewing direction, length 1. number: (n)
    int32, unique. keyframes_that_see_it: (n) int32. keyframe_time_ns: (k) int64.
    keyframe_T_world_camera: (k, 4, 4) float64.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    number: NDArray[np.int32]
    keyframes_that_see_it: NDArray[np.int32]
    keyframe_time_ns: NDArray[np.int64]
    keyframe_T_world_camera: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlacedKeyframes:
    """The keyframes as loops have corrected them, n of them, oldest first.

    time_ns: (n) int64. map: (n) int32, their map's number, which is that of the first of maps that loops have joined. T_odom_camera:
    (n, 4, 4) float64, as they were tracked. T_world_camera: (n, 4, 4) float64, as they are known now. scale: (n) float64 of the odometry's unit in
    the world's, 1 but with a MonocularCamera without an IMU. loaded: (n) bool, whether it came with load_map().
    """

    time_ns: NDArray[np.int64]
    map: NDArray[np.int32]
    T_odom_camera: NDArray[np.float64]
    T_world_camera: NDArray[np.float64]
    scale: NDArray[np.float64]
    loaded: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True, eq=False)
class ClosedLoops:
    """Loops between PlacedKeyframes, n of them, in the order in which they were closed.

    from_keyframe, to_keyframe: (n) int32, indices of the keyframe that was recognised and of the later one. from_time_ns, to_time_ns: (n)
    int64. T_from_to: (n, 4, 4) float64 as it was measured. scale: (n) float64 of `to`'s unit in `from`'s. inliers: (n) int32, the
    matches that agree.
    """

    from_keyframe: NDArray[np.int32]
    to_keyframe: NDArray[np.int32]
    from_time_ns: NDArray[np.int64]
    to_time_ns: NDArray[np.int64]
    T_from_to: NDArray[np.float64]
    scale: NDArray[np.float64]
    inliers: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.from_keyframe)
