# SPDX-License-Identifier: Apache-2.0
"""Faults of recordings: a generated sequence with other lists of images, other samples of the IMU, another calibration.

A fault is a function that changes a Recording. Times are seconds from its first frame."""
import copy
import math
import pathlib
import random
import re

GRAVITY = 9.81
SENSOR = {"gyro": 1, "accel": 2}  # where a sample has them


def numbers_of(matrix_text):
    return [float(n) for n in re.search(r"data: \[([^\]]*)\]", matrix_text).group(1).split(",")]


class Recording:
    """The text files of a sequence in EuRoC layout, as write_asl writes them. Images stay where they are."""

    def __init__(self, source):
        self.source = pathlib.Path(source).resolve()
        mav = self.source / "mav0"
        lists = [self.lines(mav / camera / "data.csv") for camera in ("cam0", "cam1")]
        # [time in ns, left file, right file]
        self.frames = [[int(a[0]), a[1], b[1]] for a, b in zip(*lists)]
        # [time in ns, gyroscope, accelerometer]
        self.imu = [[int(f[0]), [float(x) for x in f[1:4]], [float(x) for x in f[4:7]]] for f in self.lines(mav / "imu0/data.csv")]
        self.truth = [(int(f[0]), f[1:]) for f in self.lines(mav / "state_groundtruth_estimate0/data.csv")]
        self.sensors = {n: (mav / n / "sensor.yaml").read_text() for n in ("cam0", "cam1", "imu0", "state_groundtruth_estimate0")}
        self.begin_ns = self.frames[0][0]

    @staticmethod
    def lines(path):
        return [line.split(",") for line in path.read_text().splitlines() if line and not line.startswith("#")]

    def seconds(self, time_ns):
        return 1e-9 * (time_ns - self.begin_ns)

    def samples(self, begin_s, end_s):
        """Those of the IMU in a time."""
        return [s for s in self.imu if begin_s - 1e-9 <= self.seconds(s[0]) < end_s - 1e-9]

    def write(self, folder):
        mav = pathlib.Path(folder) / "mav0"
        for name, text in self.sensors.items():
            if name == "imu0" and not self.imu:
                continue
            (mav / name).mkdir(parents=True)
            (mav / name / "sensor.yaml").write_text(text)
        for k, camera in enumerate(("cam0", "cam1")):
            (mav / camera / "data").symlink_to(self.source / "mav0" / camera / "data")
            self.write_lines(mav / camera, "#timestamp [ns],filename", [(f[0], f[1 + k]) for f in self.frames])
        if self.imu:
            self.write_lines(mav / "imu0", "#timestamp [ns],gyro [rad/s] 3,accel [m/s^2] 3", [[s[0], *s[1], *s[2]] for s in self.imu])
        self.write_lines(mav / "state_groundtruth_estimate0", "#timestamp,state", [[t, *rest] for t, rest in self.truth])

    @staticmethod
    def write_lines(folder, head, rows):
        (folder / "data.csv").write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")


def direction(seed):
    """A unit vector, each equally likely."""
    draw = random.Random(seed)
    v = [draw.gauss(0, 1) for _ in range(3)]
    n = math.sqrt(sum(x * x for x in v))
    return [x / n for x in v]


# ---- images


def every(n):
    """Every n-th frame."""

    def apply(r):
        r.frames = r.frames[::n]

    return apply


def without_images(begin_s, end_s):
    def apply(r):
        r.frames = [f for f in r.frames if not begin_s - 1e-9 <= r.seconds(f[0]) < end_s - 1e-9]

    return apply


def late_right(frames=1):
    """The right camera's images come so many frames late."""

    def apply(r):
        files = [f[2] for f in r.frames]
        for i, f in enumerate(r.frames):
            f[2] = files[max(0, i - frames)]

    return apply


def rows_apart(pixels):
    """The right camera's calibration has its principal point so much too low: the rows of the pair do not correspond."""

    def apply(r):
        def lower(found):
            return f"{found[1]}{float(found[2]) + pixels}]"

        r.sensors["cam1"] = re.sub(r"(intrinsics: \[[^\]]*, )([^\],]*)\]", lower, r.sensors["cam1"])

    return apply


def repeated_images(begin_s, end_s, cameras=(0, 1)):
    """The image at the beginning is repeated until the end."""

    def apply(r):
        held = None
        for f in r.frames:
            if begin_s - 1e-9 <= r.seconds(f[0]) < end_s - 1e-9:
                held = held or list(f)
                for c in cameras:
                    f[1 + c] = held[1 + c]

    return apply


def in_order(indices):
    """These frames, as if taken one after the other. The IMU's samples are of another motion then: there are none."""

    def apply(r):
        truth = dict(r.truth)
        interval_ns = r.frames[1][0] - r.frames[0][0]
        times = [r.begin_ns + k * interval_ns for k in range(len(indices))]
        old = [r.frames[i] for i in indices]
        r.frames = [[t, f[1], f[2]] for t, f in zip(times, old)]
        r.truth = [(t, truth[f[0]]) for t, f in zip(times, old)]
        r.imu = []

    return apply


