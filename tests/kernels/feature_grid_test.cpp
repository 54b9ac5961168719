// SPDX-License-Identifier: Apache-2.0
// The feature grid and its area queries against plain readings of section 7 of the specification.
#include "ft/kernels/grid.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <vector>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "tests/support/backends.hpp"

namespace feature_grid_test {

inline constexpr float nan = std::numeric_limits<float>::quiet_NaN();
inline constexpr float infinity = std::numeric_limits<float>::infinity();

struct point {
  float x, y;
  int octave;
};
using points = std::vector<point>;

/// Bounds of an undistorted image, as a calibration may give them.
inline constexpr float min_x = -12.3f;
inline constexpr float min_y = -7.7f;
inline constexpr float max_x = 761.9f;
inline constexpr float max_y = 489.1f;
inline ft::grid_geometry bounds() { return ft::grid_geometry::over(min_x, min_y, max_x, max_y); }

/// Products and sums rounded one by one, whatever the compiler's flags.
inline float scaled(float difference, float factor) {
  float volatile const product = difference * factor;
  return product;
}
inline float inv_width() { return 64.0f / (max_x - min_x); }
inline float inv_height() { return 48.0f / (max_y - min_y); }

/// Cell of a keypoint, column * 48 + row, or -1.
inline int cell_by_definition(point const& p) {
  float const fx = std::round(scaled(p.x - min_x, inv_width()));
  float const fy = std::round(scaled(p.y - min_y, inv_height()));
  bool const inside = fx >= 0 && fx <= 63 && fy >= 0 && fy <= 47;
  return inside ? static_cast<int>(fx) * 48 + static_cast<int>(fy) : -1;
}

/// Cell of a grid of rows.
inline int row_by_definition(point const& p, int rows) {
  for (int row = 0; row < rows; ++row) {
    if (p.y >= static_cast<float>(row) && p.y < static_cast<float>(row + 1)) { return row; }
  }
  return -1;
}

inline points random_points(int n, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> x(min_x - 40, max_x + 40);
  std::uniform_real_distribution<float> y(min_y - 40, max_y + 40);
  points all;
  for (int i = 0; i < n; ++i) {
    all.push_back({x(random), y(random), static_cast<int>(random() % 8u)});
  }
  return all;
}

/// The query of section 7: cells by floor and ceil, both included, column by column; then the
/// square.
inline std::vector<int> query_by_definition(points const& all, float x, float y, float r, int low,
                                            int high) {
  std::vector<int> result;
  float const x0 = std::floor(scaled(x - min_x - r, inv_width()));
  float const x1 = std::ceil(scaled(x - min_x + r, inv_width()));
  float const y0 = std::floor(scaled(y - min_y - r, inv_height()));
  float const y1 = std::ceil(scaled(y - min_y + r, inv_height()));
  if (x0 >= 64 || x1 < 0 || y0 >= 48 || y1 < 0) { return result; }
  for (int cx = static_cast<int>(std::max(x0, 0.0f)); cx <= static_cast<int>(std::min(x1, 63.0f));
       ++cx) {
    for (int cy = static_cast<int>(std::max(y0, 0.0f)); cy <= static_cast<int>(std::min(y1, 47.0f));
         ++cy) {
      for (std::size_t i = 0; i < all.size(); ++i) {
        if (cell_by_definition(all[i]) != cx * 48 + cy) { continue; }
        bool const check = low > 0 || high >= 0;
        if (check && (all[i].octave < low || (high >= 0 && all[i].octave > high))) { continue; }
        if (std::abs(all[i].x - x) < r && std::abs(all[i].y - y) < r) {
          result.push_back(static_cast<int>(i));
        }
      }
    }
  }
  return result;
}

/// Writes what a window's visit yields, in its order.
struct run_query {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, ft::search_window const* windows,
                                 ft::keypoints_view const& kp, ft::feature_grid_view const& grid,
                                 int* found, int* counts, int room) const {
    ft::search_window const w = windows[item];
    int n = 0;
    ft::visit_cells(g, w, grid, [&](int k) {
      bool const keep = k >= 0 && ft::inside(w, kp, k);
      int total = 0;
      int const at = g.exclusive_scan(static_cast<int>(keep), total);
      if (keep && n + at < room) { found[item * room + n + at] = k; }
      n += total;
    });
    if (g.rank() == 0) { counts[item] = n; }
  }
};

