// SPDX-License-Identifier: Apache-2.0
// The ends of every range: image sizes, strides, levels, scale factors, thresholds, numbers of
// features, capacities and products of sizes. Each is refused as documented, or works.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <new>
#include <numeric>
#include <random>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/pipelines/frame_tracker.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace limits_test {

using test::at;
using test::noise;

using image = std::vector<std::uint8_t>;
constexpr int largest_int = std::numeric_limits<int>::max();

ft::orb_params size(int w, int h, int levels = 8, float factor = 1.2f) {
  ft::orb_params p;
  p.width = w;
  p.height = h;
  p.levels = levels;
  p.scale_factor = factor;
  p.features = 300;
  return p;
}

/// What an image yielded, in host memory.
struct found {
  std::vector<float> x, y, angle;
  std::vector<int> octave;
  std::vector<ft::descriptor> orb;
};

bool same(found const& a, found const& b) {
  return a.x == b.x && a.y == b.y && a.angle == b.angle && a.octave == b.octave &&
         a.orb.size() == b.orb.size() &&
         (a.orb.empty() ||
          std::memcmp(a.orb.data(), b.orb.data(), a.orb.size() * sizeof(ft::descriptor)) == 0);
}

template <typename Backend>
class limits : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using extractor = ft::orb_extractor<exec_type>;
  using tracker_type = ft::frame_tracker<exec_type>;
  Backend backend;
  exec_type const& exec() const { return backend.exec; }

  found read(extractor const& orb, int i) const {
    auto const kp = orb.keypoints().slice(i);
    auto const count = at(test::from_exec(exec(), static_cast<int const*>(kp.count), 1)[0]);
    EXPECT_LE(count, at(orb.capacity()));
    auto const column = [&](auto const* data) { return test::from_exec(exec(), data, count); };
    found f;
    f.x = column(static_cast<float const*>(ft::array_of<ft::field::x>(kp)));
    f.y = column(static_cast<float const*>(ft::array_of<ft::field::y>(kp)));
    f.angle = column(static_cast<float const*>(ft::array_of<ft::field::angle>(kp)));
    f.octave = column(static_cast<int const*>(ft::array_of<ft::field::octave>(kp)));
    f.orb = column(static_cast<ft::descriptor const*>(ft::array_of<ft::field::orb>(kp)));
    return f;
  }
  found extract(ft::orb_params const& p, ft::gray_view view) const {
    extractor orb(exec(), p, 1);
    orb.upload(exec(), 0, view);
    orb.extract(exec());
    return read(orb, 0);
  }
  /// Keypoints where the detector may find them: 19 pixels (16 and the circle) inside their level.
  void expect_sound(found const& f, ft::orb_params const& p) const {
    for (std::size_t i = 0; i < f.x.size(); ++i) {
      ASSERT_TRUE(f.octave[i] >= 0 && f.octave[i] < p.levels);
      auto const scale = static_cast<float>(std::pow(p.scale_factor, f.octave[i]));
      float const rim = 19 * scale * 0.999f;
      ASSERT_TRUE(f.x[i] >= rim && f.y[i] >= rim) << f.x[i] << ", " << f.y[i];
      ASSERT_TRUE(f.x[i] < static_cast<float>(p.width) && f.y[i] < static_cast<float>(p.height));
      ASSERT_TRUE(f.angle[i] >= 0 && f.angle[i] <= 360);
    }
  }
};
TYPED_TEST_SUITE(limits, test::backends);

TYPED_TEST(limits, any_small_size_is_refused_or_works) {
  using orb = ft::orb_extractor<typename TypeParam::exec_type>;
  int const rounds = std::max(20, test::effort(120));  // some work, some are refused
  std::mt19937 random(1);
  int worked = 0;
  int refused = 0;
  for (int i = 0; i < rounds; ++i) {
    auto const below = [&](unsigned n) { return static_cast<int>(random() % n); };
    auto const p = size(1 + below(110), 1 + below(90), 1 + below(16),
                        1.01f + 0.99f * static_cast<float>(below(1000)) / 999.0f);
    SCOPED_TRACE(std::to_string(p.width) + "x" + std::to_string(p.height) + ", " +
                 std::to_string(p.levels) + " levels of " + std::to_string(p.scale_factor));
    double const last = std::pow(static_cast<double>(p.scale_factor), p.levels - 1);
    double const smallest = std::min(p.width, p.height) / last;
    if (smallest < 0.49) {
      EXPECT_THROW(orb(this->exec(), p, 1), ft::bad_argument);
      ++refused;
    } else if (smallest > 0.51) {  // between the two float rounding decides
      image const pixels = noise(at(p.width) * at(p.height), static_cast<unsigned>(random()));
      this->expect_sound(this->extract(p, {pixels.data(), p.width, p.height, p.width}), p);
      ++worked;
    }
  }
  EXPECT_GT(worked, 0);
  EXPECT_GT(refused, 0);
}

