// SPDX-License-Identifier: Apache-2.0
// The search for initial matches, compared with the loop that defines it.
#include <gtest/gtest.h>

#include <algorithm>
#include <climits>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "ft/kernels/grid.hpp"
#include "ft/kernels/monocular/initial_matches.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_area.hpp"
#include "tests/support/plain_rotations.hpp"
#include "tests/support/random.hpp"

namespace initial_matches_test {

using test::at;
using test::generator;

constexpr float width = 640;
constexpr float height = 480;

struct frame {
  std::vector<float> x, y, angle;
  std::vector<int> octave;
  std::vector<ft::descriptor> orb;

  int size() const { return static_cast<int>(x.size()); }
  void add(float px, float py, ft::descriptor const& d, int level = 0, float turned = 0) {
    x.push_back(px);
    y.push_back(py);
    orb.push_back(d);
    octave.push_back(level);
    angle.push_back(turned);
  }
};

struct frame_pair {
  frame first, second;
  std::vector<ft::vec2<float>> previous;

  /// Every keypoint is searched where it was.
  void stay() {
    previous.clear();
    for (int i = 0; i < first.size(); ++i) { previous.push_back({first.x[at(i)], first.y[at(i)]}); }
  }
};

struct outcome {
  std::vector<int> match;
  std::vector<ft::vec2<float>> previous;
  int count = 0;
};

/// How often the oracle met what the pairs are made for.
struct tally {
  long matched = 0;
  long lost = 0;         ///< to a later keypoint
  long passed_over = 0;  ///< candidates that an earlier keypoint is as near to
  long alike = 0;        ///< refused by the ratio test
  long alone = 0;        ///< matched without a second candidate
  long long_lists = 0;   ///< keypoints with more near candidates than a list has room for
  long exhausted = 0;    ///< of these, those with fewer than two free ones among the nearest
  long dropped = 0;
};

// ---- the rule, told plainly -------------------------------------------------------------------

struct found_two {
  int best = INT_MAX, second = INT_MAX, k = -1;
};

found_two nearest_two(frame_pair const& p, ft::initial_match_params const& params, int i,
                      std::vector<int> const& distance, tally& t) {
  auto const grid = ft::grid_geometry::over(0, 0, width, height);
  auto const& start = p.previous[at(i)];
  auto const area = test::keypoints_in({start.x, start.y, params.window_radius, 0, 0}, grid,
                                       p.second.x, p.second.y, p.second.octave);
  found_two found;
  std::vector<std::pair<int, bool>> near;  // distance, free
  for (int const k : area) {
    int const d = ft::hamming(p.first.orb[at(i)], p.second.orb[at(k)]);
    if (d <= 56) { near.emplace_back(d, distance[at(k)] > d); }
    if (distance[at(k)] <= d) {
      ++t.passed_over;
      continue;
    }
    if (d < found.best) {
      found.second = found.best;
      found.best = d;
      found.k = k;
    } else if (d < found.second) {
      found.second = d;
    }
  }
  if (near.size() > 16) {
    std::stable_sort(near.begin(), near.end(),
                     [](auto const& a, auto const& b) { return a.first < b.first; });
    ++t.long_lists;
    t.exhausted += static_cast<long>(
        std::count_if(near.begin(), near.begin() + 16, [](auto const& c) { return c.second; }) < 2);
  }
  return found;
}

outcome plain_search(frame_pair const& p, ft::initial_match_params const& params, tally& t) {
  outcome out;
  out.match.assign(at(p.first.size()), -1);
  out.previous = p.previous;
  std::vector<int> distance(at(p.second.size()), INT_MAX);
  std::vector<int> owner(at(p.second.size()), -1);
  std::vector<int> accepted;
  std::vector<test::turned_match> turned;
  for (int i = 0; i < p.first.size(); ++i) {
    if (p.first.octave[at(i)] != 0) { continue; }
    auto const f = nearest_two(p, params, i, distance, t);
    if (f.best > params.max_hamming) { continue; }
    if (!(static_cast<float>(f.best) < static_cast<float>(f.second) * params.ratio)) {
      ++t.alike;
      continue;
    }
    t.alone += static_cast<long>(f.second == INT_MAX);
    if (owner[at(f.k)] >= 0) {
      out.match[at(owner[at(f.k)])] = -1;
      ++t.lost;
    }
    out.match[at(i)] = f.k;
    owner[at(f.k)] = i;
    distance[at(f.k)] = f.best;
    accepted.push_back(i);
    turned.push_back({p.first.angle[at(i)], p.second.angle[at(f.k)]});
  }
  auto const kept = test::kept_rotations(turned);
  for (std::size_t a = 0; a < accepted.size(); ++a) {
    int& match = out.match[at(accepted[a])];
    if (params.orientation_check && !kept[a] && match >= 0) {
      match = -1;
      ++t.dropped;
    }
  }
  for (int i = 0; i < p.first.size(); ++i) {
    int const k = out.match[at(i)];
    if (k < 0) { continue; }
    out.previous[at(i)] = {p.second.x[at(k)], p.second.y[at(k)]};
    ++out.count;
    ++t.matched;
  }
  return out;
}

// ---- the stage --------------------------------------------------------------------------------

/// A batch entry for each frame.
template <typename Exec>
ft::keypoints<Exec::space> upload(Exec const& exec, std::vector<frame const*> const& frames,
                                  int spare) {
  int most = 1;
  for (auto const* f : frames) { most = std::max(most, f->size()); }
  ft::keypoints<Exec::space> kp(most + spare, static_cast<int>(frames.size()));
  for (std::size_t b = 0; b < frames.size(); ++b) {
    auto const to = kp.view().slice(static_cast<int>(b));
    auto const& f = *frames[b];
    int const n = f.size();
    ft::copy(exec, ft::array_of<ft::field::x>(to), f.x.data(), at(n));
    ft::copy(exec, ft::array_of<ft::field::y>(to), f.y.data(), at(n));
    ft::copy(exec, ft::array_of<ft::field::angle>(to), f.angle.data(), at(n));
    ft::copy(exec, ft::array_of<ft::field::octave>(to), f.octave.data(), at(n));
    ft::copy(exec, ft::array_of<ft::field::orb>(to), f.orb.data(), at(n));
    ft::copy(exec, to.count, &n, 1);
    exec.wait();
  }
  return kp;
}

template <typename Exec>
std::vector<outcome> search(Exec const& exec, std::vector<frame_pair> const& pairs,
                            ft::initial_match_params const& params, int spare = 0) {
  std::vector<frame const*> first, second;
  for (auto const& p : pairs) {
    first.push_back(&p.first);
    second.push_back(&p.second);
  }
  auto const kp1 = upload(exec, first, spare);
  auto const kp2 = upload(exec, second, 2 * spare);
  int const batch = static_cast<int>(pairs.size());
  ft::frame_pair_view frames{kp1.view(), kp2.view(), {}};
  ft::initial_matches_view out;
  ft::initial_match_workspace work;
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    carve(c, frames.grids, ft::grid_geometry::over(0, 0, width, height), kp2.capacity(), batch);
    carve(c, out, kp1.capacity(), batch);
    carve(c, work, kp1.capacity(), kp2.capacity(), batch);
  });
  std::size_t const wide = at(kp1.capacity());
  for (std::size_t b = 0; b < pairs.size(); ++b) {
    ft::copy(exec, out.previous + b * wide, pairs[b].previous.data(), pairs[b].previous.size());
  }
  exec.wait();
  ft::build_grid<ft::nearest_cell>(exec, frames.second, 0, 1, batch, frames.grids);
  ft::search_initial_matches(exec, frames, params, out, work);
  auto const match = test::from_exec(exec, static_cast<int const*>(out.match), wide * pairs.size());
  auto const previous =
      test::from_exec(exec, static_cast<ft::vec2<float> const*>(out.previous), wide * pairs.size());
  auto const count = test::from_exec(exec, static_cast<int const*>(out.count), pairs.size());
  std::vector<outcome> got(pairs.size());
  for (std::size_t b = 0; b < pairs.size(); ++b) {
    for (std::size_t i = 0; i < wide; ++i) {
      if (i >= pairs[b].previous.size()) {
        EXPECT_EQ(match[b * wide + i], -1);
        continue;
      }
      got[b].match.push_back(match[b * wide + i]);
      got[b].previous.push_back(previous[b * wide + i]);
    }
    got[b].count = count[b];
  }
  return got;
}

