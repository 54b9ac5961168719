#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What a call of ft.Odometry.track costs above ft::odometry::track, in one process, on the same images.

    build/bin/generate_sequence --out FOLDER --frames 200
    bench/python_overhead.py FOLDER --arrays cupy torch --json raw.json --commit COMMIT
    bench/python_overhead.py FOLDER --device host --arrays numpy

The images of FOLDER, a sequence in EuRoC or KITTI layout, are decoded and brought to where they shall lie before anything
is timed, and are taken back and forth. A pass is an odometry of its own: warm-up, then --frames frames. In a pass of Python
each sample is perf_counter_ns around track(); in one of C++ the extension calls ft::odometry::track in a loop and reads
steady_clock around each call: the code that Python calls, with images that are plain views already. Passes alternate, --rounds
of each. The poses at the end of all passes must be the same. Percentiles by nearest rank over the samples of all rounds.
"""

import argparse
import datetime
import json
import platform
import sys
import time

import numpy as np

import ft

PERIOD_NS = 50_000_000


def on_device(kind):
    """Brings a NumPy image to where the arrays of a library lie."""
    if kind == "cupy":
        import cupy

        return cupy.asarray
    if kind == "torch":
        import torch

        return lambda image: torch.from_numpy(image).cuda()
    return np.ascontiguousarray


def order_of(images, calls):
    """Back and forth: neighbours in time stay neighbours."""
    once = list(range(images)) + list(range(images - 2, 0, -1))
    return [once[i % len(once)] for i in range(calls)]


class Pass:
    """An odometry, and the frames that it is given."""

    def __init__(self, sequence, pairs, arguments):
        self.odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, device=arguments.device)
        order = order_of(len(pairs), arguments.warm_up + arguments.frames + 1)
        self.frames = [pairs[k] for k in order]
        self.times = [PERIOD_NS * (i + 1) for i in range(len(order))]
        for (left, right), t in zip(self.frames[:arguments.warm_up], self.times):
            self.odometry.track(left, right, t)
        self.timed = slice(arguments.warm_up, arguments.warm_up + arguments.frames)

    def python(self):
        track, clock, spent = self.odometry.track, time.perf_counter_ns, []
        for (left, right), t in zip(self.frames[self.timed], self.times[self.timed]):
            begin = clock()
            track(left, right, t)
            spent.append(clock() - begin)
        return spent

    def cpp(self):
        return self.odometry._pipeline.track_timed(self.frames[self.timed], self.times[self.timed])

    def last_pose(self):
        last = self.odometry.track(*self.frames[-1], self.times[-1])
        if not last.tracked:
            sys.exit("the last frame is not tracked: not worth timing")
        return last.T_world_camera


def percentile(samples, share):
    return sorted(samples)[max(0, int(np.ceil(share * len(samples))) - 1)]


def measure(kind, sequence, images, arguments):
    to = on_device(kind)
    pairs = [(to(left), to(right)) for left, right in images]
    samples, poses = {"python": [], "cpp": []}, []
    for i in range(arguments.rounds):
        for way in ("python", "cpp") if i % 2 == 0 else ("cpp", "python"):
            one = Pass(sequence, pairs, arguments)
            samples[way] += getattr(one, way)()
            poses.append(one.last_pose())
    if not all(np.array_equal(poses[0], p) for p in poses):
        sys.exit("the passes do not end in the same pose")
    row = {"images": kind, "calls": len(samples["python"])}
    for way, all_ns in samples.items():
        row[way] = {"p50_us": percentile(all_ns, 0.5) / 1e3, "p99_us": percentile(all_ns, 0.99) / 1e3,
                    "mean_us": float(np.mean(all_ns)) / 1e3}
    row["above_cpp"] = {k: row["python"][k] - row["cpp"][k] for k in row["cpp"]}
    return row


def processor():
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as f:
            return next(line.split(":")[1].strip() for line in f if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--arrays", nargs="+", default=["numpy"], choices=["numpy", "cupy", "torch"])
    parser.add_argument("--device", default="auto", choices=["auto", "host", "cuda"])
    parser.add_argument("--frames", type=int, default=1000, help="timed in a pass")
    parser.add_argument("--rounds", type=int, default=3, help="passes of each language")
    parser.add_argument("--warm-up", type=int, default=100)
    parser.add_argument("--images", type=int, default=200, help="pairs that are decoded, at most")
    parser.add_argument("--json")
    parser.add_argument("--commit", default="")
    arguments = parser.parse_args()
    sequence = ft.read_sequence(arguments.folder, max_frames=arguments.images)
    images = [(frame.left, frame.right) for frame in sequence]
    on_gpu = arguments.device != "host" and len(ft.devices()) > 1
    result = {
        "what": "ft.Odometry.track from Python and ft::odometry::track in a loop of C++, the same pairs in the same order; us",
        "date": datetime.date.today().isoformat(), "commit": arguments.commit, "command": " ".join(sys.argv),
        "device": ft.devices()[1] if on_gpu else "host", "processor": processor(), "python": platform.python_version(),
        "size": [sequence.width, sequence.height], "images": len(images), "warm_up": arguments.warm_up,
        "rows": [measure(kind, sequence, images, arguments) for kind in arguments.arrays],
    }
    text = json.dumps(result, indent=1)
    print(text)
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as f:
            f.write(text + "\n")


if __name__ == "__main__":
    main()
