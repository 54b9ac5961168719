// SPDX-License-Identifier: Apache-2.0
// The search for the points of a keyframe, compared with the loop that defines it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/search/keyframe.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_area.hpp"
#include "tests/support/plain_rotations.hpp"
#include "tests/support/random.hpp"

namespace search_keyframe_test {

using test::at;
using test::generator;

constexpr float width = 640;
constexpr float height = 480;
constexpr int levels = 8;
using pinhole = ft::pinhole<float>;
using fisheye = ft::kannala_brandt<float>;
pinhole const plain_camera{400, 410, 320, 240};
fisheye const wide_camera{200, 205, 320, 240, 0.02f, -0.003f, 0.001f, 0};

struct point {
  ft::vec3<float> position;
  float least, most;  ///< distances, metres
  ft::descriptor orb;
  bool found;
};
struct keypoint {
  float x, y, angle;
  int octave;
  ft::descriptor orb;
  int holder;
};
/// A batch entry: keypoints of each camera.
struct entry {
  ft::pose T_cw = ft::pose::identity();
  std::vector<point> points;
  std::vector<keypoint> keyframe[2], frame[2];
};
struct outcome {
  std::vector<int> holder[2];
  int count = 0;
};

/// How often the oracle met what the scenes are made for.
struct tally {
  long placed = 0;
  long contested = 0;  ///< the nearest keypoint was taken in this very search
  long occupied = 0;   ///< it held a point before
  long behind = 0;     ///< points behind the camera with a window in the image
  long twice = 0;      ///< points placed twice
  long exhausted = 0;  ///< none of the nearest that a list holds was free
  long equal = 0;      ///< the first of equals was taken
  long dropped = 0;
};

// ---- the rule, told plainly -------------------------------------------------------------------

ft::projection<ft::strict_float> project(pinhole const& c, ft::vec3<ft::strict_float> p) {
  auto const x = ft::strict_float(c.fx) * p.x / p.z + c.cx;
  auto const y = ft::strict_float(c.fy) * p.y / p.z + c.cy;
  return {{x, y}, std::isfinite(x.value) && std::isfinite(y.value)};
}
ft::projection<ft::strict_float> project(fisheye const& c, ft::vec3<ft::strict_float> p) {
  return c.cast<ft::strict_float>().project(p);
}

/// Where a point is searched. @return false if nowhere
template <typename Camera>
bool area_of(entry const& e, point const& p, Camera const& camera, float radius, tally& t,
             test::plain_area& area) {
  using vector = ft::vec3<ft::strict_float>;
  vector const world{p.position.x, p.position.y, p.position.z};
  auto const T = e.T_cw.cast<ft::strict_float>();
  vector const seen = T * world;
  auto const pixel = project(camera, seen);
  area.x = pixel.pixel.x.value;
  area.y = pixel.pixel.y.value;
  if (!pixel.valid || !(area.x >= 0 && area.x <= width && area.y >= 0 && area.y <= height)) {
    return false;
  }
  vector const view = world - T.centre();
  float const distance = std::sqrt(dot(view, view).value);
  if (!(distance >= (ft::strict_float(0.8f) * p.least).value &&
        distance <= (ft::strict_float(1.2f) * p.most).value)) {
    return false;
  }
  auto const logarithm = [](float v) {
    return static_cast<float>(std::log(static_cast<double>(v)));
  };
  float const level = std::ceil(logarithm(p.most / distance) / logarithm(1.2f));
  int const octave = static_cast<int>(std::clamp(level, 0.0f, static_cast<float>(levels - 1)));
  area.radius = radius * ft::pyramid_geometry::make(640, 480, levels, 1.2f).scale[octave];
  area.min_octave = octave - 1;
  area.max_octave = octave + 1;
  t.behind += static_cast<long>(seen.z < ft::strict_float(0.0f));
  return true;
}

/// The keypoint that a point takes, -1 = none.
/// @param held holders in this search @param before those before it
int choose(std::vector<keypoint> const& left, std::vector<int> const& area, point const& p,
           int limit, std::vector<int> const& held, tally& t) {
  int best = 256;
  int taken = -1;
  int nearest = 256;
  int nearest_k = -1;
  std::vector<std::pair<int, bool>> near;  // distance, free
  for (int const k : area) {
    int const distance = ft::hamming(p.orb, left[at(k)].orb);
    if (distance < nearest) {
      nearest = distance;
      nearest_k = k;
    }
    bool const before = left[at(k)].holder >= 0;
    if (distance <= limit && !before) { near.emplace_back(distance, held[at(k)] < 0); }
    if (held[at(k)] >= 0) { continue; }
    t.equal += static_cast<long>(distance == best);
    if (distance < best) {
      best = distance;
      taken = k;
    }
  }
  if (nearest <= limit && held[at(nearest_k)] >= 0) {
    ++(left[at(nearest_k)].holder >= 0 ? t.occupied : t.contested);
  }
  std::stable_sort(near.begin(), near.end(),
                   [](auto const& a, auto const& b) { return a.first < b.first; });
  t.exhausted +=
      static_cast<long>(near.size() > 16 && std::none_of(near.begin(), near.begin() + 16,
                                                         [](auto const& c) { return c.second; }));
  return best <= limit ? taken : -1;
}

template <typename Camera>
outcome plain_search(entry const& e, Camera const& camera, ft::keyframe_search_params const& params,
                     tally& t) {
  auto const grid = ft::grid_geometry::over(0, 0, width, height);
  std::vector<float> x, y;
  std::vector<int> octave;
  outcome out;
  for (int c = 0; c < 2; ++c) {
    for (auto const& k : e.frame[c]) { out.holder[c].push_back(k.holder); }
  }
  for (auto const& k : e.frame[0]) {
    x.push_back(k.x);
    y.push_back(k.y);
    octave.push_back(k.octave);
  }
  std::vector<int> placed;  // keypoints of the frame
  std::vector<test::turned_match> turned;
  std::vector<int> times(e.points.size(), 0);
  for (auto const& side : e.keyframe) {
    for (auto const& from : side) {
      test::plain_area area{};
      if (from.holder < 0 || e.points[at(from.holder)].found ||
          !area_of(e, e.points[at(from.holder)], camera, params.window_radius, t, area)) {
        continue;
      }
      int const k = choose(e.frame[0], keypoints_in(area, grid, x, y, octave),
                           e.points[at(from.holder)], params.max_hamming, out.holder[0], t);
      if (k < 0) { continue; }
      out.holder[0][at(k)] = from.holder;
      placed.push_back(k);
      turned.push_back({from.angle, e.frame[0][at(k)].angle});
      t.twice += static_cast<long>(++times[at(from.holder)] == 2);
    }
  }
  auto const kept = test::kept_rotations(turned);
  for (std::size_t m = 0; m < placed.size(); ++m) {
    bool const stays = !params.orientation_check || kept[m];
    if (!stays) { out.holder[0][at(placed[m])] = -1; }
    out.count += static_cast<int>(stays);
    t.dropped += static_cast<long>(!stays);
  }
  t.placed += out.count;
  return out;
}

// ---- the stage --------------------------------------------------------------------------------

/// Keypoints and their holders in an executor's memory: an image for each camera of each entry.
template <int Cameras, typename Exec>
struct uploaded_keypoints {
  ft::keypoints<Exec::space> kp;
  ft::buffer<int, Exec::space> holder;

