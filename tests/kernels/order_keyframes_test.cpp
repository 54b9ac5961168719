// SPDX-License-Identifier: Apache-2.0
// A map whose keyframes get other numbers: all that belongs to a keyframe goes with it, the points
// stay where they are and are seen by the same ones.
#include "ft/kernels/loops/order_keyframes.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/containers/map_points.hpp"
#include "ft/core/error.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"

namespace order_keyframes_test {

constexpr int positions = 70;  // two words of a mask
constexpr int slots = 300;     // more than a block has threads
constexpr int capacity = 40;   // more than a warp has
constexpr int cameras = 2;
constexpr int made = 95, count = 66;

template <typename Exec>
using map_of = test::mirrored<Exec, ft::odometry_map_view>;

void layout(ft::carver& c, ft::odometry_map_view& v) {
  carve(c, v, {slots, {positions, cameras, capacity}}, 1);
}
int position(int number) { return (number - 1) % positions; }
/// The next number in some order of all.
int number_of(int before) { return made - count + 1 + (before * 29 + 7) % count; }

/// Everything tells the number of its keyframe.
void fill(ft::odometry_map_view const& v) {
  ft::keyframes_view const& k = v.keyframes;
  k.made[0] = made;
  k.count[0] = count;
  for (int n = made - count + 1; n <= made; ++n) {
    int const p = position(n);
    k.T_cw[p] = ft::rigid<double>::identity();
    k.T_cw[p].t.x = n;
    k.time_ns[p] = 1000 * n;
    k.neighbour[p] = n - 1;  // that of the oldest one has left
    k.shared[p] = n;
    for (int c = 0; c < cameras; ++c) { k.keypoints[p * cameras + c] = n % capacity + c; }
    for (int i = 0; i < cameras * capacity; ++i) {
      auto const at = k.at(0, p, i);
      k.x[at] = static_cast<float>(n);
      k.y[at] = static_cast<float>(i);
      k.right_x[at] = static_cast<float>(n + i);
      k.octave[at] = n % 8;
      k.holder[at] = (n + i) % slots;
      k.holder_number[at] = n * i;
      k.aligned[at] = static_cast<unsigned char>((n + i) % 2);
    }
  }
  for (int s = 0; s < slots; ++s) {
    v.records.number[s] = s + 1;
    for (int n = made - count + 1; n <= made; ++n) {
      bool const sees = (n + s) % 3 == 0;
      if (sees) {
        v.records.mask(0, s)[position(n) / 64] |= std::uint64_t{1} << (position(n) % 64);
      }
    }
  }
}

template <typename Backend>
class OrderKeyframes : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(OrderKeyframes, test::backends);

TYPED_TEST(OrderKeyframes, AllOfAKeyframeGoesWithIt) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  map_of<exec_type> from(layout), to(layout);
  test::mirrored<exec_type, int*> place(
      [](ft::carver& c, int*& v) { v = c.take<int>(std::size_t{positions}); });
  clear(backend.exec, from.device);
  from.pull(backend.exec);
  fill(from.host);
  from.push(backend.exec);
  to.take(from);
  to.push(backend.exec);
  std::vector<int> now(made + 1, 0);  // the number that each gets
  for (int p = 0; p < positions; ++p) { place.host[p] = -1; }
  for (int i = 0; i < count; ++i) {
    now[static_cast<std::size_t>(number_of(i))] = made - count + 1 + i;
    place.host[position(number_of(i))] = position(made - count + 1 + i);
  }
  place.push(backend.exec);
  order_keyframes(backend.exec, from.device, place.device, to.device);
  to.pull(backend.exec);
  ft::keyframes_view const& k = to.host.keyframes;
  EXPECT_EQ(k.made[0], made);
  EXPECT_EQ(k.count[0], count);
  for (int n = made - count + 1; n <= made; ++n) {
    int const p = position(now[static_cast<std::size_t>(n)]);
    EXPECT_EQ(k.T_cw[p].t.x, n);
    EXPECT_EQ(k.time_ns[p], 1000 * n);
    bool const is_oldest = n == made - count + 1;
    EXPECT_EQ(k.neighbour[p], is_oldest ? 0 : now[static_cast<std::size_t>(n - 1)]) << n;
    EXPECT_EQ(k.shared[p], is_oldest ? 0 : n);
    for (int c = 0; c < cameras; ++c) { EXPECT_EQ(k.keypoints[p * cameras + c], n % capacity + c); }
    for (int i = 0; i < cameras * capacity; ++i) {
      auto const at = k.at(0, p, i);
      ASSERT_EQ(k.x[at], static_cast<float>(n));
      ASSERT_EQ(k.y[at], static_cast<float>(i));
      ASSERT_EQ(k.right_x[at], static_cast<float>(n + i));
      ASSERT_EQ(k.octave[at], n % 8);
      ASSERT_EQ(k.holder[at], (n + i) % slots);
      ASSERT_EQ(k.holder_number[at], n * i);
      ASSERT_EQ(k.aligned[at], (n + i) % 2);
    }
    for (int s = 0; s < slots; ++s) {
      bool const sees = (to.host.records.mask(0, s)[p / 64] >> (p % 64) & 1) != 0;
      ASSERT_EQ(sees, (n + s) % 3 == 0) << n << " sees " << s;
    }
  }
  for (int s = 0; s < slots; ++s) {
    EXPECT_EQ(to.host.records.number[s], s + 1);
    EXPECT_EQ(to.host.records.observers(0, s), from.host.records.observers(0, s));
  }
}

TYPED_TEST(OrderKeyframes, RefusesMapsOfAnotherShape) {
  TypeParam backend;
  map_of<typename TypeParam::exec_type> map(layout),
      other([](ft::carver&c, ft::odometry_map_view&v) {
        carve(c, v, {slots, {positions - 1, cameras, capacity}}, 1);
      }),
      batch([](ft::carver&c, ft::odometry_map_view&v) {
        carve(c, v, {slots, {positions, cameras, capacity}}, 2);
      });
  EXPECT_THROW(order_keyframes(backend.exec, other.device, nullptr, map.device), ft::bad_argument);
  EXPECT_THROW(order_keyframes(backend.exec, batch.device, nullptr, batch.device),
               ft::bad_argument);
}

}  // namespace order_keyframes_test
