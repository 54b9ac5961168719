// SPDX-License-Identifier: Apache-2.0
// The ORB extractor as a whole: arguments, tiny and extreme images, limits, repeatability,
// independence of the batch.
#include "ft/pipelines/orb_extractor.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace extractor_test {

using test::noise;

using image = std::vector<std::uint8_t>;

inline ft::orb_params size(int w, int h) {
  ft::orb_params p;
  p.width = w;
  p.height = h;
  p.features = 300;
  return p;
}
inline image flat(int w, int h, int grey) {
  return image(static_cast<std::size_t>(w) * static_cast<std::size_t>(h),
               static_cast<std::uint8_t>(grey));
}
/// Everything that an image yields.
struct features {
  std::vector<float> x, y, angle, response;
  std::vector<int> octave;
  std::vector<ft::descriptor> orb;
  int mono = 0;

  std::size_t count() const { return x.size(); }
  friend bool operator==(features const& a, features const& b) {
    return a.x == b.x && a.y == b.y && a.angle == b.angle && a.response == b.response &&
           a.octave == b.octave && a.mono == b.mono && a.orb.size() == b.orb.size() &&
           (a.orb.empty() ||
            std::memcmp(a.orb.data(), b.orb.data(), a.orb.size() * sizeof(ft::descriptor)) == 0);
  }
};

template <typename Backend>
class extractor_unit : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using extractor = ft::orb_extractor<exec_type>;
  Backend backend;

  std::vector<features> extract(extractor& orb, std::vector<image> const& images) {
    auto const& exec = backend.exec;
    int const w = orb.params().width;
    int const h = orb.params().height;
    for (std::size_t i = 0; i < images.size(); ++i) {
      orb.upload(exec, static_cast<int>(i), {images[i].data(), w, h, w});
      exec.wait();
    }
    orb.extract(exec);
    return read(orb);
  }
  std::vector<features> read(extractor const& orb) {
    auto const& exec = backend.exec;
    auto const kp = orb.keypoints();
    auto const batch = static_cast<std::size_t>(orb.batch());
    auto const count = test::from_exec(exec, static_cast<int const*>(kp.count), batch);
    auto const mono = test::from_exec(exec, orb.mono_count(), batch);
    std::vector<features> all(batch);
    for (std::size_t b = 0; b < batch; ++b) {
      EXPECT_GE(count[b], 0);
      EXPECT_LE(count[b], orb.capacity());
      auto const n = static_cast<std::size_t>(count[b]);
      auto const s = kp.slice(static_cast<int>(b));
      auto const first = [&](auto values) {
        values.resize(n);
        return values;
      };
      all[b].x = first(test::column<ft::field::x>(exec, s));
      all[b].y = first(test::column<ft::field::y>(exec, s));
      all[b].angle = first(test::column<ft::field::angle>(exec, s));
      all[b].response = first(test::column<ft::field::response>(exec, s));
      all[b].octave = first(test::column<ft::field::octave>(exec, s));
      all[b].orb = first(test::column<ft::field::orb>(exec, s));
      all[b].mono = mono[b];
    }
    return all;
  }
  features extract_one(ft::orb_params const& params, image const& pixels) {
    extractor orb(backend.exec, params, 1);
    return extract(orb, {pixels})[0];
  }

  /// What holds for the keypoints of any image.
  void check_sound(features const& f, ft::orb_params const& params) {
    auto const g =
        ft::pyramid_geometry::make(params.width, params.height, params.levels, params.scale_factor);
    std::set<std::pair<int, std::pair<float, float>>> places;
    for (std::size_t i = 0; i < f.count(); ++i) {
      ASSERT_GE(f.octave[i], 0);
      ASSERT_LT(f.octave[i], params.levels);
      float const scale = g.scale[f.octave[i]];
      EXPECT_GE(f.x[i], 18.9f * scale);
      EXPECT_GE(f.y[i], 18.9f * scale);
      EXPECT_LE(f.x[i], (static_cast<float>(g.width[f.octave[i]]) - 19.9f) * scale);
      EXPECT_LE(f.y[i], (static_cast<float>(g.height[f.octave[i]]) - 19.9f) * scale);
      EXPECT_GE(f.angle[i], 0);
      EXPECT_LE(f.angle[i], 360);
      EXPECT_GE(f.response[i], std::min(params.ini_threshold, params.min_threshold));
      EXPECT_LE(f.response[i], 254);
      EXPECT_TRUE(places.insert({f.octave[i], {f.x[i], f.y[i]}}).second)
          << "one keypoint per place";
    }
    EXPECT_TRUE(std::is_sorted(f.octave.begin(), f.octave.end())) << "level by level";
    EXPECT_EQ(f.mono, static_cast<int>(f.count())) << "without an overlap all are mono";
  }
};
TYPED_TEST_SUITE(extractor_unit, test::backends);

