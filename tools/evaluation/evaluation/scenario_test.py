# SPDX-License-Identifier: Apache-2.0
"""Tests of the figures, without ft: of trajectories that are made up."""
import importlib.util
import json
import math
import pathlib
import random
import tempfile
import unittest

from . import faults, motions, scenario_runs, scenarios


def turned(degrees):
    half = math.radians(degrees) / 2
    return motions.rotation_of(0, 0, math.sin(half), math.cos(half))


def frames_of(positions, truth=None, reasons=None, lost=(), deviation=None, turns=None):
    """A run at 20 frames a second; truth is at the same places by default."""
    out = []
    for i, p in enumerate(positions):
        row = {"time_s": f"{i / 20:.9f}", "keyframe": "0", "reason": (reasons or {}).get(i, "")}
        if deviation:
            for r in range(6):
                for c in range(r, 6):
                    row[f"covariance_{r}{c}"] = str(deviation**2 if r == c else 0)
        R = turned(turns[i] if turns else 0)
        out.append(motions.Frame(row, None if i in lost else (R, list(p)), (R, list((truth or positions)[i])), set()))
    return out


def line(count, step=0.02):
    return [(step * i, 0.0, 0.0) for i in range(count)]


class Silence(unittest.TestCase):
    def silent(self, *args, **kwargs):
        frames = frames_of(*args, **kwargs)
        motions.figures(frames)
        return [i for i, f in enumerate(frames) if f.silent]

    def jumped(self, by, at=30, count=40):
        return [(x + (by if i >= at else 0), y, z) for i, (x, y, z) in enumerate(line(count))]

    def test_a_right_path_is_not_silent(self):
        self.assertEqual(self.silent(line(40)), [])

    def test_a_jump_is_silent_for_the_second_that_has_it(self):
        self.assertEqual(self.silent(self.jumped(0.06), line(40)), list(range(30, 40)))
        self.assertEqual(self.silent(self.jumped(0.06, at=10), line(40)), list(range(10, 11)) + list(range(20, 30)))

    def test_less_than_five_centimetres_are_not(self):
        self.assertEqual(self.silent(self.jumped(0.049), line(40)), [])

    def test_drift_shows_over_a_second_not_over_a_frame(self):
        slow = [(x * 0.8, y, z) for x, y, z in line(40)]  # 8 cm of 40 cm a second
        self.assertEqual(self.silent(slow, line(40)), list(range(20, 40)))
        self.assertEqual(self.silent([(x * 0.9, y, z) for x, y, z in line(40)], line(40)), [])

    def test_two_percent_of_a_long_path_are_allowed(self):
        truth = line(40, 0.5)  # 10 m a second
        self.assertEqual(self.silent([(x * 0.985, y, z) for x, y, z in truth], truth), [])
        self.assertEqual(self.silent([(x * 0.975, y, z) for x, y, z in truth], truth), list(range(20, 40)))

    def test_a_frame_with_a_warning_is_not_silent_the_next_one_is(self):
        self.assertEqual(self.silent(self.jumped(0.06), line(40), {30: "imu_only"}), list(range(31, 40)))

    def test_a_lost_frame_is_not_silent(self):
        self.assertEqual(self.silent(self.jumped(0.06), line(40), lost=range(30, 40)), [])

    def test_what_comes_back_at_a_wrong_place_is_silent(self):
        self.assertEqual(self.silent(self.jumped(0.06), line(40), lost=range(25, 32)), list(range(32, 40)))

    def test_three_standard_deviations_of_the_motion_are_allowed(self):
        # of both frames: sqrt(2) times that of one
        self.assertEqual(self.silent(self.jumped(0.06), line(40), deviation=0.02), [])
        self.assertEqual(self.silent(self.jumped(0.06), line(40), deviation=0.005), list(range(30, 40)))

    def test_gaps_make_no_motion_of_a_frame_of_other_frames(self):
        frames = frames_of(self.jumped(0.06), line(40), lost=[29])
        steps = dict(motions.motions_of(frames, motions.path_lengths(frames)))
        self.assertNotIn(30, steps)
        self.assertEqual(len(steps), 37)


