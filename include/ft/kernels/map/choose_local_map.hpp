// SPDX-License-Identifier: Apache-2.0
/// @file Stage: chooses the local map, the map points that a frame probably sees.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/map/detail/slot_rows.hpp"
#include "ft/kernels/map/point_masks.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument naming the value and the limit
inline void check(local_map_params const& p) {
  detail::require_range("keyframes of a local map", p.keyframes, 1, 64);
  detail::require_range("neighbours of a local map", p.neighbours, 0, 32);
}

/// Which keyframes a local map is made of.
enum class local_map_mode : int {
  by_votes = 0,  ///< those that share points with the frame
  newest = 1,    ///< the newest ones: the camera is being recovered
  given = 2,     ///< those that the caller gives votes
};

/// Inputs of choose_local_map, apart from the map.
struct local_map_input {
  frame_view frame;                      ///< its counts and holders are read
  local_map_mode const* mode = nullptr;  ///< [batch]
  local_map_params params;
  int const* votes = nullptr;  ///< [batch][max_keyframes] by position, of the mode `given`; or null
};

/// A local map of each batch entry, the output of choose_local_map.
struct local_map_view {
  int capacity = 0;         ///< points of a local map
  int* slots = nullptr;     ///< [batch][capacity] ascending
  int* count = nullptr;     ///< [batch]
  int* left_out = nullptr;  ///< [batch] points for which there was no room
};

namespace detail {

/// Ranks that keyframes of a local map can have: the newest one, those with votes, neighbours.
inline constexpr int local_map_ranks = 1 + 64 + 32;
/// Slots of a chunk, which a block ranks and lists.
inline constexpr int local_map_chunk = 4096;

}  // namespace detail

struct local_map_workspace {
  int chunks = 0;                 ///< of detail::local_map_chunk slots
  unsigned char* rank = nullptr;  ///< [batch][slots] the first rank of a point's keyframes
  int* points = nullptr;          ///< [batch][chunks][ranks] points of a rank
};

/// Places the arrays into an arena.
inline void carve(carver& c, local_map_workspace& v, int slots, int batch) {
  v.chunks = ceil_div(slots, detail::local_map_chunk);
  c.place({batch, slots}, v.rank);
  c.place({batch, v.chunks, detail::local_map_ranks}, v.points);
}

namespace detail {

/// A chunk of a batch entry's slots.
struct slot_chunk {
  int b, number, used;

