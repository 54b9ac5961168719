# SPDX-License-Identifier: Apache-2.0
"""Errors of a trajectory, of each motion in it too, and which of them nobody was told of. Without packages.

A pose is (R, p): R is a list of three rows and maps the camera's axes to the world's, p is metres."""
import bisect
import csv
import math

# A motion that is wrong by no more than the largest of these is not wrong.
LEAST_M = 0.05
SHARE_OF_PATH = 0.02
DEVIATIONS = 3
CHI_SQUARE_95 = 12.592  # of 6 numbers
MOVING_M = 0.002  # a frame, and more


def product(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(len(b))) for j in range(len(b[0]))] for i in range(len(a))]


def transposed(a):
    return [list(row) for row in zip(*a)]


def rotated(R, v):
    return [sum(R[i][k] * v[k] for k in range(3)) for i in range(3)]


def difference(a, b):
    return [x - y for x, y in zip(a, b)]


def length(v):
    return math.sqrt(sum(x * x for x in v))


def rotation_of(x, y, z, w):
    """Of a quaternion of any length above 0."""
    n = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / n, y / n, z / n, w / n
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def relative(a, b):
    """The pose b in the frame of a."""
    back = transposed(a[0])
    return product(back, b[0]), rotated(back, difference(b[1], a[1]))


def small_turn(R):
    """The rotation vector of a rotation by less than half a turn."""
    w = [R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]]
    sine, cosine = 0.5 * length(w), 0.5 * (R[0][0] + R[1][1] + R[2][2] - 1)
    scale = 0.5 if sine < 1e-9 else 0.5 * math.atan2(sine, cosine) / sine
    return [scale * x for x in w]


def read_tum(path):
    """Dictionary of poses by their stamps, which are texts: the same in all files of a run."""
    poses = {}
    for line in open(path, encoding="utf-8"):
        if not line.strip() or line.startswith("#"):
            continue
        stamp, *numbers = line.split()
        px, py, pz, *q = (float(n) for n in numbers)
        poses[stamp] = (rotation_of(*q), [px, py, pz])
    return poses


def aligned_positions(estimate, truth):
    """The positions of the estimate, moved as a whole onto those of the truth (Horn, JOSA A 4(4), 1987)."""
    n = len(estimate)
    e0 = [sum(p[k] for p in estimate) / n for k in range(3)]
    t0 = [sum(p[k] for p in truth) / n for k in range(3)]
    s = [[0.0] * 3 for _ in range(3)]
    for e, t in zip(estimate, truth):
        a, b = difference(e, e0), difference(t, t0)
        for i in range(3):
            for j in range(3):
                s[i][j] += a[i] * b[j] / n
    matrix = [
        [s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]],
        [0, s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
        [0, 0, -s[0][0] + s[1][1] - s[2][2], s[1][2] + s[2][1]],
        [0, 0, 0, -s[0][0] - s[1][1] + s[2][2]],
    ]
    for i in range(4):
        for j in range(i):
            matrix[i][j] = matrix[j][i]
    w, x, y, z = largest_eigenvector(matrix)
    R = rotation_of(x, y, z, w)
    return [[c + d for c, d in zip(rotated(R, difference(e, e0)), t0)] for e in estimate]


def largest_eigenvector(m):
    """Of a symmetric matrix, by Jacobi's rotations."""
    n = len(m)
    m = [list(row) for row in m]
    v = [[float(i == j) for j in range(n)] for i in range(n)]
    for _ in range(60):
        i, j = max(((i, j) for i in range(n) for j in range(i + 1, n)), key=lambda at: abs(m[at[0]][at[1]]))
        if abs(m[i][j]) < 1e-300:
            break
        angle = 0.5 * math.atan2(2 * m[i][j], m[j][j] - m[i][i])
        c, s = math.cos(angle), math.sin(angle)
        for k in range(n):
            m[k][i], m[k][j] = c * m[k][i] - s * m[k][j], s * m[k][i] + c * m[k][j]
        for k in range(n):
            m[i][k], m[j][k] = c * m[i][k] - s * m[j][k], s * m[i][k] + c * m[j][k]
        for k in range(n):
            v[k][i], v[k][j] = c * v[k][i] - s * v[k][j], s * v[k][i] + c * v[k][j]
    best = max(range(n), key=lambda k: m[k][k])
    return [v[k][best] for k in range(n)]


