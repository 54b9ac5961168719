// SPDX-License-Identifier: Apache-2.0
/// @file Choice of the stages that the shim runs, made in code and changed by the environment.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdlib>
#include <string>

#include "ft/core/error.hpp"

namespace ft::orbslam3 {

/// How changes of map points are found.
enum class change_detection {
  compare,  ///< every point of a call is read and compared with the values sent
  hooks,    ///< only points pushed into the change_queue are read
};

enum class stage {
  extract,
  stereo,
  search_last_frame,
  pose_last_frame,
  search_local_map,
  pose_local_map,
  pose_keyframe,  ///< of the reference keyframe, and in relocalisation
  pose_inertial_last_frame,
  pose_inertial_last_keyframe,
  search_keyframe,
  transform,
  search_by_bow,
};
inline constexpr int stage_count = 12;

inline char const* name_of(stage s) {
  constexpr char const* names[stage_count] = {"extract",
                                              "stereo",
                                              "search_last_frame",
                                              "pose_last_frame",
                                              "search_local_map",
                                              "pose_local_map",
                                              "pose_keyframe",
                                              "pose_inertial_last_frame",
                                              "pose_inertial_last_keyframe",
                                              "search_keyframe",
                                              "transform",
                                              "search_by_bow"};
  return names[static_cast<int>(s)];
}

/// Whether a stage reads map points on the device.
inline bool reads_map(stage s) { return s >= stage::search_last_frame && s < stage::transform; }

/// Whether a stage computes a pose. ft's are not the CPU's to the bit.
inline bool gives_pose(stage s) {
  return s == stage::pose_last_frame ||
         (s >= stage::pose_local_map && s <= stage::pose_inertial_last_keyframe);
}

enum class stage_mode {
  device,  ///< run by the accelerator
  host,    ///< run by ORB-SLAM3's own code: the call sites check accelerator::uses()
  bypass,  ///< pose optimisation only: keeps the pose, no outliers
};

struct options {
  change_detection detection = change_detection::compare;
  bool verify = false;  ///< for the call sites: run both and compare, see verify.hpp
  /// Whether the search of a local map fills Frame::mmProjectPoints, which only a viewer draws.
  bool fills_projected_points = true;
  std::array<stage_mode, stage_count> modes{};  ///< by stage; all on the device
  /// File of the vocabulary for `transform`, which front_end loads: the one that the system reads,
  /// DBoW2's text, or its words in ft's binary form. Empty: ORB-SLAM3's own code transforms.
  std::string vocabulary;

  stage_mode& operator[](stage s) { return modes[static_cast<std::size_t>(s)]; }
  stage_mode operator[](stage s) const { return modes[static_cast<std::size_t>(s)]; }
};

/// Whether a stage may be bypassed: a pose optimisation that is followed by another one, or after
/// which tracking can continue with the current pose.
inline bool may_bypass(stage s) {
  return s == stage::pose_last_frame || s == stage::pose_local_map;
}

/// Sets the mode of the stages in a list such as "extract,stereo"; "all" means all stages that can
/// have it, "poses" those of them that give a pose, "none" no stage.
/// @throws bad_argument for an unknown name, or a stage that cannot be bypassed
inline void set_modes(options& o, std::string const& list, stage_mode mode) {
  for (std::size_t begin = 0; begin < list.size();) {
    std::size_t const end = std::min(list.find(',', begin), list.size());
    std::string const name = list.substr(begin, end - begin);
    bool known = name == "all" || name == "poses" || name == "none";
    for (int i = 0; i < stage_count; ++i) {
      auto const s = static_cast<stage>(i);
      bool const possible = mode != stage_mode::bypass || may_bypass(s);
      if (name == name_of(s)) {
        detail::require(possible, "only pose_last_frame and pose_local_map can be bypassed");
        known = true;
      }
      bool const meant = name == "all" || (name == "poses" && gives_pose(s)) || name == name_of(s);
      if (possible && meant) { o[s] = mode; }
    }
    if (!known) {
      std::string names;
      for (int i = 0; i < stage_count; ++i) {
        names += name_of(static_cast<stage>(i)) + std::string(", ");
      }
      throw bad_argument("ft: '" + name + "' is no stage; there are: " + names +
                         "all, poses, none");
    }
    begin = end + 1;
  }
}

/// `o` with the changes of the environment: FT_ORBSLAM3_HOST and FT_ORBSLAM3_BYPASS are lists of
/// stages, the first of which replaces what `o` leaves to the CPU; FT_ORBSLAM3_VERIFY is 0 or 1;
/// FT_ORBSLAM3_PROJECTED_POINTS=0 leaves mmProjectPoints empty; FT_ORBSLAM3_COMPARE=1 finds changes
/// of map points by comparing.
/// @throws bad_argument as set_modes()
inline options from_environment(options o = {}) {
  auto const text = [](char const* name) {
    char const* const value = std::getenv(name);
    return std::string(value == nullptr ? "" : value);
  };
  auto const flag = [&](char const* name, bool& value) {
    if (!text(name).empty()) { value = text(name) != "0"; }
  };
  if (!text("FT_ORBSLAM3_HOST").empty()) {
    std::replace(o.modes.begin(), o.modes.end(), stage_mode::host, stage_mode::device);
    set_modes(o, text("FT_ORBSLAM3_HOST"), stage_mode::host);
  }
  set_modes(o, text("FT_ORBSLAM3_BYPASS"), stage_mode::bypass);
  flag("FT_ORBSLAM3_VERIFY", o.verify);
  flag("FT_ORBSLAM3_PROJECTED_POINTS", o.fills_projected_points);
  bool compare = false;
  flag("FT_ORBSLAM3_COMPARE", compare);
  if (compare) { o.detection = change_detection::compare; }
  return o;
}

}  // namespace ft::orbslam3
