# SPDX-License-Identifier: Apache-2.0
"""FastTrack: the tracking front-end of visual(-inertial) SLAM on CPU threads and GPUs, with the same bits on both.

Lengths are in metres, positions in images in pixels, times in nanoseconds. T_a_b maps points of b to a. A mistake of the
caller raises ValueError, anything else RuntimeError.
"""

from ._ft import (
    DoubleSphere, ExtendedUnified, FieldOfView, KannalaBrandt, MapSnapshot, Pinhole, PlaceRecognition, RadTan, Tracking, Unified,
    __version__, devices,
)
from .features import ImageFeatures, Keypoints, OrbExtractor, StereoMatcher, StereoMatches
from .odometry import Odometry
from .rectification import Rectifier
from .results import ClosedLoops, Map, PlacedKeyframes, TrackedKeypoints
from .rigs import (
    CalibrationWarning, DistortedPair, FisheyePair, Imu, MonocularCamera, MultiRig, RectifiedPair, RgbdCamera, RigCamera,
    check_calibration,
)
from .sequences import Frame, Sequence, Trajectory, evaluate, read_sequence, read_tum
from .streams import Stream

__all__ = [
    "CalibrationWarning", "ClosedLoops", "DistortedPair", "DoubleSphere", "ExtendedUnified", "FieldOfView", "FisheyePair", "Frame",
    "ImageFeatures", "Imu", "KannalaBrandt", "Keypoints", "Map", "MapSnapshot", "MonocularCamera", "MultiRig", "Odometry", "OrbExtractor", "Pinhole",
    "PlaceRecognition", "PlacedKeyframes", "RadTan", "RectifiedPair", "Rectifier", "RgbdCamera", "RigCamera", "Sequence", "StereoMatcher",
    "StereoMatches", "Stream", "TrackedKeypoints", "Tracking", "Trajectory", "Unified", "__version__", "check_calibration", "devices",
    "evaluate", "read_sequence", "read_tum",
]
