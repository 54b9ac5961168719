// SPDX-License-Identifier: Apache-2.0
// The parallel quadtree against the rule as it is told in section 3 of the specification: a list of
// nodes that hold their points, split one after the other.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <list>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/corners.hpp"
#include "ft/containers/soa.hpp"
#include "ft/kernels/distribution/distribute_corners.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/corners.hpp"

namespace distribution_oracle {

using corners_list = std::vector<ft::corner>;

struct node {
  int x0, y0, x1, y1;
  corners_list points;
};
using node_list = std::list<node>;

/// Pushes the quadrants of a node to the front of the list; those with more than one point are
/// noted.
void push_children(node_list& nodes, node const& parent,
                   std::vector<node_list::iterator>& multiple) {
  int const sx =
      parent.x0 + static_cast<int>(std::ceil(static_cast<float>(parent.x1 - parent.x0) / 2));
  int const sy =
      parent.y0 + static_cast<int>(std::ceil(static_cast<float>(parent.y1 - parent.y0) / 2));
  node quadrants[4] = {{parent.x0, parent.y0, sx, sy, {}},
                       {sx, parent.y0, parent.x1, sy, {}},
                       {parent.x0, sy, sx, parent.y1, {}},
                       {sx, sy, parent.x1, parent.y1, {}}};
  for (auto const& p : parent.points) {
    quadrants[(p.x < sx ? 0 : 1) + (p.y < sy ? 0 : 2)].points.push_back(p);
  }
  for (auto& q : quadrants) {
    if (q.points.empty()) { continue; }
    nodes.push_front(std::move(q));
    if (nodes.front().points.size() > 1) { multiple.push_back(nodes.begin()); }
  }
}

node_list make_roots(corners_list const& points, int width, int height) {
  int const k = std::max(
      1, static_cast<int>(std::round(static_cast<float>(width) / static_cast<float>(height))));
  float const root_width = static_cast<float>(width) / static_cast<float>(k);
  std::vector<node> roots;
  for (int i = 0; i < k; ++i) {
    roots.push_back({static_cast<int>(root_width * static_cast<float>(i)),
                     0,
                     static_cast<int>(root_width * static_cast<float>(i + 1)),
                     height,
                     {}});
  }
  for (auto const& p : points) {
    auto const r = static_cast<std::size_t>(static_cast<float>(p.x) / root_width);
    roots[std::min(r, roots.size() - 1)].points.push_back(p);
  }
  node_list nodes;
  for (auto& r : roots) {
    if (!r.points.empty()) { nodes.push_back(std::move(r)); }
  }
  return nodes;
}

/// Whether this program's std::sort is the one that the rule std_sort follows.
#if defined(__GLIBCXX__)
constexpr bool has_std_sort = true;
#else
constexpr bool has_std_sort = false;
#endif

/// What a level keeps, in list order.
corners_list distribute(corners_list const& points, int width, int height, int wanted,
                        ft::tie_rule ties) {
  corners_list kept;
  if (points.empty()) { return kept; }
  auto const enough = static_cast<std::size_t>(wanted);
  node_list nodes = make_roots(points, width, height);
  std::vector<node_list::iterator>
      multiple;  // nodes to split again, in the order of their creation
  bool done = false;
  while (!done) {
    auto const before = nodes.size();
    multiple.clear();
    for (auto it = nodes.begin(); it != nodes.end();) {
      if (it->points.size() == 1) {
        ++it;
        continue;
      }
      push_children(nodes, *it, multiple);
      it = nodes.erase(it);
    }
    if (nodes.size() >= enough || nodes.size() == before) { break; }
    if (nodes.size() + 3 * multiple.size() <= enough) { continue; }
    while (!done) {
      auto const before_batch = nodes.size();
      auto batch = std::exchange(multiple, {});
      auto const before_other = [](auto const& a, auto const& b) {
        return std::make_pair(a->points.size(), a->x0) < std::make_pair(b->points.size(), b->x0);
      };
      if (ties == ft::tie_rule::stable) {
        std::stable_sort(batch.begin(), batch.end(), before_other);
      } else {
        std::sort(batch.begin(), batch.end(), before_other);
      }
      for (auto it = batch.rbegin(); it != batch.rend() && nodes.size() < enough; ++it) {
        push_children(nodes, **it, multiple);
        nodes.erase(*it);
      }
      done = nodes.size() >= enough || nodes.size() <= before_batch;
    }
  }
  for (auto const& n : nodes) {
    kept.push_back(
        *std::max_element(n.points.begin(), n.points.end(), [](auto const& a, auto const& b) {
          return a.response < b.response;  // the first of equals
        }));
  }
  return kept;
}

/// A number in [0, n).
int below(std::mt19937& random, int n) {
  return static_cast<int>(random() % static_cast<unsigned>(std::max(n, 1)));
}

enum class scatter {
  uniform,
  clustered,
  grid,
  line,
  corner_of_the_level,
  coincident,
  split_lines,
  block_of_pixels,
  count
};

/// A column or row beside or on a line at which nodes of the first depths are split.
int near_split(std::mt19937& random, int side) {
  int low = 0;
  int high = side;
  for (int depth = below(random, 8); depth >= 0 && high - low > 1; --depth) {
    int const middle = low + (high - low + 1) / 2;
    if (depth == 0) { return middle - below(random, 2); }
    (below(random, 2) == 0 ? high : low) = middle;
  }
  return low;
}

corners_list random_points(std::mt19937& random, scatter kind, int n, int width, int height) {
  int const responses = 1 + below(random, 3) * below(random, 100);  // often all equal
  std::vector<std::pair<int, int>> centres(static_cast<std::size_t>(1 + below(random, 5)));
  for (auto& c : centres) { c = {below(random, width), below(random, height)}; }
  int const spread = 2 + below(random, 40);
  int const pitch = 1 + below(random, 9);
  std::set<std::pair<int, int>> taken;
  corners_list points;
  for (int i = 0; i < n; ++i) {
    int x = below(random, width);
    int y = below(random, height);
    if (kind == scatter::clustered) {
      auto const& c =
          centres[static_cast<std::size_t>(below(random, static_cast<int>(centres.size())))];
      x = c.first + below(random, spread) - spread / 2;
      y = c.second + below(random, spread) - spread / 2;
    } else if (kind == scatter::grid) {
      x = (i % (width / pitch + 1)) * pitch;
      y = (i / (width / pitch + 1)) * pitch;
    } else if (kind == scatter::line) {
      y = static_cast<int>(static_cast<std::int64_t>(x) * height / width);
    } else if (kind == scatter::corner_of_the_level) {
      x = width - 1 - below(random, 8);
      y = height - 1 - below(random, 8);
    } else if (kind == scatter::coincident) {
      x = centres[0].first + below(random, 2);
      y = centres[0].second;
    } else if (kind == scatter::split_lines) {
      x = near_split(random, width);
      y = near_split(random, height);
    } else if (kind == scatter::block_of_pixels) {
      x = centres[0].first / 2 + i % spread;
      y = centres[0].second / 2 + i / spread;
    }
    x = std::min(std::max(x, 0), width - 1);
    y = std::min(std::max(y, 0), height - 1);
    // Corners are at places of their own; the rule must end for any input all the same.
    if (kind != scatter::coincident && !taken.insert({x, y}).second) { continue; }
    points.push_back({static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y),
                      7 + below(random, responses)});
  }
  return points;
}

