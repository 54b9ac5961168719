#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""tools/evaluation/evaluate.py with the programs, on short generated sequences: generated_test.py FOLDER_OF_PROGRAMS"""
import csv
import pathlib
import subprocess
import sys
import tempfile
import unittest

PROGRAMS = sys.argv[1]
EVALUATE = pathlib.Path(__file__).resolve().parent.parent.parent / "tools" / "evaluation" / "evaluate.py"


def evaluate(out, *options):
    command = [sys.executable, EVALUATE, "--bin", PROGRAMS, "--out", out, "--frames", "12", "--runs", "1", "--backends", "host"]
    return subprocess.run([str(c) for c in [*command, *options]], capture_output=True, text=True, timeout=500, check=False)


class Generated(unittest.TestCase):
    def rows(self, path):
        with open(path, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def test_sequences_of_both_rigs_are_tracked_once_and_tabulated(self):
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder)
            done = evaluate(out, "--sequences", "_1")
            self.assertEqual(done.returncode, 0, done.stderr)
            accuracy = [r for r in self.rows(out / "accuracy.csv") if r["mode"] == "offline"]
            self.assertEqual({r["sequence"] for r in accuracy}, {"generated_pinhole_1", "generated_fisheye_1"})
            for row in accuracy:
                self.assertLess(float(row["ATE mean, m"]), 0.05)
            self.assertEqual([float(r["frames that came"]) for r in self.rows(out / "realtime.csv")], [12, 12])
            again = evaluate(out, "--sequences", "_1")
            self.assertIn("4 runs, 4 of them finished before", again.stdout)

    def test_what_track_sequence_complains_of_is_shown(self):
        with tempfile.TemporaryDirectory() as folder:
            done = evaluate(folder, "--sequences", "pinhole_1", "--modes", "offline", "--", "--near", "-3")
            self.assertEqual(done.returncode, 2)
            self.assertIn("--near: -3: must be above 0", done.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
