// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/sparse_map.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace app {

namespace {

constexpr std::size_t descriptors_kept = 8;
constexpr std::size_t local_keyframes = 30;
constexpr int cull_after_frames = 10;
constexpr double cull_ratio = 0.25;
constexpr int moving_keyframes = 8;      // newest ones, adjusted
constexpr int fixed_keyframes = 5;       // preceding ones, constant
constexpr int adjustment_steps = 3;      // the next keyframe continues from there
constexpr double disparity_weight = 16;  // sub-pixel, while keypoints are whole pixels
constexpr double trusted_factor = 2;     // on a point's distance: a larger change is chance
constexpr double outlier2 = 9.21;        // 99 % of 2 degrees of freedom

int hamming(orb_words const& a, orb_words const& b) {
  int d = 0;
  for (std::size_t i = 0; i < a.size(); ++i) { d += __builtin_popcount(a[i] ^ b[i]); }
  return d;
}

/// The descriptor whose median distance to the others is least.
orb_words most_typical(std::vector<orb_words> const& all) {
  std::size_t best = all.size() - 1;
  int best_median = 257;
  for (std::size_t i = 0; i < all.size(); ++i) {
    std::vector<int> distances;
    for (auto const& other : all) { distances.push_back(hamming(all[i], other)); }
    auto const middle = distances.begin() + static_cast<std::ptrdiff_t>((distances.size() - 1) / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    if (*middle < best_median) {
      best_median = *middle;
      best = i;
    }
  }
  return all[best];
}

double norm(std::array<double, 3> const& v) {
  return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

}  // namespace

std::array<double, 3> rigid_pose::operator*(std::array<double, 3> const& p) const {
  return {R[0] * p[0] + R[1] * p[1] + R[2] * p[2] + t[0],
          R[3] * p[0] + R[4] * p[1] + R[5] * p[2] + t[1],
          R[6] * p[0] + R[7] * p[1] + R[8] * p[2] + t[2]};
}

rigid_pose rigid_pose::operator*(rigid_pose const& other) const {
  rigid_pose r;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      r.R[3 * i + j] =
          R[3 * i] * other.R[j] + R[3 * i + 1] * other.R[3 + j] + R[3 * i + 2] * other.R[6 + j];
    }
  }
  r.t = *this * other.t;
  return r;
}

rigid_pose rigid_pose::inverse() const {
  rigid_pose r;
  r.R = {R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]};
  rigid_pose rotation;
  rotation.R = r.R;
  auto const moved = rotation * t;
  r.t = {-moved[0], -moved[1], -moved[2]};
  return r;
}

void rigid_pose::orthonormalize() {
  auto const scale_row = [&](std::size_t i) {
    double const n = norm({R[3 * i], R[3 * i + 1], R[3 * i + 2]});
    for (std::size_t k = 0; k < 3; ++k) { R[3 * i + k] /= n; }
  };
  scale_row(0);
  double const d = R[0] * R[3] + R[1] * R[4] + R[2] * R[5];
  for (std::size_t k = 0; k < 3; ++k) { R[3 + k] -= d * R[k]; }
  scale_row(1);
  R[6] = R[1] * R[5] - R[2] * R[4];
  R[7] = R[2] * R[3] - R[0] * R[5];
  R[8] = R[0] * R[4] - R[1] * R[3];
}

sparse_map::sparse_map(int slots, std::vector<float> scales)
    : scales_(std::move(scales)), points_(static_cast<std::size_t>(slots)) {
  is_changed_.assign(points_.size(), 0);
  clear();
}

void sparse_map::clear() {
  keyframes_.clear();
  oldest_ = 0;
  alive_ = 0;
  points_made_ = 0;
  free_.clear();
  for (int s = static_cast<int>(points_.size()) - 1; s >= 0; --s) {
    points_[static_cast<std::size_t>(s)] = {};
    free_.push_back(s);
  }
  changed_.clear();
  std::fill(is_changed_.begin(), is_changed_.end(), static_cast<unsigned char>(0));
}

void sparse_map::touch(int slot) {
  auto& flag = is_changed_[static_cast<std::size_t>(slot)];
  if (flag == 0) {
    flag = 1;
    changed_.push_back(slot);
  }
}

std::vector<int> sparse_map::take_changes() {
  std::vector<int> taken;
  taken.swap(changed_);
  for (int s : taken) { is_changed_[static_cast<std::size_t>(s)] = 0; }
  taken.erase(std::remove_if(taken.begin(), taken.end(), [&](int s) { return !alive(s); }),
              taken.end());
  return taken;
}

