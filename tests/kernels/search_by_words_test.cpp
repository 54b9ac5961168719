// SPDX-License-Identifier: Apache-2.0
// The search by words, compared with a loop over the nodes that two frames share.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/kernels/words/search_by_words.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_rotations.hpp"
#include "tests/support/random.hpp"
#include "tests/support/word_groups.hpp"

namespace search_by_words_test {

using test::at;
using test::generator;

/// The keypoints of a frame or a keyframe.
struct keypoints {
  std::vector<ft::descriptor> orb;
  std::vector<float> angle;
  std::vector<int> node;    ///< -1 = in no group
  std::vector<int> holder;  ///< of a keyframe
  int left = 0;             ///< left keypoints, of two cameras

  int size() const { return static_cast<int>(orb.size()); }
  void add(ft::descriptor const& d, int in_node, int held = -1, float turned = 0) {
    orb.push_back(d);
    node.push_back(in_node);
    holder.push_back(held);
    angle.push_back(turned);
  }
};

struct scene {
  std::vector<keypoints> keyframes, frames;
  std::vector<int> keyframe, frame;  ///< of each pair
  bool two_cameras = false;
  ft::words_search_params params;
};

struct outcome {
  std::vector<std::vector<int>> match;  ///< of each pair, of its frame's keypoints
  std::vector<int> count;
};

/// How often the oracle met what the scenes are made for.
struct tally {
  long matched = 0;
  long contested = 0;  ///< the nearest one was taken
  long alike = 0;      ///< refused by the ratio test
  long first_of_equals = 0;
  long right_of_refused = 0;  ///< matched in the right camera alone
  long right_not_searched = 0;
  long dropped = 0;
};

// ---- the rule, told plainly -------------------------------------------------------------------

struct nearest {
  int best = 256;
  int second = 256;
  int k = -1;

  void add(int distance, int candidate, tally& t) {
    t.first_of_equals += static_cast<long>(distance == best && k >= 0);
    if (distance < best) {
      second = best;
      best = distance;
      k = candidate;
    } else if (distance < second) {
      second = distance;
    }
  }
};

std::vector<int> matched_keypoints(scene const& s, keypoints const& from, keypoints const& to,
                                   tally& t) {
  std::vector<int> source(at(to.size()), -1);
  int const last = *std::max_element(from.node.begin(), from.node.end());
  for (int node = 0; node <= last; ++node) {
    for (int i = 0; i < from.size(); ++i) {
      if (from.node[at(i)] != node || from.holder[at(i)] < 0) { continue; }
      nearest of[2], all;
      tally none;
      for (int k = 0; k < to.size(); ++k) {
        if (to.node[at(k)] != node) { continue; }
        int const distance = ft::hamming(from.orb[at(i)], to.orb[at(k)]);
        all.add(distance, k, none);
        if (source[at(k)] >= 0) { continue; }
        of[s.two_cameras && k >= to.left ? 1 : 0].add(distance, k, t);
      }
      t.contested += static_cast<long>(all.k >= 0 && all.best <= 50 && source[at(all.k)] >= 0);
      if (of[0].best > s.params.max_hamming) {
        t.right_not_searched += static_cast<long>(of[1].best <= s.params.max_hamming);
        continue;
      }
      bool const left =
          static_cast<float>(of[0].best) < s.params.ratio * static_cast<float>(of[0].second);
      if (left) { source[at(of[0].k)] = i; }
      t.alike += static_cast<long>(!left);
      if (of[1].best <= s.params.max_hamming) {
        source[at(of[1].k)] = i;
        t.right_of_refused += static_cast<long>(!left);
      }
    }
  }
  return source;
}

outcome plain_search(scene const& s, tally& t) {
  outcome out;
  for (std::size_t p = 0; p < s.keyframe.size(); ++p) {
    bool const there = s.keyframe[p] >= 0 && s.keyframe[p] < static_cast<int>(s.keyframes.size()) &&
                       s.frame[p] >= 0 && s.frame[p] < static_cast<int>(s.frames.size());
    out.match.emplace_back();
    out.count.push_back(0);
    if (!there) { continue; }
    keypoints const& from = s.keyframes[at(s.keyframe[p])];
    keypoints const& to = s.frames[at(s.frame[p])];
    auto& match = out.match.back();
    match.assign(at(to.size()), -1);
    if (from.size() == 0) { continue; }
    auto const source = matched_keypoints(s, from, to, t);
    std::vector<test::turned_match> turned;
    std::vector<int> which;
    for (int k = 0; k < to.size(); ++k) {
      if (source[at(k)] < 0) { continue; }
      which.push_back(k);
      turned.push_back({from.angle[at(source[at(k)])], to.angle[at(k)]});
    }
    auto const kept = test::kept_rotations(turned);
    for (std::size_t m = 0; m < which.size(); ++m) {
      if (s.params.orientation_check && !kept[m]) {
        ++t.dropped;
        continue;
      }
      match[at(which[m])] = from.holder[at(source[at(which[m])])];
      ++out.count.back();
      ++t.matched;
    }
  }
  return out;
}

// ---- the stage --------------------------------------------------------------------------------

/// Rows of keypoints in an executor's memory.
template <typename Exec>
struct uploaded {
  int capacity;
  test::uploaded_groups<Exec> groups;
  ft::buffer<ft::descriptor, Exec::space> orb;
  ft::buffer<float, Exec::space> angle;
  ft::buffer<int, Exec::space> left, holder;

