// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/reader.hpp"

namespace seq {
namespace {

constexpr double least_cosine = 0.70710678118654752;  // of 45 degrees

/// Whether a camera of a mixed rig may have it.
bool is_known(lens model) {
  return model != lens::unified && model != lens::extended_unified && model != lens::field_of_view;
}

}  // namespace

std::vector<rig_camera> rig_cameras(stereo_rig const& rig) {
  std::vector<rig_camera> all = {{{rig.left, Eigen::Isometry3d::Identity()}},
                                 {{rig.right, rig.T_left_right}}};
  for (mounted_camera const& camera : rig.more) { all.push_back({camera}); }
  std::vector<bool> taken(all.size());
  for (int const k : rig.depth_cameras) {
    taken[static_cast<std::size_t>(k)] = all[static_cast<std::size_t>(k)].has_depth = true;
  }
  for (std::size_t i = 0; i < all.size(); ++i) {
    for (std::size_t k = i + 1; k < all.size() && !taken[i]; ++k) {
      Eigen::Isometry3d const T = all[i].T_left_this.inverse() * all[k].T_left_this;
      bool const pair =
          T.linear()(2, 2) >= least_cosine && T.translation().norm() >= detail::min_baseline;
      if (taken[k] || !pair) { continue; }
      all[i].right = static_cast<int>(k);
      taken[i] = taken[k] = true;
    }
  }
  return all;
}

namespace detail {

bool added_camera(stereo_rig& rig, int k, std::string const& source,
                  std::function<void()> const& add, std::vector<std::string>& warnings) {
  std::size_t const before = rig.more.size();
  try {
    add();
    check_camera(rig.more.back().camera, "cam" + std::to_string(k), source);
    return true;
  } catch (error const& e) {
    rig.more.resize(before);
    warnings.push_back("cam" + std::to_string(k) +
                       " and those after it are not taken: " + e.what());
    return false;
  }
}

void check_mixed(stereo_rig const& rig, std::string const& source) {
  std::vector<rig_camera> const all = rig_cameras(rig);
  constexpr std::size_t most = 16;
  if (all.size() > most) {
    throw error(source + ": " + std::to_string(all.size()) + " cameras, at most " +
                std::to_string(most) + " allowed");
  }
  for (std::size_t k = 0; k < all.size(); ++k) {
    camera_intrinsics const& c = all[k].camera;
    std::string const name = "cam" + std::to_string(k);
    if (!is_known(c.model)) {
      throw error(
          source + ": " + name +
          " has a unified lens (omni, eucm) or fov, which no rig of several cameras has: must be "
          "pinhole with radtan, equidistant or none, or ds; --rig auto takes the first pair alone");
    }
    if (c.width != rig.left.width || c.height != rig.left.height) {
      throw error(source + ": " + name + " is " + size_text(c.width, c.height) + " pixels, cam0 " +
                  size_text(rig.left.width, rig.left.height) +
                  ": all cameras of a rig must have one size");
    }
  }
  if (std::none_of(all.begin(), all.end(),
                   [](rig_camera const& c) { return c.right >= 0 || c.has_depth; })) {
    throw error(source + ": no two of the " + std::to_string(all.size()) +
                " cameras look the same way within 45 degrees, and none has depth images (depth0, "
                "depth1 ... beside cam0, cam1 ...): no depths");
  }
}

}  // namespace detail
}  // namespace seq
