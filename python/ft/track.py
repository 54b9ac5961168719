# SPDX-License-Identifier: Apache-2.0
"""The program `python -m ft track`: options, defaults and files are those of track_sequence."""

from __future__ import annotations

import argparse
import inspect
import os
import signal
import sys
import time
import warnings
from typing import TYPE_CHECKING, Any, Mapping, Optional

import numpy as np
from numpy.typing import NDArray

import ft

from . import _ft
from .map_files import load_map, require_writable, save_map
from .results import PlacedKeyframes, TrackedKeypoints
from .sequences import Settings

if TYPE_CHECKING:
    from .view import Viewer

MOST_CLOUD_POINTS = 8000
SAMPLES = 6  # frames that are drawn in the report


RIGS = {"auto": "auto", "stereo": "stereo", "rectified": "stereo", "fisheye": "stereo", "mono": "mono", "monocular": "mono",
        "rgbd": "rgbd", "mixed": "mixed"}


class Unpacking:
    """Says every few seconds how many frames of a bag or video are unpacked."""

    def __init__(self, quiet: bool) -> None:
        self._quiet, self._said = quiet, time.monotonic()

    def __call__(self, frames: int) -> None:
        if not self._quiet and time.monotonic() - self._said > 5:
            self._said = time.monotonic()
            print(f"unpack    {frames} frames", flush=True)


def open_sequence(a: argparse.Namespace) -> ft.Sequence:
    apart = None if a.max_time_difference is None else round(1e6 * a.max_time_difference)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they are printed
        sequence = ft.read_sequence(a.files, calibration=a.calibration, keep_fisheye=a.rig != "rectified", max_frames=a.frames,
                                    topics=a.topics, progress=Unpacking(a.quiet), imu=a.imu == "auto", rig=RIGS[a.rig],
                                    depth_unit=a.depth_unit, min_depth=a.min_depth,
                                    max_depth=a.max_depth, max_time_difference_ns=apart, fps=a.fps, times=a.times,
                                    image_bits=a.image_bits, masks=a.mask)
    if a.imu_time_offset is not None and sequence.imu is not None:
        sequence.imu.time_offset_s = a.imu_time_offset
    if a.readout is not None:
        for part in sequence.rig.cameras if isinstance(sequence.rig, ft.MultiRig) else [sequence.rig]:
            part.readout_s = 1e-3 * a.readout
    for text in sequence.warnings:
        print(f"ft: warning: {text}", file=sys.stderr)
    if a.rig == "fisheye" and not isinstance(sequence.rig, ft.FisheyePair):
        raise ValueError(f"--rig fisheye: the cameras of {a.folder} are not a pair of Kannala-Brandt cameras")
    if a.frame == "body" and sequence.kind == "mono":
        raise ValueError("--frame body: with one camera (--rig mono) the scale may be unknown, and then so are the poses of "
                         "the body")
    if a.frame == "body" and not sequence.has_body_frame:
        raise ValueError(f"--frame body: the calibration of {a.folder} does not say where the body is")
    if not sequence.depth_unit and (a.depth_unit, a.min_depth, a.max_depth) != (None, 0.0, None):
        raise ValueError(f"--depth-unit, --min-depth, --max-depth: no depth images of {a.folder} are used")
    return sequence


def make_odometry(arguments: argparse.Namespace, sequence: ft.Sequence,
                  measure_stages: bool) -> tuple[ft.Odometry, Settings]:
    """The settings file's values where the command line has none."""
    settings = sequence.settings.copy()
    settings.setdefault("features", 2000 if sequence.width > 1000 else 1200)
    if arguments.features:
        settings["features"] = arguments.features
    if arguments.near is not None:
        settings["near_depth"] = arguments.near
    slots = max(1 << 14, 8 * settings["features"])
    local, window = 1 << 13, 1 << 12
    if isinstance(sequence.rig, ft.MultiRig):  # of all cameras
        slots, local, window = max(1 << 15, slots), 12288, 12288
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the calibration, which are printed
        odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, imu=sequence.imu, device=arguments.backend,
                               threads=arguments.threads, loops=arguments.loops, localize_only=arguments.localize_only,
                               measure_stages=measure_stages, map_slots=slots, local_points=local, window_points=window,
                               corner_ratio=arguments.corner_ratio,
                               mask_size=(sequence.width, sequence.height) if sequence.masked else (0, 0), **settings)
    if arguments.load_map:
        load_map(arguments.load_map, odometry)
    return odometry, settings