def covariance_of(row):
    """6 x 6 of a row of times.csv, rotation first; nothing where it has none."""
    if not row.get("covariance_00"):
        return None
    m = [[0.0] * 6 for _ in range(6)]
    for i in range(6):
        for j in range(i, 6):
            m[i][j] = m[j][i] = float(row[f"covariance_{i}{j}"])
    return m if all(math.isfinite(x) for line in m for x in line) else None


def motion_covariance(of_from, of_to, motion):
    """Of the relative pose of two frames whose errors are independent, as a twist in the later one's frame.

    Both are of a twist x in T_world_camera * exp(x). exp(-a) D exp(b) = D exp(-Ad(D^-1) a + b), rotation first."""
    back = transposed(motion[0])
    x, y, z = (-c for c in rotated(back, motion[1]))
    cross = product([[0, -z, y], [z, 0, -x], [-y, x, 0]], back)
    adjoint = [back[i] + [0, 0, 0] for i in range(3)] + [cross[i] + back[i] for i in range(3)]
    moved = product(product(adjoint, of_from), transposed(adjoint))
    return [[a + b for a, b in zip(r, s)] for r, s in zip(moved, of_to)]


def deviation_along(covariance, direction):
    """Standard deviation of the translation in the direction of an error."""
    n = length(direction)
    if n == 0:
        return 0.0
    u = [d / n for d in direction]
    return math.sqrt(max(0.0, sum(u[i] * covariance[3 + i][3 + j] * u[j] for i in range(3) for j in range(3))))


def squared_mahalanobis(covariance, x):
    """x^T covariance^-1 x; nothing where the covariance is singular."""
    n = len(x)
    rows = [list(covariance[i]) + [x[i]] for i in range(n)]
    for i in range(n):
        pivot = max(range(i, n), key=lambda r: abs(rows[r][i]))
        if abs(rows[pivot][i]) < 1e-30:
            return None
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for r in range(i + 1, n):
            factor = rows[r][i] / rows[i][i]
            rows[r] = [a - factor * b for a, b in zip(rows[r], rows[i])]
    solved = [0.0] * n
    for i in reversed(range(n)):
        solved[i] = (rows[i][n] - sum(rows[i][k] * solved[k] for k in range(i + 1, n))) / rows[i][i]
    return sum(a * b for a, b in zip(x, solved))


class Frame:
    """One frame of a run. `pose` is nothing where it is not tracked, `truth` where there is none."""

    def __init__(self, row, pose, truth, told):
        self.time_s = float(row["time_s"])
        self.pose, self.truth = pose, truth
        self.covariance = covariance_of(row)
        self.keyframe = row["keyframe"] == "1"
        self.warnings = warnings_of(row) | told
        self.imu_known = bool(row.get("velocity_x"))
        self.imu_used = row.get("imu_optimized") == "1"
        self.silent = False
        turn = [row.get(f"imu_turn_{axis}") for axis in "xyz"]
        self.imu_turn = [float(v) for v in turn] if all(turn) else None
        self.clock_s = float(row["imu_clock_offset_s"]) if row.get("imu_clock_offset_s") else None

    @property
    def tracked(self):
        return self.pose is not None


def warnings_of(row):
    """Names in the columns `warnings` and `reason` of a row of times.csv."""
    names = row.get("warnings") or ""
    for separator in ";|,":
        names = names.replace(separator, " ")
    return set(names.split()) | ({row["reason"]} if row.get("reason") else set())


