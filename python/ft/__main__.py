# SPDX-License-Identifier: Apache-2.0
"""python -m ft track FOLDER: tracks a recorded sequence; see --help."""

import argparse
import json
import sys
import time
from pathlib import Path

import ft


def recorder_of(file):
    """A recording for the viewer rerun, or None; says which package is missing."""
    if file is None:
        return None
    try:
        import rerun
    except ImportError:
        sys.exit("python -m ft track --record needs the package rerun: python -m pip install rerun-sdk")
    rerun.init("ft", spawn=False)
    rerun.save(str(file))
    return rerun


def record(rerun, frame, pose, odometry):
    """Image, keypoints and pose of a frame."""
    rerun.set_time("frame", timestamp=1e-9 * frame.time_ns)
    keypoints = odometry.keypoints()
    rerun.log("camera/image", rerun.Image(frame.left))
    rerun.log("camera/image/keypoints", rerun.Points2D(
        list(zip(keypoints["x"], keypoints["y"])),
        colors=[[0, 255, 0] if m else [255, 160, 0] for m in keypoints["matched"]]))
    T = pose.T_world_camera
    rerun.log("camera", rerun.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
    if pose.keyframe:
        rerun.log("map", rerun.Points3D(odometry.map()["position"]))


def track(arguments):
    sequence = ft.read_sequence(arguments.folder, calibration=arguments.calibration, max_frames=arguments.frames,
                                imu=arguments.imu)
    options = {"features": arguments.features} if arguments.features else {}
    odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, imu=sequence.imu, device=arguments.device,
                           **options)
    rerun = recorder_of(arguments.record)
    samples = iter(sequence.imu_samples)
    waiting = next(samples, None)
    poses, tracked, spent, stopped = [], 0, 0.0, None
    try:
        for i, frame in enumerate(sequence):
            while waiting is not None and waiting[0] <= frame.time_ns:
                odometry.add_imu(*waiting)
                waiting = next(samples, None)
            begin = time.perf_counter()
            pose = odometry.track(frame.left, frame.right, frame.time_ns)
            spent += time.perf_counter() - begin
            if pose.tracked:
                tracked += 1
                poses.append((frame.time_ns, pose.T_world_camera))
            if rerun is not None:
                record(rerun, frame, pose, odometry)
    except KeyboardInterrupt:
        stopped = i
    if not poses:
        print("no frame could be tracked", file=sys.stderr)
        return 1
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    trajectory = ft.Trajectory.of(poses)
    trajectory.write_tum(out / "trajectory.txt")
    summary = {"sequence": sequence.name, "frames": len(sequence), "tracked": tracked, "stopped_at": stopped,
               "frames_per_s": tracked / spent if spent else None}
    if len(sequence.ground_truth):
        errors = ft.evaluate(trajectory, sequence.ground_truth, orientation=sequence.ground_truth_has_orientation)
        summary.update({k: v for k, v in errors.items() if k != "T_truth_estimate"})
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(summary, indent=1))
    if stopped is not None:
        print(f"stopped at frame {stopped}", file=sys.stderr)
    return 0 if stopped is None else 3


def main():
    parser = argparse.ArgumentParser(prog="python -m ft", description=__doc__)
    parser.add_argument("--version", action="version", version=ft.__version__)
    commands = parser.add_subparsers(dest="command", required=True)
    command = commands.add_parser("track", help="tracks a sequence in EuRoC or KITTI layout")
    command.add_argument("folder")
    command.add_argument("--calibration", default="", help="in place of the sequence's own")
    command.add_argument("--frames", type=int, default=0, help="stop after so many; 0 = all")
    command.add_argument("--features", type=int, default=0, help="keypoints per image; default: 1200")
    command.add_argument("--device", default="auto", choices=["auto", "host", "cuda"])
    command.add_argument("--imu", action="store_true", help="use the sequence's IMU")
    command.add_argument("--out", default="ft_track_out", help="folder for trajectory.txt and summary.json")
    command.add_argument("--record", metavar="FILE.rrd", help="a recording for the viewer rerun")
    return track(parser.parse_args())


if __name__ == "__main__":
    sys.exit(main())