TYPED_TEST(limits, one_pixel_rows_and_columns_of_any_length_work) {
  for (auto const& p : {size(1, 1, 1), size(16384, 1, 1), size(1, 16384, 1), size(8191, 2, 1),
                        size(70, 8192), size(8192, 70)}) {
    SCOPED_TRACE(std::to_string(p.width) + "x" + std::to_string(p.height));
    image const pixels = noise(at(p.width) * at(p.height), 2);
    auto const f = this->extract(p, {pixels.data(), p.width, p.height, p.width});
    this->expect_sound(f, p);
    EXPECT_EQ(f.x.empty(), std::min(p.width, p.height) < 67) << "67 pixels hold a cell";
  }
}

TYPED_TEST(limits, an_image_of_8192_by_8192_works) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  auto p = size(8192, 8192);
  p.features = 100000;
  image pixels = noise(at(8192) * 8192, 9);
  // Corners in the whole image take the host a minute: there they are beside the far ends alone.
  if (std::is_same_v<typename TypeParam::exec_type, ft::host_exec>) {
    for (int y = 0; y < 7680; ++y) {
      std::fill_n(pixels.begin() + y * 8192, 7680, std::uint8_t{128});
    }
  }
  auto const f = this->extract(p, {pixels.data(), 8192, 8192, 8192});
  this->expect_sound(f, p);
  double const s = 1 / 1.2;  // the share of the finest level: there are corners enough for it
  double const finest = p.features * (1 - s) / (1 - std::pow(s, 8));
  EXPECT_GE(static_cast<double>(std::count(f.octave.begin(), f.octave.end(), 0)), finest - 1);
  EXPECT_GT(*std::max_element(f.x.begin(), f.x.end()), 8100.0f) << "also at the far end";
  EXPECT_GT(*std::max_element(f.y.begin(), f.y.end()), 8100.0f);
}

TYPED_TEST(limits, what_lies_between_rows_is_not_looked_at) {
  auto const p = size(131, 97, 4);
  image const tight = test::random_image(131, 97, 3);
  auto const want = this->extract(p, {tight.data(), 131, 97, 131});
  ASSERT_GT(want.x.size(), 20u);
  for (int const stride : {132, 133, 191, 192, 193, 1009, 4099}) {
    image wide = noise(at(stride) * 97, static_cast<unsigned>(stride));
    for (int y = 0; y < 97; ++y) {
      std::copy_n(tight.begin() + y * 131, 131, wide.begin() + y * stride);
    }
    // The last row ends with its last pixel: a checker of memory sees who reads on.
    wide.resize(at(stride) * 96 + 131);
    wide.shrink_to_fit();
    EXPECT_TRUE(same(this->extract(p, {wide.data(), 131, 97, stride}), want)) << stride;
  }
}

TYPED_TEST(limits, every_number_of_levels_and_scale_factor_works) {
  image const pixels = test::random_image(320, 240, 4);
  for (int levels = 1; levels <= 16; ++levels) {
    for (float const factor : {1.01f, 1.1f, 1.2f, 1.41421356f, 2.0f}) {
      auto const p = size(320, 240, levels, factor);
      SCOPED_TRACE(std::to_string(levels) + " levels of " + std::to_string(factor));
      if (240 / std::pow(static_cast<double>(factor), levels - 1) < 0.49) {
        EXPECT_THROW((typename TestFixture::extractor(this->exec(), p, 1)), ft::bad_argument);
        continue;
      }
      auto const f = this->extract(p, {pixels.data(), 320, 240, 320});
      this->expect_sound(f, p);
      EXPECT_GT(f.x.size(), 20u);
    }
  }
}

TYPED_TEST(limits, corners_grow_fewer_with_every_threshold) {
  image const pixels = noise(at(200) * 150, 5);
  std::size_t last = std::numeric_limits<std::size_t>::max();
  for (int const threshold : {0, 1, 7, 20, 64, 128, 200, 254, 255}) {
    auto p = size(200, 150, 1);
    p.features = 100000;  // all there are
    p.ini_threshold = p.min_threshold = threshold;
    auto const f = this->extract(p, {pixels.data(), 200, 150, 200});
    this->expect_sound(f, p);
    EXPECT_LE(f.x.size(), last) << threshold;
    last = f.x.size();
  }
  EXPECT_EQ(last, 0u) << "no difference exceeds 255";
}

TYPED_TEST(limits, as_many_features_as_asked_for_or_as_there_are) {
  image const pixels = noise(at(320) * 240, 6);
  auto const extract = [&](int features) {
    auto p = size(320, 240, 1);
    p.features = features;
    auto const f = this->extract(p, {pixels.data(), 320, 240, 320});
    this->expect_sound(f, p);
    return f.x.size();
  };
  std::size_t const all = extract(1 << 20);
  ASSERT_GT(all, 1001u);
  ASSERT_LT(all, 100000u);
  for (int const features : {1, 2, 10, 999, 1000, 1001, 100000}) {
    EXPECT_GE(extract(features), std::min(at(features), all)) << features;
    EXPECT_LE(extract(features), at(features) + 3) << "a split of the quadtree adds up to three";
  }
}

