# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag with images, and the calibration that their camera_info and the static transforms are."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from . import bag_images
from .bag_frames import Frames, Motion, pair_of_info, write_chain
from .unpacking import Unpacked

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

INFO_TYPE = "sensor_msgs/msg/CameraInfo"


class CameraInfo(Protocol):
    """sensor_msgs/msg/CameraInfo as far as it is used; ROS 1 calls its matrices K, D, R and P."""

    width: int
    height: int
    distortion_model: str


@dataclass
class Stream:
    """A topic with images, and what its first message and its camera_info say."""

    connections: list[Connection]
    first: bag_images.Message
    info_topic: str = ""
    info: CameraInfo | None = None

    @property
    def topic(self) -> str:
        return self.connections[0].topic

    @property
    def depth(self) -> bool:
        return bag_images.is_depth(self.first, self.topic)

    @property
    def frame(self) -> str:
        return str(self.first.header.frame_id)

    @property
    def rectified(self) -> bool:
        return re.search(r"(^|[/_])rect", self.topic) is not None

    def right_of_pair(self) -> bool:
        return self.info is not None and matrix(self.info, "p")[3] != 0

    def named(self) -> str:
        return f"{self.topic} ({bag_images.encoding_of(self.first)})"


def matrix(info: CameraInfo, name: str) -> list[float]:
    values = getattr(info, name, None)
    return [float(v) for v in (getattr(info, name.upper()) if values is None else values)]


def info_values(stream: Stream) -> tuple[list[float], list[float], list[float], list[float], str]:
    """K, D, R, P and the model of the images: those of rectified ones are P, without distortion."""
    info = stream.info
    assert info is not None
    k, d, r, p = (matrix(info, name) for name in "kdrp")
    if stream.rectified and p[0] > 0:
        return [*p[0:3], *p[4:7], *p[8:11]], [0.0] * 4, [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0], p, "plumb_bob"
    if not any(r):
        r = [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]
    return k, d or [0.0] * 4, r, p, str(info.distortion_model) or "plumb_bob"


def write_info(file: Path, stream: Stream) -> None:
    """As camera_calibration_parsers writes it."""
    assert stream.info is not None
    k, d, r, p, model = info_values(stream)
    lines = [f"image_width: {stream.info.width}", f"image_height: {stream.info.height}", f"distortion_model: {model}"]
    for name, rows, values in (("camera_matrix", 3, k), ("distortion_coefficients", 1, d), ("rectification_matrix", 3, r),
                               ("projection_matrix", 3, p)):
        lines.append(f"{name}: {{rows: {rows}, cols: {len(values) // rows}, data: [{', '.join(map(repr, values))}]}}")
    file.write_text("\n".join(lines) + "\n")


def write_camera_txt(file: Path, stream: Stream) -> None:
    k, d, _, _, model = info_values(stream)
    if model not in ("plumb_bob", "rational_polynomial"):
        raise RuntimeError(f"{stream.info_topic}: distortion model {model} of a camera with depth images, must be plumb_bob or "
                           "rational_polynomial")
    numbers = [k[0], k[4], k[2], k[5], *(d if any(d) else [])]
    file.write_text("# depth in units of 1 mm\n" + " ".join(map(repr, numbers)) + "\n")


@dataclass
class ChainCamera:
    """Of the images of a topic, for Kalibr's chain."""

    width: int
    height: int
    model: str
    k: list[float]
    d: list[float]


def chain_camera(stream: Stream) -> ChainCamera:
    assert stream.info is not None
    k, d, _, _, model = info_values(stream)
    return ChainCamera(int(stream.info.width), int(stream.info.height), model, k, d)


def turned(stream: Stream, T_camera_other: Motion) -> Motion:
    """What maps to the images' camera: rectified ones are turned by R of camera_info."""
    T = np.eye(4)
    if stream.rectified and stream.info is not None and any(matrix(stream.info, "r")):
        T[:3, :3] = np.reshape(matrix(stream.info, "r"), (3, 3))
    return np.asarray(T @ T_camera_other)


def why_not_joined(left: Stream, right: Stream, frames: Frames) -> str:
    if not left.frame or not right.frame:
        return "images that name no frame have no place in /tf_static"
    if left.frame.lstrip("/") == right.frame.lstrip("/"):
        return f"the images of both cameras have the same frame '{left.frame}'"
    if frames.find(right.frame, left.frame) is not None:
        return f"/tf_static has the frames '{left.frame}' and '{right.frame}' at one point"
    return f"/tf_static does not join the frames '{left.frame}' and '{right.frame}'"


def write_calibration(made: Unpacked, chosen: list[Stream], frames: Frames, imu_frame: str) -> bool:
    """Of the camera_info of the chosen topics, where all have one of their own; what they do not say of the places of cameras
    and the IMU is that of /tf_static. Returns whether the place of the IMU is in it."""
    used = chosen[:1] if len(chosen) > 1 and chosen[1].depth else chosen
    without = [s.topic for s in used if s.info is None]
    if without:
        made.missing = (f"the bag has no {INFO_TYPE} beside {' and '.join(without)}: --calibration (calibration) names a file with "
                        "focal lengths, centre and distortion")
    elif len({s.info_topic for s in used}) < len(used):
        made.missing = f"{used[0].info_topic} is of one camera, and there are two: --calibration (calibration) names a file of both"
    if made.missing:
        return False
    made.calibration = " and ".join(s.info_topic for s in used)
    for name in ("camera.txt", "camera.yaml", "left.yaml", "right.yaml", "camchain-imucam.yaml"):
        made.parts[name] = f"{made.source}: {made.calibration}"
    if used is not chosen and len(chosen) == 2:
        write_camera_txt(made.folder / "camera.txt", used[0])
        return False
    left, right = chosen[0], chosen[-1]
    T_left_imu = frames.find(left.frame, imu_frame) if imu_frame else None
    T_right_left = None
    if len(chosen) == 2 and right.right_of_pair():
        _, _, r, _, _ = info_values(left)
        _, _, r_right, p, _ = info_values(right)
        T_right_left = pair_of_info(r, r_right, p)
    elif len(chosen) == 2 and (between := frames.find(right.frame, left.frame)) is not None and between[:3, 3].any():
        T_right_left = turned(right, between) @ np.linalg.inv(turned(left, np.eye(4)))
    placed = len(chosen) == 1 or T_right_left is not None
    if placed and (T_left_imu is not None or (len(chosen) == 2 and not right.right_of_pair())):
        write_chain(made.folder / "camchain-imucam.yaml", map(chain_camera, chosen), [] if T_right_left is None else [T_right_left],
                    None if T_left_imu is None else turned(left, T_left_imu))
        made.calibration += " and /tf_static"
        made.warnings += frames.warnings
        return T_left_imu is not None
    if not placed:
        raise RuntimeError(f"{made.source}: P of {right.info_topic} has no baseline, and {why_not_joined(left, right, frames)}: "
                           "where is the right camera? A calibration (calibration, --calibration) says it; topics (--topics) "
                           "names one camera to be taken alone")
    if len(chosen) == 2:
        write_info(made.folder / "left.yaml", left)
        write_info(made.folder / "right.yaml", right)
    else:
        write_info(made.folder / "camera.yaml", left)
    return False