  uploaded_keypoints(Exec const& exec, std::vector<entry> const& entries, bool of_keyframe) {
    std::size_t most = 1;
    auto const side = [&](entry const& e, int c) -> std::vector<keypoint> const& {
      return of_keyframe ? e.keyframe[c] : e.frame[c];
    };
    for (auto const& e : entries) { most = std::max({most, side(e, 0).size(), side(e, 1).size()}); }
    int const capacity = static_cast<int>(most) + 2;
    kp = ft::keypoints<Exec::space>(capacity, Cameras * static_cast<int>(entries.size()));
    ft::keypoints<ft::memory_space::host> const host(capacity, kp.batch());
    std::vector<int> held(at(capacity) * at(kp.batch()), -1);
    for (int image = 0; image < kp.batch(); ++image) {
      auto const to = host.view().slice(image);
      auto const& from = side(entries[at(image / Cameras)], image % Cameras);
      *to.count = static_cast<int>(from.size());
      for (std::size_t i = 0; i < from.size(); ++i) {
        int const k = static_cast<int>(i);
        to.x(k) = from[i].x;
        to.y(k) = from[i].y;
        to.angle(k) = from[i].angle;
        to.octave(k) = from[i].octave;
        to.orb(k) = from[i].orb;
        held[at(image) * at(capacity) + i] = from[i].holder;
      }
    }
    ft::copy(exec, kp.view(), host.view());
    holder = test::to_exec(exec, held);
    exec.wait();
  }
};

/// The points of all entries, and which of them are stamped with the number of their entry.
template <typename Exec>
struct uploaded_points {
  ft::map_points<Exec::space> map;
  ft::buffer<int, Exec::space> seen, now;

