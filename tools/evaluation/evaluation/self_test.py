# SPDX-License-Identifier: Apache-2.0
"""Tests of the evaluation without ft: track_sequence is a script that writes known numbers."""
import contextlib
import csv
import io
import json
import pathlib
import statistics
import sys
import tempfile
import unittest

from . import runs, sequences, tables

# In place of track_sequence. A file `fail` in the sequence makes it fail, `unreadable` before it asks for a GPU; `tell` counts
# calls.
TRACKER = """#!{python}
import json, pathlib, sys
a = sys.argv[1:]
value = lambda name: a[a.index(name) + 1]
sequence, out, backend = pathlib.Path(value("--sequence")), pathlib.Path(value("--out")), value("--backend")
if (sequence / "unreadable").exists():
    sys.exit("track_sequence: no calibration")
if backend == "cuda" and {no_gpu}:
    sys.exit("track_sequence: --backend cuda: no CUDA device here, or ...")
with open(sequence / "tell", "a") as f:
    f.write(" ".join(a) + chr(10))
if (sequence / "fail").exists():
    sys.exit("track_sequence: something is broken")
realtime = "--realtime" in a
scale = 1 if backend == "host" else 0.25
frames = [(2.0, 3.0, 6.0), (4.0, 5.0, 10.0), (6.0, 1.0, 8.0)]
(out / "times.csv").write_text("index,time_s,pyramid_ms,corners_ms,odd_ms,total_ms" + chr(10) + "".join(
    f"{{i}},0.1,{{p * scale}},{{c * scale}},,{{t * scale}}" + chr(10) for i, (p, c, t) in enumerate(frames)))
(out / "summary.json").write_text(json.dumps(dict(
    frames=3, tracked=2, lost=1, dropped=1 if realtime else 0, keyframes=1, ate_rmse_m=0.5, rpe_rmse_m=None, truth_path_m=10.0,
    device=backend + " <device>", image_width=64, image_height=48, options=dict(layout="euroc", rig="rectified"))))
"""


class Workplace(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name)
        self.out = self.root / "out"
        self.tracker = self.make_tracker()

    def make_tracker(self, no_gpu=False):
        path = self.root / "track_sequence"
        path.write_text(TRACKER.format(python=sys.executable, no_gpu=no_gpu))
        path.chmod(0o755)
        return path

    def make_sequence(self, *parts, left="mav0/cam0", right="mav0/cam1", text="1\n"):
        folder = self.root.joinpath("data", *parts)
        for camera in (left, right):
            (folder / camera).mkdir(parents=True)
        (folder / left / "data.csv").write_text(text)
        return folder

    def plan(self, backends=("host",), modes=("offline",), times=1, options=()):
        found = sequences.find_sequences(self.root / "data")
        return runs.plan_runs(self.tracker, found, backends, modes, times, list(options), self.out)

    def do(self, planned):
        lines = []
        failed = runs.do_all([r for r in planned if not r.finished], lines.append)
        return failed, lines

    def calls(self, folder):
        return (folder / "tell").read_text().splitlines()


class Finding(Workplace):
    def test_every_layout_is_found_under_its_path(self):
        self.make_sequence("euroc", "MH_01", text="a")
        self.make_sequence("kitti", "00", left="image_0", right="image_1")
        self.make_sequence("bare", left="cam0", right="cam1")
        (self.root / "data" / "no_sequence" / "mav0" / "cam0").mkdir(parents=True)  # one camera
        found = sequences.find_sequences(self.root / "data")
        self.assertEqual([s.name for s in found], ["bare", "euroc-MH_01", "kitti-00"])

    def test_a_sequence_itself_and_its_mav0_are_the_same_sequence(self):
        folder = self.make_sequence("MH_01")
        (folder / "groundtruth.txt").write_text("0 0 0 0 0 0 0 1\n")
        (whole,), (bare,) = sequences.find_sequences(folder), sequences.find_sequences(folder / "mav0")
        self.assertEqual((whole.name, whole.fingerprint), (bare.name, bare.fingerprint))

    def test_the_fingerprint_is_of_contents_not_of_the_place(self):
        self.make_sequence("a", text="same"), self.make_sequence("b", text="same"), self.make_sequence("c", text="other")
        a, b, c = sequences.find_sequences(self.root / "data")
        self.assertEqual(a.fingerprint, b.fingerprint)
        self.assertNotEqual(a.fingerprint, c.fingerprint)

    def test_nothing_to_be_found_is_an_error_that_names_the_folder(self):
        with self.assertRaisesRegex(sequences.UsageError, "no folder '.*/data'"):
            sequences.find_sequences(self.root / "data")
        (self.root / "data").mkdir()
        with self.assertRaisesRegex(sequences.UsageError, "no sequence under '.*/data'"):
            sequences.find_sequences(self.root / "data")


