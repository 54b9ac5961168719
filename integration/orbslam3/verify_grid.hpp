// SPDX-License-Identifier: Apache-2.0
/// @file The cells of a frame's grid, and their comparison.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "integration/orbslam3/verify_report.hpp"

namespace ft {
namespace orbslam3 {

/// Column by column.
template <typename List, std::size_t Columns, std::size_t Rows>
std::vector<List> cells_of(List const (&grid)[Columns][Rows]) {
  std::vector<List> all;
  all.reserve(Columns * Rows);
  for (auto const& column : grid) { all.insert(all.end(), column, column + Rows); }
  return all;
}
template <typename List, std::size_t Columns, std::size_t Rows>
void clear_cells(List (&grid)[Columns][Rows]) {
  for (auto& column : grid) {
    for (List& cell : column) { cell.clear(); }
  }
}
/// The sizes of a cell, or the first two indices that differ.
template <typename List>
void compare_cells(difference_log& log, char const* what, std::vector<List> const& cpu,
                   std::vector<List> const& gpu) {
  for (std::size_t c = 0; c < cpu.size(); ++c) {
    auto const at = static_cast<long>(c);
    if (cpu[c].size() != gpu[c].size()) {
      log.compare(what, at, cpu[c].size(), gpu[c].size());
      continue;
    }
    auto const other = std::mismatch(cpu[c].begin(), cpu[c].end(), gpu[c].begin());
    if (other.first != cpu[c].end()) { log.compare(what, at, *other.first, *other.second); }
  }
}

}  // namespace orbslam3
}  // namespace ft
