# SPDX-License-Identifier: Apache-2.0
"""Cameras that are plugged in: any of OpenCV's, Intel RealSense, Luxonis OAK. Each is a Source."""

from __future__ import annotations

import queue
import time
from collections import deque
from typing import Any, Callable, Iterator, NamedTuple, Optional, Protocol, Sequence, Union

import numpy as np
import numpy.typing as npt

from . import _ft
from .rectification import Rectifier
from .rigs import DistortedPair, Imu, MonocularCamera, RectifiedPair

Numbers = npt.NDArray[np.float64]
Grey = npt.NDArray[np.uint8]
LiveRig = Union[RectifiedPair, MonocularCamera]
Stopped = Callable[[], bool]
PATIENCE_S = 5  # without images


def never() -> bool:
    return False


class Sample(NamedTuple):
    """Of an IMU: specific force, m/s^2, and angular rate, rad/s."""

    time_ns: int
    accel: Numbers
    gyro: Numbers


class LiveFrame(NamedTuple):
    """Images as ft.Odometry.track() takes them, and the samples of the IMU since the frame before."""

    time_ns: int
    images: tuple[Grey, ...]
    imu: list[Sample]


class Source(Protocol):
    """A camera. Size: of the images, pixels. `live`: images that nobody waits for are lost."""

    name: str
    rig: LiveRig
    width: int
    height: int
    imu: Optional[Imu]
    live: bool
    warnings: list[str]

    def frames(self, stopped: Stopped = never) -> Iterator[LiveFrame]:
        """Frames in the order of their times, until stopped() is true, which is asked several times a second. Raises
        RuntimeError where the camera gives no more."""

    def close(self) -> None:
        """Called by the thread that took the frames, after the last one."""


class ImuJoiner:
    """Joins the two sensors of an IMU, whose rates differ: a sample for each of the gyroscope's, with the specific force
    between two of the accelerometer's. Both in the order of their times."""

    def __init__(self) -> None:
        self._accel: deque[tuple[int, Numbers]] = deque(maxlen=2000)  # from the one before the oldest that waits
        self._waiting: deque[tuple[int, Numbers]] = deque(maxlen=2000)
        self._joined: deque[Sample] = deque(maxlen=10000)
        self.last_ns = -1  # of the joined ones

    def add_accel(self, time_ns: int, value: Sequence[float]) -> None:
        if not self._accel or time_ns > self._accel[-1][0]:
            self._accel.append((time_ns, np.asarray(value, np.float64)))
            self._join()

    def add_gyro(self, time_ns: int, value: Sequence[float]) -> None:
        self._waiting.append((time_ns, np.asarray(value, np.float64)))
        self._join()

    def take(self) -> list[Sample]:
        taken = list(self._joined)
        self._joined.clear()
        return taken

    def _join(self) -> None:
        while self._waiting and len(self._accel) > 1 and self._waiting[0][0] <= self._accel[-1][0]:
            t, gyro = self._waiting.popleft()
            while self._accel[1][0] < t:
                self._accel.popleft()
            (t0, a0), (t1, a1) = self._accel[0], self._accel[1]
            if t < t0:
                continue  # from before the accelerometer began
            share = (t - t0) / (t1 - t0)
            self._joined.append(Sample(t, (1 - share) * a0 + share * a1, gyro))
            self.last_ns = t