  FT_HOST_DEVICE slot_chunk(int item, local_map_workspace const& work,
                            point_records_view const& records)
      : b(item / work.chunks), number(item % work.chunks), used(records.used[b]) {}
  FT_HOST_DEVICE int begin() const { return number * local_map_chunk; }
  FT_HOST_DEVICE int end() const { return min_of(begin() + local_map_chunk, used); }
  /// The first chunk always has work: it writes the counts.
  FT_HOST_DEVICE bool has_work() const { return number == 0 || begin() < used; }
  /// Chunks of this batch entry with slots in use.
  FT_HOST_DEVICE int chunks() const { return ceil_div(used, local_map_chunk); }
  /// Where the points of the ranks of a chunk are counted.
  FT_HOST_DEVICE int* points(local_map_workspace const& work, int chunk) const {
    return work.points + (static_cast<std::ptrdiff_t>(b) * work.chunks + chunk) * local_map_ranks;
  }
};

/// Item: a chunk of a batch entry. Ranks keyframes, and the chunk's points by them. The votes are
/// counted for each chunk anew, which takes less time than another launch.
struct rank_local_points {
  struct scratch {
    int votes[max_keyframes];
    int recent[max_keyframes];  ///< votes by age, newest keyframe first
    int ranked[64];             ///< numbers of the keyframes with most votes, best first
    int rank[max_keyframes];    ///< first place in the order of the keyframe at a position
    unsigned admitted[2 * mask_words];
    int points[local_map_ranks];  ///< points whose first keyframe has a rank
  };
  static constexpr int unranked = local_map_ranks;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, local_map_input const& in,
                                 odometry_map_view const& map,
                                 local_map_workspace const& work) const {
    slot_chunk const chunk(item, work, map.records);
    if (!chunk.has_work()) { return; }
    for (int p = g.rank(); p < max_keyframes; p += g.size()) {
      s.votes[p] = 0;
      s.rank[p] = unranked;
    }
    for (int i = g.rank(); i < local_map_ranks; i += g.size()) { s.points[i] = 0; }
    for (int i = g.rank(); i < 64; i += g.size()) { s.ranked[i] = 0; }
    g.sync();
    local_map_mode const mode = in.mode[chunk.b];
    bool const by_votes = mode != local_map_mode::newest;
    if (mode == local_map_mode::by_votes) { vote(g, s, chunk.b, in.frame, map.records); }
    if (mode == local_map_mode::given) {
      for (int p = g.rank(); p < max_keyframes; p += g.size()) {
        s.votes[p] = in.votes[chunk.b * max_keyframes + p];
      }
    }
    g.sync();
    choose_ranked(g, s, chunk.b, in.params, by_votes, map.keyframes);
    admit(g, s, chunk.b, in.params, by_votes, map.keyframes);
    rank_points(g, s, chunk, map.records, work);
    g.sync();
    int* const points = chunk.points(work, chunk.number);
    for (int i = g.rank(); i < local_map_ranks; i += g.size()) { points[i] = s.points[i]; }
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void vote(Group g, scratch& s, int b, frame_view const& frame,
                                  point_records_view const& records) {
    auto const part = g.part();
    int const numbers = frame.numbers();
    int const* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * numbers;
    for (int first = g.part_index() * part.size(); first < numbers; first += g.size()) {
      int const n = min_of(first + part.rank(), numbers - 1);
      int const c = n / frame.capacity();
      int const slot = holder[n];
      bool const is_keypoint =
          first + part.rank() < numbers && n - c * frame.capacity() < *frame.camera(b, c).count;
      bool const there = is_keypoint && slot >= 0 && slot < records.slots;
      add_votes(part, s.votes, there ? records.mask(b, slot) : nullptr, records.words);
    }
  }

  /// Lists the keyframes with most votes, or the newest ones.
  template <typename Group>
  FT_HOST_DEVICE static void choose_ranked(Group g, scratch& s, int b,
                                           local_map_params const& params, bool by_votes,
                                           keyframes_view const& keyframes) {
    int const made = keyframes.made[b];
    int const count = keyframes.count[b];
    for (int age = g.rank(); age < count; age += g.size()) {
      s.recent[age] = s.votes[keyframes.position(made - age)];
    }
    g.sync();
    constexpr int most_lanes = 8;  // that share a keyframe's comparisons
    int const lanes = g.lanes(most_lanes);
    for (int first = 0; first < count; first += g.size() / lanes) {
      int const age = first + g.rank() / lanes;
      int const mine = age < count ? s.recent[age] : 0;
      int better = 0;
      for (int other = g.rank() % lanes; by_votes && other < count; other += lanes) {
        int const theirs = s.recent[other];
        better += static_cast<int>(theirs > mine || (theirs == mine && other < age));
      }
      better = g.template reduce_lanes<most_lanes>(better, sum_op{});
      int const rank = by_votes ? better : age;
      bool const is = age < count && (mine > 0 || !by_votes) && rank < params.keyframes;
      if (is && g.rank() % lanes == 0) { s.ranked[rank] = made - age; }
    }
    g.sync();
  }

  /// Gives the keyframes of the local map their ranks.
  template <typename Group>
  FT_HOST_DEVICE static void admit(Group g, scratch& s, int b, local_map_params const& params,
                                   bool by_votes, keyframes_view const& keyframes) {
    for (int i = g.rank(); i < params.keyframes; i += g.size()) {
      int const number = s.ranked[i];
      if (i == 0 && keyframes.count[b] > 0) {
        atomic_min(s.rank + keyframes.position(keyframes.made[b]), 0);
      }
      if (number == 0) { continue; }
      int const position = keyframes.position(number);
      atomic_min(s.rank + position, 1 + i);
      int const neighbour = keyframes.neighbour[keyframes.at(b, position)];
      if (by_votes && i < params.neighbours && neighbour != 0 && keyframes.holds(b, neighbour)) {
        atomic_min(s.rank + keyframes.position(neighbour), 1 + params.keyframes + i);
      }
    }
    g.sync();
    auto const part = g.part();
    for (int w = g.part_index(); w < 2 * mask_words; w += g.parts()) {
      unsigned const bits =
          row_of_flags(part, [&](int i) { return s.rank[32 * w + i] != unranked; });
      if (part.rank() == 0) { s.admitted[w] = bits; }
    }
    g.sync();
  }

  template <typename Group>
  FT_HOST_DEVICE static void rank_points(Group g, scratch& s, slot_chunk const& chunk,
                                         point_records_view const& records,
                                         local_map_workspace const& work) {
    position_set admitted;
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) {
      admitted.words[w] =
          static_cast<std::uint64_t>(s.admitted[2 * w + 1]) << 32 | s.admitted[2 * w];
    }
    each_slot(
        g, chunk.begin(), chunk.end(),
        [&](int slot) { return position_set::of(records.mask(chunk.b, slot), records.words); },
        [&](int slot, position_set const& seen) {
          int first = unranked;
          FT_UNROLL
          for (int w = 0; w < mask_words; ++w) {
            for (std::uint64_t rest = seen.words[w] & admitted.words[w]; rest != 0;
                 rest &= rest - 1) {
              first = min_of(first, s.rank[64 * w + trailing_zeros(rest)]);
            }
          }
          work.rank[records.at(chunk.b, slot)] = static_cast<unsigned char>(first);
          if (first != unranked) { atomic_add(s.points + first, 1); }
        });
  }
};

