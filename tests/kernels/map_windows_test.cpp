// SPDX-License-Identifier: Apache-2.0
// Windows of a map: what is gathered, and what a result changes, against plain loops; also where
// the map has changed meanwhile.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <map>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "ft/kernels/map/apply_window.hpp"
#include "ft/kernels/map/gather_window.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random_maps.hpp"

namespace map_windows_test {

constexpr int batch = 3;
constexpr int positions = 20;
constexpr int keypoints = 60;
constexpr int slots = 500;

struct windows {
  ft::window_problem_view problem;
  ft::window_sources_view sources;
  int* flags = nullptr;
  ft::rigid<double>* T_cw = nullptr;
};

template <typename Exec>
struct room {
  Exec const& exec;
  int cameras;
  test::mirrored<Exec, ft::odometry_map_view> map;
  test::mirrored<Exec, windows> in;
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(640, 480, 4, 1.2f);
  std::vector<test::plain_map> plain;

  room(Exec const& executor, int camera_count, int points)
      : exec(executor),
        cameras(camera_count),
        map([&](ft::carver& c, ft::odometry_map_view& v) {
          carve(c, v, {slots, {positions, camera_count, keypoints}}, batch);
        }),
        in([&](ft::carver& c, windows& v) {
          ft::window_capacity const size{9, points, camera_count};
          carve(c, v.problem, size, batch);
          carve(c, v.sources, size, slots, batch);
          v.flags = c.take<int>(batch);
          v.T_cw = c.take<ft::rigid<double>>(batch);
        }) {
    clear(exec, map.device);
    map.pull(exec);
    in.pull(exec);
  }
  void write() {
    for (int b = 0; b < batch; ++b) { test::write_map(plain[test::index(b)], map.host, b); }
    map.push(exec);
    in.push(exec);
  }
};

/// The gathered views and points, with their observations.
struct plain_window {
  std::vector<int> keyframes;
  int fixed = 0;
  std::vector<int> slots;
  int left_out = 0;
};

inline plain_window plain_gather(test::plain_map const& m, ft::window_selection const& params,
                                 int room_for) {
  plain_window w;
  int const count = static_cast<int>(m.keyframes.size());
  int const begin = std::max(0, count - params.moving - params.fixed);
  int const moving = std::min(count, std::max(begin + 1, count - params.moving));  // the first one
  w.fixed = moving - begin;
  int i = 0;
  std::set<int> seen;
  for (auto const& [n, f] : m.keyframes) {
    if (i >= begin) { w.keyframes.push_back(n); }
    for (std::size_t s = 0; i >= moving && s < m.points.size(); ++s) {
      if (m.points[s].seen_by.count(n) != 0) { seen.insert(static_cast<int>(s)); }
    }
    ++i;
  }
  for (int const s : seen) {
    if (static_cast<int>(w.slots.size()) < room_for) {
      w.slots.push_back(s);
    } else {
      ++w.left_out;
    }
  }
  return w;
}

/// Number of the keypoint of a camera that observes a point; -1 = none.
inline int observer(test::plain_map const& m, int keyframe, int camera, int slot) {
  auto const& all = m.keyframes.at(keyframe).cameras[test::index(camera)];
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (all[i].holder == slot && all[i].holder_number == m.points[test::index(slot)].number) {
      return static_cast<int>(i);
    }
  }
  return -1;
}

