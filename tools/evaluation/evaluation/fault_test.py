# SPDX-License-Identifier: Apache-2.0
"""Tests of the faults, without ft: on a recording of a few lines."""
import math
import pathlib
import re
import tempfile
import unittest

from . import faults

SENSOR = """sensor_type: {kind}
T_BS:
  cols: 4
  rows: 4
  data: [{data}]
rate_hz: {rate}
intrinsics: [210.5, 211.5, 160.25, 120.75] #fu, fv, cu, cv
"""
IDENTITY = "1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1"
ASIDE = "0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1"  # a quarter of a turn about z
BEGIN = 1_600_000_000_000_000_000


def stamp(i, rate):
    return BEGIN + round(1e9 * i / rate)


def make_sequence(folder, frames=40):
    """20 images and 200 samples a second; sample i is (i, 0, 0), (0, 0, 100 + i); frame i is at x = 0.1 i, turned by i degrees."""
    mav = folder / "mav0"
    for name, data, rate in (("cam0", ASIDE, 20), ("cam1", IDENTITY, 20), ("imu0", IDENTITY, 200), ("state_groundtruth_estimate0", IDENTITY, 200)):
        (mav / name).mkdir(parents=True)
        (mav / name / "sensor.yaml").write_text(SENSOR.format(kind=name, data=data, rate=rate))
    for camera in ("cam0", "cam1"):
        (mav / camera / "data").mkdir()
        rows = [f"{stamp(i, 20)},{stamp(i, 20)}.png" for i in range(frames)]
        (mav / camera / "data.csv").write_text("#stamp,file\n" + "\n".join(rows) + "\n")
    samples = range(10 * frames)
    (mav / "imu0/data.csv").write_text("#\n" + "".join(f"{stamp(i, 200)},{i},0,0,0,0,{100 + i}\n" for i in samples))
    half = math.radians(0.5)
    states = [f"{stamp(i, 20)},{0.1 * i},0,0,{math.cos(i * half)},0,0,{math.sin(i * half)},0,0,0" for i in range(frames)]
    (mav / "state_groundtruth_estimate0/data.csv").write_text("#\n" + "\n".join(states) + "\n")
    return folder


