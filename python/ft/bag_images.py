# SPDX-License-Identifier: Apache-2.0
"""Images of ROS messages as files: grey and colour as they are or as PGM and PPM, depth as PNG in millimetres."""

from __future__ import annotations

from pathlib import Path
from typing import IO, TYPE_CHECKING, Protocol

import numpy as np

from .unpacking import stamp_text, write_depth_png, write_pnm

RAW = {  # channels, bytes a value
    "mono8": (1, 1), "8UC1": (1, 1), "mono16": (1, 2), "16UC1": (1, 2), "16SC1": (1, 2), "32FC1": (1, 4), "rgb8": (3, 1),
    "bgr8": (3, 1), "8UC3": (3, 1), "rgba8": (4, 1), "bgra8": (4, 1), "yuv422": (2, 1), "uyvy": (2, 1),
    "yuv422_yuy2": (2, 1), "yuyv": (2, 1), "bayer_rggb8": (1, 1), "bayer_bggr8": (1, 1), "bayer_gbrg8": (1, 1),
    "bayer_grbg8": (1, 1),
}
ACCEPTED = f"accepted are {', '.join(RAW)}, and JPEG and PNG"
MILLIMETRE = 1e-3

if TYPE_CHECKING:
    Bytes = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
    Values = np.ndarray[tuple[int, ...], np.dtype[np.uint8 | np.uint16 | np.float32]]


class Refused(RuntimeError):
    """Says topic and encoding."""


class Stamp(Protocol):
    sec: int
    nanosec: int


class Header(Protocol):
    stamp: Stamp
    frame_id: str


class Message(Protocol):
    """sensor_msgs/msg/Image or CompressedImage: `encoding` or `format` tells."""

    header: Header
    data: Bytes


class RawImage(Message, Protocol):
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int


class Vector(Protocol):
    x: float
    y: float
    z: float


class ImuMessage(Protocol):
    header: Header
    angular_velocity: Vector
    linear_acceleration: Vector


def stamp_of(header: Header) -> int:
    """Nanoseconds; 0 where nobody set it."""
    return 1_000_000_000 * int(header.stamp.sec) + int(header.stamp.nanosec)


def encoding_of(message: Message) -> str:
    return str(getattr(message, "encoding", None) or getattr(message, "format", ""))


def is_depth(message: Message, topic: str) -> bool:
    encoding = encoding_of(message)
    kind = encoding.split(";")[0].strip()
    return kind in ("16UC1", "32FC1") or "compressedDepth" in encoding or ("depth" in topic and kind == "mono16")


def values_of(message: RawImage, topic: str) -> Values:
    """(height, width) or (height, width, channels), without what pads rows."""
    if message.encoding not in RAW:
        raise Refused(f"{topic}: images are {message.encoding or 'without encoding'}; {ACCEPTED}")
    channels, size = RAW[message.encoding]
    width, data = message.width * channels * size, np.frombuffer(message.data, np.uint8)
    step = message.step or width
    if step < width or len(data) < step * message.height or width == 0 or message.height == 0:
        raise Refused(f"{topic}: an image of {message.width} x {message.height} {message.encoding} with {len(data)} bytes in "
                      f"rows of {step}, must have {width * message.height} in rows of at least {width}")
    rows = np.ascontiguousarray(data[:step * message.height].reshape(message.height, step)[:, :width])
    kind = np.dtype({1: "u1", 2: "u2", 4: "f4"}[size]).newbyteorder(">" if message.is_bigendian else "<")
    values = rows.view(kind)
    return values if channels == 1 else values.reshape(message.height, message.width, channels)


