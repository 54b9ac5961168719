#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Loops, pose graphs and whole maps, measured: runs the programs and writes one file of bench/results' shape.

  loops.py --bin FOLDER --out FILE.json --commit C [--backend cuda] [--jobs 16] [--only laps graphs ...]
             [--data FOLDER]    recordings and pose graphs, for `recordings` and `graphs`

FOLDER has track_sequence, generate_sequence, ft_pose_graphs, ft_bundles and, by the backend, optimize_pose_graph, adjust_map and
loop_cases_host, or optimize_pose_graph_cuda, adjust_map_cuda and loop_cases_cuda. A part that fails is left out, and the exit status is 1.
"""
import argparse
import datetime
import json
import math
import pathlib
import re
import subprocess
import sys
import tempfile


class Measurement:
    def __init__(self, how):
        self.how = how
        self.work = pathlib.Path(how.work or tempfile.mkdtemp(prefix="loops"))
        self.work.mkdir(parents=True, exist_ok=True)
        self.commands = []

    def program(self, name):
        return str(pathlib.Path(self.how.bin) / name)

    def small(self, name):
        """A program that is compiled for each backend."""
        return self.program(name + ("_cuda" if self.how.backend == "cuda" else ""))

    def run(self, *words, limit_s=None):
        """What a program prints; nothing where it takes longer than the limit."""
        words = [str(w) for w in words]
        self.commands.append(" ".join([pathlib.Path(words[0]).name, *words[1:]]).replace(str(self.work), "WORK"))
        print("+", self.commands[-1], file=sys.stderr, flush=True)
        try:
            done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=False, timeout=limit_s)
        except subprocess.TimeoutExpired:
            return ""
        # A solver that stops at its most steps says so in its exit status, and has printed its times.
        if done.returncode != 0 and not done.stdout:
            raise RuntimeError(f"{words[0]} ended with {done.returncode}")
        return done.stdout

    def rows(self, *words):
        return [json.loads(line) for line in self.run(*words).splitlines() if line.startswith("{")]

    def sequence(self, name, *options):
        folder = self.work / name
        if not folder.exists():
            self.run(self.program("generate_sequence"), "--out", folder, *options)
        return folder

    def track(self, folder, name, *options):
        """The summary of a run, and the poses of its path."""
        out = self.work / f"run_{name}"
        self.run(self.program("track_sequence"), folder, "--backend", self.how.backend, "--out", out, "--quiet", *options)
        poses = [[float(x) for x in line.split()] for line in (out / "trajectory.txt").read_text().splitlines() if line[0] != "#"]
        return json.loads((out / "summary.json").read_text()), poses


def mm(metres):
    return None if metres is None else round(1e3 * metres, 2)


def row_of(summary, **more):
    row = dict(more, frames=summary["frames"], lost=summary["lost"], maps_begun=summary["maps"], ate_mm=mm(summary["ate_rmse_m"]))
    if "loops" in summary:
        row.update(loops=summary["loops"]["closed"], corrections=summary["loops"]["corrections"], online_ate_mm=mm(summary["loops"]["online_ate_rmse_m"]))
    return {k: v for k, v in row.items() if v is not None}


# ---- paths


def laps(m):
    rows = []
    for seed in m.how.seeds:
        folder = m.sequence(f"laps_{seed}", "--frames", 800, "--seed", seed, "--no-imu", *m.how.size)
        rows.append(row_of(m.track(folder, f"laps_{seed}", "--loops")[0], seed=seed))
        rows[-1]["without_ate_mm"] = mm(m.track(folder, f"laps_{seed}_without")[0]["ate_rmse_m"])
    return rows


def blind(m):
    """60 frames of the second lap are black."""
    rows = []
    for seed in m.how.seeds:
        folder = m.sequence(f"blind_{seed}", "--frames", 800, "--seed", seed, "--no-imu", "--blind", 26, 29, *m.how.size)
        rows.append(row_of(m.track(folder, f"blind_{seed}", "--loops")[0], seed=seed))
    return rows


def one_camera(m):
    rows = []
    for rig in ("fisheye", "pinhole"):
        for seed in m.how.seeds[:2]:
            folder = m.sequence(f"mono_{rig}_{seed}", "--rig", rig, "--frames", 1250, "--seed", seed, "--no-imu")
            rows.append(row_of(m.track(folder, f"mono_{rig}_{seed}", "--rig", "mono", "--loops")[0], rig=rig, seed=seed))
    return rows


# ---- recordings


def to_and_fro(source, folder):
    """An RGB-D recording forward, then backward; the times go on. Returns the time of its end."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("rgb", "depth"):
        if not (folder / name).exists():
            (folder / name).symlink_to(source / name)
    (folder / "camera.txt").write_text((source / "camera.txt").read_text())
    lines = lambda name: [line.split() for line in (source / name).read_text().splitlines() if line and line[0] != "#"]
    images, truth = lines("associations.txt"), lines("groundtruth.txt")
    begin, step, n = float(images[0][0]), float(images[1][0]) - float(images[0][0]), len(images)
    order = [*range(n), *range(n - 2, -1, -1)]
    time = [f"{begin + k * step:.6f}" for k in range(len(order))]
    (folder / "associations.txt").write_text("".join(f"{t} {images[i][1]} {t} {images[i][3]}\n" for t, i in zip(time, order)))
    (folder / "groundtruth.txt").write_text("".join(" ".join([t, *truth[i][1:]]) + "\n" for t, i in zip(time, order)))
    for name, column in (("rgb.txt", 1), ("depth.txt", 3)):
        (folder / name).write_text("".join(f"{t} {images[i][column]}\n" for t, i in zip(time, order)))