template <typename Backend>
class feature_grid_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
  static constexpr ft::memory_space space = Backend::exec_type::space;

  /// Batch entry b holds images[b].
  ft::keypoints<space> upload(std::vector<points> const& images, int capacity) {
    auto const& exec = backend.exec;
    ft::keypoints<space> kp(capacity, static_cast<int>(images.size()));
    ft::keypoints<ft::memory_space::host> staging(capacity, static_cast<int>(images.size()));
    auto const v = staging.view();
    auto const n = static_cast<std::size_t>(capacity) * images.size();
    // What is beyond the count lies in a cell, too: reading it would show.
    std::fill_n(ft::array_of<ft::field::x>(v), n, 100.0f);
    std::fill_n(ft::array_of<ft::field::y>(v), n, 100.0f);
    std::fill_n(ft::array_of<ft::field::angle>(v), n, 0.0f);
    std::fill_n(ft::array_of<ft::field::response>(v), n, 0.0f);
    std::fill_n(ft::array_of<ft::field::octave>(v), n, 0);
    std::fill_n(ft::array_of<ft::field::orb>(v), n, ft::descriptor{});
    for (std::size_t b = 0; b < images.size(); ++b) {
      auto const slice = v.slice(static_cast<int>(b));
      *slice.count = static_cast<int>(images[b].size());
      for (int i = 0; i < *slice.count; ++i) {
        point const& p = images[b][static_cast<std::size_t>(i)];
        slice.x(i) = p.x;
        slice.y(i) = p.y;
        slice.octave(i) = p.octave;
      }
    }
    ft::copy(exec, kp.view(), v);
    exec.wait();
    return kp;
  }

  /// Builds grids of the images first, first + step, ... and compares every list.
  template <typename Cell, typename CellOf>
  void check(std::vector<points> const& images, int capacity, ft::grid_geometry const& geometry,
             int first, int step, CellOf const& cell_of) {
    auto const& exec = backend.exec;
    int const grids = (static_cast<int>(images.size()) - first + step - 1) / step;
    auto const kp = upload(images, capacity);
    ft::feature_grid<space> const grid(geometry, capacity, grids);
    ft::build_grid<Cell>(exec, kp.view(), first, step, grids, grid.view());
    for (int b = 0; b < grids; ++b) {
      auto const& all = images[static_cast<std::size_t>(first + b * step)];
      std::vector<std::vector<int>> cells(static_cast<std::size_t>(geometry.cells()));
      for (std::size_t i = 0; i < all.size(); ++i) {
        int const c = cell_of(all[i]);
        if (c >= 0) { cells[static_cast<std::size_t>(c)].push_back(static_cast<int>(i)); }
      }
      std::vector<int> start{0};
      std::vector<int> indices;
      for (auto const& cell : cells) {
        indices.insert(indices.end(), cell.begin(), cell.end());
        start.push_back(static_cast<int>(indices.size()));
      }
      auto const v = grid.view().slice(b);
      EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(v.start), start.size()), start)
          << "grid " << b;
      EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(v.indices), indices.size()), indices)
          << "grid " << b;
    }
  }
};
TYPED_TEST_SUITE(feature_grid_unit, test::backends);

TYPED_TEST(feature_grid_unit, several_images_inside_and_outside) {
  std::vector<points> const images{
      random_points(700, 1), random_points(1, 2), {}, random_points(256, 3), random_points(257, 4)};
  this->template check<ft::nearest_cell>(images, 700, bounds(), 0, 1, cell_by_definition);
  this->template check<ft::nearest_cell>(images, 700, bounds(), 1, 2, cell_by_definition);
  this->template check<ft::nearest_cell>(images, 700, bounds(), 0, 3, cell_by_definition);
}

