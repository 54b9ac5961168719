// SPDX-License-Identifier: Apache-2.0
/// @file Poses of a graph by chaining measured motions.
#pragma once

#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

#include "ft/containers/pose_graph.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Each pose from one that is known: over the edge to the pose before or after it where there is
/// one, and over other edges only from where no such edge leads on.
/// @param position of each pose in the system; -1: it stays
template <typename Motion>
std::vector<Motion> chained_poses(motion_graph<Motion> const& graph,
                                  std::vector<int> const& position) {
  std::size_t const poses = graph.T_world_pose.size();
  std::vector<Motion> T = graph.T_world_pose;
  std::vector<std::vector<int>> edges_of(poses);
  for (std::size_t e = 0; e < graph.edges.size(); ++e) {
    edges_of[static_cast<std::size_t>(graph.edges[e].from)].push_back(static_cast<int>(e));
    edges_of[static_cast<std::size_t>(graph.edges[e].to)].push_back(static_cast<int>(e));
  }
  std::vector<char> known(poses, 0);
  std::vector<int> chain;  // poses whose neighbours along the chain are looked at next
  std::vector<std::pair<int, int>> others;  // pose and edge; first in, first out
  std::size_t next_other = 0;
  auto const learn = [&](int pose) {
    known[static_cast<std::size_t>(pose)] = 1;
    chain.push_back(pose);
  };
  auto const follow = [&](int pose, int edge) {
    motion_edge<Motion> const& e = graph.edges[static_cast<std::size_t>(edge)];
    int const to = e.from == pose ? e.to : e.from;
    if (known[static_cast<std::size_t>(to)] != 0) { return; }
    auto const Z = e.T_from_to.template cast<strict_double>();
    auto const here = T[static_cast<std::size_t>(pose)].template cast<strict_double>();
    T[static_cast<std::size_t>(to)] =
        (here * (e.from == pose ? Z : Z.inverse())).orthonormalized().template cast<double>();
    learn(to);
  };
  for (std::size_t i = 0; i < poses; ++i) {
    if (position[i] < 0) { learn(static_cast<int>(i)); }
  }
  std::reverse(chain.begin(), chain.end());
  while (!chain.empty() || next_other < others.size()) {
    if (chain.empty()) {
      auto const other = others[next_other++];
      follow(other.first, other.second);
      continue;
    }
    int const pose = chain.back();
    chain.pop_back();
    for (int const e : edges_of[static_cast<std::size_t>(pose)]) {
      motion_edge<Motion> const& edge = graph.edges[static_cast<std::size_t>(e)];
      int const apart = edge.to - edge.from;
      if (apart == 1 || apart == -1) {
        follow(pose, e);
      } else {
        others.push_back({pose, e});
      }
    }
  }
  return T;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
