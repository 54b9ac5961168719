// SPDX-License-Identifier: Apache-2.0
// The start with one camera: which frames become the first one, when it is forgotten, and the pair
// that makes a reconstruction.
#include "ft/pipelines/monocular_start.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/random.hpp"
#include "tests/support/two_view_scene.hpp"

namespace monocular_start_test {

using ft::start_outcome;
using ft::two_view_status;
using test::at;
using vec3d = ft::vec3<double>;

constexpr int capacity = 160;
constexpr float width = 740;
constexpr float height = 500;

/// The frame of one camera.
struct frame {
  std::vector<test::two_view_pixel> pixels;
  std::vector<ft::descriptor> orb;
  double time_s = 0;
};

/// Points with descriptors.
struct world {
  std::vector<vec3d> points;
  std::vector<ft::descriptor> orb;

  world(unsigned seed, int count) {
    test::generator random(seed);
    auto const real = [&](float low, float high) {
      return static_cast<double>(random.real(low, high));
    };
    for (int i = 0; i < count; ++i) {
      double const x = real(-2.5f, 2.5f);
      double const y = real(-1.5f, 1.5f);
      points.push_back({x, y, real(5, 9)});
      orb.push_back(random.descriptor());
    }
  }
  /// The first `count` points, from a place.
  frame seen_from(ft::rigid<double> const& T, int count, double time_s = 0) const {
    frame f;
    f.time_s = time_s;
    for (int i = 0; i < count; ++i) {
      f.pixels.push_back(test::project({450, 455, 370, 250}, T * points[at(i)]));
      f.orb.push_back(orb[at(i)]);
    }
    return f;
  }
};

ft::rigid<double> aside() { return {test::plain_exp({0.01, -0.02, 0.03}), {0.5, 0.05, -0.04}}; }
ft::rigid<double> turned() { return {test::plain_exp({0.01, -0.02, 0.03}), {0, 0, 0}}; }

struct answer {
  ft::start_report report;
  ft::two_view_result result;
  std::vector<int> match;
  std::vector<ft::vec2<float>> previous;
  std::vector<std::uint8_t> flags;
  std::vector<ft::vec3<float>> points;
};

/// A start of several cameras.
template <typename Exec>
class starter {
public:
  starter(Exec const& exec, int cameras, ft::start_rules const& rules = {})
      : exec_(exec), cameras_(at(cameras)) {
    ft::monocular_start_params params;
    params.rules = rules;
    params.two_views.samples = 60;
    start_ = ft::monocular_start<Exec>(
        exec, params, std::vector<ft::pinhole<float>>(cameras_, {450, 455, 370, 250}),
        ft::grid_geometry::over(0, 0, width, height), capacity);
  }

  std::vector<answer> add(std::vector<frame> const& frames) {
    std::size_t const n = cameras_ * at(capacity);
    std::vector<float> x(n, 1e9f);
    std::vector<float> y(n, 1e9f);
    std::vector<ft::descriptor> orb(n);
    std::vector<int> count;
    std::vector<double> times;
    for (std::size_t b = 0; b < cameras_; ++b) {
      auto const& f = frames.at(b);
      for (std::size_t i = 0; i < f.pixels.size(); ++i) {
        x[b * at(capacity) + i] = f.pixels[i].x;
        y[b * at(capacity) + i] = f.pixels[i].y;
        orb[b * at(capacity) + i] = f.orb[i];
      }
      count.push_back(static_cast<int>(f.pixels.size()));
      times.push_back(f.time_s);
    }
    ft::keypoints<Exec::space> const keypoints(capacity, static_cast<int>(cameras_));
    auto const view = keypoints.view();
    fill(exec_, view, 0);
    test::set_pixels(exec_, view, x, y, count);
    ft::copy(exec_, ft::array_of<ft::field::orb>(view), orb.data(), orb.size());
    auto const d_times = test::to_exec(exec_, times);
    start_.add(exec_, {view, view, d_times.data()});
    return read();
  }
  answer add(frame const& f) { return add(std::vector<frame>{f})[0]; }
  void restart() { start_.restart(exec_); }
  ft::monocular_start<Exec>& start() { return start_; }

private:
  std::vector<answer> read() const {
    std::vector<answer> all;
    for (std::size_t b = 0; b < cameras_; ++b) {
      auto const n = at(capacity);
      auto const from = b * n;
      auto const views = start_.reconstructions();
      all.push_back({test::from_exec(exec_, start_.reports() + b, 1)[0],
                     test::from_exec(exec_, views.result + b, 1)[0],
                     test::from_exec(exec_, start_.matches().match + from, n),
                     test::from_exec(exec_, start_.matches().previous + from, n),
                     test::from_exec(exec_, views.flags + from, n),
                     test::from_exec(exec_, views.point + from, n)});
    }
    return all;
  }