TYPED_TEST(feature_grid_unit, positions_that_are_no_positions_are_dropped) {
  points all = random_points(300, 5);
  for (std::size_t i = 0; i < all.size(); i += 3) {
    float const bad[] = {nan, infinity, -infinity, 1e30f, -1e30f};
    (i % 2 == 0 ? all[i].x : all[i].y) = bad[i / 3 % 5];
  }
  this->template check<ft::nearest_cell>({all}, 300, bounds(), 0, 1, cell_by_definition);
}

TYPED_TEST(feature_grid_unit, positions_on_the_edges_of_cells) {
  // Half-way between cell corners, and the bounds themselves, from both sides.
  points all;
  for (int k = -2; k <= 2 * 64 + 2; ++k) {
    float const x = min_x + 0.5f * static_cast<float>(k) * (max_x - min_x) / 64.0f;
    float const y = min_y + 0.5f * static_cast<float>(k) * (max_y - min_y) / 48.0f;
    for (float const d : {-infinity, infinity}) {
      all.push_back({std::nextafter(x, d), 200.0f, 0});
      all.push_back({300.0f, std::nextafter(y, d), 0});
    }
    all.push_back({x, y, 0});
  }
  auto const n = static_cast<int>(all.size());
  this->template check<ft::nearest_cell>({all}, n, bounds(), 0, 1, cell_by_definition);
}

TYPED_TEST(feature_grid_unit, all_in_one_cell_keep_their_order) {
  points const all(1500, point{200.0f, 100.0f, 0});
  this->template check<ft::nearest_cell>({all}, 1500, bounds(), 0, 1, cell_by_definition);
  points const last(1500, point{max_x - 7.0f, max_y - 6.0f, 0});
  ASSERT_EQ(cell_by_definition(last[0]), 64 * 48 - 1);
  this->template check<ft::nearest_cell>({last}, 1500, bounds(), 0, 1, cell_by_definition);
}

TYPED_TEST(feature_grid_unit, no_keypoints_give_empty_cells) {
  this->template check<ft::nearest_cell>({{}, {}}, 1, bounds(), 0, 1, cell_by_definition);
}

TYPED_TEST(feature_grid_unit, rows_of_an_image) {
  ft::grid_geometry rows;
  rows.cols = 1;
  rows.rows = 480;
  points all = random_points(600, 6);
  all.push_back({1.0f, nan, 0});
  all.push_back({1.0f, infinity, 0});
  all.push_back({1.0f, -0.5f, 0});
  all.push_back({1.0f, 0.0f, 0});
  all.push_back({1.0f, 480.0f, 0});
  all.push_back({1.0f, std::nextafter(480.0f, 0.0f), 0});
  this->template check<ft::row_cell>({all, random_points(9, 7)}, 700, rows, 0, 1,
                                     [](point const& p) { return row_by_definition(p, 480); });
}

