#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tracks the same frames with ft on a GPU and with cuVSLAM, one after the other on one machine, and writes a table.

    bench/peers/beside_cuvslam.py --client ./cuvslam_client --data FOLDER --seeds 1 2 3 4 5 --commit COMMIT --out raw.json
    bench/results.py raw.json beside_cuvslam.json --what TEXT

Without --client ft alone, also on the host (--backend host). FOLDER has the recordings of ROWS, by their names; those that are not there are left out, and said so. cuVSLAM runs three
times by its default, which adjusts beside the frames and differs from run to run, and once adjusting within the frames. Of generated sequences it also says the error of
a motion over one frame, of cuVSLAM's run within the frames."""
import argparse
import datetime
import json
import os
import pathlib
import platform
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools" / "evaluation"))
from evaluation import motions  # noqa: E402

BACK = "and back"
# recording, rig, every n-th frame; or all frames, then backward (KITTI's layout)
ROWS = [
    ("kitti_motion_start", "stereo", 1), ("kitti_motion_start", "stereo", 3), ("kitti_motion_start", "stereo", BACK),
    ("kitti_0926_stereo", "stereo", 1),
    ("euroc_v101_stereo_start", "stereo", 1), ("euroc_mh05_mono", "mono", 1), ("euroc_v101_mono_flight", "mono", 1),
    ("rgbd_7scenes_kitchen", "rgbd", 1), ("rgbd_7scenes_kitchen", "rgbd", 6), ("rgbd_7scenes_kitchen", "rgbd", 10),
    ("rgbd_hololens_office", "rgbd", 1), ("rgbd_hololens_office", "rgbd", 2),
    ("rgbd_tartanair", "rgbd", 1), ("rgbd_tartanair", "rgbd", 3),
]  # fmt: skip
# name, options of generate_sequence, every n-th frame, with the IMU
GENERATED = [
    ("generated", [], 1, False), ("generated, every 2nd", [], 2, False), ("generated, every 4th", [], 4, False),
    ("generated, fast turn", ["--exposure", "15", "--fast-turn", "5", "6.5", "120"], 1, False),
]  # fmt: skip


def thinned_list(source, target, every):
    """A list with a line for each frame; those that begin with # stay."""
    lines = source.read_text().splitlines()
    head = [line for line in lines if line.startswith("#")]
    rows = [line for line in lines if line and not line.startswith("#")]
    target.write_text("\n".join(head + rows[::every]) + "\n")


def thinned(source, folder, every):
    """A folder with every n-th frame of a recording in the layout of EuRoC, KITTI or TUM RGB-D."""
    if every == 1:
        return source
    shutil.copytree(source, folder, ignore=lambda path, names: {n for n in names if n in ("data", "rgb", "depth", "image_0", "image_1")})
    for images in ("rgb", "depth", "mav0/cam0/data", "mav0/cam1/data"):
        if (source / images).is_dir():
            (folder / images).symlink_to((source / images).resolve())
    for name in ("rgb.txt", "depth.txt", "associations.txt", "times.txt", "poses.txt", "mav0/cam0/data.csv", "mav0/cam1/data.csv"):
        if (source / name).is_file():
            thinned_list(source / name, folder / name, every)
    for images in ("image_0", "image_1"):  # named by their numbers
        if (source / images).is_dir():
            (folder / images).mkdir()
            for k, image in enumerate(sorted((source / images).iterdir())[::every]):
                (folder / images / f"{k:06d}{image.suffix}").symlink_to(image.resolve())
    return folder


def there_and_back(source, folder):
    """All frames of a recording in KITTI's layout, then the same backward; the times go on."""
    folder.mkdir()
    shutil.copy(source / "calib.txt", folder)
    times = [float(t) for t in (source / "times.txt").read_text().split()]
    poses = (source / "poses.txt").read_text().splitlines()
    order = [*range(len(times)), *range(len(times) - 2, -1, -1)]
    (folder / "times.txt").write_text("".join(f"{times[0] + k * (times[1] - times[0]):.6f}\n" for k in range(len(order))))
    (folder / "poses.txt").write_text("".join(poses[i] + "\n" for i in order))
    for images in ("image_0", "image_1"):
        (folder / images).mkdir()
        files = sorted((source / images).iterdir())
        for k, i in enumerate(order):
            (folder / images / f"{k:06d}{files[i].suffix}").symlink_to(files[i].resolve())
    return folder


