// SPDX-License-Identifier: Apache-2.0
/// @file A rendered room that a stereo camera walks through, and a tracker that follows it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "ft/types/images.hpp"
#include "ft/types/tracking.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"
#include "tests/support/tracking.hpp"

namespace test::room {

using test::at;

// ---- a room ------------------------------------------------------------------------------------

constexpr int width = 480;
constexpr int height = 360;

inline ft::rectified_rig rig() {
  return ft::rectified_rig::make({300.0f, 300.0f, 239.5f, 179.5f}, 0.25f);
}

using fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

/// Two fisheye cameras that are not quite parallel.
inline fisheye_rig fisheye() {
  ft::pose T_rl{{{0.9998f, 0, -0.02f, 0, 1, 0, 0.02f, 0, 0.9998f}}, {-0.25f, 0.004f, 0.002f}};
  return {{210.0f, 211.0f, 239.5f, 179.5f, -0.012f, 0.003f, -0.002f, 0.0003f},
          {212.0f, 210.0f, 241.0f, 177.0f, -0.01f, 0.002f, -0.001f, 0.0002f},
          T_rl};
}

inline ft::tracker_params params() {
  ft::tracker_params p;
  p.orb.width = width;
  p.orb.height = height;
  p.orb.features = 600;
  p.map_slots = 1500;
  p.local_points = 900;
  p.updates = 800;
  return p;
}

/// @param map_slots half of which are in a local map or an adjustment
inline ft::odometry_params odometry_params(int map_slots) {
  ft::odometry_params p;
  p.orb = params().orb;
  p.map_slots = map_slots;
  p.local_points = map_slots / 2;
  p.keyframes = 20;
  p.window_points = map_slots / 2;
  return p;
}

using image = std::vector<std::uint8_t>;

inline ft::gray_view view(image const& i) { return {i.data(), width, height, width}; }

/// Intersection of a ray with the inside of the box.
struct hit {
  int wall;
  ft::vec3<double> point;  ///< world
};

template <typename Camera>
hit look(Camera const& camera, ft::pose const& T_wc, float u, float v) {
  constexpr double low[3] = {-3, -1.5, -2};
  constexpr double high[3] = {3, 1.5, 6};
  ft::vec3<float> const d = T_wc.R * camera.unproject({u, v}).direction;
  double const direction[3] = {d.x, d.y, d.z};
  double const origin[3] = {T_wc.t.x, T_wc.t.y, T_wc.t.z};
  double nearest = 1e9;
  int axis = 0;
  for (int a = 0; a < 3; ++a) {
    double const wall = direction[a] > 0 ? high[a] : low[a];
    double const t = std::abs(direction[a]) < 1e-9 ? 1e9 : (wall - origin[a]) / direction[a];
    if (t < nearest) {
      nearest = t;
      axis = a;
    }
  }
  return {2 * axis + (direction[axis] > 0 ? 1 : 0),
          {origin[0] + nearest * direction[0], origin[1] + nearest * direction[1],
           origin[2] + nearest * direction[2]}};
}

constexpr int wall_side = 400;  ///< texels

/// The textures of a room's six walls.
inline std::vector<image> make_walls(unsigned seed) {
  std::vector<image> walls;
  for (unsigned w = 0; w < 6; ++w) {
    walls.push_back(test::random_image(wall_side, wall_side, 100 * seed + w));
  }
  return walls;
}

/// The image of a camera at T_cw.
template <typename Camera>
image render(Camera const& camera, std::vector<image> const& walls, ft::pose const& T_cw) {
  constexpr double texels = 50;  // per metre
  auto const T_wc = T_cw.inverse();
  image out(at(width) * at(height));
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      hit const h = look(camera, T_wc, static_cast<float>(u), static_cast<float>(v));
      double const p[3] = {h.point.x, h.point.y, h.point.z};
      double const s = (p[(h.wall / 2 + 1) % 3] + 20) * texels;
      double const t = (p[(h.wall / 2 + 2) % 3] + 20) * texels;
      out[at(v) * at(width) + at(u)] = test::texture_at(walls[at(h.wall)], wall_side, s, t);
    }
  }
  return out;
}

struct stereo_frame {
  image left, right;
  ft::pose T_cw;  ///< true
};

inline ft::stereo_images images_of(stereo_frame const& f) { return {view(f.left), view(f.right)}; }

/// What a rig at T_cw sees.
template <typename Rig>
stereo_frame see(Rig const& rig, std::vector<image> const& walls, ft::pose const& T_cw) {
  if constexpr (Rig::rectified) {
    ft::pose T_rw = T_cw;
    T_rw.t.x -= rig.baseline_length().value;
    return {render(rig.camera, walls, T_cw), render(rig.camera, walls, T_rw), T_cw};
  } else {
    return {render(rig.left, walls, T_cw), render(rig.right, walls, rig.T_rl * T_cw), T_cw};
  }
}

