# SPDX-License-Identifier: Apache-2.0
"""python -m ft track RECORDING tracks a recorded sequence; python -m ft live tracks a camera; python -m ft view FOLDER shows a recording; see --help."""

from __future__ import annotations

import argparse
import sys
from typing import Callable, cast

import ft


def track(arguments: argparse.Namespace) -> int:
    from . import track as program

    return program.track(arguments)


def track_live(arguments: argparse.Namespace) -> int:
    from .live import live

    return live(arguments)


def view_recording(arguments: argparse.Namespace) -> int:
    from ft import view

    if arguments.folder.endswith(".rrd"):
        if arguments.record is not None:
            raise ValueError(f"{arguments.folder}: --record takes a folder, and this is what it writes")
        return view.show_file(arguments.folder)
    print(f"{view.show_recording(arguments.folder, arguments.record)} frames")
    return 0


def count(least: int, most: int) -> Callable[[str], int]:
    """A whole number in a range."""
    def parsed(text: str) -> int:
        value = int(text)
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"is {value}, must be in [{least}, {most}]")
        return value
    return parsed


def number(least: float, most: float) -> Callable[[str], float]:
    """A number in a range."""
    def parsed(text: str) -> float:
        value = float(text)
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"is {value:g}, must be in [{least:g}, {most:g}]")
        return value
    return parsed


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="python -m ft", description=__doc__)
    top.add_argument("--version", action="version", version=ft.__version__)
    commands = top.add_subparsers(dest="command", required=True)
    command = commands.add_parser(
        "track", help="tracks a sequence in the layout of EuRoC, KITTI or TUM RGB-D and others, folders of images, a bag, or videos",
        epilog="The exit status is 0; 1 for an error, or where no frame could be tracked; 2 for a mistake in the options; 3 "
               "where Ctrl-C, SIGTERM or an image that cannot be read stopped the run: what was tracked until then is written.")
    command.add_argument("folder", nargs="*", metavar="RECORDING",
                         help="a folder; a bag (.bag, .mcap, .db3, the folder of a ROS 2 bag); a video, or those of the left and "
                              "the right camera; images of one camera, or 'images/*.png'")
    command.add_argument("--sequence", help="the same as an option")
    command.add_argument("--calibration", default="", help="in place of the sequence's own")
    command.add_argument("--topics", nargs="+", default=(), metavar="TOPIC",
                         help="of a bag: one with images, left and right, or colour and depth; default: by type and name")
    command.add_argument("--fps", type=number(1e-3, 1e5), help="images a second, of folders whose file names are no times")
    command.add_argument("--times", default="", help="file with the time of each image, of folders of images")
    command.add_argument("--frames", type=count(0, 2**31 - 1), default=0, help="stop after so many; 0 = all")
    command.add_argument("--backend", "--device", default="auto", choices=["auto", "host", "cuda"],
                         help="auto is a GPU if there is one")
    command.add_argument("--threads", type=count(0, 4096), default=0, help="of the host; 0 = all")
    command.add_argument("--rig", default="auto",
                         choices=["auto", "stereo", "mono", "rgbd", "rectified", "fisheye", "mixed", "monocular"],
                         help="auto (what the folder holds), stereo (fisheye pairs as they are, others rectified), mono (one "
                              "camera, of a pair the left one), rgbd (with depth images), rectified or fisheye (a pair), mixed "
                              "(all cameras of a rig as they are: pinhole, radtan, Kannala-Brandt or double sphere); monocular is mono")
    command.add_argument("--mask", action="append", default=[], metavar="MASK",
                         help="image that is 0 where no keypoints are wanted, or a folder with one for each frame that has the "
                              "name of its image; once for each camera, left, right, cam2 ...; '' = none")
    command.add_argument("--image-bits", type=count(8, 16), metavar="BITS",
                         help="that hold the samples of grey images of 16 bits; default: 16")
    command.add_argument("--max-time-difference", type=number(0, 1e4), metavar="MS",
                         help="how far the time stamps of the two images of a frame may be apart; default: 1 for a pair, 20 "
                              "for depth images")
    command.add_argument("--depth-unit", type=number(1e-9, 1e3),
                         help="metres per unit of depth images; default: the calibration's, or 0.0002 (TUM)")
    command.add_argument("--min-depth", type=number(0, 1e6), default=0.0, help="metres; smaller depths are taken for none")
    command.add_argument("--max-depth", type=number(1e-9, float("inf")), help="metres; larger depths are taken for none")
    command.add_argument("--readout", type=number(0, 100), metavar="MS",
                         help="from the first row of an image to the last one, of all cameras: those have rolling shutters, and "
                              "stamps are those of the middle row; 0 = global shutters; default: the calibration's (Kalibr's "
                              "line_delay), or 0")
    command.add_argument("--features", type=count(1, 1 << 20), default=0,
                         help="keypoints per image; default: the settings file's, or 1200 (2000 for wide images)")
    command.add_argument("--near", type=number(1e-6, 1e6),
                         help="depth of map points, in baselines; default: the settings file's, or 50")
    command.add_argument("--corner-ratio", type=number(0, 1), default=0.0,
                         help="corners that are more like an edge are left out; 0 = the default, 1/16 where there are depths; "
                              "1e-6 keeps all")
    command.add_argument("--loops", action="store_true",
                         help="recognises places seen before and corrects the path there: trajectory.txt is the path as all "
                              "loops have corrected it, trajectory_online.txt as each frame told it")
    command.add_argument("--load-map", metavar="FILE",
                         help="of --save-map, with the same rig, image size and options: the camera is searched for in it, and "
                              "poses are in its world. Near the place where it was saved; anywhere if both runs have --loops")
    command.add_argument("--localize-only", action="store_true",
                         help="with --load-map: the map is not changed, and a camera that is not found in it stays lost")
    command.add_argument("--save-map", metavar="FILE",
                         help="for the map at the end, with --loops also for all places that are kept")
    command.add_argument("--imu", default="auto", nargs="?", const="auto", choices=["auto", "off"],
                         help="auto (the default): used if the sequence has one")
    command.add_argument("--imu-time-offset", type=number(-10, 10),
                         help="seconds that the IMU's clock is ahead of that of the images; default: what imu0/sensor.yaml has "
                              "as timeshift_cam_imu, or 0")
    command.add_argument("--out", default="track_sequence_out",
                         help="folder for trajectory.txt, groundtruth.txt, map.ply, times.csv, summary.json, report.html")
    command.add_argument("--frame", default="camera", choices=["camera", "body"], help="whose poses are written and compared")
    command.add_argument("--poses", default="tum", choices=["tum", "kitti"], help="kitti: also poses.txt, 12 numbers a frame")
    command.add_argument("--timing", action="store_true", help="measures the stages of a frame")
    command.add_argument("--quiet", action="store_true", help="no progress display")
    shown = command.add_mutually_exclusive_group()
    shown.add_argument("--view", action="store_true", help="show the run in the viewer rerun, as it goes (rerun-sdk)")
    shown.add_argument("--record", metavar="FILE.rrd", help="write what the viewer shows to a file (rerun-sdk)")
    command.set_defaults(run=track)
    command = commands.add_parser(
        "live", help="tracks a camera that is plugged in, until Ctrl-C",
        epilog="Writes trajectory.txt in TUM's format. The exit status is 0; 1 for an error, or where no frame was tracked.")
    command.add_argument("--camera", default="0", metavar="CAMERA",
                         help="a number or a video for OpenCV, realsense (pyrealsense2), or oak (depthai 3); default: 0")
    command.add_argument("--parameters", type=float, nargs="+", default=(), metavar="P",
                         help="of OpenCV's camera: fx fy cx cy, pixels, then 0, 4, 5 or 8 of k1 k2 p1 p2 k3 k4 k5 k6")
    command.add_argument("--fisheye", action="store_true", help="the parameters are fx fy cx cy k1 k2 k3 k4 of Kannala and Brandt")
    command.add_argument("--readout", type=number(0, 100), default=0.0, metavar="MS",
                         help="of OpenCV's camera: from the first row of an image to the last one; most webcams and phones have "
                              "rolling shutters; 0 (the default) = a global shutter")
    command.add_argument("--size", metavar="WxH", help="of the images; default: the camera's, or 848x480 and 640x400")
    command.add_argument("--fps", type=number(1, 1000), help="images a second; default: the camera's, or 30 and 20")
    command.add_argument("--imu", default="auto", choices=["auto", "off"], help="auto (the default): used if the camera has one")
    command.add_argument("--backend", "--device", default="auto", choices=["auto", "host", "cuda"],
                         help="auto is a GPU if there is one")
    command.add_argument("--threads", type=count(0, 4096), default=0, help="of the host; 0 = all")
    command.add_argument("--features", type=count(1, 1 << 20), default=1200, help="keypoints per image (1200)")
    command.add_argument("--frames", type=count(0, 2**31 - 1), default=0, help="stop after so many; 0 = go on")
    command.add_argument("--seconds", type=number(0, 1e9), help="stop after so long")
    command.add_argument("--out", default="live_out", help="folder for trajectory.txt")
    command.add_argument("--quiet", action="store_true", help="no line every second")
    shown = command.add_mutually_exclusive_group()
    shown.add_argument("--view", action="store_true", help="show the run in the viewer rerun, as it goes (rerun-sdk)")
    shown.add_argument("--record", metavar="FILE.rrd", help="write what the viewer shows to a file (rerun-sdk)")
    command.set_defaults(run=track_live)
    command = commands.add_parser("view", help="shows what track_sequence --record FOLDER, or --record FILE.rrd, wrote (rerun-sdk)")
    command.add_argument("folder", metavar="RECORDING", help="the folder; or a file .rrd, which rerun's own viewer opens")
    command.add_argument("--record", metavar="FILE.rrd", help="write it to a file, and start no viewer")
    command.set_defaults(run=view_recording)
    return top


def main() -> int:
    top = parser()
    arguments = top.parse_args()
    if arguments.command == "track":
        if bool(arguments.folder) == (arguments.sequence is not None):
            top.error("one of RECORDING and --sequence names the recording")
        arguments.files = arguments.folder or [arguments.sequence]
        arguments.folder = arguments.files[0]
        if arguments.localize_only and not arguments.load_map:
            top.error("argument --localize-only: needs --load-map")
        if arguments.max_depth is not None and not arguments.max_depth > arguments.min_depth:
            top.error(f"argument --max-depth: is {arguments.max_depth:g}, must be above --min-depth, {arguments.min_depth:g}")
        if arguments.max_depth == float("inf"):
            arguments.max_depth = None
    try:
        return cast(int, arguments.run(arguments))
    except (RuntimeError, ValueError) as e:
        print(f"ft: {e}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("ft: stopped", file=sys.stderr)
        return 3


if __name__ == "__main__":
    sys.exit(main())