template <typename Exec>
void expect_gathered(room<Exec> const& r, plain_window const& w, int b) {
  auto const& p = r.in.host.problem;
  auto const& from = r.in.host.sources;
  auto const& m = r.plain[test::index(b)];
  ASSERT_EQ(p.view_count[b], static_cast<int>(w.keyframes.size()));
  EXPECT_EQ(p.fixed_count[b], w.fixed);
  ASSERT_EQ(p.point_count[b], static_cast<int>(w.slots.size()));
  EXPECT_EQ(from.left_out[b], w.left_out);
  for (int v = 0; v < p.view_count[b]; ++v) {
    int const n = w.keyframes[test::index(v)];
    EXPECT_EQ(from.keyframe[p.view(b, v)], n);
    EXPECT_EQ(p.T_cw[p.view(b, v)].t.x, m.keyframes.at(n).T_cw.t.x);
    EXPECT_EQ(p.T_cw[p.view(b, v)].R.m[5], m.keyframes.at(n).T_cw.R.m[5]);
    for (int i = 0; i < p.point_count[b]; ++i) {
      int const slot = w.slots[test::index(i)];
      for (int c = 0; c < r.cameras; ++c) {
        auto const at = p.sighting(b, i, v, c);
        int const k = observer(m, n, c, slot);
        ASSERT_EQ(p.seen[at].inv_sigma2 > 0, k >= 0);
        if (k < 0) { continue; }
        auto const& q = m.keyframes.at(n).cameras[test::index(c)][test::index(k)];
        EXPECT_EQ(from.keypoint[at], c * keypoints + k);
        EXPECT_EQ(p.seen[at].x, q.x);
        EXPECT_EQ(p.seen[at].y, q.y);
        EXPECT_EQ(p.seen[at].right_x, q.right_x);
        EXPECT_NEAR(p.seen[at].inv_sigma2 / (q.aligned ? 16.0f : 1.0f),
                    std::pow(1.2, -2 * q.octave), 1e-6);
      }
    }
  }
  for (int i = 0; i < p.point_count[b]; ++i) {
    auto const& point = m.points[test::index(w.slots[test::index(i)])];
    EXPECT_EQ(from.slot[p.point(b, i)], w.slots[test::index(i)]);
    EXPECT_EQ(from.number[p.point(b, i)], point.number);
    EXPECT_EQ(p.position[p.point(b, i)].x, static_cast<double>(point.position.x));
    EXPECT_EQ(p.position[p.point(b, i)].z, static_cast<double>(point.position.z));
  }
}

template <typename Exec>
void gather(room<Exec>& r, ft::window_selection const& params) {
  r.write();
  ft::gather_window(r.exec, {r.in.device.flags, r.geometry, params}, r.map.device,
                    r.in.device.problem, r.in.device.sources);
  r.in.pull(r.exec);
}

template <typename Backend>
class MapWindows : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(MapWindows, test::backends);

TYPED_TEST(MapWindows, AreTheNewestKeyframesAndTheirPoints) {
  TypeParam backend;
  int untouched = 0;
  for (int trial = 0; trial < test::effort(40); ++trial) {
    SCOPED_TRACE("trial " + std::to_string(trial));
    std::mt19937 random(static_cast<unsigned>(trial));
    int const points = trial % 3 == 0 ? 20 : slots;
    ft::window_selection const params{1 + trial % 5, trial % 4};
    room<typename TypeParam::exec_type> r(backend.exec, 1 + trial / 2 % 3, points);
    for (int b = 0; b < batch; ++b) {
      int const keyframes = (trial + 7 * b) % (positions + 1);
      test::random_map_sizes const size{slots,     positions, r.cameras,
                                        keypoints, keyframes, trial % 5 == 4 ? 0u : 50u};
      r.plain.push_back(test::random_map(random, size));
      r.in.host.flags[b] = static_cast<int>(random() % 4 != 0);
      r.in.host.problem.view_count[b] = -7;
      r.in.host.problem.point_count[b] = -7;
    }
    gather(r, params);
    for (int b = 0; b < batch; ++b) {
      if (r.in.host.flags[b] == 0) {
        EXPECT_EQ(r.in.host.problem.view_count[b], -7);
        EXPECT_EQ(r.in.host.problem.point_count[b], -7);
        ++untouched;
        continue;
      }
      expect_gathered(r, plain_gather(r.plain[test::index(b)], params, points), b);
    }
    if (::testing::Test::HasFailure()) { return; }
  }
  EXPECT_GT(untouched, 0);
}

inline ft::rigid<double> plain_inverse(ft::rigid<double> const& T) {
  auto const R = T.R.transposed();
  return {R, -(R * T.t)};
}

/// Makes results for a gathered problem: small motions, some points far away or without a number.
inline void randomize_results(std::mt19937& random, ft::window_problem_view const& p, int b) {
  std::uniform_real_distribution<double> in(-0.1, 0.1);
  p.outcome[b] = {2, 1, 3, static_cast<int>(random() % 8 != 0)};
  for (int v = p.fixed_count[b]; v < p.view_count[b]; ++v) {
    auto& T = p.T_cw[p.view(b, v)];
    T = test::random_motion(random, 0.01, 0.05) * T;
  }
  for (int i = 0; i < p.point_count[b]; ++i) {
    auto& at = p.position[p.point(b, i)];
    double const factor = random() % 6 == 0 ? (random() % 2 == 0 ? 4 : 0.1) : 1;
    at = {factor * at.x + in(random), factor * at.y + in(random), factor * at.z + in(random)};
    if (random() % 20 == 0) { at.y = NAN; }
    unsigned const rarely = random() % 5 == 0 ? 1 : 8;  // some points lose all
    for (int v = 0; v < p.view_count[b]; ++v) {
      for (int c = 0; c < p.cameras; ++c) {
        auto const to = p.sighting(b, i, v, c);
        bool const is_seen = p.seen[to].inv_sigma2 > 0;
        bool const pixel = is_seen && random() % rarely == 0;
        bool const right = is_seen && random() % 8 == 0;
        p.outlier[to] = static_cast<unsigned char>((pixel ? ft::outlying_pixel : 0) |
                                                   (right ? ft::outlying_right : 0));
      }
    }
  }
}

