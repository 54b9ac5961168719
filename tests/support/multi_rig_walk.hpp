// SPDX-License-Identifier: Apache-2.0
/// @file Rigs of several cameras in the rendered room of room.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/cameras/multi_rig.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/room.hpp"

namespace test {
namespace rigs {

using room::image;

/// Body to a camera that is turned by `yaw` about the body's y axis and lies at `centre`.
inline ft::pose turned(float yaw, ft::vec3<float> centre) {
  float const c = std::cos(yaw);
  float const s = std::sin(yaw);
  ft::pose const T_bc{{{c, 0, s, 0, 1, 0, -s, 0, c}}, centre};
  return T_bc.inverse();
}

inline ft::rig_camera pair_at(ft::pose const& T_cb) {
  auto const pair = room::rig();
  return {pair.camera, pair.baseline, T_cb};
}
inline ft::rig_camera single_at(ft::pose const& T_cb) { return {room::rig().camera, 0, T_cb}; }

/// A pair that looks ahead and one that looks to the right, both away from the body's origin.
inline ft::multi_rig<2> two_pairs() {
  return {{pair_at(turned(0.1f, {0.1f, 0.02f, 0.2f})), pair_at(turned(1.4f, {0.3f, 0, -0.1f}))}};
}

/// Images of a rig at poses of its body.
struct rig_frame {
  std::vector<image> images;  ///< as a tracker numbers them; empty = there is none
  ft::pose T_cw;              ///< true, of the body
};

template <int N>
std::vector<rig_frame> make_walk(ft::multi_rig<N> const& rig, unsigned seed,
                                 std::vector<ft::pose> const& bodies) {
  auto const walls = room::make_walls(seed);
  std::vector<rig_frame> walk;
  for (ft::pose const& T_bw : bodies) {
    rig_frame f{{}, T_bw};
    for (ft::rig_camera const& c : rig.of) {
      ft::pose const T_cw = c.T_cb * T_bw;
      f.images.push_back(room::render(c.camera, walls, T_cw));
      ft::pose T_rw = T_cw;
      T_rw.t.x -= static_cast<float>(c.baseline);
      f.images.push_back(c.single() ? image{} : room::render(c.camera, walls, T_rw));
    }
    walk.push_back(f);
  }
  return walk;
}
/// Ahead and aside, turning a little.
template <int N>
std::vector<rig_frame> make_walk(ft::multi_rig<N> const& rig, unsigned seed, int frames) {
  std::vector<ft::pose> bodies;
  float const turn = seed % 2 == 0 ? 1.0f : -1.0f;
  for (int i = 0; i < frames; ++i) {
    auto const step = static_cast<float>(i);
    bodies.push_back(
        turned(turn * 0.012f * step, {turn * 0.02f * step, -0.01f * step, 0.05f * step}));
  }
  return make_walk(rig, seed, bodies);
}

/// The walk with every second image black from frame 1 on: those of pair c.
inline std::vector<rig_frame> blackened(std::vector<rig_frame> walk, std::size_t c) {
  for (std::size_t f = 1; f < walk.size(); ++f) {
    std::fill(walk[f].images[2 * c].begin(), walk[f].images[2 * c].end(), std::uint8_t{0});
    std::fill(walk[f].images[2 * c + 1].begin(), walk[f].images[2 * c + 1].end(), std::uint8_t{0});
  }
  return walk;
}
}  // namespace rigs
}  // namespace test