/// Item: a chunk of a batch entry. Lists its chosen points. After rank_local_points.
struct list_local_points {
  struct scratch {
    int points[local_map_ranks];  ///< of all chunks
    int before[local_map_ranks];  ///< of the chunks before this one
    int last_rank, quota;  ///< points of this rank are taken up to the quota, of later ones not
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, point_records_view const& records,
                                 local_map_view const& out, local_map_workspace const& work) const {
    slot_chunk const chunk(item, work, records);
    if (!chunk.has_work()) { return; }
    int const found = count_points(g, s, chunk, work);
    find_limit(g, s, out.capacity);
    int kept = 0;
    for (int r = g.rank(); r < s.last_rank; r += g.size()) { kept += s.before[r]; }
    kept = g.reduce(kept, sum_op{});
    int const ties = s.last_rank < local_map_ranks ? s.before[s.last_rank] : 0;
    list(g, s, chunk, {kept, ties}, work.rank + records.at(chunk.b, 0),
         out.slots + static_cast<std::ptrdiff_t>(chunk.b) * out.capacity);
    if (chunk.number == 0 && g.rank() == 0) {
      out.count[chunk.b] = min_of(found, out.capacity);
      out.left_out[chunk.b] = max_of(found - out.capacity, 0);
    }
  }

private:
  struct counts {
    int kept;  ///< points of ranks before the last one
    int ties;  ///< points of the last rank
  };

  /// @return points of all ranks
  template <typename Group>
  FT_HOST_DEVICE static int count_points(Group g, scratch& s, slot_chunk const& chunk,
                                         local_map_workspace const& work) {
    int found = 0;
    for (int r = g.rank(); r < local_map_ranks; r += g.size()) {
      int all = 0;
      int before = 0;
      for (int c = 0; c < chunk.chunks(); ++c) {
        int const n = chunk.points(work, c)[r];
        all += n;
        before += c < chunk.number ? n : 0;
      }
      s.points[r] = all;
      s.before[r] = before;
      found += all;
    }
    if (g.rank() == 0) {
      s.last_rank = local_map_ranks;
      s.quota = 0;
    }
    found = g.reduce(found, sum_op{});
    g.sync();
    return found;
  }