  uploaded_points(Exec const& exec, std::vector<entry> const& entries) {
    std::size_t most = 1;
    for (auto const& e : entries) { most = std::max(most, e.points.size()); }
    map = ft::map_points<Exec::space>(static_cast<int>(most), static_cast<int>(entries.size()));
    ft::map_points<ft::memory_space::host> const host(map.capacity(), map.batch());
    std::vector<int> stamps(most * entries.size(), 0), numbers;
    for (std::size_t b = 0; b < entries.size(); ++b) {
      auto const to = host.view().slice(static_cast<int>(b));
      auto const& from = entries[b].points;
      numbers.push_back(10 + static_cast<int>(b));
      *to.count = static_cast<int>(from.size());
      for (std::size_t i = 0; i < from.size(); ++i) {
        int const s = static_cast<int>(i);
        to.position(s) = from[i].position;
        to.min_distance(s) = from[i].least;
        to.max_distance(s) = from[i].most;
        to.orb(s) = from[i].orb;
        to.observations(s) = s % 2;  // makes no difference
        stamps[b * most + i] = from[i].found ? numbers.back() : 9 + 2 * (s % 2);
        if (!from[i].found && stamps[b * most + i] == numbers.back()) { stamps[b * most + i] = 0; }
      }
    }
    ft::copy(exec, map.view(), host.view());
    seen = test::to_exec(exec, stamps);
    now = test::to_exec(exec, numbers);
  }
};

template <int Cameras, typename Exec, typename Camera>
std::vector<outcome> search(Exec const& exec, std::vector<entry> const& entries,
                            Camera const& camera, ft::keyframe_search_params const& params,
                            bool parallel = false) {
  uploaded_keypoints<Cameras, Exec> const keyframe(exec, entries, true);
  uploaded_keypoints<Cameras, Exec> const to(exec, entries, false);
  uploaded_points<Exec> const points(exec, entries);
  int const batch = static_cast<int>(entries.size());
  std::vector<ft::pose> poses;
  for (auto const& e : entries) { poses.push_back(e.T_cw); }
  auto const T_cw = test::to_exec(exec, poses);
  ft::frame_view frame;
  frame.keypoints = to.kp.view();
  frame.cameras = frame.keypoint_step = Cameras;
  frame.batch = batch;
  frame.holder = to.holder.data();
  ft::search_buffers buffers;
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    int const windows = Cameras * keyframe.kp.capacity();
    carve(c, frame.grids, ft::grid_geometry::over(0, 0, width, height), to.kp.capacity(),
          to.kp.batch());
    carve(c, buffers.windows, windows, batch, Cameras);
    carve(c, buffers.work, windows, to.kp.capacity(), batch, Cameras);
  });
  ft::build_grid<ft::nearest_cell>(exec, frame.keypoints, 0, 1, to.kp.batch(), frame.grids);
  ft::keyframe_search<Camera, Cameras> in;
  in.camera = camera;
  in.T_cw = T_cw.data();
  in.keyframe = {keyframe.kp.view(), Cameras, Cameras, keyframe.holder.data()};
  in.found = {points.now.data(), points.seen.data()};
  in.frustum.max_x = width;
  in.frustum.max_y = height;
  in.frustum.levels = levels;
  in.frustum.log_scale_factor = ft::log_rounded(1.2f);
  in.geometry = ft::pyramid_geometry::make(640, 480, levels, 1.2f);
  in.params = params;
  auto const map = points.map.view();
  if (parallel) {  // on the host, too, the form of a device
    using windows = ft::detail::keyframe_windows<Camera, Cameras>;
    ft::for_each_item<ft::per_warp>(exec, batch * buffers.windows.capacity,
                                    ft::detail::list_point<windows>{}, in, frame, map, buffers);
    ft::for_each_item<ft::per_block<ft::detail::assign_threads>>(
        exec, batch, ft::detail::assign_keyframe_points<true>{}, in, frame, map, buffers);
  } else {
    ft::search_keyframe(exec, in, frame, map, buffers);
  }
  auto const holder =
      test::from_exec(exec, static_cast<int const*>(to.holder.data()), to.holder.size());
  auto const count =
      test::from_exec(exec, static_cast<int const*>(buffers.work.matches), entries.size());
  std::vector<outcome> got(entries.size());
  for (int b = 0; b < batch; ++b) {
    got[at(b)].count = count[at(b)];
    for (int c = 0; c < Cameras; ++c) {
      auto const row = holder.begin() + (Cameras * b + c) * to.kp.capacity();
      got[at(b)].holder[c].assign(
          row, row + static_cast<std::ptrdiff_t>(entries[at(b)].frame[c].size()));
    }
  }
  return got;
}

