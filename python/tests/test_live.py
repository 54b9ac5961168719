# SPDX-License-Identifier: Apache-2.0
"""Cameras that are plugged in, with videos and stand-ins for the devices' packages that have their names and units."""

import ast
import datetime
import inspect
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH

import ft
from ft import live, live_cameras
from ft.__main__ import parser
from ft.live_cameras import ImuJoiner, LiveFrame, Oak, RealSense, Sample

F, _, CX, CY = CAMERA
FRAMES = 12


def options(*arguments):
    return parser().parse_args(["live", *arguments])


def test_two_rates_are_joined_between_samples():
    joiner = ImuJoiner()
    joiner.add_gyro(5, (9, 9, 9))  # before the accelerometer began
    joiner.add_accel(10, (0, 0, 10))
    for t in (12, 15, 20, 25):
        joiner.add_gyro(t, (t, 0, 0))
    assert joiner.take() == []
    joiner.add_accel(20, (1, 0, 20))
    taken = joiner.take()
    assert [s.time_ns for s in taken] == [12, 15, 20] and joiner.last_ns == 20
    assert [s.gyro[0] for s in taken] == [12, 15, 20]
    np.testing.assert_allclose([s.accel for s in taken], [[0.2, 0, 12], [0.5, 0, 15], [1, 0, 20]])
    joiner.add_accel(30, (1, 0, 0))
    np.testing.assert_allclose(joiner.take()[0].accel, [1, 0, 10])


def test_bursts_and_repeated_stamps_are_joined():
    joiner = ImuJoiner()
    for first in range(0, 300, 30):  # three of the one sensor, then three of the other
        for t in range(first, first + 30, 10):
            joiner.add_accel(t, (t, 0, 0))
            joiner.add_accel(t, (99, 0, 0))
        for t in range(first, first + 30, 10):
            joiner.add_gyro(t + 4, (0, 0, 0))
    taken = joiner.take()
    assert [s.time_ns for s in taken] == list(range(4, 294, 10))
    np.testing.assert_allclose([s.accel[0] for s in taken], [s.time_ns for s in taken])
    for t in range(5000):  # an accelerometer that is silent takes no memory without end
        joiner.add_gyro(1000 + t, (0, 0, 0))
    assert len(joiner._waiting) <= 2000


def test_a_slow_reader_gets_the_newest_frame_and_all_samples():
    sent, go, closed = threading.Event(), threading.Event(), []

    class Fast:
        def frames(self, stopped):
            for i in range(5):
                yield LiveFrame(i, (), [Sample(i, np.zeros(3), np.zeros(3))])
            sent.set()
            go.wait(10)
            raise RuntimeError("unplugged")

        def close(self):
            closed.append(threading.current_thread())

    newest = live.Newest(Fast())
    assert sent.wait(10)
    frames = iter(newest)
    frame = next(frames)
    assert (frame.time_ns, [s.time_ns for s in frame.imu], newest.dropped) == (4, [0, 1, 2, 3, 4], 4)
    go.set()
    with pytest.raises(RuntimeError, match="unplugged"):
        next(frames)
    assert len(closed) == 1 and closed[0] is not threading.current_thread()


def test_a_camera_that_goes_on_is_closed_after_its_last_frame():
    log = []

    class Endless:
        def frames(self, stopped):
            while not stopped():
                yield LiveFrame(len(log), (), [])
            log.append("ended")

        def close(self):
            log.append("closed")

    newest = live.Newest(Endless())
    next(iter(newest))
    newest.stop()
    assert log == ["ended", "closed"]


def identity(size):
    return [[float(i == j) for j in range(size)] for i in range(size)]