  /// Finds the rank at which the capacity is exceeded.
  template <typename Group>
  FT_HOST_DEVICE static void find_limit(Group g, scratch& s, int capacity) {
    for (int r = g.rank(); r < local_map_ranks; r += g.size()) {
      int lower = 0;
      for (int q = 0; q < r; ++q) { lower += s.points[q]; }
      if (lower <= capacity && capacity < lower + s.points[r]) {
        s.last_rank = r;
        s.quota = capacity - lower;
      }
    }
    g.sync();
  }

  /// @param before of the chunks before this one
  template <typename Group>
  FT_HOST_DEVICE static void list(Group g, scratch const& s, slot_chunk const& chunk, counts before,
                                  unsigned char const* rank, int* slots) {
    if constexpr (Group::max_threads == 1) {
      int n = before.kept + min_of(before.ties, s.quota);
      for (int slot = chunk.begin(); slot < chunk.end(); ++slot) {
        bool const tie = rank[slot] == s.last_rank;
        if (rank[slot] < s.last_rank || (tie && before.ties < s.quota)) { slots[n++] = slot; }
        before.ties += static_cast<int>(tie);
      }
    } else {
      auto const part = g.part();
      constexpr int rows = local_map_chunk / 32 / Group::parts();  // of a warp
      int const first = chunk.begin() + 32 * rows * g.part_index() + part.rank();
      unsigned lower[rows], ties[rows];
      FT_UNROLL
      for (int r = 0; r < rows; ++r) {
        int const slot = first + 32 * r;
        int const mine = slot < chunk.end() ? rank[slot] : local_map_ranks;
        lower[r] = part.ballot(mine < s.last_rank);
        ties[r] = part.ballot(mine == s.last_rank);
      }
      counts of_warp{0, 0};
      FT_UNROLL
      for (int r = 0; r < rows; ++r) {
        of_warp.kept += popcount(lower[r]);
        of_warp.ties += popcount(ties[r]);
      }
      // Both counts in one scan.
      int all = 0;
      int const packed = part.rank() == 0 ? of_warp.kept | of_warp.ties << 16 : 0;
      int const scanned = part.shuffle(g.exclusive_scan(packed, all), 0);
      before.kept += scanned & 0xffff;
      before.ties += scanned >> 16;
      unsigned const below = (1u << part.rank()) - 1;
      FT_UNROLL
      for (int r = 0; r < rows; ++r) {
        int const nth = before.ties + popcount(ties[r] & below);
        bool const is_lower = (lower[r] >> part.rank() & 1) != 0;
        bool const is_tie = (ties[r] >> part.rank() & 1) != 0;
        if (is_lower || (is_tie && nth < s.quota)) {
          slots[before.kept + popcount(lower[r] & below) + min_of(nth, s.quota)] = first + 32 * r;
        }
        before.kept += popcount(lower[r]);
        before.ties += popcount(ties[r]);
      }
    }
  }
};

}  // namespace detail

/// Chooses the points that the search in the local map looks for.
///
/// Each keypoint that holds a point votes for the keyframes that see the point. Keyframes are
/// taken in this order: the newest one; those with votes, most votes first, newer ones first among
/// equals, at most `params.keyframes`; the neighbours of the first `params.neighbours` of these. In
/// the mode `newest`: the newest `params.keyframes`. In the mode `given` the votes are the
/// caller's. Each point that one of them sees is chosen
/// once. If there are more than `out.capacity`, points of earlier keyframes are preferred, then
/// lower slots, and the others are counted in `out.left_out`.
///
/// Asynchronous on `exec`; allocates nothing; two launches.
/// @throws bad_argument for parameters out of range
template <typename Exec>
void choose_local_map(Exec const& exec, local_map_input const& in, odometry_map_view const& map,
                      local_map_view const& out, local_map_workspace const& work) {
  check(in.params);
  int const items = in.frame.batch * work.chunks;
  for_each_item<per_block<1024>>(exec, items, detail::rank_local_points{}, in, map, work);
  for_each_item<per_block<1024>>(exec, items, detail::list_local_points{}, map.records, out, work);
}

}  // namespace FT_ABI
}  // namespace ft
