// SPDX-License-Identifier: Apache-2.0
/// @file Stage: even distribution of corners over a level by a quadtree. Source: specification
/// section 3.
///
/// The rule is sequential (a list of nodes, children pushed to its front). A point's way down the
/// tree does not depend on the other points, though: it is a code, two bits a depth. Points are
/// sorted by it once; a node is then a range of the sorted points, the numbers of nodes at every
/// depth are known before a node is split, and with them how many rounds the rule makes. The list
/// after the rounds in which every node is split is written at once, and only the rounds that go
/// node by node are made. docs/architecture.md says why the result is the loop's.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/corners.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/introsort.hpp"

namespace ft {
inline namespace FT_ABI {

/// Which of two nodes is split first where both have as many points and the same left edge, in the
/// rounds that go node by node. Source: specification section 3.
enum class tie_rule {
  stable,   ///< the one made last
  std_sort  ///< as libstdc++'s std::sort orders them, whatever library the program uses
};

/// How many corners each level should keep and how much memory that takes.
struct distribution_layout {
  int levels = 0;
  int wanted[max_levels] = {};  ///< features of a level
  int roots[max_levels] = {};
  int width[max_levels] = {};  ///< of the work area
  int height[max_levels] = {};
  int capacity[max_levels] = {};  ///< nodes, and kept corners, of a level
  int first[max_levels] = {};     ///< of a level among an image's
  int total = 0;                  ///< of an image

  /// Level of the corner in a slot of an image.
  FT_HOST_DEVICE int level_of(int slot) const {
    int l = 0;
    while (l + 1 < levels && slot >= first[l + 1]) { ++l; }
    return l;
  }
  /// @param features wanted in all levels together, 1 to 2^20. Source: specification section 2.
  static distribution_layout make(pyramid_geometry const& g, int features) {
    detail::require_range("features", features, 1, 1 << 20);
    distribution_layout d;
    d.levels = g.levels;
    float const factor = 1.0f / g.scale_factor;
    float n = static_cast<float>(features) * (1.0f - factor) /
              (1.0f - static_cast<float>(
                          std::pow(static_cast<double>(factor), static_cast<double>(g.levels))));
    int sum = 0;
    for (int l = 0; l < g.levels; ++l) {
      bool const last = l + 1 == g.levels;
      d.wanted[l] = last ? max_of(features - sum, 0) : static_cast<int>(std::lrint(n));
      sum += d.wanted[l];
      n *= factor;
      d.width[l] = max_of(g.width[l] - 2 * corner_border, 0);
      d.height[l] = max_of(g.height[l] - 2 * corner_border, 0);
      bool const empty = d.width[l] < corner_cell_size || d.height[l] < corner_cell_size;
      d.roots[l] = empty ? 0
                         : max_of(1, static_cast<int>(std::round(static_cast<float>(d.width[l]) /
                                                                 static_cast<float>(d.height[l]))));
      // One unconditional round makes at most four nodes of a root; from n-1 nodes a split makes
      // n+2.
      d.capacity[l] = empty ? 0 : max_of(d.wanted[l] + 3, 4 * d.roots[l]);
      d.first[l] = d.total;
      d.total += d.capacity[l];
    }
    return d;
  }
};

/// A quadtree node: the points [begin, end) of the sorted ones.
template <typename Index>
struct node_range {
  Index begin, end;
};

/// Kept corners and the workspace of the quadtree, for a batch of images.
struct distribution_view {
  distribution_layout layout;
  int batch = 0;
  corner* kept = nullptr;     ///< [batch][total], per level in list order
  int* kept_count = nullptr;  ///< [batch][levels]
  // What levels use that do not fit into block scratch.
  static constexpr int key_pad = 32;        ///< keys more than points: rows are whole words
  unsigned long long* keys = nullptr;       ///< [batch][total_slots + levels * key_pad]
  unsigned* order = nullptr;                ///< [batch][total_slots]
  node_range<int>* list[2] = {};            ///< [batch][total]
  unsigned long long* node_keys = nullptr;  ///< [batch][total]
  int* splits_before = nullptr;             ///< [batch][total]
  int* gain_before = nullptr;               ///< [batch][total]
};

inline void carve(carver& c, distribution_view& v, distribution_layout const& layout,
                  corner_layout const& corners, int batch) {
  auto const b = static_cast<std::size_t>(batch);
  auto const levels = static_cast<std::size_t>(layout.levels);
  auto const slots = static_cast<std::size_t>(corners.total_slots);
  std::size_t const total = detail::checked_mul(b, static_cast<std::size_t>(layout.total));
  v.layout = layout;
  v.batch = batch;
  v.kept = c.take<corner>(max_of(total, std::size_t{1}));  // the first is read in any case
  v.kept_count = c.take<int>(b * levels);
  v.keys = c.take<unsigned long long>(
      detail::checked_mul(b, slots + levels * std::size_t{distribution_view::key_pad}));
  v.order = c.take<unsigned>(detail::checked_mul(b, slots));
  v.list[0] = c.take<node_range<int>>(total);
  v.list[1] = c.take<node_range<int>>(total);
  v.node_keys = c.take<unsigned long long>(total);
  v.splits_before = c.take<int>(total);
  v.gain_before = c.take<int>(total);
}

/// The quadtree of one level of one image.
///
/// The *code* of a point is the number of its root and, for each depth from 1 to `depths`, two
/// bits: 1 for the right half, 2 for the lower half. The bits of even depths are inverted: pushing
/// to the front turns the order around in each round, and with every second depth inverted the
/// nodes made in round k are, for odd k, in descending order of their codes, for even k in
/// ascending order.
struct distribute_level {
  bool entered = false;  ///< take the corners' entries, not their ordered list
  /// Levels of up to so many points are kept in the block scratch asked for at launch, others in
  /// the workspace.
  int scratch_points = 0;
  static constexpr int threads = 512;  ///< of a block
  /// Levels that keep more nodes are in the workspace, too.
  static constexpr int scratch_nodes = 512;
  static constexpr int max_bins = 2048;   ///< codes are sorted into so many bins first,
  static constexpr int more_bins = 8192;  ///< or so many where the points leave place for them
  /// Depths told apart at first; where nodes are left that might be split, all are.
  static constexpr int usual_depths = 7;
  static constexpr int max_rows =
      16;  ///< depths 0 to 15: nodes of 2^14 pixels a side, and one more
  /// A bin of more points makes the points sorted by comparison.
  static constexpr int crowded_bin = 128;
  /// Up to so many nodes are put in the splitting order by comparing each with each.
  static constexpr int ranked_nodes = 256;

  struct scratch {
    struct split_store {
      unsigned long long keys[scratch_nodes];
      int splits_before[scratch_nodes];
      int gain_before[scratch_nodes];
    };
    struct packed_store {
      unsigned keys[scratch_nodes];
      int before[scratch_nodes];
      std::uint16_t left[scratch_nodes];  ///< of introsort; then the place of each node's key
      std::uint16_t right[scratch_nodes];
    };
    union {
      alignas(16) int bins[max_bins];
      split_store splits;
      packed_store packed;
    } b;
    int totals[2 * max_rows];
    int made;
    int candidates;  ///< keys of split_together() so far, and `large_node` for each that has none
    union {
      unsigned crowded;  ///< while points are sorted
      int open[2];       ///< of introsort
    };
  };

  /// Of block scratch, for a point: its key, then, in the same place, its part of the rows; and its
  /// entry of `order`.
  static constexpr int bytes_per_point = 12;
  /// Fewer do not leave place for the nodes beside the rows.
  static constexpr int min_scratch_points = 2048;

  /// @param bytes of block scratch that there are besides `scratch`
  static distribute_level with_scratch(std::size_t bytes, bool entered) {
    auto const points = min_of(bytes / bytes_per_point, std::size_t{0xffe0}) / 32 * 32;
    distribute_level op;
    op.entered = entered;
    if (points >= std::size_t{min_scratch_points}) { op.scratch_points = static_cast<int>(points); }
    return op;
  }
  /// What the executor is asked for.
  std::size_t extra_bytes() const {
    return static_cast<std::size_t>(scratch_points) * bytes_per_point;
  }

  /// Whether there is place for them, as there is where no two blocks share a multiprocessor.
  FT_HOST_DEVICE bool has_more_bins() const { return scratch_points > more_bins / 2; }

  /// Empties bins, and fills the tables of codes.
  template <typename Group>
  FT_HOST_DEVICE void prologue(Group g, scratch& s, int item, corners_view const&,
                               distribution_view const& v) const {
    distribution_layout const& layout = v.layout;
    int const l = item % layout.levels;
    if (scratch_points == 0 || layout.capacity[l] == 0) { return; }
    shape const level(layout.width[l], layout.height[l], layout.roots[l], 1, usual_depths, 1);
    empty_bins(g, s.b.bins, max_bins);
    if (has_more_bins()) { empty_bins(g, bins_in_scratch(g), more_bins); }
    if (level.width + level.height <= scratch_points) {
      fill_tables(g, level, order_in_scratch(g));
    }
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, corners_view const& corners,
                                 distribution_view const& v) const {
    distribute<0, tie_rule::stable>(g, s, item, corners, v);
  }

protected:
  /// @tparam Held points that a thread keeps in registers while they are sorted, where that is all
  template <int Held, tie_rule Ties, typename Group>
  FT_HOST_DEVICE void distribute(Group g, scratch& s, int item, corners_view const& corners,
                                 distribution_view const& v) const {
    distribution_layout const& layout = v.layout;
    int const image = item / layout.levels;
    int const l = item % layout.levels;
    // Points are under way while it is found out how many there are.
    corner_word held[max_of(Held, 1)];
    fetch_points<Held>(g, held, corners_of(image, l, corners),
                       static_cast<int>(corners.layout.level_slots(l)));
    int const points = (entered ? corners.entry_count : corners.list_count)[item];
    if (points == 0 || layout.capacity[l] == 0) {
      if (g.rank() == 0) { v.kept_count[item] = 0; }
      return;
    }
    int const at = image * layout.total + layout.first[l];
    int size = 0;
    if (points <= scratch_points && layout.capacity[l] <= scratch_nodes) {
      unsigned char* const memory = g.extra();
      tree<std::uint16_t> t;
      take_points(t, image, l, corners);
      t.n = points;
      t.words = ceil_div(points, 32);
      t.keys = reinterpret_cast<unsigned long long*>(memory);
      t.order = order_in_scratch(g);
      t.prepared = true;
      if (points <= scratch_points - more_bins_words) {
        t.bins = bins_in_scratch(g);
        t.most_bins = more_bins;
      } else {
        t.bins = s.b.bins;
        t.most_bins = max_bins;
      }
      t.order_size = scratch_points;
      // Behind keys and rows, before what else lies in their part.
      int const copy_at = 8 * 32 * t.words;
      if (copy_at + static_cast<int>(sizeof(corner)) * points <=
          min_of(6 * scratch_points, 8 * (scratch_points - more_bins_words))) {
        t.copy = reinterpret_cast<corner*>(memory + copy_at);
      }
      t.rows = reinterpret_cast<unsigned*>(memory);
      t.before = reinterpret_cast<std::uint16_t*>(t.rows + 2 * max_rows * t.words);
      t.list = reinterpret_cast<node_range<std::uint16_t>*>(memory + 6 * scratch_points);
      t.next = t.list + scratch_nodes;
      t.node_keys = s.b.splits.keys;
      t.splits_before = s.b.splits.splits_before;
      t.gain_before = s.b.splits.gain_before;
      size = run<Held, Ties>(g, s, t, held, layout, l, v.kept + at);
    } else {
      size = run_in_workspace<Ties>(g, s, image, l, points, at, corners, v);
    }
    if (g.rank() == 0) {
      v.kept_count[item] = size;
      if (entered) { corners.entry_count[item] = 0; }
    }
  }

private:
  // Of the keys' part of block scratch, behind the keys where both have place.
  static constexpr int more_bins_words = more_bins / 2;
  template <typename Group>
  FT_HOST_DEVICE int* bins_in_scratch(Group g) const {
    return reinterpret_cast<int*>(g.extra() + 8 * (scratch_points - more_bins_words));
  }
  template <typename Group>
  FT_HOST_DEVICE unsigned* order_in_scratch(Group g) const {
    return reinterpret_cast<unsigned*>(g.extra() + 8 * scratch_points);
  }

  template <tie_rule Ties, typename Group>
  FT_HOST_DEVICE int run_in_workspace(Group g, scratch& s, int image, int l, int points, int at,
                                      corners_view const& corners,
                                      distribution_view const& v) const {
    distribution_layout const& layout = v.layout;
    std::ptrdiff_t const slot = image * corners.layout.total_slots + corners.layout.first_slot[l];
    tree<int> t;
    t.keys = v.keys + slot +
             static_cast<std::ptrdiff_t>(distribution_view::key_pad) * (image * layout.levels + l);
    t.order = v.order + slot;
    t.bins = s.b.bins;
    t.most_bins = max_bins;
    t.order_size = static_cast<int>(corners.layout.level_slots(l));
    t.n = points;
    t.words = ceil_div(points, 32);
    // Rows and their counts: 2 * max_rows words of each for 32 points, 8 bytes a point.
    t.rows = reinterpret_cast<unsigned*>(t.keys);
    t.before = reinterpret_cast<int*>(t.rows + static_cast<std::ptrdiff_t>(2 * max_rows) * t.words);
    t.list = v.list[0] + at;
    t.next = v.list[1] + at;
    t.node_keys = v.node_keys + at;
    t.splits_before = v.splits_before + at;
    t.gain_before = v.gain_before + at;
    take_points(t, image, l, corners);
    corner_word held[1] = {};
    return run<0, Ties>(g, s, t, held, layout, l, v.kept + at);
  }

  static constexpr int index_bits = 26;  ///< of an entry of `order`; above it the depth
  static constexpr unsigned index_mask = (1u << index_bits) - 1;
  static constexpr int never = 31;  ///< depth at which coincident points part

  // Rows and their counts take 6 bytes a point, both lists have what is left of the keys' 8.
  static_assert(2 * max_rows * 6 == 6 * 32, "rows of words of 32 points");
  static_assert(2 * scratch_nodes * sizeof(node_range<std::uint16_t>) <= 2 * min_scratch_points,
                "aliased");

  /// Where nodes are split: follows from the level's size alone.
  struct shape {
    int width, height, roots;
    float root_width;
    int depths;     ///< bits of a code below the root's, in pairs
    bool complete;  ///< no deeper node parts points
    int rows;       ///< depths that are told apart, 0 to `depths`
    int bins;       ///< the leading bits of the codes
    int bin_shift;  ///< bits of a code below the bin's
    unsigned flip;  ///< the inverted bits

    /// @param most depths to tell apart, fewer where no node has more
    FT_HOST_DEVICE shape(int w, int h, int root_count, int points, int most, int most_bins)
        : width(w),
          height(h),
          roots(root_count),
          root_width(detail::div(static_cast<float>(w), static_cast<float>(root_count))) {
      // Nodes at the depth before the last have at most one pixel. A point that rounding put into
      // the root beside its own is split from the last column one depth later, if at all. At most
      // 31 bits: a side has 16384 pixels at most, and with k > 1 roots the height is below 1.5 / k
      // of the width.
      int const side = max_of(static_cast<int>(root_width) + 2, height);
      int full = 1;
      while (1 << (full - 1) < side) { ++full; }
      depths = min_of(full, most);
      complete = depths == full;
      rows = depths + 1;
      bins = roots;
      bin_shift = 2 * depths;
      while (4 * bins <= min_of(most_bins, 4 * points) && bin_shift > 0) {
        bins *= 4;
        bin_shift -= 2;
      }
      flip = (depths % 2 == 0 ? 0x33333333u : 0xccccccccu) & ((1u << 2 * depths) - 1);
    }
    FT_HOST_DEVICE int root_of(int x) const {
      return min_of(static_cast<int>(detail::div(static_cast<float>(x), root_width)), roots - 1);
    }
    FT_HOST_DEVICE int root_edge(int root) const {
      return static_cast<int>(detail::mul(root_width, static_cast<float>(root)));
    }
    /// Bit 2 (depths - d) is set where the point is in the second half at depth d.
    FT_HOST_DEVICE unsigned axis_code(int offset, int side) const {
      unsigned code = 0;
      for (int d = 0; d < depths; ++d) {
        int const half = (side + 1) >> 1;
        bool const second = offset >= half;
        code = code << 2 | static_cast<unsigned>(second);
        offset -= second ? half : 0;
        side = second ? side - half : half;
      }
      return code;
    }
    FT_HOST_DEVICE unsigned column_code(int x) const {
      int const root = root_of(x);
      int const edge = root_edge(root);
      return (static_cast<unsigned>(root) << 2 * depths |
              axis_code(x - edge, root_edge(root + 1) - edge)) ^
             flip;
    }
    FT_HOST_DEVICE unsigned row_code(int y) const { return axis_code(y, height) << 1; }
    /// Left edge of the node at `depth` that holds column x.
    FT_HOST_DEVICE int left_edge(int x, int depth) const {
      int const root = root_of(x);
      int edge = root_edge(root);
      int side = root_edge(root + 1) - edge;
      for (int d = 0; d < depth; ++d) {
        int const half = (side + 1) >> 1;
        bool const second = x - edge >= half;
        edge += second ? half : 0;
        side = second ? side - half : half;
      }
      return edge;
    }
    /// First depth at which two codes differ.
    FT_HOST_DEVICE int parting_depth(unsigned a, unsigned b) const {
      unsigned const x = a ^ b;
      if (x == 0) { return never; }
#if defined(__CUDA_ARCH__)
      int const top = 31 - __clz(static_cast<int>(x));
#else
      int const top = 31 - __builtin_clz(x);
#endif
      return max_of(depths - top / 2, 0);
    }
    FT_HOST_DEVICE int row_of(int depth) const { return min_of(depth, depths); }
  };

  /// A level's points and its list. @tparam Index of sorted points
  ///
  /// Row k, for k in [0, rows), has a bit for each sorted point that is the first of its node at
  /// depth k; row `rows + k` one for each that is alone in it. `before` counts the bits of a row
  /// before each word.
  template <typename Index>
  struct tree {
    corner const* points;
    bool ranked;  ///< they are in any order, with a corner_rank
    int n, words;
    corner* copy = nullptr;    ///< where points are put once, to be read again; or null
    unsigned long long* keys;  ///< code << 32 | index
    unsigned* order;           ///< parting depth from the point before, and index, by code
    int order_size;            ///< at least n
    bool prepared = false;     ///< bins and tables are
    int* bins;                 ///< of the sort alone
    int most_bins;
    unsigned* rows;
    Index* before;
    node_range<Index>* list;  ///< front first
    node_range<Index>* next;
    unsigned long long* node_keys;
    int* splits_before;  ///< per node: how many are split before it
    int* gain_before;    ///< and how many nodes more the list has by then

    FT_HOST_DEVICE corner point(int i) const {
      corner c = points[i];
      if (ranked) { c.response = corner_rank::response(static_cast<std::uint32_t>(c.response)); }
      return c;
    }
    /// The strongest point's is the highest, of equals that of the first.
    FT_HOST_DEVICE unsigned long long strength(int i) const {
      auto const response =
          static_cast<unsigned long long>(static_cast<std::uint32_t>(points[i].response));
      return ranked ? response : response << 32 | (0xffffffffu - static_cast<unsigned>(i));
    }
    FT_HOST_DEVICE int depth_at(int p) const {
      return p < n ? static_cast<int>(order[p] >> index_bits) : 0;
    }
    FT_HOST_DEVICE int index_at(int p) const { return static_cast<int>(order[p] & index_mask); }
    /// Bits of a row below position p < n.
    FT_HOST_DEVICE int rank(int row, int p) const {
      int const at = row * words + p / 32;
      return before[at] + popcount(rows[at] & ((1u << (p & 31)) - 1));
    }
    /// Position of bit number i of a row.
    FT_HOST_DEVICE int select(int row, int i) const {
      int const first = row * words;
      int w = 0;
      for (int end = words; end - w > 1;) {
        int const middle = (w + end) / 2;
        if (before[first + middle] <= i) {
          w = middle;
        } else {
          end = middle;
        }
      }
      unsigned bits = rows[first + w];
      int left = i - before[first + w];
      int p = 32 * w;
      for (int step = 16; step > 0; step /= 2) {
        int const below = popcount(bits & ((1u << step) - 1));
        bool const above = left >= below;
        left -= above ? below : 0;
        bits >>= above ? step : 0;
        p += above ? step : 0;
      }
      return p;
    }
    /// Position of the first bit of a row above position p, n where there is none.
    FT_HOST_DEVICE int bit_above(int row, int p) const {
      int w = p / 32;
      unsigned bits = rows[row * words + w] & ~((2u << (p & 31)) - 1);
      while (bits == 0) {
        if (++w == words) { return n; }
        bits = rows[row * words + w];
      }
      return 32 * w + popcount((bits & (0u - bits)) - 1);
    }
  };

  /// A corner as one word: taken apart where it is needed, not where it is loaded, which would have
  /// the next load wait.
  using corner_word = unsigned long long;
  static_assert(sizeof(corner) == sizeof(corner_word) && alignof(corner) == sizeof(corner_word),
                "one load");
  FT_HOST_DEVICE static corner corner_of(corner_word word) {
    corner c;
    std::memcpy(&c, &word, sizeof(c));
    return c;
  }
  FT_HOST_DEVICE corner const* corners_of(int image, int l, corners_view const& corners) const {
    return (entered ? corners.entries : corners.list) + corners.level_slot(image, l);
  }
  /// A thread's points, the first `Held` turns. @param n of these and others
  template <int Held, typename Group, int Size>
  FT_HOST_DEVICE static void fetch_points(Group g, corner_word (&held)[Size], corner const* points,
                                          int n) {
    FT_UNROLL
    for (int k = 0; k < Held; ++k) {
      int const i = g.rank() + k * g.size();
      held[k] = {};
      if (i < n) { held[k] = *reinterpret_cast<corner_word const*>(points + i); }
    }
  }

  template <typename Index>
  FT_HOST_DEVICE void take_points(tree<Index>& t, int image, int l,
                                  corners_view const& corners) const {
    t.points = corners_of(image, l, corners);
    t.ranked = entered;
  }

  /// All of a level. Returns the number of kept corners.
  /// @param held the level's first points
  template <int Held, tie_rule Ties, typename Group, typename Index, int Size>
  FT_HOST_DEVICE static int run(Group g, scratch& s, tree<Index>& t, corner_word (&held)[Size],
                                distribution_layout const& layout, int l, corner* kept) {
    int const wanted = layout.wanted[l];
    for (int most = usual_depths;; most = max_rows - 1) {
      shape const level(layout.width[l], layout.height[l], layout.roots[l], t.n, most, t.most_bins);
      sort_points<Held>(g, s, t, held, level);
      mark_heads(g, t, level);
      count_heads(g, s, t, level);
      rounds const r = count_rounds(level, s.totals, wanted);
      if (r.last == 0) {  // the points are crowded: more depths
        fetch_points<Held>(g, held, t.points, t.n);
        continue;
      }
      int children = list_nodes(g, s, t, level, r.whole);
      int size = s.totals[level.row_of(r.whole)];
      for (int depth = r.whole + 1; depth <= r.last; ++depth) {
        if (!split_together<Ties>(g, s, t, level, depth, children, size, wanted)) {
          size = split_one_by_one<Ties>(g, s, t, level, depth, children, size, wanted);
        }
      }
      keep_strongest(g, t, size, kept);
      return size;
    }
  }

  struct rounds {
    int whole;  ///< split all nodes in list order
    int last;   ///< up to this one node by node; 0 where the rows do not tell
  };

  /// Every node with more than one point is split in every round but for the last, also in those
  /// that go node by node; so the size of the list after a round is the number of nodes at its
  /// depth.
  FT_HOST_DEVICE static rounds count_rounds(shape const& level, int const* totals, int wanted) {
    int const* const alone = totals + level.rows;
    int whole = 0;
    int before = totals[0];
    for (int round = 1; level.complete || round <= level.depths; ++round) {
      int const row = level.row_of(round);
      int const size = totals[row];
      bool const done = size >= wanted || size <= before;
      if (whole == 0 && (done || size + 3 * (size - alone[row]) > wanted)) { whole = round; }
      if (done) { return {whole, round}; }
      before = size;
    }
    return {0, 0};
  }

  /// Counts become the sums of those before; `crowded` tells whether one is large. Counts are in
  /// registers between, by quads, of which threads side by side have neighbouring ones.
  template <typename Group>
  FT_HOST_DEVICE static void scan_bins(Group g, scratch& s, int* bins, int n) {
    constexpr int most_quads = more_bins / 4 / Group::max_threads;
    static_assert(4 * most_quads * Group::max_threads == more_bins, "whole quads");
    int const quads = ceil_div(n, 4);
    if (Group::max_threads > 1 && quads > g.size()) {
      scan_quads<most_quads>(g, s, bins, quads);
    } else {
      scan_quads<1>(g, s, bins, quads);
    }
  }
  /// @tparam Each quads of a thread, at most
  template <int Each, typename Group>
  FT_HOST_DEVICE static void scan_quads(Group g, scratch& s, int* bins, int n) {
    struct alignas(16) quad {
      int of[4];
    };
    auto* const quads = reinterpret_cast<quad*>(bins);
    if constexpr (Group::max_threads == 1) {
      int at = 0;
      for (int i = 0; i < 4 * n; ++i) {
        int const count = bins[i];
        if (count > crowded_bin) { s.crowded = 1; }
        bins[i] = at;
        at += count;
      }
    } else {
      auto const part = g.part();
      int const width = part.size();
      // A warp has quads that follow each other.
      int const chunk = ceil_div(n, g.parts());
      int const first = g.part_index() * chunk;
      int const end = min_of(first + chunk, n);
      quad q[Each];
      int sum[Each];
      int all = 0;
      int most = 0;
      FT_UNROLL
      for (int k = 0; k < Each; ++k) {
        int const i = first + k * width + part.rank();
        q[k] = {};
        if (i < end) { q[k] = quads[i]; }
        sum[k] = q[k].of[0] + q[k].of[1] + q[k].of[2] + q[k].of[3];
        all += sum[k];
        most = max_of(max_of(most, max_of(q[k].of[0], q[k].of[1])), max_of(q[k].of[2], q[k].of[3]));
      }
      if (most > crowded_bin) { s.crowded = 1; }
      int total = 0;
      int at = g.exclusive_scan(all, total);
      if constexpr (Each > 1) {
        int warp_at = part.shuffle(at, 0);
        FT_UNROLL
        for (int k = 0; k < Each; ++k) {
          sum[k] = part.exclusive_scan(sum[k], total) + warp_at;
          warp_at += total;
        }
      } else {
        sum[0] = at;
      }
      FT_UNROLL
      for (int k = 0; k < Each; ++k) {
        int const i = first + k * width + part.rank();
        at = sum[k];
        FT_UNROLL
        for (int& count : q[k].of) {
          int const here = count;
          count = at;
          at += here;
        }
        if (i < end) { quads[i] = q[k]; }
      }
    }
  }

  template <typename Group>
  FT_HOST_DEVICE static void empty_bins(Group g, int* bins, int n) {
    for (int i = g.rank(); i < n; i += g.size()) { bins[i] = 0; }
  }
  /// The codes of columns, then of rows.
  template <typename Group>
  FT_HOST_DEVICE static void fill_tables(Group g, shape const& level, unsigned* table) {
    for (int i = g.rank(); i < level.width + level.height; i += g.size()) {
      table[i] = i < level.width ? level.column_code(i) : level.row_code(i - level.width);
    }
  }

  static constexpr int rank_bits = 12;  ///< of a point's rank in its bin, below its code

  /// Fills `order`: the points by (code, index).
  template <int Held, typename Group, typename Index, int Size>
  FT_HOST_DEVICE static void sort_points(Group g, scratch& s, tree<Index>& t,
                                         corner_word const (&held)[Size], shape const& level) {
    constexpr int batch = 4;  // loads under way at a time
    int* const bins = t.bins;
    unsigned* const table = t.order;  // dead before `order` is filled
    int const sides = level.width + level.height;
    // Where that is less than the codes of all points, or done already.
    bool const tables = sides <= t.order_size && (t.prepared || sides < 2 * t.n);
    if (!t.prepared) {
      empty_bins(g, bins, ceil_div(level.bins, 4) * 4);
      if (tables) { fill_tables(g, level, table); }
    }
    t.prepared = false;  // for another number of depths
    if (g.rank() == 0) { s.crowded = 0; }
    g.sync();
    auto const code_of = [&](corner const& p) {
      return tables ? table[p.x] ^ table[level.width + p.y]
                    : level.column_code(p.x) ^ level.row_code(p.y);
    };
    // A thread keeps its points' codes, and their ranks in their bins, where registers do.
    unsigned kept[max_of(Held, 1)] = {};
    bool const keeps =
        Held > 0 && tables && Held * g.size() <= 1 << rank_bits && t.n <= Held * g.size() &&
        static_cast<unsigned long long>(level.roots) << 2 * level.depths <= 1u << (32 - rank_bits);
    if (keeps) {
      // Loop by loop, so that nothing waits for what another point needs.
      auto const is_point = [&](int k) { return g.rank() + k * g.size() < t.n; };
      int rank[max_of(Held, 1)] = {};
      FT_UNROLL
      for (int k = 0; k < Held; ++k) {
        int const x = is_point(k) ? corner_of(held[k]).x : 0;
        int const y = is_point(k) ? corner_of(held[k]).y : 0;
        kept[k] = table[x] ^ table[level.width + y];
      }
      FT_UNROLL
      for (int k = 0; k < Held; ++k) {
        if (is_point(k)) { rank[k] = atomic_add(bins + (kept[k] >> level.bin_shift), 1); }
      }
      if (t.copy != nullptr) {
        FT_UNROLL
        for (int k = 0; k < Held; ++k) {
          if (is_point(k)) { t.copy[g.rank() + k * g.size()] = corner_of(held[k]); }
        }
      }
      FT_UNROLL
      for (int k = 0; k < Held; ++k) {
        kept[k] = kept[k] << rank_bits | static_cast<unsigned>(rank[k]);
      }
    } else {
      for (int base = g.rank(); base < t.n; base += batch * g.size()) {
        corner p[batch];
        FT_UNROLL
        for (int k = 0; k < batch; ++k) { p[k] = t.points[min_of(base + k * g.size(), t.n - 1)]; }
        FT_UNROLL
        for (int k = 0; k < batch; ++k) {
          int const i = base + k * g.size();
          if (i < t.n) {
            unsigned const code = code_of(p[k]);
            if (!tables) { t.order[i] = code; }
            if (t.copy != nullptr) { t.copy[i] = p[k]; }
            atomic_add(bins + (code >> level.bin_shift), 1);
          }
        }
      }
    }
    g.sync();
    if (t.copy != nullptr) {
      t.points = t.copy;
      t.copy = nullptr;
    }
    scan_bins(g, s, bins, level.bins);
    g.sync();
    if (keeps) {
      int begin[max_of(Held, 1)];
      FT_UNROLL
      for (int k = 0; k < Held; ++k) { begin[k] = bins[kept[k] >> rank_bits >> level.bin_shift]; }
      FT_UNROLL
      for (int k = 0; k < Held; ++k) {
        int const i = g.rank() + k * g.size();
        if (i < t.n) {
          int const rank = static_cast<int>(kept[k] & ((1u << rank_bits) - 1));
          t.keys[begin[k] + rank] = static_cast<unsigned long long>(kept[k] >> rank_bits) << 32 |
                                    static_cast<unsigned>(i);
        }
      }
    } else {
      for (int base = g.rank(); base < t.n; base += batch * g.size()) {
        unsigned code[batch];
        FT_UNROLL
        for (int k = 0; k < batch; ++k) {
          int const i = min_of(base + k * g.size(), t.n - 1);
          corner const p = t.points[i];
          code[k] = tables ? table[p.x] ^ table[level.width + p.y] : t.order[i];
        }
        FT_UNROLL
        for (int k = 0; k < batch; ++k) {
          int const i = base + k * g.size();
          if (i < t.n) {
            int const to = atomic_add(bins + (code[k] >> level.bin_shift), 1);
            t.keys[to] = static_cast<unsigned long long>(code[k]) << 32 | static_cast<unsigned>(i);
          }
        }
      }
    }
    g.sync();
    // A bin begins where it says, and ends there if its points were counted again while they were
    // moved. Within it a point's place is the number of smaller keys, and the largest of these is
    // that of the point before.
    bool const compare = s.crowded != 0;
    if (compare) { g.sort(t.keys, t.n); }
    for (int p = g.rank(); p < t.n; p += g.size()) {
      unsigned long long const key = t.keys[p];
      unsigned const code = static_cast<unsigned>(key >> 32);
      unsigned const bin = code >> level.bin_shift;
      int const at = static_cast<int>(bin) - (keeps ? 0 : 1);
      int const bin_begin = compare ? p : at >= 0 ? bins[at] : 0;
      int const bin_end = compare ? p : at + 1 < level.bins ? bins[at + 1] : t.n;
      int to = bin_begin;
      auto previous = bin_begin > 0 ? static_cast<unsigned>(t.keys[bin_begin - 1] >> 32) : 0u;
      for (int q = bin_begin; q < bin_end; ++q) {
        unsigned long long const other = t.keys[q];
        bool const smaller = other < key;
        to += static_cast<int>(smaller);
        previous = max_of(previous, smaller ? static_cast<unsigned>(other >> 32) : 0u);
      }
      int const depth = to == 0 ? 0 : level.parting_depth(previous, code);
      t.order[to] =
          static_cast<unsigned>(depth) << index_bits | static_cast<unsigned>(key & index_mask);
    }
    g.sync();
  }

  /// Fills the rows. 32 points at a time, a warp each: five ballots give the bits of their depths,
  /// from which each lane makes one row.
  template <typename Group, typename Index>
  FT_HOST_DEVICE static void mark_heads(Group g, tree<Index>& t, shape const& level) {
    constexpr int planes = 5;
    auto const part = g.part();
    for (int w = g.part_index(); w < t.words; w += g.parts()) {
      int const following = t.depth_at(32 * w + 32);
      unsigned const end = t.n < 32 * w + 32 ? 1u << (t.n & 31) : 0;
      auto const write = [&](int k, unsigned heads) {
        t.rows[k * t.words + w] = heads;
        t.rows[(level.rows + k) * t.words + w] =
            heads & ((heads | end) >> 1 | static_cast<unsigned>(following <= k) << 31);
      };
      if constexpr (Group::max_threads == 1) {
        unsigned parted[never + 1] = {};
        for (int p = 32 * w; p < min_of(32 * w + 32, t.n); ++p) {
          parted[t.depth_at(p)] |= 1u << (p & 31);
        }
        unsigned heads = 0;
        for (int k = 0; k < level.rows; ++k) { write(k, heads |= parted[k]); }
        continue;
      }
      unsigned plane[planes] = {};
      for (int base = 0; base < 32; base += part.size()) {
        int const p = 32 * w + base + part.rank();
        unsigned const depth = p < t.n ? t.order[p] >> index_bits : static_cast<unsigned>(never);
        FT_UNROLL
        for (int b = 0; b < planes; ++b) { plane[b] |= part.ballot((depth >> b & 1) != 0) << base; }
      }
      for (int k = part.rank(); k < level.rows; k += part.size()) {
        unsigned less = 0;
        unsigned equal = ~0u;
        FT_UNROLL
        for (int b = planes - 1; b >= 0; --b) {
          unsigned const bit = 0u - (static_cast<unsigned>(k) >> b & 1);
          less |= equal & bit & ~plane[b];
          equal &= ~(bit ^ plane[b]);
        }
        write(k, less | equal);
      }
    }
    g.sync();
  }

  /// Counts the bits of the rows: before each word, and in all (`totals`).
  template <typename Group, typename Index>
  FT_HOST_DEVICE static void count_heads(Group g, scratch& s, tree<Index>& t, shape const& level) {
    auto const part = g.part();
    int const chunk = ceil_div(t.words, part.size());
    int const first = min_of(part.rank() * chunk, t.words);
    int const end = min_of(first + chunk, t.words);
    for (int row = g.part_index(); row < 2 * level.rows; row += g.parts()) {
      unsigned const* const bits = t.rows + row * t.words;
      Index* const before = t.before + row * t.words;
      int sum = 0;
      for (int w = first; w < end; ++w) {
        before[w] = static_cast<Index>(sum);
        sum += popcount(bits[w]);
      }
      int total = 0;
      int const at = part.exclusive_scan(sum, total);
      for (int w = first; w < end && at > 0; ++w) {
        before[w] = static_cast<Index>(before[w] + at);
      }
      if (part.rank() == 0) { s.totals[row] = total; }
    }
    g.sync();
  }

  /// The list after `whole` rounds that split every node: the nodes made in the last, then the
  /// nodes of one point made in the one before, and so on; those made in one round in order of
  /// their codes, descending for odd rounds. Returns how many were made in the last.
  template <typename Group, typename Index>
  FT_HOST_DEVICE static int list_nodes(Group g, scratch& s, tree<Index>& t, shape const& level,
                                       int whole) {
    int const* const totals = s.totals;
    int const* const alone = totals + level.rows;
    int const size = totals[level.row_of(whole)];
    int const alone_before = alone[level.row_of(whole - 1)];
    int const children = size - alone_before;
    if (g.rank() == 0) { s.candidates = 0; }
    for (int i = g.rank(); i < size; i += g.size()) {
      int const begin = t.select(level.row_of(whole), i);
      int const end = t.bit_above(level.row_of(whole), begin);
      int const round =
          end - begin == 1 ? min_of(max_of(t.depth_at(begin), t.depth_at(end)), whole) : whole;
      int first = 0;
      int count = children;
      int rank = i - t.rank(level.rows + level.row_of(whole - 1), begin);
      if (round < whole) {
        int const up_to = alone[round];
        int const sooner = round > 0 ? alone[round - 1] : 0;
        first = children + alone_before - up_to;
        count = up_to - sooner;
        rank = t.rank(level.rows + round, begin) -
               (round > 0 ? t.rank(level.rows + round - 1, begin) : 0);
      }
      t.list[first + (round % 2 == 0 ? rank : count - 1 - rank)] = {static_cast<Index>(begin),
                                                                    static_cast<Index>(end)};
    }
    g.sync();
    return children;
  }

  /// Children of a node, at `row`'s depth.
  template <typename Index>
  FT_HOST_DEVICE static int children_of(tree<Index> const& t, node_range<Index> node, int row,
                                        int total) {
    int const end = node.end < t.n ? t.rank(row, node.end) : total;
    return end - t.rank(row, node.begin);
  }

  /// The key of a node for the order in which nodes are split, ascending: 26 bits of points and 14
  /// of its left edge, both inverted, 22 of `place`, which decides among equals, 2 of gain.
  template <typename Index>
  FT_HOST_DEVICE static unsigned long long split_key(tree<Index> const& t, shape const& level,
                                                     int depth, int heads, node_range<Index> node,
                                                     int place) {
    auto const count = static_cast<unsigned>(node.end - node.begin);
    int const edge = level.left_edge(t.points[t.index_at(node.begin)].x, depth - 1);
    return static_cast<unsigned long long>(0x3ffffffu - count) << 38 |
           static_cast<unsigned long long>(0x3fffu - static_cast<unsigned>(edge)) << key_place_end |
           static_cast<unsigned long long>(place) << 2 |
           static_cast<unsigned long long>(children_of(t, node, level.row_of(depth), heads) - 1);
  }
  static constexpr int key_place_end = 24;

  /// Fills the keys of the first `children` nodes of the list, each at its node's index, which is
  /// its place: a node made later is nearer to the front. Nodes of one point come last.
  template <typename Group, typename Index>
  FT_HOST_DEVICE static void make_stable_keys(Group g, tree<Index>& t, shape const& level,
                                              int depth, int heads, int children) {
    for (int i = g.rank(); i < children; i += g.size()) {
      node_range<Index> const node = t.list[i];
      unsigned long long key = ~0ull << key_place_end | static_cast<unsigned long long>(i) << 2;
      if (node.end - node.begin > 1) { key = split_key(t, level, depth, heads, node, i); }
      t.node_keys[i] = key;
      t.splits_before[i] = 0;
      t.gain_before[i] = 0;
    }
  }

  /// The same for nodes of more than one point alone, in the order in which introsort leaves them,
  /// from the last; `next[k].begin` is the index of the node that has key k.
  template <typename Group, typename Index>
  FT_HOST_DEVICE static void make_std_sort_keys(Group g, scratch& s, tree<Index>& t,
                                                shape const& level, int depth, int heads,
                                                int children) {
    int n = 0;
    for (int base = 0; base < children; base += g.size()) {
      int const i = base + g.rank();
      node_range<Index> node{0, 0};
      if (i < children) { node = t.list[i]; }
      int more = 0;
      int const at = n + g.exclusive_count(node.end - node.begin > 1, more);
      if (node.end - node.begin > 1) {
        t.node_keys[at] = split_key(t, level, depth, heads, node, i);
      }
      n += more;
    }
    detail::introsort_partitions(g, detail::reversed_array<unsigned long long>{t.node_keys, n}, n,
                                 by_points_and_edge{key_place_end},
                                 detail::introsort_workspace<node_range<Index>, int>{
                                     t.next, t.splits_before, t.gain_before, s.open});
    g.sync();
    for (int i = g.rank(); i < children; i += g.size()) {
      t.splits_before[i] = 0;
      t.gain_before[i] = 0;
    }
    constexpr unsigned long long places = (1ull << key_place_end) - 4;
    for (int k = g.rank(); k < n; k += g.size()) {
      unsigned long long const key = t.node_keys[k];
      t.next[k].begin = static_cast<Index>((key & places) >> 2);
      t.node_keys[k] = (key & ~places) | static_cast<unsigned long long>(k) << 2;
    }
  }

  /// Ascending by points, then by the left edge: what a key inverts is above `shift` bits.
  struct by_points_and_edge {
    int shift;
    template <typename Key>
    FT_HOST_DEVICE bool operator()(Key a, Key b) const {
      return a >> shift > b >> shift;
    }
  };

  /// Index of the node that has key k, where keys were sorted by their place k.
  template <tie_rule Ties, typename Index>
  FT_HOST_DEVICE static int node_of_key(tree<Index> const& t, int k) {
    return Ties == tie_rule::stable ? k : static_cast<int>(t.next[k].begin);
  }

  /// Node by node: of the nodes made last (the first `children` of the list) those with more than
  /// one point, the fullest first, among equals the one furthest right, among these by the tie
  /// rule; as many as it takes to reach `wanted` nodes. Returns the new size of the list;
  /// `children` gets the number of nodes made.
  template <tie_rule Ties, typename Group, typename Index>
  FT_HOST_DEVICE static int split_one_by_one(Group g, scratch& s, tree<Index>& t,
                                             shape const& level, int depth, int& children, int size,
                                             int wanted) {
    int const row = level.row_of(depth);
    int const heads = s.totals[row];
    int const multiple = size - s.totals[level.rows + level.row_of(depth - 1)];
    int keys = children;
    if constexpr (Ties == tie_rule::stable) {
      make_stable_keys(g, t, level, depth, heads, children);
    } else {
      make_std_sort_keys(g, s, t, level, depth, heads, children);
      keys = multiple;
    }
    if (g.rank() == 0) { s.made = 0; }
    g.sync();
    if (g.size() > 1 && keys <= ranked_nodes) {
      rank_splits<Ties>(g, t, keys);
    } else {
      sort_splits<Ties>(g, t, keys);
    }
    g.sync();

    // The last node to be split knows how many are made.
    for (int i = g.rank(); i < children; i += g.size()) {
      if (!is_split(t, i, children, size, wanted)) { continue; }
      int const made = children_of(t, t.list[i], row, heads);
      int const gained = t.gain_before[i] + made - 1;
      if (size + gained >= wanted || t.splits_before[i] + 1 == multiple) {
        s.made = t.splits_before[i] + 1 + gained;
      }
    }
    int stayed = 0;
    int made = 0;
    for (int base = 0; base < size; base += g.size()) {
      int const i = base + g.rank();
      bool const splits = is_split(t, i, children, size, wanted);
      bool const stays = i < size && !splits;
      int total = 0;
      int const rank = g.exclusive_scan(static_cast<int>(stays), total);
      made = s.made;
      if (stays) { t.next[made + stayed + rank] = t.list[i]; }
      if (splits) {
        node_range<Index> const node = t.list[i];
        write_children(t, t.next, node, row, depth, children_of(t, node, row, heads),
                       made - 1 - t.splits_before[i] - t.gain_before[i]);
      }
      stayed += total;
    }
    if (g.rank() == 0) { s.candidates = 0; }
    g.sync();
    node_range<Index>* const swap = t.list;
    t.list = t.next;
    t.next = swap;
    children = made;
    return made + stayed;
  }

  /// Keys of 32 bits, from above: points, left edge, place, gain. In a level of 16384 columns they
  /// have place for 127 points, in one of 1024 for 2047.
  static constexpr int gain_bits = 2;
  static constexpr int place_bits = 9;
  static constexpr int large_node = 1 << 16;
  static_assert(scratch_nodes <= 1 << place_bits, "places of nodes");

  /// The same for lists of up to a node a thread, which keeps it in registers; only nodes that can
  /// be split are compared. Returns false, and has changed nothing, where nodes are too many or a
  /// key has no place for the points of one.
  template <tie_rule Ties, typename Group, typename Index>
  FT_HOST_DEVICE static bool split_together(Group g, scratch& s, tree<Index>& t, shape const& level,
                                            int depth, int& children, int& size, int wanted) {
    if (g.size() == 1 || size > min_of(g.size(), scratch_nodes)) { return false; }
    auto const part = g.part();
    unsigned* const keys = s.b.packed.keys;
    int* const before = s.b.packed.before;
    int const row = level.row_of(depth);
    int const candidates = size - s.totals[level.rows + level.row_of(depth - 1)];
    int edge_bits = 1;
    while (1 << edge_bits < level.width) { ++edge_bits; }
    int const count_shift = gain_bits + place_bits + edge_bits;
    unsigned const most_points = ~0u >> count_shift;

    int const i = g.rank();
    node_range<Index> node{0, 0};
    if (i < size) { node = t.list[i]; }
    auto const points = static_cast<unsigned>(node.end - node.begin);
    bool const candidate = i < children && points > 1;
    int count = 0;
    unsigned key = 0;
    if (candidate) {
      count = children_of(t, node, row, s.totals[row]);
      int const edge = level.left_edge(t.points[t.index_at(node.begin)].x, depth - 1);
      key = (most_points - min_of(points, most_points)) << count_shift |
            static_cast<unsigned>((1 << edge_bits) - 1 - edge) << (gain_bits + place_bits) |
            static_cast<unsigned>(i) << gain_bits | static_cast<unsigned>(count - 1);
    }
    // Keys have their nodes' places: they may lie in any order.
    int of_part = 0;
    int const in_part = part.exclusive_count(candidate, of_part);
    int const large = part.any(candidate && points > most_points) ? large_node : 0;
    int first = 0;
    if (part.rank() == 0 && of_part > 0) { first = atomic_add(&s.candidates, of_part + large); }
    first = part.shuffle(first, 0) & (large_node - 1);
    int at = first + in_part;
    if constexpr (Ties == tie_rule::std_sort) {  // in their nodes' order
      int all = 0;
      at = g.exclusive_count(candidate, all);
    }
    if (candidate) { keys[at] = key; }
    if (i >= candidates && i < ceil_div(candidates, 4) * 4) { keys[i] = ~0u; }
    if (i < size) { before[i] = 0; }
    if (i == 0) { s.made = 0; }
    g.sync();
    if (s.candidates >= large_node) { return false; }
    int place = i;
    if constexpr (Ties == tie_rule::std_sort) {
      place_as_std_sort(g, s, t, candidates);
      if (candidate) { place = s.b.packed.left[i]; }
    }
    rank_packed(g, s, candidates);
    g.sync();

    // The last node to be split knows how many are made.
    int const splits_before = i < size ? before[place] >> 16 : 0;
    int const gain_before = i < size ? before[place] & 0xffff : 0;
    bool const splits = candidate && size + gain_before < wanted;
    if (splits) {
      int const gained = gain_before + count - 1;
      if (size + gained >= wanted || splits_before + 1 == candidates) {
        s.made = splits_before + 1 + gained;
      }
    }
    bool const stays = i < size && !splits;
    int stayed = 0;
    int const rank = g.exclusive_count(stays, stayed);
    int const made = s.made;
    if (stays) { t.list[made + rank] = node; }
    if (splits) {
      write_children(t, t.list, node, row, depth, count, made - 1 - splits_before - gain_before);
    }
    if (i == 0) { s.candidates = 0; }
    g.sync();
    children = made;
    size = made + stayed;
    return true;
  }

  /// Puts the packed keys of nodes, which are in the nodes' order, in the order in which introsort
  /// leaves them, from the last, with their indices as places; `left[i]` gets the place of node i.
  template <typename Group, typename Index>
  FT_HOST_DEVICE static void place_as_std_sort(Group g, scratch& s, tree<Index> const& t, int n) {
    auto& packed = s.b.packed;
    detail::introsort_partitions(g, detail::reversed_array<unsigned>{packed.keys, n}, n,
                                 by_points_and_edge{gain_bits + place_bits},
                                 detail::introsort_workspace<node_range<Index>, std::uint16_t>{
                                     t.next, packed.left, packed.right, s.open});
    g.sync();
    constexpr unsigned places = ((1u << place_bits) - 1) << gain_bits;
    for (int k = g.rank(); k < n; k += g.size()) {
      unsigned const key = packed.keys[k];
      packed.left[(key & places) >> gain_bits] = static_cast<std::uint16_t>(k);
      packed.keys[k] = (key & ~places) | static_cast<unsigned>(k) << gain_bits;
    }
    g.sync();
  }

  /// What comes before each node: splits, and in the lower half gain. A warp takes 32 nodes and a
  /// part of the keys.
  template <typename Group>
  FT_HOST_DEVICE static void rank_packed(Group g, scratch& s, int n) {
    struct alignas(16) quad {
      unsigned of[4];
    };
    if (n == 0) { return; }
    auto const part = g.part();
    auto const* const quads = reinterpret_cast<quad const*>(s.b.packed.keys);
    int const all = ceil_div(n, 4);
    int const rows = ceil_div(n, 32);
    int const columns = max_of(g.parts() / rows, 1);
    int const each = ceil_div(all, columns);
    for (int tile = g.part_index(); tile < rows * columns; tile += g.parts()) {
      int const row = tile / columns;
      int const from = (tile - row * columns) * each;
      int const to = min_of(from + each, all);
      for (int k = 32 * row + part.rank(); k < min_of(32 * row + 32, n); k += part.size()) {
        unsigned const key = s.b.packed.keys[k];
        unsigned sum = 0;
        for (int j = from; j < to; ++j) {
          quad const q = quads[j];
          FT_UNROLL
          for (unsigned const other : q.of) {
            sum += other < key ? (other & ((1u << gain_bits) - 1)) | 1u << 16 : 0u;
          }
        }
        atomic_add(s.b.packed.before + (key >> gain_bits & ((1u << place_bits) - 1)),
                   static_cast<int>(sum));
      }
    }
  }

  /// The nodes that one is split into, the last made first, which goes to place `last - (count -
  /// 1)`. The order of creation is that of the quadrants, which the codes of even depths invert.
  template <typename Index>
  FT_HOST_DEVICE static void write_children(tree<Index> const& t, node_range<Index>* list,
                                            node_range<Index> node, int row, int depth, int count,
                                            int last) {
    int begin = node.begin;
    for (int c = 0; c < count; ++c) {
      int const end = c + 1 == count ? static_cast<int>(node.end) : t.bit_above(row, begin);
      int const creation = depth % 2 == 0 ? count - 1 - c : c;
      list[last - creation] = {static_cast<Index>(begin), static_cast<Index>(end)};
      begin = end;
    }
  }

  template <typename Index>
  FT_HOST_DEVICE static bool is_split(tree<Index> const& t, int i, int children, int size,
                                      int wanted) {
    return i < children && t.list[i].end - t.list[i].begin > 1 && size + t.gain_before[i] < wanted;
  }

  /// What comes before each node, by comparing all keys: a warp takes 32 nodes and 16 keys at a
  /// time.
  template <tie_rule Ties, typename Group, typename Index>
  FT_HOST_DEVICE static void rank_splits(Group g, tree<Index>& t, int n) {
    constexpr int keys = 16;
    auto const part = g.part();
    int const columns = ceil_div(n, keys);
    int const tiles = columns * ceil_div(n, 32);
    for (int tile = g.part_index(); tile < tiles; tile += g.parts()) {
      int const row = tile / columns;
      int const first = (tile - row * columns) * keys;
      int const end = min_of(first + keys, n);
      for (int k = part.rank(); k < 32; k += part.size()) {
        int const i = 32 * row + k;
        if (i >= n) { break; }
        unsigned long long const key = t.node_keys[i];
        int splits = 0;
        int gain = 0;
        for (int j = first; j < end; ++j) {
          unsigned long long const other = t.node_keys[j];
          if (other < key) {
            ++splits;
            gain += static_cast<int>(other & 3);
          }
        }
        int const node = node_of_key<Ties>(t, i);
        atomic_add(t.splits_before + node, splits);
        atomic_add(t.gain_before + node, gain);
      }
    }
  }

  /// The same by sorting.
  template <tie_rule Ties, typename Group, typename Index>
  FT_HOST_DEVICE static void sort_splits(Group g, tree<Index>& t, int n) {
    g.sort(t.node_keys, n);
    int gained = 0;
    for (int base = 0; base < n; base += g.size()) {
      int const i = base + g.rank();
      unsigned long long const key = i < n ? t.node_keys[i] : 0;
      int total = 0;
      int const before = g.exclusive_scan(static_cast<int>(key & 3), total);
      if (i < n) {
        int const node = node_of_key<Ties>(t, static_cast<int>(key >> 2 & 0x3fffff));
        t.splits_before[node] = i;
        t.gain_before[node] = gained + before;
      }
      gained += total;
    }
  }

  /// Each node yields its strongest point, the first of equals.
  template <typename Group, typename Index>
  FT_HOST_DEVICE static void keep_strongest(Group g, tree<Index> const& t, int size, corner* kept) {
    constexpr int most = 4;
    constexpr int batch = Group::max_threads == 1 ? 1 : 4;
    int const lanes = g.lanes(most);
    int const lane = g.rank() % lanes;
    for (int base = 0; base < size; base += g.size() / lanes) {
      int const i = base + g.rank() / lanes;
      unsigned long long mine = 0;
      int strongest = 0;
      if (i < size) {
        node_range<Index> const node = t.list[i];
        // Some loads are under way at a time; the last point may be looked at again.
        for (int first = node.begin + lane; first < node.end; first += batch * lanes) {
          int index[batch];
          unsigned long long strength[batch];
          FT_UNROLL
          for (int k = 0; k < batch; ++k) {
            index[k] = t.index_at(min_of(first + k * lanes, node.end - 1));
          }
          FT_UNROLL
          for (int k = 0; k < batch; ++k) { strength[k] = t.strength(index[k]); }
          FT_UNROLL
          for (int k = 0; k < batch; ++k) {
            if (strength[k] > mine) {
              mine = strength[k];
              strongest = index[k];
            }
          }
        }
      }
      unsigned long long const best = g.template reduce_lanes<most>(mine, max_op{});
      if (i < size && mine == best) { kept[i] = t.point(strongest); }
    }
  }
};

/// The same for a block that has a multiprocessor to itself, and all of its registers.
struct distribute_level_alone : distribute_level {
  static constexpr int resident_blocks = 1;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, corners_view const& corners,
                                 distribution_view const& v) const {
    distribute<8, tie_rule::stable>(g, s, item, corners, v);
  }
};

/// As distribute_level, by the tie rule std_sort.
struct distribute_level_as_std_sort : distribute_level {
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, corners_view const& corners,
                                 distribution_view const& v) const {
    distribute<0, tie_rule::std_sort>(g, s, item, corners, v);
  }
};