template <int Cameras, typename Exec, typename Camera>
void expect_plain(Exec const& exec, std::vector<entry> const& entries, Camera const& camera,
                  ft::keyframe_search_params const& params, tally& t) {
  auto const got = search<Cameras>(exec, entries, camera, params);
  auto const parallel = search<Cameras>(exec, entries, camera, params, true);
  for (std::size_t b = 0; b < entries.size(); ++b) {
    SCOPED_TRACE("entry " + std::to_string(b));
    EXPECT_EQ(parallel[b].count, got[b].count);
    EXPECT_EQ(parallel[b].holder[0], got[b].holder[0]);
    auto const want = plain_search(entries[b], camera, params, t);
    EXPECT_EQ(got[b].count, want.count);
    EXPECT_EQ(got[b].holder[0], want.holder[0]);
    EXPECT_EQ(got[b].holder[1], want.holder[1]);
  }
}

// ---- scenes -----------------------------------------------------------------------------------

point random_point(generator& random, ft::descriptor const& near) {
  float const depth = random.chance(10) ? random.real(-9, 0) : random.real(2, 20);
  ft::vec3<float> p{depth * random.real(-0.9f, 0.9f), depth * random.real(-0.7f, 0.7f), depth};
  if (random.chance(2)) { p.y = std::numeric_limits<float>::quiet_NaN(); }
  if (random.chance(2)) { p.z = 0; }
  float const distance = std::sqrt(ft::dot(p, p));
  float const most = distance * random.real(0.7f, 5);
  return {p, most / 4, most, random.flipped(near, random.below(60)), random.chance(10)};
}

template <typename Camera>
entry random_entry(unsigned seed, Camera const& camera, int cameras) {
  generator random(seed);
  entry e;
  float const turn = random.real(-0.03f, 0.03f);
  e.T_cw.R = {{std::cos(turn), -std::sin(turn), 0, std::sin(turn), std::cos(turn), 0, 0, 0, 1}};
  e.T_cw.t = {random.real(-0.1f, 0.1f), random.real(-0.1f, 0.1f), random.real(-0.1f, 0.1f)};
  std::vector<ft::descriptor> near;
  for (int i = random.from_to(1, 5); i > 0; --i) { near.push_back(random.descriptor()); }
  auto const any = [&] { return near[at(random.below(static_cast<int>(near.size())))]; };
  bool const alike = random.chance(30);  // rotations mostly in one bin
  auto const angle = [&] {
    return alike && random.chance(95) ? random.real(0, 10) : random.real(0, 360);
  };
  bool const crowded = random.chance(30);  // few places in the image
  int const n = random.chance(10) ? 0 : random.from_to(1, 150);
  for (int i = 0; i < n; ++i) {
    e.points.push_back(random_point(random, any()));
    if (crowded && i > 2) { e.points.back().position = e.points[at(i % 3)].position; }
  }
  for (int c = 0; c < cameras; ++c) {
    for (int i = random.below(150); i > 0; --i) {
      int const held = n > 0 && random.chance(80) ? random.below(n) : -1;
      e.keyframe[c].push_back({0, 0, angle(), 77, {}, held});
    }
    for (int i = random.below(150); i > 0; --i) {
      float x = random.real(0, width);
      float y = random.real(0, height);
      if (n > 0 && random.chance(80)) {
        auto const& p = e.points[at(random.below(n))].position;
        auto const seen = project(camera, (e.T_cw * p).template cast<ft::strict_float>());
        if (seen.valid) {
          x = seen.pixel.x.value + random.real(-12, 12);
          y = seen.pixel.y.value + random.real(-12, 12);
        }
      }
      e.frame[c].push_back({x, y, angle(), random.below(levels),
                            random.flipped(any(), random.below(40)),
                            n > 0 && random.chance(20) ? random.below(n) : -1});
    }
  }
  return e;
}