template <typename Backend>
class distribution_oracle_test : public test::on_backend<Backend> {
protected:
  void SetUp() override {
    test::on_backend<Backend>::SetUp();
    if (!this->IsSkipped() && !this->HasFailure()) { backend_ = std::make_unique<Backend>(); }
  }

  /// Distributes random points over all levels of `batch` images and compares with the plain rule.
  void compare(std::mt19937& random, int width, int height, int levels, int wanted, int batch,
               int most_points) {
    auto const geometry = ft::pyramid_geometry::make(width, height, levels, 1.2f);
    auto const cells = ft::corner_layout::make(geometry);
    auto const layout = ft::distribution_layout::make(geometry, wanted);
    std::vector<corners_list> points(static_cast<std::size_t>(batch * levels));
    for (int b = 0; b < batch; ++b) {
      for (int l = 0; l < levels; ++l) {
        int const slots = static_cast<int>(cells.level_slots(l));
        int const n = std::min(
            below(random, 6) == 0 ? below(random, 4) : below(random, most_points + 1), slots);
        auto const kind = static_cast<scatter>(below(random, static_cast<int>(scatter::count)));
        if (n > 0) {
          points[static_cast<std::size_t>(b * levels + l)] =
              random_points(random, kind, n, layout.width[l], layout.height[l]);
        }
      }
    }
    compare(points, width, height, levels, wanted, batch);
  }

