// SPDX-License-Identifier: Apache-2.0
/// @file What a unit with FT_DESCRIPTOR does, whatever that is.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <exception>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/rgbd_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/execution.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/own_descriptor/units.hpp"

namespace own_descriptor_test {
namespace {

#if defined(__CUDACC__)
struct place {
  ft::stream stream;
  ft::cuda_exec exec() const { return ft::cuda_exec(stream.get()); }
};
#else
struct place {
  ft::host_exec exec() const { return ft::host_exec(); }
};
#endif

using orb_bytes = unsigned char[32];

/// @param own_of a descriptor from ORB's
template <typename Rig, typename OwnOf>
class follower {
  using exec_type = decltype(place().exec());
  using odometry_type = ft::odometry<exec_type, Rig>;

public:
  follower(given_walk const& given, Rig const& rig, OwnOf own_of)
      : given_(given), rig_(rig), own_of_(std::move(own_of)), exec_(place_.exec()) {}

  answers all(std::string const& orb_map) {
    answers a;
    odometry_type odo = made();
    std::size_t const half = given_.frames.size() / 2;
    for (std::size_t i = 0; i < given_.frames.size(); ++i) {
      if (i == half) {
        std::ostringstream to;
        odo.save_map(to);
        a.map = to.str();
      }
      a.frames.push_back(track(odo, i));
    }
    odometry_type other = made();
    std::istringstream from(a.map);
    other.load_map(from);
    for (std::size_t i = half; i < given_.frames.size(); ++i) {
      a.loaded.push_back(track(other, i));
    }
    refuse(a, other, orb_map);
    return a;
  }

private:
  odometry_type made() { return odometry_type(exec_, rig_, given_.params, 1, ft::own_features{}); }
  ft::tracking track(odometry_type& odo, std::size_t i) {
    ft::given_features f = given_.frames[i];
    std::vector<ft::descriptor> rows[2];
    take(f.left, rows[0]);
    take(f.right, rows[1]);
    return odo.track(f, 50'000'000 * static_cast<std::int64_t>(i + 1));
  }
  void take(ft::image_features& f, std::vector<ft::descriptor>& rows) const {
    for (int i = 0; i < f.count; ++i) {
      orb_bytes from;
      std::memcpy(from, static_cast<unsigned char const*>(f.descriptors) + 32 * i, sizeof from);
      rows.push_back(own_of_(from));
    }
    f.descriptors = rows.data();
    f.descriptor_bytes = static_cast<int>(sizeof(ft::descriptor));
  }
  template <typename Call>
  static std::string text_of(Call const& call) {
    try {
      call();
    } catch (std::exception const& e) { return e.what(); }
    return "";
  }
  void refuse(answers& a, odometry_type& odo, std::string const& orb_map) {
    a.of_images = text_of([&] {
      typename odometry_type::images_type const none{};
      odo.track(none, 1'000'000'000'000);
    });
    a.of_prefetch = text_of([&] {
      auto p = given_.params;
      p.prefetch = 1;
      odometry_type(exec_, rig_, p, 1, ft::own_features{});
    });
    a.of_places = text_of(
        [&] { odometry_type(exec_, rig_, given_.params, 1, ft::places{}, ft::own_features{}); });
    a.of_bytes = text_of([&] {
      ft::given_features f = given_.frames[0];
      f.left.descriptor_bytes = 31;
      odo.track(f, 1'000'000'000'000);
    });
    a.of_other_map = text_of([&] {
      std::istringstream from(orb_map);
      odo.load_map(from);
    });
  }

  given_walk const& given_;
  Rig rig_;
  OwnOf own_of_;
  place place_;
  exec_type exec_;
};

template <typename Rig, typename OwnOf>
answers follow(given_walk const& given, Rig const& rig, std::string const& orb_map,
               OwnOf const& own_of) {
  return follower<Rig, OwnOf>(given, rig, own_of).all(orb_map);
}

inline ft::pinhole<float> camera_of(given_walk const& g) { return {g.fx, g.fx, g.cx, g.cy}; }
inline ft::rectified_rig pair_of(given_walk const& g) {
  return ft::rectified_rig::make(camera_of(g), g.baseline);
}

}  // namespace
}  // namespace own_descriptor_test