class FakeRealSense:
    """Of pyrealsense2, what RealSense takes. The IMU is turned by a quarter about z, and moved."""

    def __init__(self, walk, imu=True, coefficients=(0, 0, 0, 0, 0), same_clock=True):
        self.stream = SimpleNamespace(infrared="infrared", accel="accel", gyro="gyro")
        self.format = SimpleNamespace(y8="y8", motion_xyz32f="xyz")
        self.option = SimpleNamespace(emitter_enabled="emitter")
        self.set, self.stopped, self.wanted = {}, False, []
        fake = self

        class Profile:
            def __init__(self, kind, index=0):
                self.kind, self.index = kind, index

            def stream_type(self):
                return self.kind

            def fps(self):
                return 400

            def as_video_stream_profile(self):
                return self

            def get_intrinsics(self):
                return SimpleNamespace(fx=F, fy=F, ppx=CX, ppy=CY, coeffs=list(coefficients))

            def get_extrinsics_to(self, other):
                if other.kind == "gyro":  # x of the camera is y of the IMU; rotations are by columns
                    return SimpleNamespace(rotation=[0, 1, 0, -1, 0, 0, 0, 0, 1], translation=[0.01, 0.02, 0.03])
                return SimpleNamespace(rotation=np.eye(3).ravel().tolist(), translation=[-BASELINE, 0, 0])

        class Frame:
            def __init__(self, kind, ms, value):
                self.kind, self.ms, self.value = kind, ms, value

            def get_timestamp(self):
                return self.ms

            def get_frame_timestamp_domain(self):
                return "global" if self.kind == "pair" or same_clock else "system"

            def is_motion_frame(self):
                return self.kind in ("gyro", "accel")

            def is_frameset(self):
                return self.kind == "pair"

            def as_motion_frame(self):
                return self

            def as_frameset(self):
                return self

            def get_motion_data(self):
                return SimpleNamespace(x=self.value[0], y=self.value[1], z=self.value[2])

            def get_profile(self):
                return Profile(self.kind)

            def get_infrared_frame(self, index):
                return SimpleNamespace(get_data=lambda: self.value[index - 1])

        class Pipeline:
            def start(self, config, callback):
                if "gyro" in config.streams and not imu:
                    raise RuntimeError("Couldn't resolve requests")
                fake.wanted = config.streams
                self.callback, self.imu = callback, "gyro" in config.streams
                sensor = SimpleNamespace(supports=lambda option: True, set_option=fake.set.__setitem__)
                return SimpleNamespace(get_stream=Profile,
                                       get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor))

            def send(self):
                callback = self.callback
                for i in range(FRAMES):
                    left, right, ns = walk.frame(i)
                    if self.imu:
                        for k in range(10):
                            callback(Frame("accel", 1e-6 * ns + 5 * k - 48, (0.0, -9.81, 0.0)))
                            callback(Frame("gyro", 1e-6 * ns + 5 * k - 46, (0.0, 0.0, 0.0)))
                    callback(Frame("pair", 1e-6 * ns, (left, right)))

            def stop(self):
                fake.stopped = True

        class Config:
            def __init__(self):
                self.streams = []

            def enable_stream(self, stream, *how):
                wanted = ("infrared", int, int, int, "y8", int) if stream == "infrared" else (stream, "xyz", int)
                assert len(how) + 1 == len(wanted) and all(type(a) is b if isinstance(b, type) else a == b for a, b in zip((stream, *how), wanted))
                self.streams.append(stream)

        self.running = Pipeline()
        self.pipeline, self.config = lambda: self.running, Config


def frames_of(source, rs, most):
    """Frames of a device that sends them once somebody takes them."""
    frames = source.frames()
    sender = threading.Timer(0.2, rs.running.send)
    sender.start()
    taken = [frame for _, frame in zip(range(most), frames)]
    sender.join()
    return taken


def poses_of(source, frames):
    odometry = ft.Odometry(source.rig, source.width, source.height, imu=source.imu, features=400, device="host")
    return [odometry.track(*frame.images, frame.time_ns) for frame in frames]


def test_a_realsense_is_tracked(walk):
    rs = FakeRealSense(walk)
    source = RealSense((WIDTH, HEIGHT), 20, rs=rs)
    assert rs.set == {"emitter": 0} and rs.wanted == ["infrared", "infrared", "accel", "gyro"]
    assert source.rig == ft.RectifiedPair((F, F, CX, CY), BASELINE) and source.imu.rate_hz == 400
    rs.running.callback("older than the first request")
    np.testing.assert_allclose(source.imu.T_imu_camera @ [1, 0, 0, 1], [0.01, 1.02, 0.03, 1])
    taken = frames_of(source, rs, FRAMES - 1)
    assert [frame.time_ns for frame in taken] == [50_000_000 * i for i in range(FRAMES - 1)]
    times = [s.time_ns for frame in taken for s in frame.imu]
    assert times == sorted(times) and len(times) > 100
    assert all(frame.imu[-1].time_ns >= frame.time_ns - 10_000_000 for frame in taken)
    source.close()
    assert rs.stopped

    rs = FakeRealSense(walk)
    source = RealSense((WIDTH, HEIGHT), 20, imu=False, rs=rs)
    assert source.imu is None
    pose = poses_of(source, frames_of(source, rs, FRAMES - 1))[-1]
    assert pose.tracked and pose.T_world_camera[0, 3] == pytest.approx(walk.position(FRAMES - 2)[0], abs=0.02)


