# SPDX-License-Identifier: Apache-2.0
"""Bags that rosbags' own writers have written: ROS 1, ROS 2 in SQLite and in MCAP."""

import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import BASELINE, CAMERA, HEIGHT, WIDTH, Walk
from test_sequences import write_png

import ft
from ft import bag_frames, bag_images, bags

pytest.importorskip("rosbags", reason="rosbags is not installed: no bags are read")
from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

FRAMES = 8
FIRST_NS = 1_700_000_000_000_000_000
F, _, CX, CY = CAMERA


class Bag:
    """Writes messages to a bag of a kind: bag, db3 or mcap."""

    def __init__(self, folder, kind):
        self.ros1 = kind == "bag"
        self.types = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            self.path = folder / "run.bag"
            self._writer = Writer1(self.path)
        else:
            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            self.path = folder / "run" / f"run.{kind}"
            self._writer = Writer2(folder / "run", version=9, storage_plugin=plugin)
        self._writer.open()
        self._connections = {}

    def make(self, name, **values):
        return self.types.types[name](**values)

    def header(self, time_ns, frame="camera"):
        stamp = self.make("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        sequence = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **sequence)

    def write(self, topic, message, time_ns):
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.types)
        pack = self.types.serialize_ros1 if self.ros1 else self.types.serialize_cdr
        self._writer.write(self._connections[topic], time_ns, pack(message, kind))

    def image(self, topic, image, time_ns, encoding="mono8", pad=0, stamped=True, frame="camera", big=False):
        height, width = image.shape[:2]
        rows = np.ascontiguousarray(image).view(np.uint8).reshape(len(image), -1)
        padded = np.pad(rows, ((0, 0), (0, pad)), constant_values=77)
        self.write(topic, self.make(
            "sensor_msgs/msg/Image", header=self.header(time_ns if stamped else 0, frame), height=height,
            width=width, encoding=encoding, is_bigendian=int(big), step=padded.shape[1], data=padded.reshape(-1)), time_ns)

    def compressed(self, topic, data, form, time_ns):
        self.write(topic, self.make("sensor_msgs/msg/CompressedImage", header=self.header(time_ns), format=form,
                                    data=np.frombuffer(data, np.uint8)), time_ns)

    def info(self, topic, baseline=0.0, distortion=(0.0,) * 5, time_ns=FIRST_NS, model="plumb_bob", rectified=True,
             height=HEIGHT):
        up = str.upper if self.ros1 else str
        roi = self.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        matrices = {"d": distortion, "k": [F, 0, CX, 0, F, CY, 0, 0, 1], "r": [1, 0, 0, 0, 1, 0, 0, 0, 1],
                    "p": [F, 0, CX, -F * baseline, 0, F, CY, 0, 0, 0, 1, 0] if rectified else [0.0] * 12}
        self.write(topic, self.make(
            "sensor_msgs/msg/CameraInfo", header=self.header(time_ns), height=height, width=WIDTH, distortion_model=model,
            binning_x=0, binning_y=0, roi=roi, **{up(k): np.array(v, np.float64) for k, v in matrices.items()}), time_ns)

    def imu(self, topic, time_ns):
        vector, unknown = "geometry_msgs/msg/Vector3", np.zeros(9)
        self.write(topic, self.make(
            "sensor_msgs/msg/Imu", header=self.header(time_ns, "imu"),
            orientation=self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0), orientation_covariance=unknown,
            angular_velocity=self.make(vector, x=0.0, y=0.0, z=0.0), angular_velocity_covariance=unknown,
            linear_acceleration=self.make(vector, x=0.0, y=-9.81, z=0.0), linear_acceleration_covariance=unknown), time_ns)

    def static(self, *motions, topic="/tf_static", time_ns=FIRST_NS):
        """Of (parent, child, T_parent_child) of no rotation, or one about z by a quarter."""
        vector, made = "geometry_msgs/msg/Vector3", []
        for parent, child, T in motions:
            q = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0} if T[0, 0] == 1 else {"x": 0.0, "y": 0.0, "z": 0.5**0.5, "w": 0.5**0.5}
            made.append(self.make(
                "geometry_msgs/msg/TransformStamped", header=self.header(0, parent), child_frame_id=child,
                transform=self.make("geometry_msgs/msg/Transform", translation=self.make(vector, x=T[0, 3], y=T[1, 3], z=T[2, 3]),
                                    rotation=self.make("geometry_msgs/msg/Quaternion", **q))))
        if "tf2_msgs/msg/TFMessage" not in self.types.types:  # not of rosbags' ROS 1
            self.types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
        self.write(topic, self.make("tf2_msgs/msg/TFMessage", transforms=made), time_ns)

    def pose(self, topic, time_ns):
        self.write(topic, self.make(
            "geometry_msgs/msg/PoseStamped", header=self.header(time_ns, "world"), pose=self.make(
                "geometry_msgs/msg/Pose", position=self.make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
                orientation=self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0))), time_ns)

    def close(self):
        self._writer.close()
        return self.path


