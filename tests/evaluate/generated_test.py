#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""scripts/evaluate.py with the programs, on short generated sequences: generated_test.py FOLDER_OF_PROGRAMS"""
import csv
import pathlib
import subprocess
import sys
import tempfile
import unittest

PROGRAMS = sys.argv[1]
EVALUATE = pathlib.Path(__file__).resolve().parent.parent.parent / "scripts" / "evaluate.py"


def evaluate(out, *options):
    command = [sys.executable, EVALUATE, "--bin", PROGRAMS, "--out", out, "--frames", "12", "--runs", "1", "--backends", "host"]
    return subprocess.run([str(c) for c in [*command, *options]], capture_output=True, text=True, timeout=500, check=False)


class Generated(unittest.TestCase):
    def test_sequences_of_both_rigs_are_tracked_once_and_tabulated(self):
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder)
            done = evaluate(out, "--sequences", "_1")
            self.assertEqual(done.returncode, 0, done.stderr)
            with open(out / "accuracy.csv", newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
            names = [(r["sequence"], r["mode"]) for r in rows]
            self.assertEqual(len(names), 4)
            self.assertEqual({n for n, _ in names}, {"generated_pinhole_1", "generated_fisheye_1"})
            for row in rows:
                self.assertLess(float(row["ATE mean, m"]), 0.05)
            self.assertIn("other", evaluate(out, "--sequences", "_1", "--", "--pose-optimization", "other").stderr)
            again = evaluate(out, "--sequences", "_1")
            self.assertIn("4 runs, 4 of them finished before", again.stdout)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
