# SPDX-License-Identifier: Apache-2.0
"""What a run looks like, in the viewer rerun (package rerun-sdk, 0.23 or newer): as it goes, or in a file.

Entities: world/camera/left (image, keypoints, matches, depths), world/map, world/keyframes, world/trajectory, world/truth;
world/corrected is the path of the keyframes as loops have corrected it, world/loops joins those that they have recognised;
counts/NAME and milliseconds/STAGE are plots. The world is the first left camera: x right, y down, z forward, metres. On the
timeline `frame` are the numbers of frames, on `time` their time stamps.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, Callable, Iterator, Mapping, Optional, Sequence, Union, cast

import numpy as np
from numpy.typing import NDArray

from . import _ft
from .results import ClosedLoops, Map, PlacedKeyframes, TrackedKeypoints
from .rigs import Camera
from .sequences import Trajectory, evaluate

Floats = NDArray[np.float64]

FORMAT = 1  # of recordings
WHITE, GREEN, ORANGE, GREY, RED = [255, 255, 255], [60, 220, 90], [255, 160, 40], [150, 150, 150], [240, 60, 60]
BLUE, YELLOW = [80, 140, 255], [250, 230, 60]


class MissingPackage(RuntimeError):
    """A package that a viewer or a recording needs is not installed."""


@dataclass
class Corrected:
    """What loops have made of the path: pieces of it, (n, 3) each, and the ends of loops, (m, 2, 3)."""

    path: list[Floats]
    loops: Floats

    @classmethod
    def of(cls, placed: PlacedKeyframes, closed: ClosedLoops) -> Corrected:
        """A piece is of one map and one run."""
        places = placed.T_world_camera[:, :3, 3]
        cuts = np.flatnonzero((np.diff(placed.map) != 0) | np.diff(placed.loaded)) + 1
        return cls(np.split(places, cuts), np.stack([places[closed.from_keyframe], places[closed.to_keyframe]], axis=1))


@dataclass
class Seen:
    """A frame. image: (height, width) uint8, or the path of a PNG file. keypoints: as those of ft.Odometry. counts and
    milliseconds: numbers by name, for plots. corrected: where a correction entered with the frame."""

    index: int
    time_ns: int
    image: Union[NDArray[np.uint8], str, Path]
    tracked: bool
    keyframe: bool
    T_world_camera: Floats
    keypoints: TrackedKeypoints
    counts: Mapping[str, float] = field(default_factory=dict)
    milliseconds: Mapping[str, float] = field(default_factory=dict)
    corrected: Optional[Corrected] = None


def _rerun() -> ModuleType:
    try:
        import rerun
    except ImportError as e:
        raise MissingPackage("the package rerun is missing: python -m pip install rerun-sdk") from e
    return rerun


def open_rerun(file: Union[str, Path, None] = None) -> ModuleType:
    """The module rerun, which writes to the file from now on, or to a viewer that is started. Raises MissingPackage."""
    rerun = _rerun()
    rerun.init("ft", spawn=file is None)
    if file is not None:
        rerun.save(str(file))
    return rerun


def depth_colours(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Red is near, blue is far, by inverse depth between 1 m and infinity; grey has none."""
    near = np.clip(1.0 / np.maximum(depth, 1.0), 0, 1)[:, None]
    colours: NDArray[np.floating[Any]] = near * (255, 40, 40) + (1 - near) * (40, 90, 255)
    colours[depth <= 0] = GREY
    return colours.astype(np.uint8)


