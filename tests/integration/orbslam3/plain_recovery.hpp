// SPDX-License-Identifier: Apache-2.0
/// @file Relocalisation's search for a keyframe's points as plain loops over the stand-in types,
/// written from the specification.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <set>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

using point_set = std::set<stand_in::map_point*>;

class plain_keyframe_search : plain_search {
public:
  explicit plain_keyframe_search(ft::orbslam3::settings const& s)
      : plain_search(s), camera_(s.left), levels_(s.levels), factor_(s.scale_factor) {}

  int run(stand_in::frame& f, stand_in::key_frame const& keyframe, point_set const& found, float th,
          int farthest) const {
    cells const left(f, keys(f, 0));
    Eigen::Vector3f const centre = -(R(f).transpose() * t(f));
    std::vector<rotated> taken;
    for (std::size_t i = 0; i < keyframe.points.size(); ++i) {
      auto* const p = keyframe.points[i];
      if (p == nullptr || p->isBad() || found.count(p) != 0) { continue; }
      Eigen::Vector3f const P = p->GetWorldPos();
      Eigen::Vector2f const uv = project(camera_, R(f) * P + t(f));
      float const distance = (P - centre).norm();
      if (!inside(f, uv) || !(distance >= p->GetMinDistanceInvariance()) ||
          distance > p->GetMaxDistanceInvariance()) {
        continue;
      }
      int const level =
          std::clamp(static_cast<int>(
                         std::ceil(std::log(p->raw_max_distance() / distance) / std::log(factor_))),
                     0, levels_ - 1);
      auto const wanted = p->GetDescriptor();
      int best = 256;
      std::size_t best_k = 0;
      for (auto const k : left.area(uv.x(), uv.y(), th * scale(level), level - 1, level + 1)) {
        int const d = hamming(wanted.data, descriptor(f, 0, k));
        if (f.mvpMapPoints[k] != nullptr || d >= best) { continue; }
        best = d;
        best_k = k;
      }
      if (best > farthest) { continue; }
      f.mvpMapPoints[best_k] = p;
      float turn = angle_of(keyframe, i) - keys(f, 0)[best_k].angle;
      if (turn < 0) { turn += 360.0f; }
      int const bin = static_cast<int>(std::round(turn * (1.0f / 30.0f)));
      taken.push_back({best_k, bin == 30 ? 0 : bin});
    }
    return static_cast<int>(taken.size()) - drop_rotated(f, taken);
  }

private:
  static float angle_of(stand_in::key_frame const& k, std::size_t i) {
    if (k.NLeft < 0) { return k.mvKeysUn[i].angle; }
    auto const n = static_cast<std::size_t>(k.NLeft);
    return i < n ? k.mvKeys[i].angle : k.mvKeysRight[i - n].angle;
  }

  ft::orbslam3::camera_parameters camera_;
  int levels_;
  float factor_;
};

}  // namespace orbslam3_test
