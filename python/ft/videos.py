# SPDX-License-Identifier: Apache-2.0
"""Videos, decoded by OpenCV: one, or those of a left and a right camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .unpacking import VIDEOS, Unpacked, Wanted, begin, link_calibrations, stamp_text, write_pnm


def videos_in(folder: Path) -> list[Path]:
    """Of a folder with videos and no images: left and right, or the only one; empty for another folder."""
    videos = sorted(path for path in folder.iterdir() if path.suffix.lower() in VIDEOS)
    sides = [path for side in ("left", "right") for path in videos if path.stem.lower() == side]
    return sides if len(sides) == 2 else videos if len(videos) == 1 else []


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
        link_calibrations(paths[0].resolve().parent, made.folder)
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