def read_frames(folder, told=frozenset()):
    """Those of a run of track_sequence. @param told warnings that held for the whole run"""
    poses, truth = read_tum(folder / "trajectory.txt"), read_tum(folder / "groundtruth.txt")
    with open(folder / "times.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [Frame(r, poses.get(r["time_s"]) if r["tracked"] == "1" else None, truth.get(r["time_s"]), set(told)) for r in rows]


class Motion:
    """From one tracked frame to a later one."""

    def __init__(self, frames, begin, end, paths):
        a, b = frames[begin], frames[end]
        estimated, true = relative(a.pose, b.pose), relative(a.truth, b.truth)
        error = relative(true, estimated)
        self.path_m = paths[end] - paths[begin]
        self.error_m = length(difference(estimated[1], true[1]))
        self.covariance = None
        if a.covariance and b.covariance:
            self.covariance = motion_covariance(a.covariance, b.covariance, estimated)
        # the error as a twist in the later frame, to the first order
        self.twist = small_turn(error[0]) + rotated(transposed(estimated[0]), difference(estimated[1], true[1]))

    @property
    def is_wrong(self):
        deviation = deviation_along(self.covariance, self.twist[3:]) if self.covariance else 0.0
        return self.error_m > max(LEAST_M, SHARE_OF_PATH * self.path_m, DEVIATIONS * deviation)

    @property
    def squared_error(self):
        """In deviations of its covariance, squared; nothing without one."""
        return squared_mahalanobis(self.covariance, self.twist) if self.covariance else None

    @property
    def is_contained(self):
        """Whether the 95 % ellipsoid of its covariance has the error; nothing without one."""
        squared = self.squared_error
        return None if squared is None else squared <= CHI_SQUARE_95


def path_lengths(frames):
    """Metres that the true camera has gone until each frame."""
    paths, before = [], None
    for f in frames:
        step = length(difference(f.truth[1], before)) if f.truth and before else 0.0
        before = f.truth[1] if f.truth else before
        paths.append((paths[-1] if paths else 0.0) + step)
    return paths


def motions_of(frames, paths, seconds=None):
    """(index of the later frame, Motion) over one frame, or over a time, between tracked frames."""
    times = [f.time_s for f in frames]
    for end, f in enumerate(frames):
        begin = end - 1
        if seconds is not None:
            # the newest frame that is old enough; after a gap it is older
            begin = bisect.bisect_right(times, f.time_s - seconds + 1e-4) - 1
            if begin >= 0 and f.time_s - times[begin] > 1.5 * seconds:
                continue
        if begin >= 0 and all(g.tracked and g.truth for g in (frames[begin], f)):
            yield end, Motion(frames, begin, end, paths)


def root_mean_square(values):
    values = list(values)
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else None


def mark_silent(frames, *motions):
    """A frame is silent if it is tracked, without a warning, and its motion is wrong."""
    for moved in motions:
        for end, motion in moved:
            frames[end].silent |= motion.is_wrong and not frames[end].warnings


def warned_right(frames, *motions):
    """How many frames have a warning though each of their motions that is known is right."""
    known, wrong = set(), set()
    for moved in motions:
        for end, motion in moved:
            known.add(end)
            if motion.is_wrong:
                wrong.add(end)
    return sum(bool(frames[end].warnings) for end in known - wrong)


def deviation_told(motions, least=20):
    """How many times as large deviations are told as they are; nothing of fewer motions than these."""
    squared = [m.squared_error for m in motions]
    squared = [s for s in squared if s is not None]
    return math.sqrt(6 * len(squared) / sum(squared)) if len(squared) >= least and sum(squared) > 0 else None


def clock_offset(frames, newest=20):
    """That of the IMU as found, seconds: median over the newest frames that have one."""
    found = sorted(f.clock_s for f in frames[-newest:] if f.clock_s is not None)
    return found[len(found) // 2] if found else None


def figures(frames):
    """What a row of the scenarios has of one run."""
    paths = path_lengths(frames)
    steps, seconds = list(motions_of(frames, paths)), list(motions_of(frames, paths, 1.0))
    mark_silent(frames, steps, seconds)
    both = [f for f in frames if f.tracked and f.truth]
    apart = []
    if len(both) >= 3:
        moved = aligned_positions([f.pose[1] for f in both], [f.truth[1] for f in both])
        apart = [length(difference(p, f.truth[1])) for p, f in zip(moved, both)]
    contained = [m.is_contained for _, m in steps if m.path_m >= MOVING_M and m.is_contained is not None]
    names = sorted({w for f in frames for w in f.warnings})
    known = [f for f in frames if f.imu_known]
    return {
        "frames": len(frames),
        "path_m": paths[-1] if paths else 0.0,
        "ate_m": root_mean_square(apart),
        "max_error_m": max(apart) if apart else None,
        "rpe_frame_m": root_mean_square(m.error_m for _, m in steps),
        "rpe_second_m": root_mean_square(m.error_m for _, m in seconds),
        "lost": sum(not f.tracked for f in frames),
        "keyframes": sum(f.keyframe for f in frames),
        "silent": sum(f.silent for f in frames),
        "warned_right": warned_right(frames, steps, seconds),
        "warnings": {n: sum(n in f.warnings for f in frames) for n in names},
        "contained": sum(contained) / len(contained) if contained else None,
        "deviation_at_rest": deviation_told(m for _, m in steps if m.path_m < MOVING_M),
        "imu_used": sum(f.imu_used for f in known) / len(known) if known else None,
    }