  uploaded(Exec const& exec, std::vector<keypoints> const& rows, int spare)
      : capacity(most(rows) + spare),
        groups(exec, groups_of(rows, capacity), capacity),
        orb(test::to_exec(exec, column(rows, &keypoints::orb, ft::descriptor{}))),
        angle(test::to_exec(exec, column(rows, &keypoints::angle, 0.0f))),
        left(test::to_exec(exec, lefts(rows))),
        holder(test::to_exec(exec, column(rows, &keypoints::holder, 4711))) {}

  ft::word_keypoints_view view(bool two_cameras) const {
    return {groups.view(), orb.data(), angle.data(), two_cameras ? left.data() : nullptr};
  }

private:
  static int most(std::vector<keypoints> const& rows) {
    int n = 1;
    for (auto const& r : rows) { n = std::max(n, r.size()); }
    return n;
  }
  static std::vector<test::words_groups> groups_of(std::vector<keypoints> const& rows, int wide) {
    std::vector<test::words_groups> all;
    for (auto const& r : rows) { all.emplace_back(r.node, wide); }
    return all;
  }
  static std::vector<int> lefts(std::vector<keypoints> const& rows) {
    std::vector<int> all;
    for (auto const& r : rows) { all.push_back(r.left); }
    return all;
  }
  template <typename T>
  std::vector<T> column(std::vector<keypoints> const& rows, std::vector<T> keypoints::*of,
                        T const& rest) const {
    std::vector<T> all;
    for (auto const& r : rows) {
      all.insert(all.end(), (r.*of).begin(), (r.*of).end());
      all.resize(all.size() + at(capacity - r.size()), rest);
    }
    return all;
  }
};

template <typename Exec>
outcome search(Exec const& exec, scene const& s, int spare = 0) {
  uploaded<Exec> const keyframes(exec, s.keyframes, spare);
  uploaded<Exec> const frames(exec, s.frames, 2 * spare);
  auto const keyframe = test::to_exec(exec, s.keyframe);
  auto const frame = test::to_exec(exec, s.frame);
  int const pairs = static_cast<int>(s.keyframe.size());
  ft::word_matches_view matches;
  ft::words_search_workspace work;
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    carve(c, matches, pairs, frames.capacity);
    carve(c, work, pairs, frames.capacity);
  });
  ft::words_search in;
  in.keyframes = keyframes.view(s.two_cameras);
  in.holder = keyframes.holder.data();
  in.frames = frames.view(s.two_cameras);
  in.keyframe = keyframe.data();
  in.frame = frame.data();
  ft::search_by_words(exec, in, s.params, matches, work);
  std::size_t const wide = at(frames.capacity);
  auto const match =
      test::from_exec(exec, static_cast<int const*>(matches.match), wide * s.keyframe.size());
  outcome out;
  out.count = test::from_exec(exec, static_cast<int const*>(matches.count), s.keyframe.size());
  for (std::size_t p = 0; p < s.keyframe.size(); ++p) {
    std::size_t const n = s.keyframe[p] >= 0 &&
                                  s.keyframe[p] < static_cast<int>(s.keyframes.size()) &&
                                  s.frame[p] >= 0 && s.frame[p] < static_cast<int>(s.frames.size())
                              ? s.frames[at(s.frame[p])].orb.size()
                              : 0;
    auto const row = match.begin() + static_cast<std::ptrdiff_t>(p * wide);
    out.match.emplace_back(row, row + static_cast<std::ptrdiff_t>(n));
    for (std::size_t k = n; k < wide; ++k) { EXPECT_EQ(row[static_cast<std::ptrdiff_t>(k)], -1); }
  }
  return out;
}