  Exec exec_;
  std::size_t cameras_;
  ft::monocular_start<Exec> start_;
};

template <typename Backend>
class MonocularStart : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(MonocularStart, test::backends);

TYPED_TEST(MonocularStart, TakesTwoFramesThatMakeAReconstruction) {
  TypeParam backend;
  world const scene(1, 150);
  starter<typename TypeParam::exec_type> start(backend.exec, 1);
  EXPECT_EQ(start.add(scene.seen_from(turned(), 150)).report.outcome, start_outcome::took_first);
  auto const got = start.add(scene.seen_from(aside() * turned(), 150));
  ASSERT_EQ(got.report.outcome, start_outcome::started);
  EXPECT_EQ(got.report.two_views, two_view_status::reconstructed);
  EXPECT_LT(test::rotation_error(got.result.T_21, aside()), 0.01);
  EXPECT_LT(test::direction_error(got.result.T_21, aside()), 0.05);
  int matches = 0;
  double const unit = std::sqrt(dot(aside().t, aside().t));
  for (std::size_t i = 0; i < 150; ++i) {
    if (got.match[i] < 0) { continue; }
    ++matches;
    EXPECT_EQ(got.match[i], static_cast<int>(i));
    EXPECT_NE(got.flags[i] & ft::two_view_flag::triangulated, 0u);
    vec3d const want = turned() * scene.points[i];
    vec3d const have = got.points[i].template cast<double>();
    EXPECT_NEAR(have.z * unit, want.z, 0.02);
  }
  EXPECT_EQ(got.report.matches, matches);
  EXPECT_EQ(got.result.triangulated, matches);
  EXPECT_GE(matches, 100);
  // A caller whose map fails goes on.
  EXPECT_EQ(start.add(scene.seen_from(turned(), 150)).report.outcome, start_outcome::took_first);
}

TYPED_TEST(MonocularStart, NeedsMoreThanAHundredKeypoints) {
  TypeParam backend;
  world const scene(2, 150);
  starter<typename TypeParam::exec_type> start(backend.exec, 1);
  auto const outcome = [&](int count) {
    auto const got = start.add(scene.seen_from(turned(), count));
    EXPECT_EQ(got.report.keypoints, count);
    return got.report.outcome;
  };
  EXPECT_EQ(outcome(0), start_outcome::waiting);
  EXPECT_EQ(outcome(100), start_outcome::waiting);
  EXPECT_EQ(outcome(101), start_outcome::took_first);
  EXPECT_EQ(outcome(100), start_outcome::forgot_first);
  EXPECT_EQ(outcome(100), start_outcome::waiting);
  EXPECT_EQ(outcome(150), start_outcome::took_first);
  // The frame that makes the first one forgotten does not become the first one.
  EXPECT_EQ(outcome(0), start_outcome::forgot_first);
  EXPECT_EQ(outcome(150), start_outcome::took_first);
  start.restart();
  EXPECT_EQ(outcome(150), start_outcome::took_first);
}

TYPED_TEST(MonocularStart, ForgetsAFrameThatHasFewMatches) {
  TypeParam backend;
  world const scene(3, 150);
  starter<typename TypeParam::exec_type> start(backend.exec, 1);
  // The later frame has other descriptors for some of the points.
  for (int const same : {99, 100}) {
    world other = scene;
    test::generator random(77);
    for (std::size_t i = at(same); i < 150; ++i) { other.orb[i] = random.descriptor(); }
    EXPECT_EQ(start.add(scene.seen_from(turned(), 150)).report.outcome, start_outcome::took_first);
    auto const got = start.add(other.seen_from(turned(), 150));
    EXPECT_EQ(got.report.matches, same);
    EXPECT_EQ(got.report.outcome,
              same == 99 ? start_outcome::few_matches : start_outcome::no_motion);
    EXPECT_EQ(got.result.status == two_view_status::too_few_matches, same == 99);
  }
}

TYPED_TEST(MonocularStart, KeepsTheFirstFrameWhileThereIsNoMotion) {
  TypeParam backend;
  world const scene(4, 150);
  starter<typename TypeParam::exec_type> start(backend.exec, 1);
  start.add(scene.seen_from(ft::rigid<double>::identity(), 150));
  auto const still = start.add(scene.seen_from(turned(), 150));
  EXPECT_EQ(still.report.outcome, start_outcome::no_motion);
  EXPECT_NE(still.report.two_views, two_view_status::reconstructed);
  // Searches go on from where keypoints were found.
  auto const now = scene.seen_from(turned(), 150);
  for (std::size_t i = 0; i < 150; ++i) {
    if (still.match[i] < 0) { continue; }
    EXPECT_EQ(still.previous[i].x, now.pixels[at(still.match[i])].x);
    EXPECT_EQ(still.previous[i].y, now.pixels[at(still.match[i])].y);
  }
  auto const got = start.add(scene.seen_from(aside(), 150));
  ASSERT_EQ(got.report.outcome, start_outcome::started);
  EXPECT_LT(test::rotation_error(got.result.T_21, aside()), 0.01);  // from the first frame
}

TYPED_TEST(MonocularStart, OfAnInertialCameraIsWithinASecond) {
  TypeParam backend;
  world const scene(5, 150);
  ft::start_rules rules;
  rules.inertial = true;
  double const nan = std::numeric_limits<double>::quiet_NaN();
  for (auto const& [later, want] :
       std::vector<std::pair<double, start_outcome>>{{11.0, start_outcome::started},
                                                     {11.001, start_outcome::forgot_first},
                                                     {nan, start_outcome::forgot_first}}) {
    starter<typename TypeParam::exec_type> start(backend.exec, 1, rules);
    start.add(scene.seen_from(turned(), 150, 10.0));
    EXPECT_EQ(start.add(scene.seen_from(aside(), 150, later)).report.outcome, want);
  }
  // Without an IMU time does not matter.
  starter<typename TypeParam::exec_type> start(backend.exec, 1);
  start.add(scene.seen_from(turned(), 150, 10.0));
  EXPECT_EQ(start.add(scene.seen_from(aside(), 150, 99.0)).report.outcome, start_outcome::started);
}

TYPED_TEST(MonocularStart, OfABatchIsThatOfEachCamera) {
  TypeParam backend;
  world const a(6, 150);
  world const b(7, 150);
  std::vector<std::vector<frame>> const frames{
      {a.seen_from(turned(), 150), b.seen_from(turned(), 90)},
      {a.seen_from(aside(), 150), b.seen_from(turned(), 140)},
      {a.seen_from(turned(), 130), b.seen_from(turned(), 140)},
      {b.seen_from(turned(), 150), b.seen_from(aside(), 140)},
      {b.seen_from(aside(), 150), a.seen_from(aside(), 0)}};
  starter<typename TypeParam::exec_type> together(backend.exec, 2);
  starter<typename TypeParam::exec_type> first(backend.exec, 1);
  starter<typename TypeParam::exec_type> second(backend.exec, 1);
  for (auto const& now : frames) {
    auto const got = together.add(now);
    std::vector<answer> const want{first.add(now[0]), second.add(now[1])};
    for (std::size_t c = 0; c < 2; ++c) {
      EXPECT_EQ(std::memcmp(&got[c].report, &want[c].report, sizeof got[c].report), 0);
      EXPECT_EQ(std::memcmp(&got[c].result, &want[c].result, sizeof got[c].result), 0);
      EXPECT_EQ(got[c].match, want[c].match);
      EXPECT_EQ(got[c].flags, want[c].flags);
    }
  }
}

/// One camera has its keypoints in the order that an overlap of the columns [0, 1000] gives.
TYPED_TEST(MonocularStart, HasTheReversedOrderOfKeypointsFromAnExtractor) {
  TypeParam backend;
  for (int const w : {320, 1100}) {
    int const h = 200;
    ft::orb_params params;
    params.width = w;
    params.height = h;
    params.features = 500;
    auto const image = test::random_image(w, h, 3);
    ft::orb_extractor<typename TypeParam::exec_type> usual(backend.exec, params, 1);
    ft::orb_extractor<typename TypeParam::exec_type> mono(backend.exec, params, 1, {{0, 1000}});
    for (auto* const extractor : {&usual, &mono}) {
      extractor->upload(backend.exec, 0, {image.data(), w, h, w});
      extractor->extract(backend.exec);
    }
    auto const a = usual.download(backend.exec);
    auto const b = mono.download(backend.exec);
    int const n = a->count[0];
    ASSERT_EQ(b->count[0], n);
    ASSERT_GT(n, 300);
    std::vector<int> order;  // of those beyond column 1000, then of the others, backwards
    for (int i = 0; i < n; ++i) {
      if (a->x(i) > 1000) { order.push_back(i); }
    }
    EXPECT_EQ(order.empty(), w == 320);
    for (int i = n - 1; i >= 0; --i) {
      if (a->x(i) <= 1000) { order.push_back(i); }
    }
    for (int i = 0; i < n; ++i) {
      int const from = order.at(at(i));
      EXPECT_EQ(b->x(i), a->x(from));
      EXPECT_EQ(b->y(i), a->y(from));
      EXPECT_EQ(b->octave(i), a->octave(from));
      EXPECT_EQ(b->angle(i), a->angle(from));
      EXPECT_EQ(hamming(b->orb(i), a->orb(from)), 0);
    }
  }
}

TYPED_TEST(MonocularStart, RefusesBadArguments) {
  TypeParam backend;
  using start_type = ft::monocular_start<typename TypeParam::exec_type>;
  auto const grid = ft::grid_geometry::over(0, 0, width, height);
  std::vector<ft::pinhole<float>> const one{{450, 455, 370, 250}};
  auto const refuses = [&](auto const& change) {
    ft::monocular_start_params params;
    auto cameras = one;
    int keypoints = 10;
    change(params, cameras, keypoints);
    EXPECT_THROW(start_type(backend.exec, params, cameras, grid, keypoints), ft::bad_argument);
  };
  refuses([](auto& p, auto&, auto&) { p.rules.min_keypoints = -1; });
  refuses([](auto& p, auto&, auto&) { p.rules.longest_gap_s = std::nan(""); });
  refuses([](auto& p, auto&, auto&) { p.two_views.samples = 0; });
  refuses([](auto& p, auto&, auto&) { p.matching.max_hamming = 256; });
  refuses([](auto&, auto& c, auto&) { c.clear(); });
  refuses([](auto&, auto& c, auto&) { c[0].fx = 0; });
  refuses([](auto&, auto&, auto& n) { n = 0; });

  ft::monocular_start_params inertial;
  inertial.rules.inertial = true;
  start_type start(backend.exec, inertial, one, grid, 10);
  ft::keypoints<start_type::space> const right(10);
  ft::keypoints<start_type::space> const other(11);
  auto const fails = [&](ft::start_frames const& f) {
    EXPECT_THROW(start.add(backend.exec, f), ft::bad_argument);
  };
  ft::buffer<double, start_type::space> const time(1);
  fails({});
  fails({right.view(), right.view(), nullptr});
  fails({other.view(), other.view(), time.data()});
  fails({right.view(), other.view(), time.data()});
  start_type const moved(std::move(start));
  fails({right.view(), right.view(), time.data()});
}

}  // namespace monocular_start_test
