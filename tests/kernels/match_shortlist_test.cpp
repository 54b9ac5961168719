// SPDX-License-Identifier: Apache-2.0
// Rows of float and float16 whose matches are hard to tell without strict arithmetic: the bound of
// their distances by products of 16 bits, and matches against a plain loop, bit for bit.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "ft/descriptors/vector_descriptor.hpp"
#include "ft/kernels/matching/detail/lower_bound.hpp"
#include "ft/kernels/matching/detail/strips.hpp"
#include "ft/kernels/matching/match_descriptors.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/descriptor_rows.hpp"
#include "tests/support/random.hpp"

namespace match_shortlist_test {

using test::at;

template <typename T>
T number(double v) {
  if constexpr (std::is_same<T, float>::value) {
    return static_cast<float>(v);
  } else {
    return ft::float16::nearest(static_cast<float>(v));
  }
}

enum class kind { ordinary, near_ties, integers, huge, tiny, mixed, no_numbers };
constexpr kind all_kinds[] = {kind::ordinary, kind::near_ties, kind::integers,  kind::huge,
                              kind::tiny,     kind::mixed,     kind::no_numbers};
char const* name_of(kind k) {
  constexpr char const* names[] = {"ordinary", "near ties", "integers",  "huge",
                                   "tiny",     "mixed",     "no numbers"};
  return names[static_cast<int>(k)];
}

/// Rows of one kind. The largest finite numbers of both types are among them, and the least.
template <typename T, int N, typename Metric>
class hard_rows {
public:
  using row = ft::vector_descriptor<T, N, Metric>;
  hard_rows(kind what, unsigned seed) : what_(what), random_(seed) {
    for (auto& c : centre_) { fill(c, 0.1); }
  }

  std::vector<row> draw(int count) {
    std::vector<row> rows(at(count));
    for (row& r : rows) { draw(r); }
    return rows;
  }

private:
  static constexpr bool of_halves = std::is_same<T, ft::float16>::value;

  /// Numbers of about the size.
  void fill(row& r, double size) {
    for (T& v : r.of) { v = number<T>(size * static_cast<double>(random_.real(-1, 1))); }
  }
  void draw(row& r) {
    switch (what_) {
      case kind::ordinary:
        fill(r, 0.15);
        break;
      case kind::near_ties: {  // a step of one unit in the last place, in a few numbers
        r = centre_[random_.below(3)];
        for (int k = random_.below(4); k > 0; --k) { step(r.of[random_.below(N)]); }
        break;
      }
      case kind::integers:
        for (T& v : r.of) { v = number<T>(random_.chance(80) ? 0 : random_.below(4)); }
        break;
      case kind::huge:
        fill(r, of_halves ? 65504 : std::pow(10.0, random_.from_to(15, 38)));
        break;
      case kind::tiny:
        fill(r, std::pow(10.0, random_.from_to(of_halves ? -8 : -45, -3)));
        break;
      case kind::mixed: {
        for (T& v : r.of) {
          double const size =
              std::pow(10.0, of_halves ? random_.from_to(-8, 4) : random_.from_to(-20, 15));
          v = number<T>(size * static_cast<double>(random_.real(-1, 1)));
        }
        break;
      }
      case kind::no_numbers: {
        fill(r, 0.15);
        double const inf = std::numeric_limits<double>::infinity();
        double const odd[] = {inf, -inf, std::nan(""), of_halves ? 65504 : 3e38};
        if (random_.chance(20)) { r.of[random_.below(N)] = number<T>(odd[random_.below(4)]); }
        break;
      }
    }
  }
  void step(T& v) {
    if constexpr (of_halves) {
      v.bits = static_cast<std::uint16_t>(v.bits ^ 1u);
    } else {
      v = std::nextafter(v, random_.chance(50) ? 1.0f : -1.0f);
    }
  }

  kind what_;
  test::generator random_;
  row centre_[3];
};

// ---- the bound

template <typename D>
struct bound_of {
  using limit = ft::detail::lower_bound<D, D>;

  std::vector<double> rounded;  ///< as tensor cores take the numbers
  ft::detail::row_bound row{};