class Figures(unittest.TestCase):
    def test_a_moved_and_turned_path_has_no_error(self):
        rng = random.Random(1)
        truth = [(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-1, 1)) for _ in range(30)]
        R = motions.rotation_of(0.1, -0.5, 0.3, 0.8)
        estimate = [[a + b for a, b in zip(motions.rotated(R, p), (5, 6, 7))] for p in truth]
        for p, t in zip(motions.aligned_positions(estimate, truth), truth):
            self.assertLess(math.dist(p, t), 1e-9)

    def test_errors_of_a_known_path(self):
        up = [(x, 0.01 * (-1) ** i, z) for i, (x, y, z) in enumerate(line(40))]
        row = motions.figures(frames_of(up, line(40)))
        self.assertAlmostEqual(row["ate_m"], 0.01, places=4)
        self.assertAlmostEqual(row["rpe_frame_m"], 0.02, places=9)
        self.assertAlmostEqual(row["rpe_second_m"], 0, places=9)
        self.assertAlmostEqual(row["path_m"], 0.78)
        self.assertEqual((row["frames"], row["lost"], row["silent"]), (40, 0, 0))

    def test_nothing_tracked_has_no_errors(self):
        row = motions.figures(frames_of(line(5), lost=range(5)))
        self.assertEqual([row[k] for k in ("ate_m", "max_error_m", "rpe_frame_m", "rpe_second_m")], [None] * 4)
        self.assertEqual((row["lost"], row["silent"]), (5, 0))
        self.assertIsNone(motions.figures([])["ate_m"])

    def test_the_covariance_of_a_motion_is_that_of_drawn_poses(self):
        rng = random.Random(2)
        a, b = (turned(20), [0.3, 0.1, -0.2]), (turned(75), [1.0, -0.4, 0.5])
        sigma = [0.002, 0.004, 0.003, 0.01, 0.02, 0.03]
        of_one = [[sigma[i] ** 2 if i == j else 0 for j in range(6)] for i in range(6)]
        motion = motions.relative(a, b)
        expected = motions.motion_covariance(of_one, of_one, motion)

        def drawn(pose):
            x = [rng.gauss(0, s) for s in sigma]
            half = math.hypot(*x[:3]) / 2
            axis = [v / (2 * half) * math.sin(half) for v in x[:3]]
            return motions.product(pose[0], motions.rotation_of(*axis, math.cos(half))), [
                p + d for p, d in zip(pose[1], motions.rotated(pose[0], x[3:]))
            ]

        errors = []
        for _ in range(4000):
            off = motions.relative(motion, motions.relative(drawn(a), drawn(b)))
            errors.append(motions.small_turn(off[0]) + off[1])
        for i in range(6):
            for j in range(6):
                mean = sum(e[i] * e[j] for e in errors) / len(errors)
                scale = math.sqrt(expected[i][i] * expected[j][j])
                self.assertAlmostEqual(mean / scale, expected[i][j] / scale, delta=0.08)
        inside = sum(motions.squared_mahalanobis(expected, e) <= motions.CHI_SQUARE_95 for e in errors) / len(errors)
        self.assertAlmostEqual(inside, 0.95, delta=0.015)

    def test_deviations_at_rest_are_told_as_large_as_they_are(self):
        rng = random.Random(4)
        jitter = [[rng.gauss(0, 0.01) for _ in range(3)] for _ in range(2000)]  # no turns: half of the six squares are nothing

        def told(deviation, truth):
            return motions.figures(frames_of(jitter, truth, deviation=deviation))["deviation_at_rest"]

        still = [(0.0, 0.0, 0.0)] * len(jitter)
        self.assertAlmostEqual(told(0.01, still), math.sqrt(2), delta=0.05)
        self.assertAlmostEqual(told(0.03, still), 3 * math.sqrt(2), delta=0.15)
        self.assertIsNone(told(0.01, line(len(jitter))))
        self.assertIsNone(told(None, still))

    def test_a_singular_covariance_contains_nothing_that_can_be_said(self):
        self.assertIsNone(motions.squared_mahalanobis([[0.0] * 6 for _ in range(6)], [1.0] * 6))

    def test_infinite_and_missing_covariances_are_none(self):
        row = {f"covariance_{i}{j}": "inf" if i == j else "0" for i in range(6) for j in range(i, 6)}
        self.assertIsNone(motions.covariance_of(row))
        self.assertIsNone(motions.covariance_of({"covariance_00": ""}))
        self.assertIsNone(motions.covariance_of({}))

    def test_warnings_are_names_of_both_columns(self):
        self.assertEqual(motions.warnings_of({"warnings": "two_motions;imu_clock", "reason": "imu_only"}), {"two_motions", "imu_clock", "imu_only"})
        self.assertEqual(motions.warnings_of({"reason": ""}), set())


    def test_a_warned_frame_whose_motions_are_right_is_warned_right(self):
        frames = frames_of(line(40, step=0.02))
        frames[10].pose = (frames[10].pose[0], [1.0, 0.0, 0.0])  # wrong over a frame at 10 and 11, over a second at 30
        for i in (0, 5, 10, 11, 12, 30):
            frames[i].warnings = {"dark"}
        row = motions.figures(frames)
        self.assertEqual(row["warned_right"], 2)  # 5 and 12: nothing is known of the first frame's motion
        self.assertEqual(motions.figures(frames_of(line(40)))["warned_right"], 0)

    def test_the_clock_that_was_found_is_that_of_the_last_frames(self):
        frames = frames_of(line(40))
        self.assertIsNone(motions.clock_offset(frames))
        for i, f in enumerate(frames):
            f.clock_s = 0.9 if i < 20 else None if i % 2 else 0.001 * i
        self.assertAlmostEqual(motions.clock_offset(frames), 0.030)

    def test_rows_of_a_wrong_clock_have_what_was_found_beside_it(self):
        frames = frames_of(line(40))
        for f in frames:
            f.clock_s = -0.0195
        recording = type("", (), {"imu": [[0]], "clock_ms": None})()
        about = {"maps": 1, "device": ""}
        self.assertNotIn("clock_ms", scenario_runs.figures_of(recording, frames, about))
        faults.late_clock(-20)(recording)
        row = scenario_runs.figures_of(recording, frames, about)
        self.assertAlmostEqual(row["clock_found_ms"], -19.5)
        self.assertEqual((row["clock_ms"], recording.imu), (-20, [[-20_000_000]]))