class OpenCvCamera:
    """One camera that OpenCV opens: a number, or the file or address of a video. parameters: fx, fy, cx, cy, pixels, and 4, 5
    or 8 of OpenCV's coefficients of distortion, whose images are undistorted; with fisheye k1 to k4 of its fisheye model.
    readout_s: of a rolling shutter, from the first row to the last one, seconds, 0 to 0.1.
    Times of a camera's images are those of its driver, where that has the computer's monotonic clock (V4L2), else when they
    arrived."""

    rig: LiveRig
    imu: Optional[Imu] = None

    def __init__(self, camera: str, parameters: Sequence[float], *, fisheye: bool = False,
                 size: Optional[tuple[int, int]] = None, fps: Optional[float] = None, readout_s: float = 0.0) -> None:
        try:
            import cv2
        except ImportError:
            raise RuntimeError("OpenCV is not installed: python -m pip install opencv-python-headless") from None
        self._cv2 = cv2
        wanted = (8,) if fisheye else (4, 8, 9, 12)
        if len(parameters) not in wanted:
            raise ValueError(f"--parameters: {len(parameters)} numbers, must be " + (
                "8: fx fy cx cy k1 k2 k3 k4" if fisheye else "fx fy cx cy, and 0, 4, 5 or 8 of k1 k2 p1 p2 k3 k4 k5 k6"))
        self.live = camera.isdigit() or "://" in camera or camera.startswith("/dev/")
        self.name = f"camera {camera}" if camera.isdigit() else camera
        self.warnings: list[str] = []
        self._video = cv2.VideoCapture(int(camera) if camera.isdigit() else camera)
        if size is not None:
            self._video.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            self._video.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        if fps is not None:
            self._video.set(cv2.CAP_PROP_FPS, fps)
        self._first = self._next() if self._video.isOpened() else None
        if self._first is None:
            self.close()
            raise RuntimeError(f"{self.name}: OpenCV cannot open it, or it gives no image")
        self.height, self.width = self._first[1].shape
        if size is not None and (self.width, self.height) != tuple(size):
            self.warnings.append(f"{self.name}: gives {self.width}x{self.height}, wanted {size[0]}x{size[1]}: the parameters "
                                 "must be those of that size")
        self._maps: Optional[tuple[Any, Any]] = None
        K = np.array([[parameters[0], 0, parameters[2]], [0, parameters[1], parameters[3]], [0, 0, 1]])
        if fisheye:
            self.rig = MonocularCamera(_ft.KannalaBrandt(list(parameters)), readout_s)
        else:
            self.rig = MonocularCamera(_ft.Pinhole(list(parameters[:4])), readout_s)
            if len(parameters) > 4:
                self._maps = cv2.initUndistortRectifyMap(K, np.array(parameters[4:], np.float64), None, K,
                                                         (self.width, self.height), cv2.CV_16SC2)

    def _next(self) -> Optional[tuple[int, Grey]]:
        """The next image and its time; None at the end. Images of a camera that cannot be decoded are left out."""
        begin = time.monotonic()
        while True:
            if not self._video.grab():
                return None
            arrived = time.monotonic_ns()
            good, image = self._video.retrieve()
            if good:
                break
            if not self.live or time.monotonic() - begin > PATIENCE_S:
                return None
        said = round(1e6 * self._video.get(self._cv2.CAP_PROP_POS_MSEC))
        if not self.live or 0 <= arrived - said < 1e9 * PATIENCE_S:
            arrived = said
        grey = image if image.ndim == 2 else self._cv2.cvtColor(image, self._cv2.COLOR_BGR2GRAY)
        return arrived, np.asarray(grey, np.uint8)

    def frames(self, stopped: Stopped = never) -> Iterator[LiveFrame]:
        last_ns, found, given, taken = -1, self._first, 0, 0
        while found is not None and not stopped():
            time_ns, image = found
            given += 1
            if image.shape != (self.height, self.width):
                raise RuntimeError(f"{self.name}: an image is {image.shape[1]}x{image.shape[0]}, the first one was "
                                   f"{self.width}x{self.height}")
            if time_ns > last_ns:
                last_ns = time_ns
                taken += 1
                if self._maps is not None:
                    image = np.asarray(self._cv2.remap(image, *self._maps, self._cv2.INTER_LINEAR), np.uint8)
                yield LiveFrame(time_ns, (image,), [])
            found = self._next()
        if given > 1 and taken == 1:
            raise RuntimeError(f"{self.name}: OpenCV tells no times of its images")
        if self.live and found is None:
            raise RuntimeError(f"{self.name}: gives no more images")

    def close(self) -> None:
        self._video.release()


