// SPDX-License-Identifier: Apache-2.0
/// @file Settings of the extraction of ORB keypoints.
#pragma once

#include "ft/core/config.hpp"

namespace ft {
inline namespace v0 {

/// The node that is split first of two with the same number of points and the same left edge, in
/// the rounds that split node by node. Source: specification section 3.
enum class tie_rule {
  stable,   ///< the one that was created last
  std_sort  ///< as libstdc++'s std::sort orders them, whatever library the program uses
};

struct orb_params {
  int width = 0;  ///< of every image, pixels
  int height = 0;
  int features = 1200;  ///< wanted per image; the result may have a few more, and with corner_ratio
                        ///< fewer
  /// Wanted of images in which a map of one camera may begin; at least `features`, or 0 = as many.
  /// In an odometry of one camera 0 is five times `features`, as in ORB-SLAM3; in others it is 0.
  int start_features = 0;
  int levels = 8;
  float scale_factor = 1.2f;
  int ini_threshold = 20;  ///< corner threshold, grey levels
  int min_threshold = 7;   ///< used in cells that stay empty at ini_threshold; not above it
  /// Least ratio of the eigenvalues of a corner's structure tensor, [0, 1]: corners of a smaller
  /// one lie on an edge, or beside a stronger one, and are left out; see drop_edges(). 0 = all are
  /// kept, as in ORB-SLAM3; but in an odometry that has depths 0 is odometry_corner_ratio.
  float corner_ratio = 0;
  /// Size of masks, pixels, up to 16384 a side. A mask is stretched over its image. 0 = no masks
  int mask_width = 0;
  int mask_height = 0;
  /// Poses and map points take keypoints where they are in the image, and not where ORB-SLAM3 takes
  /// them to be; see pyramid_geometry::exact. The keypoints themselves are the same. An odometry
  /// does so with false, too.
  bool exact_positions = false;
  /// Keypoints lie between pixels, as refine_positions() places them: not those of ORB-SLAM3. An
  /// odometry of camera pairs does so with false, too; one of other rigs refuses true.
  bool refine_positions = false;
  tie_rule ties =
      tie_rule::stable;  ///< std_sort: keypoints as ORB-SLAM3 with libstdc++ orders them
};

/// The orb_params::corner_ratio of an odometry, if none is given: along its edge a corner is at
/// most four times as uncertain as across it.
inline constexpr float odometry_corner_ratio = 1.0f / 16;

/// Pixel columns that both cameras of a fisheye pair see. Keypoints inside go to the end of the
/// list. The default contains no keypoint.
struct stereo_overlap {
  float left = 0;
  float right = 0;

  /// Whether no keypoint of an image this wide is inside. Their columns lie strictly between 0 and
  /// the width.
  FT_HOST_DEVICE FT_INLINE bool has_none(int width) const {
    return right <= 0 || left >= static_cast<float>(width);
  }
  /// Whether every keypoint of an image this wide is inside.
  FT_HOST_DEVICE FT_INLINE bool has_all(int width) const {
    return left <= 0 && right >= static_cast<float>(width);
  }
};

}  // namespace v0
}  // namespace ft
