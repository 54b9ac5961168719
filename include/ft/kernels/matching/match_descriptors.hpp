// SPDX-License-Identifier: Apache-2.0
/// @file Stage: the nearest and second nearest descriptor of each, all with all.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/kernels/matching/detail/match_strips.hpp"
#include "ft/kernels/matching/detail/rescored_match.hpp"
#include "ft/kernels/matching/match_types.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a query row. Merges what it found in the strips, after what is in a shortlist has been
/// compared, and tests it.
template <typename D>
struct accept_match {
  using scratch = std::conditional_t<has_shortlist<D>, rescored_scratch<D>, no_scratch>;
  using distance_type = descriptor_distance<D>;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int i, descriptor_rows<D> const& query,
                                 descriptor_rows<D> const& train,
                                 match_tests<distance_type> const& tests,
                                 match_workspace<distance_type> const& work,
                                 descriptor_match<distance_type>* out) const {
    strips const in{
        strip_plan::of(query.size(), strips_of(query.capacity)),
        strip_plan::of(train.size(), train.capacity > 0 ? strips_of(train.capacity) : 1)};
    two best = two::none();
    bool accepted = false;
    if (i < in.queries.rows) {
      auto const passes = [&](two const& found) {
        return found.first.index != no_row && found.first.distance <= tests.most &&
               is_clear(found, tests);
      };
      if constexpr (Group::max_threads > 1 && has_shortlist<D>) {
        rescored_match<D> const rows{s, query, train, in.queries, in.trains, work, i};
        best = rows.nearest(g);
        accepted = passes(best) && (!tests.mutual || rows.is_nearest_of(g, best.first));
      } else {
        static_cast<void>(s);
        best = nearest(g, in, work, i);
        accepted = passes(best) && (!tests.mutual || best_of(g, in, work, best.first.index) == i);
      }
    }
    if (g.rank() != 0) { return; }
    auto const row = [](int index) { return index == no_row ? -1 : index; };
    out[i] = {accepted ? best.first.index : -1, row(best.first.index), row(best.second.index),
              best.first.distance, best.second.distance};
  }

private:
  using two = two_nearest_rows<distance_type>;
  using one = nearest_row<distance_type>;
  struct strips {
    strip_plan queries, trains;
  };

  /// The two nearest train rows.
  template <typename Group>
  FT_HOST_DEVICE static two nearest(Group g, strips const& in,
                                    match_workspace<distance_type> const& work, int i) {
    two best = two::none();
    for (int s = g.rank(); s < in.trains.used; s += g.size()) {
      best = merge_nearest{}(best, work.of_query[place(s, work.queries, i)]);
    }
    return nearest_of_all(g, best);
  }
  /// The query row that is nearest to a train row.
  template <typename Group>
  FT_HOST_DEVICE static int best_of(Group g, strips const& in,
                                    match_workspace<distance_type> const& work, int j) {
    one back = one::none();
    for (int s = g.rank(); s < in.queries.used; s += g.size()) {
      back = min_op{}(back, work.of_train[place(s, work.trains, j)]);
    }
    return nearest_of_all(g, back).index;
  }
  FT_HOST_DEVICE static std::ptrdiff_t place(int strip, int rows, int row) {
    return static_cast<std::ptrdiff_t>(strip) * rows + row;
  }
  FT_HOST_DEVICE static bool is_clear(two_nearest_rows<distance_type> const& best,
                                      match_tests<distance_type> const& tests) {
    if (tests.ratio_den == 0 || best.second.index == no_row) { return true; }
    // Dot products of rows a little longer than 1 give distances below 0.
    distance_type const first = max_of(best.first.distance, distance_type{});
    distance_type const second = max_of(best.second.distance, distance_type{});
    if constexpr (std::is_same<distance_type, int>::value) {
      return static_cast<long long>(tests.ratio_den) * first <
             static_cast<long long>(tests.ratio_num) * second;
    } else {
      return mul(static_cast<float>(tests.ratio_den), first) <
             mul(static_cast<float>(tests.ratio_num), second);
    }
  }
};

template <typename D>
void check_rows(char const* name, descriptor_rows<D> const& rows, int most) {
  require_range(name, rows.capacity, 0, most);
  require(reinterpret_cast<std::uintptr_t>(rows.row) % alignof(D) == 0,
          "rows of descriptors are not aligned as their type is");
}

template <typename Distance>
void check_tests(match_tests<Distance> const& tests) {
  require(!(tests.most != tests.most), "match_tests::most is not a number");
  require_range("match_tests::ratio_num", tests.ratio_num, 0, 1 << 20);
  require_range("match_tests::ratio_den", tests.ratio_den, 0, 1 << 20);
  require((tests.ratio_num == 0) == (tests.ratio_den == 0),
          "match_tests::ratio_num and ratio_den are both 0, or neither is");
}

}  // namespace detail

/// Compares all query rows with all train rows: for each query row the nearest and the second
/// nearest train row with their distances, ties by the lower index, and whether the match passes
/// the tests. A distance that is not a number, or infinite, is no match. The same bits on every
/// executor. Asynchronous on `exec`; allocates nothing; two launches, O(query * train).
/// @tparam D a descriptor (descriptors/descriptor_model.hpp)
/// @param out [query.capacity] executor memory; rows past the count have found nothing
/// @throws bad_argument for more rows than there is working memory for, rows that are not aligned,
///   and tests that contradict themselves
template <typename Exec, typename D>
void match_descriptors(Exec const& exec, descriptor_rows<D> const& query,
                       descriptor_rows<D> const& train,
                       match_tests<descriptor_distance<D>> const& tests,
                       match_workspace<descriptor_distance<D>> const& work,
                       descriptor_match<descriptor_distance<D>>* out) {
  static_assert(assert_descriptor_model<D>::value, "a descriptor keeps its contract");
  detail::check_rows("query rows", query, work.queries);
  detail::check_rows("train rows", train, work.trains);
  detail::check_tests(tests);
  if (query.capacity == 0) { return; }
  if (train.capacity > 0) {
    int const strips = detail::strips_of(query.capacity) * detail::strips_of(train.capacity);
    for_each_item<per_block<detail::match_threads>>(exec, strips, detail::match_strips<D>{}, query,
                                                    train, tests.mutual, work);
  }
  // It does not begin early: that was measured to make both together up to 3 us longer.
  for_each_item<per_warp>(detail::with_order(exec, detail::launch_order::full_wave), query.capacity,
                          detail::accept_match<D>{}, query, train, tests, work, out);
}

}  // namespace FT_ABI
}  // namespace ft