template <typename Exec>
void expect_plain(Exec const& exec, scene const& s, tally& t, int spare = 0) {
  auto const want = plain_search(s, t);
  auto const got = search(exec, s, spare);
  EXPECT_EQ(got.count, want.count);
  EXPECT_EQ(got.match, want.match);
}

// ---- scenes -----------------------------------------------------------------------------------

/// Keypoints near a few descriptors, so that many are candidates of each other.
keypoints random_keypoints(generator& random, std::vector<ft::descriptor> const& near, int most,
                           int nodes) {
  keypoints all;
  int const n = random.below(most + 1);
  bool const alike = random.chance(30);  // rotations mostly in one bin
  for (int i = 0; i < n; ++i) {
    auto const d = random.flipped(near[at(random.below(static_cast<int>(near.size())))],
                                  random.chance(50) ? 3 : 30);
    all.add(d, random.chance(10) ? -1 : 3 * random.below(nodes),
            random.chance(70) ? random.below(1000) : -1,
            alike && random.chance(95) ? random.real(0, 10) : random.real(0, 360));
  }
  all.left = random.below(n + 1);
  return all;
}

scene random_scene(unsigned seed) {
  generator random(seed);
  scene s;
  std::vector<ft::descriptor> near;
  for (int i = random.from_to(1, 6); i > 0; --i) { near.push_back(random.descriptor()); }
  int const most = random.chance(20) ? 400 : 60;
  int const nodes = random.from_to(1, 8);
  for (int i = random.from_to(1, 4); i > 0; --i) {
    s.keyframes.push_back(random_keypoints(random, near, most, nodes));
  }
  for (int i = random.from_to(1, 3); i > 0; --i) {
    s.frames.push_back(random_keypoints(random, near, most, nodes));
  }
  for (int i = 0; i < 8; ++i) {
    s.keyframe.push_back(random.from_to(-1, static_cast<int>(s.keyframes.size())));
    s.frame.push_back(random.from_to(random.chance(10) ? -1 : 0,
                                     static_cast<int>(s.frames.size()) - random.below(2)));
  }
  s.two_cameras = random.chance(50);
  s.params.ratio = random.chance(20) ? 0.1f : random.real(0.6f, 1);
  s.params.orientation_check = random.chance(70);
  return s;
}

template <typename Backend>
class search_by_words : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(search_by_words, test::backends);

TYPED_TEST(search_by_words, equals_a_loop_over_shared_nodes) {
  tally t;
  int const scenes = test::effort(150);
  for (int i = 0; i < scenes; ++i) {
    SCOPED_TRACE("scene " + std::to_string(i));
    expect_plain(this->backend.exec, random_scene(static_cast<unsigned>(i)), t, i % 3);
    if (this->HasFailure()) { return; }
  }
  if (scenes < 150) { return; }
  EXPECT_GT(t.matched, 3000);
  EXPECT_GT(t.contested, 1000);
  EXPECT_GT(t.alike, 1000);
  EXPECT_GT(t.first_of_equals, 1000);
  EXPECT_GT(t.right_of_refused, 300);
  EXPECT_GT(t.right_not_searched, 50);
  EXPECT_GT(t.dropped, 1000);
}

