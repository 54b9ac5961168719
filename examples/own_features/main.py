# SPDX-License-Identifier: Apache-2.0
"""Tracks a recording of a rectified pair or of a camera with depth images twice: by ft's own keypoints, and by those of
OpenCV's ORB. Prints the errors of both.

    python examples/own_features/main.py FOLDER [--features 1200] [--device host]

Needs opencv-python-headless.
"""

import argparse
import time

import cv2
import numpy as np

import ft


def found(orb, image):
    return ft.ImageFeatures.from_cv2(*orb.detectAndCompute(image, None))


def features_of(orb, frame, unit):
    """Of a pair those of both images: ft finds partners by descriptors. Of a camera with depth images the depths, too."""
    left = found(orb, frame.left)
    if frame.right.dtype == np.uint8:
        return left, found(orb, frame.right)
    columns, rows = left.positions.astype(int).T
    left.depth = unit * frame.right[rows, columns].astype(np.float32)
    return (left,)


def follow(sequence, name, track):
    poses, spent, inliers = [], 0.0, []
    for frame in sequence:
        begin = time.perf_counter()
        pose = track(frame)
        spent += time.perf_counter() - begin
        if pose.tracked:
            poses.append((frame.time_ns, pose.T_world_camera))
            inliers.append(pose.inliers)
    error = ft.evaluate(poses, sequence.ground_truth)["ate_m"] if sequence.ground_truth else None
    of = len(sequence)
    print(f"{name:22} {len(poses):4} of {of:4} {pose.maps:5} {np.median(inliers):8.0f} "
          f"{'-' if error is None else f'{error:7.3f} m':>10} {1e3 * spent / of:8.1f} ms")


def main():
    arguments = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    arguments.add_argument("folder")
    arguments.add_argument("--features", type=int, default=1200)
    arguments.add_argument("--device", default="auto")
    given = arguments.parse_args()
    sequence = ft.read_sequence(given.folder)
    options = {"features": given.features, "device": given.device}
    size = sequence.width, sequence.height
    print(f"{'keypoints':22} {'tracked':>12} {'maps':>5} {'inliers':>8} {'ATE':>10} {'a frame':>11}")

    images = ft.Odometry(sequence.rig, *size, **options)
    follow(sequence, "ft, of images", lambda frame: images.track(*frame.images, frame.time_ns))

    odometry = ft.Odometry(sequence.rig, *size, own_features=True, **options)
    unit = getattr(sequence.rig, "depth_scale", None)  # metres
    orb = cv2.ORB_create(given.features, scaleFactor=odometry.scale_factor, nlevels=8)
    follow(sequence, "cv2.ORB_create",
           lambda f: odometry.track_features(*features_of(orb, f, unit), f.time_ns))


if __name__ == "__main__":
    main()