def recordings(m):
    rows = []
    for name, data in (("kitchen", "rgbd_7scenes_kitchen"), ("hololens", "rgbd_hololens_office")):
        source = pathlib.Path(m.how.data).resolve() / data
        folder = m.work / name
        to_and_fro(source, folder)
        for what, path, options in (("forward", source, ["--loops"]), ("forward, then backward", folder, ["--loops"]), ("forward, then backward, without loops", folder, [])):
            summary, poses = m.track(path, f"{name}_{len(rows)}", *options)
            row = row_of(summary, recording=name, way=what)
            if path == folder:
                row["end_from_start_mm"] = mm(math.dist(poses[0][1:4], poses[-1][1:4]))
            rows.append(row)
    return rows


# ---- rendered walls


def trials(m):
    return m.rows(m.program(f"loop_cases_{m.how.backend}"), "trials", m.how.trials, m.how.jobs)


def starts(m):
    return m.rows(m.program(f"loop_cases_{m.how.backend}"), "starts", m.how.starts, m.how.jobs)


def localize(m):
    return m.rows(m.program(f"loop_cases_{m.how.backend}"), "localize", m.how.starts, m.how.jobs)


def flat(m):
    return m.rows(m.program(f"loop_cases_{m.how.backend}"), "flat", 1000, m.how.ms, 0, 100, 1000, m.how.keyframes)


# ---- optimisers

CERES_S = 30  # Ceres is given no more
FOUND = r"chi2 (\S+), at the start (\S+), after (\d+) steps (\S+)( \(not converged\))?"
TIMES = r"first call (\S+) ms; of (\d+): least (\S+) ms, median (\S+) ms"


def within(text, least, share=1e-6):
    """Milliseconds until Ceres' first step that is so near to the least cost."""
    for time, chi2 in re.findall(r"step +\d+: +(\S+) ms, chi2 (\S+)", text):
        if float(chi2) <= least * (1 + share):
            return float(time)
    return None


def graphs(m):
    given = [pathlib.Path(m.how.data) / "pose_graphs" / f"{n}.g2o" for n in ("smallGrid3D", "sphere2500", "parking-garage")]
    made = []
    for poses, loops, apart in ((1000, 50, 0), (2500, 2500, 100), (10000, 10000, 100), (100000, 20000, 100)):
        made.append(m.work / f"walk_{poses}.g2o")
        m.run(m.program("ft_pose_graphs"), "make", poses, loops, apart, made[-1])
    rows = []
    for path in given + made:
        large = path.name == "walk_100000.g2o"
        ours = m.run(m.small("optimize_pose_graph"), path, "--start", "chordal", "--repeat", 1 if large else 5, *(["--steps", 100] if large else []))
        chi2, times = re.search(FOUND, ours), re.search(TIMES, ours)
        row = {"graph": path.stem, "poses": int(re.match(r"(\d+) poses", ours).group(1)), "steps": int(chi2.group(3)), "chi2": float(chi2.group(4)),
               "converged": chi2.group(5) is None, "median_ms": float(times.group(4)), "first_ms": float(times.group(1)),
               "mb": float(re.search(r"([\d.]+) MB", ours).group(1))}
        if not large:
            start = m.work / "start.g2o"
            m.run(m.small("optimize_pose_graph"), path, "--start", "chordal", "--steps", 0, "--out", start)
            theirs = m.run(m.program("ft_pose_graphs"), "ceres", start, m.how.jobs, 1, limit_s=CERES_S)
            if not theirs:
                rows.append({**row, "ceres_not_within_ms": 1000 * CERES_S})
                continue
            end = float(re.search(r"chi2 (\S+), \d+ steps, (\S+) ms", theirs).group(1))
            row["ceres_chi2"] = end
            row["ceres_ms"] = float(re.search(r"steps, (\S+) ms", theirs).group(1))
            reached = within(theirs, min(end, row["chi2"]))
            if reached is not None:
                row["ceres_within_1e-6_ms"] = reached
        rows.append(row)
    return rows