  /// The same for given points, [batch][levels].
  /// @param scratch_points that levels in block scratch may have; 0 = what is usual
  void compare(std::vector<corners_list> const& points, int width, int height, int levels,
               int wanted, int batch, int scratch_points = 0) {
    auto const geometry = ft::pyramid_geometry::make(width, height, levels, 1.2f);
    auto const cells = ft::corner_layout::make(geometry);
    auto const layout = ft::distribution_layout::make(geometry, wanted);
    auto const& exec = backend_->exec;
    ft::corners_view corners;
    ft::distribution_view out;
    ft::arena<std::decay_t<decltype(exec)>::space> memory([&](ft::carver& c) {
      ft::carve(c, corners, cells, batch);
      ft::carve(c, out, layout, cells, batch);
    });
    corners_list list(static_cast<std::size_t>(batch) *
                      static_cast<std::size_t>(cells.total_slots));
    std::vector<int> counts(static_cast<std::size_t>(batch * levels), 0);
    std::vector<corners_list> in_order = points;  // as the rule takes them
    for (int b = 0; b < batch; ++b) {
      for (int l = 0; l < levels; ++l) {
        auto const at = static_cast<std::size_t>(b * levels + l);
        ASSERT_LE(points[at].size(), static_cast<std::size_t>(cells.level_slots(l)));
        counts[at] = static_cast<int>(points[at].size());
        test::sort_corners(in_order[at].data(), counts[at], cells, l);
        std::copy(in_order[at].begin(), in_order[at].end(),
                  list.begin() + b * cells.total_slots + cells.first_slot[l]);
      }
    }
    corners_list shuffled = list;
    std::mt19937 random(static_cast<unsigned>(list.size()));
    for (int b = 0; b < batch; ++b) {
      for (int l = 0; l < levels; ++l) {
        auto const first = shuffled.begin() + b * cells.total_slots + cells.first_slot[l];
        std::shuffle(first, first + counts[static_cast<std::size_t>(b * levels + l)], random);
      }
    }
    ft::copy(exec, corners.list_count, counts.data(), counts.size());
    for (bool const any_order : {false, true}) {
      auto const& given = any_order ? shuffled : list;
      ft::copy(exec, corners.list, given.data(), given.size());
      for (ft::tie_rule const ties : {ft::tie_rule::stable, ft::tie_rule::std_sort}) {
        if (ties == ft::tie_rule::std_sort && !has_std_sort) { continue; }
        SCOPED_TRACE(any_order ? "any order" : "in order");
        SCOPED_TRACE(ties == ft::tie_rule::stable ? "stable" : "std_sort");
        run(exec, corners, out, ties, scratch_points);
        int compared = 0;
        check(exec, in_order, layout, out, levels, batch, ties, compared);
        levels_compared_ += any_order && ties == ft::tie_rule::stable ? compared : 0;
      }
    }
  }

  template <typename Exec>
  static void run(Exec const& exec, ft::corners_view const& corners,
                  ft::distribution_view const& out, ft::tie_rule ties, int scratch_points) {
    ft::detail::level_memory const division{scratch_points};
    if (scratch_points == 0) {
      ft::distribute_corners(exec, corners, out, ties);
    } else if (ties == ft::tie_rule::std_sort) {
      ft::detail::distribute_in<ft::tie_rule::std_sort>(exec, division, corners, out);
    } else {
      ft::detail::distribute_in<ft::tie_rule::stable>(exec, division, corners, out);
    }
  }

