// SPDX-License-Identifier: Apache-2.0
/// @file Keypoints of a walk through the room in memory of the caller.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "ft/types/features.hpp"
#include "ft/types/orb_params.hpp"
#include "tests/support/room.hpp"

namespace test::room {

/// Keypoints in memory of the caller.
struct features {
  std::vector<float> positions, angle, score, right_x, depth;
  std::vector<int> octave;
  std::vector<ft::descriptor> descriptors;

  ft::image_features view() const {
    ft::image_features f;
    f.count = static_cast<int>(octave.size());
    f.positions = positions.data();
    f.descriptors = descriptors.data();
    f.octave = octave.data();
    f.angle = angle.data();
    f.score = score.data();
    f.level_positions = true;
    return f;
  }
  ft::image_features with_partners() const {
    ft::image_features f = view();
    f.right_x = right_x.data();
    f.depth = depth.data();
    return f;
  }
};
inline features copy_of(ft::keypoints_view const& kp) {
  features f;
  for (int i = 0; i < *kp.count; ++i) {
    f.positions.insert(f.positions.end(), {kp.x(i), kp.y(i)});
    f.angle.push_back(kp.angle(i));
    f.score.push_back(kp.response(i));
    f.octave.push_back(kp.octave(i));
    f.descriptors.push_back(kp.orb(i));
  }
  return f;
}

struct pair_features {
  features left, right;

  ft::given_features with_partners() const { return {left.with_partners(), {}}; }
  ft::given_features without_partners() const { return {left.view(), right.view()}; }
};

/// What an odometry extracts of a walk, with positions between pixels.
template <typename Exec>
std::vector<pair_features> extract(Exec const& exec, ft::rectified_rig const& rig,
                                   ft::orb_params orb, std::vector<stereo_frame> const& frames) {
  orb.exact_positions = orb.refine_positions = true;
  orb.corner_ratio = ft::odometry_corner_ratio;
  ft::orb_extractor<Exec> extractor(exec, orb, 2);
  ft::stereo_matcher<Exec> matcher(rig, extractor, ft::column_rule::least_squares);
  std::vector<pair_features> all;
  for (auto const& f : frames) {
    extractor.upload(exec, 0, view(f.left));
    extractor.upload(exec, 1, view(f.right));
    extractor.extract(exec);
    matcher.match(exec, extractor);
    auto const keypoints = extractor.download(exec);
    auto const matches = ft::download(exec, matcher.matches());
    pair_features p{copy_of(keypoints.view().slice(0)), copy_of(keypoints.view().slice(1))};
    auto const n = static_cast<std::ptrdiff_t>(p.left.octave.size());
    float const* const right_x = ft::array_of<ft::field::right_x>(matches.view());
    float const* const depth = ft::array_of<ft::field::depth>(matches.view());
    p.left.right_x.assign(right_x, right_x + n);
    p.left.depth.assign(depth, depth + n);
    all.push_back(std::move(p));
  }
  return all;
}

}  // namespace test::room