def test_a_realsense_without_imu_says_so_and_one_with_distortion_is_refused(walk):
    source = RealSense((WIDTH, HEIGHT), 20, rs=FakeRealSense(walk, imu=False))
    assert source.imu is None and source.warnings == ["RealSense: has no IMU"]
    distorted = FakeRealSense(walk, coefficients=(0.1, 0, 0, 0, 0))
    with pytest.raises(RuntimeError, match="not rectified: distortion"):
        RealSense((WIDTH, HEIGHT), 20, rs=distorted)
    assert distorted.stopped


def test_an_imu_of_another_clock_is_left_out(walk):
    rs = FakeRealSense(walk, same_clock=False)
    source = RealSense((WIDTH, HEIGHT), 20, rs=rs)
    assert all(frame.imu == [] for frame in frames_of(source, rs, FRAMES - 1))


def test_images_that_stop_are_told(walk, monkeypatch):
    monkeypatch.setattr(live_cameras, "PATIENCE_S", 0.5)
    rs = FakeRealSense(walk)
    source = RealSense((WIDTH, HEIGHT), 20, rs=rs)
    with pytest.raises(RuntimeError, match="RealSense: no images for 0.5 s"):
        frames_of(source, rs, FRAMES + 1)
    source = Oak((WIDTH, HEIGHT), 20, dai=FakeDepthAi(walk))
    with pytest.raises(RuntimeError, match="OAK: no pair of images for 0.5 s"):
        list(source.frames())


class FakeDepthAi:
    """Of depthai, what Oak takes. A right image is missing."""

    def __init__(self, walk, d=(0,) * 14, imu=True, model="Perspective"):
        self.CameraBoardSocket = SimpleNamespace(CAM_B="left", CAM_C="right")
        self.CameraModel = SimpleNamespace(Perspective="Perspective", Fisheye="Fisheye")
        self.ImgFrame = SimpleNamespace(Type=SimpleNamespace(GRAY8="grey"))
        self.MessageQueue = SimpleNamespace(QueueException=KeyError)
        self.IMUSensor = SimpleNamespace(ACCELEROMETER_RAW="a", GYROSCOPE_RAW="w")

        def extrinsics(first, second):
            assert (first, second) == ("left", "right")
            T = np.eye(4)
            T[0, 3] = -100 * BASELINE
            return T.tolist()

        def imu_place(camera):
            if not imu:
                raise RuntimeError("no IMU extrinsics")
            T = np.eye(4)
            T[:3, 3] = 1, 2, 3  # centimetres, of the IMU in the camera
            return T.tolist()

        calibration = SimpleNamespace(
            getCameraIntrinsics=lambda socket, w, h: [[F, 0, CX], [0, F, CY], [0, 0, 1]], getDistortionModel=lambda socket: model,
            getDistortionCoefficients=lambda socket: list(d), getCameraExtrinsics=extrinsics, getImuToCameraExtrinsics=imu_place)

        clock = {"ms": 0.0}  # goes on with each sample that is asked for

        class Queue:
            def __init__(self, items):
                self.items = list(items)  # (ms, what is given from then on)

            def tryGet(self):
                return self.items.pop(0)[1] if self.items and self.items[0][0] <= clock["ms"] else None

        class Samples(Queue):
            def tryGet(self):
                clock["ms"] += 5
                return super().tryGet()

        def image(i, side):
            return SimpleNamespace(getSequenceNum=lambda: i, getFrame=lambda: walk.frame(i)[side],
                                   getTimestampDevice=lambda: datetime.timedelta(microseconds=50_000 * i))

        def packet(ms):
            at = lambda: datetime.timedelta(milliseconds=ms)  # noqa: E731
            return SimpleNamespace(acceleroMeter=SimpleNamespace(x=0, y=-9.81, z=0, getTimestampDevice=at),
                                   gyroscope=SimpleNamespace(x=0, y=0, z=0, getTimestampDevice=at))

        class CameraNode:
            def build(self, socket):
                self.side = 0 if socket == "left" else 1
                return self

            def requestOutput(self, size, kind, fps):
                items = [(50 * i if imu else 0, image(i, self.side)) for i in range(FRAMES) if (i, self.side) != (3, 1)]
                return SimpleNamespace(createOutputQueue=lambda maxSize, blocking: Queue(items))

        class ImuNode:
            def __init__(self):
                packets = [(5 * k, SimpleNamespace(packets=[packet(5 * k), packet(5 * k + 2)])) for k in range(10 * FRAMES)]
                self.out = SimpleNamespace(createOutputQueue=lambda maxSize, blocking: Samples(packets))

            def enableIMUSensor(self, sensors, rate):
                pass

            def setBatchReportThreshold(self, n):
                pass

            def setMaxBatchReports(self, n):
                pass

        class Pipeline:
            running = False

            def getDefaultDevice(self):
                return SimpleNamespace(readCalibration=lambda: calibration)

            def create(self, node):
                return node()

            def start(self):
                self.running = True

            def isRunning(self):
                return self.running

            def stop(self):
                self.running = False

        self.node = SimpleNamespace(Camera=CameraNode, IMU=ImuNode)
        self.Pipeline = Pipeline