// Images in which a map may begin have the features of an extractor that was made for more.
TYPED_TEST(extractor_unit, images_of_which_more_is_wanted_have_more) {
  auto params = size(320, 240);
  auto const usual = params;
  auto more = params;
  more.features = 1500;
  params.start_features = 1500;
  auto const one = noise(320, 240, 1);
  auto const other = noise(320, 240, 2);
  auto const few_of_one = this->extract_one(usual, one);
  auto const many_of_one = this->extract_one(more, one);
  auto const few_of_other = this->extract_one(usual, other);
  ASSERT_GT(many_of_one.count(), 3 * few_of_one.count());
  typename TestFixture::extractor orb(this->backend.exec, params, 2);
  int* const wants_more = orb.stages().kept.wants_more;
  ASSERT_NE(wants_more, nullptr);
  auto got = this->extract(orb, {one, other});
  EXPECT_TRUE(got[0] == few_of_one);
  EXPECT_TRUE(got[1] == few_of_other);
  ft::fill_bytes(this->backend.exec, wants_more, 1, sizeof(int));
  got = this->extract(orb, {one, other});
  EXPECT_TRUE(got[0] == many_of_one);
  EXPECT_TRUE(got[1] == few_of_other);
  ft::fill_bytes(this->backend.exec, wants_more, 0, sizeof(int));
  EXPECT_TRUE(this->extract(orb, {one, other})[0] == few_of_one);
  params.start_features = usual.features - 1;
  EXPECT_THROW(typename TestFixture::extractor(this->backend.exec, params, 1), ft::bad_argument);
}

TYPED_TEST(extractor_unit, arguments_out_of_range_throw) {
  auto const& exec = this->backend.exec;
  using orb = ft::orb_extractor<typename TypeParam::exec_type>;
  auto const with = [](auto change) {
    auto p = size(200, 150);
    change(p);
    return p;
  };
  EXPECT_NO_THROW(orb(exec, size(200, 150), 1));
  EXPECT_THROW(orb(exec, size(0, 150), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, size(200, -1), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, size(16385, 150), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, size(200, 150), 0), ft::bad_argument);
  EXPECT_THROW(orb(exec, size(200, 150), 4097), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.features = 0; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.features = (1 << 20) + 1; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.levels = 0; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.levels = 17; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.scale_factor = 1.0f; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.ini_threshold = 256; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.ini_threshold = -1; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.min_threshold = -1; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, with([](auto& p) { p.min_threshold = 256; }), 1), ft::bad_argument);
  EXPECT_THROW(orb(exec, size(200, 150), 2, {{0, 10}}), ft::bad_argument)
      << "an overlap for every image";
}

