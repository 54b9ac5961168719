# SPDX-License-Identifier: Apache-2.0
"""Tracks a recording of a rectified pair or of a camera with depth images by ft's own keypoints, and by those of OpenCV's
ORB, AKAZE and SIFT. Prints the errors of all.

    python examples/own_features/main.py FOLDER [--features 1200] [--device host] [--xfeat CLONE]

Needs opencv-python-headless. --xfeat: also by the network XFeat, of a clone of verlab/accelerated_features with its
weights/xfeat.pt; needs PyTorch. Nothing is downloaded.
"""

from __future__ import annotations

import argparse
import importlib
import time
from pathlib import Path
from typing import Any, Callable, Optional

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


def xfeat(clone: str, n: int) -> Found:
    """Keypoints of the network, with the weights that lie in the clone; without, as its random weights make them."""
    torch: Any = importlib.import_module("torch")
    network = torch.hub.load(clone, "XFeat", source="local", pretrained=False, top_k=n)
    weights = Path(clone, "weights", "xfeat.pt")
    if weights.is_file():
        network.net.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
    else:
        print(f"{weights} is not there: the network's weights are random")

    def found(image: NDArray[np.uint8]) -> ft.ImageFeatures:
        of = network.detectAndCompute(torch.from_numpy(np.array(image))[None, None].float(), top_k=n)[0]
        positions, score, rows = (of[k].cpu().numpy() for k in ("keypoints", "scores", "descriptors"))
        # 64 numbers, and length 1. Rows of one point are up to 250 apart in ft's steps: here that is an angle of 35 degrees,
        # the cosine 0.82 below which XFeat's own matcher takes none.
        steps = np.clip(np.rint(250 / 0.6 * rows), -127, 127).astype(np.int8)
        return ft.ImageFeatures(positions, np.pad(steps, ((0, 0), (0, 128 - steps.shape[1]))), score=score,
                                deviation=np.ones(len(rows), np.float32))

    return found


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
    arguments.add_argument("--xfeat", metavar="CLONE")
    given = arguments.parse_args()
    sequence = ft.read_sequence(given.folder)
    width, height, features, device = sequence.width, sequence.height, int(given.features), str(given.device)
    unit = getattr(sequence.rig, "depth_scale", None)  # metres
    print(f"{'keypoints':22} {'tracked':>12} {'maps':>5} {'inliers':>8} {'ATE':>10} {'a frame':>11}")

    images = ft.Odometry(sequence.rig, width, height, features=features, device=device)
    follow(sequence, "ft, of images", lambda frame: images.track(*frame.images, frame.time_ns))

    def follow_own(name: str, descriptors: str, found: Found) -> None:
        own = ft.Odometry(sequence.rig, width, height, features=features, device=device, own_features=True,
                          descriptors=descriptors)
        follow(sequence, name, lambda f: own.track_features(*features_of(found, f, unit), f.time_ns))

    for name, (descriptors, pixel_size, make) in DETECTORS.items():
        if not hasattr(cv2, name):
            print(f"{name}: not in this OpenCV")
            continue
        detector = make(features)

        def found(image: NDArray[np.uint8]) -> ft.ImageFeatures:
            return ft.ImageFeatures.from_cv2(*detector.detectAndCompute(image, None), pixel_size=pixel_size)

        follow_own(f"cv2.{name}", descriptors, found)
    if given.xfeat:
        follow_own("XFeat", "int8_128", xfeat(given.xfeat, features))


if __name__ == "__main__":
    main()
