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
#include "ft/kernels/map/point_masks.hpp"

namespace ft {
inline namespace FT_ABI {

struct local_map_params {
  int keyframes = 30;   ///< with most votes, 1 to 64
  int neighbours = 10;  ///< of these the best ones whose neighbours are added, 0 to 32
};

/// Which keyframes a local map is made of.
enum class local_map_mode : int {
  by_votes = 0,  ///< those that share points with the frame
  newest = 1,    ///< the newest ones: the camera is being recovered
};

/// Inputs of choose_local_map, apart from the map.
struct local_map_input {
  frame_view frame;                      ///< its counts and holders are read
  local_map_mode const* mode = nullptr;  ///< [batch]
  local_map_params params;
};

/// A local map of each batch entry, the output of choose_local_map.
struct local_map_view {
  int capacity = 0;         ///< points of a local map
  int* slots = nullptr;     ///< [batch][capacity] ascending
  int* count = nullptr;     ///< [batch]
  int* left_out = nullptr;  ///< [batch] points for which there was no room
};

struct local_map_workspace {
  unsigned* chosen = nullptr;  ///< [batch][2][rows] a bit for each slot
  int rows = 0;                ///< words of 32 slots
};

/// Places the arrays into an arena.
inline void carve(carver& c, local_map_workspace& v, int slots, int batch) {
  v.rows = (slots + 31) / 32;
  v.chosen = c.take<unsigned>(
      2 * detail::checked_mul(static_cast<std::size_t>(batch), static_cast<std::size_t>(v.rows)));
}

namespace detail {

/// Ranks that keyframes of a local map can have: the newest one, those with votes, neighbours.
inline constexpr int local_map_ranks = 1 + 64 + 32;

struct local_map_scratch {
  int votes[max_keyframes];
  int ranked[64];           ///< numbers of the keyframes with most votes, best first
  int rank[max_keyframes];  ///< first place in the order of the keyframe at a position
  unsigned long long admitted[mask_words];
  int points[local_map_ranks];  ///< points whose first keyframe has a rank
  int last_rank, quota;  ///< points of this rank are taken up to the quota, of later ones not
};

/// Rows of 32 slots, a bit for each slot that fulfils a condition. Each warp has consecutive rows.
template <typename Group>
class slot_rows {
public:
  /// @param used slots to consider
  FT_HOST_DEVICE slot_rows(Group g, int used) : g_(g), used_(used) {
    int const rows = ceil_div(used, 32);
    int const each = ceil_div(rows, g.parts());
    first_ = min_of(g.part_index() * each, rows);
    end_ = min_of(first_ + each, rows);
  }

  /// Writes the rows of condition(slot).
  template <typename Condition>
  FT_HOST_DEVICE void write(unsigned* rows, Condition const& condition) const {
    constexpr int together = 4;  // rows whose loads are in flight at a time
    auto const part = g_.part();
    for (int row = first_; row < end_; row += together) {
      unsigned bits[together];
      FT_UNROLL
      for (int t = 0; t < together; ++t) { bits[t] = flags(row + t, condition); }
      FT_UNROLL
      for (int t = 0; t < together; ++t) {
        unsigned whole = bits[t];
        if constexpr (Group::max_threads > 1) { whole = part.ballot(bits[t] != 0); }
        if (part.rank() == 0 && row + t < end_) { rows[row + t] = whole; }
      }
    }
    part.sync();
  }
  /// Calls visit(row, bits of lower rows) for this warp's rows, with all its threads.
  /// @return bits of all rows
  template <typename Visit>
  FT_HOST_DEVICE int visit(unsigned const* rows, Visit const& visit) const {
    auto const part = g_.part();
    int mine = 0;
    for (int row = first_ + part.rank(); row < end_; row += part.size()) {
      mine += popcount(rows[row]);
    }
    int total = 0;
    int before = part.shuffle(g_.exclusive_scan(mine, total), 0);
    for (int row = first_; row < end_; ++row) {
      unsigned const bits = rows[row];
      visit(row, bits, before);
      before += popcount(bits);
    }
    part.sync();
    return total;
  }

private:
  /// This thread's flag of a row; all flags if it is the only thread.
  template <typename Condition>
  FT_HOST_DEVICE unsigned flags(int row, Condition const& condition) const {
    unsigned bits = 0;
    for (int i = g_.part().rank(); i < 32; i += g_.part().size()) {
      int const slot = 32 * row + i;
      bool const is = row < end_ && slot < used_ && condition(slot);
      bits |= static_cast<unsigned>(is) << i;
    }
    return bits;
  }

  Group g_;
  int used_;
  int first_, end_;
};

/// Item: a batch entry.
struct choose_points {
  using scratch = local_map_scratch;
  static constexpr int unranked = local_map_ranks;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, local_map_input const& in,
                                 odometry_map_view const& map, local_map_view const& out,
                                 local_map_workspace const& work) const {
    for (int p = g.rank(); p < max_keyframes; p += g.size()) {
      s.votes[p] = 0;
      s.rank[p] = unranked;
    }
    for (int i = g.rank(); i < local_map_ranks; i += g.size()) { s.points[i] = 0; }
    for (int w = g.rank(); w < mask_words; w += g.size()) { s.admitted[w] = 0; }
    g.sync();
    if (in.mode[b] == local_map_mode::by_votes) { vote(g, s, b, in.frame, map.records); }
    g.sync();
    admit(g, s, b, in, map.keyframes);
    choose(g, s, b, map.records, out, work);
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void vote(Group g, scratch& s, int b, frame_view const& frame,
                                  point_records_view const& records) {
    auto const part = g.part();
    int const* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    for (int c = 0; c < frame.cameras; ++c) {
      int const n = *frame.camera(b, c).count;
      for (int first = g.part_index() * part.size(); first < n; first += g.size()) {
        int const i = first + part.rank();
        int const slot = i < n ? holder[c * frame.capacity() + i] : -1;
        bool const there = slot >= 0 && slot < records.slots;
        add_votes(part, s.votes, there ? records.mask(b, slot) : nullptr, records.words);
      }
    }
  }

  /// Gives the keyframes of the local map their ranks.
  template <typename Group>
  FT_HOST_DEVICE static void admit(Group g, scratch& s, int b, local_map_input const& in,
                                   keyframes_view const& keyframes) {
    int const made = keyframes.made[b];
    int const count = keyframes.count[b];
    local_map_params const& params = in.params;
    bool const by_votes = in.mode[b] == local_map_mode::by_votes;
    for (int i = g.rank(); i < 64; i += g.size()) { s.ranked[i] = 0; }
    g.sync();
    for (int age = g.rank(); age < count; age += g.size()) {
      int const mine = s.votes[keyframes.position(made - age)];
      if (by_votes && mine == 0) { continue; }
      int rank = by_votes ? 0 : age;
      for (int other = 0; by_votes && other < count; ++other) {
        int const theirs = s.votes[keyframes.position(made - other)];
        rank += static_cast<int>(theirs > mine || (theirs == mine && other < age));
      }
      if (rank < params.keyframes) { s.ranked[rank] = made - age; }
    }
    g.sync();
    for (int i = g.rank(); i < params.keyframes; i += g.size()) {
      int const number = s.ranked[i];
      if (i == 0 && count > 0) { atomic_min(s.rank + keyframes.position(made), 0); }
      if (number == 0) { continue; }
      int const position = keyframes.position(number);
      atomic_min(s.rank + position, 1 + i);
      int const neighbour = keyframes.neighbour[keyframes.at(b, position)];
      if (by_votes && i < params.neighbours && neighbour != 0 && keyframes.holds(b, neighbour)) {
        atomic_min(s.rank + keyframes.position(neighbour), 1 + params.keyframes + i);
      }
    }
    g.sync();
    for (int p = g.rank(); p < keyframes.positions; p += g.size()) {
      if (s.rank[p] != unranked) { atomic_add(s.admitted + p / 64, 1ull << (p % 64)); }
    }
    g.sync();
  }

  template <typename Group>
  FT_HOST_DEVICE static void choose(Group g, scratch& s, int b, point_records_view const& records,
                                    local_map_view const& out, local_map_workspace const& work) {
    slot_rows<Group> const rows(g, records.used[b]);
    unsigned* const chosen = work.chosen + static_cast<std::ptrdiff_t>(b) * 2 * work.rows;
    position_set admitted;
    for (int w = 0; w < mask_words; ++w) { admitted.words[w] = s.admitted[w]; }
    rows.write(chosen,
               [&](int slot) { return admitted.meets(records.mask(b, slot), records.words); });
    int const found = rows.visit(chosen, [](int, unsigned, int) {});
    if (found > out.capacity) {
      prefer(g, s, b, records, {rows, chosen, chosen + work.rows, out.capacity});
    }
    int* const slots = out.slots + static_cast<std::ptrdiff_t>(b) * out.capacity;
    rows.visit(chosen, [&](int row, unsigned bits, int before) {
      for (int i = g.part().rank(); i < 32; i += g.part().size()) {
        if ((bits >> i & 1) != 0) {
          slots[before + popcount(bits & ((1u << i) - 1))] = 32 * row + i;
        }
      }
    });
    if (g.rank() == 0) {
      out.count[b] = min_of(found, out.capacity);
      out.left_out[b] = max_of(found - out.capacity, 0);
    }
  }

  template <typename Group>
  struct crowd {
    slot_rows<Group> const& rows;
    unsigned* chosen;   ///< rows of the candidates, then of the preferred ones
    unsigned* of_last;  ///< rows of those with the last rank
    int capacity;
  };

  /// Restricts the chosen points to the capacity.
  template <typename Group>
  FT_HOST_DEVICE static void prefer(Group g, scratch& s, int b, point_records_view const& records,
                                    crowd<Group> const& c) {
    auto const rank_of = [&](int slot) {
      int first = unranked;
      each_position(records.mask(b, slot), records.words,
                    [&](int p) { first = min_of(first, s.rank[p]); });
      return first;
    };
    c.rows.visit(c.chosen, [&](int row, unsigned bits, int) {
      for (int i = g.part().rank(); i < 32; i += g.part().size()) {
        if ((bits >> i & 1) != 0) { atomic_add(s.points + rank_of(32 * row + i), 1); }
      }
    });
    g.sync();
    if (g.rank() == 0) {
      s.last_rank = 0;
      s.quota = c.capacity;
      while (s.quota >= s.points[s.last_rank]) { s.quota -= s.points[s.last_rank++]; }
    }
    g.sync();
    c.rows.write(c.of_last, [&](int slot) { return rank_of(slot) == s.last_rank; });
    c.rows.write(c.chosen, [&](int slot) { return rank_of(slot) < s.last_rank; });
    c.rows.visit(c.of_last, [&](int row, unsigned bits, int before) {
      unsigned kept = 0;
      for (int n = before; n < s.quota && bits != 0; ++n) {
        unsigned const lowest = bits & (0u - bits);
        kept |= lowest;
        bits ^= lowest;
      }
      if (g.part().rank() == 0) { c.chosen[row] |= kept; }
    });
  }
};

}  // namespace detail

/// Chooses the points that the search in the local map looks for.
///
/// Each keypoint that holds a point votes for the keyframes that see the point. Keyframes are
/// taken in this order: the newest one; those with votes, most votes first, newer ones first among
/// equals, at most `params.keyframes`; the neighbours of the first `params.neighbours` of these. In
/// the mode `newest`: the newest `params.keyframes`. Each point that one of them sees is chosen
/// once. If there are more than `out.capacity`, points of earlier keyframes are preferred, then
/// lower slots, and the others are counted in `out.left_out`.
///
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @throws bad_argument for parameters out of range
template <typename Exec>
void choose_local_map(Exec const& exec, local_map_input const& in, odometry_map_view const& map,
                      local_map_view const& out, local_map_workspace const& work) {
  detail::require_range("keyframes of a local map", in.params.keyframes, 1, 64);
  detail::require_range("neighbours of a local map", in.params.neighbours, 0, 32);
  for_each_item<per_block<1024>>(exec, in.frame.batch, detail::choose_points{}, in, map, out, work);
}

}  // namespace FT_ABI
}  // namespace ft
