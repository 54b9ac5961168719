# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 1 and 2, read by the package rosbags: which of their topics are a rig, and their calibration."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from . import bag_images
from .bag_calibration import INFO_TYPE, Stream, matrix, write_calibration
from .bag_frames import read_frames, write_assumed_imu
from .bag_rigs import choose_rig, folders_of, pairs_by_name, write_rig
from .unpacking import BAGS, Unpacked, Wanted, begin

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
IMU_TYPE = "sensor_msgs/msg/Imu"
TRUTH_TYPES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Odometry",
               "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PointStamped")


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
        tool = {".bag": "rosbag reindex", ".mcap": "mcap recover"}.get(path.suffix.lower())
        hint = f"; {tool} mends one whose recording was interrupted" if tool else ""
        raise RuntimeError(f"{path}: not a bag that can be read ({', '.join(BAGS)}): {e}{hint}") from e


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
    found = pairs_by_name(cameras)
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
        if len(wanted.topics) > 2 and wanted.rig != "mixed":
            raise RuntimeError(f"{source}: {len(wanted.topics)} topics, must be one camera, left and right, or colour and depth; "
                               "rig mixed (--rig mixed) takes more")
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
        raise RuntimeError(f"{source}: several cameras: {there}; name one, or two of a pair (topics, --topics), or take "
                           "all of them as a rig (rig mixed, --rig mixed)")
    return [pair[0] if pair is not None else cameras[0]]


class Writer:
    """Writes messages to the folder: images by their stamps, samples of an IMU to imu.csv."""

    def __init__(self, made: Unpacked, chosen: list[Stream], mixed: bool, stack: ExitStack) -> None:
        self._made = made
        rgbd = len(chosen) == 2 and chosen[1].depth
        names = (folders_of(Path(made.source), chosen) if mixed else ("rgb", "depth") if rgbd
                 else ("left", "right") if len(chosen) == 2 else ("images",))
        self._images = {}
        for stream, name in zip(chosen, names):
            (made.folder / name).mkdir()
            made.parts.update({name: f"{made.source}: {stream.topic}", f"{name}.txt": f"{made.source}: stamps of {stream.topic}"})
            lists = stack.enter_context(open(made.folder / f"{name}.txt", "w")) if rgbd and not mixed else None
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
        wanted.tell(writer.least())
        if end_ns is None and 0 < wanted.max_frames <= writer.least():
            end_ns = logged_ns + 200_000_000  # of an IMU what comes a little later is used, too


def unpack_bag(path: Path, wanted: Wanted) -> Unpacked:
    """Raises RuntimeError that names the bag, and the topic."""
    with ExitStack() as stack:
        reader = open_reader(path, stack)
        streams = find_streams(reader)
        made = begin(str(path), "bag")
        mixed = wanted.rig == "mixed"
        chosen = (choose(path, streams, wanted) if wanted.topics or not mixed
                  else choose_rig(path, streams, wanted.calibration, made.warnings))
        # A RealSense has a topic for each half of its IMU.
        imus = [(t, c) for t, c in sorted(by_topic(reader, (IMU_TYPE,)).items()) if not {"accel", "gyro"} & set(t.split("/"))]
        first = first_of(reader, imus[0][1]) if imus else None
        imu_frame = str(first.header.frame_id) if first is not None else ""  # type: ignore[attr-defined]
        write = write_rig if mixed else write_calibration
        placed = not wanted.calibration and write(made, chosen, read_frames(reader, mixed), imu_frame)
        writer = Writer(made, chosen, mixed, stack)
        made.parts["imu.csv"] = f"{path}: {imus[0][0] if imus else 'no IMU'}"
        made.parts["imu.yaml"] = f"{path}: the noise of its IMU"
        try:
            copy_messages(reader, writer, chosen, imus[0][1] if imus else [], wanted)
        except bag_images.Refused as e:
            raise RuntimeError(f"{path}: {e}") from None
        writer.finish()
        if placed and writer.imu_times:
            assumed = write_assumed_imu(made.folder / "imu.yaml", writer.imu_times)
            made.warnings += [assumed] if wanted.imu else []
        describe(made, reader, chosen, streams, [topic for topic, _ in imus], len(writer.imu_times), wanted)
    return made


def describe(made: Unpacked, reader: AnyReader, chosen: list[Stream], streams: list[Stream], imus: list[str],
             samples: int, wanted: Wanted) -> None:
    kind = "ROS 1 bag" if made.source.endswith(".bag") else "ROS 2 bag"
    mixed = wanted.rig == "mixed"
    cameras = (", ".join(f"{n} {s.named()}" for n, s in zip(folders_of(Path(made.source), chosen), chosen)) if mixed
               else " and ".join(s.named() for s in chosen))
    made.what = f"{Path(made.source).name}, {kind}, {cameras}"
    made.stamps = "headers of the messages"
    made.depth_unit = bag_images.MILLIMETRE if mixed and any(s.depth for s in chosen) else None
    if imus:
        made.added["imu"] = f"{samples} samples of {imus[0]}"
    else:
        halves = sorted(by_topic(reader, (IMU_TYPE,)))
        made.replaced["imu"] = (f"none: {' and '.join(halves)} are halves of one, which are not joined" if halves else
                                f"none: no topic of the type {IMU_TYPE}")
        if halves and wanted.imu:
            made.warnings.append(f"{made.source}: the samples of the IMU are not used: {' and '.join(halves)} are halves of one, "
                                 "which are not joined; the driver joins them (unite_imu_method)")
    truths = sorted(by_topic(reader, TRUTH_TYPES).items())
    if truths:
        made.added["truth"] = "not used, as nothing says of what body they are: " + ", ".join(
            f"{topic} ({sum(c.msgcount for c in connections)} {connections[0].msgtype.split('/')[-1]})"
            for topic, connections in truths)
    others = [s.named() for s in streams if s not in chosen] + imus[1:]
    if others:
        more = len(chosen) == 2 and any(not s.depth for s in streams if s not in chosen) and not mixed
        made.added["left out"] = f"topics {', '.join(others)}{'; --rig mixed takes other cameras, too' if more else ''}"