def test_an_oak_is_tracked(walk):
    source = Oak((WIDTH, HEIGHT), 20, dai=FakeDepthAi(walk))
    assert source.rig.baseline == pytest.approx(BASELINE)
    np.testing.assert_allclose(source.imu.T_imu_camera[:3, 3], [-0.01, -0.02, -0.03], atol=1e-9)
    taken = [frame for _, frame in zip(range(FRAMES - 2), source.frames())]
    assert [frame.time_ns // 50_000_000 for frame in taken] == [0, 1, 2, *range(4, FRAMES - 1)]
    assert all(frame.imu[-1].time_ns >= frame.time_ns - 5_000_000 for frame in taken)
    assert sum(len(frame.imu) for frame in taken) > 150
    source.close()
    with pytest.raises(RuntimeError, match="OAK: stopped"):
        next(source.frames())

    source = Oak((WIDTH, HEIGHT), 20, imu=False, dai=FakeDepthAi(walk, imu=False))
    pose = poses_of(source, [frame for _, frame in zip(range(FRAMES - 1), source.frames())])[-1]
    assert pose.tracked and pose.T_world_camera[0, 3] == pytest.approx(walk.position(FRAMES - 1)[0], abs=0.02)


def test_an_oak_without_its_imus_place_says_so_and_other_lenses_are_refused(walk):
    source = Oak((WIDTH, HEIGHT), 20, dai=FakeDepthAi(walk, imu=False))
    assert source.imu is None and source.warnings == ["OAK: its IMU is not used: no IMU extrinsics"]
    with pytest.raises(RuntimeError, match="must be Perspective with 8 coefficients"):
        Oak((WIDTH, HEIGHT), 20, dai=FakeDepthAi(walk, model="Fisheye"))
    with pytest.raises(RuntimeError, match="must be Perspective with 8 coefficients"):
        Oak((WIDTH, HEIGHT), 20, dai=FakeDepthAi(walk, d=(0,) * 13 + (0.1,)))


@pytest.mark.parametrize("package, name", [("pyrealsense2", "rs"), ("depthai", "dai")])
def test_the_packages_have_the_names_that_are_used(package, name):
    module = pytest.importorskip(package, reason=f"{package} is not installed: its names are not compared")

    def chain(node):
        if isinstance(node, ast.Attribute):
            before = chain(node.value)
            return None if before is None else [*before, node.attr]
        if isinstance(node, ast.Name):
            return [] if node.id == name else None
        return None

    found = {".".join(c) for node in ast.walk(ast.parse(inspect.getsource(live_cameras))) for c in [chain(node)] if c}
    found |= {".".join(c[1:]) for node in ast.walk(ast.parse(inspect.getsource(live_cameras).replace(f"self._{name}.", f"{name}.x.")))
              for c in [chain(node)] if c and len(c) > 1 and c[0] == "x"}
    assert len(found) > 4
    for path in found:
        at = module
        for part in path.split("."):
            at = getattr(at, part)


@pytest.fixture(scope="module")
def video(walk, tmp_path_factory):
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: no videos are decoded")
    file = tmp_path_factory.mktemp("live") / "left.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (WIDTH, HEIGHT))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no videos")
    for i in range(3 * FRAMES):
        writer.write(np.repeat(walk.frame(i)[0][:, :, None], 3, 2))
    writer.release()
    return file