  explicit bound_of(D const& of) {
    float squares = 0, errors = 0;
    for (int k = 0; k < D::size; ++k) {
      float numbers[8];
      auto const eight = limit::read(of, k / 8, numbers);
      float const number = numbers[k % 8];
      std::uint32_t const bits = eight.words[k % 8 / 2] >> 16 * (k % 2) & 0xffffu;
      if (!std::isnan(number)) {
        EXPECT_EQ(number, static_cast<float>(of.of[k]));
        EXPECT_EQ(bits, limit::rounded(number, 0) & 0xffffu);
      }
      limit::add(squares, errors, number, bits);
      if constexpr (limit::of_halves) {
        rounded.push_back(
            static_cast<double>(static_cast<float>(ft::float16{static_cast<std::uint16_t>(bits)})));
      } else {
        std::uint32_t const wide = bits << 16;
        float f;
        std::memcpy(&f, &wide, sizeof f);
        rounded.push_back(static_cast<double>(f));
      }
    }
    row = limit::of(squares, errors);
  }
};

/// @return by how much the bound is below the distance at most, in shares of the rows' squares
template <typename D>
double check_bounds(std::vector<D> const& rows) {
  using limit = typename bound_of<D>::limit;
  std::vector<bound_of<D>> bounds(rows.begin(), rows.end());
  double most = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    for (std::size_t j = 0; j < rows.size(); ++j) {
      float const d = D::distance(rows[i], rows[j]);
      double product = 0, magnitude = 0;
      for (std::size_t k = 0; k < bounds[i].rounded.size(); ++k) {
        product += bounds[i].rounded[k] * bounds[j].rounded[k];
        magnitude += std::abs(bounds[i].rounded[k] * bounds[j].rounded[k]);
      }
      // All that tensor cores are allowed to err.
      double const error = 1.125 * (D::size + 3) * std::pow(2.0, -22) * magnitude;
      for (double const p : {product - error, product, product + error}) {
        float const bound = limit::below(static_cast<float>(p), bounds[i].row, bounds[j].row);
        EXPECT_FALSE(std::isnan(bound));
        if (!std::isfinite(d)) { continue; }
        EXPECT_LE(bound, d) << i << " and " << j;
        double const squares = static_cast<double>(bounds[i].row.base) + bounds[j].row.base;
        most = std::max(most, (static_cast<double>(d) - bound) / squares);
      }
    }
  }
  return most;
}

template <typename T, int N, typename Metric>
void bounds_are_below() {
  for (kind const k : all_kinds) {
    SCOPED_TRACE(name_of(k));
    hard_rows<T, N, Metric> rows(k, N);
    double const most = check_bounds(rows.draw(60));
    if (k == kind::ordinary && std::is_same<Metric, ft::squared_distance>::value) {
      EXPECT_LT(most, 0.03) << "so that a shortlist is short";
    }
  }
}

TEST(LowerBound, IsBelowTheDistance) {
  bounds_are_below<float, 5, ft::squared_distance>();
  bounds_are_below<float, 128, ft::squared_distance>();
  bounds_are_below<float, 256, ft::dot_product>();
  bounds_are_below<ft::float16, 33, ft::squared_distance>();
  bounds_are_below<ft::float16, 128, ft::squared_distance>();
  bounds_are_below<ft::float16, 256, ft::dot_product>();
}

TEST(LowerBound, OfIntegersIsAsExactAsTheSums) {
  hard_rows<float, 128, ft::squared_distance> rows(kind::integers, 1);
  EXPECT_LT(check_bounds(rows.draw(60)), 2.5e-4) << "bfloat16 has them";
}

struct other_sums : ft::vector_descriptor<float, 128> {
  FT_HOST_DEVICE static void add(sum& s, part const& a, part const& b) {
    vector_descriptor::add(s, b, a);
  }
};
struct other_rules : ft::vector_descriptor<float, 128> {
  static constexpr ft::descriptor_rules<float> rules{0, 1e7f, 62500, 16, 25};
};

struct other_numbers : ft::vector_descriptor<ft::float16, 16> {
  ft::float16 of[16];
};
TEST(LowerBound, ReadsTheNumbersThatAreCompared) {
  using base = ft::vector_descriptor<ft::float16, 16>;
  other_numbers row{};
  for (int k = 0; k < 16; ++k) {
    static_cast<base&>(row).of[k] = ft::float16::nearest(static_cast<float>(k));
    row.of[k] = ft::float16::nearest(-1);
  }
  float numbers[8];
  auto const eight = ft::detail::lower_bound<other_numbers, base>::read(row, 1, numbers);
  for (int k = 0; k < 8; ++k) {
    EXPECT_EQ(numbers[k], static_cast<float>(8 + k));
    EXPECT_EQ(eight.words[k / 2] >> 16 * (k % 2) & 0xffffu,
              std::uint32_t{static_cast<base&>(row).of[8 + k].bits});
  }
}

