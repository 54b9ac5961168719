// SPDX-License-Identifier: Apache-2.0
// Which of several matches makes a new point: a wide wrong one loses against narrow ones that
// agree, and against a plain reading of the rule.
#include "ft/kernels/map/detail/bin_rays.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <random>
#include <vector>

#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"

namespace match_candidates_test {

constexpr int most = 10;
struct problem {
  float depth[most];  ///< of each candidate's point; equal ones agree
  double cosine[most];
  int count, least;
};

struct choose {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, problem const* in, int* out) const {
    problem const& p = in[item];
    ft::detail::match_candidate all[most];
    for (int k = 0; k < p.count; ++k) { all[k].cosine = p.cosine[k]; }
    int const chosen = ft::detail::most_supported(
        g, all, p.count, p.least, [&](int a, int b) { return p.depth[a] == p.depth[b]; });
    if (g.rank() == 0) { out[item] = chosen; }
  }
};

int plain(problem const& p) {
  int best = -1, votes = -1;
  for (int k = 0; k < p.count; ++k) {
    int n = -1;  // itself
    for (int j = 0; j < p.count; ++j) { n += p.depth[k] == p.depth[j] ? 1 : 0; }
    if (n < p.least || n < votes || (n == votes && p.cosine[k] >= p.cosine[best])) { continue; }
    votes = n;
    best = k;
  }
  return best;
}

template <typename Exec>
std::vector<int> run(Exec const& exec, std::vector<problem> const& problems) {
  auto const in = test::to_exec(exec, problems);
  ft::buffer<int, Exec::space> out(problems.size());
  ft::for_each_item<ft::per_warp>(exec, static_cast<int>(problems.size()), choose{},
                                  static_cast<problem const*>(in.data()), out.data());
  return test::from_exec(exec, out.data(), problems.size());
}

template <typename Backend>
class match_candidates : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(match_candidates, test::backends);

TYPED_TEST(match_candidates, a_wide_wrong_match_loses_against_narrow_ones_that_agree) {
  TypeParam backend;
  problem const wrong_first{{1, 7, 7, 7}, {0.1, 0.99, 0.98, 0.99}, 4, 2};
  problem const alone{{1, 7, 8}, {0.1, 0.99, 0.98}, 3, 1};
  problem const early{{1, 7}, {0.2, 0.1}, 2, 0};
  problem const none{{}, {}, 0, 0};
  EXPECT_EQ(run(backend.exec, {wrong_first, alone, early, none}), (std::vector<int>{2, -1, 1, -1}));
}

TYPED_TEST(match_candidates, are_chosen_as_a_plain_reading_says) {
  TypeParam backend;
  std::mt19937 random(7);
  std::vector<problem> problems(500);
  std::vector<int> want;
  for (auto& p : problems) {
    p.count = static_cast<int>(random() % (most + 1));
    p.least = static_cast<int>(random() % 3);
    for (int k = 0; k < most; ++k) {
      p.depth[k] = static_cast<float>(random() % 4);
      p.cosine[k] = 0.25 * static_cast<double>(random() % 4);  // with ties
    }
    want.push_back(plain(p));
  }
  EXPECT_EQ(run(backend.exec, problems), want);
}

TYPED_TEST(match_candidates, need_more_support_the_more_keyframes_there_are) {
  using ft::detail::least_support;
  EXPECT_EQ(least_support(1), 0);
  EXPECT_EQ(least_support(2), 0);
  EXPECT_EQ(least_support(3), 1);
  EXPECT_EQ(least_support(5), 1);
  EXPECT_EQ(least_support(6), 2);
  EXPECT_EQ(least_support(most), 2);
}

}  // namespace match_candidates_test