def stereo_bag(folder, kind, walk, names=("left", "right")):
    bag = Bag(folder, kind)
    for i in range(FRAMES):
        left, right, t = walk.frame(i)
        for name, image, baseline in zip(names, (left, right), (0, BASELINE)):
            bag.info(f"/{name}/camera_info", baseline, time_ns=FIRST_NS + t)
            bag.image(f"/{name}/image_raw", image, FIRST_NS + t, pad=8)
        for k in range(10):
            bag.imu("/imu", FIRST_NS + t + 5_000_000 * k)
        bag.pose("/vicon/pose", FIRST_NS + t)
    return bag.close()


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_a_pair_is_found_and_tracked(kind, walk, tmp_path):
    path = stereo_bag(tmp_path, kind, walk)
    with pytest.warns(UserWarning, match="/imu: the samples of the IMU are not used"):  # their place is not known
        sequence = ft.read_sequence(path, imu=True)
    assert (sequence.layout, sequence.name, len(sequence)) == ("bag", path.name, FRAMES)
    assert isinstance(sequence.rig, ft.RectifiedPair) and sequence.rig.baseline == pytest.approx(BASELINE)
    odometry = walk.odometry()
    for i, frame in enumerate(sequence):
        left, right, t = walk.frame(i)
        assert frame.time_ns == FIRST_NS + t
        assert np.array_equal(frame.left, left) and np.array_equal(frame.right, right)
        pose = odometry.track(*frame.images, frame.time_ns)
        assert pose.tracked
    assert pose.T_world_camera[0, 3] == pytest.approx(walk.position(FRAMES - 1)[0], abs=0.01)
    lines = dict(sequence.describe())
    assert list(lines) == ["sequence", "cameras", "images", "imu", "truth"]
    assert f"ROS {1 if kind == 'bag' else 2} bag, /left/image_raw (mono8) and /right/image_raw" in lines["sequence"]
    assert lines["sequence"].endswith("calibration /left/camera_info and /right/camera_info")
    assert lines["images"].startswith("8 frames, 20 Hz") and lines["images"].endswith("times: headers of the messages")
    assert "80 samples of /imu" in lines["imu"] and lines["imu"].startswith("none: ")
    assert lines["truth"].startswith("none; ") and "/vicon/pose (8 PoseStamped)" in lines["truth"]
    folder = sequence._recording.folder
    assert folder.is_dir()
    del sequence
    assert not folder.exists()


def test_the_folder_of_a_bag_and_the_first_frames(walk, tmp_path):
    path = stereo_bag(tmp_path, "mcap", walk, ("cam0", "cam1"))
    assert len(ft.read_sequence(path.parent, max_frames=3)) == 3
    mono = ft.read_sequence(path, rig="mono")
    assert isinstance(mono.rig, ft.MonocularCamera) and len(mono) == FRAMES
    assert np.array_equal(mono[2].left, walk.frame(2)[0])
    other = ft.read_sequence(path, rig="mono", topics=["/cam1/image_raw"])
    assert np.array_equal(other[2].left, walk.frame(2)[1])