template <typename D>
constexpr bool has_bound = ft::detail::products_by_mma<D> == ft::detail::products::of_numbers;

TEST(LowerBound, IsThatOfDescriptorsThatKeepTheirDistances) {
  EXPECT_TRUE((has_bound<ft::vector_descriptor<float, 128>>));
  EXPECT_TRUE((has_bound<ft::vector_descriptor<ft::float16, 33, ft::dot_product>>));
  EXPECT_TRUE(has_bound<other_rules>);
  EXPECT_FALSE(has_bound<other_sums>);
  EXPECT_FALSE((has_bound<ft::vector_descriptor<std::int8_t, 128>>));
}

// ---- matches

template <typename Backend>
class MatchShortlist : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(MatchShortlist, test::backends);

template <typename T, int N, typename Metric, typename Exec>
void matches_are_those_of_a_plain_loop(Exec const& exec, int queries, int trains, unsigned seed) {
  for (kind const k : all_kinds) {
    SCOPED_TRACE(std::string(name_of(k)) + ", seed " + std::to_string(seed));
    hard_rows<T, N, Metric> rows(k, seed);
    auto const query = rows.draw(queries);
    auto const train = rows.draw(trains);
    auto const distances = test::plain_distances(query, train);
    for (bool const mutual : {false, true}) {
      ft::match_tests<float> tests;
      tests.mutual = mutual;
      test::expect_same(test::matches_by(exec, query, train, tests),
                        test::plain_matches(distances, train.size(), tests));
    }
  }
}

TYPED_TEST(MatchShortlist, OfFloatsIsThatOfAPlainLoop) {
  TypeParam backend;
  for (unsigned const seed : {1u, 2u}) {
    matches_are_those_of_a_plain_loop<float, 128, ft::squared_distance>(backend.exec, 150, 200,
                                                                        seed);
    matches_are_those_of_a_plain_loop<float, 30, ft::squared_distance>(backend.exec, 64, 65, seed);
    matches_are_those_of_a_plain_loop<float, 256, ft::dot_product>(backend.exec, 130, 70, seed);
    matches_are_those_of_a_plain_loop<float, 203, ft::squared_distance>(backend.exec, 66, 130,
                                                                        seed);
  }
}

TYPED_TEST(MatchShortlist, OfHalvesIsThatOfAPlainLoop) {
  TypeParam backend;
  for (unsigned const seed : {1u, 2u}) {
    matches_are_those_of_a_plain_loop<ft::float16, 128, ft::squared_distance>(backend.exec, 150,
                                                                              200, seed);
    matches_are_those_of_a_plain_loop<ft::float16, 33, ft::squared_distance>(backend.exec, 64, 65,
                                                                             seed);
    matches_are_those_of_a_plain_loop<ft::float16, 256, ft::dot_product>(backend.exec, 130, 70,
                                                                         seed);
    matches_are_those_of_a_plain_loop<ft::float16, 40, ft::squared_distance>(backend.exec, 70, 129,
                                                                             seed);
    matches_are_those_of_a_plain_loop<ft::float16, 200, ft::squared_distance>(backend.exec, 66, 130,
                                                                              seed);
  }
}

TYPED_TEST(MatchShortlist, OfACountBelowTheCapacityWithAllTests) {
  TypeParam backend;
  for (kind const k : all_kinds) {
    SCOPED_TRACE(name_of(k));
    hard_rows<float, 128, ft::squared_distance> rows(k, 4);
    auto query = rows.draw(130);
    auto train = rows.draw(160);
    ft::match_tests<float> tests;
    tests.mutual = true;
    tests.ratio_num = 9;
    tests.ratio_den = 10;
    auto const got = test::matches_by(backend.exec, query, train, tests, {100, 100});
    query.resize(100);
    train.resize(100);
    auto want = test::plain_matches(query, train, tests);
    want.resize(130, {-1, -1, -1, 0, 0});
    test::expect_same(got, want);
  }
}

TYPED_TEST(MatchShortlist, MoreTilesThanStrips) {
  TypeParam backend;
  matches_are_those_of_a_plain_loop<float, 20, ft::squared_distance>(backend.exec, 90, 64 * 35, 3);
  matches_are_those_of_a_plain_loop<ft::float16, 20, ft::squared_distance>(backend.exec, 64 * 35,
                                                                           90, 3);
}

}  // namespace match_shortlist_test