/// On a lap of so many frames, camera to world: on a circle of 1.2 m, looking outwards.
inline ft::pose on_lap(float frame, int lap) {
  float const yaw = 6.2831853f * frame / static_cast<float>(lap);
  float const c = std::cos(yaw), s = std::sin(yaw);
  return {{{c, 0, s, 0, 1, 0, -s, 0, c}}, {0.6f * s, 0, 1.2f + 0.6f * c}};
}

/// A short walk through the room of a seed.
template <typename Rig>
std::vector<stereo_frame> make_walk(Rig const& rig, unsigned seed, int frames) {
  auto const walls = make_walls(seed);
  std::vector<stereo_frame> walk;
  float const turn = seed % 2 == 0 ? 1.0f : -1.0f;
  for (int i = 0; i < frames; ++i) {
    auto const step = static_cast<float>(i);
    float const yaw = turn * 0.012f * step;
    float const pitch = 0.006f * step;
    float const c = std::cos(yaw), s = std::sin(yaw), cp = std::cos(pitch), sp = std::sin(pitch);
    ft::mat3<float> const about_y{{c, 0, s, 0, 1, 0, -s, 0, c}};
    ft::mat3<float> const about_x{{1, 0, 0, 0, cp, -sp, 0, sp, cp}};
    ft::pose const T_wc{about_y * about_x, {turn * 0.02f * step, -0.01f * step, 0.05f * step}};
    ft::pose const T_cw = T_wc.inverse();
    walk.push_back(see(rig, walls, T_cw));
  }
  return walk;
}

/// Rendered once per program run.
inline std::vector<stereo_frame> const& walk(unsigned seed) {
  static std::vector<std::vector<stereo_frame>> const walks = [] {
    std::vector<std::vector<stereo_frame>> all;
    for (unsigned i = 0; i < 3; ++i) { all.push_back(make_walk(rig(), i, 3)); }
    return all;
  }();
  return walks.at(seed);
}

// ---- driving a tracker ------------------------------------------------------------------------

using test::expect_same;
using test::same_bits;
using test::snapshot;

/// @param local whether to copy in_view, too
template <typename Tracker>
snapshot take(Tracker const& tracker, int b, bool local) {
  return test::take(tracker, b, local ? tracker.result().local_points : 0);
}

inline void expect_same(std::vector<snapshot> const& a, std::vector<snapshot> const& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    SCOPED_TRACE("snapshot " + std::to_string(i));
    expect_same(a[i], b[i]);
  }
}

inline int held(snapshot const& s) {
  return static_cast<int>(
      std::count_if(s.holder.begin(), s.holder.end(), [](int h) { return h >= 0; }));
}

/// Map points of the last result's keypoints with depth: slot i is left keypoint i.
template <typename Exec, typename Rig>
std::vector<ft::point_update> points_of(ft::frame_tracker<Exec, Rig> const& tracker,
                                        Exec const& exec, int b) {
  auto const& r = tracker.result();
  int const count = r.keypoints[b * r.cameras];
  std::vector<ft::descriptor> orb(at(count));
  tracker.download_descriptors(exec, b, orb.data(), count);
  exec.wait();
  auto const& g = tracker.geometry();
  ft::pose const T_wc = r.T_cw[b].inverse();
  std::vector<ft::point_update> points;
  for (int i = 0; i < count; ++i) {
    std::ptrdiff_t const k = static_cast<std::ptrdiff_t>(b) * r.capacity + i;
    if (!(r.depth[k] > 0)) { continue; }
    ft::vec3<float> const p = T_wc * r.point[k];
    ft::vec3<float> const d = p - T_wc.t;
    float const distance = std::sqrt(ft::dot(d, d));
    int const octave = r.octave[static_cast<std::ptrdiff_t>(b) * r.cameras * r.capacity + i];
    float const farthest = distance * g.scale[octave];
    points.push_back({i,
                      1,
                      p,
                      {d.x / distance, d.y / distance, d.z / distance},
                      farthest / g.scale[g.levels - 1],
                      farthest,
                      orb[at(i)]});
  }
  return points;
}

template <typename Tracker>
void set_images(Tracker& tracker, int b, stereo_frame const& f) {
  tracker.set_image(b, 0, view(f.left));
  tracker.set_image(b, 1, view(f.right));
}

/// Whether a frame is tracked by two calls or by one.
enum class calls { halves, whole };

struct walk_options {
  calls by = calls::halves;
  int guests = 0;  ///< every guests-th point of the map is not observed, 0 = none
  int kept = 1;    ///< every kept-th keypoint of the last frame has a holder
};

