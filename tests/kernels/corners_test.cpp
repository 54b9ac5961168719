// SPDX-License-Identifier: Apache-2.0
// Corner detection: layout of the cells, room for every corner, and the stage against a plain
// reading of section 2 of the specification.
#include "ft/containers/corners.hpp"
#include "ft/kernels/corners/detect_corners.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <ostream>
#include <random>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/corners.hpp"
#include "tests/support/random.hpp"

namespace corners_test {

using image = std::vector<std::uint8_t>;

/// x, y relative to (16, 16), response.
struct found {
  int x, y, response;
  friend bool operator==(found a, found b) {
    return a.x == b.x && a.y == b.y && a.response == b.response;
  }
};
inline std::ostream& operator<<(std::ostream& out, found const& f) {
  return out << "(" << f.x << ", " << f.y << ": " << f.response << ")";
}

inline constexpr int circle[16][2] = {{0, 3},  {1, 3},  {2, 2},  {3, 1},   {3, 0},   {3, -1},
                                      {2, -2}, {1, -3}, {0, -3}, {-1, -3}, {-2, -2}, {-3, -1},
                                      {-3, 0}, {-3, 1}, {-2, 2}, {-1, 3}};

/// S of the specification: the largest over arcs of the smallest difference; negative where no arc
/// is brighter or darker throughout.
inline int arc_strength(image const& pixels, int w, int x, int y) {
  auto const at = [&](int px, int py) {
    return static_cast<int>(pixels[static_cast<std::size_t>(py * w + px)]);
  };
  int strongest = -255;
  for (int first = 0; first < 16; ++first) {
    int bright = 255;
    int dark = 255;
    for (int k = first; k < first + 9; ++k) {
      int const difference = at(x + circle[k % 16][0], y + circle[k % 16][1]) - at(x, y);
      bright = std::min(bright, difference);
      dark = std::min(dark, -difference);
    }
    strongest = std::max({strongest, bright, dark});
  }
  return strongest;
}

/// All corners of a level, cell by cell.
inline std::vector<found> corners_by_definition(image const& pixels, int w, int h, int ini,
                                                int minimum) {
  std::vector<found> all;
  int const width = w - 32;
  int const height = h - 32;
  int const cols = width / 35;
  int const rows = height / 35;
  if (width <= 0 || height <= 0 || cols == 0 || rows == 0) { return all; }
  int const cell_w = (width + cols - 1) / cols;
  int const cell_h = (height + rows - 1) / rows;
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < cols; ++j) {
      int const x0 = 16 + j * cell_w;
      int const y0 = 16 + i * cell_h;
      int const x1 = std::min(x0 + cell_w + 6, w - 16);
      int const y1 = std::min(y0 + cell_h + 6, h - 16);
      if (x1 - x0 < 7 || y1 - y0 < 7) { continue; }
      auto const detect = [&](int threshold) {
        auto const score = [&](int x, int y) {
          if (x < x0 + 3 || x >= x1 - 3 || y < y0 + 3 || y >= y1 - 3) { return 0; }
          int const s = arc_strength(pixels, w, x, y);
          return s > threshold ? s - 1 : 0;
        };
        std::vector<found> cell;
        for (int y = y0 + 3; y < y1 - 3; ++y) {
          for (int x = x0 + 3; x < x1 - 3; ++x) {
            int const s = arc_strength(pixels, w, x, y);
            if (s <= threshold) { continue; }
            bool highest = true;
            for (int dy = -1; dy <= 1; ++dy) {
              for (int dx = -1; dx <= 1; ++dx) {
                highest = highest && ((dx == 0 && dy == 0) || s - 1 > score(x + dx, y + dy));
              }
            }
            if (highest) { cell.push_back({x - 16, y - 16, s - 1}); }
          }
        }
        return cell;
      };
      auto cell = detect(ini);
      if (cell.empty()) { cell = detect(minimum); }
      all.insert(all.end(), cell.begin(), cell.end());
    }
  }
  return all;
}