def maps(m):
    rows = []
    for views, points, outliers, huber in ((100, 10000, 0, 0), (1000, 50000, 0, 0), (1000, 50000, 0.05, 2.5)):
        path = m.work / f"map_{views}_{outliers}.txt"
        m.run(m.program("ft_bundles"), "make", views, points, path, outliers)
        more = ["--threads", m.how.jobs] if m.how.backend == "host" else []
        ours = m.run(m.small("adjust_map"), path, "--repeat", 3, "--huber", huber, *more)
        cost = re.search(r"cost (\S+), after (\d+) steps \((\d+) refused, (\d+) of conjugate gradients\) (\S+): (.*)", ours)
        times = re.search(TIMES, ours)
        theirs = m.run(m.program("ft_bundles"), "ceres", path, m.how.jobs, huber)
        found = re.search(r"cost (\S+), (\d+) steps, (\S+) ms \((.*)\)", theirs)
        row = {"views": views, "points": points, "observations": int(re.search(r"(\d+) observations", ours).group(1)), "outliers": outliers, "huber": huber,
               "steps": int(cost.group(2)), "cg_steps": int(cost.group(4)), "cost": float(cost.group(5)), "outcome": cost.group(6), "median_ms": float(times.group(4)),
               "mb": float(re.search(r"([\d.]+) MB", ours).group(1)), "ceres_cost": float(found.group(1)), "ceres_steps": int(found.group(2)),
               "ceres_ms": float(found.group(3)), "ceres_outcome": found.group(4)}
        row["cost_above_ceres"] = row["cost"] / row["ceres_cost"] - 1
        rows.append(row)
    return rows


PARTS = {f.__name__: f for f in (laps, blind, one_camera, recordings, trials, starts, localize, flat, graphs, maps)}


def machine_of(how):
    out = {"threads": how.jobs}
    for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            out["processor"] = line.split(":", 1)[1].strip()
            break
    if how.backend == "cuda":
        query = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
        name, driver = subprocess.run(query, stdout=subprocess.PIPE, text=True, check=True).stdout.splitlines()[0].split(", ")
        out.update(gpu=name, driver=driver)
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--commit", required=True)
    parser.add_argument("--backend", choices=("host", "cuda"), default="host")
    parser.add_argument("--jobs", type=int, default=16)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--data", default="../shared/data")
    parser.add_argument("--work", help="where sequences and runs are kept (a new folder in /tmp)")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--size", nargs=2, type=int, metavar=("WIDTH", "HEIGHT"), default=[])
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--starts", type=int, default=100)
    parser.add_argument("--keyframes", type=int, default=10000, help="of the largest map of `flat`")
    parser.add_argument("--ms", type=int, default=20, help="between frames of `flat`")
    how = parser.parse_args()
    how.size = ["--width", how.size[0], "--height", how.size[1]] if how.size else []
    m = Measurement(how)
    out = pathlib.Path(how.out)
    data = json.loads(out.read_text()) if out.exists() else {"what": "Loops, pose graphs and whole maps: bench/loops.py", "records": []}
    failed = []
    for name in how.only:
        m.commands.clear()
        try:
            rows = PARTS[name](m)
        except (RuntimeError, OSError, AttributeError, subprocess.CalledProcessError) as error:
            print(f"loops.py: {name}: {error}", file=sys.stderr)
            failed.append(name)
            continue
        for row in rows:
            print(json.dumps(row), flush=True)
        record = {"name": f"{name}, {how.backend}", "date": datetime.date.today().isoformat(), "commit": how.commit, "machine": machine_of(how),
                  "command": list(m.commands), "tables": {name: rows}}
        data["records"] = [r for r in data["records"] if r["name"] != record["name"]] + [record]
        out.write_text(json.dumps(data, indent=1) + "\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