/// The first frame creates the map: the holders of its keypoints, and the local map.
template <typename Exec, typename Rig>
void make_map(test::frame_inputs<ft::frame_tracker<Exec, Rig>>& in, Exec const& exec, int b,
              int guests) {
  auto& tracker = in.tracker;
  auto points = points_of(tracker, exec, b);
  for (std::size_t i = 0; guests > 0 && i < points.size(); i += at(guests)) {
    points[i].observations = 0;
  }
  tracker.update_map(exec, b, points.data(), static_cast<int>(points.size()));
  exec.wait();
  auto const first = static_cast<std::ptrdiff_t>(b) * in.numbers();
  auto const holder = in.last_holder.begin() + first;
  int const* const partner = tracker.result().partner + first;
  std::fill(holder, holder + in.numbers(), -1);
  int* local =
      in.local_slots.data() + static_cast<std::ptrdiff_t>(b) * tracker.params().local_points;
  in.local_count[at(b)] = static_cast<int>(points.size());
  for (auto const& p : points) {
    holder[p.slot] = p.slot;
    if (partner[p.slot] >= 0) { holder[partner[p.slot]] = p.slot; }
    *local++ = p.slot;
  }
  in.last_pose[at(b)] = in.predicted[at(b)];
}

/// The first frame creates the map. The others are tracked against the preceding frame and against
/// the map. The state after the last frame is given with each call.
/// @param in of the tracker
/// @param give called before each frame with batch entry, number and frame; sets its images
/// @return per frame, step and batch entry
template <typename Exec, typename Rig, typename Give>
std::vector<snapshot> track(test::frame_inputs<ft::frame_tracker<Exec, Rig>>& in, Exec const& exec,
                            std::vector<std::vector<stereo_frame> const*> const& walks,
                            Give const& give, walk_options const& how = {}) {
  auto const& tracker = in.tracker;
  std::vector<snapshot> all;
  int const batch = tracker.batch();
  int const numbers = in.numbers();
  auto const forget_some = [&] {
    for (int i = 0; i < batch * numbers; ++i) {
      if (i % how.kept != 0) { in.last_holder[at(i)] = -1; }
    }
  };
  auto const keep = [&](bool local) {
    exec.wait();
    for (int b = 0; b < batch; ++b) { all.push_back(take(tracker, b, local)); }
  };
  for (std::size_t f = 0; f < walks[0]->size(); ++f) {
    for (int b = 0; b < batch; ++b) { give(b, static_cast<int>(f), (*walks[at(b)])[f]); }
    if (f == 0) {
      for (int b = 0; b < batch; ++b) { in.predicted[at(b)] = (*walks[at(b)])[0].T_cw; }
      in.extract(exec);
      keep(false);
      for (int b = 0; b < batch; ++b) { make_map(in, exec, b, how.guests); }
      forget_some();
      continue;
    }
    if (how.by == calls::halves) {
      in.track_motion(exec);
      keep(false);
      in.track_local(exec);
    } else {
      in.track(exec);
    }
    keep(true);
    auto const& r = tracker.result();
    std::copy_n(r.holder, batch * numbers, in.last_holder.begin());
    std::copy_n(r.T_cw, batch, in.last_pose.begin());
    in.predicted = in.last_pose;
    forget_some();
  }
  return all;
}
template <typename Exec, typename Rig, typename Give>
std::vector<snapshot> track(ft::frame_tracker<Exec, Rig>& tracker, Exec const& exec,
                            std::vector<std::vector<stereo_frame> const*> const& walks,
                            Give const& give, walk_options const& how = {}) {
  test::frame_inputs in(tracker);
  return track(in, exec, walks, give, how);
}

/// The same with images that the host copies.
template <typename Exec, typename Rig>
std::vector<snapshot> track(test::frame_inputs<ft::frame_tracker<Exec, Rig>>& in, Exec const& exec,
                            std::vector<std::vector<stereo_frame> const*> const& walks) {
  return track(in, exec, walks,
               [&](int b, int, stereo_frame const& f) { set_images(in.tracker, b, f); });
}
template <typename Exec, typename Rig>
std::vector<snapshot> track(ft::frame_tracker<Exec, Rig>& tracker, Exec const& exec,
                            std::vector<std::vector<stereo_frame> const*> const& walks) {
  test::frame_inputs in(tracker);
  return track(in, exec, walks);
}

template <typename Exec>
std::vector<snapshot> track_alone(Exec const& exec, unsigned seed) {
  ft::frame_tracker<Exec> tracker(exec, rig(), params());
  return track(tracker, exec, {&walk(seed)});
}

}  // namespace test::room
