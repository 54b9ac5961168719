# SPDX-License-Identifier: Apache-2.0
"""Recorded sequences, trajectories and their errors."""

from __future__ import annotations

import operator
import os
import warnings
from dataclasses import dataclass
from typing import Callable, Iterable, Iterator, Optional, SupportsIndex, TypedDict, Union, cast
from typing import Sequence as Items

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _ft
from .rigs import FisheyePair, Imu, MonocularCamera, MultiRig, RectifiedPair, RgbdCamera, RigCamera, _matrix
from .unpacking import Unpacked, Wanted, unpacked

Path = Union[str, os.PathLike[str]]


class Settings(TypedDict, total=False):
    """What a settings file says of ft.Odometry's arguments."""

    features: int
    levels: int
    scale_factor: float
    ini_threshold: int
    min_threshold: int
    near_depth: float


class Errors(TypedDict):
    """See evaluate."""

    pairs: int
    path_m: float
    ate_m: Optional[float]
    rpe_m: Optional[float]
    ate_deg: Optional[float]
    ate_rotation_missing: Optional[str]
    rpe_deg: Optional[float]
    scale: Optional[float]
    T_truth_estimate: NDArray[np.float64]


class _FileCamera(TypedDict):
    model: str
    camera: list[float]
    T_camera_body: NDArray[np.float64]
    readout_s: float
    right: Optional[int]
    has_depth: bool


class _FileRig(TypedDict):
    kind: str
    fisheye: bool
    left: list[float]
    right: list[float]
    T_right_left: NDArray[np.float64]
    baseline: float
    readout_s: float
    depth_unit: float
    width: int
    height: int
    cameras: list[_FileCamera]


class _FileImu(TypedDict):
    T_imu_camera: NDArray[np.float64]
    gyro_noise: float
    accel_noise: float
    gyro_walk: float
    accel_walk: float
    rate_hz: float
    time_offset_s: float
    time_ns: NDArray[np.int64]
    accel: NDArray[np.float64]
    gyro: NDArray[np.float64]


@dataclass
class Frame:
    """Images taken at time_ns, a tuple in the order of ft.Odometry.track: left and right of a pair, those of
    a rig's cameras, depth images behind their camera's, the one of a single camera, or that and its depth image; (height, width) uint8, depth uint16. None where a camera of a
    MultiRig has none. masks: of its cameras, as ft.Odometry.set_masks takes them; () without read_sequence(masks=...)."""

    time_ns: int
    images: tuple[Optional[NDArray[np.uint8]], ...]
    masks: tuple[Optional[NDArray[np.uint8]], ...] = ()

    @property
    def left(self) -> NDArray[np.uint8]:
        """That of the left camera, or of the only one."""
        return cast("NDArray[np.uint8]", self.images[0])

    @property
    def right(self) -> NDArray[np.uint8]:
        """That of the right camera; of a pair."""
        return cast("NDArray[np.uint8]", self.images[1])


def _times(values: ArrayLike) -> NDArray[np.int64]:
    """Times as int64. What is no integer would be cut, so it is refused."""
    times = np.asarray(values)
    if times.size == 0:
        return np.zeros(0, np.int64)
    if times.ndim != 1:
        raise ValueError(f"the times have shape {times.shape}, must have (n,)")
    if times.dtype.kind not in "iu":
        raise ValueError(f"the times are {times.dtype}, must be int, nanoseconds: round(1e9 * seconds)")
    if times.max() > np.iinfo(np.int64).max:
        raise ValueError(f"the times go to {times.max()}, must be at most {np.iinfo(np.int64).max} nanoseconds")
    return times.astype(np.int64, copy=False)


