// SPDX-License-Identifier: Apache-2.0
/// @file What a block of match_strips compares, and which of its threads compares what.
#pragma once

#include <cstddef>

#include "ft/core/config.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/kernels/matching/detail/lower_bound.hpp"
#include "ft/kernels/matching/match_types.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

inline constexpr int match_threads = 256;

#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
inline constexpr bool has_mma = true;
#else
inline constexpr bool has_mma = false;
#endif

/// Whether this executor compares rows by a shortlist. All kernels of a program that run on one
/// device are compiled for the same architecture.
template <typename D>
inline constexpr bool has_shortlist = has_mma&& has_lower_bound<D>;

/// Pairs of a tile that a thread compares: those that it holds of the products of the PTX
/// instructions mma.m16n8. A warp compares 16 query rows with 4 times 8 train rows, and two warps
/// have the same query rows.
struct pairs_of_mma {
  static constexpr int rows = 2, columns = 8;
  static constexpr int lanes = 4;   ///< consecutive threads that have the same query rows
  static constexpr int shares = 2;  ///< such runs of threads
  static constexpr int lines = 32;  ///< threads that have the same train rows

  FT_HOST_DEVICE static int row(int rank, int r) { return rank / 64 * 16 + rank % 32 / 4 + 8 * r; }
  FT_HOST_DEVICE static int column(int rank, int c) {
    return share(rank) * 32 + c / 2 * 8 + rank % 4 * 2 + c % 2;
  }
  FT_HOST_DEVICE static int share(int rank) { return rank / 32 % 2; }
  FT_HOST_DEVICE static int line(int rank) { return rank / 64 * 8 + rank % 32 / 4; }
};

/// A strip of query rows, a strip of train rows, and where what they find goes.
template <typename D>
struct strip_pair {
  using distance_type = descriptor_distance<D>;

  D const* query;
  D const* train;
  int first_query, last_query;  ///< the latter is past the strip
  int first_train, last_train;
  two_nearest_rows<distance_type>* of_query;  ///< of this strip of train rows
  nearest_row<distance_type>* of_train;       ///< of this strip of query rows; null = not asked for
  float* rest_of_query;                       ///< likewise, of shortlists
  float* rest_of_train;

  FT_HOST_DEVICE static strip_pair of(descriptor_rows<D> const& query,
                                      descriptor_rows<D> const& train, strip_plan const& queries,
                                      strip_plan const& trains, int q, int t, bool mutual,
                                      match_workspace<distance_type> const& work) {
    auto const of_q = static_cast<std::ptrdiff_t>(t) * work.queries;
    auto const of_t = static_cast<std::ptrdiff_t>(q) * work.trains;
    return {query.row,
            train.row,
            queries.begin(q),
            queries.end(q),
            trains.begin(t),
            trains.end(t),
            work.of_query + of_q,
            mutual ? work.of_train + of_t : nullptr,
            work.rest_of_query == nullptr ? nullptr : work.rest_of_query + of_q,
            work.rest_of_train == nullptr ? nullptr : work.rest_of_train + of_t};
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
