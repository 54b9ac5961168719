# SPDX-License-Identifier: Apache-2.0
"""python -m ft track FOLDER tracks a recorded sequence; python -m ft view FOLDER shows a recording; see --help."""

import argparse
import json
import sys
import time
from pathlib import Path

import ft


def viewer_of(arguments, sequence):
    """A viewer, or None. Raises MissingPackage."""
    if not arguments.view and arguments.record is None:
        return None
    from ft import view

    camera = getattr(sequence.rig, "camera", None) or sequence.rig.left
    return view.Viewer(view.open_rerun(arguments.record), camera, sequence.width, sequence.height,
                       sequence.ground_truth, sequence.ground_truth_has_orientation)


def show(viewer, i, frame, pose, odometry, milliseconds):
    """What is known about a frame, to the viewer."""
    from ft import view

    counts = {"keypoints": pose.keypoints, "with depth": pose.stereo_points, "inliers": pose.inliers,
              "local map": pose.local_points}
    times = {**odometry.stage_times(), "total": milliseconds}
    seen = view.Seen(i, frame.time_ns, frame.left, pose.tracked, pose.keyframe, pose.T_world_camera,
                     odometry.keypoints(), counts, times)
    viewer.show(seen, odometry.map() if pose.tracked and pose.keyframe else None)


def track(arguments):
    sequence = ft.read_sequence(arguments.folder, calibration=arguments.calibration, max_frames=arguments.frames,
                                imu=arguments.imu)
    viewer = viewer_of(arguments, sequence)
    options = {"features": arguments.features} if arguments.features else {}
    odometry = ft.Odometry(sequence.rig, sequence.width, sequence.height, imu=sequence.imu, device=arguments.device,
                           measure_stages=viewer is not None, **options)
    samples = iter(sequence.imu_samples)
    waiting = next(samples, None)
    poses, spent, stopped, i = [], 0.0, None, 0
    try:
        for i, frame in enumerate(sequence):
            while waiting is not None and waiting[0] <= frame.time_ns:
                odometry.add_imu(*waiting)
                waiting = next(samples, None)
            begin = time.perf_counter()
            pose = odometry.track(frame.left, frame.right, frame.time_ns)
            took = time.perf_counter() - begin
            spent += took
            if pose.tracked:
                poses.append((frame.time_ns, pose.T_world_camera))
            if viewer is not None:
                show(viewer, i, frame, pose, odometry, 1e3 * took)
    except KeyboardInterrupt:
        stopped = i
    if viewer is not None:
        viewer.finish()
    return report(arguments, sequence, poses, spent, stopped)


def report(arguments, sequence, poses, spent, stopped):
    """Writes trajectory and summary. Returns the exit status."""
    if not poses:
        print("no frame could be tracked", file=sys.stderr)
        return 1
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    trajectory = ft.Trajectory.of(poses)
    trajectory.write_tum(out / "trajectory.txt")
    summary = {"sequence": sequence.name, "frames": len(sequence), "tracked": len(poses), "stopped_at": stopped,
               "frames_per_s": len(poses) / spent if spent else None}
    if len(sequence.ground_truth):
        errors = ft.evaluate(trajectory, sequence.ground_truth, orientation=sequence.ground_truth_has_orientation)
        summary.update({k: v for k, v in errors.items() if k != "T_truth_estimate"})
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(summary, indent=1))
    if stopped is not None:
        print(f"stopped at frame {stopped}", file=sys.stderr)
    return 0 if stopped is None else 3


def view_recording(arguments):
    from ft import view

    print(f"{view.show_recording(arguments.folder, arguments.record)} frames")
    return 0


def parser():
    top = argparse.ArgumentParser(prog="python -m ft", description=__doc__)
    top.add_argument("--version", action="version", version=ft.__version__)
    commands = top.add_subparsers(dest="command", required=True)
    command = commands.add_parser("track", help="tracks a sequence in EuRoC or KITTI layout")
    command.add_argument("folder")
    command.add_argument("--calibration", default="", help="in place of the sequence's own")
    command.add_argument("--frames", type=int, default=0, help="stop after so many; 0 = all")
    command.add_argument("--features", type=int, default=0, help="keypoints per image; default: 1200")
    command.add_argument("--device", default="auto", choices=["auto", "host", "cuda"])
    command.add_argument("--imu", action="store_true", help="use the sequence's IMU")
    command.add_argument("--out", default="ft_track_out", help="folder for trajectory.txt and summary.json")
    shown = command.add_mutually_exclusive_group()
    shown.add_argument("--view", action="store_true", help="show the run in the viewer rerun, as it goes (rerun-sdk)")
    shown.add_argument("--record", metavar="FILE.rrd", help="write what the viewer shows to a file (rerun-sdk)")
    command.set_defaults(run=track)
    command = commands.add_parser("view", help="shows what track_sequence --record FOLDER wrote (rerun-sdk)")
    command.add_argument("folder")
    command.add_argument("--record", metavar="FILE.rrd", help="write it to a file, and start no viewer")
    command.set_defaults(run=view_recording)
    return top


def main():
    arguments = parser().parse_args()
    try:
        return arguments.run(arguments)
    except (RuntimeError, ValueError) as e:
        print(f"ft: {e}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