@dataclass
class Trajectory:
    """Times (n), int nanoseconds, and poses (n, 4, 4): T_world_camera; n may be 0. has_orientation: whether rotations are
    known, not those of positions alone. Raises ValueError for other shapes and types."""

    time_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    has_orientation: bool = True

    def __post_init__(self) -> None:
        self.time_ns = _times(self.time_ns)
        poses, n = _matrix(self.poses, "the poses"), len(self.time_ns)
        if poses.shape != (n, 4, 4) and not poses.size == n == 0:
            raise ValueError(f"the poses have shape {poses.shape}, must have ({n}, 4, 4): one for each time")
        self.poses = poses.reshape(n, 4, 4)

    @classmethod
    def of(cls, poses: Union[Trajectory, Iterable[tuple[int, ArrayLike]]]) -> Trajectory:
        """A Trajectory, or a sequence of pairs of a time and a (4, 4) matrix."""
        if isinstance(poses, cls):
            return poses
        try:
            pairs = [(t, T) for t, T in cast(Iterable[tuple[int, ArrayLike]], poses)]
        except (TypeError, ValueError):
            raise ValueError("the trajectory must be an ft.Trajectory, or pairs of a time and a matrix (4, 4)") from None
        return cls(_times([t for t, _ in pairs]), _matrix(cast(ArrayLike, [T for _, T in pairs]), "the poses"))

    def __len__(self) -> int:
        return len(self.time_ns)

    def write_tum(self, file: Path) -> None:
        """time tx ty tz qx qy qz qw, a line a pose."""
        _ft.write_tum(str(file), self.time_ns, _matrix(self.poses, "the poses"))

    def write_kitti(self, file: Path) -> None:
        """12 numbers a pose."""
        _ft.write_kitti(str(file), self.time_ns, _matrix(self.poses, "the poses"))

    def write_euroc(self, file: Path) -> None:
        """timestamp [ns], position, quaternion (w x y z), as in EuRoC's data.csv, with a heading."""
        self.write_tum(file)
        columns = [1, 2, 3, 7, 4, 5, 6]
        rows = np.loadtxt(file, ndmin=2)[:, columns] if len(self) else np.zeros((0, 7))
        with open(file, "w") as out:
            out.write("#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w,q_x,q_y,q_z\n")
            for time_ns, row in zip(self.time_ns, rows):
                out.write(",".join([str(int(time_ns)), *(f"{value:.9f}" for value in row)]) + "\n")


class Sequence:
    """Frames on disk, decoded when they are asked for; of fisheye cameras and of a MultiRig as they are, of others
    rectified. rig: what ft.Odometry takes; of read_sequence(rig="mixed") a MultiRig. ground_truth: a Trajectory, which is empty,
    and false, where there is none. depth_unit: metres per unit of depth images; 0 without. masked: whether frames have masks. warnings: what was left out or looks wrong, a sentence each. files: that of the
    extension."""

    def __init__(self, files: _ft.SequenceFiles, min_depth: float = 0.0, max_depth: Optional[float] = None,
                 recording: Optional[Unpacked] = None) -> None:
        self.files = files
        self._recording = recording  # an Unpacked, whose folder goes with it
        rig = cast(_FileRig, files.rig)
        self.baseline, self.kind = rig["baseline"], rig["kind"]
        self.width, self.height, self.depth_unit = rig["width"], rig["height"], rig["depth_unit"]
        self.rig: Union[MonocularCamera, RgbdCamera, FisheyePair, RectifiedPair, MultiRig]
        left: Union[_ft.KannalaBrandt, _ft.Pinhole, _ft.RadTan, _ft.DoubleSphere]
        left = _ft.KannalaBrandt(rig["left"]) if rig["fisheye"] else _ft.Pinhole(rig["left"][:4])
        if rig["cameras"]:
            cameras = [getattr(_ft, c["model"])(c["camera"]) for c in rig["cameras"]]
            left = cameras[0]
            self.rig = MultiRig([RigCamera(camera, 0.0, c["T_camera_body"], c["right"], c["has_depth"],
                                           c["readout_s"])
                                 for camera, c in zip(cameras, rig["cameras"])], rig["depth_unit"] or None, min_depth, max_depth)
        elif self.kind == "mono":
            self.rig = MonocularCamera(left, rig["readout_s"])
        elif self.kind == "rgbd":
            self.rig = RgbdCamera(left, rig["baseline"], rig["depth_unit"], min_depth, max_depth, rig["readout_s"])
        elif rig["fisheye"]:
            self.rig = FisheyePair(rig["left"], rig["right"], rig["T_right_left"], rig["readout_s"])
        else:
            self.rig = RectifiedPair(left, rig["baseline"], rig["readout_s"])
        self.left_camera = left
        self.warnings = list(files.warnings)
        self.name, self.layout, self.settings = files.name, files.layout, cast(Settings, files.settings)
        if recording is not None:
            self.layout = recording.layout
            self.warnings = [*recording.warnings, *map(recording.named, self.warnings)]
        self.has_body_frame = files.has_body_frame
        self.masked = files.masked
        self.ground_truth_has_orientation = files.ground_truth_has_orientation
        self.ground_truth = Trajectory(*files.ground_truth, has_orientation=files.ground_truth_has_orientation)
        samples = cast(Optional[_FileImu], files.imu)
        self.imu: Optional[Imu] = None
        self.imu_samples: list[tuple[int, NDArray[np.float64], NDArray[np.float64]]] = []
        if samples is not None:
            self.imu_samples = list(zip(samples["time_ns"].tolist(), samples["accel"], samples["gyro"]))
            self.imu = Imu(samples["T_imu_camera"], samples["gyro_noise"], samples["accel_noise"], samples["gyro_walk"],
                           samples["accel_walk"], samples["rate_hz"], samples["time_offset_s"])

    def describe(self, imu: bool = True) -> list[tuple[str, str]]:
        """What was found, lines as (name, text): layout and calibration, cameras, rate and length, IMU, ground truth, and
        images left out. imu: whether it was asked for."""
        lines = self.files.describe(bool(imu))
        return lines if self._recording is None else self._recording.described(lines)

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, i: SupportsIndex) -> Frame:
        k, n = operator.index(i), len(self)
        if not -n <= k < n:
            raise IndexError(f"frame {k} of {n}")
        try:
            return Frame(*self.files.load(k % n))
        except RuntimeError as e:
            raise RuntimeError(str(e) if self._recording is None else self._recording.named(str(e))) from None

    def __iter__(self) -> Iterator[Frame]:
        return (self[i] for i in range(len(self)))