def test_the_program_says_what_it_found(walk, tmp_path):
    path = stereo_bag(tmp_path, "mcap", walk)
    run = subprocess.run([sys.executable, "-m", "ft", "track", str(path), "--backend", "host", "--out", str(tmp_path / "out"),
                          "--quiet"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    names = [line.split()[0] for line in run.stdout.splitlines()[:6]]
    assert names == ["sequence", "cameras", "images", "imu", "truth", "backend"]
    assert len(ft.read_tum(tmp_path / "out" / "trajectory.txt")) == FRAMES
    run = subprocess.run([sys.executable, "-m", "ft", "track", str(path), "--topics", "/nothing"], capture_output=True, text=True)
    assert run.returncode == 1 and "/left/image_raw (mono8), /right/image_raw (mono8)" in run.stderr


def test_an_imu_is_used_with_kalibrs_chain(walk, tmp_path):
    path = stereo_bag(tmp_path, "bag", walk)
    camera = f"""camera_model: pinhole
  intrinsics: [{F}, {F}, {CX}, {CY}]
  distortion_model: none
  distortion_coeffs: []
  resolution: [{WIDTH}, {HEIGHT}]
  T_cam_imu: """
    place = "[[1.0, 0, 0, {}], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]"
    (tmp_path / "camchain-imucam.yaml").write_text(
        f"cam0:\n  {camera}{place.format(0.0)}\ncam1:\n  {camera}{place.format(-BASELINE)}\n"
        f"  T_cn_cnm1: {place.format(-BASELINE)}\n")
    (tmp_path / "imu.yaml").write_text("accelerometer_noise_density: 0.002\naccelerometer_random_walk: 0.003\n"
                                       "gyroscope_noise_density: 0.00017\ngyroscope_random_walk: 0.00002\nupdate_rate: 200.0\n")
    sequence = ft.read_sequence(path, imu=True, calibration=tmp_path / "camchain-imucam.yaml")
    assert sequence.imu is not None and len(sequence.imu_samples) == 10 * FRAMES
    assert sequence.imu_samples[1][0] == FIRST_NS + 5_000_000
    assert np.allclose(sequence.imu_samples[1][1], [0, -9.81, 0])


def motion(x, y, z, turned=False):
    T = np.eye(4)
    if turned:
        T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T[:3, 3] = [x, y, z]
    return T


# The body is neither a camera nor the IMU; what is searched for goes up and down the tree.
CAMERAS_BODY = (("body", "left_optical", motion(0.2, 0, 0, True)), ("body", "right_optical", motion(0.2, BASELINE, 0, True)),
                ("/body", "mount", motion(0, 0, 0.5)), ("mount", "imu", motion(0.1, 0, 0)))
T_IMU_LEFT = np.linalg.inv(motion(0.1, 0, 0.5)) @ motion(0.2, 0, 0, True)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize("rectified", [True, False])
def test_static_transforms_say_where_cameras_and_imu_are(kind, rectified, walk, tmp_path):
    bag = Bag(tmp_path, kind)
    bag.static(*CAMERAS_BODY)
    model, distortion = ("plumb_bob", (0.0,) * 5) if rectified else ("equidistant", (0.01, 0.0, 0.0, 0.0))
    for i in range(FRAMES):
        left, right, t = walk.frame(i)
        for name, image, baseline in zip(("left", "right"), (left, right), (0, BASELINE)):
            bag.info(f"/{name}/camera_info", baseline, distortion, FIRST_NS + t, model, rectified)
            bag.image(f"/{name}/image_raw", image, FIRST_NS + t, frame=f"{name}_optical")
        for k in range(10):
            bag.imu("/imu", FIRST_NS + t + 5_000_000 * k)
    path = bag.close()
    with pytest.warns(UserWarning, match="does not say the noise"):
        sequence = ft.read_sequence(path, imu=True)
    assert sequence.imu is not None and len(sequence.imu_samples) == 10 * FRAMES
    assert sequence.imu.rate_hz == pytest.approx(200)
    assert np.allclose(sequence.imu.T_imu_camera, T_IMU_LEFT, atol=1e-9)
    T_right_left = motion(-BASELINE, 0, 0)
    if rectified:
        assert isinstance(sequence.rig, ft.RectifiedPair) and sequence.rig.baseline == pytest.approx(BASELINE)
    else:
        assert isinstance(sequence.rig, ft.FisheyePair) and np.allclose(sequence.rig.T_right_left, T_right_left, atol=1e-9)
    assert "/tf_static" in sequence.describe()[0][1]


@pytest.mark.parametrize("name_of_frame, why", [
    ("{}_optical", "does not join the frames 'left_optical' and 'right_optical'"), ("both", "have the same frame 'both'"),
    ("", "images that name no frame"), ("{}_point", "'left_point' and 'right_point' at one point")])
def test_without_transforms_a_raw_pair_is_refused(name_of_frame, why, walk, tmp_path):
    bag = Bag(tmp_path, "mcap")
    left, right, t = walk.frame(0)
    for name, image in (("left", left), ("right", right)):
        bag.info(f"/{name}/camera_info", 0.0, (0.01, 0.0, 0.0, 0.0), FIRST_NS, "equidistant", False)
        bag.image(f"/{name}/image_raw", image, FIRST_NS, frame=name_of_frame.format(name))
    bag.static(("left_point", "right_point", motion(0, 0, 0)))
    with pytest.raises(RuntimeError, match=f"{why}.*--calibration"):
        ft.read_sequence(bag.close())


def test_frames_that_are_placed_twice_warn():
    frames = bag_frames.Frames()
    frames.add("body", "left", motion(0.1, 0, 0))
    frames.add("body", "left", motion(0.1, 0, 0))
    frames.add("mount", "left", motion(0, 0.2, 0))  # a second parent, joined by nothing else
    frames.add("body", "mount", motion(0.1, -0.2, 0))  # closes the loop
    assert not frames.warnings
    frames.add("body", "right", motion(0.2, 0, 0))
    frames.add("mount", "right", motion(0.3, 0, 0))  # by the body it is (0.1, 0.2, 0)
    assert len(frames.warnings) == 1 and "'right' in 'mount' in two ways" in frames.warnings[0]
    assert frames.find("", "") is None and frames.find("body", "/") is None
    assert np.array_equal(frames.find("body", "/body"), np.eye(4))


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_colour_with_depth(encoding, walk, tmp_path):
    bag = Bag(tmp_path, "db3")
    for i in range(FRAMES):
        left, _, t = walk.frame(i)
        bag.info("/camera/color/camera_info", distortion=[0.01, 0, 0, 0, 0], time_ns=FIRST_NS + t)
        bag.image("/camera/color/image_raw", np.repeat(left[:, :, None], 3, 2), FIRST_NS + t, "rgb8")
        depth = walk.depth(i)
        depth = depth if encoding == "16UC1" else np.where(depth > 2000, np.nan, 1e-3 * depth).astype(np.float32)
        bag.image("/camera/aligned_depth_to_color/image_raw", depth, FIRST_NS + t + 3_000_000, encoding)
    sequence = ft.read_sequence(bag.close())
    assert sequence.kind == "rgbd" and sequence.rig.depth_scale == pytest.approx(0.001) and len(sequence) == FRAMES
    assert "undistorted on load" in dict(sequence.describe())["cameras"]
    values = set(np.unique(sequence[3].images[1]))
    assert values <= ({1200, 3000} if encoding == "16UC1" else {0, 1200}) | {0} and 1200 in values


def colours(random):
    return random.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)


def read_back(folder, image, encoding, **how):
    bag = Bag(folder, "mcap")
    for i in range(2):
        bag.info("/cam/camera_info", time_ns=FIRST_NS + i)
        bag.image("/cam/image", image, FIRST_NS + 50_000_000 * i, encoding, **how)
    return ft.read_sequence(bag.close())


@pytest.mark.parametrize("order", ["rgb8", "bgr8", "rgba8", "bgra8"])
def test_colours_become_the_same_grey(order, tmp_path):
    image = colours(np.random.default_rng(5))
    given = image if order.startswith("rgb") else image[:, :, ::-1]
    if order.endswith("a8"):
        given = np.concatenate([given, np.full((HEIGHT, WIDTH, 1), 9, np.uint8)], axis=2)
    grey = read_back(tmp_path, given, order)[0].left
    wanted = image @ np.array([0.299, 0.587, 0.114])
    assert np.abs(grey - wanted).max() <= 1


@pytest.mark.parametrize("big", [False, True])
def test_the_range_of_twelve_bits(big, tmp_path):
    image = np.random.default_rng(6).integers(0, 4096, (HEIGHT, WIDTH)).astype(np.uint16)
    with pytest.warns(UserWarning, match="taken for images of 12 bits"):
        sequence = read_back(tmp_path, image.astype(">u2" if big else "<u2"), "mono16", big=big)
    assert np.abs(sequence[0].left - image * (255 / 4095)).max() <= 0.51


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_bayer_pattern_of_one_colour_is_grey(pattern, tmp_path):
    value = {"r": 40, "g": 120, "b": 200}
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    for k, colour in enumerate(pattern):
        image[k // 2::2, k % 2::2] = value[colour]
    grey = read_back(tmp_path, image, f"bayer_{pattern}8")[0].left
    assert (grey == (40 + 2 * 120 + 200) // 4).all()


def test_compressed_images_are_taken_as_they_are(walk, tmp_path):
    bag = Bag(tmp_path, "bag")
    for i in range(2):
        left, _, t = walk.frame(i)
        write_png(tmp_path / "one.png", left)
        bag.info("/cam/camera_info", time_ns=FIRST_NS + t)
        bag.compressed("/cam/image_raw/compressed", (tmp_path / "one.png").read_bytes(), "mono8; png compressed", FIRST_NS + t)
    sequence = ft.read_sequence(bag.close())
    assert len(sequence) == 2 and np.array_equal(sequence[1].left, walk.frame(1)[0])


@pytest.mark.parametrize("transport", ["", "/compressed"])
def test_a_camera_without_a_namespace_has_its_camera_info(transport, walk, tmp_path):
    bag = Bag(tmp_path, "mcap")
    bag.info("/camera_info")
    for i in range(3):
        left, _, t = walk.frame(i)
        write_png(tmp_path / "one.png", left)
        if transport:
            bag.compressed("/image_raw/compressed", (tmp_path / "one.png").read_bytes(), "mono8; png compressed", FIRST_NS + t)
        else:
            bag.image("/image_raw", left, FIRST_NS + t)
    sequence = ft.read_sequence(bag.close(), imu=True)
    assert isinstance(sequence.rig, ft.MonocularCamera) and np.array_equal(sequence[2].left, walk.frame(2)[0])
    lines = dict(sequence.describe())
    assert lines["sequence"].endswith("calibration /camera_info")
    assert lines["imu"] == "none: no topic of the type sensor_msgs/msg/Imu"
    assert dict(sequence.describe(imu=False))["imu"] == "not asked for"


@pytest.mark.parametrize("topics", [("/left", "/right"), ("/stereo/left", "/stereo/right"), ("/left/image", "/right/image")])
def test_one_camera_info_is_not_that_of_two_cameras(topics, walk, tmp_path):
    bag = Bag(tmp_path, "mcap")
    bag.info("/stereo/camera_info" if "stereo" in topics[0] else "/camera_info")
    for topic, image in zip(topics, walk.frame(0)):
        bag.image(topic, image, FIRST_NS)
    with pytest.raises(RuntimeError, match="holds no calibration; accepted are"):
        ft.read_sequence(bag.close())


def test_images_without_stamps_have_those_of_the_recording(tmp_path):
    with pytest.warns(UserWarning, match="headers have no stamps"):
        sequence = read_back(tmp_path, colours(np.random.default_rng(7)), "rgb8", stamped=False)
    assert [frame.time_ns for frame in sequence] == [FIRST_NS, FIRST_NS + 50_000_000]


def test_what_is_refused_says_what_is_accepted(walk, tmp_path):
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(b"no bag")
    with pytest.raises(RuntimeError, match="damaged.mcap: not a bag that can be read.*; mcap recover mends one"):
        ft.read_sequence(damaged)
    with pytest.raises(RuntimeError, match="none.bag: no such file"):
        ft.read_sequence(tmp_path / "none.bag")
    note = tmp_path / "note.doc"
    note.write_text("x")
    with pytest.raises(RuntimeError, match=r"accepted are a folder .*\.mcap.*\.mp4"):
        ft.read_sequence(note)
    with pytest.raises(RuntimeError, match="yuv444.*accepted are mono8"):
        read_back(tmp_path, np.zeros((HEIGHT, WIDTH), np.uint8), "yuv444")
    (tmp_path / "b").mkdir()
    bag = Bag(tmp_path / "b", "bag")
    bag.imu("/imu", FIRST_NS)
    with pytest.raises(RuntimeError, match="no images of a camera"):
        ft.read_sequence(bag.close())
    (tmp_path / "c").mkdir()
    bag = Bag(tmp_path / "c", "bag")
    bag.image("/front/image", walk.frame(0)[0], FIRST_NS)
    bag.image("/rear/image", walk.frame(0)[0], FIRST_NS)
    path = bag.close()
    with pytest.raises(RuntimeError, match=r"several cameras: /front/image \(mono8\), /rear/image"):
        ft.read_sequence(path)
    with pytest.raises(RuntimeError, match=re.escape(f"{path}: holds no calibration; accepted are Kalibr's")):
        ft.read_sequence(path, topics=["/front/image"])
    with pytest.raises(RuntimeError, match="no pair of topics"):
        ft.read_sequence(path, rig="stereo")
    with pytest.raises(RuntimeError, match="no depth images"):
        ft.read_sequence(path, rig="rgbd")


def test_a_message_that_is_cut_off_is_refused():
    message = SimpleNamespace(encoding="mono8", width=8, height=4, step=8, is_bigendian=0, data=np.zeros(31, np.uint8))
    with pytest.raises(bag_images.Refused, match="31 bytes in rows of 8, must have 32"):
        bag_images.values_of(message, "/cam")


@pytest.mark.parametrize("text, depth", [("16UC1; png compressed", True), ("mono8; png compressed", False),
                                         ("16UC1; compressedDepth png", True), ("rgb8; jpeg compressed bgr8", False)])
def test_a_compressed_depth_is_no_camera(text, depth):
    assert bag_images.is_depth(SimpleNamespace(format=text), "/camera/image") == depth


@pytest.mark.parametrize("topic, rectified", [("/left/image_rect", True), ("/left/image_rect_color", True),
                                              ("/left/image_unrectified", False), ("/camera_direct/image_raw", False)])
def test_rect_is_a_word_of_a_topic(topic, rectified):
    stream = bags.Stream([SimpleNamespace(topic=topic)], SimpleNamespace())
    assert stream.rectified == rectified


@pytest.mark.parametrize("kind", ["db3", "bag"])
def test_a_damaged_bag_names_itself(kind, walk, tmp_path):
    bag = Bag(tmp_path, kind)
    for frame in range(3):
        bag.image("/cam/image_raw", walk.frame(frame)[0], FIRST_NS + frame * 50_000_000)
    path = bag.close()
    data = bytearray(path.read_bytes())
    data[len(data) // 4:-len(data) // 4] = b"\xff" * (len(data[len(data) // 4:-len(data) // 4]))
    path.write_bytes(data)
    with pytest.raises(RuntimeError, match="run"):
        ft.read_sequence(path)


def test_what_progress_raises_comes_as_it_is(walk, tmp_path):
    path = stereo_bag(tmp_path, "mcap", walk)

    def stop(images):
        raise LookupError(f"{images} images")

    with pytest.raises(LookupError, match="images"):
        ft.read_sequence(path, progress=stop)


def test_an_image_of_another_size_is_named_by_its_time(walk, tmp_path):
    bag = Bag(tmp_path, "mcap")
    for frame in range(3):
        bag.info("/cam/camera_info", time_ns=FIRST_NS)
        bag.image("/cam/image_raw", walk.frame(frame)[0][:HEIGHT - 2 * (frame == 2)], FIRST_NS + frame * 50_000_000)
    sequence = ft.read_sequence(bag.close())
    assert sequence[-3].time_ns == sequence[np.int64(0)].time_ns == FIRST_NS
    with pytest.raises(RuntimeError, match=r"/cam/image_raw, image of 1700000000\.100000000 s: image is"):
        sequence[2]
    with pytest.raises(IndexError, match="frame 3 of 3"):
        sequence[3]
    with pytest.raises(TypeError, match="slice"):
        sequence[0:2]
