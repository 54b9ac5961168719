// SPDX-License-Identifier: Apache-2.0
// The words of an odometry's keyframes: gathered, numbered, kept and listed, against plain loops.
#include "ft/kernels/words/keyframe_words.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace keyframe_words_test {

using test::at;

constexpr int batch = 3;
constexpr int cameras = 2;
constexpr int capacity = 20;
constexpr int numbers = cameras * capacity;
constexpr int positions = 4;
constexpr int slots = 16;
/// Keypoints of the images: none, all, and in between.
constexpr int counts[batch * cameras] = {20, 13, 0, 20, 7, 0};

struct arrays {
  ft::keypoints_view keypoints;
  int* wanted = nullptr;
  ft::descriptors_view gathered;
  ft::frame_words_view words;
  ft::keyframe_words_view rows;
  ft::odometry_map_view map;
  ft::keyframe_order* order = nullptr;
  int* live = nullptr;
};

/// Random frames and words of these.
template <typename Exec>
struct scene {
  Exec const& exec;
  test::generator random;
  test::mirrored<Exec, arrays> data;

  scene(Exec const& on, unsigned seed)
      : exec(on), random(seed), data([](ft::carver& c, arrays& v) {
          ft::keyframes_capacity const keyframes{positions, cameras, capacity};
          carve(c, v.keypoints, capacity, cameras * batch);
          v.wanted = c.take<int>(batch);
          carve(c, v.gathered, numbers, batch);
          carve(c, v.words, batch, numbers);
          carve(c, v.rows, keyframes, 1000, batch);
          carve(c, v.map, {slots, keyframes}, batch);
          v.order = c.take<ft::keyframe_order>(batch);
          v.live = c.take<int>(positions * numbers);
        }) {
    arrays const& v = data.host;
    std::copy_n(counts, batch * cameras, v.keypoints.count);
    for (int i = 0; i < batch * numbers; ++i) {
      v.keypoints.orb(i) = random.descriptor();
      v.keypoints.angle(i) = random.real(0, 360);
    }
    for (int b = 0; b < batch; ++b) { make_words(b); }
  }
  ft::frame_view frame() const {
    ft::frame_view f{};
    f.keypoints = data.device.keypoints;
    f.keypoint_step = f.cameras = cameras;
    f.batch = batch;
    return f;
  }
  int keypoints(int b) const { return counts[cameras * b] + counts[cameras * b + 1]; }
  /// The number of the keypoint whose descriptor is gathered at a place.
  int number(int b, int place) const {
    int const left = counts[cameras * b];
    return place < left ? place : capacity + place - left;
  }

private:
  /// Groups of one to three places each, and words.
  void make_words(int b) {
    ft::word_list_view const& bag = data.host.words.bag;
    ft::node_groups_view const& groups = data.host.words.groups;
    bag.count[b] = keypoints(b) / 2;
    for (int i = 0; i < numbers; ++i) {
      bag.word[bag.at(b) + i] = static_cast<std::uint32_t>(random.below(1000));
      bag.value[bag.at(b) + i] = static_cast<double>(random.real(0, 1));
      groups.node[groups.at(b) + i] = static_cast<std::uint32_t>(random.below(1000));
      groups.keypoint[groups.at(b) + i] = i;
    }
    int* const start = groups.start + groups.start_at(b);
    int count = 0;
    int place = 0;
    for (; place < keypoints(b); ++count) {
      start[count] = place;
      place = std::min(place + 1 + random.below(3), keypoints(b));
    }
    start[count] = place;
    groups.count[b] = count;
  }
};

template <typename Backend>
class KeyframeWords : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  Backend backend;
};
TYPED_TEST_SUITE(KeyframeWords, test::backends);

TYPED_TEST(KeyframeWords, DescriptorsOfAllCamerasAreGatheredSideBySide) {
  scene<typename TestFixture::exec_type> s(this->backend.exec, 1);
  arrays const& v = s.data.host;
  int const wanted[batch] = {1, 0, 1};
  std::copy_n(wanted, batch, v.wanted);
  s.data.push(s.exec);
  ft::gather_descriptors(s.exec, s.frame(), s.data.device.wanted, s.data.device.gathered);
  s.data.pull(s.exec);
  for (int b = 0; b < batch; ++b) {
    ASSERT_EQ(v.gathered.count[b], wanted[b] * s.keypoints(b)) << b;
    for (int place = 0; place < v.gathered.count[b]; ++place) {
      EXPECT_EQ(ft::hamming(v.gathered.orb(b * numbers + place),
                            v.keypoints.orb(b * numbers + s.number(b, place))),
                0)
          << b << " " << place;
    }
  }
  auto smaller = s.data.device.gathered;
  smaller.capacity = numbers - 1;
  EXPECT_THROW(ft::gather_descriptors(s.exec, s.frame(), s.data.device.wanted, smaller),
               ft::bad_argument);
  EXPECT_THROW(ft::gather_descriptors(s.exec, s.frame(), nullptr, s.data.device.gathered),
               ft::bad_argument);
}

TYPED_TEST(KeyframeWords, PlacesBecomeNumbersOfKeypoints) {
  scene<typename TestFixture::exec_type> s(this->backend.exec, 2);
  s.data.push(s.exec);
  ft::node_groups_view const& groups = s.data.device.words.groups;
  ft::number_keypoints(s.exec, s.frame(), groups);
  s.data.pull(s.exec);
  for (int b = 0; b < batch; ++b) {
    for (int place = 0; place < numbers; ++place) {
      // What no group has stays.
      EXPECT_EQ(s.data.host.words.groups.keypoint[groups.at(b) + place],
                place < s.keypoints(b) ? s.number(b, place) : place)
          << b << " " << place;
    }
  }
  EXPECT_THROW(ft::number_keypoints(s.exec, s.frame(), groups.slice(0, 2)), ft::bad_argument);
}