def value_of(settings: Settings, name: str) -> Any:
    """Of a setting of ft.Odometry, whose default holds where there is none."""
    return settings.get(name, inspect.signature(ft.Odometry).parameters[name].default)


def duration_text(seconds: float) -> str:
    whole = int(seconds + 0.5)
    if whole < 60:
        return f"{whole} s"
    return f"{whole // 60} min {whole % 60} s" if whole < 3600 else f"{whole // 3600} h {whole % 3600 // 60} min"


class Progress:
    """One line that changes on a terminal; elsewhere a line every 10 %."""

    def __init__(self, total: int, quiet: bool) -> None:
        self._total, self._quiet, self._terminal = total, quiet, sys.stdout.isatty()
        self._begin, self._drawn, self._tenth = time.monotonic(), -1.0, 0

    def step(self, done: int, note: str = "") -> None:
        now = time.monotonic()
        if self._terminal:
            show = done == self._total or now - self._drawn > 0.1
        else:
            show = 10 * done // self._total > self._tenth
        if self._quiet or not show:
            return
        self._drawn, self._tenth = now, 10 * done // self._total
        rate = done / max(now - self._begin, 1e-6)
        left = f"  ETA {duration_text((self._total - done) / rate)}" if done < self._total else ""
        text = f"track  {done}/{self._total}  {100 * done // self._total} %  {rate:.{1 if rate < 1000 else 0}f} frames/s{left}"
        print(f"\r{text}  {note}\033[K" if self._terminal else f"{text}  {note}".rstrip(), end="" if self._terminal else "\n",
              flush=True)

    def finish(self) -> None:
        if self._terminal and not self._quiet and self._drawn >= 0:
            print(flush=True)