def run(command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        print(f"  {command[0]}: {done.stderr.strip() or done.stdout.strip()[-300:]}", file=sys.stderr)
    return done


def error_over_a_frame(estimate, truth):
    """RMSE of the translations of motions over one frame, metres, of two trajectories in TUM's format with the same stamps."""
    estimate, truth = motions.read_tum(estimate), motions.read_tum(truth)
    stamps = list(truth)
    errors = []
    for a, b in zip(stamps, stamps[1:]):
        if a not in estimate or b not in estimate:
            continue
        wrong = motions.relative(motions.relative(truth[a], truth[b]), motions.relative(estimate[a], estimate[b]))
        errors.append(motions.length(wrong[1]))
    return motions.root_mean_square(errors)


def track_ft(options, folder, rig, imu, work):
    """Frames one after the other: none is prefetched."""
    out = work / "ft"
    shutil.rmtree(out, ignore_errors=True)
    command = [options.bin / "track_sequence", folder, "--rig", rig, "--backend", options.backend, "--read-ahead", "0", "--quiet"]
    run([*command, "--out", out, "--imu", "auto" if imu else "off", *(["--features", options.features] if options.features else [])])
    try:
        found = json.loads((out / "summary.json").read_text())
    except OSError:
        return {}
    row = {f"ft.{name}": found[name] for name in ("frames", "lost", "maps", "keyframes")}
    row["ft.p50_ms"], row["ft.p99_ms"] = (found["images_to_pose"][f"{p}_ms"] for p in ("p50", "p99"))
    if found["ate_rmse_m"] is not None:
        row["ft.ate_m"] = found["ate_rmse_m"]
        row["ft.scale_to_truth"] = found["scale_to_truth"]
    warned = [f"{name} {count}" for name, count in sorted(found["frame_warnings"].items())]
    return {**row, **({"ft.warnings": warned} if warned else {})}


def track_cuvslam(options, folder, rig, imu, work):
    command = [options.client, folder, work / "cuvslam.txt", "--rig", rig, *(["--imu"] if imu else [])]
    found = []
    for adjusts in (["--async"], ["--async"], ["--async"], []):
        done = run([*command, *adjusts])
        if done.returncode != 0:
            return {}
        found.append(json.loads(done.stdout.splitlines()[-1]))
    middle = sorted(found[:3], key=lambda f: f["ms_p50"])[1]
    row = {"cuvslam.lost": middle["lost"], "cuvslam.p50_ms": middle["ms_p50"], "cuvslam.p99_ms": middle["ms_p99"]}
    errors = sorted(f["ate_m"] for f in found[:3] if f["ate_m"] is not None)
    if errors:
        row["cuvslam.ate_m"] = errors
    if found[3]["ate_m"] is not None:
        row["cuvslam.ate_synchronous_m"] = found[3]["ate_m"]
    row["cuvslam.p50_synchronous_ms"] = found[3]["ms_p50"]
    return row


def compare(options, name, source, rig, every, imu, work):
    folder = there_and_back(source, work / "thinned") if every == BACK else thinned(source, work / "thinned", every)
    row = {"recording": name, "every": every, "rig": rig, "imu": imu}
    row.update(track_ft(options, folder, rig, imu, work))
    truth, generated = work / "ft" / "groundtruth.txt", name.startswith("generated")
    if generated and truth.is_file():
        row["ft.rpe_frame_m"] = error_over_a_frame(work / "ft" / "trajectory.txt", truth)
    if options.client:
        row.update(track_cuvslam(options, folder, rig, imu, work))
        if generated and truth.is_file() and (work / "cuvslam.txt").is_file():
            row["cuvslam.rpe_frame_m"] = error_over_a_frame(work / "cuvslam.txt", truth)
    shutil.rmtree(work / "thinned", ignore_errors=True)
    print(json.dumps(row), flush=True)
    return row


def all_rows(options, work):
    for name, rig, every in ROWS:
        if options.data and (options.data / name).is_dir():
            yield compare(options, name, options.data / name, rig, every, False, work)
        else:
            print(f"  no recording {name}: left out", file=sys.stderr)
    for seed in options.seeds:
        made = {}
        for name, how, every, imu in GENERATED:
            source = made.setdefault(tuple(how), work / f"generated_{seed}_{len(made)}")
            if not source.is_dir():
                run([options.bin / "generate_sequence", "--out", source, "--seed", seed, *how])
            yield {**compare(options, name, source, "stereo", every, imu, work), "seed": seed}
        for source in made.values():
            shutil.rmtree(source, ignore_errors=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--client", type=pathlib.Path, help="cuvslam_client (none: ft alone)")
    parser.add_argument("--backend", default="cuda", help="ft's (cuda)")
    parser.add_argument("--features", type=int, help="ft's (its default)")
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build" / "bin", help="folder of ft's programs (build/bin)")
    parser.add_argument("--data", type=pathlib.Path, help="folder of recordings (none)")
    parser.add_argument("--seeds", type=int, nargs="*", default=[], help="of generated sequences of 300 frames")
    parser.add_argument("--commit", required=True, help="of ft")
    parser.add_argument("--out", type=pathlib.Path, required=True)
    options = parser.parse_args()
    options.client = options.client.resolve() if options.client else None
    with tempfile.TemporaryDirectory() as folder:
        rows = list(all_rows(options, pathlib.Path(folder)))
    if not rows:
        parser.error("nothing to track: neither recordings nor seeds")
    words = ["bench/peers/beside_cuvslam.py", *(pathlib.Path(w).name if "/" in w else w for w in sys.argv[1:])]
    machine = {"processor": f"{os.cpu_count()} cores, {platform.processor() or platform.machine()}"}
    if options.client or options.backend == "cuda":
        gpu = subprocess.run(["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"], capture_output=True, text=True, check=False)
        machine["gpu"], _, machine["driver"] = gpu.stdout.strip().partition(", ")
    options.out.write_text(json.dumps({"date": datetime.date.today().isoformat(), "commit": options.commit, "command": words, "machine": machine, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
