# SPDX-License-Identifier: Apache-2.0
"""Videos, decoded by OpenCV: one, or those of a left and a right camera."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Optional

import numpy as np

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
    if wanted.rig == "rgbd" or (wanted.rig == "stereo" and len(paths) == 1):
        raise RuntimeError(f"{paths[0]}: the video of one camera: a pair is two videos, and none has depth images")
    lone = paths[0] if len(paths) == 1 else None
    if wanted.rig == "mono":
        paths = paths[:1]
    made = begin(str(paths[0]), "video")
    made.what = f"{' and '.join(path.name for path in paths)}, {'videos' if len(paths) == 2 else 'video'}"
    made.stamps = "those of the video"
    for path, name in zip(paths, ("left", "right") if len(paths) == 2 else ("images",)):
        (made.folder / name).mkdir()
        frames, doubled = decode(cv2.VideoCapture(str(path)), path, made.folder / name, wanted)
        if frames == 0:
            raise RuntimeError(f"{path}: no image can be decoded: OpenCV has no decoder for it, or it is damaged")
        if doubled:
            made.warnings.append(f"{path}: {doubled} images left out: their stamps are not after those of the images before")
    if not wanted.calibration:
        link_calibrations(paths[0].resolve().parent, made.folder, lambda file: is_calibration(file, lone))
    return made


def decode(video: object, path: Path, folder: Path, wanted: Wanted) -> tuple[int, int]:
    """Number of images, and of those left out."""
    import cv2

    assert isinstance(video, cv2.VideoCapture)
    written = doubled = 0
    last_ns = -1
    while not wanted.max_frames or written < wanted.max_frames:
        good, image = video.read()
        if not good:
            break
        time_ns = round(1e6 * video.get(cv2.CAP_PROP_POS_MSEC))
        if time_ns <= last_ns:
            doubled += 1
            continue
        last_ns = time_ns
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        write_pnm(folder / f"{stamp_text(time_ns)}.pgm", np.asarray(grey, np.uint8))
        written += 1
        wanted.progress(written)
    return written, doubled