def test_the_program_tracks_what_opencv_opens(video, tmp_path):
    k = [str(v) for v in CAMERA]
    run = subprocess.run([sys.executable, "-m", "ft", "live", "--camera", video, "--parameters", *k, "--backend", "host",
                          "--out", tmp_path], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert f"camera    {video}, {WIDTH}x{HEIGHT}, without an IMU" in run.stdout
    assert f"{3 * FRAMES} frames, " in run.stdout and "0 left out" in run.stdout
    assert "the unit of length is unknown" in run.stdout
    path = ft.read_tum(tmp_path / "trajectory.txt").poses[:, :3, 3]
    along = path[-1] - path[0]
    assert along[0] > 3 * abs(along[1]) > 0 and abs(along[2]) < 0.2 * along[0]  # to the right and down
    few = subprocess.run([sys.executable, "-m", "ft", "live", "--camera", video, "--parameters", *k, "--backend", "host",
                          "--frames", "2", "--out", tmp_path / "few"], capture_output=True, text=True)
    assert few.returncode == 1 and few.stdout.endswith("2 frames, 0 tracked, 0 left out\n")


class FakeCapture:
    """Of cv2.VideoCapture, a camera: of each frame whether it can be decoded, its size, and what CAP_PROP_POS_MSEC is."""

    def __init__(self, frames, position):
        self.frames, self.position = [None, *frames], position

    def isOpened(self):
        return True

    def grab(self):
        self.frames.pop(0)
        return bool(self.frames)

    def retrieve(self):
        good, size = self.frames[0]
        return good, np.zeros((*size, 3), np.uint8) if good else None

    def get(self, _):
        return self.position()

    def release(self):
        pass


def webcam(monkeypatch, frames, position):
    cv2 = pytest.importorskip("cv2")
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: FakeCapture(frames, position))
    return live_cameras.OpenCvCamera("0", CAMERA)


@pytest.mark.parametrize("age_ms, taken_ms", [(4000, 4000), (-3600e3, 0), (3600e3, 0)])
def test_times_are_those_of_a_driver_with_the_same_clock(monkeypatch, age_ms, taken_ms):
    source = webcam(monkeypatch, 3 * [(True, (48, 64))], lambda: 1e-6 * time.monotonic_ns() - age_ms)
    before = time.monotonic_ns()
    frames = source.frames()
    next(frames)
    assert -2e6 < next(frames).time_ns - before + 1e6 * taken_ms < 1e9


def test_broken_images_of_a_camera_are_left_out_and_those_of_another_size_refused(monkeypatch):
    good, broken, other = (True, (48, 64)), (False, (0, 0)), (True, (24, 32))
    source = webcam(monkeypatch, [broken, good, broken, broken, good, other], lambda: 0.0)
    taken = []
    with pytest.raises(RuntimeError, match="camera 0: an image is 32x24, the first one was 64x48"):
        for frame in source.frames():
            taken.append(frame)
    assert len(taken) == 2


def test_distorted_images_are_undistorted(video, walk):
    cv2 = pytest.importorskip("cv2")
    d = [-0.2, 0.05, 0.001, -0.001]
    source = live.open_source(options("--camera", str(video), "--readout", "20", "--parameters", *(str(v) for v in [*CAMERA, *d])))
    assert source.rig.readout_s == pytest.approx(0.02)
    K = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1]])
    wanted = cv2.undistort(walk.frame(0)[0], K, np.array(d))
    image = next(source.frames()).images[0]
    inner = np.s_[40:-40, 40:-40]
    assert np.abs(image[inner].astype(int) - wanted[inner]).mean() < 5  # JPEG


def test_a_folder_that_cannot_be_made_is_named_and_the_camera_closed(video, tmp_path):
    (tmp_path / "file").write_text("")
    a = options("--camera", str(video), "--parameters", *(str(v) for v in CAMERA), "--out", str(tmp_path / "file"))
    source = live.open_source(a)
    with pytest.raises(RuntimeError, match="--out .*file"):
        live.track(source, a)
    assert not source._video.isOpened()


@pytest.mark.parametrize("arguments, message", [
    (["--camera", "0"], "needs --parameters fx fy cx cy"),
    (["--camera", "0", "--parameters", "1", "2", "3"], "3 numbers, must be fx fy cx cy"),
    (["--camera", "0", "--fisheye", "--parameters", "1", "2", "3", "4"], "4 numbers, must be 8"),
    (["--camera", "none.mp4", "--parameters", "1", "2", "3", "4"], "none.mp4: OpenCV cannot open it"),
    (["--camera", "oak", "--fisheye"], "its calibration is the device's"),
    (["--camera", "realsense", "--readout", "20"], "no --parameters, --fisheye or --readout"),
    (["--camera", "oak", "--size", "big"], "is big, must be WxH"),
    (["--camera", "oak", "--size", "0x400"], "is 0x400, must be WxH"),
])
def test_mistakes_are_named(arguments, message):
    pytest.importorskip("cv2")
    with pytest.raises((ValueError, RuntimeError), match=message):
        live.open_source(options(*arguments))


def test_missing_packages_are_named(monkeypatch):
    for package, device, hint in (("pyrealsense2", RealSense, "pip install pyrealsense2"), ("depthai", Oak, "depthai>=3")):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(RuntimeError, match=hint):
            device()