def jumps(count, between=8, metres=1.2, degrees=25.0):
    """So many jumps, each larger than the one before, up to a distance and an angle; frames in between follow each other."""

    def apply(r):
        indices, at = jump_indices(places_of(r), count, between, metres, degrees)
        in_order(indices)(r)
        r.jumps = at

    return apply


def places_of(r):
    """(position, quaternion w x y z) of each frame."""
    truth = dict(r.truth)
    return [([float(x) for x in truth[f[0]][0:3]], [float(x) for x in truth[f[0]][3:7]]) for f in r.frames]


def distance_and_angle(a, b):
    turned = min(1.0, abs(sum(x * y for x, y in zip(a[1], b[1]))))
    return math.dist(a[0], b[0]), math.degrees(2 * math.acos(turned))


def jump_indices(places, count, between, metres, degrees):
    """Frames in their order, and the numbers of those after a jump: the frame that fits a wanted jump best."""
    indices, after = list(range(between)), []
    for k in range(1, count + 1):
        wanted, now = k / count, indices[-1]
        ends = [j for j in range(len(places) - between) if abs(j - now) > 1]

        def misfit(j, now=now, wanted=wanted):
            moved, turned = distance_and_angle(places[now], places[j])
            return abs(moved / metres - wanted) + abs(turned / degrees - wanted)

        if not ends:
            break
        to = min(ends, key=misfit)
        after.append(len(indices))
        indices += range(to, to + between)
    return indices, after


# ---- samples of the IMU


def sensor_bias(sensor, amount, seed):
    """Added to a sensor, in a direction that the seed tells."""
    by = [amount * x for x in direction(seed)]

    def apply(r):
        for s in r.imu:
            s[SENSOR[sensor]] = [a + b for a, b in zip(s[SENSOR[sensor]], by)]

    return apply


def spike(sensor, value, at_s):
    """One sample has this value on its first axis."""

    def apply(r):
        r.samples(at_s, at_s + 1)[0][SENSOR[sensor]][0] = value

    return apply


def saturated(sensor, value, begin_s, end_s):
    """The first axis is at its limit for a time."""

    def apply(r):
        for s in r.samples(begin_s, end_s):
            s[SENSOR[sensor]][0] = value

    return apply


def held_samples(begin_s, end_s, zeros=False):
    """Samples are all zero for a time, or stay what they were."""

    def apply(r):
        held = None
        for s in r.samples(begin_s, end_s):
            held = held or [[0.0] * 3, [0.0] * 3] if zeros else held or copy.deepcopy(s[1:])
            s[1:] = copy.deepcopy(held)

    return apply


def late_clock(milliseconds):
    """The IMU's stamps are so much later than those of the cameras; less than 0 for earlier."""

    def apply(r):
        for s in r.imu:
            s[0] += round(1e6 * milliseconds)
        r.clock_ms = milliseconds

    return apply


def scaled(sensor, factor):
    def apply(r):
        for s in r.imu:
            s[SENSOR[sensor]] = [factor * x for x in s[SENSOR[sensor]]]

    return apply


def swapped_axes(r):
    """x and y of both sensors."""
    for s in r.imu:
        for k in (1, 2):
            x, y, z = s[k]
            s[k] = [y, x, z]


def turned_imu(degrees, seed):
    """The IMU is mounted otherwise than its calibration says, by a turn about an axis that the seed tells."""
    x, y, z = direction(seed)
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    cross = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    axis = (x, y, z)
    R = [[c * (i == j) + (1 - c) * axis[i] * axis[j] + s * cross[i][j] for j in range(3)] for i in range(3)]

    def apply(r):
        r.turned_rad = [math.radians(degrees) * a for a in axis]  # as late_clock() says what it did
        for sample in r.imu:
            for k in (1, 2):
                sample[k] = [sum(R[i][j] * sample[k][j] for j in range(3)) for i in range(3)]

    return apply


def only_samples(begin_s=-math.inf, end_s=math.inf):
    """The IMU starts late, or stops."""

    def apply(r):
        r.imu = [s for s in r.imu if begin_s <= r.seconds(s[0]) < end_s]

    return apply


# ---- calibration


def wrong_rate(factor):
    """imu0 says a rate that is not that of the samples."""

    def apply(r):
        r.sensors["imu0"] = re.sub(r"rate_hz: (\S+)", lambda m: f"rate_hz: {factor * float(m.group(1))}", r.sensors["imu0"])

    return apply


def inverted_extrinsics(r):
    """Where the IMU should be seen from the camera, the camera is seen from the IMU. The cameras' own stay."""
    T_body_left = as_rows(numbers_of(r.sensors["cam0"]))
    T_body_imu = multiplied(T_body_left, multiplied(T_body_left, as_rows(numbers_of(r.sensors["imu0"]))))
    data = "data: [" + ", ".join(repr(x) for row in T_body_imu for x in row) + "]"
    r.sensors["imu0"] = re.sub(r"data: \[[^\]]*\]", data, r.sensors["imu0"])


def as_rows(numbers):
    return [numbers[4 * i : 4 * i + 4] for i in range(4)]


def multiplied(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]