TYPED_TEST(search_by_words, ten_keyframes_are_compared_with_one_frame) {
  generator random(3);
  scene s;
  s.frames.emplace_back();
  for (int i = 0; i < 300; ++i) { s.frames[0].add(random.descriptor(), i % 20); }
  for (int c = 0; c < 10; ++c) {
    keypoints k;
    for (int i = 0; i < 200; ++i) {  // those of every candidate see another part of the frame
      k.add(s.frames[0].orb[at((i + 10 * c) % 300)], (i + 10 * c) % 20, 1000 * c + i);
    }
    s.keyframes.push_back(k);
    s.keyframe.push_back(c);
    s.frame.push_back(0);
  }
  auto const got = search(this->backend.exec, s);
  for (int c = 0; c < 10; ++c) {
    EXPECT_EQ(got.count[at(c)], 200);
    for (int i = 0; i < 200; ++i) {
      EXPECT_EQ(got.match[at(c)][at((i + 10 * c) % 300)], 1000 * c + i);
    }
  }
}

TYPED_TEST(search_by_words, nothing_is_found_without_a_common_node) {
  scene s;
  s.keyframes.resize(3);
  s.frames.resize(2);
  s.keyframes[1].add({}, 4, 17);
  s.keyframes[2].add({}, -1, 17);
  s.frames[1].add({}, 3);
  s.frames[1].add({}, 5);
  for (int k = 0; k < 3; ++k) {
    for (int f = 0; f < 2; ++f) {
      s.keyframe.push_back(k);
      s.frame.push_back(f);
    }
  }
  auto const got = search(this->backend.exec, s);
  EXPECT_EQ(got.count, std::vector<int>(6, 0));
  EXPECT_EQ(got.match[3], (std::vector<int>{-1, -1}));
}

TYPED_TEST(search_by_words, equal_descriptors_match_where_there_is_no_choice) {
  scene s;
  s.keyframes.resize(1);
  for (int i = 0; i < 3; ++i) { s.keyframes[0].add({}, 2, 30 + i); }
  s.keyframe = s.frame = {0};
  s.frames.resize(1);
  s.frames[0].add({}, 2);
  s.frames[0].left = 1;
  EXPECT_EQ(search(this->backend.exec, s).match[0], std::vector<int>{30});
  s.frames[0].add({}, 2);
  s.frames[0].left = 2;
  EXPECT_EQ(search(this->backend.exec, s).match[0], (std::vector<int>{-1, -1}));
  // Two cameras: the left one refuses each, the right one takes one after the other.
  s.two_cameras = true;
  for (int i = 0; i < 2; ++i) { s.frames[0].add({}, 2); }
  EXPECT_EQ(search(this->backend.exec, s).match[0], (std::vector<int>{-1, -1, 30, 31}));
  // Nothing in the left camera: nothing in the right one.
  s.frames[0].left = 0;
  EXPECT_EQ(search(this->backend.exec, s).match[0], std::vector<int>(4, -1));
}

TYPED_TEST(search_by_words, limits_of_distance_and_ratio) {
  auto const with_bits = [](int n) {
    ft::descriptor d{};
    for (int bit = 0; bit < n; ++bit) { d.words[bit / 32] |= 1u << (bit % 32); }
    return d;
  };
  for (int const best : {49, 50, 51}) {
    for (int const second : {66, 67, 68, 256}) {
      scene s;
      s.keyframes.resize(1);
      s.keyframes[0].add({}, 1, 9);
      s.frames.resize(1);
      s.frames[0].add(with_bits(second), 1);
      s.frames[0].add(with_bits(best), 1);
      s.keyframe = s.frame = {0};
      bool const near = best <= 50 && static_cast<float>(best) < 0.75f * static_cast<float>(second);
      EXPECT_EQ(search(this->backend.exec, s).match[0], (std::vector<int>{-1, near ? 9 : -1}))
          << best << " " << second;
    }
  }
}

TYPED_TEST(search_by_words, refuses_arguments_out_of_range) {
  auto const& exec = this->backend.exec;
  ft::words_search in;
  in.frames.groups.capacity = 8;
  ft::words_search_params params;
  ft::word_matches_view matches;
  matches.capacity = 7;
  EXPECT_THROW(ft::search_by_words(exec, in, params, matches, {}), ft::bad_argument);
  matches.capacity = 8;
  EXPECT_NO_THROW(ft::search_by_words(exec, in, params, matches, {}));
  for (int const limit : {-1, 256}) {
    params.max_hamming = limit;
    EXPECT_THROW(ft::search_by_words(exec, in, params, matches, {}), ft::bad_argument);
  }
}

}  // namespace search_by_words_test
