#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""evaluate_mpi with several ranks on this machine: mpi_test.py MPIEXEC EVALUATE_MPI. Skips (77) without MPI."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import unittest

MPIEXEC, PROGRAM = (sys.argv[1:] + ["", ""])[:2]

# More ranks than cores, and as root in a container: Open MPI asks for both to be said. It does not free what it
# has at its end: a build with AddressSanitizer is not to look for leaks.
ALLOWED = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "ASAN_OPTIONS": ":".join(filter(None, [os.environ.get("ASAN_OPTIONS"), "detect_leaks=0"])),
}

# A job: writes who runs it, waits until others have begun as well, ends as it is told to.
JOB = """
import json, os, pathlib, sys, time
folder, name, others, status = pathlib.Path(sys.argv[1]), *sys.argv[2:]
names = ("OMPI_COMM_WORLD_RANK", "CUDA_VISIBLE_DEVICES", "FT_RANKS_ON_HOST")
with open(folder / name, "a") as file:
    file.write(json.dumps({n: os.environ.get(n) for n in names} | {"pid": os.getpid()}) + chr(10))
end = time.monotonic() + 60
while not all((folder / other).exists() for other in others.split()):
    if time.monotonic() > end:
        sys.exit("waited in vain")
    time.sleep(0.02)
if status == "kill":
    os.kill(os.getpid(), 9)
sys.exit(int(status))
"""


def until(condition):
    """Fails where it takes more than 30 s."""
    end = time.monotonic() + 30
    while not condition():
        if time.monotonic() > end:
            raise AssertionError("did not come about in 30 s")
        time.sleep(0.05)


class EvaluateMpi(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def job(self, name, status="0", others=()):
        return {"name": name, "command": [sys.executable, "-c", JOB, str(self.folder), name, " ".join(others), status]}

    def jobs_together(self, together, alone=0):
        """So many that end only when all of them run at the same time, and some that wait for nothing."""
        names = [f"together{i}" for i in range(together)]
        return [self.job(n, others=names) for n in names] + [self.job(f"alone{i}") for i in range(alone)]

    def command_of(self, ranks, plan, *options, devices=None):
        path = self.folder / "plan.json"
        path.write_text(plan if isinstance(plan, str) else json.dumps(plan))
        environment = {k: v for k, v in os.environ.items() if k != "CUDA_VISIBLE_DEVICES"} | ALLOWED
        if devices is not None:
            environment["CUDA_VISIBLE_DEVICES"] = devices
        return {"args": [MPIEXEC, "-n", str(ranks), PROGRAM, str(path), *options], "env": environment}

    def run_plan(self, *arguments, **devices):
        started = self.command_of(*arguments, **devices)
        return subprocess.run(**started, capture_output=True, text=True, timeout=120, check=False)

    def seen(self, name):
        return [json.loads(line) for line in (self.folder / name).read_text().splitlines()]

    def test_every_job_is_run_once_and_every_rank_takes_part(self):
        plan = self.jobs_together(3, 4)
        done = self.run_plan(3, plan)
        self.assertEqual(done.returncode, 0, done.stderr)
        runs = [self.seen(j["name"]) for j in plan]
        self.assertEqual([len(r) for r in runs], [1] * 7)
        self.assertEqual({r[0]["OMPI_COMM_WORLD_RANK"] for r in runs}, {"0", "1", "2"})
        self.assertEqual({r[0]["FT_RANKS_ON_HOST"] for r in runs}, {"3"})
        self.assertIn("[7/7]", done.stdout)

    def test_a_rank_with_a_long_job_is_given_no_other(self):
        short = [f"short{i}" for i in range(6)]
        done = self.run_plan(2, [self.job("long", others=short)] + [self.job(n) for n in short])
        self.assertEqual(done.returncode, 0, done.stderr)
        rank_of_long = self.seen("long")[0]["OMPI_COMM_WORLD_RANK"]
        self.assertNotIn(rank_of_long, {self.seen(n)[0]["OMPI_COMM_WORLD_RANK"] for n in short})

    def test_a_job_that_fails_does_not_stop_the_others_and_is_named(self):
        plan = [self.job("bad", "3"), self.job("killed", "kill"), {"name": "absent", "command": ["/no/such/program"]}]
        done = self.run_plan(3, plan + [self.job(f"good{i}") for i in range(5)])
        self.assertEqual(done.returncode, 1)
        for text in ("bad: ended with 3", "killed: ended with 137", "absent: ended with 127", "3 of 8 jobs failed"):
            self.assertIn(text, done.stderr)
        self.assertEqual([len(self.seen(f"good{i}")) for i in range(5)], [1] * 5)

    def test_more_ranks_than_jobs(self):
        done = self.run_plan(6, [self.job("a"), self.job("b")])
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual([len(self.seen("a")), len(self.seen("b"))], [1, 1])

    def test_one_rank_runs_all_in_order(self):
        done = self.run_plan(1, [self.job("a"), self.job("b")])
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertLess(done.stdout.index("[1/2] a"), done.stdout.index("[2/2] b"))

    def test_no_job_goes_on_when_mpirun_is_killed(self):
        plan = [self.job(n, others=["never"]) for n in ("a", "b")]
        with subprocess.Popen(**self.command_of(2, plan), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as mpirun:
            until(lambda: all((self.folder / j["name"]).exists() and self.seen(j["name"]) for j in plan))
            mpirun.kill()
            mpirun.wait(60)
        for job in plan:
            process = pathlib.Path("/proc", str(self.seen(job["name"])[0]["pid"]), "cmdline")
            until(lambda path=process: not path.exists() or str(self.folder) not in path.read_text())

    def test_no_jobs(self):
        self.assertEqual(self.run_plan(3, []).returncode, 0)

    def test_ranks_share_the_gpus_of_a_machine_evenly(self):
        plan = self.jobs_together(4, 4)
        done = self.run_plan(4, plan, "--gpus", "2")
        self.assertEqual(done.returncode, 0, done.stderr)
        seen = [self.seen(j["name"])[0] for j in plan]
        self.assertEqual({s["CUDA_VISIBLE_DEVICES"] for s in seen}, {"0", "1"})
        for s in seen:
            self.assertEqual(int(s["CUDA_VISIBLE_DEVICES"]), int(s["OMPI_COMM_WORLD_RANK"]) % 2)

    def test_gpus_that_a_scheduler_gave_are_kept_to(self):
        plan = self.jobs_together(2)
        done = self.run_plan(2, plan, devices="5,GPU-abc")
        self.assertEqual(done.returncode, 0, done.stderr)
        seen = {self.seen(j["name"])[0]["CUDA_VISIBLE_DEVICES"] for j in plan}
        self.assertEqual(seen, {"5", "GPU-abc"})

    def test_a_plan_that_is_none_is_refused(self):
        for plan in ('{"a": 1}', "[{}]", "nothing", '[{"name": "x", "command": []}]'):
            done = self.run_plan(2, plan)
            self.assertNotEqual(done.returncode, 0)
            self.assertIn("plan.json", done.stderr)


if __name__ == "__main__":
    if not PROGRAM or not MPIEXEC:
        print("skipped: evaluate_mpi was not built: no MPI found (Debian: openmpi-bin libopenmpi-dev)")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1])