bool same(ft::vec2<float> a, ft::vec2<float> b) {
  auto const equal = [](float u, float v) { return u == v || (std::isnan(u) && std::isnan(v)); };
  return equal(a.x, b.x) && equal(a.y, b.y);
}

template <typename Exec>
void expect_plain(Exec const& exec, std::vector<frame_pair> const& pairs,
                  ft::initial_match_params const& params, tally& t, int spare = 0) {
  auto const got = search(exec, pairs, params, spare);
  for (std::size_t b = 0; b < pairs.size(); ++b) {
    SCOPED_TRACE("pair " + std::to_string(b));
    auto const want = plain_search(pairs[b], params, t);
    EXPECT_EQ(got[b].match, want.match);
    EXPECT_EQ(got[b].count, want.count);
    for (std::size_t i = 0; i < want.previous.size(); ++i) {
      EXPECT_TRUE(same(got[b].previous[i], want.previous[i])) << i;
    }
  }
}

// ---- pairs ------------------------------------------------------------------------------------

frame_pair random_pair(unsigned seed) {
  generator random(seed);
  std::vector<ft::descriptor> near;
  for (int i = random.from_to(1, 6); i > 0; --i) { near.push_back(random.descriptor()); }
  bool const alike = random.chance(30);  // rotations mostly in one bin
  int const bits = random.chance(30) ? 1 : random.chance(50) ? 12 : 40;  // 1: all are near
  float const side = random.chance(30) ? 120.0f : width;  // of the part where keypoints are
  frame_pair p;
  auto const fill = [&](frame& f, int n, int least) {
    for (int i = 0; i < n; ++i) {
      auto const d = random.flipped(near[at(random.below(static_cast<int>(near.size())))],
                                    least + random.below(bits));
      f.add(random.real(-5, side), random.real(-5, std::min(side, height)), d,
            random.chance(80) ? 0 : random.from_to(1, 7),
            alike && random.chance(95) ? random.real(0, 10) : random.real(0, 360));
    }
  };
  fill(p.first, random.below(200), 2);
  fill(p.second, random.below(200), 0);
  p.stay();
  for (auto& start : p.previous) {  // as a match with an earlier frame has moved them
    if (random.chance(30)) { start = {random.real(-200, 800), random.real(-200, 700)}; }
    if (random.chance(2)) { start.x = std::numeric_limits<float>::quiet_NaN(); }
  }
  return p;
}

