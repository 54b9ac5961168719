# SPDX-License-Identifier: Apache-2.0
"""Images for the notebooks: a stereo camera in a room with textured walls, drawn with NumPy, and a short sequence on disk,
made by the program generate_sequence where it is found. Lengths are in metres, pixels count from the centre of the first."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import tempfile
import zlib
from pathlib import Path
from typing import Optional

import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]
Reals = NDArray[np.float64]

WIDTH, HEIGHT = 480, 320
CAMERA = (300.0, 300.0, 239.5, 159.5)  # fx, fy, cx, cy
BASELINE = 0.11
FRAME_NS = 50_000_000
HALF_ROOM = np.array([3.0, 1.6, 6.0])  # x right, y down, z forward, as in a camera
TEXEL = 0.02


def walls(seed: int = 1, size: int = 640) -> Reals:
    """Grey squares of several sizes, a little smoothed: (6, size, size)."""
    random = np.random.default_rng(seed)
    all_walls = np.full((6, size, size), 110.0)
    for wall in all_walls:
        for _ in range(1500):
            w, h = random.integers(4, 40, 2)
            x, y = random.integers(0, size, 2)
            wall[y:y + h, x:x + w] = random.integers(20, 236)
    for axis in (1, 2):
        all_walls = (np.roll(all_walls, 1, axis) + 2 * all_walls + np.roll(all_walls, -1, axis)) / 4
    return all_walls


def draw(textures: Reals, T_world_camera: Reals) -> tuple[Grey, Reals]:
    """What a pinhole camera sees: the image (height, width) uint8 and the depth along its axis, (height, width)."""
    fx, fy, cx, cy = CAMERA
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], axis=-1) @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    rays[rays == 0] = 1e-12
    reach = (np.sign(rays) * HALF_ROOM - origin) / rays  # of the wall on each axis
    axis = reach.argmin(axis=-1)
    depth = reach.min(axis=-1)
    texels = (origin + depth[..., None] * rays + HALF_ROOM) / TEXEL
    on_wall = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    at = np.take_along_axis(texels, on_wall, axis=-1) % (textures.shape[1] - 1)
    column, row = np.floor(at).astype(int).transpose(2, 0, 1)
    a, b = (at - np.floor(at)).transpose(2, 0, 1)
    wall = 2 * axis + (np.take_along_axis(rays, axis[..., None], axis=-1)[..., 0] > 0)
    grey = ((1 - b) * ((1 - a) * textures[wall, row, column] + a * textures[wall, row, column + 1])
            + b * ((1 - a) * textures[wall, row + 1, column] + a * textures[wall, row + 1, column + 1]))
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), depth


def pose(i: int) -> Reals:
    """T_world_camera of frame i: a walk forward that sways and turns."""
    turn = 0.3 * np.sin(0.06 * i)
    T = np.eye(4)
    T[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    T[:3, 3] = (0.5 * np.sin(0.08 * i), 0.1 * np.sin(0.15 * i), -3.0 + 0.04 * i)
    return T


def pair(textures: Reals, i: int) -> tuple[Grey, Grey, Reals]:
    """Left image, right image and left depth of frame i."""
    T = pose(i)
    left, depth = draw(textures, T)
    T[:3, 3] += BASELINE * T[:3, 0]
    return left, draw(textures, T)[0], depth


def write_png(file: Path, image: Grey) -> None:
    """An 8-bit grey PNG."""
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    height, width = image.shape
    rows = np.pad(image, ((0, 0), (1, 0))).tobytes()  # each row begins with its filter, 0
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
                     + chunk(b"IDAT", zlib.compress(rows, 1)) + chunk(b"IEND", b""))


def draw_sequence(folder: Path, frames: int) -> None:
    """Writes frames in KITTI's layout, with poses.txt as ground truth."""
    textures = walls()
    for camera in (0, 1):
        (folder / f"image_{camera}").mkdir(parents=True)
    for i in range(frames):
        for camera, image in enumerate(pair(textures, i)[:2]):
            write_png(folder / f"image_{camera}" / f"{i:06d}.png", image)
    (folder / "times.txt").write_text("".join(f"{1e-9 * FRAME_NS * i:.9f}\n" for i in range(frames)))
    fx, fy, cx, cy = CAMERA
    (folder / "calib.txt").write_text("".join(
        f"P{c}: {fx} 0 {cx} {-fx * BASELINE * c} 0 {fy} {cy} 0 0 0 1 0\n" for c in (0, 1)))
    np.savetxt(folder / "poses.txt", [pose(i)[:3].ravel() for i in range(frames)])


def generator() -> Optional[str]:
    """The program generate_sequence: named by FT_GENERATE_SEQUENCE, on the path or in the build folder; or None."""
    named = os.environ.get("FT_GENERATE_SEQUENCE")
    if named is not None:
        return named or None  # empty: none
    built = Path(__file__).resolve().parents[2] / "build/bin/generate_sequence"
    return shutil.which("generate_sequence") or (str(built) if built.exists() else None)


def sequence(frames: int = 24) -> Path:
    """The folder of a new sequence, in the folder for temporary files. A generated camera is at
    rest in the first second."""
    folder = Path(tempfile.mkdtemp(prefix="ft_notebook_")) / "sequence"
    program = generator()
    if program:
        subprocess.run([program, "--out", str(folder), "--frames", str(frames), "--width", str(WIDTH), "--height",
                        str(HEIGHT), "--fps", "10", "--no-imu"], check=True, capture_output=True)
    else:
        draw_sequence(folder, frames)
    return folder
