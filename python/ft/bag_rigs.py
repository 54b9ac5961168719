# SPDX-License-Identifier: Apache-2.0
"""Rigs of several cameras in a bag: which topics are its cameras, and where these are."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .bag_calibration import INFO_TYPE, Stream, chain_camera, info_values, turned
from .bag_frames import Frames, Motion, pair_of_info, write_chain
from .unpacking import Unpacked

PAIRS = (("left", "right"), ("cam0", "cam1"), ("camera0", "camera1"), ("cam_0", "cam_1"), ("camera_0", "camera_1"),
         ("infra1", "infra2"), ("image_0", "image_1"), ("fisheye1", "fisheye2"), ("cam1", "cam2"), ("camera1", "camera2"))
Pair = tuple[Stream, Stream]


def pairs_by_name(cameras: list[Stream]) -> list[Pair]:
    at = {s.topic: s for s in cameras}
    found = []
    for left, right in PAIRS:
        for stream in cameras:
            other = at.get(stream.topic.replace(left, right))
            if other is not None and other is not stream:
                found.append((stream, other))
    return found


def is_pair_by_info(left: Stream, right: Stream) -> bool:
    """Whether camera_info has them rectified to one camera, with a baseline."""
    if left.info is None or right.info is None or left.right_of_pair() or not right.right_of_pair():
        return False
    p, q = info_values(left)[3], info_values(right)[3]
    return p[0] > 0 and np.allclose([*p[:3], *p[4:7]], [*q[:3], *q[4:7]], rtol=1e-6)


def find_pairs(cameras: list[Stream]) -> list[Pair]:
    """Left and right, each camera once: by camera_info, first those whose names say it, too."""
    named = pairs_by_name(cameras)
    all_pairs = [*named, *((b, a) for a, b in named), *((a, b) for a in cameras for b in cameras if a is not b)]
    found: list[Pair] = []
    taken: set[str] = set()
    for left, right in all_pairs:
        if is_pair_by_info(left, right) and not taken & {left.topic, right.topic}:
            found.append((left, right))
            taken |= {left.topic, right.topic}
    return found


def of_one_transport(cameras: list[Stream]) -> list[Stream]:
    """Of several topics with the same camera_info one: that of images as they were taken."""
    found: dict[str, Stream] = {}
    for stream in sorted(cameras, key=lambda s: s.rectified):
        found.setdefault(stream.info_topic or stream.topic, stream)
    return sorted(found.values(), key=lambda s: s.topic)


def topics_of_chain(calibration: str) -> list[str]:
    """Those that Kalibr has written of cam0, cam1 ...; none of another file."""
    file = Path(calibration)
    if not calibration or not file.is_file():
        return []
    return re.findall(r"^\s*rostopic:\s*['\"]?(/[^\s'\"]+)", file.read_text(errors="replace"), re.MULTILINE)


def choose_rig(source: Path, streams: list[Stream], calibration: str, warnings: list[str]) -> list[Stream]:
    """The cameras of a mixed rig: in the order of Kalibr's chain, else pairs first, left before right, then by name; behind
    them the depth images in the frame of a camera that is in no pair."""
    cameras = of_one_transport([s for s in streams if not s.depth])
    if not calibration and any(s.info is not None for s in cameras):
        warnings += [f"{s.topic} is not taken: no {INFO_TYPE} is beside it" for s in cameras if s.info is None]
        cameras = [s for s in cameras if s.info is not None]
    if len(cameras) < 2:
        raise RuntimeError(f"{source}: a mixed rig has two cameras or more, there are "
                           f"{', '.join(s.named() for s in streams) or 'none'}")
    at = {s.topic: s for s in streams}
    listed = topics_of_chain(calibration)
    first = [s for pair in find_pairs(cameras) for s in pair]
    if len(listed) > 1 and all(topic in at for topic in listed):
        cameras = [at[topic] for topic in listed]
    else:
        cameras = [*first, *(s for s in cameras if s not in first)]
    alone = {s.frame for s in cameras if s.frame} - {s.frame for s in first}
    depths = {s.frame: s for s in streams if s.depth and s.frame in alone}
    return [*cameras, *depths.values()]


def folders_of(source: Path, chosen: list[Stream]) -> list[str]:
    """For each of the topics cam0, cam1 ..., for depth images depth2 of the camera in whose frame they are."""
    cameras = [s for s in chosen if not s.depth]
    names = []
    for stream in chosen:
        if not stream.depth:
            names.append(f"cam{cameras.index(stream)}")
            continue
        of = next((i for i, s in enumerate(cameras) if s.frame and s.frame == stream.frame), None)
        if of is None:
            raise RuntimeError(f"{source}: depth images of {stream.topic} are in the frame '{stream.frame}', that of no camera: "
                               + ", ".join(f"{s.topic} '{s.frame}'" for s in cameras) + "; those of a rig must be registered "
                               "to one of its cameras, and have its frame_id")
        names.append(f"depth{of}")
    return names


def places_of(source: str, cameras: list[Stream], frames: Frames) -> list[Motion]:
    """T_cam0_camera of each. Of a pair P of camera_info says it, of others the transforms."""
    left_of = {right.topic: left for left, right in find_pairs(cameras)}
    T_image_camera = [turned(s, np.eye(4)) for s in cameras]
    found: dict[str, Motion] = {cameras[0].topic: np.eye(4)}
    for _ in cameras:  # a camera may be joined by one that comes later
        for i, stream in enumerate(cameras):
            if stream.topic in found:
                continue
            T = frames.find(cameras[0].frame, stream.frame) if stream.frame != cameras[0].frame else None
            left = left_of.get(stream.topic)
            if left is not None and left.topic in found:
                (_, _, r, _, _), (_, _, r_right, p, _) = info_values(left), info_values(stream)
                found[stream.topic] = found[left.topic] @ np.linalg.inv(pair_of_info(r, r_right, p))
            elif T is not None and left is None:
                found[stream.topic] = T_image_camera[0] @ T @ np.linalg.inv(T_image_camera[i])
    lost = [s for s in cameras if s.topic not in found]
    if lost:
        names = " and ".join(f"{s.topic} (frame '{s.frame}')" for s in lost)
        raise RuntimeError(
            f"{source}: nothing says where {names} is on the rig, beside {cameras[0].topic} (frame '{cameras[0].frame}'): "
            "accepted are transforms that join the frames (/tf_static, or /tf where they do not change), the baseline in P of "
            "a pair's camera_info, and a calibration (calibration, --calibration) such as Kalibr's chain, whose cam0, cam1 ... "
            f"are {', '.join(s.topic for s in cameras)}, or the topics of its rostopic; topics (--topics) names the cameras to "
            "be taken")
    return [found[s.topic] for s in cameras]


def write_rig(made: Unpacked, chosen: list[Stream], frames: Frames, imu_frame: str) -> bool:
    """The chain of all cameras, as Kalibr writes it. Returns whether the place of the IMU is in it."""
    cameras = [s for s in chosen if not s.depth]
    without = [s.topic for s in cameras if s.info is None]
    if without:
        raise RuntimeError(f"{made.source}: no {INFO_TYPE} is beside {' and '.join(without)}: a calibration (calibration, "
                           "--calibration), such as Kalibr's chain, is needed")
    sizes = {s.topic: (int(s.info.width), int(s.info.height)) for s in cameras if s.info is not None}
    if len(set(sizes.values())) > 1:
        raise RuntimeError(f"{made.source}: all cameras of a rig must have one size, there are "
                           + ", ".join(f"{topic} of {w}x{h}" for topic, (w, h) in sizes.items())
                           + "; topics (--topics) names those of one size")
    places = places_of(made.source, cameras, frames)
    steps = [np.linalg.inv(after) @ before for before, after in zip(places, places[1:])]
    T_cam0_imu = frames.find(cameras[0].frame, imu_frame) if imu_frame else None
    if T_cam0_imu is not None:
        T_cam0_imu = turned(cameras[0], T_cam0_imu)
    write_chain(made.folder / "camchain-imucam.yaml", map(chain_camera, cameras), steps, T_cam0_imu)
    made.calibration = "camera_info of each and the transforms between their frames"
    made.parts["camchain-imucam.yaml"] = f"{made.source}: {made.calibration}"
    made.warnings += frames.warnings
    return T_cam0_imu is not None
