# SPDX-License-Identifier: Apache-2.0
"""Recordings in one file become a folder of images, which the reader of folders opens: it is removed with the sequence."""

from __future__ import annotations

import glob
import re
import struct
import tempfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Sequence as SequenceOf

import numpy as np

BAGS = (".bag", ".db3", ".mcap")
VIDEOS = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm")
IMAGES = (".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".bmp", ".tif", ".tiff")
ACCEPTED = (f"accepted are a folder (EuRoC, KITTI, KITTI raw, TUM RGB-D, ICL-NUIM, OpenLORIS, 7-Scenes, images), a bag ({', '.join(BAGS)}, the folder of a ROS 2 bag), "
            f"one or two videos ({', '.join(VIDEOS)}), and a pattern of images such as 'images/*.png'")

Progress = Callable[[int], None]


class Told(BaseException):
    """Carries what a caller's progress function raised through all that catches errors of files."""


@dataclass
class Wanted:
    """What a caller of read_sequence asks of a recording. rig: auto, stereo, mono, rgbd or mixed. topics: of images, of a bag;
    empty: found. calibration: the file or folder that was named. imu: whether samples of one are to be used."""

    rig: str = "auto"
    max_frames: int = 0
    topics: SequenceOf[str] = ()
    calibration: str = ""
    progress: Progress = lambda images: None
    imu: bool = False

    def tell(self, images: int) -> None:
        try:
            self.progress(images)
        except Exception as e:
            raise Told from e


@dataclass
class Unpacked:
    """A folder with the images, and what Sequence.describe() is to say of where they come from: what it is, where its
    calibration and its stamps are from, and what is `added` to lines, or `replaced` in them, by their name."""

    source: str
    layout: str
    folder: Path
    temporary: tempfile.TemporaryDirectory[str]
    what: str = ""
    calibration: str = ""  # "" = the folder's
    stamps: str = ""
    added: dict[str, str] = field(default_factory=dict)
    replaced: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    parts: dict[str, str] = field(default_factory=dict)  # what files and folders of the folder were, by their names
    depth_unit: float | None = None  # metres, of depth images whose calibration does not say it
    missing: str = ""  # what the recording lacks where it holds no calibration

    def named(self, text: str) -> str:
        """A message with the recording's name, and what was in it, in place of the folder and its files: nobody else sees
        these."""
        for folder in (str(self.folder.resolve()), str(self.folder)):
            text = re.sub(re.escape(folder) + r"((?:/[^\s:,;'()]+)*)", lambda found: self._origin(found[1].strip("/")), text)
        if "accepted are Kalibr's" in text:
            text = text.replace(f"{self.source}: no such file", f"{self.source}: holds no calibration")
            text += f"; {self.missing}" if self.missing else ""
        return text

    def _origin(self, part: str) -> str:
        """Of a file or folder of the folder: where it comes from."""
        file = self.folder / part
        if part and file.is_symlink():
            return str(file.readlink())
        top, _, rest = part.partition("/")
        if top not in self.parts:
            return f"{self.source}: {part}" if part and file.exists() else self.source
        stamp = Path(rest).stem if rest else ""
        if stamp.isdigit():  # of EuRoC's layout
            stamp = stamp_text(int(stamp))
        return self.parts[top] + (f", image of {stamp} s" if stamp else "")

    def described(self, lines: list[tuple[str, str]]) -> list[tuple[str, str]]:
        """Lines of the folder, as those of the recording."""
        said = []
        for name, text in lines:
            if name == "sequence":
                text = f"{self.what}; calibration {self.calibration or text.rpartition('; calibration ')[2]}"
            elif name == "images" and self.stamps:
                text = f"{text.rpartition('; times: ')[0]}; times: {self.stamps}"
            elif name == "cameras" and self.depth_unit is not None:
                text = text.replace("as asked for", "as bags have it")
            elif name in self.replaced and text != "not asked for":
                text = self.replaced[name]
            elif name in self.added and text != "not asked for":
                text = f"{text}; {self.added[name]}"
            said.append((name, text))
        known = [name for name, _ in lines]
        return said + [(name, text) for name, text in self.added.items() if name not in known]


def begin(source: str, layout: str) -> Unpacked:
    """An empty folder of the recording's name, in a new one."""
    temporary = tempfile.TemporaryDirectory(prefix="ft_")
    name = Path(source).name
    folder = Path(temporary.name) / ("recording" if name in ("", "..") else name)
    folder.mkdir()
    return Unpacked(source, layout, folder, temporary)


def is_bag(path: Path) -> bool:
    return path.suffix.lower() in BAGS or (path / "metadata.yaml").is_file()


def unpacked(source: object, wanted: Wanted) -> Unpacked | None:
    """The folder made of a recording; None for what is a folder of images already. Raises RuntimeError that names the
    file and what is wrong."""
    try:
        return _unpacked(source, wanted)
    except Told as told:
        raised = told.__cause__ or told
    except (RuntimeError, ValueError):
        raise
    except Exception as e:  # of rosbags, sqlite, OpenCV or the disk
        raise RuntimeError(f"{source}: cannot be unpacked: {e or type(e).__name__}") from e
    raise raised  # outside, so that its traceback has this one alone


def _unpacked(source: object, wanted: Wanted) -> Unpacked | None:
    files = [str(file) for file in source] if isinstance(source, (list, tuple)) else [str(source)]
    if not files:
        raise RuntimeError(f"no file is named; {ACCEPTED}")
    paths = [Path(file) for file in files]
    if len(files) == 1 and is_bag(paths[0]):
        from .bags import unpack_bag

        return unpack_bag(paths[0], wanted)
    if wanted.topics:
        raise RuntimeError(f"{files[0]}: no bag, and only bags have topics")
    if len(files) == 1 and paths[0].is_dir():
        from .videos import unpack_videos, videos_in

        videos = videos_in(paths[0])
        return unpack_videos(videos, wanted) if videos else None
    kinds = {path.suffix.lower() for path in paths}
    if len(files) <= 2 and kinds <= set(VIDEOS):
        from .videos import unpack_videos

        return unpack_videos(paths, wanted)
    if len(files) == 1 and glob.has_magic(files[0]):
        paths = [Path(file) for file in sorted(glob.glob(files[0]))]
        if not paths:
            raise RuntimeError(f"{files[0]}: no file has such a name; {ACCEPTED}")
        return of_images(files[0], paths)
    if len(files) > 1 and kinds <= set(IMAGES):
        return of_images(f"{files[0]} ...", paths)
    for path in paths:
        if not path.exists():
            raise RuntimeError(f"{path}: no such file or folder; {ACCEPTED}")
    raise RuntimeError(f"{' and '.join(files[:3])}: not a recording that is known; {ACCEPTED}")


def of_images(source: str, paths: list[Path]) -> Unpacked:
    """Images of one camera: a folder with links to them, and the calibration beside them."""
    wrong = next((path for path in paths if path.suffix.lower() not in IMAGES), None)
    if wrong is not None:
        raise RuntimeError(f"{wrong}: no image; accepted are {', '.join(IMAGES)}")
    parents = {path.parent.resolve() for path in paths}
    if len(parents) > 1:
        raise RuntimeError(f"{source}: images of {len(parents)} folders, must be of one camera, in one folder; a pair is a "
                           "folder with left and right in it")
    made = begin(source.rstrip(".* /") or "images", "images")
    made.source = source
    made.what = f"{source}, images of one camera"
    for path in paths:
        (made.folder / path.name).symlink_to(path.resolve())
    link_calibrations(parents.pop(), made.folder)
    return made


def link_calibrations(source: Path, folder: Path, taken: Callable[[Path], bool] = lambda path: True) -> None:
    """taken: which of the files that may be calibrations."""
    for path in source.iterdir():
        if path.suffix.lower() in (".txt", ".yaml", ".yml", ".xml", ".json") and taken(path):
            (folder / path.name).symlink_to(path)


def stamp_text(time_ns: int) -> str:
    return f"{time_ns // 1_000_000_000}.{time_ns % 1_000_000_000:09d}"


def write_pnm(file: Path, image: np.ndarray[tuple[int, ...], np.dtype[np.uint8 | np.uint16]], largest: int = 255) -> None:
    """A grey (height, width) or RGB (height, width, 3) image of 8 or 16 bits, with the value that is white."""
    kind = b"P5" if image.ndim == 2 else b"P6"
    with open(file, "wb") as out:
        out.write(b"%s %d %d %d\n" % (kind, image.shape[1], image.shape[0], largest))
        out.write(image.astype(np.uint8 if largest < 256 else ">u2").tobytes())


def write_depth_png(file: Path, depth: np.ndarray[tuple[int, ...], np.dtype[np.uint16]]) -> None:
    """(height, width) of 16 bits."""
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    height, width = depth.shape
    rows = np.zeros((height, 1 + 2 * width), np.uint8)  # each begins with its filter, 0
    rows[:, 1:] = depth.astype(">u2").view(np.uint8)
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))
                     + chunk(b"IDAT", zlib.compress(rows.tobytes(), 1)) + chunk(b"IEND", b""))
