# SPDX-License-Identifier: Apache-2.0
"""Rigs of cameras, and the IMU on them. Lengths are in metres, parameters of cameras in pixels. Where fx, fy, cx, cy stand,
a matrix (3, 3) does, too.

`readout_s` of a rig or RigCamera is for rolling shutters: seconds from the exposure of the first row to that of the last one,
0 to 0.1; 0 = a global shutter. Both cameras of a pair have it. Times of frames are those of the middle row, and so are poses."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Iterable, NamedTuple, Optional, Sequence, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _ft

IDENTITY = np.eye(4)

MODELS = (_ft.Pinhole, _ft.RadTan, _ft.KannalaBrandt, _ft.DoubleSphere, _ft.Unified, _ft.ExtendedUnified, _ft.FieldOfView)
Camera = Union[_ft.Pinhole, _ft.RadTan, _ft.KannalaBrandt, _ft.DoubleSphere, _ft.Unified, _ft.ExtendedUnified,
               _ft.FieldOfView, ArrayLike]


def _matrix(values: ArrayLike, name: str = "the matrix") -> NDArray[np.float64]:
    try:
        return np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise ValueError(f"{name} is no matrix of numbers: {e}") from None


def _two(values: Iterable[int], name: str) -> tuple[int, int]:
    try:
        first, second = values
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {values!r}, must be two numbers") from None
    return first, second


def _values(camera: Camera, name: str = "the camera", models: tuple[type, ...] = (_ft.Pinhole,)) -> list[float]:
    """The parameters of a camera, which is one of some models, a matrix (3, 3), or a sequence of numbers."""
    if isinstance(camera, MODELS) and not isinstance(camera, models):
        allowed = " or ".join(f"ft.{m.__name__}" for m in models)
        raise ValueError(f"{name} is ft.{type(camera).__name__}, must be {allowed}, or its parameters")
    return _ft.camera_values(camera, name)


def _plain(kind: str, left: Sequence[float] = (), right: Sequence[float] = (), wanted: Sequence[float] = (),
           T_right_left: ArrayLike = IDENTITY, baseline: float = 0.0,
           depth: tuple[Optional[float], float, Optional[float]] = (None, 0.0, None), raw: tuple[int, int] = (0, 0),
           cameras: Iterable[dict[str, object]] = (), readout_s: float = 0.0) -> dict[str, object]:
    return {
        "kind": kind, "left": left, "right": right, "wanted": wanted, "T_right_left": _matrix(T_right_left, "T_right_left"),
        "baseline": baseline, "depth_scale": depth[0], "min_depth": depth[1], "max_depth": depth[2],
        "raw_width": raw[0], "raw_height": raw[1], "cameras": list(cameras),
        "readout_s": readout_s,
    }


@dataclass
class RectifiedPair:
    """Two equal pinholes whose rows correspond. `camera`: fx, fy, cx, cy."""

    camera: Camera
    baseline: float
    readout_s: float = 0.0

    def _plain(self) -> dict[str, object]:
        return _plain("rectified", _values(self.camera), baseline=self.baseline, readout_s=self.readout_s)


@dataclass
class DistortedPair:
    """Two cameras with radial-tangential distortion (ft.RadTan, or fx, fy, cx, cy and 0, 4, 5 or 8 of k1, k2, p1, p2, k3
    ...). Their images are rectified before they are searched: to `wanted`, fx, fy, cx, cy of both. `T_right_left` (4, 4)
    maps points of the left camera to the right one. `size` is width and height of the images that come in."""

    left: Camera
    right: Camera
    T_right_left: ArrayLike
    wanted: Camera
    size: tuple[int, int]
    readout_s: float = 0.0

    def _plain(self) -> dict[str, object]:
        models = (_ft.RadTan, _ft.Pinhole)
        return _plain("distorted", _values(self.left, "the left camera", models),
                      _values(self.right, "the right camera", models), _values(self.wanted, "wanted"),
                      self.T_right_left, raw=_two(self.size, "size"), readout_s=self.readout_s)


@dataclass
class FisheyePair:
    """Two Kannala-Brandt cameras (ft.KannalaBrandt, or fx, fy, cx, cy, k1, k2, k3, k4), whose images are searched as they
    are. `T_right_left` (4, 4) maps points of the left camera to the right one."""

    left: Camera
    right: Camera
    T_right_left: ArrayLike
    readout_s: float = 0.0

    def _plain(self) -> dict[str, object]:
        models = (_ft.KannalaBrandt,)
        return _plain("fisheye", _values(self.left, "the left camera", models), _values(self.right, "the right camera", models),
                      T_right_left=self.T_right_left, readout_s=self.readout_s)


@dataclass
class RgbdCamera:
    """A camera (ft.Pinhole, ft.RadTan, or their parameters) with registered depth images, uint16 or float32.
    `depth_scale` is metres per unit: 0.001 for millimetres, 1 / 5000 for TUM's images. uint16 images need one; without it
    those of float32 are in metres. Depths below `min_depth` or above `max_depth`, metres, None = no limit, are none.
    `baseline` is that of the virtual pair that keypoints with depth count as."""

    camera: Camera
    baseline: float = 0.08
    depth_scale: Optional[float] = None
    min_depth: float = 0.0
    max_depth: Optional[float] = None
    readout_s: float = 0.0

    def _plain(self) -> dict[str, object]:
        return _plain("rgbd", _values(self.camera, models=(_ft.Pinhole, _ft.RadTan)), baseline=self.baseline,
                      depth=(self.depth_scale, self.min_depth, self.max_depth), readout_s=self.readout_s)


@dataclass
class MonocularCamera:
    """One camera without any depth: ft.Pinhole (or fx, fy, cx, cy) or ft.KannalaBrandt, pixels. Its map begins when it
    has moved. Nothing tells the scale: `Tracking.metric` is False, and the unit of length is the median depth of the
    first points. With an IMU the map gets metres once the scale is known, `metric` is True from then on."""

    camera: Camera
    readout_s: float = 0.0

    def _plain(self) -> dict[str, object]:
        fisheye = isinstance(self.camera, _ft.KannalaBrandt)
        values = _values(self.camera, models=(_ft.Pinhole, _ft.KannalaBrandt))
        return _plain("monocular_fisheye" if fisheye else "monocular", values, readout_s=self.readout_s)


@dataclass
class RigCamera:
    """A camera of a MultiRig: the left one of a rectified pair or, with a `baseline` of 0, one of its own. `camera`: fx, fy,
    cx, cy, pixels, or ft.Pinhole, ft.RadTan, ft.KannalaBrandt or ft.DoubleSphere. `baseline`: to the right camera of the
    rectified pair, metres; the camera is a pinhole then. `T_camera_body` (4, 4) maps points of the body to the (left) camera.
    `right`: the number of another camera of the rig that sees the same: both are a pair, which is not rectified, and
    `baseline` is 0. `has_depth`: it has depth images as those of RgbdCamera, and is in no pair; `baseline` is that of its virtual
    pair then, 0 = 0.08. Other values raise ValueError where the rig is used."""

    camera: Camera
    baseline: float = 0.0
    T_camera_body: ArrayLike = field(default_factory=lambda: np.eye(4))
    right: Optional[int] = None
    has_depth: bool = False
    readout_s: float = 0.0

    def _plain(self) -> dict[str, object]:
        if self.has_depth and self.right is not None:
            raise ValueError(f"right is {self.right} and has_depth is True: the depths of a camera have one origin")
        baseline = self.baseline or (0.08 if self.has_depth else 0.0)
        if self.right is not None and self.baseline != 0:
            raise ValueError(f"right is {self.right} and baseline is {self.baseline}: a camera is in one pair, rectified "
                             "(baseline) or not (right)")
        models = {_ft.Pinhole: "pinhole", _ft.RadTan: "radtan8", _ft.KannalaBrandt: "kannala_brandt",
                  _ft.DoubleSphere: "double_sphere"}
        return {"model": next((name for m, name in models.items() if isinstance(self.camera, m)), "pinhole"),
                "camera": _values(self.camera, models=tuple(models)), "baseline": baseline,
                "T_camera_body": _matrix(self.T_camera_body, "T_camera_body"), "right": self.right,
                "has_depth": bool(self.has_depth), "readout_s": self.readout_s}


@dataclass
class MultiRig:
    """1 to 16 cameras fixed to a body, in any order, of the models of RigCamera. At least one has a `baseline` or
    depth images, or two are a pair by `right`. One map and one pose, that of the body, come from all of them. `cameras`: a list of RigCamera. A frame has
    an image for each camera, and behind it the right image of each with a baseline, the depth image of each with `has_depth`, in the
    order of `cameras`. `depth_scale`, `min_depth` and `max_depth` are those of RgbdCamera, of all depth images. A single camera
    makes no points: it finds those of the others. Memory is taken for 4 cameras; for 16 from the fifth on, for other models than
    pinholes, and for pairs by `right` and depth images."""

    cameras: list[RigCamera]
    depth_scale: Optional[float] = None
    min_depth: float = 0.0
    max_depth: Optional[float] = None

    def _plain(self) -> dict[str, object]:
        for i, camera in enumerate(self.cameras):
            if not isinstance(camera, RigCamera):
                raise ValueError(f"cameras[{i}] is {type(camera).__name__}, must be ft.RigCamera")
        return _plain("multi", depth=(self.depth_scale, self.min_depth, self.max_depth),
                      cameras=[c._plain() for c in self.cameras])


Rig = Union[RectifiedPair, DistortedPair, FisheyePair, RgbdCamera, MonocularCamera, MultiRig]


class CalibrationWarning(NamedTuple):
    """A word, such as "principal_point", and a sentence that has the numbers."""

    name: str
    text: str


def check_calibration(rig: Rig, width: int, height: int) -> list[CalibrationWarning]:
    """Signs that a calibration is another camera's, another size's or in other units, a list of CalibrationWarning: wrong
    calibrations are tracked without an error, and wrongly. Empty for an ordinary one. width, height: of the images that
    are searched, pixels. ft.Odometry warns of these. Raises ValueError for what is no rig, and for sizes out of range."""
    return [CalibrationWarning(*found) for found in _ft.check_calibration(rig, width, height)]


@dataclass
class Imu:
    """An IMU. `T_imu_camera` (4, 4) maps points of the left camera to the IMU. Densities: rad/s/sqrt(Hz),
    m/s^2/sqrt(Hz), and of the biases' walks rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz). time_offset_s: its clock less that of the
    images, -10 to 10 s, as Kalibr's timeshift_cam_imu; Odometry corrects it where the camera turns enough."""

    T_imu_camera: ArrayLike = field(default_factory=lambda: np.eye(4))
    gyro_noise: float = 1.7e-4
    accel_noise: float = 2e-3
    gyro_walk: float = 2e-5
    accel_walk: float = 3e-3
    rate_hz: float = 200.0
    time_offset_s: float = 0.0

    def __post_init__(self) -> None:
        self.T_imu_camera = _matrix(self.T_imu_camera, "T_imu_camera")
