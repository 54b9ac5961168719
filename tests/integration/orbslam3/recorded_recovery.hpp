// SPDX-License-Identifier: Apache-2.0
/// @file Recorded frames and keyframes of golden_words as frames and map points of the stand-in
/// types.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"
#include "tests/conformance/golden_words_input.hpp"
#include "tests/integration/orbslam3/constructors.hpp"
#include "tests/integration/orbslam3/plain_words.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/npy.hpp"

namespace orbslam3_test {

/// The folder golden_words, which may not be there.
inline std::string recorded_words() {
  char const* const data = std::getenv("FT_DATA");
  return std::string(data == nullptr ? "../shared" : data) + "/golden_words";
}

inline stand_in::se3 pose_from(test::npy<float> const& m, int row = 0) {
  Eigen::Matrix3f R;
  Eigen::Vector3f t;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { R(r, c) = m(row + r, c); }
    t(r) = m(row + r, 3);
  }
  return {R, t};
}

/// The cameras of recorded frames. @param set its folder
class recorded_cameras {
public:
  explicit recorded_cameras(std::string set) : set_(std::move(set)) {}

  bool two_cameras() const { return test::exists(set_ + "/camera2.npy"); }
  ft::orbslam3::settings settings() const {
    auto const bounds = floats("bounds");
    auto const scale = floats("scale");
    ft::orbslam3::settings s;
    s.width = static_cast<int>(std::ceil(bounds[1]));
    s.height = static_cast<int>(std::ceil(bounds[3]));
    s.levels = static_cast<int>(scale.size());
    s.scale_factor = scale[1];
    s.images = two_cameras() ? 2 : 1;
    s.left = camera("camera1");
    s.most_keypoints = 4000;
    if (two_cameras()) {
      s.right = camera("camera2");
      auto const T_rl = T_lr().inverse();
      for (int i = 0; i < 9; ++i) { s.T_rl.R.m[i] = T_rl.rotationMatrix()(i / 3, i % 3); }
      auto const t = T_rl.translation();
      s.T_rl.t = {t(0), t(1), t(2)};
    }
    if (test::exists(set_ + "/bf.npy") && s.left.kind == ft::orbslam3::lens::pinhole) {
      s.bf = floats("bf")[0];
    }
    return s;
  }
  /// What a constructor gives a frame of these cameras.
  void describe(stand_in::frame& f) const {
    auto const bounds = floats("bounds");
    f.mnMinX = bounds[0];
    f.mnMaxX = bounds[1];
    f.mnMinY = bounds[2];
    f.mnMaxY = bounds[3];
    f.mvLevelSigma2 = floats("sigma2");
    if (two_cameras()) { f.T_lr = T_lr(); }
  }

private:
  std::vector<float> floats(char const* name) const {
    return test::read_npy<float>(set_ + "/" + name + ".npy").data;
  }
  stand_in::se3 T_lr() const { return pose_from(test::read_npy<float>(set_ + "/Tlr.npy")); }
  ft::orbslam3::camera_parameters camera(char const* name) const {
    auto const values = floats(name);
    ft::orbslam3::camera_parameters c;
    c.kind = values.size() == 8 ? ft::orbslam3::lens::kannala_brandt : ft::orbslam3::lens::pinhole;
    std::copy(values.begin(), values.end(), c.values);
    return c;
  }

  std::string set_;
};

/// A recorded frame, number 0.
inline stand_in::frame recorded_view(std::string const& root, std::string const& name) {
  test::words_frame const from(root, name);
  stand_in::frame f;
  recorded_cameras(from.set).describe(f);
  f.N = from.size();
  f.Nleft = from.cameras == 2 ? from.left : -1;
  f.Nright = from.cameras == 2 ? from.size() - from.left : -1;
  f.monoLeft = f.monoRight = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(from.size()); ++i) {
    stand_in::keypoint k;
    k.pt.x = from.x[i];
    k.pt.y = from.y[i];
    k.angle = from.angle[i];
    k.octave = from.octave[i];
    (static_cast<int>(i) < from.left ? f.mvKeys : f.mvKeysRight).push_back(k);
  }
  f.mvKeysUn = f.mvKeys;
  f.mDescriptors.create(from.size(), 32, 0);
  std::memcpy(f.mDescriptors.data, from.orb.data(), 32 * from.orb.size());
  std::string const right = root + "/frames/" + name + "/uRight.npy";
  f.mvuRight.assign(f.mvKeys.size(), -1.0f);
  if (test::exists(right)) { f.mvuRight = test::read_npy<float>(right).data; }
  f.mvpMapPoints.assign(static_cast<std::size_t>(f.N), nullptr);
  f.mvbOutlier.assign(static_cast<std::size_t>(f.N), false);
  return f;
}

/// A recorded keyframe and its map points, whose numbers are their rows, from `first` on.
struct recorded_keyframe {
  stand_in::key_frame keyframe;
  std::vector<std::unique_ptr<stand_in::map_point>> map;
  unsigned long first;

  recorded_keyframe(std::string const& root, std::string const& folder, unsigned long first_id = 0)
      : first(first_id) {
    std::string const at = root + "/" + folder;
    test::words_keyframe const from(at);
    auto const points = from.map.view();
    for (int i = 0; i < *points.count; ++i) {
      auto p = std::make_unique<stand_in::map_point>();
      auto const P = points.position(i);
      p->mnId = first + static_cast<unsigned long>(i);
      p->SetWorldPos({P.x, P.y, P.z});
      p->set_view({0, 0, 1}, points.min_distance(i), points.max_distance(i));
      unsigned char bytes[32];
      std::memcpy(bytes, points.orb(i).words, sizeof bytes);
      p->set_descriptor(bytes);
      map.push_back(std::move(p));
    }
    keyframe = keyframe_of(recorded_view(root, from.frame));
    keyframe.points = points_of(from.holder);
  }
  std::vector<stand_in::map_point*> points_of(std::vector<std::int32_t> const& rows) const {
    std::vector<stand_in::map_point*> all;
    for (std::int32_t const row : rows) {
      all.push_back(row < 0 ? nullptr : map[static_cast<std::size_t>(row)].get());
    }
    return all;
  }
  std::vector<std::int32_t> rows_of(std::vector<stand_in::map_point*> const& points) const {
    std::vector<std::int32_t> all;
    for (auto const* p : points) {
      all.push_back(p == nullptr ? -1 : static_cast<std::int32_t>(p->mnId - first));
    }
    return all;
  }
};

}  // namespace orbslam3_test