// ---- capacities -------------------------------------------------------------------------------

ft::tracker_params small() {
  ft::tracker_params p;
  p.orb = size(160, 120, 4);
  p.map_slots = 40;
  p.local_points = 30;
  p.updates = 20;
  return p;
}
ft::rectified_rig rig() { return ft::rectified_rig::make({100, 100, 80, 60}, 0.1f); }

TYPED_TEST(limits, a_tracker_takes_what_its_capacities_say_and_no_more) {
  typename TestFixture::tracker_type tracker(this->exec(), rig(), small());
  image const pixels = test::random_image(160, 120, 7);
  for (int c = 0; c < 2; ++c) { tracker.set_image(0, c, {pixels.data(), 160, 120, 160}); }
  std::vector<ft::point_update> points(at(small().updates) + 1);
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i] = {static_cast<int>(i), 1, {0, 0, 2}, {0, 0, 1}, 1, 10, {}};
  }
  points[at(small().updates) - 1].slot = small().map_slots - 1;
  for (int const over : {-1, 0, 1}) {
    SCOPED_TRACE(over);
    int const updates = small().updates + over;
    int const local = small().local_points + over;
    std::vector<int> slots(at(local));
    std::iota(slots.begin(), slots.end(), 0);
    tracker.set_last(this->exec(), 0, ft::pose::identity(),
                     std::vector<int>(at(tracker.capacity()), -1));
    ft::frame_input const input{ft::pose::identity(), slots};
    if (over > 0) {
      EXPECT_THROW(tracker.update_map(this->exec(), 0, points.data(), updates), ft::bad_argument);
      EXPECT_THROW(tracker.track(this->exec(), input), ft::bad_argument);
    } else {
      tracker.update_map(this->exec(), 0, points.data(), updates);
      this->exec().wait();
      tracker.track(this->exec(), input);
      this->exec().wait();
      auto const& r = tracker.result();
      EXPECT_GT(r.keypoints[0], 0);
      EXPECT_EQ(std::count(r.in_view, r.in_view + small().updates - 1, 1), small().updates - 1)
          << "every point written is in view";
      EXPECT_EQ(std::count(r.in_view, r.in_view + local, 1), small().updates - 1) << "and no other";
    }
  }
  std::vector<ft::descriptor> orb(at(tracker.capacity()) + 1);
  EXPECT_NO_THROW(tracker.download_descriptors(this->exec(), 0, orb.data(), tracker.capacity()));
  this->exec().wait();
}

TYPED_TEST(limits, a_matcher_refuses_an_extractor_of_another_shape) {
  using orb = typename TestFixture::extractor;
  auto const& exec = this->exec();
  orb mine(exec, size(160, 120, 4), 2);
  ft::stereo_matcher<typename TypeParam::exec_type> matcher(rig(), mine);
  auto more_features = size(160, 120, 4);
  more_features.features = 301;
  orb const larger(exec, more_features, 2);
  orb const taller(exec, size(160, 121, 4), 2);
  orb const longer(exec, size(160, 120, 4), 4);
  orb const none;
  for (orb const* other : {&larger, &taller, &longer, &none}) {
    EXPECT_THROW(matcher.match(exec, *other), ft::bad_argument);
    EXPECT_THROW(matcher.match_sorted(exec, *other), ft::bad_argument);
  }
  image const pixels = test::random_image(160, 120, 8);
  for (int i = 0; i < 2; ++i) { mine.upload(exec, i, {pixels.data(), 160, 120, 160}); }
  mine.extract(exec);
  EXPECT_NO_THROW(matcher.match(exec, mine));
  exec.wait();
}

// ---- products of sizes ------------------------------------------------------------------------

TYPED_TEST(limits, containers_whose_size_has_no_number_are_refused) {
  constexpr auto space = TypeParam::exec_type::space;
  EXPECT_THROW(ft::keypoints<space>(largest_int, largest_int), ft::bad_argument);
  EXPECT_THROW(ft::map_points<space>(largest_int, largest_int), ft::bad_argument);
}

TYPED_TEST(limits, launches_that_no_int_counts_are_refused) {
  using orb = typename TestFixture::extractor;
  auto p = size(1 << 10, 1 << 10);
  p.features = 1 << 20;
  EXPECT_THROW(orb(this->exec(), p, 4096), ft::bad_argument);
  auto t = small();
  t.orb = size(8, 8, 1);
  t.local_points = 1 << 21;
  EXPECT_THROW(typename TestFixture::tracker_type(this->exec(), rig(), t, 2048), ft::bad_argument);
}

}  // namespace limits_test
