// SPDX-License-Identifier: Apache-2.0
/// @file The input of the shim's bench: settings, images, and a map whose points are scattered over
/// the heap, like ORB-SLAM3's.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace bench {

/// KITTI's raw images, 1392x512, with 2000 features.
inline ft::orbslam3::settings kitti() {
  ft::orbslam3::settings s;
  s.width = 1392;
  s.height = 512;
  s.features = 2000;
  s.left = {ft::orbslam3::lens::pinhole, {984.2f, 984.2f, 690.0f, 233.2f}};
  s.bf = 0.537f * 984.2f;
  return s;
}

/// Random boxes, all of them moved to the left by `shift` pixels.
inline stand_in::matrix picture(ft::orbslam3::settings const& s, int shift) {
  std::mt19937 random(1);
  stand_in::matrix m;
  m.create(s.height, s.width, 0);
  std::fill_n(m.data, s.width * s.height, static_cast<unsigned char>(90));
  auto const wide = static_cast<unsigned>(s.width);
  auto const high = static_cast<unsigned>(s.height);
  for (int box = 0; box < s.width * s.height / 400; ++box) {
    int const w = 4 + static_cast<int>(random() % 60);
    int const h = 4 + static_cast<int>(random() % 60);
    int const x0 = static_cast<int>(random() % wide) - shift;
    int const y0 = static_cast<int>(random() % high);
    auto const value = static_cast<unsigned char>(random());
    for (int y = y0; y < std::min(y0 + h, s.height); ++y) {
      for (int x = std::max(x0, 0); x < std::min(x0 + w, s.width); ++x) {
        m.data[y * s.width + x] = value;
      }
    }
  }
  return m;
}

/// Points that the first frame's keypoints see, and others around them, allocated between other
/// objects.
class scattered_map {
public:
  /// @param z depth of the points, metres
  scattered_map(stand_in::frame const& f, ft::orbslam3::settings const& s, int count, float z) {
    std::uniform_real_distribution<float> wide(-2, 2);
    for (int i = 0; i < count; ++i) {
      auto const k = static_cast<std::size_t>(i);
      bool const seen = k < f.mvKeys.size();
      Eigen::Vector3f const P =
          seen ? Eigen::Vector3f((f.mvKeys[k].pt.x - s.left.values[2]) / s.left.values[0] * z,
                                 (f.mvKeys[k].pt.y - s.left.values[3]) / s.left.values[1] * z, z)
               : Eigen::Vector3f(wide(random_) * z, wide(random_) * z, z);
      std::vector<unsigned char> bits(32);
      for (auto& b : bits) { b = static_cast<unsigned char>(random_()); }
      local.push_back(add(P, seen ? f.mDescriptors.data + 32 * k : bits.data()));
    }
    std::shuffle(local.begin(), local.end(), random_);
  }

  stand_in::map_point* operator[](std::size_t i) const { return points_[i].get(); }
  std::size_t size() const { return points_.size(); }

  /// A new point; its changes are pushed to `hooks` from the beginning.
  stand_in::map_point* add(Eigen::Vector3f const& P, unsigned char const* descriptor,
                           stand_in::hooks* hooks = nullptr) {
    filler_.push_back(std::make_unique<unsigned char[]>(200 + random_() % 1500));
    auto p = std::make_unique<stand_in::map_point>();
    p->observer = hooks;
    p->mnId = static_cast<unsigned long>(points_.size());
    p->SetWorldPos(P);
    p->set_view(P.normalized(), P.norm() * 0.3f, P.norm() * 2);
    p->set_descriptor(descriptor);
    p->set_observations(3);
    points_.push_back(std::move(p));
    return points_.back().get();
  }

  std::vector<stand_in::map_point*> local;

private:
  std::mt19937 random_{2};
  std::vector<std::unique_ptr<unsigned char[]>> filler_;
  std::vector<std::unique_ptr<stand_in::map_point>> points_;
};

}  // namespace bench