class Table(unittest.TestCase):
    def test_names_are_unique_and_limits_are_of_figures(self):
        names = [s.name for s in scenarios.ALL]
        self.assertEqual(len(names), len(set(names)))
        known = {
            "ate_m", "max_error_m", "rpe_frame_m", "rpe_second_m", "lost", "maps", "silent", "warned", "keyframe_share", "ate_share",
            "contained", "deviation_at_rest", "gain", "gap_share", "imu_used", "jumps_right", "ate_over_allowed", "max_over_allowed",
        }
        for s in scenarios.ALL:
            self.assertLessEqual({n for n, _ in (*s.limits, *s.least)}, known)
            self.assertIn(("silent", 0), s.limits, s.name)

    def test_a_figure_that_is_missing_or_beyond_its_limit_is_named(self):
        s = scenarios.Scenario("x", "", limits=(("ate_m", 0.01), ("lost", 0)), least=(("warned", 1),))
        fine = {"error": None, "ate_m": 0.01, "lost": 0, "warned": 1}
        self.assertEqual(scenario_runs.misses_of(fine, s), [])
        self.assertEqual(scenario_runs.misses_of({**fine, "ate_m": 0.011, "warned": 0}, s), ["ate_m", "warned"])
        self.assertEqual(scenario_runs.misses_of({**fine, "ate_m": None}, s), ["ate_m"])
        self.assertEqual(scenario_runs.misses_of({**fine, "ate_m": math.nan}, s), ["ate_m"])
        self.assertEqual(scenario_runs.misses_of({**fine, "error": "crashed"}, s), ["error"])

    def test_with_an_imu_a_fifth_or_three_millimetres_more_are_allowed(self):
        without = {"ate_m": 0.05, "max_error_m": 0.001, "silent": 0}
        beside = scenario_runs.beside({"ate_m": 0.06, "max_error_m": 0.004}, without)
        self.assertAlmostEqual(beside["ate_over_allowed"], 1)
        self.assertAlmostEqual(beside["max_over_allowed"], 1)
        self.assertAlmostEqual(beside["gain"], 1.2)

    def test_what_is_written_has_the_shape_of_results(self):
        script = pathlib.Path(__file__).resolve().parent.parent / "scenarios.py"
        spec = importlib.util.spec_from_file_location("scenarios_script", script)
        program = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(program)
        row = scenario_runs.finished({"scenario": "x", "seed": 1, "error": None, "ate_m": 0.1, "warnings": {"dark": 2}}, scenarios.ALL[0])
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder) / "rows.json"
            program.write(program.parse(["--out", str(out)]), [{**row, "device": "a processor"}] * 2)
            written = json.loads(out.read_text())
        self.assertEqual(written["records"][0]["command"], [f"tools/evaluation/scenarios.py --out {out}"])
        rows = written["records"][0]["tables"]["rows"]
        self.assertEqual(rows[0], rows[1])
        self.assertEqual(rows[0]["warnings"], ["dark 2"])
        self.assertNotIn("error", rows[0])
        self.assertNotIn("device", rows[0])
        self.assertIn("silent", rows[0]["misses"])

    def test_a_doubt_about_a_recording_tells_of_no_frame(self):
        with tempfile.TemporaryDirectory() as name:
            run = pathlib.Path(name)
            for file in ("trajectory.txt", "groundtruth.txt"):
                (run / file).write_text("0.0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n")
            (run / "times.csv").write_text("time_s,tracked,keyframe,warnings\n0.0,1,1,\n0.1,1,0,imu\n")

            def told(*sentences):
                (run / "summary.json").write_text(json.dumps({"warnings": sentences}))
                return [f.warnings for f in scenario_runs.read_run(run)[0]]

            doubt = "mav0/imu0/data.csv: the accelerometer measures 1 m/s^2 in the median, gravity alone is 9.81: is it in g?"
            self.assertEqual(told(doubt), [set(), {"imu"}])
            unused = "mav0/imu0/sensor.yaml: the samples of the IMU are not used: no noise"
            self.assertEqual(told(doubt, unused), [{"imu_left_out"}, {"imu_left_out", "imu"}])


if __name__ == "__main__":
    unittest.main()
