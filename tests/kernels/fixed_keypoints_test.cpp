// SPDX-License-Identifier: Apache-2.0
// Which keypoints are of what is fixed to a camera: against a plain loop, on random frames.
#include "ft/kernels/odometry/fixed_keypoints.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace fixed_keypoints_test {

using changes = ft::image_changes;
constexpr int batch = 3, cameras = 2, images = batch * cameras;
constexpr int capacity = 200, numbers = cameras * capacity;
constexpr int width = 320, height = 240;
constexpr float least_disparity = 5;

struct arrays {
  ft::keypoints_view keypoints;
  ft::keypoints_view seen;  // elsewhere: what a lens moves
  float* right_x = nullptr;
  unsigned char* fixed = nullptr;
  ft::image_changes_view changes;
};

template <typename Exec>
struct frames {
  test::mirrored<Exec, arrays> data;
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(width, height, 8, 1.2f);

  explicit frames(test::generator& random)
      : data([](ft::carver& c, arrays& v) {
          carve(c, v.keypoints, capacity, images);
          carve(c, v.seen, capacity, images);
          v.right_x = c.take<float>(batch * numbers);
          v.fixed = c.take<unsigned char>(batch * numbers);
          carve(c, v.changes, images);
        }) {
    arrays& v = data.host;
    for (int i = 0; i < images; ++i) {
      changes& of = v.changes.of[i];
      of.fixed = random.chance(70) ? 1 : 0;
      of.by_quarters = random.chance(50) ? 1 : 0;
      constexpr int quarters = changes::quarters * changes::cells;
      for (int q = 0; q < quarters; ++q) {
        v.changes.quarter_frames[i * quarters + q] = static_cast<std::uint8_t>(random.below(9));
      }
      for (int w = 0; w < changes::words; ++w) {
        of.long_since[w] = static_cast<unsigned>(random.below(1 << 30)) * 7u;
        of.now[w] = of.long_since[w] | static_cast<unsigned>(random.below(1 << 30)) * 5u;
      }
      auto const kp = v.keypoints.slice(i);
      *kp.count = random.from_to(0, capacity);
      for (int k = 0; k < capacity; ++k) {
        int const octave = random.below(8);
        auto const level = test::at(octave);
        kp.octave(k) = octave;
        kp.x(k) = random.real(0, static_cast<float>(geometry.width[level] - 1));
        kp.y(k) = random.real(0, static_cast<float>(geometry.height[level] - 1));
        v.seen.slice(i).x(k) = random.real(0, static_cast<float>(geometry.width[level] - 1));
        v.seen.slice(i).y(k) = random.real(0, static_cast<float>(geometry.height[level] - 1));
        v.right_x[i * capacity + k] = random.chance(40) ? -1.0f : kp.x(k) - random.real(0, 10);
      }
    }
  }
};

/// The same in words: the cell of the pixel that the keypoint has in the whole image.
bool is_fixed(arrays const& v, ft::pyramid_geometry const& geometry, int image, int k,
              bool sure = false) {
  auto const kp = v.keypoints.slice(image);
  if (v.changes.of[image].fixed == 0 || k >= *kp.count) { return false; }
  float const right = v.right_x[image * capacity + k];
  if (right >= 0 && kp.x(k) - right < least_disparity) { return false; }
  auto const seen = v.seen.slice(image);
  float const x = geometry.column(seen.x(k), kp.octave(k));
  float const y = geometry.row(seen.y(k), kp.octave(k));
  bool const waits = !(right >= 0) && v.changes.of[image].by_quarters == 0;
  return v.changes.is_fixed(image, x, y, width, height, sure || waits);
}

template <typename Backend>
class FixedKeypoints : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(FixedKeypoints, test::backends);

TYPED_TEST(FixedKeypoints, AreThoseOfAPlainLoop) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  int marked = 0, others = 0;
  for (unsigned seed = 1; seed <= 5; ++seed) {
    test::generator random(seed);
    frames<exec_type> f(random);
    f.data.push(backend.exec);
    arrays const& there = f.data.device;
    ft::fixed_keypoints in{};
    in.frame.keypoints = there.keypoints;
    in.frame.keypoint_step = cameras;
    in.frame.cameras = cameras;
    in.frame.batch = batch;
    in.frame.right_x = there.right_x;
    in.seen = there.seen;
    in.geometry = f.geometry;
    in.changes = there.changes;
    in.least_disparity = least_disparity;
    in.fixed = there.fixed;
    ft::mark_fixed_keypoints(backend.exec, in);
    std::vector<unsigned char> found(batch * numbers);
    ft::copy(backend.exec, found.data(), static_cast<unsigned char const*>(there.fixed),
             found.size());
    backend.exec.wait();
    for (int i = 0; i < images; ++i) {
      for (int k = 0; k < capacity; ++k) {
        bool const wanted = is_fixed(f.data.host, f.geometry, i, k);
        bool const sure = wanted && is_fixed(f.data.host, f.geometry, i, k, true);
        ASSERT_EQ(found[test::at(i * capacity + k)], sure     ? ft::fixed_for_long
                                                     : wanted ? 1
                                                              : 0)
            << seed << ' ' << i << ' ' << k;
        ++(wanted ? marked : others);
      }
    }
  }
  EXPECT_GT(marked, 100);
  EXPECT_GT(others, 100);
}

}  // namespace fixed_keypoints_test