  template <typename Exec>
  void check(Exec const& exec, std::vector<corners_list> const& points,
             ft::distribution_layout const& layout, ft::distribution_view const& out, int levels,
             int batch, ft::tie_rule ties, int& compared) {
    auto const kept =
        test::from_exec(exec, out.kept, static_cast<std::size_t>(batch * layout.total));
    auto const kept_count =
        test::from_exec(exec, out.kept_count, static_cast<std::size_t>(batch * levels));
    for (int b = 0; b < batch; ++b) {
      for (int l = 0; l < levels; ++l) {
        auto const at = static_cast<std::size_t>(b * levels + l);
        auto const want =
            distribute(points[at], layout.width[l], layout.height[l], layout.wanted[l], ties);
        SCOPED_TRACE("image " + std::to_string(b) + " level " + std::to_string(l) + " with " +
                     std::to_string(layout.width[l]) + "x" + std::to_string(layout.height[l]) +
                     ", " + std::to_string(points[at].size()) + " points, wanted " +
                     std::to_string(layout.wanted[l]));
        ASSERT_LE(static_cast<int>(want.size()), layout.capacity[l]);
        ASSERT_EQ(kept_count[at], static_cast<int>(want.size()));
        auto const first = static_cast<std::size_t>(b * layout.total + layout.first[l]);
        for (std::size_t i = 0; i < want.size(); ++i) {
          auto const& got = kept[first + i];
          ASSERT_TRUE(got.x == want[i].x && got.y == want[i].y && got.response == want[i].response)
              << "node " << i << ": (" << got.x << ", " << got.y << ") " << got.response
              << " instead of (" << want[i].x << ", " << want[i].y << ") " << want[i].response;
        }
        compared += static_cast<int>(!want.empty());
      }
    }
  }

  std::unique_ptr<Backend> backend_;  // made where there is a device only
  int levels_compared_ = 0;
};
TYPED_TEST_SUITE(distribution_oracle_test, test::backends);

TYPED_TEST(distribution_oracle_test, keeps_what_the_list_of_nodes_keeps) {
  struct shape {
    int min_width, max_width, min_height, max_height, most_points;
  };
  constexpr shape shapes[] = {
      {160, 900, 120, 600, 1500},  // landscape
      {100, 300, 200, 900, 800},   // portrait: one root
      {600, 1800, 70, 130, 600},   // wide: many roots
      {67, 80, 67, 80, 60},        // one cell
      {9000, 16384, 67, 90, 700},  // more roots than wanted features
  };
  for (unsigned seed = 0; seed < static_cast<unsigned>(test::effort(1000)); ++seed) {
    std::mt19937 random(1000 + seed);
    auto const& s = shapes[seed % std::size(shapes)];
    int const wanted = 1 + below(random, 1 << (1 + below(random, 11)));
    int const width = s.min_width + below(random, s.max_width - s.min_width + 1);
    int const height = s.min_height + below(random, s.max_height - s.min_height + 1);
    SCOPED_TRACE("seed " + std::to_string(seed));
    this->compare(random, width, height, 1 + below(random, 3), wanted, 1 + below(random, 4),
                  s.most_points);
    if (this->HasFatalFailure()) { return; }
  }
  EXPECT_GT(this->levels_compared_, test::effort(2000));
}

TYPED_TEST(distribution_oracle_test, many_points_and_up_to_3000_features) {
  for (unsigned seed = 0; seed < static_cast<unsigned>(test::effort(8)); ++seed) {
    std::mt19937 random(9000 + seed);
    SCOPED_TRACE("seed " + std::to_string(seed));
    this->compare(random, 752 + below(random, 500), 370 + below(random, 300), 1,
                  seed == 0 ? 3000 : 1 + below(random, 3000), 2, 12000);
    if (this->HasFatalFailure()) { return; }
  }
}

TYPED_TEST(distribution_oracle_test, few_points_for_any_number_of_wanted_features) {
  for (int wanted = 1; wanted <= test::effort(40); ++wanted) {
    for (int most = 0; most <= 3; ++most) {
      std::mt19937 random(static_cast<unsigned>(100 * wanted + most));
      SCOPED_TRACE("wanted " + std::to_string(wanted) + ", up to " + std::to_string(most) +
                   " points");
      this->compare(random, 120, 90, 2, wanted, 3, most);
      if (this->HasFatalFailure()) { return; }
    }
  }
}

