// SPDX-License-Identifier: Apache-2.0
// Description of keypoints from elsewhere: the extractor's own keypoints get what the extractor
// gave them; what cannot be described is marked.
#include "ft/kernels/keypoints/describe_corners.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace describe_keypoints_test {

struct point {
  float x, y;
  int octave;
};
struct described {
  float angle;
  ft::descriptor orb;
};

inline ft::orb_params small_images() {
  ft::orb_params p;
  p.width = 240;
  p.height = 180;
  p.features = 300;
  return p;
}

inline bool is_zero(ft::descriptor const& d) {
  return std::all_of(d.words, d.words + 8, [](std::uint32_t w) { return w == 0; });
}

template <typename Backend>
class describe_keypoints_unit : public test::on_backend<Backend> {
protected:
  using extractor = ft::orb_extractor<typename Backend::exec_type>;
  Backend backend;

  void upload(extractor& orb, std::vector<std::vector<std::uint8_t>> const& images) {
    for (std::size_t i = 0; i < images.size(); ++i) {
      orb.upload(backend.exec, static_cast<int>(i), {images[i].data(), 240, 180, 240});
      backend.exec.wait();
    }
  }
  /// @param points of each image
  std::vector<std::vector<described>> describe(extractor const& orb,
                                               std::vector<std::vector<point>> const& points,
                                               int capacity) {
    auto const& exec = backend.exec;
    auto const batch = static_cast<int>(points.size());
    ft::keypoints<ft::memory_space::host> host(capacity, batch);
    ft::keypoints<Backend::exec_type::space> device(capacity, batch);
    auto const v = host.view();
    for (int b = 0; b < batch; ++b) {
      auto const& mine = points[static_cast<std::size_t>(b)];
      v.count[b] = static_cast<int>(mine.size());
      for (int i = 0; i < capacity; ++i) {
        int const at = b * capacity + i;
        bool const used = i < v.count[b];
        point const p = used ? mine[static_cast<std::size_t>(i)] : point{100, 90, 0};
        v.x(at) = p.x;
        v.y(at) = p.y;
        v.octave(at) = p.octave;
        v.angle(at) = 777;
      }
    }
    ft::copy(exec, device.view(), v);
    orb.describe_keypoints(exec, device.view());
    ft::copy(exec, v, device.view());
    exec.wait();
    std::vector<std::vector<described>> all(points.size());
    for (int b = 0; b < batch; ++b) {
      for (int i = 0; i < capacity; ++i) {
        int const at = b * capacity + i;
        if (i < v.count[b]) {
          all[static_cast<std::size_t>(b)].push_back({v.angle(at), v.orb(at)});
        } else {
          EXPECT_EQ(v.angle(at), 777) << "past the count nothing is written";
        }
      }
    }
    return all;
  }
};
TYPED_TEST_SUITE(describe_keypoints_unit, test::backends);

TYPED_TEST(describe_keypoints_unit, the_extractors_keypoints_get_its_angles_and_descriptors) {
  auto const& exec = this->backend.exec;
  typename TestFixture::extractor orb(exec, small_images(), 2);
  this->upload(orb, {test::random_image(240, 180, 1), test::random_image(240, 180, 2)});
  orb.extract(exec);
  std::vector<std::vector<point>> points(2);
  std::vector<std::vector<described>> want(2);
  for (std::size_t b = 0; b < 2; ++b) {
    auto const kp = orb.keypoints().slice(static_cast<int>(b));
    auto const x = test::column<ft::field::x>(exec, kp);
    auto const y = test::column<ft::field::y>(exec, kp);
    auto const octave = test::column<ft::field::octave>(exec, kp);
    auto const angle = test::column<ft::field::angle>(exec, kp);
    auto const descriptors = test::column<ft::field::orb>(exec, kp);
    auto const n = test::from_exec(exec, static_cast<int const*>(kp.count), 1)[0];
    for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
      points[b].push_back({x[i], y[i], octave[i]});
      want[b].push_back({angle[i], descriptors[i]});
    }
    ASSERT_GT(n, 150);
  }
  auto const check = [&](std::vector<std::vector<described>> const& got) {
    for (std::size_t b = 0; b < 2; ++b) {
      for (std::size_t i = 0; i < want[b].size(); ++i) {
        EXPECT_EQ(got[b][i].angle, want[b][i].angle);
        EXPECT_EQ(ft::hamming(got[b][i].orb, want[b][i].orb), 0) << "image " << b << ", " << i;
      }
    }
  };
  check(this->describe(orb, points, 500));
  // The levels alone are enough.
  typename TestFixture::extractor levels(exec, small_images(), 2);
  this->upload(levels, {test::random_image(240, 180, 1), test::random_image(240, 180, 2)});
  levels.build_levels(exec);
  check(this->describe(levels, points, 500));
}

TYPED_TEST(describe_keypoints_unit, positions_count_by_their_nearest_pixel) {
  auto const& exec = this->backend.exec;
  typename TestFixture::extractor orb(exec, small_images(), 1);
  this->upload(orb, {test::random_image(240, 180, 3)});
  orb.build_levels(exec);
  auto const got = this->describe(
      orb, {{{100, 70, 0}, {100.4f, 69.6f, 0}, {99.51f, 70.49f, 0}, {101, 70, 0}}}, 4)[0];
  EXPECT_EQ(ft::hamming(got[0].orb, got[1].orb), 0);
  EXPECT_EQ(ft::hamming(got[0].orb, got[2].orb), 0);
  EXPECT_NE(ft::hamming(got[0].orb, got[3].orb), 0);
}

TYPED_TEST(describe_keypoints_unit, what_cannot_be_described_is_marked) {
  auto const& exec = this->backend.exec;
  typename TestFixture::extractor orb(exec, small_images(), 1);
  this->upload(orb, {test::random_image(240, 180, 4)});
  orb.build_levels(exec);
  float const nan = std::numeric_limits<float>::quiet_NaN();
  float const inf = std::numeric_limits<float>::infinity();
  std::vector<point> const bad{{17.9f, 90, 0},  {90, 17.9f, 0},  {221.1f, 90, 0}, {90, 161.1f, 0},
                               {nan, 90, 0},    {90, nan, 0},    {inf, 90, 0},    {-inf, 90, 0},
                               {1e30f, 90, 0},  {90, -1e30f, 0}, {100, 90, -1},   {100, 90, 8},
                               {100, 90, 1000}, {30, 90, 7}};
  auto const marked = this->describe(orb, {bad}, 20);
  for (auto const& d : marked[0]) {
    EXPECT_EQ(d.angle, -1);
    EXPECT_TRUE(is_zero(d.orb));
  }
  std::vector<point> const good{{18, 18, 0}, {221, 161, 0}, {100, 90, 7}};
  auto const found = this->describe(orb, {good}, 3);
  for (auto const& d : found[0]) {
    EXPECT_GE(d.angle, 0);
    EXPECT_FALSE(is_zero(d.orb));
  }
  EXPECT_TRUE(this->describe(orb, {{}}, 1)[0].empty());
}

TYPED_TEST(describe_keypoints_unit, another_batch_throws) {
  auto const& exec = this->backend.exec;
  typename TestFixture::extractor orb(exec, small_images(), 2);
  ft::keypoints<TypeParam::exec_type::space> one(10, 1);
  EXPECT_THROW(orb.describe_keypoints(exec, one.view()), ft::bad_argument);
}

}  // namespace describe_keypoints_test