/// A descriptor with the lowest n bits set.
ft::descriptor with_bits(int n) {
  ft::descriptor d{};
  for (int bit = 0; bit < n; ++bit) { d.words[bit / 32] |= 1u << (bit % 32); }
  return d;
}

template <typename Backend>
class initial_matches : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(initial_matches, test::backends);

TYPED_TEST(initial_matches, equal_the_loop) {
  tally t;
  int const scenes = test::effort(60);
  for (int i = 0; i < scenes; ++i) {
    SCOPED_TRACE("scene " + std::to_string(i));
    auto const seed = static_cast<unsigned>(10 * i);
    std::vector<frame_pair> pairs;
    for (unsigned b = 0; b < 3; ++b) { pairs.push_back(random_pair(seed + b)); }
    ft::initial_match_params params;
    params.orientation_check = i % 3 != 0;
    params.ratio = i % 4 == 0 ? 1.5f : 0.9f;  // 1.5: equal ones pass
    params.window_radius = i % 5 == 0 ? 30.0f : 100.0f;
    expect_plain(this->backend.exec, pairs, params, t, i % 2);
    if (this->HasFailure()) { return; }
  }
  if (scenes < 60) { return; }
  EXPECT_GT(t.matched, 1000);
  EXPECT_GT(t.lost, 300);
  EXPECT_GT(t.passed_over, 3000);
  EXPECT_GT(t.alike, 1000);
  EXPECT_GT(t.alone, 100);
  EXPECT_GT(t.long_lists, 1000);
  EXPECT_GT(t.exhausted, 30);
  EXPECT_GT(t.dropped, 300);
}