TYPED_TEST(extractor_unit, images_of_another_kind_throw) {
  auto const& exec = this->backend.exec;
  typename TestFixture::extractor orb(exec, size(200, 150), 2);
  image const pixels = flat(200, 151, 0);
  EXPECT_NO_THROW(orb.upload(exec, 1, {pixels.data(), 200, 150, 200}));
  EXPECT_THROW(orb.upload(exec, 0, {nullptr, 200, 150, 200}), ft::bad_argument);
  EXPECT_THROW(orb.upload(exec, 0, {pixels.data(), 200, 151, 200}), ft::bad_argument);
  EXPECT_THROW(orb.upload(exec, 0, {pixels.data(), 199, 150, 200}), ft::bad_argument);
  EXPECT_THROW(orb.upload(exec, 0, {pixels.data(), 200, 150, 199}), ft::bad_argument);
  EXPECT_THROW(orb.upload(exec, 0, {pixels.data(), 0, 0, 0}), ft::bad_argument);
  EXPECT_THROW(orb.upload(exec, -1, {pixels.data(), 200, 150, 200}), ft::bad_argument);
  EXPECT_THROW(orb.upload(exec, 2, {pixels.data(), 200, 150, 200}), ft::bad_argument);
  exec.wait();
}

TYPED_TEST(extractor_unit, images_too_small_for_a_corner_give_none) {
  using orb = ft::orb_extractor<typename TypeParam::exec_type>;
  EXPECT_THROW(orb(this->backend.exec, size(1, 1), 1), ft::bad_argument) << "8 levels need pixels";
  EXPECT_EQ(this->extract_one(size(16, 16), noise(16, 16, 1)).count(), 0u);
  EXPECT_EQ(this->extract_one(size(40, 40), noise(40, 40, 2)).count(), 0u);
  EXPECT_EQ(this->extract_one(size(66, 66), noise(66, 66, 3)).count(), 0u);
  EXPECT_EQ(this->extract_one(size(500, 30), noise(500, 30, 4)).count(), 0u);
  auto one_level = size(1, 1);
  one_level.levels = 1;
  EXPECT_EQ(this->extract_one(one_level, flat(1, 1, 9)).count(), 0u);
  // From 67 pixels on there is a cell.
  EXPECT_GT(this->extract_one(size(67, 67), noise(67, 67, 5)).count(), 0u);
}

TYPED_TEST(extractor_unit, images_without_structure_give_none) {
  for (int const grey : {0, 128, 255}) {
    auto const f = this->extract_one(size(200, 150), flat(200, 150, grey));
    EXPECT_EQ(f.count(), 0u);
    EXPECT_EQ(f.mono, 0);
  }
}

TYPED_TEST(extractor_unit, keypoints_are_sound) {
  auto const params = size(240, 180);
  for (unsigned seed = 0; seed < 3; ++seed) {
    auto const f = this->extract_one(params, test::random_image(240, 180, seed));
    this->check_sound(f, params);
    EXPECT_GT(f.count(), 150u);
  }
  auto const f = this->extract_one(params, noise(240, 180, 4));
  this->check_sound(f, params);
  EXPECT_GT(f.count(), 250u);
}

TYPED_TEST(extractor_unit, narrow_and_wide_images) {
  for (auto const& p : {size(70, 400), size(400, 70), size(67, 300), size(1400, 67)}) {
    auto const f = this->extract_one(p, noise(p.width, p.height, 6));
    this->check_sound(f, p);
    EXPECT_GT(f.count(), 0u);
  }
}

TYPED_TEST(extractor_unit, limits_of_the_parameters) {
  image const pixels = noise(240, 180, 7);
  auto p = size(240, 180);
  p.features = 1;
  auto f = this->extract_one(p, pixels);
  this->check_sound(f, p);
  EXPECT_GT(f.count(), 0u);
  std::size_t const few = f.count();
  p.features = 100000;
  f = this->extract_one(p, pixels);
  this->check_sound(f, p);
  EXPECT_GT(f.count(), 10 * few) << "all corners there are";
  p = size(240, 180);
  p.levels = 1;
  f = this->extract_one(p, pixels);
  this->check_sound(f, p);
  EXPECT_GE(f.count(), 300u);
  p.levels = 2;
  p.scale_factor = 4.0f;  // 60 x 45: no cell on the second level
  f = this->extract_one(p, pixels);
  this->check_sound(f, p);
  EXPECT_EQ(std::count(f.octave.begin(), f.octave.end(), 0), static_cast<int>(f.count()));
  p = size(240, 180);
  p.min_threshold = 0;
  f = this->extract_one(p, pixels);
  this->check_sound(f, p);
  p.ini_threshold = 0;
  f = this->extract_one(p, pixels);
  this->check_sound(f, p);
  EXPECT_GT(f.count(), 250u);
  p.ini_threshold = 255;
  p.min_threshold = 255;
  EXPECT_EQ(this->extract_one(p, pixels).count(), 0u) << "no difference exceeds 255";
}