void sparse_map::remove(int slot) {
  auto& p = points_[static_cast<std::size_t>(slot)];
  if (!p.alive) { return; }
  for (int id : p.keyframes) {
    auto& seen = keyframes_[static_cast<std::size_t>(id)].points;
    seen.erase(std::remove(seen.begin(), seen.end(), slot), seen.end());
  }
  p = {};
  free_.push_back(slot);
  --alive_;
}

int sparse_map::take_slot() {
  while (free_.empty()) {
    std::vector<int> const old = keyframes_[static_cast<std::size_t>(oldest_++)].points;
    for (int s : old) { remove(s); }
  }
  int const slot = free_.back();
  free_.pop_back();
  return slot;
}

void sparse_map::observe(int slot, int id, keyframe_feature const& feature) {
  auto& p = points_[static_cast<std::size_t>(slot)];
  auto& kf = keyframes_[static_cast<std::size_t>(id)];
  p.keyframes.push_back(id);
  kf.points.push_back(slot);
  p.recent.push_back(feature.orb);
  if (p.recent.size() > descriptors_kept) { p.recent.erase(p.recent.begin()); }
  p.orb = most_typical(p.recent);

  std::array<double, 3> sum{};
  std::array<double, 3> const at{static_cast<double>(p.position[0]),
                                 static_cast<double>(p.position[1]),
                                 static_cast<double>(p.position[2])};
  for (int k : p.keyframes) {
    auto const centre = keyframes_[static_cast<std::size_t>(k)].T_cw.inverse().t;
    std::array<double, 3> const view{at[0] - centre[0], at[1] - centre[1], at[2] - centre[2]};
    double const n = norm(view);
    for (std::size_t i = 0; i < 3; ++i) { sum[i] += view[i] / n; }
  }
  double const n = std::max(norm(sum), 1e-12);
  for (std::size_t i = 0; i < 3; ++i) { p.normal[i] = static_cast<float>(sum[i] / n); }
  touch(slot);
}

void sparse_map::insert(rigid_pose const& T_cw, std::vector<keyframe_feature>& features,
                        double near, int at_least) {
  int const id = static_cast<int>(keyframes_.size());
  keyframes_.push_back({T_cw, {}, {}});
  std::vector<std::pair<double, std::size_t>> candidates;
  for (std::size_t i = 0; i < features.size(); ++i) {
    auto& f = features[i];
    if (alive(f.slot)) {
      auto const& seen = points_[static_cast<std::size_t>(f.slot)].keyframes;
      if (seen.empty() || seen.back() != id) { observe(f.slot, id, f); }
    } else {
      f.slot = -1;
    }
    if (f.camera[2] > 0) { candidates.emplace_back(f.camera[2], i); }
  }
  std::sort(candidates.begin(), candidates.end());
  int made = 0;
  for (auto const& [depth, i] : candidates) {
    if (depth > near && made >= at_least) { break; }
    ++made;  // existing points count, too
    auto& f = features[i];
    if (f.slot >= 0) { continue; }
    int const slot = take_slot();
    auto& p = points_[static_cast<std::size_t>(slot)];
    auto const world = T_cw.inverse() * f.camera;
    for (std::size_t k = 0; k < 3; ++k) { p.position[k] = static_cast<float>(world[k]); }
    p.alive = true;
    p.number = ++points_made_;
    ++alive_;
    p.max_distance =
        static_cast<float>(norm(f.camera)) * scales_[static_cast<std::size_t>(f.octave)];
    p.min_distance = p.max_distance / scales_.back();
    f.slot = slot;
    observe(slot, id, f);
  }
}

