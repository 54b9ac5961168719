// SPDX-License-Identifier: Apache-2.0
/// @file A stage that both units of the link tests instantiate.
#pragma once

#include <vector>

#include "ft/stages.hpp"

/// Writes 3 * item + 1.
struct affine_of_item {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, int* out) const {
    out[item] = 3 * item + 1;
  }
};

/// Sum over [0, items) of what the stage writes, on the host.
inline constexpr int link_items = 1000;
inline constexpr int link_sum = 3 * (link_items * (link_items - 1) / 2) + link_items;

template <typename Exec>
int run_affine(Exec const& exec) {
  std::vector<int> values(link_items, 0);
  ft::for_each_item<ft::per_thread>(exec, link_items, affine_of_item{}, values.data());
  int sum = 0;
  for (int const value : values) { sum += value; }
  return sum;
}

int first_unit();
int second_unit();
