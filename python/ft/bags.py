# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 1 and 2, read by the package rosbags: which of their topics are a rig, and their calibration."""

from __future__ import annotations

import re
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TextIO

import numpy as np

from . import bag_images
from .bag_frames import Frames, Motion, pair_of_info, read_frames, write_assumed_imu, write_chain
from .unpacking import BAGS, Unpacked, Wanted, begin

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO_TYPE = "sensor_msgs/msg/CameraInfo"
IMU_TYPE = "sensor_msgs/msg/Imu"
TRUTH_TYPES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Odometry",
               "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PointStamped")
PAIRS = (("left", "right"), ("cam0", "cam1"), ("camera0", "camera1"), ("cam_0", "cam_1"), ("camera_0", "camera_1"),
         ("infra1", "infra2"), ("image_0", "image_1"), ("fisheye1", "fisheye2"), ("cam1", "cam2"), ("camera1", "camera2"))


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


def open_reader(path: Path, stack: ExitStack) -> AnyReader:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise RuntimeError(f"{path}: bags are read by the package rosbags, which is not installed: python -m pip install "
                           "rosbags") from None
    if not path.exists():
        raise RuntimeError(f"{path}: no such file or folder")
    try:
        return stack.enter_context(AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)))
    except Exception as e:  # of rosbags, sqlite or a file cut off: whatever it is, the bag cannot be read
        raise RuntimeError(f"{path}: not a bag that can be read ({', '.join(BAGS)}): {e}") from e


def by_topic(reader: AnyReader, types: tuple[str, ...]) -> dict[str, list[Connection]]:
    topics: dict[str, list[Connection]] = {}
    for connection in reader.connections:
        if connection.msgtype in types:
            topics.setdefault(connection.topic, []).append(connection)
    return topics


def first_of(reader: AnyReader, connections: list[Connection]) -> object | None:
    for connection, _, raw in reader.messages(connections=connections):
        return reader.deserialize(raw, connection.msgtype)
    return None


def info_topic_of(topic: str, infos: dict[str, list[Connection]]) -> str:
    """The camera_info beside images, whose transport may be the last word (image_raw/compressed), or in the namespaces around
    them; one without a namespace belongs to images without one."""
    parts = topic.split("/")
    words = len(parts) - 1 - (parts[-1] in ("compressed", "compressedDepth"))
    for end in range(len(parts) - 1, 0 if words == 1 else 1, -1):
        candidate = "/".join([*parts[:end], "camera_info"])
        if candidate in infos:
            return candidate
    return ""


def find_streams(reader: AnyReader) -> list[Stream]:
    streams = []
    infos = by_topic(reader, (INFO_TYPE,))
    for topic, connections in sorted(by_topic(reader, IMAGE_TYPES).items()):
        first = first_of(reader, connections)
        if first is None:
            continue
        stream = Stream(connections, first, info_topic_of(topic, infos))  # type: ignore[arg-type]
        if stream.info_topic:
            info = first_of(reader, infos[stream.info_topic])
            if info is not None and matrix(info, "k")[0] > 0:  # type: ignore[arg-type]
                stream.info = info  # type: ignore[assignment]
        streams.append(stream)
    raw = {s.topic for s in streams}
    return [s for s in streams if not any(s.topic == f"{other}/{way}" for other in raw
                                          for way in ("compressed", "compressedDepth"))]


def find_pair(cameras: list[Stream]) -> tuple[Stream, Stream] | None:
    """Left and right, by their names, else the two whose camera_info are those of a rectified pair. Those with a
    calibration and images as they were taken come first."""
    found = []
    at = {s.topic: s for s in cameras}
    for left, right in PAIRS:
        for stream in cameras:
            other = at.get(stream.topic.replace(left, right))
            if other is not None and other is not stream:
                found.append((stream, other))
    if not found:
        rights = [s for s in cameras if s.right_of_pair()]
        found = [(a, b) for b in rights for a in cameras if a.info is not None and not a.right_of_pair()]
    if not found:
        return None
    first, second = min(found, key=lambda pair: (pair[0].info is None or pair[1].info is None, pair[0].rectified))
    swapped = first.right_of_pair() and not second.right_of_pair()
    return (second, first) if swapped else (first, second)


