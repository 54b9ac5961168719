# SPDX-License-Identifier: Apache-2.0
"""The program `python -m ft live`: tracks a camera that is plugged in, until Ctrl-C."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
import warnings
from pathlib import Path
from typing import Iterator, Optional

from ._ft import Tracking
from .live_cameras import LiveFrame, Oak, OpenCvCamera, RealSense, Sample, Source
from .odometry import Odometry
from .rigs import check_calibration
from .sequences import Trajectory
from .view import Seen, Viewer, open_rerun


def open_source(a: argparse.Namespace) -> Source:
    size = None
    if a.size is not None:
        try:
            width, height = (int(n) for n in a.size.split("x"))
        except ValueError:
            raise ValueError(f"--size: is {a.size}, must be WxH, such as 640x480") from None
        size = width, height
    if a.camera in ("realsense", "oak"):
        if a.parameters or a.fisheye:
            raise ValueError(f"--camera {a.camera}: its calibration is the device's: no --parameters, no --fisheye")
        device = RealSense if a.camera == "realsense" else Oak
        given = {"size": size, "fps": a.fps and round(a.fps)}
        return device(imu=a.imu == "auto", **{k: v for k, v in given.items() if v is not None})
    if not a.parameters:
        raise ValueError(f"--camera {a.camera}: needs --parameters fx fy cx cy [k1 k2 p1 p2 ...], pixels: calibrate it with OpenCV or "
                         "Kalibr")
    return OpenCvCamera(a.camera, a.parameters, fisheye=a.fisheye, size=size, fps=a.fps)


class Newest:
    """Iterates over the newest frames of a camera: those that come while one is tracked are left out, but for the samples of
    the IMU. A thread takes them. What the camera raises is raised here."""

    def __init__(self, source: Source) -> None:
        self.dropped = 0
        self._ready = threading.Condition()
        self._frame: Optional[LiveFrame] = None
        self._error: Optional[BaseException] = None
        self._ended = False
        threading.Thread(target=self._take, args=(source,), daemon=True).start()

    def _take(self, source: Source) -> None:
        error: Optional[BaseException] = None
        try:
            for frame in source.frames():
                with self._ready:
                    if self._ended:
                        return
                    if self._frame is not None:
                        self.dropped += 1
                        frame = frame._replace(imu=self._frame.imu + frame.imu)
                    self._frame = frame
                    self._ready.notify()
        except Exception as e:  # handed on
            error = e
        with self._ready:
            self._ended, self._error = True, error
            self._ready.notify()

    def __iter__(self) -> Iterator[LiveFrame]:
        while True:
            with self._ready:
                while self._frame is None and not self._ended:
                    self._ready.wait(0.1)  # so that Ctrl-C comes through
                frame, self._frame = self._frame, None
                if frame is None:
                    if self._error is not None:
                        raise self._error
                    return
            yield frame

    def stop(self) -> None:
        with self._ready:
            self._ended = True


def track(source: Source, a: argparse.Namespace) -> int:
    """Returns the exit status: 0; 1 where no frame was tracked."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they are printed
        odometry = Odometry(source.rig, source.width, source.height, imu=source.imu, device=a.backend, threads=a.threads,
                            features=a.features)
    found = [f"calibration: {w.text}" for w in check_calibration(source.rig, source.width, source.height)]
    for text in source.warnings + found:
        print(f"ft: warning: {text}", file=sys.stderr)
    print(f"camera    {source.name}, {source.width}x{source.height}, {'with' if source.imu is not None else 'without'} an IMU",
          flush=True)
    viewer = viewer_of(a, source)
    newest = Newest(source) if source.live else None
    poses = []
    frames = tracked = before = 0
    metric = True
    spent, begin, said = 0.0, time.monotonic(), time.monotonic()
    try:
        for frame in newest or source.frames():
            for sample in frame.imu:
                odometry.add_imu(*sample)
            started = time.perf_counter()
            pose = odometry.track(*frame.images, frame.time_ns)
            spent += time.perf_counter() - started
            frames += 1
            if pose.tracked:
                tracked += 1
                poses.append((frame.time_ns, pose.T_world_camera))
                metric = pose.metric
            if viewer is not None:
                show(viewer, frames - 1, frame, pose, odometry)
            now = time.monotonic()
            if now - said >= 1 and not a.quiet:
                n = max(frames - before, 1)
                where = " ".join(f"{v:.2f}" for v in pose.T_world_camera[:3, 3]) if pose.tracked else f"lost: {pose.reason}"
                print(f"{frames} frames  {n / (now - said):.0f}/s  {1e3 * spent / n:.1f} ms  {where}  {pose.inliers} inliers"
                      + "".join(f"  {name}" for name in pose.warnings), flush=True)
                said, before, spent = now, frames, 0.0
            if (a.frames and frames >= a.frames) or (a.seconds is not None and now - begin >= a.seconds):
                break
    except KeyboardInterrupt:
        print()
    finally:
        if newest is not None:
            newest.stop()
        source.close()
        if viewer is not None:
            viewer.finish()
        if poses:
            Path(a.out).mkdir(parents=True, exist_ok=True)
            Trajectory.of(poses).write_tum(str(Path(a.out) / "trajectory.txt"))
    dropped = newest.dropped if newest is not None else 0
    print(f"{frames} frames, {tracked} tracked, {dropped} left out" + (f"; {Path(a.out) / 'trajectory.txt'}" if poses else ""))
    if not metric:
        print("one camera: the unit of length is unknown, not the metre")
    return 0 if poses else 1


def viewer_of(a: argparse.Namespace, source: Source) -> Optional[Viewer]:
    if not a.view and a.record is None:
        return None
    return Viewer(open_rerun(a.record), source.rig.camera, source.width, source.height)


def show(viewer: Viewer, index: int, frame: LiveFrame, pose: Tracking, odometry: Odometry) -> None:
    counts = {"keypoints": pose.keypoints, "inliers": pose.inliers, "local map": pose.local_points}
    viewer.show(Seen(index, frame.time_ns, frame.images[0], pose.tracked, pose.keyframe, pose.T_world_camera,
                     odometry.keypoints(), counts), odometry.map() if pose.tracked and pose.keyframe else None)


def live(a: argparse.Namespace) -> int:
    def end(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)
    return track(open_source(a), a)


__all__ = ["LiveFrame", "Newest", "Sample", "Source", "live", "open_source", "track"]
