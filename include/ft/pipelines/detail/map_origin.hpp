// SPDX-License-Identifier: Apache-2.0
/// @file What the numbers of a saved map mean: the rig, the images and the settings that it was
/// made with, as text.
#pragma once

#include <cstddef>
#include <cstring>
#include <string>
#include <string_view>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/types/orb_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Lines "name: value". Numbers have as many digits as tell them apart, so equal text is equal
/// numbers.
class map_origin {
public:
  template <typename Rig>
  map_origin(Rig const& rig, orb_params const& orb, odometry_map_view const& map) {
    add_rig(rig);
    add("image size", std::to_string(orb.width) + " x " + std::to_string(orb.height) + " pixels");
    add("levels of the pyramid", orb.levels);
    add("scale factor", orb.scale_factor);
    add("map_slots", map.records.slots);
    add("keyframes", map.keyframes.positions);
    add("searched cameras", map.keyframes.cameras);
    add("keypoints of an image", map.keyframes.capacity);
    if (!describes_images) {
      add("descriptor", std::string(descriptor::name) + " of " +
                            std::to_string(sizeof(descriptor)) + " bytes, near " +
                            std::to_string(descriptor::rules.near) + " of " +
                            std::to_string(descriptor::rules.greatest));
    }
  }

  std::string const& text() const { return text_; }

  /// @throws error naming the first line in which a map's origin differs
  void require_same(std::string_view other) const {
    std::string_view ours = text_;
    while (!ours.empty() || !other.empty()) {
      line const mine = next(ours);
      line const theirs = next(other);
      if (mine.name == theirs.name && mine.value == theirs.value) { continue; }
      if (mine.name != theirs.name) {
        throw error(
            "ft: the map was made with another kind of rig, or its file is damaged: it has "
            "'" +
            printable(theirs.name) + "' where this odometry has '" + std::string(mine.name) + "'");
      }
      throw error("ft: the map was made with " + std::string(mine.name) + " " +
                  printable(theirs.value) + ", this odometry has " + std::string(mine.value));
    }
  }

private:
  struct line {
    std::string_view name, value;
  };
  /// What a stranger's file says, for a message on a terminal.
  static std::string printable(std::string_view text) {
    std::string shown(text.substr(0, 80));
    for (char& c : shown) {
      if (c < ' ' || c > '~') { c = '?'; }
    }
    return shown;
  }
  /// Takes the first line off.
  static line next(std::string_view& text) {
    std::string_view const all = text.substr(0, text.find('\n'));
    text.remove_prefix(all.size() < text.size() ? all.size() + 1 : all.size());
    std::size_t const colon = all.find(": ");
    if (colon == std::string_view::npos) { return {all, {}}; }
    return {all.substr(0, colon), all.substr(colon + 2)};
  }

  void add(std::string const& name, std::string const& value) {
    text_ += name + ": " + value + "\n";
  }
  template <typename Number>
  void add(std::string const& name, Number value, char const* unit = "") {
    add(name, number_text(value) + unit);
  }
  template <typename Number, std::size_t Count>
  void add_numbers(std::string const& name, Number const (&values)[Count]) {
    std::string all;
    for (Number const v : values) { all += (all.empty() ? "" : " ") + number_text(v); }
    add(name, all);
  }

  /// @param of "left " or the like
  template <typename Camera>
  void add_camera(std::string const& of, Camera const& camera) {
    add(of + "camera", std::string(Camera::name));
    typename Camera::scalar_type values[num_params_v<Camera>];
    static_assert(sizeof values == sizeof camera, "a camera model holds its parameters");
    std::memcpy(values, &camera, sizeof values);
    for (int i = 0; i < num_params_v<Camera>; ++i) {
      add(of + Camera::parameters.of[i].name, to_plain(values[i]));
    }
  }
  void add_pose(std::string const& name, pose const& T) {
    add_numbers("rotation of " + name, T.R.m);
    float const t[3] = {T.t.x, T.t.y, T.t.z};
    add_numbers("translation of " + name, t);
  }
  /// @param baseline one that was a float is written with a float's digits
  void add_baseline(std::string const& of, double baseline) {
    auto const narrow = static_cast<float>(baseline);
    bool const fits = !(static_cast<double>(narrow) != baseline);
    add(of + "baseline", (fits ? number_text(narrow) : number_text(baseline)) + " m");
  }

  void add_rig(rectified_rig const& rig) {
    add("rig", std::string("rectified pair"));
    add_camera("", rig.camera);
    add_baseline("", rig.baseline);
  }
  template <typename Left, typename Right>
  void add_rig(stereo_rig<Left, Right> const& rig) {
    add("rig", std::string("two cameras"));
    add_camera("left ", rig.left);
    add_camera("right ", rig.right);
    add_baseline("", static_cast<double>(rig.baseline_length().value));
    add_pose("T_rl", rig.T_rl);
  }
  template <typename Left, typename Right>
  void add_rig(distorted_pair<Left, Right> const& rig) {
    add("rig", std::string("distorted pair"));
    add_camera("left ", rig.left);
    add_camera("right ", rig.right);
    add_camera("rectified ", rig.target.camera);
    add_baseline("", rig.target.baseline);
    add_numbers("R_left", rig.R_left.m);
    add_numbers("R_right", rig.R_right.m);
    add("raw image size", std::to_string(rig.width) + " x " + std::to_string(rig.height));
  }
  template <typename Camera>
  void add_rig(rgbd_rig<Camera> const& rig) {
    add("rig", std::string("camera with depth images"));
    add_camera("", rig.camera);
    add_baseline("", rig.baseline);
    add("depth scale", rig.depth_scale);
  }
  template <typename Camera>
  void add_rig(monocular_rig<Camera> const& rig) {
    add("rig", std::string("one camera"));
    add_camera("", rig.camera);
  }
  template <int N, typename Camera>
  void add_rig(multi_rig<N, Camera> const& rig) {
    add("rig", std::to_string(N) + " cameras");
    for (int c = 0; c < N; ++c) {
      std::string const of = "camera " + std::to_string(c) + "'s ";
      Camera const& camera = rig.pair(c);
      add(of + "use", std::string(camera.used ? "used" : "none"));
      add_camera(of, camera.camera);
      add_baseline(of, camera.baseline);
      add_pose(of + "T_cb", camera.T_cb);
      if constexpr (is_mixed_v<multi_rig<N, Camera>>) {
        add(of + "right camera", std::to_string(camera.right));
        add(of + "depth image", std::string(camera.has_depth_image ? "yes" : "none"));
        add(of + "depth scale", camera.depth_scale);
      }
    }
  }

  std::string text_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
