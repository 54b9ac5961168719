// SPDX-License-Identifier: Apache-2.0
/// @file What a block of match_strips compares, and which of its threads compares what.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/descriptors/vector_descriptor.hpp"
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

// ---- whose products tensor cores may compute

/// ft's model that a descriptor is or derives from, else void.
template <int Bits>
binary_descriptor<Bits> base_model(binary_descriptor<Bits> const*);
template <typename T, int N, typename Metric>
vector_descriptor<T, N, Metric> base_model(vector_descriptor<T, N, Metric> const*);
void base_model(...);
template <typename D>
using base_model_of = decltype(base_model(static_cast<D const*>(nullptr)));

template <auto A, auto B>
inline constexpr bool is_same_function =
    std::is_same<std::integral_constant<decltype(A), A>,
                 std::integral_constant<decltype(B), B>>::value;

/// Whether distances of D are those of the model: nothing that they are made of is hidden by
/// something else.
template <typename D, typename Base, typename = void>
inline constexpr bool keeps_distances = false;
template <typename D, typename Base>
inline constexpr bool keeps_distances<
    D, Base, std::void_t<decltype(&D::part_of), decltype(&D::add), decltype(&D::distance_of)>> =
    is_same_function<&D::part_of, &Base::part_of>&& is_same_function<&D::add, &Base::add>&&
        is_same_function<&D::distance_of, &Base::distance_of>&& D::parts == Base::parts;

enum class products { none, of_bits, of_bytes, of_numbers };

template <typename D, typename Base>
inline constexpr products products_of = products::none;
template <typename D, int Bits>
inline constexpr products products_of<D, binary_descriptor<Bits>> =
    keeps_distances<D, binary_descriptor<Bits>> ? products::of_bits : products::none;
template <typename D, typename T, int N, typename Metric>
inline constexpr products products_of<D, vector_descriptor<T, N, Metric>> =
    !keeps_distances<D, vector_descriptor<T, N, Metric>> ? products::none
    : is_int8<T>                                         ? products::of_bytes
                                                         : products::of_numbers;
/// What tensor cores multiply where there are some: bits and bytes exactly, numbers for a bound.
template <typename D>
inline constexpr products products_by_mma = products_of<D, base_model_of<D>>;

/// Whether this executor compares rows by a shortlist. All kernels of a program that run on one
/// device are compiled for the same architecture.
template <typename D>
inline constexpr bool has_shortlist = has_mma&& products_by_mma<D> == products::of_numbers;

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