TEST(corner_layout_unit, cells_cover_the_work_area_of_every_level) {
  for (int w = 1; w < 1500; w += w < 250 ? 1 : 37) {
    auto const g = ft::pyramid_geometry::make(w, 480, 1, 1.2f);
    auto const layout = ft::corner_layout::make(g);
    ASSERT_EQ(layout.levels, 1);
    if (w < 67) {
      EXPECT_EQ(layout.cells, 0) << w;
      EXPECT_EQ(layout.total_slots, 0) << w;
      continue;
    }
    EXPECT_EQ(layout.cols[0], (w - 32) / 35);
    EXPECT_EQ(layout.rows[0], 12);
    EXPECT_GE(layout.cols[0] * layout.cell_width[0], w - 32);
    EXPECT_LE(layout.cell_width[0], ft::max_cell_side);
    EXPECT_LE(layout.cell_height[0], ft::max_cell_side);
    EXPECT_EQ(layout.cells, layout.cols[0] * layout.rows[0]);
    EXPECT_EQ(layout.total_slots, static_cast<std::ptrdiff_t>(layout.cells) * layout.slots[0]);
  }
}

TEST(corner_layout_unit, numbers_cells_level_by_level) {
  auto const g = ft::pyramid_geometry::make(300, 150, 8, 1.2f);
  auto const layout = ft::corner_layout::make(g);
  int cells = 0;
  std::ptrdiff_t slots = 0;
  for (int l = 0; l < 8; ++l) {
    EXPECT_EQ(layout.first_cell[l], cells);
    EXPECT_EQ(layout.first_slot[l], slots);
    for (int c = cells; c < cells + layout.cells_of(l); ++c) {
      EXPECT_EQ(layout.level_of(c), l) << c;
    }
    cells += layout.cells_of(l);
    slots += layout.level_slots(l);
  }
  EXPECT_EQ(layout.cells_of(7), 0) << "42 pixels high: no cell";
  EXPECT_EQ(layout.cells, cells);
  EXPECT_EQ(layout.total_slots, slots);
}

TEST(corner_order_unit, goes_through_the_cells_and_their_rows) {
  for (int const side : {67, 101, 102, 333, 480, 1333}) {
    auto const layout = ft::corner_layout::make(ft::pyramid_geometry::make(side, 150, 1, 1.2f));
    ft::corner_order const order = layout.order_of(0);
    std::uint32_t last = 0;
    for (int row = 0; row < layout.rows[0]; ++row) {
      for (int col = 0; col < layout.cols[0]; ++col) {
        int const x0 = col * layout.cell_width[0] + 3;
        int const y0 = row * layout.cell_height[0] + 3;
        for (int y = y0; y < y0 + layout.cell_height[0]; ++y) {
          for (int x = x0; x < x0 + layout.cell_width[0]; ++x) {
            ASSERT_GT(order(x, y), last) << x << ", " << y;
            last = order(x, y);
          }
        }
      }
    }
  }
}

TEST(corner_order_unit, differs_for_all_pixels_of_the_work_area) {
  for (int const side : {67, 70, 101, 333}) {
    auto const layout = ft::corner_layout::make(ft::pyramid_geometry::make(side, 150, 1, 1.2f));
    ft::corner_order const order = layout.order_of(0);
    std::vector<std::uint32_t> all;
    for (int y = 0; y < 150 - 32; ++y) {
      for (int x = 0; x < side - 32; ++x) { all.push_back(order(x, y)); }
    }
    std::sort(all.begin(), all.end());
    EXPECT_TRUE(std::adjacent_find(all.begin(), all.end()) == all.end()) << side;
  }
}

TEST(corner_order_unit, has_room_for_the_largest_level) {
  auto const layout = ft::corner_layout::make(ft::pyramid_geometry::make(16384, 16384, 1, 1.2f));
  int const last = 16384 - 32 - 1;
  std::uint64_t const cell_w = static_cast<std::uint64_t>(layout.cell_width[0]) + 6;
  std::uint64_t const cell_h = static_cast<std::uint64_t>(layout.cell_height[0]) + 6;
  EXPECT_LT(static_cast<std::uint64_t>(layout.cells) * cell_w * cell_h, std::uint64_t{1} << 31);
  auto const order = layout.order_of(0);
  std::uint64_t const col = static_cast<std::uint64_t>((last - 3) / layout.cell_width[0]);
  std::uint64_t const row = static_cast<std::uint64_t>((last - 3) / layout.cell_height[0]);
  std::uint64_t const cell = row * static_cast<std::uint64_t>(layout.cols[0]) + col;
  std::uint64_t const y = last - row * static_cast<std::uint64_t>(layout.cell_height[0]);
  std::uint64_t const x = last - col * static_cast<std::uint64_t>(layout.cell_width[0]);
  EXPECT_EQ(order(last, last), (cell * cell_h + y) * cell_w + x);
}

