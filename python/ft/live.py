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
from typing import Iterable, Iterator, Optional

import numpy as np
import numpy.typing as npt

from ._ft import Tracking
from .live_cameras import PATIENCE_S, LiveFrame, Oak, OpenCvCamera, RealSense, Sample, Source
from .odometry import Odometry
from .rigs import check_calibration
from .sequences import Trajectory
from .view import Seen, Viewer, open_rerun

Matrix = npt.NDArray[np.float64]


def open_source(a: argparse.Namespace) -> Source:
    size = None
    if a.size is not None:
        try:
            width, height = (int(n) for n in a.size.split("x"))
            if width < 1 or height < 1:
                raise ValueError
        except ValueError:
            raise ValueError(f"--size: is {a.size}, must be WxH, such as 640x480") from None
        size = width, height
    if a.camera in ("realsense", "oak"):
        if a.parameters or a.fisheye or a.readout:
            raise ValueError(f"--camera {a.camera}: its calibration is the device's: no --parameters, --fisheye or --readout")
        device = RealSense if a.camera == "realsense" else Oak
        given = {"size": size, "fps": a.fps and round(a.fps)}
        return device(imu=a.imu == "auto", **{k: v for k, v in given.items() if v is not None})
    if not a.parameters:
        raise ValueError(f"--camera {a.camera}: needs --parameters fx fy cx cy [k1 k2 p1 p2 ...], pixels: calibrate it with OpenCV or "
                         "Kalibr")
    return OpenCvCamera(a.camera, a.parameters, fisheye=a.fisheye, size=size, fps=a.fps, readout_s=1e-3 * a.readout)


class Newest:
    """Iterates over the newest frames of a camera: those that come while one is tracked are left out, but for the samples of
    the IMU. A thread takes them, and closes the camera. What the camera raises is raised here."""

    def __init__(self, source: Source) -> None:
        self.dropped = 0
        self._ready = threading.Condition()
        self._frame: Optional[LiveFrame] = None
        self._error: Optional[BaseException] = None
        self._ended = False
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._take, args=(source,), daemon=True)
        self._thread.start()

    def _take(self, source: Source) -> None:
        error: Optional[BaseException] = None
        try:
            for frame in source.frames(self._stopped.is_set):
                with self._ready:
                    if self._frame is not None:
                        self.dropped += 1
                        frame = frame._replace(imu=self._frame.imu + frame.imu)
                    self._frame = frame
                    self._ready.notify()
        except Exception as e:  # handed on
            error = e
        try:
            source.close()
        except Exception as e:
            error = error or e
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
        """Waits until the camera is closed, at most some seconds."""
        self._stopped.set()
        self._thread.join(2 * PATIENCE_S)


def track(source: Source, a: argparse.Namespace) -> int:
    """Returns the exit status: 0; 1 where no frame was tracked. Closes the camera."""
    file = Path(a.out) / "trajectory.txt"
    newest: Optional[Newest] = None
    viewer: Optional[Viewer] = None
    run = Run(a)
    try:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as e:
            raise RuntimeError(f"--out {a.out}: {e}") from None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they are printed
            odometry = Odometry(source.rig, source.width, source.height, imu=source.imu, device=a.backend, threads=a.threads,
                                features=a.features)
        found = [f"calibration: {w.text}" for w in check_calibration(source.rig, source.width, source.height)]
        for text in source.warnings + found:
            print(f"ft: warning: {text}", file=sys.stderr)
        print(f"camera    {source.name}, {source.width}x{source.height}, {'with' if source.imu is not None else 'without'} an IMU",
              flush=True)
        if a.view or a.record is not None:
            viewer = Viewer(open_rerun(a.record), source.rig.camera, source.width, source.height)
        newest = Newest(source) if source.live else None
        run.track_all(newest or source.frames(), odometry, viewer, source.imu is not None)
    except KeyboardInterrupt:
        print()
    finally:
        if run.poses:  # first, whatever the devices do
            Trajectory.of(run.poses).write_tum(str(file))
        for stop in (signal.SIGINT, signal.SIGTERM):
            signal.signal(stop, signal.SIG_DFL)
        if newest is not None:
            newest.stop()
        else:
            source.close()
        if viewer is not None:
            viewer.finish()
        if run.frames:
            dropped = newest.dropped if newest is not None else 0
            print(f"{run.frames} frames, {len(run.poses)} tracked, {dropped} left out" + (f"; {file}" if run.poses else ""))
            if not run.metric:
                print("one camera: the unit of length is unknown, not the metre")
    return 0 if run.poses else 1


class Run:
    """What was tracked."""

    def __init__(self, a: argparse.Namespace) -> None:
        self._a = a
        self.frames, self.poses, self.metric = 0, list[tuple[int, Matrix]](), True
        self._before, self._spent, self._said = 0, 0.0, time.monotonic()

    def track_all(self, frames: Iterable[LiveFrame], odometry: Odometry, viewer: Optional[Viewer], imu: bool) -> None:
        a, begin, samples = self._a, time.monotonic(), 0
        self._said = begin
        for frame in frames:
            for sample in frame.imu:
                odometry.add_imu(*sample)
            samples += len(frame.imu)
            started = time.perf_counter()
            pose = odometry.track(*frame.images, frame.time_ns)
            self._spent += time.perf_counter() - started
            self.frames += 1
            if pose.tracked:
                self.poses.append((frame.time_ns, pose.T_world_camera))
                self.metric = pose.metric
            if viewer is not None:
                show(viewer, self.frames - 1, frame, pose, odometry)
            now = time.monotonic()
            if now - self._said >= 1:
                self._say(pose, now)
            if imu and samples == 0 and now - begin > PATIENCE_S:
                imu = False
                print("ft: warning: no samples of the IMU: its two sensors and the images have different clocks, or one of them "
                      "is silent", file=sys.stderr)
            if (a.frames and self.frames >= a.frames) or (a.seconds is not None and now - begin >= a.seconds):
                return

    def _say(self, pose: Tracking, now: float) -> None:
        n = max(self.frames - self._before, 1)
        where = " ".join(f"{v:.2f}" for v in pose.T_world_camera[:3, 3]) if pose.tracked else f"lost: {pose.reason}"
        if not self._a.quiet:
            print(f"{self.frames} frames  {n / (now - self._said):.0f}/s  {1e3 * self._spent / n:.1f} ms  {where}  "
                  f"{pose.inliers} inliers" + "".join(f"  {name}" for name in pose.warnings), flush=True)
        self._said, self._before, self._spent = now, self.frames, 0.0


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
