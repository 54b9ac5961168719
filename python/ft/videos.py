# SPDX-License-Identifier: Apache-2.0
"""Videos, decoded by OpenCV: one, or those of a left and a right camera."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .unpacking import IMAGES, VIDEOS, Unpacked, Wanted, begin, link_calibrations, stamp_text, write_pnm

LAYOUTS = ("mav0", "cam0", "image_0", "image_2", "rgb.txt", "associations.txt", "times.txt")
# What a calibration of more than one camera has, and of the .txt files those with a camera.
PAIR = re.compile(r"\b(cam1|camera_?matrix_?(2|r|right)|[MKD]_?(2|R|r|right)|right_\w+|Camera2\.fx|Camera\.bf|Stereo\.b|"
                  r"RIGHT\.K|P1)[\"']?\s*:|<(M|K|D|camera_?matrix_?)2>|Fisheye 2|Infrared 2|T_imu_cam[\s\S]*px[\s\S]*px|"
                  r"intrinsicMatrix[\s\S]*intrinsicMatrix|^2 [A-Z_]+ \d+ \d+ ", re.IGNORECASE | re.MULTILINE)
CAMERA = re.compile(r"^P[0-3]:|^Intrinsic of \"|^\d+ [A-Z][A-Z_0-9]* \d+ \d+ ", re.MULTILINE)
SIDE = re.compile(r"left|right|cam(era)?_?[01]", re.IGNORECASE)


def videos_in(folder: Path) -> list[Path]:
    """Of a folder with videos, without images and without a layout: left and right, or the only one; empty for another."""
    videos = sorted(path for path in folder.glob("*") if path.suffix.lower() in VIDEOS)
    sides = [path for side in ("left", "right") for path in videos if path.stem.lower() == side]
    found = sides if len(sides) == 2 else videos if len(videos) == 1 else []
    if not found or any((folder / name).exists() for name in LAYOUTS):
        return []
    files = (path for pattern in ("*", "*/*", "*/data/*") for path in folder.glob(pattern))
    return [] if any(path.suffix.lower() in IMAGES for path in files) else found


def is_calibration(file: Path, video: Optional[Path]) -> bool:
    """Whether a file beside videos may be their calibration. video: the only one, whose calibration is of one camera."""
    if not file.is_file() or file.stat().st_size > 1 << 20:
        return False
    text = file.read_text(errors="replace")
    if file.suffix.lower() == ".txt" and file.name != "camera.txt" and not CAMERA.search(text):
        return False
    if video is None:
        return True
    of_side = SIDE.search(file.stem) and file.stem.lower() != video.stem.lower()
    return video.stem.lower() != "right" and not of_side and not PAIR.search(text)


def unpack_videos(paths: list[Path], wanted: Wanted) -> Unpacked:
    """Raises RuntimeError that names the video."""
    for path in paths:
        if not path.exists():
            raise RuntimeError(f"{path}: no such file")
    try:
        import cv2
    except ImportError:
        raise RuntimeError(f"{paths[0]}: videos are decoded by OpenCV, which is not installed: python -m pip install "
                           "opencv-python-headless") from None
    if wanted.rig == "rgbd" or (wanted.rig in ("stereo", "mixed") and len(paths) == 1):
        raise RuntimeError(f"{paths[0]}: the video of one camera: a pair is two videos, and none has depth images")
    lone = paths[0] if len(paths) == 1 else None
    if wanted.rig == "mono":
        paths = paths[:1]
    made = begin(str(paths[0]), "video")
    made.what = f"{' and '.join(path.name for path in paths)}, {'videos' if len(paths) == 2 else 'video'}"
    made.stamps = "those of the video"
    if not wanted.calibration:
        link_calibrations(paths[0].resolve().parent, made.folder, lambda file: is_calibration(file, lone))
        if not any(made.folder.iterdir()):
            wanted = replace(wanted, max_frames=1)  # it will be refused
    found = []
    for path, name in zip(paths, ("left", "right") if len(paths) == 2 else ("images",)):
        (made.folder / name).mkdir()
        made.parts[name] = str(path)
        found.append(decode(cv2.VideoCapture(str(path)), path, made.folder / name, wanted))
        made.warnings += found[-1].doubts()
    made.warnings += found[0].doubts_beside(found[1]) if len(found) == 2 else found[0].doubts_alone()
    if lone is not None:
        made.missing = found[0].guess_of_camera()
    return made


@dataclass
class Decoded:
    """What was got out of a video."""

    path: Path
    times_ns: list[int] = field(default_factory=list)
    doubled: int = 0  # images whose stamps are not after those of the images before
    promised: int = 0  # images by its header, where it was read to its end
    first: Optional[NDArray[np.uint8]] = None

    @property
    def rate(self) -> float:
        steps = np.diff(self.times_ns)
        return 1e9 / float(np.median(steps)) if len(steps) else 0.0

    def doubts(self) -> list[str]:
        said = []
        if self.doubled:
            said.append(f"{self.path}: {self.doubled} images left out: their stamps are not after those of the images before")
        got = len(self.times_ns) + self.doubled
        if self.promised - got > max(2, 0.02 * self.promised):  # of some formats the number is an estimate
            said.append(f"{self.path}: the video ends early: {got} images could be decoded of the {self.promised} that its header "
                        "promises: is it cut off, or damaged?")
        return said

    def doubts_beside(self, other: Decoded) -> list[str]:
        """Of the left video of a pair."""
        a, b = self.rate, other.rate
        if a and b and abs(a - b) > 0.005 * a:
            return [f"the videos of the pair have different rates, {a:.4g} and {b:.4g} images a second: pairs are images of the "
                    "same time, and few of them are"]
        if abs(len(self.times_ns) - len(other.times_ns)) > 1:
            return [f"the videos of the pair have different lengths, {len(self.times_ns)} and {len(other.times_ns)} images: pairs "
                    "are images of the same time since the begin of each: do both begin at one time?"]
        return []

    def guess_of_camera(self) -> str:
        """What a camera.txt may hold of a phone that nobody has calibrated."""
        if self.first is None:
            return ""
        height, width = self.first.shape
        return (f"a phone that is not calibrated yet, whose lens is called X mm (of 36 mm film), has about fx = fy = X * "
                f"{max(width, height) / 36:.4g}, cx = {width / 2:g}, cy = {height / 2:g} in a camera.txt beside the video")

    def doubts_alone(self) -> list[str]:
        """Of the only video."""
        if self.first is None or not both_in_one(self.first):
            return []
        return [f"{self.path}: the left and the right half of the image look alike: are both images of a pair side by side? It is "
                f"tracked as one camera; to split it: ffmpeg -i {self.path} -vf crop=iw/2:ih:0:0 left.mp4, and "
                "crop=iw/2:ih:iw/2:0 for right.mp4"]


def both_in_one(grey: NDArray[np.uint8]) -> bool:
    """Whether the halves of a wide image show the same, moved along the rows by up to a quarter."""
    import cv2

    height, width = grey.shape
    if width < 1.9 * height:
        return False
    small = np.asarray(cv2.resize(grey, (128, 48), interpolation=cv2.INTER_AREA), np.float64)
    left, right = small[:, :64], small[:, 64:]
    best = 0.0
    for moved in range(17):
        a, b = left[:, moved:], right[:, :64 - moved]
        a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)  # sky and ground are alike everywhere
        size = float(np.sqrt((a * a).sum() * (b * b).sum()))
        best = max(best, float((a * b).sum()) / size if size > 0 else 0.0)
    return best > 0.5  # of pairs 0.66 or more, of images of one camera 0.4 at most


def decode(video: object, path: Path, folder: Path, wanted: Wanted) -> Decoded:
    """Raises RuntimeError where there is no image."""
    import cv2

    assert isinstance(video, cv2.VideoCapture)
    made = Decoded(path)
    while not wanted.max_frames or len(made.times_ns) < wanted.max_frames:
        good, image = video.read()
        if not good:
            made.promised = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
            break
        time_ns = round(1e6 * video.get(cv2.CAP_PROP_POS_MSEC))
        if made.times_ns and time_ns <= made.times_ns[-1]:
            made.doubled += 1
            continue
        grey = np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        write_pnm(folder / f"{stamp_text(time_ns)}.pgm", grey)
        made.first = grey if made.first is None else made.first
        made.times_ns.append(time_ns)
        wanted.tell(len(made.times_ns))
    if not made.times_ns:
        raise RuntimeError(f"{path}: no image can be decoded: OpenCV has no decoder for it, or it is damaged")
    return made