/// As distribute_level_alone, by the tie rule std_sort.
struct distribute_level_alone_as_std_sort : distribute_level_alone {
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, corners_view const& corners,
                                 distribution_view const& v) const {
    distribute<8, tie_rule::std_sort>(g, s, item, corners, v);
  }
};

/// Distributes with as much block scratch as `op` asks for; see distribute_corners().
template <typename Exec>
void distribute_corners(Exec const& exec, distribute_level const& op, corners_view const& corners,
                        distribution_view const& out, tie_rule ties) {
  using shape = per_block<distribute_level::threads>;
  int const items = out.batch * out.layout.levels;
  bool const by_std_sort = ties == tie_rule::std_sort;
  distribute_level_alone const alone{op};
  if (op.has_more_bins() && by_std_sort) {
    for_each_item<shape>(exec, items, distribute_level_alone_as_std_sort{alone}, corners, out);
  } else if (op.has_more_bins()) {
    for_each_item<shape>(exec, items, alone, corners, out);
  } else if (by_std_sort) {
    for_each_item<shape>(exec, items, distribute_level_as_std_sort{op}, corners, out);
  } else {
    for_each_item<shape>(exec, items, op, corners, out);
  }
}

/// Thins the corners of every level of every image to about the wanted number. Asynchronous on
/// `exec`; allocates nothing; one launch. @pre corners lie within their level's work area
/// @param entered from enter_corners(), whose entries it takes out again, not from the ordered
/// lists: the same in the end
template <typename Exec>
void distribute_corners(Exec const& exec, corners_view const& corners, distribution_view const& out,
                        bool entered = false, tie_rule ties = tie_rule::stable) {
  int const items = out.batch * out.layout.levels;
  auto const op = distribute_level::with_scratch(
      extra_scratch<distribute_level::threads, distribute_level>(exec, items), entered);
  distribute_corners(exec, op, corners, out, ties);
}

}  // namespace FT_ABI
}  // namespace ft