TYPED_TEST(feature_grid_unit, area_queries_agree_with_brute_force) {
  auto const& exec = this->backend.exec;
  points all = random_points(900, 8);
  for (int i = 0; i < 100; ++i) {
    all.push_back({300.0f + 0.01f * static_cast<float>(i), 200.0f, i % 8});  // a crowd
  }
  int const n = static_cast<int>(all.size());
  auto const kp = this->upload({all}, n);
  ft::feature_grid<TestFixture::space> const grid(bounds(), n);
  ft::build_grid<ft::nearest_cell>(exec, kp.view(), 0, 1, 1, grid.view());

  std::mt19937 random(9);
  std::uniform_real_distribution<float> x(min_x - 100, max_x + 100);
  std::uniform_real_distribution<float> y(min_y - 100, max_y + 100);
  std::uniform_real_distribution<float> radius(0, 90);
  std::vector<ft::search_window> windows;
  auto const add = [&](float wx, float wy, float r, int low, int high) {
    auto w = ft::search_window::none();
    w.x = wx;
    w.y = wy;
    w.radius = r;
    w.min_level = low;
    w.max_level = high;
    windows.push_back(w);
  };
  for (int i = 0; i < 400; ++i) {
    int const low = static_cast<int>(random() % 10u) - 2;
    int const high = i % 3 == 0 ? -1 : low + static_cast<int>(random() % 3u);
    add(x(random), y(random), radius(random), low, high);
  }
  add(300.5f, 200.0f, 0.5f, 0, -1);  // strict: points at exactly 0.5 are outside
  add(300.5f, 200.0f, 0.0f, 0, -1);  // nothing is nearer than 0
  add(300.0f, 200.0f, 1e9f, 0, -1);  // everything
  add(300.0f, 200.0f, 1e9f, 3, 3);   // one level
  add(300.0f, 200.0f, 1e9f, 0, 0);   // level 0 alone is a range, too
  add(1e30f, 200.0f, 10.0f, 0, -1);  // far outside
  add(-1e30f, 200.0f, 10.0f, 0, -1);
  add(300.0f, -1e30f, 10.0f, 0, -1);
  add(max_x + 3.0f, max_y + 3.0f, 30.0f, 0, -1);  // half in
  add(min_x - 3.0f, min_y - 3.0f, 30.0f, 0, -1);

  auto const d_windows = test::to_exec(exec, windows);
  auto const d_counts = test::to_exec(exec, std::vector<int>(windows.size(), -1));
  auto const d_found =
      test::to_exec(exec, std::vector<int>(windows.size() * static_cast<std::size_t>(n), -1));
  auto const check = [&] {
    auto const counts = test::from_exec(exec, d_counts);
    auto const found = test::from_exec(exec, d_found);
    std::size_t total = 0;
    for (std::size_t i = 0; i < windows.size(); ++i) {
      auto const& w = windows[i];
      auto const first = found.begin() + static_cast<std::ptrdiff_t>(i) * n;
      EXPECT_EQ(std::vector<int>(first, first + counts[i]),
                query_by_definition(all, w.x, w.y, w.radius, w.min_level, w.max_level))
          << "window " << i << " at " << w.x << ", " << w.y << " radius " << w.radius;
      total += static_cast<std::size_t>(counts[i]);
    }
    EXPECT_GT(total, 2000u);
  };
  int const items = static_cast<int>(windows.size());
  ft::for_each_item<ft::per_thread>(exec, items, run_query{}, d_windows.data(), kp.view(),
                                    grid.view(), d_found.data(), d_counts.data(), n);
  check();
  ft::for_each_item<ft::per_warp>(exec, items, run_query{}, d_windows.data(), kp.view(),
                                  grid.view(), d_found.data(), d_counts.data(), n);
  check();
}

TYPED_TEST(feature_grid_unit, a_window_that_is_no_number_touches_nothing) {
  auto const& exec = this->backend.exec;
  points const all = random_points(200, 10);
  auto const kp = this->upload({all}, 200);
  ft::feature_grid<TestFixture::space> const grid(bounds(), 200);
  ft::build_grid<ft::nearest_cell>(exec, kp.view(), 0, 1, 1, grid.view());
  std::vector<ft::search_window> windows(4, ft::search_window::none());
  for (auto& w : windows) {
    w.x = 300;
    w.y = 200;
    w.radius = 50;
    w.max_level = -1;
  }
  windows[0].x = nan;
  windows[1].y = nan;
  windows[2].radius = nan;
  windows[3].radius = -50;
  auto const d_windows = test::to_exec(exec, windows);
  auto const d_counts = test::to_exec(exec, std::vector<int>(4, -1));
  auto const d_found = test::to_exec(exec, std::vector<int>(800, -1));
  ft::for_each_item<ft::per_warp>(exec, 4, run_query{}, d_windows.data(), kp.view(), grid.view(),
                                  d_found.data(), d_counts.data(), 200);
  EXPECT_EQ(test::from_exec(exec, d_counts), (std::vector<int>{0, 0, 0, 0}));
}

}  // namespace feature_grid_test