def read_sequence(folder: Union[Path, Items[Path]], *, calibration: Path = "", keep_fisheye: bool = True,
                  max_frames: int = 0, imu: bool = False, rig: str = "auto", depth_unit: Optional[float] = None,
                  min_depth: float = 0.0, max_depth: Optional[float] = None,
                  max_time_difference_ns: Optional[int] = None, fps: Optional[float] = None, times: Path = "",
                  topics: Union[str, Items[str]] = (), image_bits: Optional[int] = None, masks: Items[Path] = (),
                  progress: Optional[Callable[[int], None]] = None) -> Sequence:
    """Opens a recording. It is a folder in EuRoC (ASL), KITTI odometry or KITTI raw layout, with two cameras or one, or in that of TUM
    RGB-D, ICL-NUIM, OpenLORIS or 7-Scenes, or plain folders of images: left and right (cam0 and cam1, image_0 and image_1), or one. Or it is a bag (.bag,
    .mcap, .db3, the folder of a ROS 2 bag; package rosbags), a video or a list of two (package opencv-python), or images
    of one camera, as a list or a pattern such as "images/*.png". A folder with videos and no images is opened as its videos
    left and right, or as the only one. Bags and videos are unpacked to a folder for temporary
    files, which is removed with the sequence.

    calibration: a file or folder in place of the sequence's own: Kalibr's chain, OpenCV's YAML or XML of a pair, ROS
    camera_info (left.yaml beside right.yaml), basalt's JSON, what rs-enumerate-devices -c prints,
    DepthAI's JSON (eepromToJsonFile), COLMAP's cameras.txt, ORB-SLAM3 settings, KITTI's calib.txt, a camera.txt; a bag has
    its camera_info. The calibration of a video is the one beside it; that of a single video is of one camera. fps, times: of plain folders, and fps of 7-Scenes and ICL-NUIM, images a second, or a file with a time a line; None and "" = the file
    names or times.txt say them. topics: of a bag, one with images, left and right, or colour and depth; empty = found by
    type and name. masks: of each camera in turn (left, right, cam2 ...) an image that is 0 where no keypoints are wanted, or
    a folder with one for each frame that has the name of the camera's image, of the size of the images on disk; "" = none; Frame.masks
    has them, rectified as the images. image_bits: 8 to 16, that hold the samples of grey PNG and TIFF of 16 bits; None = 16, with a
    warning where up to eight images of each camera need 14 or fewer. progress: called with the number of frames while a bag or video is unpacked. max_frames: 0 = all. imu:
    also reads mav0/imu0, imu0 or imu.csv, or a bag's sensor_msgs/Imu, if the calibration says where it is (Kalibr's
    chain). rig: auto (what the folder holds), stereo, mono (the left camera alone), rgbd, or mixed: a pair and all cameras beside it (cam2 ..., of
    EuRoC's layout or of folders with Kalibr's chain; those of a bag), as they are: pinhole, radtan, Kannala-Brandt or double sphere; auto and stereo take the pair
    alone.
    depth_unit: metres per unit of depth images; None = as the calibration says, else 0.001 of OpenLORIS and 7-Scenes, else 1/5000. min_depth, max_depth: those of ft.RgbdCamera. max_time_difference_ns: how far the
    stamps of a frame's images may be apart; None = 1 ms for a pair, 20 ms for depth images. Warns of what was left out or
    looks wrong. Raises RuntimeError that names the file and what is wrong; ValueError for arguments out of range."""
    options = {
        "calibration": str(calibration), "keep_fisheye": bool(keep_fisheye), "max_frames": max_frames, "imu": bool(imu),
        "rig": str(rig), "depth_unit": depth_unit, "max_time_difference_ns": max_time_difference_ns,
        "fps": fps, "times": str(times),
        "image_bits": image_bits, "masks": [str(mask) for mask in ([masks] if isinstance(masks, (str, os.PathLike)) else masks)],
    }
    if not isinstance(max_frames, (int, np.integer)) or not 0 <= max_frames < 2**31:
        raise ValueError(f"max_frames is {max_frames!r}, must be a whole number from 0 to {2**31 - 1}")
    frames = int(max_frames)
    recording = unpacked(folder, Wanted(str(rig), frames, (topics,) if isinstance(topics, str) else tuple(topics), str(calibration),
                                        progress or (lambda images: None), bool(imu)))
    if recording is not None and (fps is not None or str(times)):
        recording.stamps = ""  # not the recording's own
    if recording is not None and depth_unit is None:
        options["depth_unit"] = recording.depth_unit
    if recording is None:
        first = folder[0] if isinstance(folder, (list, tuple)) else folder
        sequence = Sequence(_ft.SequenceFiles.open(str(first), options), min_depth, max_depth)
    else:
        try:
            sequence = Sequence(_ft.SequenceFiles.open(str(recording.folder), options), min_depth, max_depth, recording)
        except RuntimeError as e:
            raise RuntimeError(recording.named(str(e))) from None
    for text in sequence.warnings:
        warnings.warn(text, stacklevel=2)
    return sequence


