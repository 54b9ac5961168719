# SPDX-License-Identifier: Apache-2.0
"""Tracks a recording of a rectified pair or of a camera with depth images by ft's own keypoints, and by those of OpenCV's
ORB, AKAZE and SIFT. Prints the errors of all.

    python examples/own_features/main.py FOLDER [--features 1200] [--device host]

Needs opencv-python-headless.
"""

from __future__ import annotations

import argparse
import time
from typing import Callable, Optional

import cv2
import numpy as np
from numpy.typing import NDArray

import ft

Found = Callable[[NDArray[np.uint8]], ft.ImageFeatures]

# Of each the odometry's descriptors, the size of a keypoint whose position has a standard deviation of a pixel (None: its
# octave tells), and the detector of n keypoints: with thresholds below OpenCV's defaults, by which images of little contrast
# have too few. Not every OpenCV has AKAZE.
DETECTORS: dict[str, tuple[str, Optional[float], Callable[[int], cv2.Feature2D]]] = {
    "ORB": ("orb", None, lambda n: cv2.ORB.create(n, scaleFactor=1.2, nlevels=8, fastThreshold=7)),
    "AKAZE": ("bits_512", 4.8, lambda n: getattr(cv2, "AKAZE").create(threshold=1e-4)),
    "SIFT": ("int8_128", 3.2, lambda n: cv2.SIFT.create(n, contrastThreshold=0.02)),
}


def features_of(found: Found, frame: ft.Frame, unit: Optional[float]) -> tuple[ft.ImageFeatures, ...]:
    """Of a pair those of both images: ft finds partners by descriptors. Of a camera with depth images the depths, too."""
    left = found(frame.left)
    if frame.right.dtype == np.uint8:
        return left, found(frame.right)
    columns, rows = np.asarray(left.positions).astype(int).T
    assert unit is not None
    left.depth = np.float32(unit) * frame.right[rows, columns]
    return (left,)


def follow(sequence: ft.Sequence, name: str, track: Callable[[ft.Frame], ft.Tracking]) -> None:
    poses: list[tuple[int, NDArray[np.float64]]] = []
    spent, inliers = 0.0, []
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


def main() -> None:
    arguments = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    arguments.add_argument("folder")
    arguments.add_argument("--features", type=int, default=1200)
    arguments.add_argument("--device", default="auto")
    given = arguments.parse_args()
    sequence = ft.read_sequence(given.folder)
    width, height, features, device = sequence.width, sequence.height, int(given.features), str(given.device)
    unit = getattr(sequence.rig, "depth_scale", None)  # metres
    print(f"{'keypoints':22} {'tracked':>12} {'maps':>5} {'inliers':>8} {'ATE':>10} {'a frame':>11}")

    images = ft.Odometry(sequence.rig, width, height, features=features, device=device)
    follow(sequence, "ft, of images", lambda frame: images.track(*frame.images, frame.time_ns))

    for name, (descriptors, pixel_size, make) in DETECTORS.items():
        if not hasattr(cv2, name):
            print(f"{name}: not in this OpenCV")
            continue
        detector = make(features)
        odometry = ft.Odometry(sequence.rig, width, height, features=features, device=device, own_features=True,
                               descriptors=descriptors)

        def found(image: NDArray[np.uint8]) -> ft.ImageFeatures:
            return ft.ImageFeatures.from_cv2(*detector.detectAndCompute(image, None), pixel_size=pixel_size)

        follow(sequence, f"cv2.{name}", lambda f: odometry.track_features(*features_of(found, f, unit), f.time_ns))


if __name__ == "__main__":
    main()