class RealSense:
    """The two infrared cameras of an Intel RealSense D4xx, which rectifies their images, and its IMU where it has one. The
    projector is switched off: its dots move with the camera. Lengths and calibration are the device's."""

    rig: LiveRig
    imu: Optional[Imu]
    live = True
    name = "RealSense"

    def __init__(self, size: tuple[int, int] = (848, 480), fps: int = 30, imu: bool = True, rs: Any = None) -> None:
        if rs is None:
            try:
                import pyrealsense2 as rs  # type: ignore[no-redef, import-not-found, import-untyped, unused-ignore]
            except ImportError:
                raise RuntimeError("pyrealsense2 is not installed: python -m pip install pyrealsense2") from None
        self._rs = rs
        self.warnings: list[str] = []
        self.width, self.height = size
        self._arrived: queue.Queue[Any] = queue.Queue(maxsize=1000)
        self._pipeline = rs.pipeline()
        profile, has_imu = self._start(fps, imu)
        try:
            self._read_calibration(profile, has_imu)
        except BaseException:
            self.close()
            raise

    def _read_calibration(self, profile: Any, has_imu: bool) -> None:
        rs = self._rs
        left, right = (profile.get_stream(rs.stream.infrared, i).as_video_stream_profile() for i in (1, 2))
        k = left.get_intrinsics()
        if any(k.coeffs):
            raise RuntimeError(f"{self.name}: its infrared images are not rectified: distortion {list(k.coeffs)}")
        # Points of the left camera in the right one: the baseline is along x.
        self.rig = RectifiedPair((k.fx, k.fy, k.ppx, k.ppy), abs(left.get_extrinsics_to(right).translation[0]))
        self.imu = None
        if has_imu:
            gyro = profile.get_stream(rs.stream.gyro)
            to_imu = left.get_extrinsics_to(gyro)
            T = np.eye(4)
            T[:3, :3] = np.reshape(to_imu.rotation, (3, 3)).T  # the device's are by columns
            T[:3, 3] = to_imu.translation
            self.imu = Imu(T, rate_hz=float(gyro.fps()))

    def _start(self, fps: int, imu: bool) -> tuple[Any, bool]:
        """Starts with the IMU, or without one where there is none."""
        rs = self._rs
        for with_imu in (True, False) if imu else (False,):
            config = rs.config()
            for i in (1, 2):
                config.enable_stream(rs.stream.infrared, i, self.width, self.height, rs.format.y8, fps)
            if with_imu:
                for stream in (rs.stream.accel, rs.stream.gyro):
                    config.enable_stream(stream, rs.format.motion_xyz32f, 0)  # at the device's own rate
            try:
                profile = self._pipeline.start(config, self._arrive)
            except RuntimeError as e:
                if with_imu:
                    continue
                raise RuntimeError(f"{self.name}: {e} ({self.width}x{self.height} at {fps} Hz)") from None
            sensor = profile.get_device().first_depth_sensor()
            if sensor.supports(rs.option.emitter_enabled):
                sensor.set_option(rs.option.emitter_enabled, 0)
            if imu and not with_imu:
                self.warnings.append(f"{self.name}: has no IMU")
            return profile, with_imu
        raise AssertionError("one of the two starts or raises")

    def _arrive(self, frame: Any) -> None:
        """Called by the device's thread."""
        try:
            self._arrived.put_nowait(frame)
        except queue.Full:
            pass  # nobody takes frames

    def frames(self, stopped: Stopped = never) -> Iterator[LiveFrame]:
        rs, joiner = self._rs, ImuJoiner()
        pending: Optional[tuple[int, tuple[Grey, ...]]] = None
        last_ns, domain, arrived = -1, None, time.monotonic()
        for _ in range(self._arrived.qsize()):  # those from before anybody took frames are old
            self._arrived.get_nowait()
        while not stopped():
            if time.monotonic() - arrived > PATIENCE_S:
                raise RuntimeError(f"{self.name}: no images for {PATIENCE_S} s")
            try:
                frame = self._arrived.get(timeout=0.1)
            except queue.Empty:
                continue
            time_ns = round(1e6 * frame.get_timestamp())
            ready = None
            if frame.is_motion_frame():
                if frame.get_frame_timestamp_domain() != domain:
                    continue  # of another clock than the images
                motion = frame.as_motion_frame().get_motion_data()
                gyro = frame.get_profile().stream_type() == rs.stream.gyro
                (joiner.add_gyro if gyro else joiner.add_accel)(time_ns, (motion.x, motion.y, motion.z))
            elif frame.is_frameset():
                both = [frame.as_frameset().get_infrared_frame(i) for i in (1, 2)]
                if all(both) and time_ns > last_ns:
                    arrived, domain = time.monotonic(), frame.get_frame_timestamp_domain()
                    ready, last_ns = pending, time_ns  # the next frame is here: no longer wait for the IMU
                    pending = time_ns, tuple(np.array(image.get_data(), np.uint8) for image in both)
            if pending is not None and ready is None and (self.imu is None or joiner.last_ns >= pending[0]):
                ready, pending = pending, None
            if ready is not None:
                yield LiveFrame(*ready, joiner.take())

    def close(self) -> None:
        try:
            self._pipeline.stop()
        except RuntimeError:
            pass  # has not started