class Run:
    """What is known about a run so far."""

    def __init__(self, arguments: argparse.Namespace, sequence: ft.Sequence, odometry: ft.Odometry,
                 viewer: Optional[Viewer], calibration: list[str]) -> None:
        self._arguments, self._sequence, self._odometry, self._viewer = arguments, sequence, odometry, viewer
        self._calibration = calibration
        self._camera = sequence.left_camera
        self._samples_due = {(2 * k + 1) * len(sequence) // (2 * SAMPLES) for k in range(SAMPLES)}
        if len(sequence) <= SAMPLES:
            self._samples_due = set(range(len(sequence)))
        self._imu = iter(sequence.imu_samples)
        self._imu_time_offset_s = sequence.imu.time_offset_s if sequence.imu is not None else 0.0
        self._before: tuple[int, dict[int, tuple[float, float]]] = (-1, {})
        self._cloud, self._cloud_step = np.zeros((0, 3), np.float32), 1
        self._stage_names: list[str] = []
        self.records: list[tuple[int, int, bool, dict[str, float], float, ft.Tracking]] = []
        self.poses: list[tuple[int, NDArray[np.float64]]] = []
        self._odom_poses: list[NDArray[np.float64]] = []
        self.samples: list[tuple[int, NDArray[np.uint8], list[tuple[float, float, float, int, float, bool, float, float]]]] = []
        self.metric = sequence.kind != "mono"
        self._T_world_odom = np.eye(4)  # of the last frame that was shown
        self._found_after = 0  # frames until the camera was found in a loaded map
        self._first_found = 0  # of the poses: those before are in another world, until loops join it
        self._date = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        self.stopped_at: Optional[int] = None
        self.stopped_by = ""
        self.last: Optional[ft.Tracking] = None

    def track_all(self) -> None:
        progress = Progress(len(self._sequence), self._arguments.quiet)
        begin, i = time.monotonic(), 0
        try:
            for i in range(len(self._sequence)):
                try:
                    frame = self._sequence[i]
                except RuntimeError as e:
                    self.stopped_at, self.stopped_by = i, str(e)
                    break
                progress.step(i + 1, "" if self._track(i, frame) else "lost")
        except KeyboardInterrupt as e:
            self.stopped_at, self.stopped_by = len(self.records), str(e) or "SIGINT"
        progress.finish()
        self.wall_s = time.monotonic() - begin

    def _track(self, i: int, frame: ft.Frame) -> bool:
        # A recording has what comes soon after a frame, too: the IMU's clock may be ahead.
        until_ns = frame.time_ns + round(1e9 * (0.08 + self._imu_time_offset_s))
        for sample in self._imu:
            self._odometry.add_imu(*sample)
            if sample[0] >= until_ns:
                break
        self._odometry.set_masks(frame.masks)
        begin = time.perf_counter()
        pose = self._odometry.track(*frame.images, frame.time_ns)
        total = 1e3 * (time.perf_counter() - begin)
        tracked = pose.tracked and pose.reason != "new_map"  # whose place is guessed
        times_us = self._odometry.stage_times_us() if self._arguments.timing or self._viewer else {}
        stages = {name: 1e-3 * us for name, us in times_us.items()}
        self._stage_names += [name for name in stages if name not in self._stage_names]
        self.records.append((i, frame.time_ns, tracked, stages, total, pose))
        if tracked and pose.metric and not self.metric:
            self.metric, self.poses, self._odom_poses, self._first_found = True, [], [], 0  # those before have an unknown scale
        if tracked and pose.map_id <= 1 and not self._found_after:  # one that is not joined has a larger number
            self._found_after, self._first_found = len(self.records), len(self.poses)
        if tracked and pose.metric == self.metric:
            self.poses.append((frame.time_ns, pose.T_world_camera))
            self._odom_poses.append(pose.T_odom_camera)
        self._look(i, frame.left, pose, tracked)
        if self._viewer is not None:
            self._show(self._viewer, i, frame, pose, tracked, {**stages, "total": total})
        self.last = pose
        return tracked

    def _seen(self) -> TrackedKeypoints:
        """Keypoints of the left camera, which is the first one of a rig."""
        return self._odometry.keypoints().of_camera(0)

    def _look(self, i: int, image: NDArray[np.uint8], pose: ft.Tracking, tracked: bool) -> None:
        """Keeps points that a keyframe begins, and frames for the report."""
        begins = tracked and pose.keyframe
        sample = i in self._samples_due
        if not begins and not sample and i + 1 not in self._samples_due:
            return
        k = self._seen()
        at = np.stack([k.x, k.y], axis=1)
        if begins:
            new = (k.point >= 0) & ~k.matched & (k.depth > 0)
            rays, valid = self._camera.unproject(at[new].astype(np.float64))
            valid &= rays[:, 2] > 0
            points = k.depth[new][valid, None] * rays[valid] / rays[valid, 2:]
            T = pose.T_world_camera
            added = (points @ T[:3, :3].T + T[:3, 3])[::self._cloud_step].astype(np.float32)
            self._cloud = np.concatenate([self._cloud, added])
            while len(self._cloud) >= MOST_CLOUD_POINTS:
                self._cloud, self._cloud_step = self._cloud[::2], 2 * self._cloud_step
        if sample:
            last, seen = self._before
            drawn = []
            for n, (x, y) in enumerate(at.tolist()):
                point = int(k.point[n])
                from_x, from_y = seen.get(point, (-1, -1)) if last == i - 1 and k.matched[n] else (-1, -1)
                octave = int(k.octave[n])
                size = 31.0 * self._odometry.scale_factor ** octave
                drawn.append((x, y, size, octave, float(k.depth[n]), bool(k.matched[n]), from_x, from_y))
            self.samples.append((i, image, drawn))
        self._before = i, {int(p): (x, y) for p, (x, y) in zip(k.point, at.tolist()) if p >= 0}

    def _show(self, viewer: Viewer, i: int, frame: ft.Frame, pose: ft.Tracking, tracked: bool,
              milliseconds: Mapping[str, float]) -> None:
        from .view import Corrected, Seen

        corrected = None
        if not np.array_equal(pose.T_world_odom, self._T_world_odom):
            self._T_world_odom = pose.T_world_odom
            corrected = Corrected.of(self._odometry.placed_keyframes(), self._odometry.closed_loops())

        counts = {"keypoints": pose.keypoints, "with depth": pose.stereo_points, "inliers": pose.inliers,
                  "local map": pose.local_points}
        viewer.show(Seen(i, frame.time_ns, frame.left, tracked, pose.keyframe, pose.T_world_camera,
                         self._seen(), counts, milliseconds, corrected),
                    self._odometry.map() if tracked and pose.keyframe else None)

    def _corrected(self) -> list[tuple[int, NDArray[np.float64]]]:
        """Each pose moves with the last keyframe that is not after it."""
        placed = self._odometry.placed_keyframes()
        # Those of a loaded map are before all poses, whatever their times.
        times = np.where(placed.loaded, np.iinfo(np.int64).min, placed.time_ns)
        last = np.searchsorted(times, [t for t, _ in self.poses], "right") - 1
        inverse = np.linalg.inv(placed.T_odom_camera)

        def moved(T: NDArray[np.float64], k: int) -> NDArray[np.float64]:
            step = inverse[k] @ T
            step[:3, 3] *= placed.scale[k]
            moved_pose: NDArray[np.float64] = placed.T_world_camera[k] @ step
            return moved_pose

        return [(t, moved(T, k) if k >= 0 else T) for (t, _), T, k in zip(self.poses, self._odom_poses, last)]

    def _edges(self, placed: PlacedKeyframes) -> list[tuple[object, ...]]:
        """The loops, as write_run() takes them."""
        closed, T = self._odometry.closed_loops(), placed.T_world_camera
        return [(int(placed.time_ns[a]), T[a], int(placed.time_ns[b]), T[b], inliers, bool(placed.loaded[a]))
                for a, b, inliers in zip(closed.from_keyframe, closed.to_keyframe, closed.inliers.tolist())]

    def write(self, settings: Settings) -> None:
        """The files that track_sequence writes. Prints its summary."""
        a, sequence, last = self._arguments, self._sequence, self.last
        stages = self._stage_names if a.timing else []
        made = self._odometry.map()
        T = last.T_world_odom if last else np.eye(4)  # the map's points are in the frame of the odometry
        scale = last.odom_scale if last else 1.0
        pair = {ft.FisheyePair: "fisheye", ft.MultiRig: "mixed"}.get(type(sequence.rig), "rectified")
        rig = {"mono": "monocular", "rgbd": "rgbd"}.get(sequence.kind, pair)
        online = ft.Trajectory.of(self.poses[self._first_found:])
        trajectory = ft.Trajectory.of(self._corrected()) if a.loops else online
        closed = [pose.loops_closed for *_, pose in self.records]
        tracked = [(t, T) for (t, _), T in zip(self.poses, self._odom_poses)]
        placed = self._odometry.placed_keyframes()
        loops = {"closed": sum(closed), "corrections": sum(n > 0 for n in closed),
                 "edges": self._edges(placed),
                 "maps": len(np.unique(placed.map[~placed.loaded])),
                 "online_time_ns": online.time_ns, "online": online.poses, "tracked": ft.Trajectory.of(tracked).poses} if a.loops else None
        sys.stdout.flush()
        _ft.write_run(sequence.files, a.out, a.frame, a.poses, {
            "version": ft.__version__, "command": ["python", "-m", "ft", *sys.argv[1:]], "date": self._date,
            "threads": 0 if backend_of(a.backend) == "cuda" else threads_of(a.threads),
            "backend": backend_of(a.backend), "width": sequence.width, "height": sequence.height,
            "options": {"features": str(settings["features"]), "levels": str(value_of(settings, "levels")),
                        "layout": sequence.layout, "rig": rig, "frame": a.frame,
                        "near points, baselines": f"{value_of(settings, 'near_depth'):f}"},
            "stages": [*stages, "total"],
            "records": [(i, t, tracked, [*(ms.get(name, 0.0) for name in stages), total], pose)
                        for i, t, tracked, ms, total, pose in self.records],
            "keyframes": last.keyframes if last else 0, "map_points": len(made.position),
            "maps": last.maps if last else 0, "one_camera": rig == "monocular", "depth_images": rig == "rgbd",
            "with_imu": sequence.imu is not None, "calibration": self._calibration,
            "warnings": sequence.warnings,
            "loops": loops, "loaded_map": (a.load_map, self._found_after) if a.load_map else None,
            "metric": self.metric, "time_ns": trajectory.time_ns, "poses": trajectory.poses, "samples": self.samples,
            "cloud": self._cloud.tolist(), "stopped_at": self.stopped_at, "stopped_by": self.stopped_by, "wall_s": self.wall_s,
            "map_position": (scale * made.position @ T[:3, :3].T + T[:3, 3]).tolist(),
            "map_normal": (made.normal @ T[:3, :3].T).tolist(),
        })


def threads_of(wanted: int) -> int:
    """No more threads run than there are cores for this process."""
    most = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(wanted, most) if wanted else most


def backend_of(wanted: str) -> str:
    return "cuda" if wanted != "host" and len(ft.devices()) > 1 else "host"


def viewer_of(arguments: argparse.Namespace, sequence: ft.Sequence) -> Optional[Viewer]:
    """A viewer, or None. Raises view.MissingPackage."""
    if not arguments.view and arguments.record is None:
        return None
    from . import view

    return view.Viewer(view.open_rerun(arguments.record), sequence.left_camera, sequence.width, sequence.height,
                       sequence.ground_truth, sequence.ground_truth_has_orientation)


def end_as_ctrl_c(*_: object) -> None:
    raise KeyboardInterrupt("SIGTERM")


def track(arguments: argparse.Namespace) -> int:
    """Returns the exit status: 0; 1 where no frame could be tracked; 3 for a run that was stopped."""
    signal.signal(signal.SIGTERM, end_as_ctrl_c)
    sequence = open_sequence(arguments)
    viewer = viewer_of(arguments, sequence)
    _ft.make_output_folder(arguments.out, arguments.folder)
    if arguments.save_map:
        require_writable(arguments.save_map)
    odometry, settings = make_odometry(arguments, sequence, arguments.timing or viewer is not None)
    for name, text in sequence.describe(arguments.imu == "auto"):
        print(f"{name:<10}{text}")
    if sequence.depth_unit:
        most = float("inf") if arguments.max_depth is None else arguments.max_depth
        print(f"depth     taken from {arguments.min_depth:g} to {most:g} m")
    backend = backend_of(arguments.backend)
    no_gpu = arguments.backend == "auto" and backend == "host"
    print(f"backend   {backend}{'; no GPU, or built without CUDA' if no_gpu else ''}")
    calibration = [f"{found.name}: {found.text}" for found in ft.check_calibration(sequence.rig, sequence.width, sequence.height)]
    for text in calibration:
        print(f"warning   calibration: {text}")
    run = Run(arguments, sequence, odometry, viewer, calibration)
    run.track_all()
    if viewer is not None:
        viewer.finish()
    run.write(settings)
    if arguments.save_map and any(record[2] for record in run.records):
        save_map(arguments.save_map, odometry)
    if run.stopped_at is not None:
        print(f"ft: stopped at frame {run.stopped_at}: {run.stopped_by}", file=sys.stderr)
        return 3
    if not any(record[2] for record in run.records):
        why = {"mono": "the camera does not move enough, or too few corners are seen",
               "rgbd": "too few corners have a depth"}.get(sequence.kind, "too few corners are seen by both cameras")
        if arguments.localize_only:
            why = "the camera was not found in the map"
        last = run.last.explanation if run.last else "it has no frame"
        print(f"ft: {arguments.folder}: no frame could be tracked: {why} (--features {settings['features']}); {last}",
              file=sys.stderr)
        return 1
    return 0
