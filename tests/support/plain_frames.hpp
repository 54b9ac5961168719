// SPDX-License-Identifier: Apache-2.0
/// @file Random frames for the map stages, and the plain loop that makes keyframes of them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "ft/containers/frame.hpp"
#include "ft/kernels/map/insert_keyframe.hpp"
#include "tests/support/plain_map.hpp"

namespace test {

/// Everything that insert_keyframe reads and writes of frames.
struct frames_view {
  ft::keypoints_view keypoints;
  float* right_x = nullptr;
  int* partner = nullptr;
  int* holder = nullptr;
  ft::keyframe_order* order = nullptr;
  ft::rigid<double>* T_cw = nullptr;
  std::int64_t* time_ns = nullptr;
  float* depth = nullptr;
  ft::vec3<float>* point = nullptr;
  int* held = nullptr;
  int* left_out = nullptr;
  float* moves = nullptr;  ///< of keyframe_input
  int cameras = 1;
  int searches = 1;  ///< as of a rig: the cameras of a multi_rig, else 1
  int batch = 1;

  bool rectified() const { return cameras == searches; }
  int images() const { return 2 * searches; }
  int capacity() const { return keypoints.capacity; }
  int numbers() const { return cameras * keypoints.capacity; }
  ft::frame_view frame() const {
    ft::frame_view f;
    f.keypoints = keypoints;
    f.cameras = cameras;
    f.batch = batch;
    f.keypoint_step = images();
    f.camera_step = images() / cameras;
    f.right_x = rectified() ? right_x : nullptr;
    f.partner = rectified() ? nullptr : partner;
    f.holder = holder;
    return f;
  }
};

inline void carve(ft::carver& c, frames_view& v, int capacity, int cameras, int searches,
                  int batch) {
  v.cameras = cameras;
  v.searches = searches;
  v.batch = batch;
  ft::carve(c, v.keypoints, capacity, v.images() * batch);
  auto const b = static_cast<std::size_t>(batch);
  std::size_t const n = b * static_cast<std::size_t>(capacity);
  std::size_t const with_depth = n * static_cast<std::size_t>(searches);
  v.right_x = c.take<float>(with_depth);
  v.partner = c.take<int>(n * static_cast<std::size_t>(cameras));
  v.holder = c.take<int>(n * static_cast<std::size_t>(cameras));
  v.order = c.take<ft::keyframe_order>(b);
  v.T_cw = c.take<ft::rigid<double>>(b);
  v.time_ns = c.take<std::int64_t>(b);
  v.depth = c.take<float>(with_depth);
  v.point = c.take<ft::vec3<float>>(with_depth);
  v.held = c.take<int>(b);
  v.left_out = c.take<int>(b);
  v.moves = c.take<float>(n * static_cast<std::size_t>(cameras));
}

inline ft::descriptor random_descriptor(std::mt19937& random, unsigned seed) {
  std::mt19937 base(seed);
  ft::descriptor d{};
  for (auto& w : d.words) { w = static_cast<std::uint32_t>(base()); }
  for (auto flips = random() % 5; flips > 0; --flips) {
    d.words[random() % 8] ^= 1u << (random() % 32);
  }
  return d;
}

/// A depth: often one of few values, sometimes none or no number.
inline float random_depth(std::mt19937& random) {
  switch (random() % 12) {
    case 0:
      return -1;
    case 1:
      return 0;
    case 2:
      return NAN;
    case 3:
      return std::numeric_limits<float>::infinity();
    case 4:
      return 5;
    case 5:
      return 3;
    case 6:
    case 7:
      return 8;
    default:
      return std::uniform_real_distribution<float>(1, 10)(random);
  }
}

/// Fills the keypoints of batch entry b; they hold points of the map, removed ones and none.
/// @param share of keypoints that hold something, percent
inline void randomize_frame(std::mt19937& random, frames_view const& v, int b, plain_map const& map,
                            unsigned share) {
  std::uniform_real_distribution<float> pixel(0, 500);
  int const capacity = v.capacity();
  int const slots = static_cast<int>(map.points.size());
  for (int n = 0; n < v.numbers(); ++n) {
    auto const at = static_cast<std::ptrdiff_t>(b) * v.numbers() + n;
    v.partner[at] = -1;
    v.moves[at] = static_cast<float>(n % 3) - 1;
    v.holder[at] = static_cast<int>(random() % static_cast<unsigned>(slots + 4)) - 2;
    for (int tries = 0; tries < 4 && v.holder[at] >= 0 && v.holder[at] < slots &&
                        map.points[index(v.holder[at])].number == 0;
         ++tries) {
      v.holder[at] = static_cast<int>(random() % static_cast<unsigned>(slots));
    }
    if (random() % 100 >= share) { v.holder[at] = -1; }
  }
  for (int c = 0; c < v.images(); ++c) {
    auto const k = v.keypoints.slice(v.images() * b + c);
    *k.count = static_cast<int>(random() % static_cast<unsigned>(capacity + 1));
    for (int i = 0; i < capacity; ++i) {
      k.x(i) = pixel(random);
      k.y(i) = pixel(random);
      k.octave(i) = static_cast<int>(random() % 4);
      k.orb(i) = random_descriptor(random, static_cast<unsigned>(random() % 3));
    }
  }
  for (int i = 0; i < v.searches * capacity; ++i) {
    auto const at = static_cast<std::ptrdiff_t>(b) * v.searches * capacity + i;
    v.depth[at] = random_depth(random);
    v.right_x[at] = v.depth[at] > 0 ? pixel(random) : -1;
    v.point[at] = {pixel(random) / 100, pixel(random) / 100, v.depth[at]};
  }
  int const right = *v.keypoints.slice(2 * b + 1).count;
  for (int i = 0; !v.rectified() && right > 0 && i < *v.keypoints.slice(2 * b).count; ++i) {
    if (random() % 2 == 0) { continue; }
    int* const partner = v.partner + static_cast<std::ptrdiff_t>(b) * v.numbers();
    partner[i] = capacity + static_cast<int>(random() % static_cast<unsigned>(right));
    partner[partner[i]] = i;  // of several the last one stays
  }
  v.T_cw[b] = random_motion(random, 0.3, 2);
  v.time_ns[b] = static_cast<std::int64_t>(random()) << 8;
}

inline ft::descriptor plain_typical(std::vector<ft::descriptor> const& all) {
  std::vector<int> medians;
  for (auto const& one : all) {
    std::vector<int> distances;
    for (auto const& other : all) { distances.push_back(ft::hamming(one, other)); }
    std::sort(distances.begin(), distances.end());
    medians.push_back(distances[(distances.size() - 1) / 2]);
  }
  auto const least = std::min_element(medians.begin(), medians.end());
  return all[index(least - medians.begin())];
}

inline ft::vec3<double> plain_unit(ft::vec3<double> v) {
  double const n = std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
  return {v.x / n, v.y / n, v.z / n};
}
inline ft::vec3<double> plain_wide(ft::vec3<float> v) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
}
inline ft::vec3<float> plain_narrow(ft::vec3<double> v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

/// What a plain loop over one frame makes of a map.
template <typename Rig>
class plain_insertion {
public:
  plain_map map;
  std::vector<int> holder;
  int left_out = 0;
  plain_insertion(ft::keyframe_input<Rig> const& in, ft::keyframe_params const& params, int b,
                  plain_map before)
      : map(std::move(before)),
        in_(in),
        params_(params),
        b_(b),
        cameras_(in.frame.cameras),
        claims_(index(cameras_)) {
    int const numbers = in.frame.numbers();
    holder.assign(in.frame.holder + b * numbers, in.frame.holder + (b + 1) * numbers);
  }

  void run() {
    if (in_.order[b_] == ft::keyframe_order::none) { return; }
    if (in_.order[b_] == ft::keyframe_order::begin_map) {
      map.keyframes.clear();
      for (auto& p : map.points) { p = {}; }
    }
    for (auto& p : map.points) {
      if (p.visible >= params_.cull_after &&
          p.found < p.visible / static_cast<double>(params_.cull_share)) {
        p = {};
      }
    }
    id_ = ++map.keyframes_made;
    for (int n = 0; n < in_.frame.numbers(); ++n) {
      int& h = holder[index(n)];
      bool const there = n % capacity() < count(n / capacity());
      if (!there || h < 0 || h >= slots() || map.points[index(h)].number == 0) { h = -1; }
    }
    std::set<int> const fresh = wanted();
    share(fresh);
    observe();
    leave(fresh.size());
    link();
    make(fresh);
    record();
  }

private:
  int capacity() const { return in_.frame.capacity(); }
  int slots() const { return static_cast<int>(map.points.size()); }
  int count(int c) const { return *in_.frame.camera(b_, c).count; }

  /// Limit of depth of a camera. The fisheye pairs of the tests lie along x.
  float near([[maybe_unused]] int c) const {
    if constexpr (Rig::searches > 1) {
      return params_.near_depth * static_cast<float>(in_.rig.of[c].baseline);
    } else if constexpr (Rig::rectified) {
      return params_.near_depth * static_cast<float>(in_.rig.baseline);
    } else {
      return params_.near_depth * std::abs(in_.rig.T_rl.t.x);
    }
  }
  /// Left keypoints that are to become points.
  std::set<int> wanted() const {
    std::set<int> fresh;
    for (int c = 0; c < Rig::searches; ++c) {
      std::vector<std::pair<float, int>> candidates;
      for (int i = 0; i < count(c); ++i) {
        float const depth = in_.depth[(b_ * Rig::searches + c) * capacity() + i];
        if (depth > 0 && !std::isinf(depth)) { candidates.emplace_back(depth, i); }
      }
      std::sort(candidates.begin(), candidates.end());
      int taken = 0;
      for (auto const& [depth, i] : candidates) {
        if (depth > near(c) && taken >= params_.wanted_near_points) { break; }
        ++taken;
        int const n = c * capacity() + i;
        if (holder[index(n)] < 0) { fresh.insert(n); }
      }
    }
    return fresh;
  }
  void share(std::set<int> const& fresh) {
    for (int i = 0; !Rig::rectified && i < count(1); ++i) {
      int const partner = in_.frame.partner[b_ * 2 * capacity() + capacity() + i];
      if (partner < 0) { continue; }
      int const h = holder[index(partner)];
      if (h >= 0 || fresh.count(partner) != 0) { holder[index(capacity() + i)] = h; }
    }
  }
  void observe() {
    for (int n = 0; n < in_.frame.numbers(); ++n) {
      if (holder[index(n)] >= 0) { claim(n, holder[index(n)]); }
    }
  }
  void claim(int n, int slot) {
    bool const first = claims_[index(n / capacity())].emplace(slot, n).second;
    if (first) { map.points[index(slot)].seen_by.insert(id_); }
  }
  void leave(std::size_t needed) {
    auto const oldest_leaves = [&] {
      int const number = map.keyframes.begin()->first;
      map.keyframes.erase(number);
      for (auto& p : map.points) {
        bool const saw = p.seen_by.erase(number) != 0;
        if (saw && p.seen_by.empty()) { p = {}; }
      }
    };
    if (static_cast<int>(map.keyframes.size()) == map.positions) { oldest_leaves(); }
    while (map.points.size() - index(map.alive()) < needed && !map.keyframes.empty()) {
      oldest_leaves();
    }
  }
  void link() {
    plain_keyframe made;
    for (auto& [number, other] : map.keyframes) {
      int shared = 0;
      for (auto const& p : map.points) {
        shared += static_cast<int>(p.seen_by.count(id_) != 0 && p.seen_by.count(number) != 0);
      }
      bool const has = map.keyframes.count(other.neighbour) != 0;
      if (!has) { other.neighbour = other.shared = 0; }
      if (shared > 0 && shared >= other.shared) {
        other.neighbour = id_;
        other.shared = shared;
      }
      if (shared > 0 && shared >= made.shared) {
        made.neighbour = number;
        made.shared = shared;
      }
    }
    made.T_cw = in_.T_cw[b_];
    made.time_ns = in_.time_ns[b_];
    map.keyframes[id_] = made;
  }
  void make(std::set<int> const& fresh) {
    int slot = 0;
    for (int const n : fresh) {
      while (slot < slots() && map.points[index(slot)].number != 0) { ++slot; }
      if (slot == slots()) {
        ++left_out;
        continue;
      }
      plain_point& p = map.points[index(slot)];
      p = {};
      p.number = ++map.points_made;
      p.visible = p.found = 1;
      int const c = n / capacity();
      int const i = n % capacity();
      auto const from = seen_at(c, i);
      float const distance =
          static_cast<float>(std::sqrt(from.x * from.x + from.y * from.y + from.z * from.z));
      auto const& T = in_.T_cw[b_];
      p.position = plain_narrow(T.R.transposed() * (in_body(c, from) - T.t));
      p.most = distance * in_.geometry.scale[in_.frame.camera(b_, c).octave(i)];
      p.least = p.most / in_.geometry.scale[in_.geometry.levels - 1];
      holder[index(n)] = slot;
      claim(n, slot);
      for (int j = 0; !Rig::rectified && j < count(1); ++j) {
        if (in_.frame.partner[b_ * 2 * capacity() + capacity() + j] != i) { continue; }
        holder[index(capacity() + j)] = slot;
        claim(capacity() + j, slot);
      }
    }
  }
  ft::vec3<double> in_body([[maybe_unused]] int c, ft::vec3<double> const& in_camera) const {
    if constexpr (Rig::searches > 1) {
      auto const T = in_.rig.of[c].T_cb.template cast<double>();
      return T.R.transposed() * (in_camera - T.t);
    }
    return in_camera;
  }
  /// Of a pixel of a level of `to` of `from` pixels, whose position is multiplied by the scale.
  double in_image(float x, int octave, int from, int to) const {
    auto const& g = in_.geometry;
    auto const at = static_cast<double>(x);
    if (!g.exact) { return at; }
    return (at / static_cast<double>(g.scale[octave]) + 0.5) * from / to - 0.5;
  }
  double column(float x, int octave) const {
    return in_image(x, octave, in_.geometry.width[0], in_.geometry.width[octave]);
  }
  double row(float y, int octave) const {
    return in_image(y, octave, in_.geometry.height[0], in_.geometry.height[octave]);
  }
  ft::vec3<double> seen_at(int c, int i) const {
    if constexpr (Rig::rectified) {
      auto const k = in_.frame.camera(b_, c);
      auto const camera = in_.rig.pair(c).camera.template cast<double>();
      int const o = k.octave(i);
      // A disparity is the difference of two columns.
      double const wider = column(1, o) - column(0, o);
      double const z =
          static_cast<double>(in_.depth[(b_ * Rig::searches + c) * capacity() + i]) / wider;
      return {z * (column(k.x(i), o) - camera.cx) / camera.fx,
              z * (row(k.y(i), o) - camera.cy) / camera.fy, z};
    } else {
      return plain_wide(in_.point[b_ * capacity() + i]);
    }
  }
  void record() {
    auto& made = map.keyframes[id_];
    for (int c = 0; c < cameras_; ++c) {
      made.cameras.emplace_back();
      auto const k = in_.frame.camera(b_, c);
      for (int i = 0; i < *k.count; ++i) {
        int const n = c * capacity() + i;
        int const slot = holder[index(n)];
        bool const holds = slot >= 0 && claims_[index(c)].at(slot) == n;
        float const right = Rig::rectified ? in_.frame.right_x[b_ * in_.frame.numbers() + n] : -1;
        int const o = k.octave(i);
        made.cameras.back().push_back(
            {static_cast<float>(column(k.x(i), o)), static_cast<float>(row(k.y(i), o)),
             right < 0 ? -1 : static_cast<float>(column(right, o)), o, holds ? slot : -1,
             holds ? map.points[index(slot)].number : 0,
             holds && in_.moves != nullptr && in_.moves[b_ * in_.frame.numbers() + n] >= 0});
        bool first = holds;
        for (int before = 0; before < c; ++before) {
          first = first && claims_[index(before)].count(slot) == 0;
        }
        if (first) { describe(map.points[index(slot)], k.orb(i)); }
      }
    }
    for (auto& p : map.points) { p.observations = static_cast<int>(p.seen_by.size()); }
  }
  void describe(plain_point& p, ft::descriptor const& orb) const {
    p.recent.push_back(orb);
    if (p.recent.size() > 8) { p.recent.erase(p.recent.begin()); }
    p.orb = plain_typical(p.recent);
    ft::vec3<double> sum{0, 0, 0};
    for (int const n : p.seen_by) {
      auto const& T = map.keyframes.at(n).T_cw;
      sum = sum + plain_unit(plain_wide(p.position) + T.R.transposed() * T.t);
    }
    p.normal = plain_narrow(plain_unit(sum));
  }

  ft::keyframe_input<Rig> in_;
  ft::keyframe_params params_;
  int b_;
  int cameras_;
  int id_ = 0;
  std::vector<std::map<int, int>> claims_;  ///< per camera: keypoint that holds a slot
};

}  // namespace test
