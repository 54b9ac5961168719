# SPDX-License-Identifier: Apache-2.0
"""Maps of `python -m ft track` as files: --load-map and --save-map."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from .odometry import Odometry


def load_map(path: str, odometry: Odometry) -> None:
    try:
        odometry.load_map(Path(path).read_bytes())
    except (OSError, RuntimeError) as e:  # no map, or one of another rig
        raise RuntimeError(f"--load-map {path}: {e.strerror if isinstance(e, OSError) else e}") from e


def require_writable(path: str) -> None:
    """Before the run, too."""
    part = Path(path + ".partial")
    if Path(path).exists() and not Path(path).is_dir() and not Path(path).is_file():  # a device would be replaced by the file
        raise RuntimeError(f"--save-map {path}: cannot be written: not a plain file")
    try:
        if Path(path).is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        part.touch()
        part.unlink()
    except OSError as e:
        raise RuntimeError(f"--save-map {path}: cannot be written: {e.strerror}") from e


def save_map(path: str, odometry: Odometry) -> None:
    """An older file stays until all is written."""
    part = Path(path + ".partial")
    try:
        part.write_bytes(odometry.save_map())
        part.replace(path)
    except (OSError, RuntimeError, ValueError) as e:
        part.unlink(missing_ok=True)
        raise RuntimeError(f"--save-map {path}: {e.strerror if isinstance(e, OSError) else e}") from e
    print(f"map       saved to {path}, {round(1e-6 * os.path.getsize(path))} MB")
