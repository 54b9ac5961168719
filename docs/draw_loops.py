#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Draws docs/images/loops.png: the path of a run before and after its loops were closed, these loops as lines between the places
that they join, and the truth. Needs matplotlib.

    generate_sequence --frames 800 --seed 11 --blind 26 29 --out laps   # two laps; nothing is seen for 3 s
    track_sequence laps --imu off --out before
    track_sequence laps --imu off --loops --out after
    docs/draw_loops.py before after docs/images/loops.png
"""
import json
import pathlib
import sys

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402  (the backend comes first)


def rows_of(file):
    return [list(map(float, line.split())) for line in file.read_text().splitlines() if not line.startswith("#")]


def path(file):
    """Stamps and positions."""
    rows = rows_of(file)
    return [r[0] for r in rows], [tuple(r[1:4]) for r in rows]


def truth_of(file):
    """Positions seen from the first pose, which is where a path begins."""
    rows = rows_of(file)
    x, y, z, w = rows[0][4:8]
    R = ((1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
         (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
         (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)))
    moved = [[r[1 + k] - rows[0][1 + k] for k in range(3)] for r in rows]
    return [tuple(sum(R[k][c] * d[k] for k in range(3)) for c in range(3)) for d in moved]


def pieces(times, positions, longest=0.3):
    """A path without the times in which there is none, seconds."""
    begin = 0
    for i in range(1, len(times) + 1):
        if i == len(times) or times[i] - times[i - 1] > longest:
            yield positions[begin:i]
            begin = i


def draw_edges(axes, run, edges):
    """The loops between the places where the run has their keyframes."""
    at = {round(1e6 * t): p for t, p in zip(*path(run / "trajectory.txt"))}
    label = f"{len(edges)} loops"
    for edge in edges:
        ends = [at.get(round(edge[name] / 1000)) for name in ("from_time_ns", "to_time_ns")]
        if None not in ends:
            axes.plot([p[0] for p in ends], [p[2] for p in ends], color="tab:green", linewidth=0.7, label=label)
            label = None


def draw(axes, run, title, edges):
    truth = truth_of(run / "groundtruth.txt")
    axes.plot([p[0] for p in truth], [p[2] for p in truth], color="0.75", linewidth=4, label="truth")
    for k, piece in enumerate(pieces(*path(run / "trajectory.txt"))):
        axes.plot([p[0] for p in piece], [p[2] for p in piece], linewidth=1.2, label=f"tracked, part {k + 1}")
    draw_edges(axes, run, edges)
    ate = json.loads((run / "summary.json").read_text())["ate_rmse_m"]
    axes.set_title(f"{title}: ATE {1000 * ate:.0f} mm" if ate > 0.1 else f"{title}: ATE {1000 * ate:.1f} mm")
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.legend(loc="lower right", fontsize=8)


def main():
    before, after, out = map(pathlib.Path, sys.argv[1:4])
    edges = json.loads((after / "summary.json").read_text())["loops"]["edges"]
    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4.2), sharex=True, sharey=True)
    draw(axes[0], before, "without loops", edges)
    draw(axes[1], after, "with loops", edges)
    axes[0].set_ylabel("z, m")
    figure.tight_layout()
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main()
