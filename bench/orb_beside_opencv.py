#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""ft.OrbExtractor beside cv2.ORB on one thread of the host: keypoints, how evenly they lie, repeatability, matches that are
right, time.

    bench/orb_beside_opencv.py FOLDER --json raw.json --commit COMMIT

FOLDER is a sequence in EuRoC or KITTI layout. Each image is compared with itself turned, scaled, shifted and darkened by a
known homography, with new noise. Repeatability: the share of keypoints that have one within 2.5 pixels of where the
homography puts them. A match is the nearest descriptor both ways; it is right within 2.5 pixels.
"""

import argparse
import datetime
import json
import time

import cv2
import numpy as np

import ft

RADIUS = 2.5  # pixels


def homography(random, width, height):
    """Turns by up to 20 degrees, scales by up to 1.25 either way, shifts by up to 20 pixels, tilts a little."""
    angle, scale = random.uniform(-20, 20), 1.25 ** random.uniform(-1, 1)
    H = np.vstack([cv2.getRotationMatrix2D((width / 2, height / 2), angle, scale), [0, 0, 1]])
    H[:2, 2] += random.uniform(-20, 20, 2)
    tilt = np.eye(3)
    tilt[2, :2] = random.uniform(-1e-4, 1e-4, 2)
    return tilt @ H


def changed(random, image, H):
    height, width = image.shape
    warped = cv2.warpPerspective(image, H, (width, height)).astype(float)
    return np.clip(0.9 * warped + random.normal(0, 2, warped.shape), 0, 255).astype(np.uint8)


def cells(points, width, height):
    """The share of 40 x 40 cells with a keypoint."""
    hit = {(int(x) // 40, int(y) // 40) for x, y in points}
    return len(hit) / ((width // 40) * (height // 40))


def compare(extract, image, other, H):
    begin = time.perf_counter()
    points, descriptors = extract(image)
    spent = time.perf_counter() - begin
    others, other_descriptors = extract(other)
    height, width = image.shape
    put = cv2.perspectiveTransform(points[None].astype(np.float64), H)[0]
    inside = (put[:, 0] > 25) & (put[:, 1] > 25) & (put[:, 0] < width - 25) & (put[:, 1] < height - 25)
    nearest = np.array([np.hypot(*(others - p).T).min() for p in put[inside]])
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(descriptors, other_descriptors)
    right = sum(np.hypot(*(others[m.trainIdx] - put[m.queryIdx])) < RADIUS for m in matches)
    return {"keypoints": len(points), "cells": cells(points, width, height), "repeatability": float(np.mean(nearest < RADIUS)),
            "matches": len(matches), "right": float(right / len(matches)), "ms": 1e3 * spent}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--images", type=int, default=40)
    parser.add_argument("--features", type=int, default=1200)
    parser.add_argument("--json")
    parser.add_argument("--commit", default="")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    sequence = ft.read_sequence(arguments.folder)
    own = ft.OrbExtractor(sequence.width, sequence.height, features=arguments.features, device="host", threads=1)
    theirs = cv2.ORB_create(arguments.features, 1.2, 8, fastThreshold=20)

    def extract_theirs(image):
        points, descriptors = theirs.detectAndCompute(image, None)
        return np.array([p.pt for p in points]), descriptors

    extractors = {"ft.OrbExtractor": lambda image: own.extract(image).to_numpy(), "cv2.ORB": extract_theirs}
    random = np.random.default_rng(1)
    rows = {name: [] for name in extractors}
    step = max(1, len(sequence) // arguments.images)
    for i in range(0, len(sequence), step):
        image = sequence[i].left
        H = homography(random, sequence.width, sequence.height)
        other = changed(random, image, H)
        for name, extract in extractors.items():
            rows[name].append(compare(extract, image, other, H))
    result = {"command": f"bench/orb_beside_opencv.py FOLDER --images {arguments.images} --features {arguments.features}",
              "date": datetime.date.today().isoformat(), "commit": arguments.commit, "sequence": sequence.name,
              "opencv": cv2.__version__, "threads": 1,
              "rows": {name: {k: float(np.median([r[k] for r in all_rows])) for k in all_rows[0]}
                       for name, all_rows in rows.items()}}
    print(json.dumps(result, indent=1))
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            file.write(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
