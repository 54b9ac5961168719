// SPDX-License-Identifier: Apache-2.0
// Masks: what is left of the corners, against a plain filter of those found without a mask; sizes,
// batches, arguments.
#include "ft/kernels/corners/mask.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <string>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/corners.hpp"
#include "tests/support/random.hpp"

namespace corner_mask_test {

using bytes = std::vector<std::uint8_t>;

constexpr int image_width = 250;
constexpr int image_height = 190;

struct mask_image {
  int width, height, stride;
  bytes pixels;
  ft::gray_view view() const { return {pixels.data(), width, height, stride}; }
  bool allows(int x, int y) const {
    return pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(stride) +
                  static_cast<std::size_t>(x)] != 0;
  }
};

/// Blocks of allowed and excluded pixels; allowed ones have any value but 0.
inline mask_image random_mask(int width, int height, int stride, unsigned seed) {
  std::mt19937 random(seed);
  mask_image mask{width, height, stride,
                  bytes(static_cast<std::size_t>(stride) * static_cast<std::size_t>(height), 0)};
  int const block = 1 + width / 7;
  std::vector<bool> allowed(static_cast<std::size_t>((width / block + 1) * (height / block + 1)));
  for (std::size_t i = 0; i < allowed.size(); ++i) { allowed[i] = random() % 2 == 0; }
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (allowed[static_cast<std::size_t>(y / block * (width / block + 1) + x / block)]) {
        mask.pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(stride) +
                    static_cast<std::size_t>(x)] = static_cast<std::uint8_t>(1 + random() % 255);
      }
    }
  }
  return mask;
}

inline mask_image plain_mask(int width, int height, std::uint8_t value) {
  return {width, height, width,
          bytes(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), value)};
}

inline ft::orb_params with_masks(int width, int height) {
  ft::orb_params p;
  p.width = image_width;
  p.height = image_height;
  p.features = 300;
  p.mask_width = width;
  p.mask_height = height;
  return p;
}

inline bool same(std::vector<ft::corner> const& a, std::vector<ft::corner> const& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](ft::corner p, ft::corner q) {
    return p.x == q.x && p.y == q.y && p.response == q.response;
  });
}

template <typename Backend>
class corner_mask_unit : public test::on_backend<Backend> {
protected:
  using extractor = ft::orb_extractor<typename Backend::exec_type>;
  Backend backend;

  void extract(extractor& orb, std::vector<bytes> const& images) {
    for (std::size_t i = 0; i < images.size(); ++i) {
      orb.upload(backend.exec, static_cast<int>(i),
                 {images[i].data(), image_width, image_height, image_width});
      backend.exec.wait();
    }
    orb.extract(backend.exec);
    backend.exec.wait();
  }
  /// Corners of a level, in the level's order.
  std::vector<ft::corner> corners(extractor const& orb, int image, int level) {
    auto const v = orb.corners();
    auto const counts = test::from_exec(
        backend.exec, static_cast<int const*>(v.list_count),
        static_cast<std::size_t>(v.batch) * static_cast<std::size_t>(v.layout.levels));
    auto const n = counts[static_cast<std::size_t>(image * v.layout.levels + level)];
    auto list =
        test::from_exec(backend.exec, static_cast<ft::corner const*>(v.level_list(image, level)),
                        static_cast<std::size_t>(n));
    test::sort_corners(list.data(), n, v.layout, level);
    return list;
  }
  int keypoints(extractor const& orb, int image) {
    return test::from_exec(backend.exec, static_cast<int const*>(orb.keypoints().count) + image,
                           1)[0];
  }
  std::vector<ft::descriptor> descriptors(extractor const& orb, int image) {
    auto all = test::column<ft::field::orb>(backend.exec, orb.keypoints().slice(image));
    all.resize(static_cast<std::size_t>(keypoints(orb, image)));
    return all;
  }
};
TYPED_TEST_SUITE(corner_mask_unit, test::backends);

