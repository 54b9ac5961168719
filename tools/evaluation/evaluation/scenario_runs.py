# SPDX-License-Identifier: Apache-2.0
"""Makes and tracks the sequences of scenarios, and the rows of their table."""
import json
import math
import pathlib
import subprocess
import threading

from . import faults, motions, scenarios
from .sequences import sha256_of

MADE_BY_DEFAULT = (752, 480)


class Failure(Exception):
    """A program that failed; what it said."""


class Once:
    """Results that several threads ask for and that are made once."""

    def __init__(self):
        self.guard = threading.Lock()
        self.locks, self.results = {}, {}

    def get(self, key, make):
        with self.guard:
            lock = self.locks.setdefault(key, threading.Lock())
        with lock:
            if key not in self.results:
                try:
                    self.results[key] = make()
                except Failure as e:
                    self.results[key] = e
        if isinstance(self.results[key], Failure):
            raise self.results[key]
        return self.results[key]


def call(command):
    done = subprocess.run([str(c) for c in command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
    # 1: an error, or no frame could be tracked, which is a result
    if done.returncode not in (0, 1):
        raise Failure(f"{pathlib.Path(command[0]).name} ended with {done.returncode}: {done.stderr.strip()[-300:]}")
    return done


class Workshop:
    """All that is made and tracked for one seed."""

    def __init__(self, programs, folder, backend, size=None, most_frames=None):
        self.programs, self.folder, self.backend = pathlib.Path(programs), pathlib.Path(folder), backend
        self.size, self.most_frames = size, most_frames
        self.sequences, self.runs = Once(), Once()

    def generated(self, scenario, seed):
        frames = min(scenario.frames, self.most_frames or scenario.frames)
        options = ("--frames", frames, "--seed", seed, *scenario.generate)
        if self.size and "fisheye" in scenario.generate:
            side = round(512 * self.size[0] / MADE_BY_DEFAULT[0])
            options += ("--width", side, "--height", side)
        elif self.size:
            options += ("--width", self.size[0], "--height", self.size[1])

        def make():
            folder = self.folder / "generated" / sha256_of(repr(options))
            if not folder.is_dir():
                # each image is read several times, which is faster without compression
                done = call([self.programs / "generate_sequence", "--out", folder, "--threads", 1, "--png-level", 0, *options])
                if done.returncode != 0:
                    raise Failure(f"generate_sequence: {done.stderr.strip()}")
            return folder

        return self.sequences.get(options, make)

    def faulty(self, scenario, seed):
        """The recording, written to a folder of its own."""
        recording = faults.Recording(self.generated(scenario, seed))
        for entry in scenario.faults:
            scenarios.fault_of(entry, seed)(recording)
        folder = self.folder / "faulty" / scenario.name
        if not folder.is_dir():
            recording.write(folder)
        return recording, folder

    def tracked(self, recording, folder, imu, options):
        """The folder of a run. Without the IMU one serves all sequences with the same images."""
        same = sha256_of(repr((str(recording.source), recording.frames, recording.sensors["cam0"], recording.sensors["cam1"])))
        key = (folder.name if imu else same, options)

        def make():
            out = self.folder / "runs" / (f"{folder.name}_imu" if imu else folder.name)
            command = [self.programs / "track_sequence", folder, "--out", out, "--backend", self.backend, "--quiet", *options]
            command += ["--imu", "auto" if imu else "off"]
            command += ["--threads", 1] if self.backend == "host" else []
            done = call(command)
            if not (out / "summary.json").is_file():
                raise Failure(f"track_sequence: {done.stderr.strip()[-300:]}")
            return out

        return self.runs.get(key, make)

    def row(self, scenario, seed):
        row = {"scenario": scenario.name, "seed": seed, "error": None}
        try:
            recording, folder = self.faulty(scenario, seed)
            run = self.tracked(recording, folder, scenario.imu, scenario.track)
            frames, summary = read_run(run)
            row.update(figures_of(recording, frames, summary))
            if scenario.imu:
                without, about = read_run(self.tracked(recording, folder, False, scenario.track))
                row.update(beside(row, figures_of(recording, without, about)))
        except Failure as e:
            row["error"] = str(e)
        return finished(row, scenario)


COLUMNS = (
    "scenario", "seed", "frames", "ate_m", "ate_without_imu_m", "max_error_m", "rpe_frame_m", "rpe_second_m",
    "lost", "maps", "keyframes", "silent", "warned_right", "warnings",
)


def finished(row, scenario):
    """With all columns, first those of every row, and with what it misses."""
    out = {name: row.get(name) for name in COLUMNS}
    out.update((k, v) for k, v in row.items() if k not in out)
    out = {k: round(v, 6) if isinstance(v, float) else v for k, v in out.items()}
    out["misses"] = misses_of(row, scenario)
    return out


def read_run(run):
    summary = json.loads((run / "summary.json").read_text())
    return motions.read_frames(run, told_of_all(summary["warnings"])), summary


def told_of_all(sentences):
    """Warnings that hold for each frame of a run. Doubts about a recording, as of its units, are none: no frame has them."""
    return {"imu_left_out"} if any("the samples of the IMU are not used" in s for s in sentences) else set()


def figures_of(recording, frames, summary):
    """Of one run."""
    row = motions.figures(frames)
    row["maps"] = summary["maps"]
    row["device"] = summary["device"]
    row["keyframe_share"] = row["keyframes"] / max(row["frames"], 1)
    if row["ate_m"] is not None and row["path_m"] > 0.1:
        row["ate_share"] = row["ate_m"] / row["path_m"]
    row["warned"] = int(bool(row["warnings"]))
    paths = motions.path_lengths(frames)
    steps = dict(motions.motions_of(frames, paths))
    if getattr(recording, "jumps", None):
        row["jumps"] = len(recording.jumps)
        row["jumps_right"] = sum(k in steps and not steps[k].is_wrong for k in recording.jumps) / len(recording.jumps)
    if getattr(recording, "clock_ms", None) is not None:
        found = motions.clock_offset(frames)
        row["clock_ms"] = recording.clock_ms
        row["clock_found_ms"] = None if found is None else 1000 * found
    if getattr(recording, "turned_rad", None) is not None:
        found = next((f.imu_turn for f in reversed(frames) if f.imu_turn), None)  # turns samples back
        row["turn_error_deg"] = None if found is None else math.degrees(math.dist(found, [-a for a in recording.turned_rad]))
    gaps = [k for k in range(1, len(frames)) if frames[k].time_s - frames[k - 1].time_s > 0.5]
    if len(gaps) == 1:
        bridged = steps.get(gaps[0])
        row["gap_share"] = bridged.error_m / bridged.path_m if bridged else None
    return row


def beside(row, without):
    """What is asked of a run with the IMU, by that without."""
    out = {"ate_without_imu_m": without["ate_m"], "max_without_imu_m": without["max_error_m"], "silent_without_imu": without["silent"]}
    for name, key in (("ate_over_allowed", "ate_m"), ("max_over_allowed", "max_error_m")):
        value, base = row[key], without[key]
        out[name] = None if value is None or base is None else value / max(1.2 * base, base + 0.003)
    out["gain"] = None if row["ate_m"] is None or not without["ate_m"] else row["ate_m"] / without["ate_m"]
    return out


def misses_of(row, scenario):
    """Names of the figures that are not as wanted."""
    if row["error"]:
        return ["error"]
    too_large = [n for n, most in scenario.limits if row.get(n) is None or not row[n] <= most]
    return too_large + [n for n, least in scenario.least if row.get(n) is None or not row[n] >= least]


WIDTHS = (22, 4, 6, 8, 8, 8, 8, 8, 5, 4, 9, 6, 12)
HEAD = "  ".join(
    name.rjust(w) if k else name.ljust(w)
    for k, (name, w) in enumerate(zip(
        ("scenario", "seed", "frames", "ATE", "no IMU", "largest", "a frame", "a second", "lost", "maps", "keyframes", "silent", "warned right"),
        WIDTHS))
) + "  misses; warnings (frames)   lengths in mm"


def line_of(row):
    def millimetres(value):
        return "-" if value is None else f"{1000 * value:.1f}"

    lengths = [millimetres(row[k]) for k in ("ate_m", "ate_without_imu_m", "max_error_m", "rpe_frame_m", "rpe_second_m")]
    counts = ["-" if row[k] is None else str(row[k]) for k in ("lost", "maps", "keyframes", "silent", "warned_right")]
    cells = [row["scenario"], str(row["seed"]), "-" if row["frames"] is None else str(row["frames"]), *lengths, *counts]
    text = "  ".join(c.rjust(w) if k else c.ljust(w) for k, (c, w) in enumerate(zip(cells, WIDTHS)))
    said = ", ".join(f"{n} ({count})" for n, count in (row["warnings"] or {}).items())
    return f"{text}  {', '.join(row['misses']) or 'none'}" + (f"; {said}" if said else "") + (f"; {row['error']}" if row["error"] else "")