class Faults(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.root = pathlib.Path(temporary.name)
        self.source = make_sequence(self.root / "source")

    def changed(self, *made):
        """Written and read again."""
        r = faults.Recording(self.source)
        for fault in made:
            fault(r)
        folder = self.root / f"out_{len(list(self.root.iterdir()))}"
        r.write(folder)
        self.assertTrue((folder / "mav0/cam0/data").samefile(self.source / "mav0/cam0/data"))
        return faults.Recording(folder) if r.imu else r

    def stamps(self, recording):
        return [round(20 * recording.seconds(f[0])) for f in recording.frames]

    def shown(self, recording, camera):
        """Numbers of the images of a camera."""
        return [round(20e-9 * (int(f[1 + camera][:-4]) - BEGIN)) for f in recording.frames]

    def test_without_a_fault_nothing_changes(self):
        a, b = faults.Recording(self.source), self.changed()
        self.assertEqual((a.frames, a.imu, a.truth, a.sensors), (b.frames, b.imu, b.truth, b.sensors))

    def test_every_second_image(self):
        r = self.changed(faults.every(2))
        self.assertEqual(self.stamps(r), list(range(0, 40, 2)))
        self.assertEqual(self.shown(r, 1), self.stamps(r))
        self.assertEqual(len(r.imu), 400)

    def test_no_images_for_a_time(self):
        self.assertEqual(self.stamps(self.changed(faults.without_images(0.5, 1))), [*range(10), *range(20, 40)])

    def test_the_right_image_is_late(self):
        r = self.changed(faults.late_right())
        self.assertEqual(self.shown(r, 0), list(range(40)))
        self.assertEqual(self.shown(r, 1), [0, *range(39)])
        self.assertEqual(self.stamps(r), list(range(40)))

    def test_rows_are_apart(self):
        r, before = self.changed(faults.rows_apart(2.5)), faults.Recording(self.source)
        intrinsics = [re.search(r"intrinsics: \[(.*)\]", x.sensors["cam1"])[1].split(",") for x in (before, r)]
        moved = [float(b) - float(a) for a, b in zip(*intrinsics)]
        self.assertEqual(moved, [0, 0, 0, 2.5])
        self.assertEqual(r.sensors["cam0"], before.sensors["cam0"])

    def test_images_are_repeated(self):
        both, left = self.changed(faults.repeated_images(0.5, 0.7)), self.changed(faults.repeated_images(0.5, 0.7, (0,)))
        held = [*range(10), 10, 10, 10, 10, *range(14, 40)]
        self.assertEqual((self.shown(both, 0), self.shown(both, 1)), (held, held))
        self.assertEqual((self.shown(left, 0), self.shown(left, 1)), (held, list(range(40))))
        self.assertEqual(self.stamps(both), list(range(40)))

    def test_jumps_are_of_the_sizes_wanted_and_truth_goes_along(self):
        r = faults.Recording(self.source)
        faults.jumps(4, between=3, metres=1.2, degrees=12)(r)
        self.assertEqual(r.jumps, [3, 6, 9, 12])
        shown = self.shown(r, 0)
        for at, wanted in zip(r.jumps, (3, 6, 9, 12)):  # a frame is 0.1 m and 1 degree
            self.assertEqual(abs(shown[at] - shown[at - 1]), wanted)
        self.assertEqual(self.stamps(r), list(range(15)))
        self.assertEqual(r.imu, [])
        truth = dict(r.truth)
        for f, number in zip(r.frames, shown):
            self.assertAlmostEqual(float(truth[f[0]][0]), 0.1 * number)

    def test_there_may_be_more_frames_in_another_order_than_there_were(self):
        r = faults.Recording(self.source)
        faults.jumps(31, between=8)(r)
        self.assertEqual(self.stamps(r), list(range(8 * 32)))
        self.assertEqual(r.jumps, list(range(8, 8 * 32, 8)))
        short = faults.Recording(self.source)
        short.frames = short.frames[:8]
        faults.jumps(31, between=8)(short)
        self.assertEqual((len(short.frames), short.jumps), (8, []))

    def test_a_bias_has_its_length_and_the_seeds_direction(self):
        r, other = self.changed(faults.sensor_bias("accel", 0.7, 1)), self.changed(faults.sensor_bias("accel", 0.7, 2))
        by = [a - b for a, b in zip(r.imu[5][2], [0, 0, 105])]
        self.assertAlmostEqual(math.hypot(*by), 0.7)
        self.assertGreater(math.dist(r.imu[5][2], other.imu[5][2]), 0.01)
        self.assertEqual(r.imu[5][1], [5, 0, 0])

    def test_one_sample_is_a_spike(self):
        r = self.changed(faults.spike("accel", 1e7, 1))
        self.assertEqual([k for k, s in enumerate(r.imu) if s[2][0] != 0], [200])
        self.assertEqual(r.imu[200][2], [1e7, 0, 300])
        self.assertEqual(self.changed(faults.spike("gyro", -5, 1)).imu[200][1], [-5, 0, 0])

    def test_samples_are_saturated_for_a_time(self):
        r = self.changed(faults.saturated("accel", 157, 1, 1.1))
        self.assertEqual([k for k, s in enumerate(r.imu) if s[2][0] == 157], list(range(200, 220)))

    def test_samples_are_held_or_zero_for_a_time(self):
        held, zero = self.changed(faults.held_samples(1, 1.5)), self.changed(faults.held_samples(1, 1.5, zeros=True))
        self.assertEqual([s[1][0] for s in held.imu[198:302]], [198, 199, *[200] * 100, 300, 301])
        self.assertEqual([s[2][2] for s in zero.imu[198:302]], [298, 299, *[0] * 100, 400, 401])
        self.assertEqual([s[0] for s in held.imu], [stamp(i, 200) for i in range(400)])

    def test_the_clock_is_late_or_early(self):
        for ms in (20, -100):
            r = self.changed(faults.late_clock(ms))
            self.assertEqual(r.imu[7], [stamp(7, 200) + ms * 1_000_000, [7, 0, 0], [0, 0, 107]])
            self.assertEqual(self.stamps(r), list(range(40)))

    def test_units_and_axes(self):
        r = self.changed(faults.scaled("gyro", 2))
        self.assertEqual(r.imu[7][1:], [[14, 0, 0], [0, 0, 107]])
        self.assertEqual(self.changed(faults.swapped_axes).imu[7][1:], [[0, 7, 0], [0, 0, 107]])

    def test_a_turned_imu_measures_turned_vectors(self):
        r = self.changed(faults.turned_imu(10, 3))
        axis = faults.direction(3)
        for k, length in ((1, 7), (2, 107)):
            v = r.imu[7][k]
            self.assertAlmostEqual(math.hypot(*v), length)
        self.assertAlmostEqual(sum(a * b for a, b in zip(r.imu[7][1], axis)), 7 * axis[0])  # what lies along the axis stays
        marked = faults.Recording(self.source)
        faults.turned_imu(10, 3)(marked)
        self.assertAlmostEqual(math.hypot(*marked.turned_rad), math.radians(10))
        z = self.changed(faults.turned_imu(90, 3)).imu[7][2]
        self.assertAlmostEqual(sum(a * b for a, b in zip(z, (0, 0, 1))) / 107, axis[2] ** 2)  # a quarter turn

    def test_the_imu_stops_or_starts_late(self):
        self.assertEqual([len(self.changed(faults.only_samples(**k)).imu) for k in ({"end_s": 0.5}, {"begin_s": 0.5})], [100, 300])

    def test_the_rate_is_wrong(self):
        r = self.changed(faults.wrong_rate(2))
        self.assertIn("rate_hz: 400.0\n", r.sensors["imu0"])
        self.assertIn("rate_hz: 20\n", r.sensors["cam0"])

    def test_extrinsics_are_inverted(self):
        r = self.changed(faults.inverted_extrinsics)
        T_body_camera = faults.as_rows(faults.numbers_of(r.sensors["cam0"]))
        T_body_imu = faults.as_rows(faults.numbers_of(r.sensors["imu0"]))
        # the camera in the IMU's frame, had it been given in the right direction; the body was the IMU
        wanted = faults.multiplied(T_body_camera, T_body_camera)
        for a, b in zip(sum(T_body_imu, []), sum(wanted, [])):
            self.assertAlmostEqual(a, b)
        self.assertEqual(r.sensors["cam0"], faults.Recording(self.source).sensors["cam0"])


if __name__ == "__main__":
    unittest.main()