template <typename Backend>
class search_keyframe : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <int Cameras, typename Camera>
  void compare(Camera const& camera) {
    tally t;
    int const scenes = test::effort(200);
    for (int i = 0; i < scenes; ++i) {
      SCOPED_TRACE("scene " + std::to_string(i));
      std::vector<entry> entries;
      for (int b = 0; b < 1 + i % 3; ++b) {
        entries.push_back(random_entry(static_cast<unsigned>(10 * i + b), camera, Cameras));
      }
      ft::keyframe_search_params params;
      params.window_radius = i % 2 == 0 ? 10.0f : 3.0f;
      params.max_hamming = i % 2 == 0 ? 100 : 64;
      params.orientation_check = i % 3 != 0;
      expect_plain<Cameras>(backend.exec, entries, camera, params, t);
      if (this->HasFailure()) { return; }
    }
    if (scenes < 200) { return; }
    EXPECT_GT(t.placed, 500);
    EXPECT_GT(t.contested, 300);
    EXPECT_GT(t.occupied, 300);
    EXPECT_GT(t.behind, 100);
    EXPECT_GT(t.twice, 30);
    EXPECT_GT(t.exhausted, 30);
    EXPECT_GT(t.equal, 30);
    EXPECT_GT(t.dropped, 100);
  }
};
TYPED_TEST_SUITE(search_keyframe, test::backends);

TYPED_TEST(search_keyframe, equals_the_loop_with_one_camera) {
  this->template compare<1>(plain_camera);
}
TYPED_TEST(search_keyframe, equals_the_loop_with_two_fisheye_cameras) {
  this->template compare<2>(wide_camera);
}

/// A point at 5 m straight ahead, held by one keypoint; `frame` sees it in the middle.
entry one_point() {
  entry e;
  e.points.push_back({{0, 0, 5}, 1, 5, {}, false});
  e.keyframe[0].push_back({0, 0, 0, 0, {}, 0});
  e.frame[0].push_back({320, 240, 0, 0, {}, -1});
  return e;
}

TYPED_TEST(search_keyframe, windows_and_distances_end_where_the_rule_says) {
  auto const finds = [&](entry const& e) {
    return search<1>(this->backend.exec, {e}, plain_camera, {})[0].count == 1;
  };
  EXPECT_TRUE(finds(one_point()));
  for (auto const& [x, found] : {std::pair<float, bool>{329.99f, true}, {330, false}}) {
    entry e = one_point();
    e.frame[0][0].x = x;
    EXPECT_EQ(finds(e), found) << x;
  }
  for (int octave = 0; octave < levels; ++octave) {
    entry e = one_point();
    e.points[0].most = 5 * 1.2f * 1.2f * 1.1f;  // expected in octave 3
    e.frame[0][0].octave = octave;
    EXPECT_EQ(finds(e), octave >= 2 && octave <= 4) << octave;
  }
  for (auto const& [bits, found] : {std::pair<int, bool>{100, true}, {101, false}}) {
    entry e = one_point();
    for (int b = 0; b < bits; ++b) { e.frame[0][0].orb.words[b / 32] |= 1u << (b % 32); }
    EXPECT_EQ(finds(e), found) << bits;
  }
  for (float const most : {4.16f, 4.17f}) {  // 5 / 1.2
    entry e = one_point();
    e.points[0].most = most;
    EXPECT_EQ(finds(e), most > 4.165f) << most;
  }
  for (float const least : {6.24f, 6.26f}) {  // 5 / 0.8
    entry e = one_point();
    e.points[0].least = least;
    EXPECT_EQ(finds(e), least < 6.25f) << least;
  }
  entry e = one_point();
  e.points[0].position.z = -5;  // the axis goes through the middle behind the camera, too
  EXPECT_TRUE(finds(e));
  e.points[0].found = true;
  EXPECT_FALSE(finds(e));
}