template <typename Backend>
class corners_unit : public test::on_backend<Backend> {
protected:
  Backend backend;

  /// Corners of every image of a batch of one level.
  std::vector<std::vector<found>> detect(std::vector<image> const& images, int w, int h, int ini,
                                         int minimum) {
    auto const& exec = backend.exec;
    auto const g = ft::pyramid_geometry::make(w, h, 1, 1.2f);
    int const batch = static_cast<int>(images.size());
    ft::image_pyramid<Backend::exec_type::space> const pyramid(g, batch);
    ft::corners_view view;
    ft::arena<Backend::exec_type::space> const memory(
        [&](ft::carver& c) { ft::carve(c, view, ft::corner_layout::make(g), batch); });
    for (int b = 0; b < batch; ++b) {
      ft::copy_image(exec, pyramid.view().level(b, 0),
                     {images[static_cast<std::size_t>(b)].data(), w, h, w});
      exec.wait();
    }
    ft::clear_corners(exec, view);
    auto const first = lists_of(pyramid.view(), {ini, minimum}, view);
    // Detection counts in memory of its own, which it must leave ready for the next call.
    EXPECT_EQ(test::from_exec(exec, static_cast<unsigned long long const*>(view.progress),
                              static_cast<std::size_t>(batch)),
              std::vector<unsigned long long>(static_cast<std::size_t>(batch), 0));
    EXPECT_EQ(lists_of(pyramid.view(), {ini, minimum}, view), first) << "again";
    return first;
  }

private:
  /// The corners of level 0 of each image, in the order of the level.
  std::vector<std::vector<found>> lists_of(ft::image_pyramid_view const& pyramid,
                                           ft::corner_params const& params,
                                           ft::corners_view const& view) {
    auto const& exec = backend.exec;
    ft::detect_corners(exec, pyramid, params, view);
    auto const counts = test::from_exec(exec, static_cast<int const*>(view.list_count),
                                        static_cast<std::size_t>(view.batch));
    std::vector<std::vector<found>> all;
    for (int b = 0; b < view.batch; ++b) {
      int const count = counts[static_cast<std::size_t>(b)];
      EXPECT_LE(count, view.layout.level_slots(0));
      auto list = test::from_exec(exec, static_cast<ft::corner const*>(view.level_list(b, 0)),
                                  static_cast<std::size_t>(count));
      test::sort_corners(list.data(), count, view.layout, 0);
      all.emplace_back();
      for (auto const& c : list) { all.back().push_back({c.x, c.y, c.response}); }
    }
    return all;
  }
};
TYPED_TEST_SUITE(corners_unit, test::backends);

TYPED_TEST(corners_unit, agree_with_the_definition) {
  struct shape {
    int w, h;
  };
  std::size_t all = 0;
  for (shape const s : {shape{160, 120}, {67, 67}, {101, 103}, {66, 200}, {243, 70}}) {
    std::vector<image> images;
    for (unsigned seed = 0; seed < 3; ++seed) {
      images.push_back(test::random_image(s.w, s.h, seed));
    }
    auto const got = this->detect(images, s.w, s.h, 20, 7);
    for (std::size_t b = 0; b < images.size(); ++b) {
      EXPECT_EQ(got[b], corners_by_definition(images[b], s.w, s.h, 20, 7)) << s.w << "x" << s.h;
      all += got[b].size();
    }
  }
  EXPECT_GT(all, 100u) << "the images must have corners";
}