TYPED_TEST(initial_matches, a_later_keypoint_takes_what_it_is_nearer_to) {
  frame_pair p;
  for (int const bits : {10, 4, 4, 7}) { p.first.add(100, 100, with_bits(bits)); }
  p.second.add(120, 110, with_bits(0));
  p.stay();
  auto const got = search(this->backend.exec, {p}, {})[0];
  // The third one is only as near as the second one; the fourth one is farther.
  EXPECT_EQ(got.match, (std::vector<int>{-1, 0, -1, -1}));
  EXPECT_EQ(got.count, 1);
  EXPECT_TRUE(same(got.previous[1], {120, 110}));
  EXPECT_TRUE(same(got.previous[0], {100, 100}));
}

TYPED_TEST(initial_matches, many_equal_candidates_do_not_overflow_a_list) {
  // Sixty keypoints equal to sixty others: the ratio test refuses all but those that find a single
  // candidate left.
  frame_pair p;
  for (int i = 0; i < 60; ++i) {
    p.first.add(100, 100, with_bits(1 + i / 20));
    p.second.add(static_cast<float>(60 + i), 100, with_bits(0));
  }
  p.second.add(130, 100, with_bits(40));
  p.stay();
  tally t;
  expect_plain(this->backend.exec, {p}, {}, t);
  // Ratio 1.5 lets equal ones pass, which then take one after the other.
  ft::initial_match_params loose;
  loose.ratio = 1.5f;
  expect_plain(this->backend.exec, {p}, loose, t);
  EXPECT_GT(t.exhausted, 20);
}

TYPED_TEST(initial_matches, limits_of_distance_and_ratio) {
  for (int const best : {0, 49, 50, 51}) {
    for (int const second : {0, 54, 55, 56, 200, -1}) {
      frame_pair p;
      p.first.add(100, 100, with_bits(0));
      p.second.add(100, 100, with_bits(best));
      if (second >= 0) { p.second.add(100, 100, with_bits(second)); }
      p.stay();
      tally t;
      expect_plain(this->backend.exec, {p}, {}, t);
    }
  }
}

TYPED_TEST(initial_matches, empty_frames_and_other_octaves_have_none) {
  std::vector<frame_pair> pairs(4);
  pairs[1].first.add(100, 100, {});
  pairs[2].second.add(100, 100, {});
  pairs[3].first.add(100, 100, {}, 1);
  pairs[3].first.add(300, 100, {}, 0);
  pairs[3].second.add(100, 100, {}, 0);
  pairs[3].second.add(300, 100, {}, 1);
  for (auto& p : pairs) { p.stay(); }
  for (auto const& o : search(this->backend.exec, pairs, {})) {
    EXPECT_EQ(o.count, 0);
    for (int const k : o.match) { EXPECT_EQ(k, -1); }
  }
}

TYPED_TEST(initial_matches, frames_with_more_keypoints_than_fit_in_shared_memory) {
  generator random(5);
  frame_pair p;
  constexpr int many = 8200;
  for (int i = 0; i < many; ++i) {
    p.second.add(random.real(0, width), random.real(0, height), random.descriptor(), i % 40);
  }
  for (int i = 0; i < 300; ++i) {
    int const k = random.below(many / 40) * 40;
    p.first.add(p.second.x[at(k)], p.second.y[at(k)], random.flipped(p.second.orb[at(k)], 40));
  }
  p.stay();
  tally t;
  expect_plain(this->backend.exec, {p}, {}, t);
  EXPECT_GT(t.matched, 100);
  EXPECT_GT(t.lost, 5);
}

TYPED_TEST(initial_matches, refuses_arguments_out_of_range) {
  auto const& exec = this->backend.exec;
  ft::frame_pair_view frames;
  frames.first.capacity = 8;
  frames.second.capacity = 9;
  ft::initial_matches_view out;
  out.capacity = 8;
  ft::initial_match_workspace work;
  work.capacity = 8;
  work.second_capacity = 9;
  ft::initial_match_params params;
  EXPECT_NO_THROW(ft::search_initial_matches(exec, frames, params, out, work));
  params.max_hamming = 256;
  EXPECT_THROW(ft::search_initial_matches(exec, frames, params, out, work), ft::bad_argument);
  params.max_hamming = 50;
  work.second_capacity = 8;
  EXPECT_THROW(ft::search_initial_matches(exec, frames, params, out, work), ft::bad_argument);
  work.second_capacity = 9;
  out.capacity = 9;
  EXPECT_THROW(ft::search_initial_matches(exec, frames, params, out, work), ft::bad_argument);
}

}  // namespace initial_matches_test