def choose(source: Path, streams: list[Stream], wanted: Wanted) -> list[Stream]:
    """The images of a frame. Raises RuntimeError that has the topics."""
    there = ", ".join(s.named() for s in streams) or "none"
    if wanted.topics:
        at = {s.topic: s for s in streams}
        for topic in wanted.topics:
            if topic not in at:
                raise RuntimeError(f"{source}: no images of the topic {topic}; there are {there}")
        if len(wanted.topics) > 2:
            raise RuntimeError(f"{source}: {len(wanted.topics)} topics, must be one camera, left and right, or colour and depth")
        return [at[topic] for topic in wanted.topics]
    cameras = [s for s in streams if not s.depth]
    depths = [s for s in streams if s.depth]
    if not cameras:
        raise RuntimeError(f"{source}: no images of a camera ({' or '.join(IMAGE_TYPES)}); images: {there}")
    pair = find_pair(cameras)
    if wanted.rig in ("auto", "stereo") and pair is not None:
        return list(pair)
    if wanted.rig == "stereo":
        raise RuntimeError(f"{source}: no pair of topics found, by left and right or cam0 and cam1 in their names; there are "
                           f"{there}; name two (topics, --topics LEFT RIGHT)")
    if wanted.rig in ("auto", "rgbd") and depths:
        same = [(c, d) for d in depths for c in cameras if c.frame == d.frame and c.frame]
        if same or len(cameras) == len(depths) == 1:
            return list(same[0] if same else (cameras[0], depths[0]))
        raise RuntimeError(f"{source}: no depth images in the frame of a camera: {there}; name two (topics, --topics COLOUR "
                           "DEPTH)")
    if wanted.rig == "rgbd":
        raise RuntimeError(f"{source}: no depth images (16UC1, 32FC1); there are {there}")
    if len(cameras) > 1 and pair is None:
        raise RuntimeError(f"{source}: several cameras: {there}; name one, or two of a pair (topics, --topics)")
    return [pair[0] if pair is not None else cameras[0]]


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
    if any(s.info is None for s in used) or len({s.info_topic for s in used}) < len(used):
        return False
    made.calibration = " and ".join(s.info_topic for s in used)
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
        write_chain(made.folder / "camchain-imucam.yaml", map(chain_camera, chosen), T_right_left,
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


class Writer:
    """Writes messages to the folder: images by their stamps, samples of an IMU to imu.csv."""

    def __init__(self, made: Unpacked, chosen: list[Stream], stack: ExitStack) -> None:
        self._made = made
        rgbd = len(chosen) == 2 and chosen[1].depth
        names = ("rgb", "depth") if rgbd else ("left", "right") if len(chosen) == 2 else ("images",)
        self._images = {}
        for stream, name in zip(chosen, names):
            (made.folder / name).mkdir()
            lists = stack.enter_context(open(made.folder / f"{name}.txt", "w")) if rgbd else None
            self._images[stream.topic] = bag_images.ImageWriter(made.folder / name, lists, stream.first, stream.topic)
        self._imu: TextIO | None = None
        self._stack = stack
        self.imu_times: list[int] = []

    def image(self, topic: str, message: bag_images.Message, logged_ns: int) -> None:
        self._images[topic].write(message, logged_ns)

    def imu(self, message: bag_images.ImuMessage, logged_ns: int) -> None:
        if self._imu is None:
            self._imu = self._stack.enter_context(open(self._made.folder / "imu.csv", "w"))
        w, a = message.angular_velocity, message.linear_acceleration
        time_ns = bag_images.stamp_of(message.header) or logged_ns
        self._imu.write(",".join(map(repr, [time_ns, w.x, w.y, w.z, a.x, a.y, a.z])) + "\n")
        self.imu_times.append(time_ns)

    def least(self) -> int:
        """Images of the camera that has fewest."""
        return min(writer.count for writer in self._images.values())

    def finish(self) -> None:
        for writer in self._images.values():
            self._made.warnings += writer.warnings()


def copy_messages(reader: AnyReader, writer: Writer, chosen: list[Stream], imu: list[Connection], wanted: Wanted) -> None:
    cameras = [c for s in chosen for c in s.connections]
    topics = {c.topic for c in cameras}
    end_ns = None
    for connection, logged_ns, raw in reader.messages(connections=[*cameras, *imu]):
        if end_ns is not None and logged_ns > end_ns:
            break
        message = reader.deserialize(raw, connection.msgtype)
        if connection.topic not in topics:
            writer.imu(message, logged_ns)  # type: ignore[arg-type]
            continue
        writer.image(connection.topic, message, logged_ns)  # type: ignore[arg-type]
        wanted.progress(writer.least())
        if end_ns is None and 0 < wanted.max_frames <= writer.least():
            end_ns = logged_ns + 200_000_000  # of an IMU what comes a little later is used, too


def unpack_bag(path: Path, wanted: Wanted) -> Unpacked:
    """Raises RuntimeError that names the bag, and the topic."""
    with ExitStack() as stack:
        reader = open_reader(path, stack)
        streams = find_streams(reader)
        chosen = choose(path, streams, wanted)
        made = begin(str(path), "bag")
        # A RealSense has a topic for each half of its IMU.
        imus = [(t, c) for t, c in sorted(by_topic(reader, (IMU_TYPE,)).items()) if not {"accel", "gyro"} & set(t.split("/"))]
        first = first_of(reader, imus[0][1]) if imus else None
        imu_frame = str(first.header.frame_id) if first is not None else ""  # type: ignore[attr-defined]
        placed = not wanted.calibration and write_calibration(made, chosen, read_frames(reader), imu_frame)
        writer = Writer(made, chosen, stack)
        try:
            copy_messages(reader, writer, chosen, imus[0][1] if imus else [], wanted)
        except bag_images.Refused as e:
            raise RuntimeError(f"{path}: {e}") from None
        writer.finish()
        if placed and writer.imu_times:
            assumed = write_assumed_imu(made.folder / "imu.yaml", writer.imu_times)
            made.warnings += [assumed] if wanted.imu else []
        describe(made, reader, chosen, streams, [topic for topic, _ in imus], len(writer.imu_times))
    return made


def describe(made: Unpacked, reader: AnyReader, chosen: list[Stream], streams: list[Stream], imus: list[str],
             samples: int) -> None:
    kind = "ROS 1 bag" if made.source.endswith(".bag") else "ROS 2 bag"
    made.what = f"{Path(made.source).name}, {kind}, {' and '.join(s.named() for s in chosen)}"
    made.stamps = "headers of the messages"
    if imus:
        made.added["imu"] = f"{samples} samples of {imus[0]}"
    else:
        halves = sorted(by_topic(reader, (IMU_TYPE,)))
        made.replaced["imu"] = (f"none: {' and '.join(halves)} are halves of one, which are not joined" if halves else
                                f"none: no topic of the type {IMU_TYPE}")
    truths = sorted(by_topic(reader, TRUTH_TYPES).items())
    if truths:
        made.added["truth"] = "not used, as nothing says of what body they are: " + ", ".join(
            f"{topic} ({sum(c.msgcount for c in connections)} {connections[0].msgtype.split('/')[-1]})"
            for topic, connections in truths)
    others = [s.named() for s in streams if s not in chosen] + imus[1:]
    if others:
        made.added["left out"] = "topics " + ", ".join(others)
