#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Draws docs/images/loops.png: the path of a run before and after its loops were closed, and the truth. Needs matplotlib.

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


def path(file):
    """Stamps and positions."""
    rows = [line.split() for line in file.read_text().splitlines() if not line.startswith("#")]
    return [float(r[0]) for r in rows], [tuple(map(float, r[1:4])) for r in rows]


def pieces(times, positions, longest=0.3):
    """A path without the times in which there is none, seconds."""
    begin = 0
    for i in range(1, len(times) + 1):
        if i == len(times) or times[i] - times[i - 1] > longest:
            yield positions[begin:i]
            begin = i


def draw(axes, run, title):
    truth = path(run / "groundtruth.txt")[1]
    axes.plot([p[0] for p in truth], [p[2] for p in truth], color="0.75", linewidth=4, label="truth")
    for k, piece in enumerate(pieces(*path(run / "trajectory.txt"))):
        axes.plot([p[0] for p in piece], [p[2] for p in piece], linewidth=1.2, label=f"tracked, part {k + 1}")
    ate = json.loads((run / "summary.json").read_text())["ate_rmse_m"]
    axes.set_title(f"{title}: ATE {1000 * ate:.0f} mm" if ate > 0.1 else f"{title}: ATE {1000 * ate:.1f} mm")
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.legend(loc="upper right", fontsize=8)


def main():
    before, after, out = map(pathlib.Path, sys.argv[1:4])
    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4.2), sharey=True)
    draw(axes[0], before, "without loops")
    draw(axes[1], after, "with loops")
    axes[0].set_ylabel("z, m")
    figure.tight_layout()
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main()