/// What happens to a map between gathering and applying: keyframes come and go, points are removed,
/// their slots reused.
inline void change_map(std::mt19937& random, test::plain_map& m, int cameras) {
  int const first = m.keyframes_made + 1;
  for (unsigned n = static_cast<unsigned>(random() % 4); n > 0; --n) {
    test::add_random_keyframe(random, m, cameras);
  }
  while (static_cast<int>(m.keyframes.size()) > m.positions ||
         (m.keyframes.size() > 1 && random() % 3 == 0)) {
    int const old = m.keyframes.begin()->first;
    m.keyframes.erase(old);
    for (auto& p : m.points) {
      if (p.seen_by.erase(old) != 0 && p.seen_by.empty()) { p = {}; }
      p.observations = static_cast<int>(p.seen_by.size());
    }
  }
  for (auto& p : m.points) {
    if (p.number != 0 && random() % 15 == 0) { p = {}; }
  }
  for (int s = 0; s < slots && m.keyframes_made >= first; ++s) {
    if (m.points[test::index(s)].number == 0 && random() % 3 == 0) {
      test::add_random_point(random, m, s, first);
    }
  }
}

inline double distance(ft::vec3<double> a, ft::vec3<double> b) {
  return std::sqrt((a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y) +
                   (a.z - b.z) * (a.z - b.z));
}
inline ft::vec3<double> wide(ft::vec3<float> v) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
}
inline ft::vec3<float> narrow(ft::vec3<double> v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

/// The plain loop of apply_window.
class plain_application {
public:
  plain_application(windows const& in, test::plain_map& m, int b) : in_(in), m_(m), b_(b) {}

  void run(ft::rigid<double>& T_cw) {
    auto const& p = in_.problem;
    int const views = p.view_count[b_];
    if (in_.flags[b_] == 0 || views < 1 || p.outcome[b_].valid == 0) { return; }
    int const last = keyframe(views - 1);
    if (m_.keyframes.count(last) == 0) { return; }
    auto const to = plain_inverse(m_.keyframes.at(last).T_cw) * p.T_cw[p.view(b_, views - 1)];
    T_cw = T_cw * to;
    for (auto& [n, f] : m_.keyframes) {
      if (n > last) { f.T_cw = f.T_cw * to; }
    }
    for (int v = p.fixed_count[b_]; v < views; ++v) {
      auto const found = m_.keyframes.find(keyframe(v));
      if (found != m_.keyframes.end()) { found->second.T_cw = p.T_cw[p.view(b_, v)]; }
    }
    for (auto& point : m_.points) {
      if (point.number != 0 && *point.seen_by.begin() > last) {
        point.position = narrow(plain_inverse(to) * wide(point.position));
        point.normal = narrow(plain_inverse(to).R * wide(point.normal));
      }
    }
    for (int i = 0; i < p.point_count[b_]; ++i) {
      auto& point = m_.points[test::index(in_.sources.slot[p.point(b_, i)])];
      if (point.number != in_.sources.number[p.point(b_, i)]) { continue; }
      move(point, p.position[p.point(b_, i)]);
      drop(point, i);
    }
  }

private:
  int keyframe(int v) const { return in_.sources.keyframe[in_.problem.view(b_, v)]; }

  void move(test::plain_point& point, ft::vec3<double> to) const {
    auto const centre = plain_inverse(m_.keyframes.at(*point.seen_by.begin()).T_cw).t;
    double const factor =
        distance(wide(narrow(to)), centre) / distance(wide(point.position), centre);
    if (std::isnan(factor) || factor <= 0.5 || factor >= 2) { return; }
    point.position = narrow(to);
    point.least *= static_cast<float>(factor);
    point.most *= static_cast<float>(factor);
  }
  void drop(test::plain_point& point, int i) {
    auto const& p = in_.problem;
    int const slot = in_.sources.slot[p.point(b_, i)];
    for (int v = 0; v < p.view_count[b_]; ++v) {
      auto const found = m_.keyframes.find(keyframe(v));
      if (found == m_.keyframes.end()) { continue; }
      bool sees = false;
      for (int c = 0; c < p.cameras; ++c) {
        for (auto& k : found->second.cameras[test::index(c)]) {
          if (k.holder != slot || k.holder_number != point.number) { continue; }
          int const outlier = p.outlier[p.sighting(b_, i, v, c)];
          if ((outlier & ft::outlying_pixel) != 0) {
            k.holder = -1;
            k.holder_number = 0;
          } else {
            sees = true;
            if ((outlier & ft::outlying_right) != 0) { k.right_x = -1; }
          }
        }
      }
      if (!sees) { point.seen_by.erase(keyframe(v)); }
    }
    point.observations = static_cast<int>(point.seen_by.size());
    if (point.seen_by.empty()) { point = {}; }
  }

  windows const& in_;
  test::plain_map& m_;
  int b_;
};

TYPED_TEST(MapWindows, ResultsChangeWhatIsStillThere) {
  using exec_type = typename TypeParam::exec_type;
  TypeParam backend;
  int freed = 0;
  for (int trial = 0; trial < test::effort(60); ++trial) {
    SCOPED_TRACE("trial " + std::to_string(trial));
    std::mt19937 random(1000 + static_cast<unsigned>(trial));
    room<exec_type> r(backend.exec, 1 + trial / 2 % 3, slots);
    for (int b = 0; b < batch; ++b) {
      test::random_map_sizes const size{
          slots, positions, r.cameras, keypoints, 1 + (trial + 5 * b) % positions, 50};
      r.plain.push_back(test::random_map(random, size));
      r.in.host.flags[b] = 1;
    }
    gather(r, {5, 3});
    for (int b = 0; b < batch; ++b) {
      auto& m = r.plain[test::index(b)];
      randomize_results(random, r.in.host.problem, b);
      if (trial % 3 != 0) { change_map(random, m, r.cameras); }
      r.in.host.flags[b] = static_cast<int>(random() % 5 != 0);
      r.in.host.T_cw[b] = test::random_motion(random, 1, 3);
    }
    r.write();
    ft::apply_window(r.exec, r.in.device.flags, r.in.device.problem, r.in.device.sources,
                     r.map.device, r.in.device.T_cw);
    std::vector<ft::rigid<double>> T_cw(r.in.host.T_cw, r.in.host.T_cw + batch);
    auto const last = T_cw;
    for (int b = 0; b < batch; ++b) {
      auto& m = r.plain[test::index(b)];
      int const before = m.alive();
      plain_application(r.in.host, m, b).run(T_cw[test::index(b)]);
      freed += before - m.alive();
    }
    r.map.pull(r.exec);
    r.in.pull(r.exec);
    for (int b = 0; b < batch; ++b) {
      SCOPED_TRACE("batch entry " + std::to_string(b));
      auto const found = test::read_map(r.map.host, b);
      test::expect_same_map(found, r.plain[test::index(b)], 3e-6f);
      test::expect_consistent(found);
      for (int i = 0; i < 9; ++i) {
        EXPECT_NEAR(r.in.host.T_cw[b].R.m[i], T_cw[test::index(b)].R.m[i], 1e-9);
      }
      EXPECT_NEAR(r.in.host.T_cw[b].t.x, T_cw[test::index(b)].t.x, 1e-9);
      EXPECT_NEAR(r.in.host.T_cw[b].t.z, T_cw[test::index(b)].t.z, 1e-9);
      // The correction is told, also where there is none.
      auto const moved = last[test::index(b)] * r.in.host.sources.correction[b];
      for (int i = 0; i < 9; ++i) { EXPECT_NEAR(moved.R.m[i], T_cw[test::index(b)].R.m[i], 1e-9); }
      EXPECT_NEAR(moved.t.x, T_cw[test::index(b)].t.x, 1e-9);
      EXPECT_NEAR(moved.t.z, T_cw[test::index(b)].t.z, 1e-9);
    }
    if (::testing::Test::HasFailure()) { return; }
  }
  EXPECT_GT(freed, 0) << "points that lost their last observation";
}

}  // namespace map_windows_test