TYPED_TEST(corners_unit, agree_with_the_definition_for_other_thresholds) {
  struct thresholds {
    int ini, minimum;
  };
  image const noise = [] {
    std::mt19937 random(1);
    image pixels(120 * 110);
    for (auto& p : pixels) { p = static_cast<std::uint8_t>(random()); }
    return pixels;
  }();
  for (thresholds const t :
       {thresholds{20, 20}, {60, 1}, {100, 99}, {255, 120}, {254, 254}, {200, 0}}) {
    auto const got = this->detect({noise}, 120, 110, t.ini, t.minimum);
    EXPECT_EQ(got[0], corners_by_definition(noise, 120, 110, t.ini, t.minimum))
        << t.ini << " " << t.minimum;
  }
}

TYPED_TEST(corners_unit, thin_last_cells_have_no_corner) {
  // 1333 - 32 = 1301 pixels in 37 cells of 36: the last starts at 16 + 1296 and has 5 pixels.
  int const w = 1333;
  int const h = 70;
  image const pixels = test::random_image(w, h, 77);
  auto const got = this->detect({pixels}, w, h, 20, 7);
  EXPECT_EQ(got[0], corners_by_definition(pixels, w, h, 20, 7));
  ASSERT_FALSE(got[0].empty());
  for (auto const& f : got[0]) { EXPECT_LT(f.x, 1296 + 3); }
}

TYPED_TEST(corners_unit, the_densest_image_fits_its_slots) {
  // Single bright pixels, two apart in both directions: as many maxima as suppression can leave.
  int const w = 150;
  int const h = 110;
  std::vector<image> images;
  for (int period = 2; period <= 4; ++period) {
    image pixels(static_cast<std::size_t>(w * h), 0);
    for (int y = 0; y < h; y += period) {
      for (int x = 0; x < w; x += period) { pixels[static_cast<std::size_t>(y * w + x)] = 255; }
    }
    images.push_back(pixels);
  }
  auto const got = this->detect(images, w, h, 20, 7);  // counts are compared with the slots there
  std::size_t all = 0;
  for (std::size_t b = 0; b < images.size(); ++b) {
    EXPECT_EQ(got[b], corners_by_definition(images[b], w, h, 20, 7));
    all += got[b].size();
  }
  EXPECT_GT(all, 500u);
}

TYPED_TEST(corners_unit, cells_with_more_candidates_than_their_list_holds_lose_none) {
  // A single cell of 69 x 69 pixels of noise: most can be corners at a threshold of 1.
  std::mt19937 random(8);
  image pixels(101 * 101);
  for (auto& p : pixels) { p = static_cast<std::uint8_t>(random()); }
  auto const got = this->detect({pixels}, 101, 101, 1, 0);
  EXPECT_EQ(got[0], corners_by_definition(pixels, 101, 101, 1, 0));
  EXPECT_GT(got[0].size(), 50u);
}

TYPED_TEST(corners_unit, levels_without_a_cell_have_a_count_of_zero) {
  auto const& exec = this->backend.exec;
  for (int const w : {110, 60}) {  // with cells in the lower levels, with none
    auto const g = ft::pyramid_geometry::make(w, w, 6, 1.2f);
    ft::image_pyramid<TypeParam::exec_type::space> const pyramid(g, 2);
    ft::fill_bytes(exec, pyramid.view().data, 0, static_cast<std::size_t>(2 * g.bytes));
    ft::corners_view view;
    ft::arena<TypeParam::exec_type::space> const memory(
        [&](ft::carver& c) { ft::carve(c, view, ft::corner_layout::make(g), 2); });
    ft::fill_bytes(exec, view.list_count, 0x55, 12 * sizeof(int));
    ft::clear_corners(exec, view);
    ft::detect_corners(exec, pyramid.view(), {20, 7}, view);
    EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(view.list_count), 12),
              std::vector<int>(12, 0))
        << w;
  }
}

TYPED_TEST(corners_unit, flat_images_have_none) {
  for (int grey : {0, 128, 255}) {
    auto const got =
        this->detect({image(120 * 110, static_cast<std::uint8_t>(grey))}, 120, 110, 0, 0);
    EXPECT_TRUE(got[0].empty());
  }
}

}  // namespace corners_test