def grey_of_bayer(mosaic: Bytes) -> Bytes:
    """(R + 2 G + B) / 4: the binomial filter of 3 x 3 has these weights at each pixel of every Bayer pattern."""
    wide = np.pad(mosaic.astype(np.uint32), 1, mode="reflect")
    rows = wide[:-2] + 2 * wide[1:-1] + wide[2:]
    grey: Bytes = ((rows[:, :-2] + 2 * rows[:, 1:-1] + rows[:, 2:] + 8) // 16).astype(np.uint8)
    return grey


def bits_of(values: Values) -> int:
    """10, 12, 14 or 16, by the largest value."""
    return next(bits for bits in (10, 12, 14, 16) if int(values.max()) < 1 << bits)


class ImageWriter:
    """Writes the images of a topic. lists: rgb.txt or depth.txt, else None. first: message that tells what they are."""

    def __init__(self, folder: Path, lists: IO[str] | None, first: Message, topic: str) -> None:
        self._folder, self._lists, self._topic = folder, lists, topic
        self._depth = is_depth(first, topic) and folder.name.startswith("depth")
        self._unset = stamp_of(first.header) == 0
        self._seen: set[int] = set()
        self._doubled = 0
        self._bits = 0
        self._beyond = 0
        self.count = 0

    def write(self, message: Message, logged_ns: int) -> None:
        time_ns = logged_ns if self._unset else stamp_of(message.header)
        if time_ns in self._seen:
            self._doubled += 1
            return
        self._seen.add(time_ns)
        name = f"{time_ns:019d}"
        raw = hasattr(message, "encoding")
        file = self._write_raw(name, message) if raw else self._write_compressed(name, message)  # type: ignore[arg-type]
        if self._lists is not None:
            self._lists.write(f"{stamp_text(time_ns)} {self._folder.name}/{file}\n")
        self.count += 1

    def _write_compressed(self, name: str, message: Message) -> str:
        data = bytes(message.data)
        if "compressedDepth" in encoding_of(message):
            if "32FC1" in encoding_of(message):
                raise Refused(f"{self._topic}: compressed depth of 32FC1; accepted are 16UC1 in PNG, and raw 16UC1 and 32FC1")
            data = data[12:]  # its header has parameters of 32FC1
        kind = "png" if data.startswith(b"\x89PNG") else "jpg" if data.startswith(b"\xff\xd8") else ""
        if not kind or (self._depth and kind != "png"):
            raise Refused(f"{self._topic}: compressed images are '{encoding_of(message)}', neither "
                          f"{'PNG' if self._depth else 'JPEG nor PNG'}; {ACCEPTED}")
        (self._folder / f"{name}.{kind}").write_bytes(data)
        return f"{name}.{kind}"

    def _write_raw(self, name: str, message: RawImage) -> str:
        values = values_of(message, self._topic)
        if self._depth:
            if values.dtype.kind == "f":
                units = np.rint(np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0) / MILLIMETRE)
                values = np.where((units > 0) & (units < 65536), units, 0).astype(np.uint16)
            write_depth_png(self._folder / f"{name}.png", values)  # type: ignore[arg-type]
            return f"{name}.png"
        encoding, largest = message.encoding, 255
        if encoding == "32FC1":
            raise Refused(f"{self._topic}: images are 32FC1, which only depth images may be; {ACCEPTED}")
        if encoding in ("bgr8", "bgra8", "8UC3"):
            values = values[:, :, 2::-1]
        elif encoding == "rgba8":
            values = values[:, :, :3]
        elif encoding in ("yuv422", "uyvy"):
            values = values[:, :, 1]
        elif encoding in ("yuv422_yuy2", "yuyv"):
            values = values[:, :, 0]
        elif encoding.startswith("bayer"):
            values = grey_of_bayer(values)  # type: ignore[arg-type]
        elif RAW[encoding][1] == 2:
            self._bits = self._bits or bits_of(values)
            largest = (1 << self._bits) - 1
            self._beyond += int(values.max()) > largest
        kind = "pgm" if values.ndim == 2 else "ppm"
        write_pnm(self._folder / f"{name}.{kind}", values, largest)  # type: ignore[arg-type]
        return f"{name}.{kind}"

    def warnings(self) -> list[str]:
        said = []
        if self._unset:
            said.append(f"{self._topic}: headers have no stamps: taken are the times at which messages were recorded")
        if self._doubled:
            said.append(f"{self._topic}: {self._doubled} images left out: their stamps are those of others")
        if 0 < self._bits < 16:
            said.append(f"{self._topic}: taken for images of {self._bits} bits, by the largest value of the first")
        if self._beyond:
            said.append(f"{self._topic}: {self._beyond} images are brighter than {self._bits} bits: white there")
        return said
