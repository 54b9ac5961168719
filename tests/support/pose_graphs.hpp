// SPDX-License-Identifier: Apache-2.0
/// @file Random pose graphs.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "ft/containers/pose_graph.hpp"
#include "ft/types/poses.hpp"

namespace test {

/// A rotation by |w| about w.
inline ft::mat3<double> turned_by(ft::vec3<double> w) {
  double const angle = std::sqrt(ft::dot(w, w));
  double const a = angle > 1e-12 ? std::sin(angle) / angle : 1;
  double const b = angle > 1e-12 ? (1 - std::cos(angle)) / (angle * angle) : 0.5;
  ft::mat3<double> const W{{0, -w.z, w.y, w.z, 0, -w.x, -w.y, w.x, 0}};
  ft::mat3<double> R = W * W;
  for (int k = 0; k < 9; ++k) { R.m[k] = (k % 4 == 0 ? 1 : 0) + a * W.m[k] + b * R.m[k]; }
  return R;
}

struct random_motions {
  std::mt19937 random;
  explicit random_motions(unsigned seed) : random(seed) {}

  double number() { return std::normal_distribution<double>()(random); }
  ft::vec3<double> vector(double size) {
    return {size * number(), size * number(), size * number()};
  }
  ft::rigid<double> operator()(double angle, double length) {
    return {turned_by(vector(angle)), vector(length)};
  }
};

struct graph_shape {
  int poses;
  int loops;
  double angle = 0.01;   ///< noise of measurements, rad
  double length = 0.02;  ///< m
  int apart = 0;         ///< of the ends of a loop; 0: anything
  bool full = true;      ///< information between all unknowns
};

struct generated_graph {
  ft::pose_graph graph;  ///< poses as odometry has them
  std::vector<ft::rigid<double>> truth;
};

/// A walk with loops, and measurements with noise that is not as the information says.
inline generated_graph make_graph(graph_shape const& shape, unsigned seed) {
  random_motions any(seed);
  generated_graph made;
  made.truth.push_back(ft::rigid<double>::identity());
  for (int i = 1; i < shape.poses; ++i) {
    ft::rigid<double> const step{turned_by(any.vector(0.1)), {1 + 0.1 * any.number(), 0, 0}};
    made.truth.push_back((made.truth.back() * step).orthonormalized());
  }
  auto const join = [&](int from, int to) {
    ft::pose_graph_edge e;
    e.from = from;
    e.to = to;
    auto const& T = made.truth;
    e.T_from_to = (T[static_cast<std::size_t>(from)].inverse() * T[static_cast<std::size_t>(to)] *
                   any(shape.angle, shape.length))
                      .orthonormalized();
    double B[6][6];
    for (auto& row : B) {
      for (double& v : row) { v = shape.full ? 0.2 * any.number() : 0; }
    }
    int at = 0;
    for (int i = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) {
        double sum =
            i == j ? (i < 3 ? 1 / (shape.length * shape.length) : 4 / (shape.angle * shape.angle))
                   : 0;
        double const scale = sum > 0 || shape.full ? 1 / (shape.length * shape.length) : 0;
        for (int k = 0; k < 6; ++k) { sum += scale * B[i][k] * B[j][k]; }
        e.information[at++] = sum;
      }
    }
    made.graph.edges.push_back(e);
  };
  for (int i = 0; i + 1 < shape.poses; ++i) { join(i, i + 1); }
  for (int l = 0; l < shape.loops; ++l) {
    int const from = static_cast<int>(any.random() % static_cast<unsigned>(shape.poses));
    int const to = shape.apart > 0
                       ? from + shape.apart + static_cast<int>(any.random() % 5) - 2
                       : static_cast<int>(any.random() % static_cast<unsigned>(shape.poses));
    if (to >= 0 && to < shape.poses && to != from) { join(from, to); }
  }
  made.graph.T_world_pose.push_back(made.truth.front());
  for (int i = 0; i + 1 < shape.poses; ++i) {
    auto const& step = made.graph.edges[static_cast<std::size_t>(i)].T_from_to;
    made.graph.T_world_pose.push_back((made.graph.T_world_pose.back() * step).orthonormalized());
  }
  return made;
}

/// The largest difference of two poses: of their rotations, of their places, of the logarithms of
/// their scales.
inline double distance(ft::rigid<double> const& a, ft::rigid<double> const& b) {
  double worst = 0;
  for (int k = 0; k < 9; ++k) { worst = std::max(worst, std::abs(a.R.m[k] - b.R.m[k])); }
  auto const d = a.t - b.t;
  return std::max(worst, std::sqrt(ft::dot(d, d)));
}
inline double distance(ft::similarity<double> const& a, ft::similarity<double> const& b) {
  return std::max(std::abs(std::log(a.scale / b.scale)),
                  distance(ft::rigid<double>{a.R, a.t}, ft::rigid<double>{b.R, b.t}));
}

struct generated_similarity_graph {
  ft::similarity_graph graph;  ///< poses as odometry has them
  std::vector<ft::similarity<double>> truth;
};

/// The graph of make_graph, its poses with scales that drift.
inline generated_similarity_graph make_similarity_graph(graph_shape const& shape, unsigned seed) {
  auto const rigid = make_graph(shape, seed);
  random_motions any(seed + 1000);
  generated_similarity_graph made;
  double log_scale = 0;
  for (auto const& T : rigid.truth) {
    made.truth.push_back({T.R, T.t, std::exp(log_scale)});
    log_scale += 0.02 * any.number();
  }
  for (auto const& edge : rigid.graph.edges) {
    auto const at = [&](int i) { return made.truth[static_cast<std::size_t>(i)]; };
    ft::similarity_edge e;
    e.from = edge.from;
    e.to = edge.to;
    auto const noise = any(shape.angle, shape.length);
    e.T_from_to = (at(e.from).inverse() * at(e.to) *
                   ft::similarity<double>{noise.R, noise.t, std::exp(0.01 * any.number())})
                      .orthonormalized();
    // The information of the rigid edge, and that of the scale, which depends on the translation.
    for (int i = 0, own = 0, rigid_at = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) { e.information[own++] = edge.information[rigid_at++]; }
      e.information[own++] = shape.full && i < 3 ? 0.2 * edge.information[0] : 0;
    }
    e.information[27] = 1e4;
    made.graph.edges.push_back(e);
  }
  made.graph.T_world_pose.push_back(made.truth.front());
  for (std::size_t i = 0; i + 1 < made.truth.size(); ++i) {
    auto const& step = made.graph.edges[i].T_from_to;
    made.graph.T_world_pose.push_back((made.graph.T_world_pose.back() * step).orthonormalized());
  }
  return made;
}

}  // namespace test