void sparse_map::adjust(odometry_options const& rig, std::vector<seen_point> seen) {
  for (auto& s : seen) { s.number = point(s.slot).number; }
  keyframes_.back().seen = std::move(seen);
  int const end = keyframe_count();
  int const moving = std::max(1, end - moving_keyframes);  // the first keyframe defines the world
  int const begin = std::max(0, moving - fixed_keyframes);
  if (begin > 0) { keyframes_[static_cast<std::size_t>(begin - 1)].seen = {}; }
  if (end < 2) { return; }

  adjustment a;
  a.fixed = moving - begin;
  std::vector<int> index(points_.size(), -1);
  std::vector<int> slots;
  auto const is_here = [&](seen_point const& s) {
    return alive(s.slot) && point(s.slot).number == s.number;
  };
  for (int id = moving; id < end; ++id) {
    for (auto const& s : keyframes_[static_cast<std::size_t>(id)].seen) {
      auto& i = index[static_cast<std::size_t>(s.slot)];
      if (i >= 0 || !is_here(s)) { continue; }
      i = static_cast<int>(slots.size());
      slots.push_back(s.slot);
      auto const& at = point(s.slot).position;
      a.points.push_back(
          {static_cast<double>(at[0]), static_cast<double>(at[1]), static_cast<double>(at[2])});
    }
  }
  struct source {
    sighting what;
    seen_point* from;
  };
  std::vector<source> sources;
  for (int id = begin; id < end; ++id) {
    auto& kf = keyframes_[static_cast<std::size_t>(id)];
    a.views.push_back(kf.T_cw);
    for (auto& s : kf.seen) {
      int const i = index[static_cast<std::size_t>(s.slot)];
      if (i < 0 || !is_here(s)) { continue; }
      double const scale = static_cast<double>(scales_[static_cast<std::size_t>(s.octave)]);
      sources.push_back({{id - begin, i, s.camera, s.u, s.v,
                          (rig.fisheye || s.camera == 0 ? 1 : disparity_weight) / (scale * scale)},
                         &s});
    }
  }
  std::stable_sort(sources.begin(), sources.end(),
                   [](source const& x, source const& y) { return x.what.point < y.what.point; });
  for (auto const& s : sources) { a.sightings.push_back(s.what); }

  std::vector<double> const errors = app::adjust(rig, a, adjustment_steps);

  for (int id = moving; id < end; ++id) {
    keyframes_[static_cast<std::size_t>(id)].T_cw = a.views[static_cast<std::size_t>(id - begin)];
  }
  for (std::size_t i = 0; i < slots.size(); ++i) {
    auto& p = points_[static_cast<std::size_t>(slots[i])];
    auto const centre = keyframes_[static_cast<std::size_t>(p.keyframes.front())].T_cw.inverse().t;
    auto const distance = [&] {
      return norm({static_cast<double>(p.position[0]) - centre[0],
                   static_cast<double>(p.position[1]) - centre[1],
                   static_cast<double>(p.position[2]) - centre[2]});
    };
    auto const position = p.position;
    double const before = distance();
    for (std::size_t k = 0; k < 3; ++k) { p.position[k] = static_cast<float>(a.points[i][k]); }
    double const factor = distance() / before;
    if (!(factor > 1 / trusted_factor && factor < trusted_factor)) {  // also rejects NaN
      p.position = position;
      continue;
    }
    p.min_distance *= static_cast<float>(factor);
    p.max_distance *= static_cast<float>(factor);
    touch(slots[i]);
  }
  for (std::size_t i = 0; i < sources.size(); ++i) {
    if (!(errors[i] >= 0 && errors[i] < outlier2)) { sources[i].from->number = 0; }
  }
}

std::vector<int> sparse_map::collect(std::vector<int> const& ids, int most) const {
  std::vector<int> slots;
  std::vector<unsigned char> taken(points_.size(), 0);
  for (int id : ids) {
    for (int s : keyframes_[static_cast<std::size_t>(id)].points) {
      if (taken[static_cast<std::size_t>(s)] != 0) { continue; }
      if (static_cast<int>(slots.size()) >= most) { return slots; }
      taken[static_cast<std::size_t>(s)] = 1;
      slots.push_back(s);
    }
  }
  return slots;
}

std::vector<int> sparse_map::local_points(std::vector<int> const& held, int most) const {
  std::map<int, int> votes;
  for (int s : held) {
    if (!alive(s)) { continue; }
    for (int id : point(s).keyframes) { ++votes[id]; }
  }
  std::vector<std::pair<int, int>> ranked;  // votes, then the newer keyframe first
  for (auto const& [id, n] : votes) { ranked.emplace_back(n, id); }
  std::sort(ranked.rbegin(), ranked.rend());
  std::vector<int> ids;
  for (auto const& r : ranked) {
    if (ids.size() >= local_keyframes) { break; }
    ids.push_back(r.second);
  }
  // The newest keyframe's points are most likely to be in view.
  if (!keyframes_.empty() && std::find(ids.begin(), ids.end(), keyframe_count() - 1) == ids.end()) {
    ids.push_back(keyframe_count() - 1);
  }
  return collect(ids, most);
}

std::vector<int> sparse_map::recent_points(int most) const {
  std::vector<int> ids;
  for (int id = keyframe_count() - 1; id >= 0 && ids.size() < local_keyframes; --id) {
    ids.push_back(id);
  }
  return collect(ids, most);
}

void sparse_map::cull() {
  for (int s = 0; s < static_cast<int>(points_.size()); ++s) {
    auto const& p = points_[static_cast<std::size_t>(s)];
    if (p.alive && p.visible >= cull_after_frames && p.found < cull_ratio * p.visible) {
      remove(s);
    }
  }
}

}  // namespace app