def read_tum(file: Path) -> Trajectory:
    """A Trajectory from a file in TUM format."""
    return Trajectory(*_ft.read_tum(str(file)))


def evaluate(poses: Union[Trajectory, Iterable[tuple[int, ArrayLike]]],
             truth: Union[Trajectory, Iterable[tuple[int, ArrayLike]], None], *, orientation: Optional[bool] = None,
             interval_s: float = 1.0) -> Errors:
    """Errors of a trajectory: ate_m after alignment, rpe_m over interval_s, and their rotations ate_deg, rpe_deg; None
    where there is too little. ate_rotation_missing: a str, why ate_deg is None though orientations are known, such as an
    alignment that the path does not determine; else None. scale: what lengths of the poses times it would fit the ground truth
    best, not applied; far from 1 the unit of a baseline or of depths is another one; None where the shapes differ. orientation:
    whether the ground truth has orientations; default: its has_orientation. Raises ValueError without a ground truth."""
    if truth is None:
        raise ValueError("the ground truth is None: errors need one, and not every sequence has one")
    a, b = Trajectory.of(poses), Trajectory.of(truth)
    return cast(Errors, _ft.evaluate_arrays(a.time_ns, _matrix(a.poses), b.time_ns, _matrix(b.poses),
                                            b.has_orientation if orientation is None else bool(orientation), interval_s))
