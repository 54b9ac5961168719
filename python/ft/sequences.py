# SPDX-License-Identifier: Apache-2.0
"""Recorded sequences, trajectories and their errors."""

from dataclasses import dataclass

import numpy as np

from . import _ft
from .rigs import FisheyePair, Imu, RectifiedPair, _matrix


@dataclass
class Frame:
    """A stereo pair: images (height, width) uint8, taken at time_ns."""

    time_ns: int
    left: np.ndarray
    right: np.ndarray


def _times(values):
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
    """Times (n), int nanoseconds, and poses (n, 4, 4): T_world_camera; n may be 0. Raises ValueError for other shapes and
    types."""

    time_ns: np.ndarray
    poses: np.ndarray

    def __post_init__(self):
        self.time_ns = _times(self.time_ns)
        poses, n = _matrix(self.poses, "the poses"), len(self.time_ns)
        if poses.shape != (n, 4, 4) and not poses.size == n == 0:
            raise ValueError(f"the poses have shape {poses.shape}, must have ({n}, 4, 4): one for each time")
        self.poses = poses.reshape(n, 4, 4)

    @classmethod
    def of(cls, poses):
        """A Trajectory, or a sequence of pairs of a time and a (4, 4) matrix."""
        if isinstance(poses, cls):
            return poses
        try:
            pairs = [(t, T) for t, T in poses]
        except (TypeError, ValueError):
            raise ValueError("the trajectory must be an ft.Trajectory, or pairs of a time and a matrix (4, 4)") from None
        return cls([t for t, _ in pairs], [T for _, T in pairs])

    def __len__(self):
        return len(self.time_ns)

    def write_tum(self, file):
        """time tx ty tz qx qy qz qw, a line a pose."""
        _ft.write_tum(str(file), self.time_ns, _matrix(self.poses, "the poses"))

    def write_kitti(self, file):
        """12 numbers a pose."""
        _ft.write_kitti(str(file), self.time_ns, _matrix(self.poses, "the poses"))

    def write_euroc(self, file):
        """timestamp [ns], position, quaternion (w x y z), as in EuRoC's data.csv, with a heading."""
        self.write_tum(file)
        rows = np.loadtxt(file, ndmin=2)[:, [1, 2, 3, 7, 4, 5, 6]] if len(self) else []
        with open(file, "w") as out:
            out.write("#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w,q_x,q_y,q_z\n")
            for time_ns, row in zip(self.time_ns, rows):
                out.write(",".join([str(int(time_ns)), *(f"{value:.9f}" for value in row)]) + "\n")


class Sequence:
    """Frames on disk, decoded when they are asked for; fisheye pairs as they are, others rectified. ground_truth is a
    Trajectory, which is empty, and false, where there is none."""

    def __init__(self, files):
        self.files = files  # of the extension
        rig = files.rig
        self.baseline = rig["baseline"]
        self.width, self.height = rig["width"], rig["height"]
        if rig["kind"] == "fisheye":
            self.rig = FisheyePair(rig["left"], rig["right"], rig["T_right_left"])
        else:
            self.rig = RectifiedPair(rig["left"][:4], rig["baseline"])
        self.name, self.layout, self.settings, self.has_body_frame = files.name, files.layout, files.settings, files.has_body_frame
        self.ground_truth = Trajectory(*files.ground_truth)
        self.ground_truth_has_orientation = files.ground_truth_has_orientation
        samples = files.imu
        self.imu = None
        self.imu_samples = []
        if samples is not None:
            self.imu_samples = list(zip(samples.pop("time_ns").tolist(), samples.pop("accel"), samples.pop("gyro")))
            self.imu = Imu(**samples)

    def __len__(self):
        return len(self.files)

    def __getitem__(self, i):
        return Frame(*self.files.load(i))

    def __iter__(self):
        return (self[i] for i in range(len(self)))


def read_sequence(folder, *, calibration="", keep_fisheye=True, max_frames=0, imu=False):
    """Opens a folder in EuRoC (ASL) or KITTI odometry layout. calibration: a file or folder in place of the sequence's
    own. max_frames: 0 = all. imu: also reads mav0/imu0. Raises RuntimeError that names the file and what is wrong."""
    return Sequence(_ft.SequenceFiles.open(str(folder), str(calibration), keep_fisheye, max_frames, imu))


def read_tum(file):
    """A Trajectory from a file in TUM format."""
    return Trajectory(*_ft.read_tum(str(file)))


def evaluate(poses, truth, *, orientation=True, interval_s=1.0):
    """Errors of a trajectory: ate_m after alignment, rpe_m over interval_s, and their rotations in degrees; None where
    there is too little. orientation: whether the ground truth has orientations. Raises ValueError without a ground
    truth."""
    if truth is None:
        raise ValueError("the ground truth is None: errors need one, and not every sequence has one")
    a, b = Trajectory.of(poses), Trajectory.of(truth)
    return _ft.evaluate_arrays(a.time_ns, _matrix(a.poses), b.time_ns, _matrix(b.poses), orientation, interval_s)