class Viewer:
    """Logs frames. camera: fx, fy, cx, cy and, of a fisheye camera, k1 to k4. truth: ft.Trajectory, or None."""

    def __init__(self, rerun: ModuleType, camera: Camera, width: int, height: int, truth: Optional[Trajectory] = None,
                 truth_has_orientation: bool = True) -> None:
        self._rerun = rerun
        values = _ft.camera_values(camera, "the camera")
        plain = _ft.KannalaBrandt(values) if len(values) == 8 else _ft.Pinhole(values[:4])
        self._camera = camera if isinstance(camera, (_ft.RadTan, _ft.DoubleSphere)) else plain
        self._truth = truth if truth is not None and len(truth) else None
        self._oriented = truth_has_orientation
        self._poses: list[tuple[int, Floats]] = []
        self._keyframes: list[Floats] = []
        self._points: list[Floats] = []
        self._before: dict[int, NDArray[np.float32]] = {}
        self._last: Optional[Seen] = None
        rerun.log("world", rerun.ViewCoordinates.RDF, static=True)
        rerun.log("world/camera/left", rerun.Pinhole(width=width, height=height, focal_length=values[:2],
                                                     principal_point=values[2:4]), static=True)
        if self._truth is not None:
            rerun.log("world/truth", rerun.LineStrips3D([self._truth.poses[:, :3, 3]], colors=GREY), static=True)
        rerun.send_blueprint(self._layout())

    def _layout(self) -> object:
        import rerun.blueprint as b

        return b.Blueprint(b.Horizontal(
            b.Spatial3DView(origin="world", name="map and path"),
            b.Vertical(b.Spatial2DView(origin="world/camera/left", name="left image"),
                       b.TimeSeriesView(origin="counts", name="keypoints and points"),
                       b.TimeSeriesView(origin="milliseconds", name="milliseconds a frame"))))

    def show(self, seen: Seen, made: Optional[Map] = None) -> None:
        """Logs a frame; made: ft.Odometry.map(), or None, then new points are taken from keyframes."""
        self._set_time(seen)
        self._show_image(seen)
        self._show_camera(seen)
        for group, values in (("counts", seen.counts), ("milliseconds", seen.milliseconds)):
            for name, value in values.items():
                self._rerun.log(f"{group}/{name.replace(' ', '_')}", self._rerun.Scalars(float(value)))
        if seen.tracked and seen.keyframe:
            self._show_map(seen, made)
        if seen.corrected is not None:
            rerun = self._rerun
            rerun.log("world/corrected", rerun.LineStrips3D(seen.corrected.path, colors=BLUE))
            rerun.log("world/loops", rerun.LineStrips3D(seen.corrected.loops, colors=YELLOW))
        self._last = seen

    def finish(self) -> None:
        """Logs what is known at the end: the whole path, and the truth aligned to it."""
        if self._last is None or not self._poses:
            return
        self._set_time(self._last)
        self._show_path()
        if self._truth is not None:
            errors = evaluate(Trajectory.of(self._poses), self._truth, orientation=self._oriented)
            if errors["ate_m"] is not None:
                self._show_truth(np.asarray(np.linalg.inv(errors["T_truth_estimate"]), np.float64), static=True)

    def _set_time(self, seen: Seen) -> None:
        self._rerun.set_time("frame", sequence=seen.index)
        self._rerun.set_time("time", timestamp=1e-9 * seen.time_ns)

    def _show_image(self, seen: Seen) -> None:
        rerun, left = self._rerun, "world/camera/left"
        if isinstance(seen.image, (str, Path)):
            rerun.log(left, rerun.EncodedImage(path=seen.image))
        else:
            rerun.log(left, rerun.Image(seen.image).compress(jpeg_quality=80))
        k = seen.keypoints
        at = np.stack([k.x, k.y], axis=1).astype(np.float32)
        matched, depth = np.asarray(k.matched, dtype=bool), np.asarray(k.depth, dtype=np.float32)
        colours = np.where(matched[:, None], GREEN, ORANGE).astype(np.uint8)
        rerun.log(left + "/keypoints", rerun.Points2D(at, colors=colours, radii=1.5))
        rerun.log(left + "/depth", rerun.Points2D(at[depth > 0], colors=depth_colours(depth[depth > 0]), radii=3))
        now = {int(p): at[i] for i, p in enumerate(k.point) if p >= 0}
        pairs = [(self._before[p], now[p]) for p in now if p in self._before]
        rerun.log(left + "/matches", rerun.LineStrips2D(pairs, colors=GREEN))
        self._before = now

    def _in_camera(self, keypoints: TrackedKeypoints, chosen: NDArray[np.bool_]) -> Floats:
        """Keypoints with depth as points of the camera's frame, (n, 3)."""
        pixels = np.stack([keypoints.x, keypoints.y], axis=1).astype(np.float64)[chosen]
        rays, valid = self._camera.unproject(pixels)
        valid &= rays[:, 2] > 0
        depth = np.asarray(keypoints.depth, dtype=np.float64)[chosen][valid]
        return depth[:, None] * rays[valid] / rays[valid, 2:]

    def _show_camera(self, seen: Seen) -> None:
        rerun, T = self._rerun, seen.T_world_camera
        rerun.log("world/camera", rerun.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
        depth = np.asarray(seen.keypoints.depth)
        rerun.log("world/camera/depths", rerun.Points3D(self._in_camera(seen.keypoints, depth > 0), colors=ORANGE,
                                                        radii=0.01))
        if not seen.tracked:
            return
        self._poses.append((seen.time_ns, T))
        if len(self._poses) == 1:
            self._align_first(seen.time_ns, T)
        if seen.keyframe or len(self._poses) % 10 == 0:
            self._show_path()

    def _show_path(self) -> None:
        path = np.array([T[:3, 3] for _, T in self._poses])
        self._rerun.log("world/trajectory", self._rerun.LineStrips3D([path], colors=RED))

    def _show_map(self, seen: Seen, made: Optional[Map]) -> None:
        if made is None:
            k, T = seen.keypoints, seen.T_world_camera
            new = (np.asarray(k.point) >= 0) & ~np.asarray(k.matched, dtype=bool) & (np.asarray(k.depth) > 0)
            self._points.append(self._in_camera(k, new) @ T[:3, :3].T + T[:3, 3])
            self._keyframes.append(T[:3, 3])
            points: NDArray[np.floating[Any]] = np.concatenate(self._points)
            keyframes = np.array(self._keyframes)
        else:
            points, keyframes = made.position, made.keyframe_T_world_camera[:, :3, 3]
        rerun = self._rerun
        rerun.log("world/map", rerun.Points3D(points, colors=WHITE, radii=0.01))
        rerun.log("world/keyframes", rerun.Points3D(keyframes, colors=GREEN, radii=0.02))

    def _align_first(self, time_ns: int, T: Floats) -> None:
        """The truth begins where the estimate does; finish() aligns the whole path."""
        if self._truth is None or not self._oriented:
            return
        i = np.abs(self._truth.time_ns - time_ns).argmin()
        self._show_truth(T @ np.linalg.inv(self._truth.poses[i]))

    def _show_truth(self, T_world_truth: Floats, static: bool = False) -> None:
        self._rerun.log("world/truth", self._rerun.Transform3D(translation=T_world_truth[:3, 3],
                                                               mat3x3=T_world_truth[:3, :3]), static=static)


def _matrices(rows: Sequence[Sequence[float]]) -> Floats:
    all_poses = np.tile(np.eye(4), (len(rows), 1, 1))
    all_poses[:, :3] = np.array(rows, dtype=np.float64).reshape(-1, 3, 4)
    return all_poses


def _corrected(given: Optional[dict[str, Any]]) -> Optional[Corrected]:
    if given is None:
        return None
    return Corrected([np.array(piece, dtype=np.float64).reshape(-1, 3) for piece in given["path"]],
                     np.array(given["loops"], dtype=np.float64).reshape(-1, 2, 3))


class Recording:
    """What track_sequence --record FOLDER wrote: recording.jsonl, and images. Iterates over ft.view.Seen.

    The first line of recording.jsonl has ft_recording (the format, 1), sequence, width, height, camera (fx, fy, cx, cy and
    what follows of the model), model (Pinhole, RadTan, KannalaBrandt or DoubleSphere; without it, 8 numbers are KannalaBrandt's), stages, and truth or null: time_ns, T_world_camera, orientation. Each later line is a
    frame: frame, time_ns, image (a path in the folder), tracked, keyframe, T_world_camera (12 numbers, 3x4 row-major), counts,
    stage_ms, and of the left keypoints x, y, depth (-1 = none), point (-1 = none), matched; with a correction by loops also
    corrected: path, pieces of places, and loops, pairs of places. A last line that is cut off, as
    of a run that goes on, is left out. Raises RuntimeError that names the file and what is wrong.
    """

    def __init__(self, folder: Union[str, Path]) -> None:
        self.folder = Path(folder)
        self._file = self.folder / "recording.jsonl"
        if self.folder.is_file():
            raise RuntimeError(f"{folder}: a file; accepted are a folder that track_sequence --record wrote, and a file .rrd")
        try:
            with open(self._file, encoding="utf-8") as lines:
                self.header = json.loads(lines.readline())
        except (OSError, ValueError) as e:
            raise RuntimeError(f"{self._file}: {e}") from e
        if not isinstance(self.header, dict) or self.header.get("ft_recording") != FORMAT:
            raise RuntimeError(f"{self._file}: is no recording of format {FORMAT}")
        self.truth: Optional[Trajectory] = None
        self.truth_has_orientation = False
        try:
            truth = self.header["truth"]
            if truth:
                self.truth = Trajectory(truth["time_ns"], _matrices(truth["T_world_camera"]))
                self.truth_has_orientation = bool(truth["orientation"])
        except (KeyError, TypeError, ValueError) as e:
            raise RuntimeError(f"{self._file}:1: {e!r}") from e

    @property
    def camera(self) -> Camera:
        """Raises RuntimeError for other numbers than the model has."""
        models: dict[str, Callable[[Any], Camera]] = {
            "RadTan": _ft.RadTan, "KannalaBrandt": _ft.KannalaBrandt, "DoubleSphere": _ft.DoubleSphere}
        numbers, name = self.header["camera"], self.header.get("model", "Pinhole")
        try:
            return models[name](numbers) if name in models else cast(Camera, numbers)
        except (TypeError, ValueError) as e:
            raise RuntimeError(f"{self._file}:1: camera: {e}") from e

    def __iter__(self) -> Iterator[Seen]:
        with open(self._file, encoding="utf-8") as lines:
            next(lines)
            for number, line in enumerate(lines, 2):
                if not line.endswith("\n"):
                    return
                try:
                    yield self._seen(json.loads(line))
                except (KeyError, TypeError, ValueError) as e:
                    raise RuntimeError(f"{self._file}:{number}: {e!r}") from e

    def _seen(self, f: dict[str, Any]) -> Seen:
        none = np.zeros(0, np.int32)  # of the camera and octave, which are not recorded
        keypoints = TrackedKeypoints(x=np.array(f["x"]), y=np.array(f["y"]), camera=none, octave=none,
                                     depth=np.array(f["depth"]), point=np.array(f["point"]),
                                     matched=np.array(f["matched"]))
        return Seen(f["frame"], f["time_ns"], self.folder / f["image"], f["tracked"], f["keyframe"],
                    _matrices([f["T_world_camera"]])[0], keypoints, f["counts"],
                    dict(zip(self.header["stages"], f["stage_ms"])), _corrected(f.get("corrected")))


def show_file(file: Union[str, Path]) -> int:
    """Opens a .rrd file in rerun's viewer, and waits for it. Returns its exit status. Raises MissingPackage; RuntimeError
    where there is no such file."""
    if not Path(file).is_file():
        raise RuntimeError(f"{file}: no such file")
    _rerun()
    return subprocess.run([sys.executable, "-m", "rerun", str(file)], check=False).returncode


def show_recording(folder: Union[str, Path], file: Union[str, Path, None] = None) -> int:
    """Shows a recording in the viewer, or writes it to a .rrd file. Returns the number of frames."""
    recording = Recording(folder)
    h = recording.header
    viewer = Viewer(open_rerun(file), recording.camera, h["width"], h["height"], recording.truth,
                    recording.truth_has_orientation)
    frames = 0
    for seen in recording:
        viewer.show(seen)
        frames += 1
    viewer.finish()
    return frames
