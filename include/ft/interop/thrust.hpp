// SPDX-License-Identifier: Apache-2.0
/// @file Columns of containers as iterators for Thrust's algorithms; the only header that includes
/// Thrust.
#pragma once

#include <thrust/iterator/zip_iterator.h>
#include <thrust/tuple.h>

#include "ft/containers/soa.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// Iterator over tuples of the named columns, in the order named:
///
///     thrust::sort(thrust::cuda::par.on(stream), zip_begin<field::response, field::x>(v), ...);
template <typename... Named, typename... Fields>
FT_HOST_DEVICE auto zip_begin(soa_view<Fields...> const& v) {
  return thrust::make_zip_iterator(thrust::make_tuple(array_of<Named>(v)...));
}

}  // namespace FT_ABI
}  // namespace ft