TYPED_TEST(corner_mask_unit, what_is_left_is_what_a_plain_filter_leaves) {
  struct size {
    int width, height, padding;
  };
  for (size const s : {size{image_width, image_height, 0}, size{image_width, image_height, 13},
                       size{31, 17, 0}, size{1000, 333, 5}, size{1, 40, 0}}) {
    SCOPED_TRACE(std::to_string(s.width) + "x" + std::to_string(s.height));
    bytes const image = test::random_image(image_width, image_height, 3);
    auto const params = with_masks(s.width, s.height);
    typename TestFixture::extractor plain(this->backend.exec, with_masks(0, 0), 1);
    typename TestFixture::extractor masked(this->backend.exec, params, 1);
    auto const mask = random_mask(s.width, s.height, s.width + s.padding, 5);
    masked.set_mask(this->backend.exec, 0, mask.view());
    this->backend.exec.wait();
    this->extract(plain, {image});
    this->extract(masked, {image});
    std::size_t kept = 0;
    std::size_t dropped = 0;
    for (int l = 0; l < params.levels; ++l) {
      std::vector<ft::corner> want;
      auto const& g = plain.geometry();
      for (auto const& c : this->corners(plain, 0, l)) {
        // The centre of the level's pixel as a share of the image, then of the mask.
        double const u = (c.x + 16 + 0.5) / g.width[l];
        double const v = (c.y + 16 + 0.5) / g.height[l];
        bool const allowed = mask.allows(static_cast<int>(std::floor(u * s.width + 1e-9)),
                                         static_cast<int>(std::floor(v * s.height + 1e-9)));
        if (allowed) { want.push_back(c); }
        ++(allowed ? kept : dropped);
      }
      EXPECT_TRUE(same(this->corners(masked, 0, l), want)) << "level " << l;
    }
    EXPECT_GT(kept, 50u);
    EXPECT_GT(dropped, 50u);
    EXPECT_GT(this->keypoints(masked, 0), 20);
  }
}

TYPED_TEST(corner_mask_unit, no_keypoint_lies_where_the_mask_is_0) {
  typename TestFixture::extractor orb(this->backend.exec, with_masks(image_width, image_height), 1);
  auto mask = plain_mask(image_width, image_height, 0);
  for (int y = 60; y < 150; ++y) {
    for (int x = 90; x < 200; ++x) {
      mask.pixels[static_cast<std::size_t>(y * image_width + x)] = 9;
    }
  }
  orb.set_mask(this->backend.exec, 0, mask.view());
  this->backend.exec.wait();
  this->extract(orb, {test::random_image(image_width, image_height, 8)});
  int const n = this->keypoints(orb, 0);
  auto const x = test::column<ft::field::x>(this->backend.exec, orb.keypoints());
  auto const y = test::column<ft::field::y>(this->backend.exec, orb.keypoints());
  auto const octave = test::column<ft::field::octave>(this->backend.exec, orb.keypoints());
  for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
    float const halved = 0.5f * orb.geometry().scale[octave[i]] + 1;  // of the level's pixel
    EXPECT_GE(x[i], 90 - halved);
    EXPECT_LE(x[i], 199 + halved);
    EXPECT_GE(y[i], 60 - halved);
    EXPECT_LE(y[i], 149 + halved);
  }
  EXPECT_GT(n, 30);
}

TYPED_TEST(corner_mask_unit, a_mask_that_allows_all_changes_nothing) {
  bytes const image = test::random_image(image_width, image_height, 4);
  typename TestFixture::extractor plain(this->backend.exec, with_masks(0, 0), 1);
  typename TestFixture::extractor untouched(this->backend.exec, with_masks(40, 30), 1);
  typename TestFixture::extractor set(this->backend.exec, with_masks(40, 30), 1);
  set.set_mask(this->backend.exec, 0, plain_mask(40, 30, 1).view());
  this->backend.exec.wait();
  this->extract(plain, {image});
  this->extract(untouched, {image});
  this->extract(set, {image});
  auto const want = this->descriptors(plain, 0);
  ASSERT_GT(want.size(), 100u);
  for (auto const* orb : {&untouched, &set}) {
    auto const got = this->descriptors(*orb, 0);
    ASSERT_EQ(got.size(), want.size());
    EXPECT_EQ(std::memcmp(got.data(), want.data(), want.size() * sizeof want[0]), 0);
  }
}

