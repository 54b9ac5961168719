#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The scenarios with one seed on small images: scenarios_test.py FOLDER_OF_PROGRAMS [--renew]

scenarios_known.json lists each scenario: which of its figures are missed today, and how large its error is. One that gets
worse fails; one that gets better does, too, so that the list stays true. --renew writes the list anew: look at its diff."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

HERE = pathlib.Path(__file__).resolve().parent
PROGRAMS = sys.argv[1] if len(sys.argv) > 1 else "build/bin"
RENEW = "--renew" in sys.argv
KNOWN = HERE / "scenarios_known.json"
SCENARIOS = HERE.parent.parent / "tools" / "evaluation" / "scenarios.py"
OPTIONS = ("--seeds", "1", "--size", "376x240", "--frames", "120")
SAME_M = 0.005  # errors that differ by less, or by half, are the same


def run(out):
    jobs = str(min(os.cpu_count() or 1, 8))
    command = [sys.executable, SCENARIOS, "--bin", PROGRAMS, *OPTIONS, "--jobs", jobs, "--out", out]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=1700, check=False)
    print(done.stdout, done.stderr, flush=True)
    return done.returncode, json.loads(pathlib.Path(out).read_text())["records"][0]["tables"]["rows"]


def known_of(row):
    return {"misses": sorted(row["misses"]), **{name: row.get(name) for name in ("ate_m", "silent", "lost")}}


def difference(row, known):
    """What changed, in words; empty where nothing did."""
    if known is None:
        return f"{row['scenario']}: is not in {KNOWN.name}"
    now = known_of(row)
    said = [f"{m} is missed now" for m in now["misses"] if m not in known["misses"]]
    said += [f"{m} is no longer missed: renew the list" for m in known["misses"] if m not in now["misses"]]
    if now["ate_m"] is not None and now["ate_m"] > 1.5 * (known["ate_m"] or 0) + SAME_M:
        said.append(f"ate_m is {now['ate_m']:.4f}, was {known['ate_m']}")
    for name in ("silent", "lost"):
        if (now[name] or 0) > (known[name] or 0) + 5:
            said.append(f"{name}: {now[name]} frames, were {known[name]}")
    return f"{row['scenario']}: " + "; ".join(said) if said else ""


class Scenarios(unittest.TestCase):
    maxDiff = None

    def test_no_scenario_is_other_than_it_is_known_to_be(self):
        with tempfile.TemporaryDirectory() as folder:
            status, rows = run(pathlib.Path(folder) / "rows.json")
        self.assertEqual([r["error"] for r in rows if "error" in r], [])
        self.assertEqual(status, 0)
        known = json.loads(KNOWN.read_text())["scenarios"]
        changed = [difference(r, known.get(r["scenario"])) for r in rows]
        self.assertEqual([c for c in changed if c], [])
        self.assertEqual(sorted(known), sorted(r["scenario"] for r in rows))

    def test_changes_are_told(self):
        row = {"scenario": "x", "misses": ["silent"], "ate_m": 0.1, "silent": 10, "lost": 0}
        same = known_of(row)
        self.assertEqual(difference(row, same), "")
        self.assertIn("silent is missed now", difference(row, {**same, "misses": []}))
        self.assertIn("maps is no longer missed", difference(row, {**same, "misses": ["maps", "silent"]}))
        self.assertIn("ate_m is 0.1000, was 0.05", difference(row, {**same, "ate_m": 0.05}))
        self.assertIn("silent: 10 frames, were 0", difference(row, {**same, "silent": 0}))
        self.assertIn("not in scenarios_known.json", difference(row, None))


def renew():
    with tempfile.TemporaryDirectory() as folder:
        _, rows = run(pathlib.Path(folder) / "rows.json")
    lines = [f"  {json.dumps(r['scenario'])}: {json.dumps(known_of(r))}" for r in rows]
    about = "what tests/end_to_end/scenarios_test.py finds; made by its --renew"
    KNOWN.write_text('{\n "about": ' + json.dumps(about) + ',\n "scenarios": {\n' + ",\n".join(lines) + "\n }\n}\n")


if __name__ == "__main__":
    if RENEW:
        renew()
    else:
        unittest.main(argv=sys.argv[:1])