TYPED_TEST(extractor_unit, a_repeated_extraction_gives_the_same) {
  typename TestFixture::extractor orb(this->backend.exec, size(240, 180), 2);
  std::vector<image> const images{test::random_image(240, 180, 8), noise(240, 180, 9)};
  auto const first = this->extract(orb, images);
  auto const second = this->extract(orb, images);
  orb.extract(this->backend.exec);  // without a new upload
  auto const third = this->read(orb);
  EXPECT_TRUE(first == second);
  EXPECT_TRUE(first == third);
  // Other images in between leave no trace.
  this->extract(orb, {noise(240, 180, 10), flat(240, 180, 0)});
  EXPECT_TRUE(this->extract(orb, images) == first);
}

TYPED_TEST(extractor_unit, an_image_does_not_depend_on_its_place_in_the_batch) {
  auto const params = size(200, 150);
  std::vector<image> const images{test::random_image(200, 150, 11), flat(200, 150, 50),
                                  noise(200, 150, 12), test::random_image(200, 150, 13)};
  typename TestFixture::extractor four(this->backend.exec, params, 4);
  auto const together = this->extract(four, images);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_TRUE(together[i] == this->extract_one(params, images[i])) << "image " << i;
  }
  auto const turned = this->extract(four, {images[3], images[2], images[1], images[0]});
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_TRUE(together[i] == turned[3 - i]) << "image " << i;
  }
  EXPECT_GT(together[0].count(), 100u);
  EXPECT_EQ(together[1].count(), 0u);
}

/// The second of every three images is absent.
TYPED_TEST(extractor_unit, absent_images_have_no_keypoints_and_change_no_others) {
  constexpr int w = 320;
  constexpr int h = 240;
  auto const p = size(w, h);
  std::vector<image> images;
  for (unsigned i = 0; i < 6; ++i) { images.push_back(noise(w, h, 60 + i)); }
  typename TestFixture::extractor whole(this->backend.exec, p, 6);
  typename TestFixture::extractor partial(this->backend.exec, p, 6, {}, {0b010, 3});
  // Memory that the device reads in place. The absent images have a source that nothing reads.
  constexpr ft::memory_space staging = ft::staging_space<typename TypeParam::exec_type>;
  constexpr std::size_t bytes = std::size_t{w} * h;
  ft::buffer<std::uint8_t, staging> const pixels(6 * bytes);
  ft::buffer<ft::image_source, staging> const sources(6);
  for (std::size_t i = 0; i < 6; ++i) {
    std::copy(images[i].begin(), images[i].end(), pixels.data() + i * bytes);
    sources.data()[i] = {pixels.data() + i * bytes, w};
  }
  for (int round = 0; round < 2; ++round) {
    whole.extract_from(this->backend.exec, sources.data());
    partial.extract_from(this->backend.exec, sources.data());
    auto const all = this->read(whole);
    auto const some = this->read(partial);
    for (std::size_t i = 0; i < 6; ++i) {
      EXPECT_GT(all[i].count(), 100u);
      if (i % 3 == 1) {
        EXPECT_EQ(some[i].count(), 0u) << i;
      } else {
        EXPECT_TRUE(some[i] == all[i]) << i;
      }
    }
  }
  EXPECT_THROW(typename TestFixture::extractor(this->backend.exec, p, 6, {}, {1, 0}),
               ft::bad_argument);
  EXPECT_THROW(typename TestFixture::extractor(this->backend.exec, p, 6, {}, {1, 33}),
               ft::bad_argument);
}

