# SPDX-License-Identifier: Apache-2.0
"""Where the cameras and the IMU of a bag are: its transforms, and the calibration written with them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Iterable, Iterator, Optional, Protocol

import numpy as np
from numpy.typing import NDArray

from .rigs import Imu

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
Motion = NDArray[np.float64]


class Quaternion(Protocol):
    x: float
    y: float
    z: float
    w: float


def rotation(q: Quaternion) -> Motion:
    """(3, 3); of a quaternion of any length but 0, which gives NaN."""
    w, x, y, z = np.array([q.w, q.x, q.y, q.z]) / np.sqrt(q.w**2 + q.x**2 + q.y**2 + q.z**2)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


class Frames:
    """The tree of /tf_static: frames by name, joined by motions."""

    def __init__(self) -> None:
        self._to: dict[str, dict[str, Motion]] = {}  # [a][b] maps points of b to a
        self.warnings: list[str] = []

    def add(self, parent: str, child: str, T_parent_child: Motion) -> None:
        """Warns where the frames are joined already, by another motion: of 1 mm or 1 mrad. The later one is taken."""
        before = self._to.get(parent, {}).get(child)
        if before is not None and np.array_equal(before, T_parent_child):
            return  # static transforms are sent again and again
        before = self.find(parent, child)
        if before is not None and np.abs(before - T_parent_child).max() > 1e-3:
            warning = f"/tf_static places '{child}' in '{parent}' in two ways that disagree, the later one is taken"
            if warning not in self.warnings:
                self.warnings.append(warning)
        self._to.setdefault(parent, {})[child] = T_parent_child
        self._to.setdefault(child, {})[parent] = np.linalg.inv(T_parent_child).astype(np.float64)

    def find(self, to: str, source: str) -> Optional[Motion]:
        """(4, 4) that maps points of the frame `source` to the frame `to`; None where nothing joins them, or a name
        is empty."""
        to, source = to.lstrip("/"), source.lstrip("/")
        if not to or not source:
            return None
        found = {to: np.eye(4)}
        ahead = [to]
        for frame in ahead:  # grows
            for other, T in self._to.get(frame, {}).items():
                if other not in found:
                    found[other] = found[frame] @ T
                    ahead.append(other)
        return found.get(source)


def transforms_of(reader: AnyReader, topic: str) -> Iterator[tuple[str, str, Motion]]:
    """Parent, child and T_parent_child; those with numbers that are none are left out."""
    connections = [c for c in reader.connections if c.msgtype in TF_TYPES and c.topic.split("/")[-1] == topic]
    for connection, _, raw in reader.messages(connections=connections) if connections else ():
        for one in reader.deserialize(raw, connection.msgtype).transforms:  # type: ignore[attr-defined]
            T = np.eye(4)
            with np.errstate(all="ignore"):
                T[:3, :3] = rotation(one.transform.rotation)
            t = one.transform.translation
            T[:3, 3] = [t.x, t.y, t.z]
            if np.isfinite(T).all():
                yield str(one.header.frame_id).lstrip("/"), str(one.child_frame_id).lstrip("/"), T


def read_frames(reader: AnyReader, moving: bool = False) -> Frames:
    """Those of /tf_static. moving: also those of /tf that stay as they are, where /tf_static does not join the frames."""
    frames = Frames()
    for parent, child, T in transforms_of(reader, "tf_static"):
        frames.add(parent, child, T)
    still: dict[tuple[str, str], Optional[Motion]] = {}
    for parent, child, T in transforms_of(reader, "tf") if moving else ():
        before = still.setdefault((parent, child), T)
        if before is not None and np.abs(before - T).max() > 1e-6:
            still[parent, child] = None
    for (parent, child), stays in still.items():
        if stays is not None and frames.find(parent, child) is None:
            frames.add(parent, child, stays)
    return frames


def pair_of_info(r_left: list[float], r_right: list[float], p_right: list[float]) -> Motion:
    """T_right_left of images as they were taken: R of camera_info turns a camera to its rectified one, whose P has the
    baseline."""
    left, right = np.reshape(r_left, (3, 3)), np.reshape(r_right, (3, 3))
    T = np.eye(4)
    T[:3, :3] = right.T @ left
    T[:3, 3] = right.T @ [p_right[3] / p_right[0], p_right[7] / p_right[5], 0.0]
    return T


class Camera(Protocol):
    """What write_chain needs of one: matrices of camera_info, row by row."""

    width: int
    height: int
    model: str
    k: list[float]
    d: list[float]


def write_chain(file: Path, cameras: Iterable[Camera], T_next_camera: list[Motion], T_left_imu: Optional[Motion]) -> None:
    """Kalibr's chain. T_next_camera: of each camera but the last."""
    def rows(T: Motion) -> str:
        return "[" + ", ".join("[" + ", ".join(map(repr, map(float, row))) + "]" for row in T) + "]"

    lines = []
    for i, camera in enumerate(cameras):
        k = camera.k
        lines += [f"cam{i}:", "  camera_model: pinhole", f"  intrinsics: [{k[0]!r}, {k[4]!r}, {k[2]!r}, {k[5]!r}]",
                  f"  distortion_model: {camera.model}", f"  distortion_coeffs: [{', '.join(map(repr, camera.d))}]",
                  f"  resolution: [{camera.width}, {camera.height}]"]
        if i == 0 and T_left_imu is not None:
            lines.append(f"  T_cam_imu: {rows(T_left_imu)}")
        if i > 0:
            lines.append(f"  T_cn_cnm1: {rows(T_next_camera[i - 1])}")
    file.write_text("\n".join(lines) + "\n")


def write_assumed_imu(file: Path, times_ns: list[int]) -> str:
    """Kalibr's imu.yaml with the noise that ft.Imu has, and the rate of the samples. Returns a warning."""
    imu = Imu()
    steps = np.diff(np.sort(np.array(times_ns, np.int64)))
    step_ns = float(np.median(steps)) if len(steps) else 0.0
    rate = 1e9 / step_ns if step_ns > 0 else imu.rate_hz
    file.write_text(f"gyroscope_noise_density: {imu.gyro_noise}\naccelerometer_noise_density: {imu.accel_noise}\n"
                    f"gyroscope_random_walk: {imu.gyro_walk}\naccelerometer_random_walk: {imu.accel_walk}\n"
                    f"update_rate: {min(max(rate, 1.0), 2e4):.3f}\n")
    return (f"a bag does not say the noise of its IMU: assumed are {imu.gyro_noise} rad/s/sqrt(Hz) and {imu.accel_noise} "
            "m/s^2/sqrt(Hz); calibration (--calibration) with Kalibr's chain and its imu.yaml says it")