TYPED_TEST(search_keyframe, equal_descriptors_go_to_the_first_of_the_grid) {
  entry e = one_point();
  e.frame[0].insert(e.frame[0].begin(), {325, 240, 0, 0, {}, -1});
  e.keyframe[0].push_back(e.keyframe[0][0]);
  e.keyframe[0].push_back(e.keyframe[0][0]);
  e.points.push_back(e.points[0]);
  e.keyframe[0][1].holder = 1;
  // Both keypoints are in one cell, or the first one is in a later column. Either way the third
  // keypoint of the keyframe finds nothing left.
  auto const got = search<1>(this->backend.exec, {e}, plain_camera, {})[0];
  EXPECT_EQ(got.count, 2);
  EXPECT_EQ(got.holder[0], (std::vector<int>{1, 0}));
}

TYPED_TEST(search_keyframe, nothing_is_found_without_points_or_keypoints) {
  std::vector<entry> entries(3, one_point());
  entries[0].keyframe[0].clear();
  entries[1].frame[0].clear();
  entries[2].keyframe[0][0].holder = -1;
  for (auto const& o : search<1>(this->backend.exec, entries, plain_camera, {})) {
    EXPECT_EQ(o.count, 0);
  }
}

TYPED_TEST(search_keyframe, refuses_views_of_another_shape) {
  auto const& exec = this->backend.exec;
  ft::keyframe_search<pinhole> in;
  in.frustum.levels = levels;
  in.frustum.log_scale_factor = ft::log_rounded(1.2f);
  ft::frame_view frame;
  frame.batch = 0;
  ft::search_buffers buffers;
  EXPECT_NO_THROW(ft::search_keyframe(exec, in, frame, {}, buffers));
  in.keyframe.keypoints.capacity = 5;
  EXPECT_THROW(ft::search_keyframe(exec, in, frame, {}, buffers), ft::bad_argument);
  in.keyframe.keypoints.capacity = 0;
  frame.cameras = 2;
  EXPECT_THROW(ft::search_keyframe(exec, in, frame, {}, buffers), ft::bad_argument);
  frame.cameras = 1;
  buffers.windows.cameras = 2;
  EXPECT_THROW(ft::search_keyframe(exec, in, frame, {}, buffers), ft::bad_argument);
  buffers.windows.cameras = 1;
  in.frustum.levels = 0;
  EXPECT_THROW(ft::search_keyframe(exec, in, frame, {}, buffers), ft::bad_argument);
  in.frustum.levels = levels;
  in.frustum.log_scale_factor = 0;
  EXPECT_THROW(ft::search_keyframe(exec, in, frame, {}, buffers), ft::bad_argument);
}

TYPED_TEST(search_keyframe, distances_without_a_number_are_none) {
  float const infinity = std::numeric_limits<float>::infinity();
  entry far = one_point();
  far.points[0] = {{0, 0, 1e30f}, 0, infinity, {}, false};  // the square of its distance overflows
  entry without = one_point();
  without.points[0].most = std::numeric_limits<float>::quiet_NaN();
  entry here = one_point();
  here.points[0] = {{0, 0, 0}, 0, 0, {}, false};
  for (auto const& o : search<1>(this->backend.exec, {far, without, here}, plain_camera, {})) {
    EXPECT_EQ(o.count, 0);
  }
}

}  // namespace search_keyframe_test