TYPED_TEST(corner_mask_unit, every_image_has_its_own_mask_until_the_next_one) {
  bytes const image = test::random_image(image_width, image_height, 6);
  typename TestFixture::extractor orb(this->backend.exec, with_masks(20, 20), 3);
  auto const set = [&](int i, mask_image const& mask) {
    orb.set_mask(this->backend.exec, i, mask.view());
    this->backend.exec.wait();
  };
  set(1, plain_mask(20, 20, 0));
  auto halved = plain_mask(20, 20, 0);
  for (std::size_t i = 0; i < halved.pixels.size(); ++i) {
    halved.pixels[i] = i % 20 < 10 ? 255 : 0;
  }
  set(2, halved);
  this->extract(orb, {image, image, image});
  EXPECT_GT(this->keypoints(orb, 0), 100) << "never set";
  EXPECT_EQ(this->keypoints(orb, 1), 0);
  EXPECT_GT(this->keypoints(orb, 2), 50);
  auto const x = test::column<ft::field::x>(this->backend.exec, orb.keypoints().slice(2));
  for (int i = 0; i < this->keypoints(orb, 2); ++i) {
    EXPECT_LE(x[static_cast<std::size_t>(i)], image_width / 2 + 4);
  }
  this->extract(orb, {image, image, image});
  EXPECT_EQ(this->keypoints(orb, 1), 0) << "holds for the next image too";
  set(1, plain_mask(20, 20, 3));
  this->extract(orb, {image, image, image});
  EXPECT_EQ(this->keypoints(orb, 1), this->keypoints(orb, 0));
}

TYPED_TEST(corner_mask_unit, images_without_corners_may_have_a_mask) {
  ft::orb_params small = with_masks(3, 3);
  small.width = small.height = 66;  // no cell
  typename TestFixture::extractor orb(this->backend.exec, small, 1);
  bytes const flat(66 * 66, 7);
  orb.upload(this->backend.exec, 0, {flat.data(), 66, 66, 66});
  orb.set_mask(this->backend.exec, 0, plain_mask(3, 3, 0).view());
  orb.extract(this->backend.exec);
  this->backend.exec.wait();
  EXPECT_EQ(this->keypoints(orb, 0), 0);
}

TYPED_TEST(corner_mask_unit, arguments_out_of_range_throw) {
  using orb_type = typename TestFixture::extractor;
  auto const& exec = this->backend.exec;
  EXPECT_THROW(orb_type(exec, with_masks(-1, 10), 1), ft::bad_argument);
  EXPECT_THROW(orb_type(exec, with_masks(10, 16385), 1), ft::bad_argument);
  EXPECT_THROW(orb_type(exec, with_masks(10, 0), 1), ft::bad_argument);
  EXPECT_THROW(orb_type(exec, with_masks(0, 10), 1), ft::bad_argument);
  orb_type orb(exec, with_masks(40, 30), 2);
  auto const mask = plain_mask(41, 31, 1);
  EXPECT_NO_THROW(orb.set_mask(exec, 1, {mask.pixels.data(), 40, 30, 41}));
  EXPECT_THROW(orb.set_mask(exec, 2, {mask.pixels.data(), 40, 30, 40}), ft::bad_argument);
  EXPECT_THROW(orb.set_mask(exec, -1, {mask.pixels.data(), 40, 30, 40}), ft::bad_argument);
  EXPECT_THROW(orb.set_mask(exec, 0, {nullptr, 40, 30, 40}), ft::bad_argument);
  EXPECT_THROW(orb.set_mask(exec, 0, {mask.pixels.data(), 41, 30, 41}), ft::bad_argument);
  EXPECT_THROW(orb.set_mask(exec, 0, {mask.pixels.data(), 40, 31, 40}), ft::bad_argument);
  EXPECT_THROW(orb.set_mask(exec, 0, {mask.pixels.data(), 40, 30, 39}), ft::bad_argument);
  orb_type without(exec, with_masks(0, 0), 1);
  EXPECT_THROW(without.set_mask(exec, 0, {mask.pixels.data(), 0, 0, 0}), ft::bad_argument);
  exec.wait();
}

