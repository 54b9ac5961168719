// SPDX-License-Identifier: Apache-2.0
/// @file The area query of a feature grid, told plainly. Source: specification section 7.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <tuple>
#include <vector>

#include "ft/containers/feature_grid.hpp"

namespace test {

/// A square in an image and a range of octaves.
struct plain_area {
  float x, y, radius;
  int min_octave, max_octave;
};

/// Keypoints inside an area in the order of the query: by column of cells, row of cells, index.
inline std::vector<int> keypoints_in(plain_area const& area, ft::grid_geometry const& g,
                                     std::vector<float> const& x, std::vector<float> const& y,
                                     std::vector<int> const& octave) {
  if (!std::isfinite(area.x) || !std::isfinite(area.y)) { return {}; }
  float const x0 = std::max(0.0f, std::floor((area.x - g.min_x - area.radius) * g.inv_width));
  float const x1 = std::ceil((area.x - g.min_x + area.radius) * g.inv_width);
  float const y0 = std::max(0.0f, std::floor((area.y - g.min_y - area.radius) * g.inv_height));
  float const y1 = std::ceil((area.y - g.min_y + area.radius) * g.inv_height);
  std::vector<std::tuple<float, float, int>> inside;
  for (std::size_t k = 0; k < x.size(); ++k) {
    float const column = std::round((x[k] - g.min_x) * g.inv_width);
    float const row = std::round((y[k] - g.min_y) * g.inv_height);
    bool const in_grid = column >= 0 && column < static_cast<float>(g.cols) && row >= 0 &&
                         row < static_cast<float>(g.rows);
    if (in_grid && column >= x0 && column <= x1 && row >= y0 && row <= y1 &&
        std::abs(x[k] - area.x) < area.radius && std::abs(y[k] - area.y) < area.radius &&
        octave[k] >= area.min_octave && octave[k] <= area.max_octave) {
      inside.emplace_back(column, row, static_cast<int>(k));
    }
  }
  std::sort(inside.begin(), inside.end());
  std::vector<int> order;
  for (auto const& entry : inside) { order.push_back(std::get<2>(entry)); }
  return order;
}

}  // namespace test