TYPED_TEST(distribution_oracle_test, every_kind_of_points_around_what_block_scratch_holds) {
  namespace level = ft::detail::quadtree;
  int const points[] = {1,
                        2,
                        31,
                        32,
                        33,
                        level::crowded_bin,
                        level::crowded_bin + 1,
                        level::min_scratch_points - 1,
                        level::min_scratch_points,
                        level::min_scratch_points + 1};
  // The host's levels are always in the workspace.
  int const scratch_points = TypeParam::exec_type::asynchronous ? level::min_scratch_points : 0;
  int const wanted[] = {
      1, 60, level::ranked_nodes, level::scratch_nodes - 3, level::scratch_nodes - 2, 1500};
  int const shapes[][2] = {{752, 480}, {370, 640}, {1700, 140}, {1000, 1000}};
  unsigned seed = 0;
  for (auto const& side : shapes) {
    auto const geometry = ft::pyramid_geometry::make(side[0], side[1], 1, 1.2f);
    for (int kind = 0; kind < static_cast<int>(scatter::count); ++kind) {
      for (int const n : points) {
        std::mt19937 random(++seed);
        // Places are taken once, so some more are drawn.
        auto list = random_points(random, static_cast<scatter>(kind), 2 * n, geometry.width[0] - 32,
                                  geometry.height[0] - 32);
        list.resize(std::min(list.size(), static_cast<std::size_t>(n)));
        int const features = wanted[(seed + seed / std::size(points)) % std::size(wanted)];
        SCOPED_TRACE("kind " + std::to_string(kind) + ", seed " + std::to_string(seed));
        this->compare({list}, side[0], side[1], 1, features, 1, scratch_points);
        if (this->HasFatalFailure()) { return; }
      }
    }
  }
  EXPECT_EQ(this->levels_compared_, static_cast<int>(seed));
}

TYPED_TEST(distribution_oracle_test, nodes_far_down_the_tree) {
  // Neighbouring pixels and a far point: rounds go on until single pixels are nodes.
  for (int n = 2; n <= 40; ++n) {
    corners_list list;
    for (int i = 0; i < n; ++i) {
      list.push_back({static_cast<std::uint16_t>(401 + i % 7),
                      static_cast<std::uint16_t>(203 + i / 7), 7 + i * 37 % 11});
    }
    list.push_back({3, 5, 9});
    for (int wanted = 1; wanted <= n + 4; wanted += 3) {
      this->compare({list}, 1280, 720, 1, wanted, 1);
      if (this->HasFatalFailure()) { return; }
    }
  }
}

TYPED_TEST(distribution_oracle_test, around_what_threads_keep_in_registers) {
  unsigned seed = 500;
  // Roots, whose numbers are a part of what a register holds, and points.
  int const shapes[][2] = {{752, 480}, {6000, 140}, {9000, 140}, {16384, 140}};
  for (auto const& side : shapes) {
    auto const geometry = ft::pyramid_geometry::make(side[0], side[1], 1, 1.2f);
    for (int kind = 0; kind < static_cast<int>(scatter::count); ++kind) {
      for (int const n : {4095, 4096, 4097}) {
        std::mt19937 random(++seed);
        auto list = random_points(random, static_cast<scatter>(kind), 2 * n, geometry.width[0] - 32,
                                  geometry.height[0] - 32);
        list.resize(std::min(list.size(), static_cast<std::size_t>(n)));
        SCOPED_TRACE("kind " + std::to_string(kind) + ", seed " + std::to_string(seed));
        this->compare({list}, side[0], side[1], 1, 261, 1);
        if (this->HasFatalFailure()) { return; }
      }
    }
  }
}

TYPED_TEST(distribution_oracle_test, nodes_of_many_points_in_wide_levels) {
  // The wider a level, the fewer points a node may have for a key of 32 bits.
  for (int const width : {1000, 4000, 16384}) {
    int const most = width > 16000 ? 127 : width > 3000 ? 511 : 2047;
    for (int const n : {most - 1, most, most + 1, most + 70}) {
      corners_list list;
      for (int i = 0; i < n; ++i) {  // in one node after the first round
        list.push_back({static_cast<std::uint16_t>(705 + i % 44),
                        static_cast<std::uint16_t>(3 + i / 44), 7 + i * 37 % 11});
      }
      // The list grows in the first rounds.
      for (int const x : {10, 40, 80}) { list.push_back({static_cast<std::uint16_t>(x), 5, 9}); }
      for (int wanted = 3; wanted < 11; ++wanted) {
        SCOPED_TRACE(std::to_string(width) + " columns, " + std::to_string(n) + " points together");
        this->compare({list}, width, 140, 1, wanted, 1);
        if (this->HasFatalFailure()) { return; }
      }
    }
  }
}

}  // namespace distribution_oracle
