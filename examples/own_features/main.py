# SPDX-License-Identifier: Apache-2.0
"""Tracks a recording of a rectified pair or of a camera with depth images by ft's own keypoints, and by those of OpenCV's
ORB, AKAZE and SIFT. Prints the errors of all.

    python examples/own_features/main.py FOLDER [--features 1200] [--device host]

Needs opencv-python-headless.
"""

import argparse
import time

import cv2
import numpy as np

import ft

# Of each the odometry's descriptors, the size of a keypoint whose position has a standard deviation of a pixel (None: its
# octave tells), and the detector of n keypoints: with thresholds below OpenCV's defaults, by which images of little contrast
# have too few.
DETECTORS = {
    "ORB": ("orb", None, lambda n: cv2.ORB_create(n, scaleFactor=1.2, nlevels=8, fastThreshold=7)),
    "AKAZE": ("bits_512", 4.8, lambda n: cv2.AKAZE_create(threshold=1e-4)),
    "SIFT": ("int8_128", 3.2, lambda n: cv2.SIFT_create(n, contrastThreshold=0.02)),
}


def features_of(found, frame, unit):
    """Of a pair those of both images: ft finds partners by descriptors. Of a camera with depth images the depths, too."""
    left = found(frame.left)
    if frame.right.dtype == np.uint8:
        return left, found(frame.right)
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
    error = ft.evaluate(poses, sequence.ground_truth)["ate_m"] if sequence.ground_truth and poses else None
    of = len(sequence)
    print(f"{name:22} {len(poses):4} of {of:4} {pose.maps:5} {np.median(inliers) if inliers else 0:8.0f} "
          f"{'-' if error is None else f'{error:7.3f} m':>10} {1e3 * spent / of:8.1f} ms", flush=True)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    arguments.add_argument("folder")
    arguments.add_argument("--features", type=int, default=1200)
    arguments.add_argument("--device", default="auto")
    given = arguments.parse_args()
    sequence = ft.read_sequence(given.folder)
    options = {"features": given.features, "device": given.device}
    size = sequence.width, sequence.height
    unit = getattr(sequence.rig, "depth_scale", None)  # metres
    print(f"{'keypoints':22} {'tracked':>12} {'maps':>5} {'inliers':>8} {'ATE':>10} {'a frame':>11}")

    images = ft.Odometry(sequence.rig, *size, **options)
    follow(sequence, "ft, of images", lambda frame: images.track(*frame.images, frame.time_ns))

    for name, (descriptors, pixel_size, make) in DETECTORS.items():
        if not hasattr(cv2, f"{name}_create"):
            print(f"{name}: not in this OpenCV")
            continue
        detector = make(given.features)
        odometry = ft.Odometry(sequence.rig, *size, own_features=True, descriptors=descriptors, **options)

        def found(image):
            return ft.ImageFeatures.from_cv2(*detector.detectAndCompute(image, None), pixel_size=pixel_size)

        follow(sequence, f"cv2.{name}_create", lambda f: odometry.track_features(*features_of(found, f, unit), f.time_ns))


if __name__ == "__main__":
    main()