TYPED_TEST(KeyframeWords, RowsOfNewKeyframesAreWritten) {
  scene<typename TestFixture::exec_type> s(this->backend.exec, 3);
  arrays const& v = s.data.host;
  ft::keyframe_order const order[batch] = {ft::keyframe_order::add, ft::keyframe_order::none,
                                           ft::keyframe_order::begin_map};
  int const made[batch] = {6, 2, 4};
  std::copy_n(order, batch, v.order);
  std::copy_n(made, batch, v.map.keyframes.made);
  std::fill_n(v.rows.database.number, batch * positions, 77u);
  s.data.push(s.exec);
  ft::keep_keyframe_words(s.exec, s.frame(), s.data.device.order, s.data.device.map.keyframes,
                          s.data.device.words, s.data.device.rows);
  s.data.pull(s.exec);
  int const position[batch] = {1, -1, 3};  // of the newest keyframe that is kept
  for (int row = 0; row < batch * positions; ++row) {
    int const b = row / positions;
    if (row % positions != position[b]) {
      EXPECT_EQ(v.rows.database.number[row], 77u) << row;
      continue;
    }
    ft::keyframe_words_view const rows = v.rows.slice(b);
    int const p = row % positions;
    EXPECT_EQ(rows.database.number[p], static_cast<unsigned>(made[b]));
    EXPECT_EQ(rows.database.neighbours[p].count, 0);
    ASSERT_EQ(rows.database.words[p], v.words.bag.count[b]);
    for (int i = 0; i < rows.database.words[p]; ++i) {
      EXPECT_EQ(rows.database.word[rows.database.at(p) + i], v.words.bag.word[b * numbers + i]);
      EXPECT_EQ(rows.database.value[rows.database.at(p) + i], v.words.bag.value[b * numbers + i]);
    }
    auto const to = rows.groups.slice(p, 1);
    auto const from = v.words.groups.slice(b, 1);
    ASSERT_EQ(*to.count, *from.count);
    for (int i = 0; i <= *to.count; ++i) {
      EXPECT_EQ(to.start[i], from.start[i]);
      if (i < *to.count) { EXPECT_EQ(to.node[i], from.node[i]); }
    }
    for (int i = 0; i < s.keypoints(b); ++i) {
      EXPECT_EQ(to.keypoint[i], from.keypoint[i]);
      int const k = s.number(b, i);
      EXPECT_EQ(ft::hamming(rows.orb[rows.at(0, p) + k], v.keypoints.orb(b * numbers + k)), 0);
      EXPECT_EQ(rows.angle[rows.at(0, p) + k], v.keypoints.angle(b * numbers + k));
    }
  }
  auto other = s.data.device.rows;
  other.positions = positions - 1;
  EXPECT_THROW(ft::keep_keyframe_words(s.exec, s.frame(), s.data.device.order,
                                       s.data.device.map.keyframes, s.data.device.words, other),
               ft::bad_argument);
}

TYPED_TEST(KeyframeWords, KeyframesThatHaveLeftAreForgotten) {
  scene<typename TestFixture::exec_type> s(this->backend.exec, 4);
  arrays const& v = s.data.host;
  constexpr int b = 1;
  ft::keyframes_view const& ring = v.map.keyframes;
  ring.made[b] = 7;
  ring.count[b] = 2;                                     // 6 and 7, at positions 1 and 2
  std::uint32_t const number[positions] = {5, 6, 0, 4};  // 7 has no words yet
  std::copy_n(number, positions, v.rows.slice(b).database.number);
  std::fill_n(v.rows.database.words, batch * positions, 9);
  for (int slot = 0; slot < slots; ++slot) {
    v.map.records.number[v.map.records.at(b, slot)] = slot % 4 == 0 ? 0 : 100 + slot;
  }
  for (int p = 0; p < positions; ++p) {
    ring.keypoints[ring.at(b, p) * cameras] = 15;
    ring.keypoints[ring.at(b, p) * cameras + 1] = 0;
    for (int i = 0; i < numbers; ++i) {
      int const slot = s.random.below(slots + 1) - 1;
      ring.holder[ring.at(b, p, i)] = slot;
      ring.holder_number[ring.at(b, p, i)] = slot + (s.random.chance(80) ? 100 : 99);
    }
  }
  s.data.push(s.exec);
  ft::list_live_keyframes(s.exec, s.data.device.map, b, s.data.device.rows, s.data.device.live);
  s.data.pull(s.exec);
  int listed = 0;
  for (int row = 0; row < batch * positions; ++row) {
    bool const forgotten = row / positions == b && row % positions != 1;
    EXPECT_EQ(v.rows.database.words[row], forgotten ? 0 : 9) << row;
  }
  for (int p = 0; p < positions; ++p) {
    EXPECT_EQ(v.rows.slice(b).database.number[p], p == 1 ? 6u : 0u) << p;
    for (int i = 0; i < numbers; ++i) {
      int const slot = ring.holder[ring.at(b, p, i)];
      bool const holds = p == 1 && i < 15 && slot >= 0 && slot % 4 != 0 &&
                         ring.holder_number[ring.at(b, p, i)] == 100 + slot;
      EXPECT_EQ(v.live[p * numbers + i], holds ? slot : -1) << p << " " << i;
      listed += static_cast<int>(holds);
    }
  }
  EXPECT_GT(listed, 3);
  EXPECT_THROW(ft::list_live_keyframes(s.exec, s.data.device.map, batch, s.data.device.rows,
                                       s.data.device.live),
               ft::bad_argument);
}

}  // namespace keyframe_words_test