TYPED_TEST(corner_mask_unit, a_tracker_obeys_the_masks_of_its_cameras) {
  using exec_type = typename TypeParam::exec_type;
  ft::tracker_params params;
  params.orb = with_masks(10, 10);
  params.map_slots = 100;
  params.local_points = 10;
  auto const rig = ft::rectified_rig::make({200.0f, 200.0f, 125.0f, 95.0f}, 0.1f);
  ft::frame_tracker<exec_type> tracker(this->backend.exec, rig, params);
  bytes const image = test::random_image(image_width, image_height, 9);
  ft::gray_view const view{image.data(), image_width, image_height, image_width};
  auto const keypoints_of = [&] {
    tracker.set_image(0, 0, view);
    tracker.set_image(0, 1, view);
    tracker.extract(this->backend.exec);
    this->backend.exec.wait();
    return tracker.result().keypoints[0];
  };
  EXPECT_GT(keypoints_of(), 100);
  tracker.set_mask(this->backend.exec, 0, 0, plain_mask(10, 10, 0).view());
  this->backend.exec.wait();
  EXPECT_EQ(keypoints_of(), 0);
  EXPECT_GT(this->keypoints(tracker.extractor(), 1), 100) << "the right camera's is another mask";
  tracker.set_mask(this->backend.exec, 0, 0, plain_mask(10, 10, 1).view());
  tracker.set_mask(this->backend.exec, 0, 1, plain_mask(10, 10, 0).view());
  this->backend.exec.wait();
  EXPECT_GT(keypoints_of(), 100);
  EXPECT_EQ(this->keypoints(tracker.extractor(), 1), 0);
  EXPECT_THROW(tracker.set_mask(this->backend.exec, 1, 0, plain_mask(10, 10, 0).view()),
               ft::bad_argument);
  EXPECT_THROW(tracker.set_mask(this->backend.exec, 0, 2, plain_mask(10, 10, 0).view()),
               ft::bad_argument);
}

/// Each of a batch's cameras in turn sees nothing, and no other.
TYPED_TEST(corner_mask_unit, a_batch_keeps_the_masks_of_its_cameras_apart) {
  ft::tracker_params params;
  params.orb = with_masks(10, 10);
  params.map_slots = 100;
  params.local_points = 10;
  auto const rig = ft::rectified_rig::make({200.0f, 200.0f, 125.0f, 95.0f}, 0.1f);
  ft::frame_tracker<typename TypeParam::exec_type> tracker(this->backend.exec, rig, params, 2);
  bytes const image = test::random_image(image_width, image_height, 9);
  for (int i = 0; i < 4; ++i) {
    tracker.set_image(i / 2, i % 2, {image.data(), image_width, image_height, image_width});
  }
  auto const open = plain_mask(10, 10, 1);
  auto const closed = plain_mask(10, 10, 0);
  for (int dark = 0; dark < 4; ++dark) {
    for (int i = 0; i < 4; ++i) {
      tracker.set_mask(this->backend.exec, i / 2, i % 2, (i == dark ? closed : open).view());
    }
    tracker.extract(this->backend.exec);
    this->backend.exec.wait();
    for (int i = 0; i < 4; ++i) {
      EXPECT_EQ(this->keypoints(tracker.extractor(), i) == 0, i == dark) << i << ", " << dark;
    }
  }
}

}  // namespace corner_mask_test