TYPED_TEST(extractor_unit, rows_of_a_larger_image_may_be_given) {
  auto const params = size(200, 150);
  image const pixels = test::random_image(200, 150, 14);
  auto const want = this->extract_one(params, pixels);
  image padded = flat(233, 150, 77);
  for (std::size_t y = 0; y < 150; ++y) {
    std::copy_n(pixels.begin() + static_cast<std::ptrdiff_t>(200 * y), 200,
                padded.begin() + static_cast<std::ptrdiff_t>(233 * y));
  }
  typename TestFixture::extractor orb(this->backend.exec, params, 1);
  orb.upload(this->backend.exec, 0, {padded.data(), 200, 150, 233});
  this->backend.exec.wait();
  orb.extract(this->backend.exec);
  EXPECT_TRUE(this->read(orb)[0] == want);
}

TYPED_TEST(extractor_unit, keypoints_of_an_overlap_come_from_the_end) {
  auto const params = size(240, 180);
  image const pixels = test::random_image(240, 180, 15);
  auto const plain = this->extract_one(params, pixels);
  typename TestFixture::extractor orb(this->backend.exec, params, 2, {{80, 150}, {0, 1000}});
  auto const split = this->extract(orb, {pixels, pixels});
  features want = plain;
  std::size_t front = 0;
  std::size_t back = plain.count();
  for (std::size_t i = 0; i < plain.count(); ++i) {
    std::size_t const to = plain.x[i] >= 80 && plain.x[i] <= 150 ? --back : front++;
    want.x[to] = plain.x[i];
    want.y[to] = plain.y[i];
    want.angle[to] = plain.angle[i];
    want.response[to] = plain.response[i];
    want.octave[to] = plain.octave[i];
    want.orb[to] = plain.orb[i];
  }
  want.mono = static_cast<int>(front);
  EXPECT_TRUE(split[0] == want);
  EXPECT_GT(front, 20u);
  EXPECT_LT(front, plain.count() - 20);
  EXPECT_EQ(split[1].mono, 0) << "all inside: all from the end";
  auto reversed = split[1].x;
  std::reverse(reversed.begin(), reversed.end());
  EXPECT_EQ(reversed, plain.x);
}

TYPED_TEST(extractor_unit, keypoints_of_a_wide_image_lie_on_both_sides_of_an_overlaps_end) {
  // One image with ORB-SLAM3's monocular overlap, which ends within it.
  auto params = size(1300, 200);
  params.features = 1000;
  image const pixels = test::random_image(1300, 200, 16);
  auto const plain = this->extract_one(params, pixels);
  typename TestFixture::extractor orb(this->backend.exec, params, 1, {{0, 1000}});
  auto const split = this->extract(orb, {pixels})[0];
  ASSERT_EQ(split.count(), plain.count());
  std::vector<std::size_t> from;
  for (std::size_t i = 0; i < plain.count(); ++i) {
    if (plain.x[i] > 1000) { from.push_back(i); }
  }
  EXPECT_EQ(split.mono, static_cast<int>(from.size()));
  EXPECT_GT(from.size(), 50u);
  EXPECT_LT(from.size(), plain.count() - 50);
  for (std::size_t i = plain.count(); i-- > 0;) {
    if (plain.x[i] <= 1000) { from.push_back(i); }
  }
  for (std::size_t i = 0; i < plain.count(); ++i) {
    EXPECT_EQ(split.x[i], plain.x[from[i]]);
    EXPECT_EQ(split.y[i], plain.y[from[i]]);
    EXPECT_EQ(split.angle[i], plain.angle[from[i]]);
    EXPECT_EQ(split.octave[i], plain.octave[from[i]]);
    EXPECT_EQ(ft::hamming(split.orb[i], plain.orb[from[i]]), 0);
  }
}

}  // namespace extractor_test
