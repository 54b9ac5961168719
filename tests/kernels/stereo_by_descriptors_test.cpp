// SPDX-License-Identifier: Apache-2.0
// Stereo partners by descriptors alone, against a loop over all pairs of keypoints.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/kernels/stereo/by_descriptors.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"

namespace stereo_by_descriptors_test {

constexpr int width = 320, height = 240, capacity = 300, pairs = 3;

ft::pyramid_geometry geometry() {
  auto g = ft::pyramid_geometry::make(width, height, 8, 1.2f);
  g.exact = true;
  return g;
}
ft::stereo_params params() {
  ft::stereo_params p;
  p.bf = 22;
  p.max_disparity = 90;
  return p;
}

/// Scattered keypoints. Descriptors have few different bits, so that distances tie, and right
/// keypoints are wanted by several left ones.
ft::keypoints<ft::memory_space::host> random_pairs(unsigned seed) {
  std::mt19937 random(seed);
  auto const below = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  ft::keypoints<ft::memory_space::host> all(capacity, 2 * pairs);
  ft::keypoints_view const v = all.view();
  for (int image = 0; image < 2 * pairs; ++image) {
    auto const kp = v.slice(image);
    *kp.count = image == 4 ? 0 : capacity - below(50);
    for (int i = 0; i < capacity; ++i) {
      kp.octave(i) = below(8);
      kp.x(i) = static_cast<float>(below(8 * width)) / 8;
      kp.y(i) = static_cast<float>(below(8 * height)) / 8;
      kp.angle(i) = kp.response(i) = 0;
      kp.orb(i) = {};
      for (int bit = 0; bit < 6; ++bit) { kp.orb(i).words[0] |= 1u << below(7); }
      // A third is too far from all others.
      if (image % 2 == 1 && i % 3 == 0) {
        for (auto& w : kp.orb(i).words) { w = ~w; }
      }
    }
  }
  return all;
}

struct match {
  float right_x, depth;
  int score;
  int rival = 0;
  float rows = 0;
};

bool is_candidate(ft::pyramid_geometry const& g, ft::keypoints_view const& l, int i,
                  ft::keypoints_view const& r, int j) {
  int const o = r.octave(j);
  if (std::abs(o - l.octave(i)) > 1) { return false; }
  if (!(r.x(j) <= l.x(i) && r.x(j) >= l.x(i) - params().max_disparity)) { return false; }
  float const band = 2.0f * g.scale[o];
  float const row = std::floor(l.y(i));
  return row >= std::floor(r.y(j) - band) && row <= std::ceil(r.y(j) + band);
}
std::vector<match> expected(ft::keypoints_view const& all, int pair) {
  auto const g = geometry();
  auto const l = all.slice(2 * pair);
  auto const r = all.slice(2 * pair + 1);
  std::vector<int> partner(capacity, -1), distance(capacity, 0);
  for (int i = 0; i < *l.count; ++i) {
    int least = params().hamming_limit;
    for (int j = 0; j < *r.count; ++j) {
      int const d = ft::hamming(l.orb(i), r.orb(j));
      if (d >= least || !is_candidate(g, l, i, r, j)) { continue; }
      least = distance[static_cast<std::size_t>(i)] = d;
      partner[static_cast<std::size_t>(i)] = j;
    }
  }
  std::vector<match> out(capacity, {-1, -1, -1});
  for (std::size_t i = 0; i < out.size(); ++i) {
    int const j = partner[i];
    if (j < 0) { continue; }
    bool nearest = true;
    for (std::size_t k = 0; k < out.size(); ++k) {
      nearest = nearest && !(partner[k] == j &&
                             (distance[k] < distance[i] || (distance[k] == distance[i] && k < i)));
    }
    int const octave = l.octave(static_cast<int>(i));
    float const column = g.column(r.x(j), r.octave(j));
    float const disparity = g.column(l.x(static_cast<int>(i)), octave) - column;
    if (!nearest || !(disparity > 0)) { continue; }
    out[i] = {g.level_column(column, octave), g.level_depth(params().bf / disparity, octave),
              distance[i]};
    out[i].rows = g.row(r.y(j), r.octave(j)) - g.row(l.y(static_cast<int>(i)), octave);
    int const most = std::min(distance[i] + 7, params().hamming_limit - 1);
    float const apart = 11 * g.scale[octave];
    for (int k = 0; k < *r.count; ++k) {
      bool const elsewhere = std::abs(r.x(k) - r.x(j)) >= apart;
      if (elsewhere && is_candidate(g, l, static_cast<int>(i), r, k) &&
          ft::hamming(l.orb(static_cast<int>(i)), r.orb(k)) <= most) {
        out[i].rival = 1;
      }
    }
  }
  return out;
}

template <typename Backend>
class stereo_by_descriptors : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(stereo_by_descriptors, test::backends);

TYPED_TEST(stereo_by_descriptors, finds_what_a_loop_over_all_pairs_finds) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  constexpr ft::memory_space space = exec_type::space;
  ft::keypoints<space> keypoints(capacity, 2 * pairs);
  ft::stereo_matches<space> matches(capacity, pairs);
  ft::grid_geometry rows;
  rows.cols = 1;
  rows.rows = height;
  ft::feature_grid<space> const right_rows(rows, capacity, pairs);
  ft::owner<ft::detail::partner_proposals, space> const work(
      [](ft::carver& c, ft::detail::partner_proposals& v) { carve(c, v, capacity, pairs); });
  for (unsigned seed = 1; seed <= static_cast<unsigned>(test::effort(20)); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    auto const given = random_pairs(seed);
    ft::copy(backend.exec, keypoints.view(), given.view());
    ft::sort_right_rows(backend.exec, keypoints.view(), right_rows.view());
    ft::match_by_descriptors(backend.exec, geometry(), keypoints.view(), right_rows.view(),
                             params(), work.view(), matches.view());
    auto const found = ft::download(backend.exec, matches.view());
    int some = 0;
    int rivals = 0;
    for (int pair = 0; pair < pairs; ++pair) {
      auto const m = found.view().slice(pair);
      auto const want = expected(given.view(), pair);
      EXPECT_EQ(*m.count, *given.view().slice(2 * pair).count);
      for (int i = 0; i < capacity; ++i) {
        match const& w = want[static_cast<std::size_t>(i)];
        ASSERT_EQ(m.score(i), w.score) << pair << " " << i;
        ASSERT_EQ(m.right_x(i), w.right_x) << pair << " " << i;
        ASSERT_EQ(m.depth(i), w.depth) << pair << " " << i;
        if (w.score >= 0) {
          ASSERT_EQ(m.rival(i), w.rival) << pair << " " << i;
          ASSERT_EQ(m.row_difference(i), w.rows) << pair << " " << i;
        }
        some += static_cast<int>(w.score >= 0);
        rivals += w.rival;
      }
    }
    EXPECT_GT(some, pairs * 10);
    EXPECT_GT(rivals, 0);
    EXPECT_LT(rivals, some);
  }
}

}  // namespace stereo_by_descriptors_test