class Running(Workplace):
    def test_all_combinations_are_run_with_their_options(self):
        folder = self.make_sequence("s")
        failed, lines = self.do(self.plan(("host", "cuda"), ("offline", "realtime"), 2, ["--near", "40"]))
        self.assertEqual(failed, [])
        calls = self.calls(folder)
        self.assertEqual(len(calls), 8)
        self.assertEqual(sum("--realtime" in c for c in calls), 4)
        self.assertEqual(sum("--backend cuda" in c for c in calls), 4)
        self.assertTrue(all("--near 40" in c for c in calls))
        self.assertIn("[8/8]", "".join(lines))

    def test_what_is_finished_is_not_repeated_and_more_runs_only_add(self):
        folder = self.make_sequence("s")
        self.do(self.plan(times=1))
        self.do(self.plan(times=1))
        self.assertIsNone(runs.do_run(self.plan(times=1)[0]))  # as a rank does that has an old plan
        self.assertEqual(len(self.calls(folder)), 1)
        self.do(self.plan(times=3))
        self.assertEqual(len(self.calls(folder)), 3)

    def test_other_options_program_calibration_or_contents_are_other_runs(self):
        folder = self.make_sequence("s")
        calibration = self.root / "calibration.yaml"
        calibration.write_text("a")
        options = ["--calibration", str(calibration)]
        folders = {self.plan()[0].folder, self.plan(options=options)[0].folder}
        calibration.write_text("b")
        folders.add(self.plan(options=options)[0].folder)
        (folder / "mav0" / "cam0" / "data.csv").write_text("2\n")
        folders.add(self.plan()[0].folder)
        self.tracker.write_text(self.tracker.read_text() + "# new\n")
        folders.add(self.plan()[0].folder)
        self.assertEqual(len(folders), 5)

    def test_a_run_that_was_cut_off_is_repeated(self):
        folder = self.make_sequence("s")
        (run,) = self.plan()
        partial = pathlib.Path(run.folder + ".partial")
        partial.mkdir(parents=True)
        (partial / "summary.json").write_text("{")
        self.assertEqual(self.do([run])[0], [])
        self.assertEqual(len(self.calls(folder)), 1)
        self.assertFalse(partial.exists())
        self.assertEqual(tables.load(run).summary["frames"], 3)

    def test_a_failure_does_not_stop_the_others_and_is_tried_again(self):
        bad, good = self.make_sequence("bad"), self.make_sequence("good")
        (bad / "fail").touch()
        failed, _ = self.do(self.plan())
        self.assertEqual([(r.sequence, "something is broken" in why) for r, why in failed], [("bad", True)])
        (bad / "fail").unlink()
        self.assertEqual(self.do(self.plan())[0], [])
        self.assertEqual((len(self.calls(bad)), len(self.calls(good))), (2, 1))

    def test_a_program_that_cannot_be_started_is_a_failure(self):
        self.make_sequence("s")
        self.tracker.chmod(0o644)
        (failed,), _ = self.do(self.plan())
        self.assertIn("127", failed[1])

    def test_whether_there_is_a_gpu_is_asked_of_the_program(self):
        self.make_sequence("s")
        found = sequences.find_sequences(self.root / "data")
        self.assertTrue(runs.has_cuda(self.tracker, found))
        self.assertFalse(runs.has_cuda(self.make_tracker(no_gpu=True), found))

    def test_a_sequence_that_cannot_be_read_does_not_tell_whether_there_is_a_gpu(self):
        (self.make_sequence("a") / "unreadable").touch()
        found = sequences.find_sequences(self.root / "data")
        self.assertFalse(runs.has_cuda(self.tracker, found))
        self.make_sequence("b")
        found = sequences.find_sequences(self.root / "data")
        self.assertTrue(runs.has_cuda(self.tracker, found))
        self.assertFalse(runs.has_cuda(self.make_tracker(no_gpu=True), found))

    def test_a_plan_read_back_has_the_same_runs(self):
        self.make_sequence("s")
        planned = self.plan(times=2)
        self.out.mkdir()
        runs.write_plan(self.out / "plan.json", planned)
        read = [runs.run_of_plan(self.out / "plan.json", i) for i in range(2)]
        self.assertEqual([(r.folder, list(r.command)) for r in read], [(r.folder, list(r.command)) for r in planned])