class Oak:
    """The two grey cameras of a Luxonis OAK-D, rectified here by the device's calibration, and its IMU where its place is
    known. Needs depthai 3."""

    rig: LiveRig
    imu: Optional[Imu]
    live = True
    name = "OAK"

    def __init__(self, size: tuple[int, int] = (640, 400), fps: int = 20, imu: bool = True, dai: Any = None) -> None:
        if dai is None:
            try:
                import depthai as dai  # type: ignore[no-redef, import-not-found, import-untyped, unused-ignore]
            except ImportError:
                raise RuntimeError("depthai is not installed: python -m pip install 'depthai>=3'") from None
        self._dai = dai
        self.warnings: list[str] = []
        self.width, self.height = size
        self._fps = fps
        try:
            self._pipeline = dai.Pipeline()
        except RuntimeError as e:
            raise RuntimeError(f"{self.name}: {e}") from None
        try:
            self._build(size, fps, imu)
        except BaseException:
            self.close()
            raise

    def _build(self, size: tuple[int, int], fps: int, imu: bool) -> None:
        dai = self._dai
        sockets = dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C
        calibration = self._pipeline.getDefaultDevice().readCalibration()
        left, right = (self._camera(calibration, socket) for socket in sockets)
        T = np.array(calibration.getCameraExtrinsics(*sockets), np.float64)
        T[:3, 3] *= 0.01  # centimetres
        pair = DistortedPair(left, right, T, tuple(left[:4]), size)
        self._rectifier = Rectifier(pair, *size, device="host")
        self.rig = self._rectifier.rig
        self.imu = self._imu(calibration, sockets[0]) if imu else None
        self._images = [
            self._pipeline.create(dai.node.Camera).build(socket)
            .requestOutput(size, dai.ImgFrame.Type.GRAY8, fps=fps).createOutputQueue(maxSize=8, blocking=False)
            for socket in sockets
        ]
        self._samples = None
        if self.imu is not None:
            node = self._pipeline.create(dai.node.IMU)
            node.enableIMUSensor([dai.IMUSensor.ACCELEROMETER_RAW, dai.IMUSensor.GYROSCOPE_RAW], 200)
            node.setBatchReportThreshold(1)
            node.setMaxBatchReports(20)
            self._samples = node.out.createOutputQueue(maxSize=200, blocking=False)
        self._pipeline.start()

    def _camera(self, calibration: Any, socket: Any) -> list[float]:
        """fx, fy, cx, cy, k1, k2, p1, p2, k3 to k6 of images of this size."""
        K = calibration.getCameraIntrinsics(socket, self.width, self.height)
        model, d = calibration.getDistortionModel(socket), list(calibration.getDistortionCoefficients(socket))
        if model != self._dai.CameraModel.Perspective or any(d[8:]):
            raise RuntimeError(f"{self.name}: the lens of {socket} is {model} with {d}, must be Perspective with 8 coefficients")
        return [K[0][0], K[1][1], K[0][2], K[1][2], *d[:8]]

    def _imu(self, calibration: Any, left: Any) -> Optional[Imu]:
        try:
            T = np.array(calibration.getImuToCameraExtrinsics(left), np.float64)
        except RuntimeError as e:
            self.warnings.append(f"{self.name}: its IMU is not used: {e}")
            return None
        T[:3, 3] *= 0.01  # centimetres
        raw_of_rectified = np.eye(4)
        raw_of_rectified[:3, :3] = np.asarray(self._rectifier.map(0)[2], np.float64).T
        return Imu(np.linalg.inv(T) @ raw_of_rectified, rate_hz=200.0)

    def frames(self, stopped: Stopped = never) -> Iterator[LiveFrame]:
        try:
            yield from self._frames(stopped)
        except self._dai.MessageQueue.QueueException as e:
            raise RuntimeError(f"{self.name}: {e}") from None

    def _frames(self, stopped: Stopped) -> Iterator[LiveFrame]:
        joiner, waiting = ImuJoiner(), [deque[Any](maxlen=16), deque[Any](maxlen=16)]
        arrived = time.monotonic()
        while self._pipeline.isRunning():
            if stopped():
                return
            something = self._take_samples(joiner)
            for taken, images in zip(waiting, self._images):
                image = images.tryGet()
                if image is not None:
                    taken.append(image)
                    something = True
            while waiting[0] and waiting[1]:
                times = [_nanoseconds(taken[0].getTimestampDevice()) for taken in waiting]
                if abs(times[0] - times[1]) < 0.25e9 / self._fps:
                    break
                waiting[0 if times[0] < times[1] else 1].popleft()  # its other half was lost
            if waiting[0] and waiting[1]:
                time_ns = _nanoseconds(waiting[0][0].getTimestampDevice())
                arrived = time.monotonic()
                newer = len(waiting[0]) > 1 and len(waiting[1]) > 1
                if self.imu is None or joiner.last_ns >= time_ns or newer:
                    raw = [np.ascontiguousarray(taken.popleft().getFrame(), np.uint8) for taken in waiting]
                    yield LiveFrame(time_ns, self._rectifier.rectify(raw[0], raw[1]), joiner.take())
            if time.monotonic() - arrived > PATIENCE_S:
                raise RuntimeError(f"{self.name}: no pair of images for {PATIENCE_S} s")
            if not something:
                time.sleep(0.001)
        raise RuntimeError(f"{self.name}: stopped")

    def _take_samples(self, joiner: ImuJoiner) -> bool:
        data = None if self._samples is None else self._samples.tryGet()
        if data is None:
            return False
        for packet in data.packets:
            a, w = packet.acceleroMeter, packet.gyroscope
            joiner.add_accel(_nanoseconds(a.getTimestampDevice()), (a.x, a.y, a.z))
            joiner.add_gyro(_nanoseconds(w.getTimestampDevice()), (w.x, w.y, w.z))
        return True

    def close(self) -> None:
        try:
            self._pipeline.stop()
        except RuntimeError:
            pass  # has not started


def _nanoseconds(duration: Any) -> int:
    """Of a timedelta."""
    return int((duration.days * 86400 + duration.seconds) * 1_000_000_000 + duration.microseconds * 1000)