class Tables(Workplace):
    def results(self, times=2):
        planned = self.plan(("host", "cuda"), ("offline", "realtime"), times)
        self.assertEqual(self.do(planned)[0], [])
        return [tables.load(r) for r in planned]

    def rows(self, name):
        with open(self.out / f"{name}.csv", newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def test_components_are_sums_of_stages_frame_by_frame(self):
        self.make_sequence("s")
        tables.write_tables(self.results(), "title", self.out)
        rows = {r["component"]: r for r in self.rows("components")}
        # pyramid and corners of the stand-in: 5, 9, 7 ms, in both runs
        self.assertAlmostEqual(float(rows["ORB extraction"]["host mean, ms"]), 7)
        self.assertAlmostEqual(float(rows["ORB extraction"]["host std, ms"]), statistics.pstdev([5, 9, 7]))
        self.assertAlmostEqual(float(rows["total"]["cuda mean, ms"]), 2)
        self.assertAlmostEqual(float(rows["total"]["speed-up"]), 4)
        self.assertEqual(float(rows["odd"]["host mean, ms"]), 0)  # a stage that this program does not know
        self.assertEqual(rows["odd"]["speed-up"], "")
        self.assertEqual(list(rows)[-1], "total")

    def test_frame_loss_and_errors_that_are_unknown(self):
        self.make_sequence("s")
        tables.write_tables(self.results(), "title", self.out)
        loss = self.rows("realtime")[0]
        self.assertEqual((float(loss["frames that came"]), float(loss["dropped, %"])), (4, 25))
        self.assertAlmostEqual(float(loss["processed but not tracked, %"]), 100 / 3)
        accuracy = self.rows("accuracy")
        self.assertEqual(len(accuracy), 4)
        self.assertEqual((accuracy[0]["ATE median, m"], accuracy[0]["RPE mean, m"], accuracy[0]["runs"]), ("0.5", "", "2"))
        self.assertEqual(len(self.rows("runs")), 8)

    def test_mean_and_median_are_over_the_runs(self):
        self.make_sequence("s")
        results = [r for r in self.results(3) if r.about["backend"] == "host" and r.about["mode"] == "offline"]
        for r, ate in zip(results, (1.0, 2.0, 6.0)):
            r.summary["ate_rmse_m"] = ate
        (row,) = tables.accuracy_table(results).rows
        self.assertEqual(row[5:7], [3.0, 2.0])

    def test_one_backend_has_no_speed_up(self):
        self.make_sequence("s")
        results = [r for r in self.results(1) if r.about["backend"] == "host"]
        self.assertNotIn("speed-up", tables.write_tables(results, "title", self.out))

    def test_names_are_escaped(self):
        self.make_sequence("a&b,c")
        text = tables.write_tables(self.results(1), "<title>", self.out)
        page = (self.out / "tables.html").read_text()
        self.assertIn("a&amp;b,c", page)
        self.assertIn("&lt;title&gt;", page)
        self.assertNotIn("<device>", page)
        self.assertIn("host: host <device>", text)
        self.assertEqual(self.rows("totals")[0]["sequence"], "a&b,c")

    def test_times_of_a_shared_machine_are_remarked(self):
        self.make_sequence("s")
        results = self.results(1)
        self.assertFalse(any("shared" in s for s in tables.remarks(results)))
        results[0].about["at_the_same_time"] = 3
        self.assertTrue(any(s.startswith("1 of 4 runs shared") for s in tables.remarks(results)))

    def test_times_of_different_devices_are_remarked(self):
        self.make_sequence("s")
        results = self.results(2)
        results[0].summary["device"] = "another"
        self.assertIn("The times on host are of different devices.", tables.remarks(results))

    def test_kinds_of_sequences_are_not_averaged_together(self):
        self.make_sequence("s")
        results = self.results(2)
        results[-1].summary["image_width"] = 128
        results[-1].about["mode"] = "offline"
        groups = {row[0] for row in tables.tables_of(results)[0].rows}
        self.assertEqual(groups, {"euroc, rectified, 64x48", "euroc, rectified, 128x48"})


class Command(Workplace):
    def command(self, *arguments):
        # The command itself imports this module.
        import evaluate  # pylint: disable=import-outside-toplevel

        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = evaluate.main([str(a) for a in arguments])
        return status, out.getvalue(), err.getvalue()

    def evaluate(self, *arguments):
        return self.command(self.root / "data", "--bin", self.root, "--out", self.out, *arguments)

    def test_tables_are_printed_and_written(self):
        self.make_sequence("s")
        status, text, _ = self.evaluate("--runs", "1", "--", "--near", "30")
        self.assertEqual(status, 0)
        for heading in ("Time per component", "Accuracy", "Frame loss in real time", "speed-up"):
            self.assertIn(heading, text)
        self.assertTrue((self.out / "tables.html").is_file())
        self.assertIn("4 of them finished before", self.evaluate("--runs", "1", "--", "--near", "30")[1])

    def test_a_failed_run_is_named_and_the_status_says_so(self):
        bad = self.make_sequence("bad")
        self.make_sequence("good")
        (bad / "fail").touch()
        status, text, errors = self.evaluate("--runs", "1", "--modes", "offline", "--backends", "host")
        self.assertEqual(status, 1)
        self.assertIn("FAILED: bad host offline 1: ended with 1: track_sequence: something is broken", errors)
        self.assertIn("good", text)

    def test_without_a_gpu_the_host_is_measured_alone(self):
        self.make_sequence("s")
        self.make_tracker(no_gpu=True)
        status, text, _ = self.evaluate("--runs", "1")
        self.assertEqual(status, 0)
        self.assertIn("no GPU here", text)
        self.assertNotIn("speed-up", text)

    def test_what_cannot_be_done_is_said(self):
        self.make_sequence("s")
        for arguments, message in (
            (["--sequences", "x"], "no sequence has 'x'"),
            (["--calibration", "/no/such"], "no calibration '/no/such'"),
            (["--bin", "/no/such"], "no program '/no/such/track_sequence'"),
            (["--tables-only"], "no run is finished"),
            (["--mpi", "/no/such -n 2"], "no program '.*evaluate_mpi'"),
        ):
            status, _, errors = self.evaluate(*arguments)
            self.assertEqual(status, 2)
            self.assertRegex(errors, message)
        for arguments in (["--runs", "0"], ["--backends", "tpu"], ["--modes", "", "x"]):
            with self.assertRaises(SystemExit):
                self.evaluate(*arguments)

    def test_a_folder_for_results_that_cannot_be_made_is_said(self):
        self.make_sequence("s")
        (self.root / "file").touch()
        status, _, errors = self.command(self.root / "data", "--bin", self.root, "--out", self.root / "file" / "out")
        self.assertEqual(status, 2)
        self.assertIn("cannot make the folder", errors)

    def test_a_program_that_is_not_executable_is_said(self):
        self.make_sequence("s")
        self.tracker.chmod(0o644)
        status, _, errors = self.evaluate()
        self.assertEqual(status, 2)
        self.assertRegex(errors, "'.*track_sequence' cannot be started")

    def test_what_runs_nothing_generates_nothing(self):
        generator = self.root / "generate_sequence"
        generator.write_text("#!/bin/sh\nexit 1\n")
        generator.chmod(0o755)
        for option in ("--list", "--tables-only"):
            status, text, errors = self.command("--bin", self.root, "--out", self.out, option)
            self.assertEqual(status, 2)
            self.assertIn("generated_pinhole_1, 300 stereo pairs: not generated yet", text)
            self.assertIn("no sequence is generated yet", errors)

    def test_list_runs_nothing(self):
        folder = self.make_sequence("s")
        status, text, _ = self.evaluate("--list", "--runs", "1", "--backends", "host")
        self.assertEqual(status, 0)
        self.assertIn("to do     s host offline 1", text)
        self.assertFalse((folder / "tell").exists())


def main():
    suite = unittest.defaultTestLoader.loadTestsFromModule(sys.modules[__name__])
    return 0 if unittest.TextTestRunner().run(suite).wasSuccessful() else 1
